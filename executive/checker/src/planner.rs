//! Makes a schedule from what the partitions need: how often, for how long, in the order of their chains.
//!
//! The search is list scheduling with backtracking: partitions are taken in the order of the chains, each is put where it
//! follows its forerunner soonest, and where a chain becomes too old the last decisions are taken back. It is bounded: what
//! it does not find may exist, and [`Impossible::NotFound`] says so. Everything else that it reports is certain.
//!
//! It never asks a clock or chance: the same request gives the same schedule.

use super::latency::{self, Station, Windows};
use super::units::ShowTime;
use bateleur_plan::bounds::{MOST_MINOR_FRAMES, MOST_WINDOWS};

/// What one partition needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Need {
    /// The partition.
    pub name: String,
    /// From one window to the next, ns; not zero.
    pub period_ns: u64,
    /// The length of a window, ns; not zero.
    pub duration_ns: u64,
    /// The cores that it may have, each with the number of its module; not empty.
    pub cores: Vec<(usize, u32)>,
    /// Where in its period (or in the minor frame, if that is shorter) the window has to begin, ns.
    pub offset_ns: Option<u64>,
}

/// A chain that has to keep its age.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bound {
    /// The chain.
    pub name: String,
    /// The needs on its way, by their places.
    pub stations: Vec<usize>,
    /// The largest age, ns.
    pub max_age_ns: u64,
}

/// All that is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The modules' names.
    pub modules: Vec<String>,
    /// One for each partition.
    pub needs: Vec<Need>,
    /// The chains.
    pub chains: Vec<Bound>,
    /// The minor frame, ns; `None`: the shortest period.
    pub minor_frame_ns: Option<u64>,
    /// The major frame, ns; `None`: the shortest in which every period fits.
    pub major_frame_ns: Option<u64>,
    /// What stays free between two windows of a core, ns.
    pub gap_ns: u64,
}

/// One window of the answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Placed {
    /// Whose: the place of the need.
    pub need: usize,
    /// The core.
    pub core: u32,
    /// Its start in the minor frame, ns.
    pub offset_ns: u64,
    /// The minor frames that have it, rising; `None`: all of them.
    pub minor: Option<Vec<u32>>,
}

/// A schedule that holds everything that was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The base period, ns.
    pub minor_frame_ns: u64,
    /// The whole cycle, ns.
    pub major_frame_ns: u64,
    /// By core, offset and partition.
    pub windows: Vec<Placed>,
}

/// Why there is no schedule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Impossible {
    /// Nothing is asked for.
    #[error("nobody needs a window")]
    Nothing,
    /// A period fits the minor frame neither way.
    #[error("the period of `{name}`, {}, neither divides the minor frame of {} nor is a multiple of it", ShowTime(*.period_ns), ShowTime(*.minor_ns))]
    Period {
        /// Whose.
        name: String,
        /// Its period.
        period_ns: u64,
        /// The minor frame.
        minor_ns: u64,
    },
    /// The periods have no common multiple of a sensible length.
    #[error(
        "the periods have no common multiple below {} minor frames: make them multiples of each other",
        MOST_MINOR_FRAMES
    )]
    MajorTooLong,
    /// The major frame that is asked for does not hold every period.
    #[error("a major frame of {} is no multiple of {}, in which the minor frame and every period fit", ShowTime(*.major_ns), ShowTime(*.least_ns))]
    MajorFrame {
        /// What is asked for.
        major_ns: u64,
        /// The shortest one.
        least_ns: u64,
    },
    /// A window recurs more often in the major frame than any core could have windows.
    #[error("`{name}` would have {count} windows in the major frame of {}, and {MOST_WINDOWS} is the most of a core: ask for a longer period, or for a shorter minor frame", ShowTime(*.major_ns))]
    TooManyWindows {
        /// Whose.
        name: String,
        /// How many.
        count: u64,
        /// The major frame.
        major_ns: u64,
    },
    /// All windows together are more than the cores could have.
    #[error("there would be {count} windows in the major frame of {}, and {MOST_WINDOWS} is the most of a core: ask for longer periods, or for a shorter minor frame", ShowTime(*.major_ns))]
    TooManyInAll {
        /// How many.
        count: u64,
        /// The major frame.
        major_ns: u64,
    },
    /// A window is longer than the time it recurs in.
    #[error("the window of `{name}` takes {}, and {what} is only {}", ShowTime(*.duration_ns), ShowTime(*.room_ns))]
    TooLong {
        /// Whose.
        name: String,
        /// Its window.
        duration_ns: u64,
        /// What it has to lie in.
        what: &'static str,
        /// How long that is.
        room_ns: u64,
    },
    /// A wished offset leaves no room for the window.
    #[error("the window of `{name}` can not begin at {}: it would end after {}", ShowTime(*.offset_ns), ShowTime(*.room_ns))]
    OffsetBeyond {
        /// Whose.
        name: String,
        /// The wish.
        offset_ns: u64,
        /// What it has to lie in.
        room_ns: u64,
    },
    /// Cores are asked for more time than they have.
    #[error("{who} of `{module}` would have to give {} in each {}, which is {} too much", ShowTime(*.asked_ns), ShowTime(*.major_ns), ShowTime(.asked_ns - .major_ns * .cores))]
    TooFull {
        /// "core 1", or "the 4 cores".
        who: String,
        /// Their module.
        module: String,
        /// What all windows take.
        asked_ns: u64,
        /// The cycle.
        major_ns: u64,
        /// How many cores.
        cores: u64,
    },
    /// The windows of a chain alone take longer than its age.
    #[error("chain `{name}` can not be younger than {}, which its windows take one after the other, and {} is allowed", ShowTime(*.least_ns), ShowTime(*.allowed_ns))]
    ChainTooShort {
        /// The chain.
        name: String,
        /// The sum of its windows.
        least_ns: u64,
        /// Its bound.
        allowed_ns: u64,
    },
    /// Two wishes exclude each other.
    #[error("`{one}` and `{other}` wish for the same time on core {core}")]
    WishesCollide {
        /// A partition.
        one: String,
        /// Another.
        other: String,
        /// Where.
        core: u32,
    },
    /// The search ended without an answer; there may be one.
    #[error("none was found in {attempts} attempts, which does not prove that there is none: {hint}")]
    NotFound {
        /// How often the search began anew.
        attempts: u32,
        /// Where it failed.
        hint: String,
    },
}

