//! Figures of restarts, of a partition and of the executive: from the signal to the next window.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_monitor::event::Event;
use bateleur_system::time::now_ns;
use rustix::process::{Pid, Signal, kill_process};

use super::Settings;
use super::module::{Ended, Running, start};
use super::probe;
use super::row::{Reach, Row};
use super::sketch::{Link, Sketched, schedule};
use super::statistics::{median, quantile};

/// Who is killed.
pub(super) const VICTIM: &str = "victim";
/// The frame that restarts are measured in, us: the one that flies.
pub(super) const FRAME_US: u64 = 20_000;
/// Kills in one run.
pub(super) const KILLS: u64 = 40;
/// As above, of the executive: each takes all partitions with it.
const EXECUTIVES: u64 = 20;
/// What the executive's process is called.
const EXECUTIVE: &str = "bateleurd";
/// From a successor's first window to its own end, ms: the standby of a hot restart is there by then.
const PAUSE_MS: u64 = 120;
/// How long a successor may take to its first window, ms: beyond every reach.
const PATIENCE_MS: u64 = 10_000;

/// Each kind of restart, at instants that have nothing to do with the frame.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    Ok(KINDS.iter().flat_map(|kind| rows_of(settings, kind)).collect())
}

fn rows_of(settings: &Settings, kind: &Kind) -> Vec<Row> {
    let kills = match (settings.quick, kind.ends) {
        (true, _) => 3,
        (false, Ends::Victim) => KILLS,
        (false, Ends::Executive(_)) => EXECUTIVES,
    };
    let runs = match not_in_this_build(settings, kind) {
        Some(why) => Err(anyhow::Error::msg(why)),
        None => (0..settings.runs).map(|_| ends(&module(settings, kind), kills, kind.ends)).collect(),
    };
    let runs: Vec<Restarts> = match runs {
        Ok(runs) => runs,
        Err(error) => return vec![Row::impossible(kind.name, format!("{error:#}"))],
    };
    let about = match kind.ends {
        Ends::Victim => "SIGKILL from outside to the first instruction of the successor's first window",
        Ends::Executive(_) => "the signal to the next window of a partition, among nine",
    };
    let windows = quantiles(kind.name, runs.iter().map(|run| &run.window_ms), kind.reaches(), about);
    if windows.is_empty() {
        return vec![Row::impossible(kind.name, "the window log has no window of a successor")];
    }
    let about = "SIGKILL from outside until the standby has taken over: its next window can be granted";
    let name = format!("{}, taken over", kind.name);
    let stated = [Reach::Stated, Reach::Stated];
    let takeovers = quantiles(&name, runs.iter().map(|run| &run.takeover_ms), stated, about);
    windows.into_iter().chain(takeovers).collect()
}

/// The rows of p50 and p99, over the medians of runs; none where nothing was seen.
fn quantiles<'r>(
    name: &str,
    runs: impl Iterator<Item = &'r Vec<f64>> + Clone,
    [middle, most]: [Reach; 2],
    about: &str,
) -> Vec<Row> {
    let row = |words: &str, share, reach| {
        let of_each: Vec<f64> = runs.clone().filter_map(|run| quantile(run, share)).collect();
        Some(Row::measured(format!("{name}, {words}"), "ms", median(&of_each)?, None, reach, about))
    };
    [row("p50", 0.5, middle), row("p99", 0.99, most)].into_iter().flatten().collect()
}

/// A way to start a successor.
struct Kind {
    name: &'static str,
    /// With what it has retained, and not from nothing.
    is_warm: bool,
    /// Who waits to be the successor, if anybody does.
    standby: Option<&'static str>,
    ends: Ends,
    /// At p50, if it has one there, and at p99.
    reach_ms: (Option<f64>, f64),
}

/// What is ended.
#[derive(Clone, Copy)]
enum Ends {
    /// The partition, by SIGKILL.
    Victim,
    /// The executive, by that signal.
    Executive(Signal),
}

impl Kind {
    const fn new(name: &'static str, is_warm: bool, p50_ms: Option<f64>, p99_ms: f64) -> Self {
        Self { name, is_warm, standby: None, ends: Ends::Victim, reach_ms: (p50_ms, p99_ms) }
    }

    fn reaches(&self) -> [Reach; 2] {
        [self.reach_ms.0.map_or(Reach::Stated, Reach::AtMost), Reach::AtMost(self.reach_ms.1)]
    }

    /// Keys of the partition.
    fn keys(&self) -> String {
        let (start, retained) = if self.is_warm { ("warm", "retained = \"16KiB\"\n") } else { ("cold", "") };
        let standby = self.standby.map(|who| format!("standby = \"{who}\"\n")).unwrap_or_default();
        format!(
            "restart = {{ start = \"{start}\", budget = 1000, within = \"1s\", then = \"idle\" }}\n\
             health = {{ killed = \"{start}_restart\" }}\n{retained}{standby}"
        )
    }
}

