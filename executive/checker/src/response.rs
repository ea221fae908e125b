//! How late a process can be done after its release, at worst, in the windows that its partition has.
//!
//! What the windows supply from an instant on is exact (a supply function, as Lipari and Bini, "Resource partitioning among real-time
//! applications", ECRTS 2003, and Shin and Lee, "Periodic resource model", RTSS 2003, bound it); what is asked for is that of fixed priorities
//! (Joseph and Pandya, 1986; with more than one job in a busy period: Lehoczky, 1990). The response is the first time by which the supply has
//! reached the demand, at the worst instant for the work to begin.
//!
//! Among equals who has been ready for longest runs first. As long as everybody is done before the next release of its own, at most
//! one job of each equal is before a process, and nothing of it is behind: so all processes of a priority have one demand. Where that does not
//! hold, equals count as more urgent.
//!
//! Release points are those of the partition, and processes are released at them. One that has no period may be released at any instant, once
//! at a time; how often, nobody knows, so who is less urgent has no bound. What is not in it: the error handler, locks, and mutexes,
//! which go into the times of the processes.

use super::planner::common_divisor;
use bateleur_plan::processes::recurrence;

/// A process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Task {
    /// The highest is the most urgent.
    pub(super) priority: u8,
    /// From one release to the next, ns, a multiple of the partition's period; `None`: it is not periodic.
    pub(super) period_ns: Option<u64>,
    /// What it computes after each release at most, ns; not zero.
    pub(super) wcet_ns: u64,
}

/// What is known of a process's response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Response {
    /// It is done so long after its release at the latest, ns.
    Within(u64),
    /// More is asked for than the windows give.
    TooMuch,
    /// This one, at least as urgent, has no period.
    Unlimited(usize),
}

/// What a partition's windows give.
#[derive(Clone, Debug)]
pub(super) struct Supply {
    /// By rising start, none empty.
    windows: Vec<(u64, u64)>,
    /// The time of all windows before each.
    before: Vec<u64>,
    /// The time of all of them.
    all: u64,
    major: u64,
    /// After which everything recurs.
    recurs: u64,
    /// The partition's period.
    period: u64,
    /// The first of its release points.
    release: u64,
}

/// Steps towards a fixed point: more are none, or one that nobody waits for.
const MOST_STEPS: usize = 10_000;
/// Jobs of a process that may wait for each other.
const MOST_JOBS: u64 = 1_000;

impl Supply {
    /// Of windows that recur with the major frame; the last `margin_ns` of each give nothing.
    pub(super) fn new(
        windows: &[(u64, u64)],
        margin_ns: u64,
        major: u64,
        (release, period): (u64, u64),
    ) -> Self {
        let usable = windows.iter().map(|&(start, end)| (start, end.saturating_sub(margin_ns)));
        let windows: Vec<(u64, u64)> = usable.filter(|(start, end)| start < end).collect();
        let (mut all, mut before) = (0, Vec::with_capacity(windows.len()));
        for (start, end) in &windows {
            before.push(all);
            all += end - start;
        }
        let recurs = recurrence(&windows, major).unwrap_or(major);
        Self { windows, before, all, major, recurs, period, release }
    }

    /// From `start` on, the time until `demand` has been supplied; `None` beyond all times.
    fn takes(&self, start: u64, demand: u64) -> Option<u64> {
        if self.all == 0 {
            return None;
        }
        let within = start % self.major;
        // As if from the start of the frame: what it had given by then comes on top.
        let wanted = demand.checked_add(self.given(within))?;
        let (frames, rest) = ((wanted - 1) / self.all, (wanted - 1) % self.all + 1);
        let place = self.before.partition_point(|&before| before < rest) - 1;
        let end = self.windows[place].0 + (rest - self.before[place]);
        frames.checked_mul(self.major)?.checked_add(end)?.checked_sub(within)
    }

    /// What the windows have given from the start of the frame until `within`.
    fn given(&self, within: u64) -> u64 {
        let place = self.windows.partition_point(|&(start, _)| start < within);
        let Some(last) = place.checked_sub(1) else { return 0 };
        let (start, end) = self.windows[last];
        self.before[last] + within.min(end) - start
    }

    /// The instants at which release points lie against the windows, each kind once.
    fn release_points(&self) -> impl Iterator<Item = u64> + use<> {
        let (first, period) = (self.release % self.period, self.period);
        // After so many periods the windows lie as before.
        let count = self.recurs / common_divisor(self.recurs, period);
        (0..count).map(move |place| first + place * period)
    }

    /// The instants after which it takes longest until the next window.
    fn ends(&self) -> impl Iterator<Item = u64> {
        let first = self.windows.first().map_or(0, |(start, _)| *start);
        let within = self.windows.iter().take_while(move |(start, _)| start - first < self.recurs);
        within.map(|(_, end)| *end)
    }