/// Decisions that one attempt may take.
const MOST_DECISIONS: u32 = 4_000;
/// How often the search begins anew, each time with another order of the partitions.
const ATTEMPTS: u32 = 24;
/// Places that are tried for one partition.
const WIDTH: usize = 6;
/// Minor frames that are tried as the first of a slow partition: more are alike.
const MOST_PHASES: u64 = 16;

/// Makes a schedule.
///
/// # Errors
/// Why there is none, or that none was found.
pub fn plan(request: &Request) -> Result<Answer, Impossible> {
    let frames = Frames::of(request)?;
    check_room(request, &frames)?;
    check_count(request, &frames)?;
    check_load(request, &frames)?;
    check_chains(request)?;
    check_wishes(request, &frames)?;
    let mut hint = None;
    for attempt in 0..ATTEMPTS {
        let mut search = Search::new(request, &frames, attempt);
        if search.place(0) {
            return Ok(search.answer());
        }
        let failed = search.failed;
        hint = hint.or(failed);
    }
    let hint = hint.unwrap_or_else(|| "the windows do not fit".to_owned());
    Err(Impossible::NotFound { attempts: ATTEMPTS, hint })
}

struct Frames {
    minor_ns: u64,
    /// How many minor frames the major frame has.
    count: u64,
}

impl Frames {
    fn of(request: &Request) -> Result<Self, Impossible> {
        let shortest = request.needs.iter().map(|need| need.period_ns).min().ok_or(Impossible::Nothing)?;
        let minor_ns = request.minor_frame_ns.unwrap_or(shortest).max(1);
        let mut count = 1;
        for need in &request.needs {
            let period_ns = need.period_ns;
            if period_ns == 0 || (!period_ns.is_multiple_of(minor_ns) && !minor_ns.is_multiple_of(period_ns))
            {
                return Err(Impossible::Period { name: need.name.clone(), period_ns, minor_ns });
            }
            count = common_multiple(count, (period_ns / minor_ns).max(1)).ok_or(Impossible::MajorTooLong)?;
        }
        if let Some(major_ns) = request.major_frame_ns {
            let least_ns = minor_ns.checked_mul(count).ok_or(Impossible::MajorTooLong)?;
            if major_ns == 0 || !major_ns.is_multiple_of(least_ns) {
                return Err(Impossible::MajorFrame { major_ns, least_ns });
            }
            count = major_ns / minor_ns;
        }
        let too_long = count > MOST_MINOR_FRAMES || minor_ns.checked_mul(count).is_none();
        if too_long { Err(Impossible::MajorTooLong) } else { Ok(Self { minor_ns, count }) }
    }