const KINDS: &[Kind] = &[
    Kind::new("cold restart", false, None, 60.0),
    Kind::new("warm restart", true, None, 60.0),
    Kind { standby: Some("spare"), ..Kind::new("cold restart, spare", false, Some(15.0), 25.0) },
    Kind { standby: Some("spare"), ..Kind::new("warm restart, spare", true, Some(15.0), 25.0) },
    // The next window, which is a frame away at most.
    Kind { standby: Some("hot"), ..Kind::new("hot standby", true, None, FRAME_US as f64 / 1e3 + 1.0) },
    Kind { ends: Ends::Executive(Signal::KILL), ..Kind::new("executive killed", true, Some(300.0), 1_000.0) },
    Kind { ends: Ends::Executive(Signal::STOP), ..Kind::new("executive stopped", true, None, 1_500.0) },
];

/// Why the schedule of this kind is refused, if it is.
fn not_in_this_build(settings: &Settings, kind: &Kind) -> Option<String> {
    let refused = bateleur_executive_cli::plan_file::read_text("generated", &module(settings, kind)).err()?;
    let text = refused.render(false);
    Some(format!("the schedule file is refused: {}", text.lines().next().unwrap_or_default()))
}

fn module(settings: &Settings, kind: &Kind) -> String {
    if let Ends::Executive(_) = kind.ends {
        return of_nine(settings, kind);
    }
    let partitions =
        [victim(&kind.keys(), &[(2_000, 500)]), Sketched::new("neighbour", "touch", &[(4_000, 500)])];
    let there = Link { from: 0, to: 1 };
    let back = Link { from: 1, to: 0 };
    schedule(settings.core, FRAME_US, &partitions, &[there, there, back, back])
}

/// A module of as many partitions as the flight's, each with a channel to the next one, that outlives its executive.
fn of_nine(settings: &Settings, kind: &Kind) -> String {
    let window = |place: u64| [(1_000 + 1_500 * place, 500)];
    let mut partitions = vec![victim(&kind.keys(), &window(0))];
    partitions.extend((1..9).map(|place| Sketched::new(format!("p{place}"), "touch", &window(place))));
    let links: Vec<Link> = (0..9).map(|from| Link { from, to: (from + 1) % 9 }).collect();
    schedule(settings.core, FRAME_US, &partitions, &links)
        + "\n[health.module]\nexecutive_died = \"reset\"\nexecutive_hung = \"reset\"\n\n\
           [health.reset]\nbudget = 1000\nwithin = \"1s\"\n"
}

/// The partition that is killed; it says when module time began.
pub(super) fn victim(more: &str, windows: &[(u64, u64)]) -> Sketched {
    let plain = Sketched::new(VICTIM, "touch", windows);
    Sketched { attributes: format!("{}, says_origin = true", plain.attributes), more: more.into(), ..plain }
}

/// How long the victim of a module was gone, each time that it was killed.
#[derive(Debug, Default)]
pub(super) struct Restarts {
    /// Until its successor's first window, ms.
    pub(super) window_ms: Vec<f64>,
    /// Until its standby had taken over, ms; empty where it has none.
    takeover_ms: Vec<f64>,
}

/// Kills the victim of a module `kills` times.
pub(super) fn restarts(schedule: &str, kills: u64) -> Result<Restarts> {
    ends(schedule, kills, Ends::Victim)
}

/// Ends the victim of a module, or the executive below it, `kills` times.
fn ends(schedule: &str, kills: u64, ends: Ends) -> Result<Restarts> {
    let longest_s = kills as f64 * (PATIENCE_MS + 2 * PAUSE_MS) as f64 / 1e3;
    let mut running = start(schedule, longest_s)?;
    if !running.await_windows() {
        running.end()?;
        bail!("the module did not begin");
    }
    let killed_ns = kill_each(kills, &mut Aim { running: &mut running, ends })?;
    let _ = kill_process(pid_of(running.pid())?, Signal::INT); // it has ended already: its end says why
    gone(&running.end()?, &killed_ns)
}

/// What is killed again and again.
trait Victim {
    /// How many incarnations had a window so far.
    fn lives(&mut self) -> usize;
    /// Ends the present one; the instant.
    fn kill(&mut self) -> Result<u64>;
    fn wait_ms(&mut self, ms: u64);
    /// What is known of it, for whoever wonders why it does not come back.
    fn told(&mut self) -> String;
}

