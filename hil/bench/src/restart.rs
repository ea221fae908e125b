//! Figures of restarts: from SIGKILL to the successor's first window.

use std::time::Duration;

use anyhow::{Context, Result, bail};
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
/// Between two kills, ms: longer than any restart that is within its reach.
const PAUSE_MS: u64 = 120;

/// Cold and warm restarts, each at instants that have nothing to do with the frame.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let kills = if settings.quick { 3 } else { KILLS };
    let mut rows = Vec::new();
    for kind in KINDS {
        if let Some(why) = not_in_this_build(settings, kind) {
            rows.push(Row::impossible(kind.name, why));
            continue;
        }
        let runs = (0..settings.runs).map(|_| restarts_ms(&module(settings, kind), kills));
        let runs = runs.collect::<Result<Vec<Vec<f64>>>>()?;
        for (words, share, reach) in
            [("p50", 0.5, Reach::Stated), ("p99", 0.99, Reach::AtMost(kind.reach_ms))]
        {
            let of_each: Vec<f64> = runs.iter().filter_map(|run| quantile(run, share)).collect();
            let value = median(&of_each).context("no restart was seen")?;
            let about = "SIGKILL from outside to the first instruction of the successor's first window";
            rows.push(Row::measured(format!("{}, {words}", kind.name), "ms", value, None, reach, about));
        }
    }
    Ok(rows)
}

/// A way to start a successor.
struct Kind {
    name: &'static str,
    /// Keys of the partition.
    keys: &'static str,
    reach_ms: f64,
}

const KINDS: &[Kind] = &[
    Kind {
        name: "cold restart",
        keys: "restart = { start = \"cold\", budget = 1000, within = \"1s\", then = \"idle\" }\n\
               health = { killed = \"cold_restart\" }\n",
        reach_ms: 60.0,
    },
    Kind {
        name: "warm restart",
        keys: "restart = { start = \"warm\", budget = 1000, within = \"1s\", then = \"idle\" }\n\
               health = { killed = \"warm_restart\" }\nretained = \"16KiB\"\n",
        reach_ms: 60.0,
    },
    Kind {
        name: "hot standby",
        keys: "restart = { start = \"warm\", budget = 1000, within = \"1s\", then = \"idle\" }\n\
               health = { killed = \"warm_restart\" }\nretained = \"16KiB\"\nstandby = \"hot\"\n",
        // The next window, which is a frame away at most.
        reach_ms: FRAME_US as f64 / 1e3 + 1.0,
    },
];

/// Why the schedule of this kind is refused, if it is.
fn not_in_this_build(settings: &Settings, kind: &Kind) -> Option<String> {
    let refused = bateleur_executive_cli::plan_file::read_text("generated", &module(settings, kind)).err()?;
    let text = refused.render(false);
    Some(format!("the schedule file is refused: {}", text.lines().next().unwrap_or_default()))
}

fn module(settings: &Settings, kind: &Kind) -> String {
    let partitions =
        [victim(kind.keys, &[(2_000, 500)]), Sketched::new("neighbour", "touch", &[(4_000, 500)])];
    let there = Link { from: 0, to: 1 };
    let back = Link { from: 1, to: 0 };
    schedule(settings.core, FRAME_US, &partitions, &[there, there, back, back])
}

/// The partition that is killed; it says when module time began.
pub(super) fn victim(more: &str, windows: &[(u64, u64)]) -> Sketched {
    let plain = Sketched::new(VICTIM, "touch", windows);
    Sketched { attributes: format!("{}, says_origin = true", plain.attributes), more: more.into(), ..plain }
}

/// Kills the victim of a module `kills` times; how long it was gone each time, ms.
pub(super) fn restarts_ms(schedule: &str, kills: u64) -> Result<Vec<f64>> {
    let mut running = start(schedule, kills as f64 * 2.0 * PAUSE_MS as f64 / 1e3 + 1.0)?;
    if !running.await_windows() {
        running.end()?;
        bail!("the module did not begin");
    }
    let mut killed_ns = Vec::new();
    for number in 0..kills {
        // Phases spread over the frame: 7 and 20 have no common factor.
        std::thread::sleep(Duration::from_millis(PAUSE_MS + number * 7 % 20));
        killed_ns.extend(kill_victim(&running));
    }
    std::thread::sleep(Duration::from_millis(2 * PAUSE_MS));
    let _ = kill_process(pid_of(running.pid())?, Signal::INT); // it has ended already: its end says why
    let ended = running.end()?;
    let gone = gone_ms(&ended, &killed_ns)?;
    if gone.is_empty() {
        bail!("none of {kills} killed processes had a successor");
    }
    Ok(gone)
}

fn pid_of(number: i32) -> Result<Pid> {
    Pid::from_raw(number).context("a process without a number")
}

/// CLOCK_MONOTONIC of the kill; `None` if there is no such process right now.
fn kill_victim(running: &Running) -> Option<u64> {
    let children = probe::children(running.pid());
    let (pid, _) = children.iter().find(|(_, name)| name == VICTIM)?;
    let now = now_ns();
    kill_process(Pid::from_raw(*pid)?, Signal::KILL).ok().map(|()| now)
}

/// From each kill to the next window that the victim took.
fn gone_ms(ended: &Ended, killed_ns: &[u64]) -> Result<Vec<f64>> {
    let words = ended.words_of(VICTIM);
    let origin = words.lines().find_map(|line| line.strip_prefix("origin ")?.parse::<u64>().ok());
    let origin_ns = origin.context("the partition did not say when module time began")?;
    let opened: Vec<u64> = ended.of(VICTIM).filter_map(|line| Some(line.opened_ns? + origin_ns)).collect();
    let next = |killed: &u64| {
        opened.iter().find(|opened| *opened > killed).map(|opened| (opened - killed) as f64 / 1e6)
    };
    Ok(killed_ns.iter().filter_map(next).collect())
}