    fn major_ns(&self) -> u64 {
        self.minor_ns * self.count
    }

    /// Every how many minor frames a window recurs.
    fn stride(&self, need: &Need) -> u64 {
        (need.period_ns / self.minor_ns).max(1)
    }

    /// The stretch that a window has to lie in: the minor frame, or the period if that is shorter.
    fn room_ns(&self, need: &Need) -> u64 {
        self.minor_ns.min(need.period_ns)
    }

    /// How many windows there are in a minor frame that has them.
    fn repeats(&self, need: &Need) -> u64 {
        (self.minor_ns / need.period_ns.max(1)).max(1)
    }
}

pub(super) fn common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { common_divisor(b, a % b) }
}

fn common_multiple(a: u64, b: u64) -> Option<u64> {
    (a / common_divisor(a, b)).checked_mul(b)
}

fn check_room(request: &Request, frames: &Frames) -> Result<(), Impossible> {
    for need in &request.needs {
        let room_ns = frames.room_ns(need);
        if need.duration_ns > room_ns {
            let what = if need.period_ns < frames.minor_ns { "its period" } else { "the minor frame" };
            let (name, duration_ns) = (need.name.clone(), need.duration_ns);
            return Err(Impossible::TooLong { name, duration_ns, what, room_ns });
        }
        if let Some(offset_ns) =
            need.offset_ns.filter(|offset| offset.saturating_add(need.duration_ns) > room_ns)
        {
            return Err(Impossible::OffsetBeyond { name: need.name.clone(), offset_ns, room_ns });
        }
    }
    Ok(())
}

/// Windows are laid out one by one: what no schedule could have is refused before.
fn check_count(request: &Request, frames: &Frames) -> Result<(), Impossible> {
    let (mut all, major_ns) = (0_u64, frames.major_ns());
    for need in &request.needs {
        let count = major_ns / need.period_ns.max(1);
        if count > MOST_WINDOWS {
            return Err(Impossible::TooManyWindows { name: need.name.clone(), count, major_ns });
        }
        all = all.saturating_add(count);
    }
    let mut cores: Vec<(usize, u32)> =
        request.needs.iter().flat_map(|need| need.cores.iter().copied()).collect();
    cores.sort_unstable();
    cores.dedup();
    if all > MOST_WINDOWS.saturating_mul(cores.len() as u64) {
        return Err(Impossible::TooManyInAll { count: all, major_ns });
    }
    Ok(())
}

fn load_ns(need: &Need, frames: &Frames) -> u64 {
    frames.major_ns() / need.period_ns.max(1) * need.duration_ns
}

fn check_load(request: &Request, frames: &Frames) -> Result<(), Impossible> {
    let mut groups: Vec<Vec<(usize, u32)>> = Vec::new();
    for need in &request.needs {
        if !groups.contains(&need.cores) {
            groups.push(need.cores.clone());
        }
    }
    // The smallest set of cores first: it names the reason most exactly.
    groups.sort_by_key(|group| (group.len(), group.clone()));
    for group in groups {
        let within = request.needs.iter().filter(|need| need.cores.iter().all(|core| group.contains(core)));
        let asked_ns = within.fold(0_u64, |sum, need| sum.saturating_add(load_ns(need, frames)));
        let (cores, major_ns) = (group.len() as u64, frames.major_ns());
        if asked_ns > major_ns.saturating_mul(cores) {
            let who = match group.as_slice() {
                [(_, core)] => format!("core {core}"),
                several => format!("the {} cores", several.len()),
            };
            let module =
                group.first().and_then(|core| request.modules.get(core.0)).cloned().unwrap_or_default();
            return Err(Impossible::TooFull { who, module, asked_ns, major_ns, cores });
        }
    }
    Ok(())
}

fn check_chains(request: &Request) -> Result<(), Impossible> {
    for chain in &request.chains {
        let windows = chain.stations.iter().filter_map(|&station| request.needs.get(station));
        let least_ns = windows.fold(0_u64, |sum, need| sum.saturating_add(need.duration_ns));
        if least_ns > chain.max_age_ns {
            let (name, allowed_ns) = (chain.name.clone(), chain.max_age_ns);
            return Err(Impossible::ChainTooShort { name, least_ns, allowed_ns });
        }
    }
    Ok(())
}