/// Kills each incarnation once it has had a window, `kills` in all; the instants.
///
/// One that is killed in a fixed rhythm may never come so far: among 64 partitions, whose windows leave a fifth of the processor, a start
/// takes longer than a pause that suits four.
fn kill_each(kills: u64, victim: &mut impl Victim) -> Result<Vec<u64>> {
    let mut killed_ns = Vec::new();
    for number in 0..=kills {
        let mut waited_ms = 0;
        while victim.lives() as u64 <= number {
            if waited_ms >= PATIENCE_MS {
                let told = victim.told();
                bail!(
                    "after kill {number} of {kills} no successor had a window within {PATIENCE_MS} ms{told}"
                );
            }
            victim.wait_ms(5);
            waited_ms += 5;
        }
        if number < kills {
            // Phases spread over the frame: 7 and 20 have no common factor.
            victim.wait_ms(PAUSE_MS + number * 7 % 20);
            killed_ns.push(victim.kill()?);
        }
    }
    Ok(killed_ns)
}

/// What is ended of a module that runs.
struct Aim<'r> {
    running: &'r mut Running,
    ends: Ends,
}

impl Victim for Aim<'_> {
    fn lives(&mut self) -> usize {
        instants(&self.running.words_of(VICTIM), "origin ").len()
    }

    fn kill(&mut self) -> Result<u64> {
        let (name, signal) = match self.ends {
            Ends::Victim => (VICTIM, Signal::KILL),
            Ends::Executive(signal) => (EXECUTIVE, signal),
        };
        let children = probe::children(self.running.pid());
        let victim = children.iter().find(|(_, one)| one == name);
        let (pid, _) = victim.with_context(|| format!("{name} has no process, although it had a window"))?;
        let now = now_ns();
        kill_process(pid_of(*pid)?, signal).with_context(|| format!("cannot end {name}"))?;
        Ok(now)
    }

    fn wait_ms(&mut self, ms: u64) {
        std::thread::sleep(Duration::from_millis(ms));
    }

    fn told(&mut self) -> String {
        let of_victim = |event: &Event| match event {
            Event::Fault { partition, .. } | Event::Message { partition, .. } => partition == VICTIM,
            event => matches!(event, Event::ModuleFault { .. } | Event::Stopped { .. }),
        };
        self.running
            .events()
            .filter(of_victim)
            .last()
            .map_or_else(String::new, |event| format!("; the module says: {event}"))
    }
}

fn pid_of(number: i32) -> Result<Pid> {
    Pid::from_raw(number).context("a process without a number")
}

/// The instants that a partition has written behind `word`, a line each.
fn instants(words: &str, word: &str) -> Vec<u64> {
    words.lines().filter_map(|line| line.strip_prefix(word)?.parse().ok()).collect()
}

/// From each kill to the next window that the victim took, and to the next takeover.
fn gone(ended: &Ended, killed_ns: &[u64]) -> Result<Restarts> {
    let words = ended.words_of(VICTIM);
    let origins = instants(&words, "origin ");
    let origin_ns = origins.first().context("the partition did not say when module time began")?;
    let opened: Vec<u64> = ended.of(VICTIM).filter_map(|line| Some(line.opened_ns? + origin_ns)).collect();
    let after = |instants: &[u64]| {
        let next = |killed: &u64| Some((instants.iter().find(|at| *at > killed)? - killed) as f64 / 1e6);
        killed_ns.iter().filter_map(next).collect()
    };
    Ok(Restarts { window_ms: after(&opened), takeover_ms: after(&instants(&words, "took_over ")) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A partition in a time of its own, whose start takes some time and begins anew when it is killed.
    struct Slow {
        now_ms: u64,
        start_ms: u64,
        started_ms: u64,
        lives: usize,
    }

    impl Slow {
        fn new(start_ms: u64) -> Self {
            Self { now_ms: 0, start_ms, started_ms: 0, lives: 0 }
        }
    }

    impl Victim for Slow {
        fn lives(&mut self) -> usize {
            self.lives
        }
        fn kill(&mut self) -> Result<u64> {
            self.started_ms = self.now_ms;
            Ok(self.now_ms)
        }
        fn wait_ms(&mut self, ms: u64) {
            let ready_ms = self.started_ms + self.start_ms;
            self.lives += usize::from((self.now_ms + 1..=self.now_ms + ms).contains(&ready_ms));
            self.now_ms += ms;
        }
        fn told(&mut self) -> String {
            String::new()
        }
    }

    #[test]
    fn successor_that_starts_slowly_is_waited_for_and_not_killed_in_its_start() {
        let mut rhythm = Slow::new(150);
        for _ in 0..10 {
            rhythm.wait_ms(PAUSE_MS);
            rhythm.kill().unwrap();
        }
        assert_eq!(rhythm.lives, 0, "a fixed rhythm leaves none of them a window");
        for start_ms in [1, 35, 121, 150, 846, PATIENCE_MS - 10] {
            let mut victim = Slow::new(start_ms);
            let killed = kill_each(10, &mut victim).unwrap();
            assert_eq!((killed.len(), victim.lives), (10, 11), "a start of {start_ms} ms");
        }
        let error = kill_each(10, &mut Slow::new(PATIENCE_MS + 10)).unwrap_err().to_string();
        assert!(error.starts_with("after kill 0 of 10 no successor had a window"), "{error}");
    }
}
