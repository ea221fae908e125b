//! How far the major frames of a module begin beside those of the module that it follows: two modules on this machine, which
//! has one monotonic clock for both, so that the truth can be told from their logs.

use std::time::Duration;

use anyhow::{Context, Result, bail};

use super::Settings;
use super::module::{Ended, start_one};
use super::probe;
use super::row::{Reach, Row};
use super::statistics::{median, quantile};

/// The major frame of both modules, ms.
const FRAME_MS: u64 = 20;
/// Where the windows that are looked at lie in it, ms: that of the leader, that of the follower.
const OFFSETS_MS: [u64; 2] = [1, 12];
/// After that the follower has found the leader, s.
const SETTLING_S: f64 = 4.0;

/// The schedule file of both.
fn schedule(core: u32) -> String {
    let [leads, follows] = OFFSETS_MS;
    format!(
        r#"[network.a]
rate = "1Gbit/s"
latency = "1ms"

[module.bench_leader]
cores = [{core}]
addresses = {{ a = "127.0.0.1:15391" }}

[module.bench_follower]
cores = [{core}]
addresses = {{ a = "127.0.0.1:15392" }}
follows = "bench_leader"

[link.bench]
modules = ["bench_leader", "bench_follower"]
unauthenticated = true
gap = "1ms"

[partition.leading]
program = "bateleur_bench_partition"
module = "bench_leader"
memory = "64MiB"
attributes = {{ says_origin = true }}

[partition.leading.port]
out = {{ direction = "source", kind = "sampling", message = "Rates" }}

[partition.following]
program = "bateleur_bench_partition"
module = "bench_follower"
memory = "64MiB"
attributes = {{ says_origin = true }}

[partition.following.port]
in = {{ direction = "destination", kind = "sampling", message = "Rates", refresh = "1s" }}

[[channel]]
source = "leading.out"
destinations = ["following.in"]

[schedule.bench]
major_frame = "{FRAME_MS}ms"
minor_frame = "{FRAME_MS}ms"
window = [
  {{ partition = "leading", offset = "{leads}ms", duration = "1ms" }},
  {{ partition = "relay_bench_leader", offset = "3ms", duration = "1ms" }},
  {{ partition = "relay_bench_follower", offset = "8ms", duration = "1ms" }},
  {{ partition = "following", offset = "{follows}ms", duration = "1ms" }},
]
"#
    )
}

/// The error of the follower's major frame, beside what it costs to be woken by the clock.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let (mut errors, mut wakes) = (Vec::new(), Vec::new());
    for _ in 0..settings.runs {
        errors.push(errors_us(settings)?);
        wakes.push(probe::cyclic(settings.core, 1_000, Duration::from_secs_f64(settings.seconds / 2.0))?);
    }
    let over = |runs: &[Vec<f64>], share| {
        median(&runs.iter().filter_map(|samples| quantile(samples, share)).collect::<Vec<_>>())
    };
    let about =
        "clock_nanosleep(TIMER_ABSTIME) each millisecond on the same core at the dispatcher's priority";
    let rows = [("p50", 0.5, Reach::Stated), ("p99", 0.99, Reach::Times(3.0))];
    let row = |(words, share, reach)| {
        let value = over(&errors, share).context("no frame was compared")?;
        let name = format!("major frame beside that of the module that is followed, {words}");
        anyhow::Ok(Row::measured(name, "us", value, over(&wakes, share), reach, about))
    };
    rows.into_iter().map(row).collect()
}

/// How far each of the follower's frames begins beside one of the leader's, us.
fn errors_us(settings: &Settings) -> Result<Vec<f64>> {
    let (text, until_s) = (schedule(settings.core), SETTLING_S + settings.seconds);
    let leader = start_one(&text, Some("bench_leader"), until_s + 2.0)?;
    let follower = start_one(&text, Some("bench_follower"), until_s)?;
    let (follower, leader) = (follower.end()?, leader.end()?);
    let led = frames_ns(&leader, "leading", OFFSETS_MS[0])?;
    let own = frames_ns(&follower, "following", OFFSETS_MS[1])?;
    let settled_ns = own.first().context("the follower had no window")? + (SETTLING_S * 1e9) as i64;
    let frame_ns = (FRAME_MS * 1_000_000) as i64;
    let first_ns = *led.first().context("the leader had no window")?;
    // The leader's frames are all equally long: nobody moves them.
    let beside = |at_ns: i64| {
        let into = (at_ns - first_ns).rem_euclid(frame_ns);
        into.min(frame_ns - into) as f64 / 1e3
    };
    let errors: Vec<f64> = own.into_iter().filter(|at| *at > settled_ns).map(beside).collect();
    if errors.is_empty() {
        bail!("the follower had no frame after {SETTLING_S} s");
    }
    Ok(errors)
}

/// When the major frames began in which `partition` had its window, CLOCK_MONOTONIC, ns.
fn frames_ns(ended: &Ended, partition: &str, offset_ms: u64) -> Result<Vec<i64>> {
    let words = ended.words_of(partition);
    let origin = words.lines().find_map(|line| line.strip_prefix("origin ")?.parse::<i64>().ok());
    let origin_ns = origin.with_context(|| format!("{partition} did not say when its module began"))?;
    let began = |planned_ns: u64| origin_ns + planned_ns as i64 - (offset_ms * 1_000_000) as i64;
    Ok(ended.of(partition).map(|line| began(line.planned_start_ns)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_executive_cli::plan_file;

    #[test]
    fn generated_schedule_of_two_modules_breaks_no_rule() {
        let plan = plan_file::read_text("generated", &schedule(1)).map_err(|report| report.render(false));
        let plan = plan.unwrap();
        assert_eq!((plan.modules.len(), plan.links.len()), (2, 1));
        assert!(plan.module("bench_follower").is_some_and(|view| plan[view.id()].follows.is_some()));
    }
}