/// Wishes on the only core of both, in every minor frame, at times that overlap.
fn check_wishes(request: &Request, frames: &Frames) -> Result<(), Impossible> {
    let wishes: Vec<(&Need, u64, u32)> = request
        .needs
        .iter()
        .filter(|need| frames.stride(need) == 1)
        .filter_map(|need| match (need.offset_ns, need.cores.as_slice()) {
            (Some(offset), [(_, core)]) => Some((need, offset, *core)),
            _ => None,
        })
        .collect();
    for (place, one) in wishes.iter().enumerate() {
        for other in &wishes[place + 1..] {
            if one.0.cores == other.0.cores && meet(frames, (one.0, one.1), (other.0, other.1)) {
                let (name, other) = (one.0.name.clone(), other.0.name.clone());
                return Err(Impossible::WishesCollide { one: name, other, core: one.2 });
            }
        }
    }
    Ok(())
}

/// Whether windows of two needs with their wishes overlap somewhere in the minor frame.
fn meet(frames: &Frames, one: (&Need, u64), other: (&Need, u64)) -> bool {
    let slots = |(need, offset): (&Need, u64)| {
        let (period, duration) = (need.period_ns, need.duration_ns);
        (0..frames.repeats(need)).map(move |turn| (turn * period + offset, turn * period + offset + duration))
    };
    // Both rise, so that the one that ends first meets nobody any more.
    let (mut one, mut other) = (slots(one).peekable(), slots(other).peekable());
    while let (Some(a), Some(b)) = (one.peek(), other.peek()) {
        if a.0 < b.1 && b.0 < a.1 {
            return true;
        }
        if a.1 <= b.1 {
            one.next()
        } else {
            other.next()
        };
    }
    false
}

/// Where a need has been put.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Spot {
    core: (usize, u32),
    /// The first minor frame that has it.
    phase: u64,
    offset_ns: u64,
}

struct Search<'a> {
    request: &'a Request,
    frames: &'a Frames,
    order: Vec<usize>,
    /// Before whom each need comes in a chain.
    forerunners: Vec<Vec<usize>>,
    spots: Vec<Option<Spot>>,
    decisions: u32,
    /// What went wrong when the search had come furthest.
    failed: Option<String>,
    furthest: usize,
}

impl<'a> Search<'a> {
    fn new(request: &'a Request, frames: &'a Frames, attempt: u32) -> Self {
        let mut forerunners = vec![Vec::new(); request.needs.len()];
        for pair in request.chains.iter().flat_map(|chain| chain.stations.windows(2)) {
            if let [from, to] = *pair
                && from != to
            {
                forerunners[to].push(from);
            }
        }
        let order = order(request, frames, &forerunners, attempt);
        let spots = vec![None; request.needs.len()];
        Self { request, frames, order, forerunners, spots, decisions: 0, failed: None, furthest: 0 }
    }

    /// Puts the needs from the given place of the order on; says whether all found their places.
    fn place(&mut self, depth: usize) -> bool {
        let Some(&need) = self.order.get(depth) else { return true };
        if self.decisions >= MOST_DECISIONS {
            return false;
        }
        let spots = self.candidates(need);
        if spots.is_empty() {
            self.fail(depth, || {
                format!("`{}` finds no room beside the others", self.request.needs[need].name)
            });
        }
        for spot in spots {
            self.decisions += 1;
            self.spots[need] = Some(spot);
            match self.too_old(need) {
                Some((chain, age)) => self.fail(depth, || {
                    let bound = &self.request.chains[chain];
                    let allowed = ShowTime(bound.max_age_ns);
                    format!("chain `{}` comes out at {}, and {allowed} is allowed", bound.name, ShowTime(age))
                }),
                None if self.place(depth + 1) => return true,
                None => {}
            }
            self.spots[need] = None;
        }
        false
    }

    fn fail(&mut self, depth: usize, why: impl FnOnce() -> String) {
        if self.failed.is_none() || depth > self.furthest {
            (self.failed, self.furthest) = (Some(why()), depth);
        }
    }

    /// A chain through `need` that is placed whole and too old.
    fn too_old(&self, need: usize) -> Option<(usize, u64)> {
        let chains =
            self.request.chains.iter().enumerate().filter(|(_, chain)| chain.stations.contains(&need));
        chains
            .filter_map(|(place, chain)| Some((place, self.age_ns(chain)?)))
            .find(|&(place, age)| age > self.request.chains[place].max_age_ns)
    }