    /// The longest that it takes from any of `starts` until a demand has been supplied that grows with the time it takes.
    fn longest(&self, mut starts: impl Iterator<Item = u64>, demand: &dyn Fn(u64) -> u64) -> Option<u64> {
        starts.try_fold(0, |longest, start| Some(self.fixed_point(start, demand)?.max(longest)))
    }

    fn fixed_point(&self, start: u64, demand: &dyn Fn(u64) -> u64) -> Option<u64> {
        let mut time = 1; // whatever is released at the start counts
        for _ in 0..MOST_STEPS {
            let next = self.takes(start, demand(time))?;
            if next <= time {
                return Some(next);
            }
            time = next;
        }
        None
    }
}

/// The worst response of each process.
pub(super) fn responses(tasks: &[Task], supply: &Supply) -> Vec<Response> {
    (0..tasks.len()).map(|place| Level::of(tasks, place, supply).response()).collect()
}

/// A process, and who is at least as urgent.
struct Level<'a> {
    tasks: &'a [Task],
    place: usize,
    supply: &'a Supply,
    above: Vec<&'a Task>,
    /// Without the process itself.
    equals: Vec<&'a Task>,
}

impl<'a> Level<'a> {
    fn of(tasks: &'a [Task], place: usize, supply: &'a Supply) -> Self {
        let priority = tasks[place].priority;
        let others =
            || tasks.iter().enumerate().filter(move |(other, _)| *other != place).map(|(_, task)| task);
        let above = others().filter(|task| task.priority > priority).collect();
        let equals = others().filter(|task| task.priority == priority).collect();
        Self { tasks, place, supply, above, equals }
    }

    fn own(&self) -> &Task {
        &self.tasks[self.place]
    }

    fn response(&self) -> Response {
        if let Some(place) = self.unlimited(|task| task.priority > self.own().priority) {
            return Response::Unlimited(place);
        }
        if self.asks_too_much(&self.above, None) {
            return Response::TooMuch;
        }
        let Some(once) = self.with_each_equal_once(self.own().period_ns.is_none()) else {
            return Response::TooMuch;
        };
        let Some(all) = self.with_each_equal_once(false) else { return Response::TooMuch };
        let everybody = self.equals.iter().copied().chain([self.own()]);
        if everybody.filter_map(|task| task.period_ns).all(|period| all <= period) {
            return Response::Within(once);
        }
        if let Some(place) = self.unlimited(|task| task.priority >= self.own().priority) {
            return Response::Unlimited(place);
        }
        self.with_backlog().map_or(Response::TooMuch, Response::Within)
    }

    fn unlimited(&self, among: impl Fn(&Task) -> bool) -> Option<usize> {
        self.tasks.iter().position(|task| among(task) && task.period_ns.is_none())
    }

    /// What processes ask for in the long run is no less than what the windows give.
    fn asks_too_much(&self, tasks: &[&Task], own: Option<&Task>) -> bool {
        let rate = |task: &Task| task.wcet_ns as f64 / task.period_ns.unwrap_or(u64::MAX) as f64;
        let asked: f64 = tasks.iter().copied().chain(own).map(rate).sum();
        asked >= self.supply.all as f64 / self.supply.major as f64
    }

    /// One job of each equal before the own one, in what the more urgent leave; `anywhen`: released at any instant.
    fn with_each_equal_once(&self, anywhen: bool) -> Option<u64> {
        let once = self.equals.iter().fold(self.own().wcet_ns, |sum, task| sum.saturating_add(task.wcet_ns));
        let demand = |time: u64| once.saturating_add(asked(&self.above, time));
        let ends = self.supply.ends().filter(|_| anywhen);
        self.supply.longest(self.supply.release_points().chain(ends), &demand)
    }

    /// All jobs of a stretch in which the processor is never without work of this priority or above.
    fn with_backlog(&self) -> Option<u64> {
        let (wcet, period) = (self.own().wcet_ns, self.own().period_ns?);
        let others: Vec<&Task> = self.above.iter().chain(&self.equals).copied().collect();
        if self.asks_too_much(&others, Some(self.own())) {
            return None;
        }
        let mut worst = 0;
        for job in 0..MOST_JOBS {
            let own = wcet.saturating_mul(job + 1);
            let demand = |time: u64| own.saturating_add(asked(&others, time));
            let done = self.supply.longest(self.supply.release_points(), &demand)?;
            worst = worst.max(done.saturating_sub(job * period));
            if done <= (job + 1) * period {
                return Some(worst);
            }
        }
        None
    }
}

/// What processes are released for within `time`, at most.
fn asked(tasks: &[&Task], time: u64) -> u64 {
    let one = |task: &&Task| match task.period_ns {
        Some(period) => time.div_ceil(period).saturating_mul(task.wcet_ns),
        None => 0, // nobody asks
    };
    tasks.iter().map(one).fold(0, u64::saturating_add)
}

#[cfg(test)]
mod tests;