    fn age_ns(&self, chain: &Bound) -> Option<u64> {
        let station = |&station: &usize| Some(Station { windows: self.windows(station)?, hop: None });
        let stations: Vec<Station> = chain.stations.iter().map(station).collect::<Option<_>>()?;
        Some(latency::age_ns(&stations, &latency::worst(&stations, self.frames.major_ns())?))
    }

    /// The windows of a need over the major frame, if it has been put.
    fn windows(&self, need: usize) -> Option<Windows> {
        let (spot, need) = (self.spots[need]?, &self.request.needs[need]);
        let mut windows = Windows::new();
        let mut minor = spot.phase;
        while minor < self.frames.count {
            for turn in 0..self.frames.repeats(need) {
                let start = minor * self.frames.minor_ns + turn * need.period_ns + spot.offset_ns;
                windows.push((start, start + need.duration_ns));
            }
            minor += self.frames.stride(need);
        }
        Some(windows)
    }

    /// Where a need could be put, the best first.
    fn candidates(&self, need: usize) -> Vec<Spot> {
        let asked = &self.request.needs[need];
        let phases = self.frames.stride(asked).min(MOST_PHASES);
        let first = self.first_phase(need);
        let mut found = Vec::new();
        for &core in &asked.cores {
            for step in 0..phases {
                let phase = (first + step) % self.frames.stride(asked);
                let busy = self.busy(need, core, phase);
                let after = self.after(need, phase);
                // Behind its forerunners in the same frame; where that fails, wherever there is room.
                for least in [after, 0] {
                    let offset = match asked.offset_ns {
                        Some(wish) => self.fits(asked, &busy, wish).then_some(wish),
                        None => self.earliest(asked, &busy, least),
                    };
                    let spot = offset.map(|offset_ns| Spot { core, phase, offset_ns });
                    found.extend(spot.filter(|spot| !found.contains(spot)));
                }
            }
        }
        let chained = !self.forerunners[need].is_empty();
        found.sort_by_key(|spot| {
            let delay = if chained { self.delay(need, spot) } else { 0 };
            (
                delay,
                self.load(spot.core, spot.phase, self.frames.stride(asked)),
                spot.offset_ns,
                spot.core,
                spot.phase,
            )
        });
        found.truncate(WIDTH);
        found
    }

    /// The minor frame to begin with: that of the slowest forerunner.
    fn first_phase(&self, need: usize) -> u64 {
        let stride = self.frames.stride(&self.request.needs[need]);
        let before = self.forerunners[need]
            .iter()
            .filter_map(|&one| Some((self.frames.stride(&self.request.needs[one]), self.spots[one]?.phase)));
        before.max().map_or(0, |(_, phase)| phase % stride)
    }

    /// The end of the last forerunner's window that shares a minor frame with `phase`.
    fn after(&self, need: usize, phase: u64) -> u64 {
        let stride = self.frames.stride(&self.request.needs[need]);
        let ends = self.forerunners[need].iter().filter_map(|&one| {
            let (spot, before) = (self.spots[one]?, &self.request.needs[one]);
            let common = common_divisor(stride, self.frames.stride(before));
            (spot.phase % common == phase % common)
                .then_some(spot.offset_ns + before.duration_ns + self.request.gap_ns)
        });
        ends.max().unwrap_or(0)
    }

    /// How long after its forerunners' ends a window would open, the longest of them.
    fn delay(&self, need: usize, spot: &Spot) -> u64 {
        let asked = &self.request.needs[need];
        let waits = self.forerunners[need].iter().filter_map(|&one| {
            let (before, other) = (self.spots[one]?, &self.request.needs[one]);
            let cycle =
                common_divisor(self.frames.stride(asked), self.frames.stride(other)) * self.frames.minor_ns;
            let cycle = common_divisor(cycle, common_divisor(asked.period_ns, other.period_ns)).max(1);
            let end = (before.phase * self.frames.minor_ns + before.offset_ns + other.duration_ns) % cycle;
            let start = (spot.phase * self.frames.minor_ns + spot.offset_ns) % cycle;
            Some((start + cycle - end) % cycle)
        });
        waits.max().unwrap_or(0)
    }

    /// What is put already on a core in the minor frames that a phase means.
    fn load(&self, core: (usize, u32), phase: u64, stride: u64) -> u64 {
        let put =
            self.spots.iter().zip(&self.request.needs).filter_map(|(spot, need)| Some(((*spot)?, need)));
        let here = put.filter(|(spot, need)| {
            let common = common_divisor(stride, self.frames.stride(need));
            spot.core == core && spot.phase % common == phase % common
        });
        here.map(|(_, need)| load_ns(need, self.frames)).sum()
    }

    /// The times of the minor frame that are taken, by start, where the need would be; folded into its period if it recurs
    /// within the minor frame.
    fn busy(&self, need: usize, core: (usize, u32), phase: u64) -> Vec<(u64, u64)> {
        let asked = &self.request.needs[need];
        let (stride, room) = (self.frames.stride(asked), self.frames.room_ns(asked));
        let mut busy = Vec::new();
        for (spot, other) in self.spots.iter().zip(&self.request.needs) {
            let Some(spot) = spot.filter(|spot| spot.core == core) else { continue };
            let common = common_divisor(stride, self.frames.stride(other));
            if spot.phase % common != phase % common {
                continue;
            }
            for turn in 0..self.frames.repeats(other) {
                let start = turn * other.period_ns + spot.offset_ns;
                let (from, to) = (start % room, start % room + other.duration_ns);
                busy.push((from, to.min(room)));
                if to > room {
                    busy.push((0, to - room));
                }
            }
        }
        busy.sort_unstable();
        busy
    }

    fn fits(&self, need: &Need, busy: &[(u64, u64)], offset: u64) -> bool {
        let end = offset + need.duration_ns;
        end <= self.frames.room_ns(need) && busy.iter().all(|&(from, to)| end <= from || to <= offset)
    }

    fn earliest(&self, need: &Need, busy: &[(u64, u64)], least: u64) -> Option<u64> {
        let gap = self.request.gap_ns;
        let mut offset = least;
        for &(from, to) in busy {
            if offset + need.duration_ns + gap > from && offset < to + gap {
                offset = to + gap;
            }
        }
        self.fits(need, busy, offset).then_some(offset)
    }

    fn answer(&self) -> Answer {
        let mut windows = Vec::new();
        for (place, (spot, need)) in self.spots.iter().zip(&self.request.needs).enumerate() {
            let Some(spot) = spot else { continue };
            let stride = self.frames.stride(need);
            let minors =
                (spot.phase..self.frames.count).step_by(usize::try_from(stride).unwrap_or(usize::MAX));
            let minor = (stride > 1).then(|| minors.filter_map(|minor| u32::try_from(minor).ok()).collect());
            for turn in 0..self.frames.repeats(need) {
                let offset_ns = turn * need.period_ns + spot.offset_ns;
                windows.push(Placed { need: place, core: spot.core.1, offset_ns, minor: minor.clone() });
            }
        }
        windows.sort_by_key(|window| (window.core, window.offset_ns, window.minor.clone(), window.need));
        Answer { minor_frame_ns: self.frames.minor_ns, major_frame_ns: self.frames.major_ns(), windows }
    }
}

/// The order in which needs are put: nobody before a forerunner, unless they go round in circles.
fn order(request: &Request, frames: &Frames, forerunners: &[Vec<usize>], attempt: u32) -> Vec<usize> {
    let mut chance = u64::from(attempt).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut draw = || {
        // Xorshift (Marsaglia 2003): orders that differ, the same ones every time.
        chance ^= chance << 13;
        chance ^= chance >> 7;
        chance ^= chance << 17;
        chance
    };
    let chained = |need: usize| request.chains.iter().any(|chain| chain.stations.contains(&need));
    let key = |need: usize, asked: &Need, lot: u64| {
        let wish = asked.offset_ns.is_none();
        let (stride, longest) = (frames.stride(asked), u64::MAX - asked.duration_ns);
        match attempt {
            0 => (wish, !chained(need), stride, longest),
            1 => (wish, false, stride, longest),
            2 => (wish, false, 0, longest),
            3 => (wish, !chained(need), 0, asked.duration_ns),
            _ => (wish, attempt.is_multiple_of(2) && !chained(need), 0, lot),
        }
    };
    let mut keyed: Vec<_> =
        request.needs.iter().enumerate().map(|(need, asked)| (key(need, asked, draw()), need)).collect();
    keyed.sort_unstable();
    let mut left: Vec<usize> = keyed.into_iter().map(|(_, need)| need).collect();
    let mut order: Vec<usize> = Vec::new();
    while !left.is_empty() {
        let ready = |need: &usize| forerunners[*need].iter().all(|before| order.contains(before));
        let next =
            left.iter().position(|need| request.needs[*need].offset_ns.is_some() || ready(need)).unwrap_or(0);
        order.push(left.remove(next));
    }
    order
}
