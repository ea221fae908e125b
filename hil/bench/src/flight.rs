//! Figures of the flight itself: what its chain computes, how fast the virtual clock is, what the executive keeps in
//! memory.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_plan::Plan;
use rustix::process::{Pid, Signal, kill_process};

use super::Settings;
use super::module::{Line, read_windows, spawn};
use super::probe;
use super::row::{Reach, Row};
use super::statistics::{median, quantile};
use bateleur_executive_cli::plan_file;

/// Programs of the chain from the satellite receiver to the servos, in the order of their windows.
const CHAIN: [&str; 5] = ["gps", "imu", "estimator", "controller", "servo"];
/// What the thesis of 2015 measured for its chain: 13 ms of a 20 ms frame.
const THESIS_PERCENT: f64 = 65.0;
/// Longer than a flight takes to begin or to end.
const PATIENCE: Duration = Duration::from_secs(120);

/// A flight on the wall clock that is ended after a while.
struct Glimpse {
    windows: Vec<Line>,
    /// Resident memory of the executive's process, MiB.
    executive_mib: f64,
    /// Of its helpers beside it, shared pages divided among those who share them, MiB.
    helpers_mib: Option<f64>,
}

/// The chain's computing, and the executive's memory.
pub(super) fn wall(settings: &Settings) -> Result<Vec<Row>> {
    let plan = plan(settings)?;
    let names = CHAIN.map(|program| running(&plan, program));
    let names = names.into_iter().collect::<Result<Vec<String>>>()?;
    let glimpses: Vec<Glimpse> = (0..settings.runs).map(|_| glimpse(settings)).collect::<Result<_>>()?;
    let frame_us = plan.schedules.iter().find(|schedule| schedule.initial).or(plan.schedules.first());
    let frame_us = frame_us.context("the plan has no schedule")?.minor_frame_ns as f64 / 1e3;
    let mut rows = Vec::new();
    let about = "use of the windows of GPS, IMU, Estimator, Controller and Servo in one minor frame, summed; reference: the thesis's chain";
    for (words, share, reach) in [("p50", 0.5, Reach::Stated), ("p99", 0.99, Reach::AtMost(2.0))] {
        let of_each = glimpses.iter().filter_map(|one| quantile(&chain(one, &names, computing), share));
        let value =
            median(&of_each.collect::<Vec<_>>()).context("the chain had no windows")? / frame_us * 100.0;
        let name = format!("chain GPS to Servo, computing, {words}");
        rows.push(Row::measured(name, "% of the frame", value, Some(THESIS_PERCENT), reach, about));
    }
    let of_each = glimpses.iter().filter_map(|one| quantile(&chain(one, &names, end_to_end), 0.99));
    let value = median(&of_each.collect::<Vec<_>>()).context("the chain had no windows")? / frame_us * 100.0;
    let about = "first instruction of GPS to the end of Servo: mostly the schedule's offsets";
    let name = "chain GPS to Servo, end to end, p99";
    rows.push(Row::measured(name, "% of the frame", value, Some(THESIS_PERCENT), Reach::Stated, about));
    let memory: Vec<f64> = glimpses.iter().map(|one| one.executive_mib).collect();
    let about = format!(
        "resident memory of `bateleur run` with {} partitions, all of it locked",
        plan.partitions.len()
    );
    let value = median(&memory).context("no flight")?;
    rows.push(Row::measured("executive's memory", "MiB", value, None, Reach::AtMost(32.0), &about));
    let helpers: Vec<f64> = glimpses.iter().filter_map(|one| one.helpers_mib).collect();
    rows.push(match median(&helpers) {
        Some(value) => Row::measured(
            "memory of its helpers",
            "MiB",
            value,
            None,
            Reach::Stated,
            "channel holder, recorder and guard; shared pages divided among those who share them",
        ),
        None => Row::impossible("memory of its helpers", "this kernel does not add it up (smaps_rollup)"),
    });
    Ok(rows)
}

fn plan(settings: &Settings) -> Result<Plan> {
    let path = &settings.schedule;
    if !path.exists() {
        bail!(
            "there is no {} here: start in the repository, or name a flight's schedule with --schedule",
            path.display()
        );
    }
    match plan_file::read_among(path, None, false)? {
        Ok((plan, _)) => Ok(plan),
        Err(report) => bail!("{}", report.render(false)),
    }
}

/// The partition that runs a program.
fn running(plan: &Plan, program: &str) -> Result<String> {
    let found =
        plan.partitions.iter().find(|partition| partition.program.rsplit('/').next() == Some(program));
    found
        .map(|partition| partition.name.clone())
        .with_context(|| format!("no partition of the plan runs {program}"))
}

/// One value for each minor frame in which every partition of the chain closed its window.
fn chain(glimpse: &Glimpse, names: &[String], value: fn(&[&Line]) -> Option<f64>) -> Vec<f64> {
    let frames = glimpse.windows.chunk_by(|one, next| one.minor_frame == next.minor_frame);
    let links = frames.filter_map(|frame| {
        let links: Option<Vec<&Line>> =
            names.iter().map(|name| frame.iter().find(|line| line.partition == *name)).collect();
        value(&links?)
    });
    links.collect()
}

fn computing(links: &[&Line]) -> Option<f64> {
    links.iter().map(|line| line.use_us()).sum()
}

fn end_to_end(links: &[&Line]) -> Option<f64> {
    Some(links.last()?.closed_ns?.saturating_sub(links.first()?.opened_ns?) as f64 / 1e3)
}

fn glimpse(settings: &Settings) -> Result<Glimpse> {
    let folder = folder()?;
    let mut flight = fly(settings, folder.path(), &[])?;
    let seconds = if settings.quick { 2.0 } else { 3.0 * settings.seconds };
    let begun = Instant::now();
    while !folder.path().join("windows.csv").exists() && begun.elapsed() < PATIENCE && runs(&mut flight) {
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let memory = memory(flight.id() as i32);
    if let Some(pid) = Pid::from_raw(flight.id() as i32).filter(|_| runs(&mut flight)) {
        let _ = kill_process(pid, Signal::INT); // it ends as it does for a person
    }
    await_end(&mut flight)?;
    let (executive_mib, helpers_mib) = memory.context("the flight's executive was not found")?;
    Ok(Glimpse { windows: read_windows(&folder.path().join("windows.csv"))?, executive_mib, helpers_mib })
}

/// A folder that goes away.
fn folder() -> Result<tempfile::TempDir> {
    tempfile::Builder::new().prefix("bateleur-bench.").tempdir().context("cannot make a folder")
}

fn fly(settings: &Settings, folder: &Path, more: &[&str]) -> Result<Child> {
    let own = std::env::current_exe().context("cannot find this program")?;
    let mut command = Command::new(own);
    command.args(["fly", "--format", "json", "--seed", "7"]).args(more);
    command.arg("--schedule").arg(&settings.schedule).arg("--output").arg(folder);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    spawn(&mut command).context("cannot start `bateleur fly`")
}

fn runs(process: &mut Child) -> bool {
    process.try_wait().is_ok_and(|ended| ended.is_none())
}

fn await_end(process: &mut Child) -> Result<()> {
    let begun = Instant::now();
    while runs(process) {
        if begun.elapsed() > PATIENCE {
            let _ = process.kill(); // its executive ends when its line closes
            let _ = process.wait();
            bail!("a flight of the bench did not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// Memory of the executive below a flight, and of its helpers, MiB.
fn memory(flight: i32) -> Option<(f64, Option<f64>)> {
    let verb = |pid: i32| -> Option<String> {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
        line.split(|byte| *byte == 0).nth(1).map(|verb| String::from_utf8_lossy(verb).into_owned())
    };
    let below = |parent: i32, wanted: &str| -> Option<i32> {
        probe::children(parent).into_iter().find_map(|(pid, name)| (name == wanted).then_some(pid))
    };
    // A plan may put a supervisor above the executive.
    let supervisor = below(flight, "supervisor");
    let executive = below(supervisor.unwrap_or(flight), "bateleurd")?;
    let resident = kib(&format!("/proc/{executive}/status"), "VmRSS:")? / 1024.0;
    let is_helper = |pid: i32| matches!(verb(pid).as_deref(), Some("channel-holder" | "recorder" | "guard"));
    let helpers = probe::children(executive).into_iter().filter(|(pid, _)| is_helper(*pid));
    let shares: Option<Vec<f64>> = helpers
        .map(|(pid, _)| pid)
        .chain(supervisor)
        .map(|pid| kib(&format!("/proc/{pid}/smaps_rollup"), "Pss:"))
        .collect();
    Some((resident, shares.map(|shares| shares.iter().sum::<f64>() / 1024.0)))
}

fn kib(file: &str, key: &str) -> Option<f64> {
    let text = std::fs::read_to_string(file).ok()?;
    text.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().next()?.parse().ok())
}

/// Module time over real time on the virtual clock.
pub(super) fn fast(settings: &Settings) -> Result<Vec<Row>> {
    plan(settings)?;
    let (mut factors, mut alone) = (Vec::new(), Vec::new());
    for _ in 0..settings.runs {
        let folder = folder()?;
        let mut flight = fly(settings, folder.path(), &["--fast"])?;
        await_end(&mut flight)?;
        let text = std::fs::read_to_string(folder.path().join("summary.json"))
            .context("the flight left no summary")?;
        let summary: serde_json::Value = serde_json::from_str(&text).context("the flight's summary")?;
        factors.extend(summary["real_time_factor"].as_f64());
        let windows = read_windows(&folder.path().join("windows.csv"))?;
        let used_us: f64 = windows.iter().filter_map(Line::use_us).sum();
        let flown_us = windows.last().context("the flight had no windows")?.planned_end_ns as f64 / 1e3;
        alone.push(flown_us / used_us);
    }
    let value = median(&factors).context("the summary has no real_time_factor")?;
    let about =
        "the nine partitions' computing alone, as their windows took it, without the switches between them";
    let reach = Reach::AtLeast(100.0);
    Ok(vec![Row::measured("virtual clock, two laps", "times real time", value, median(&alone), reach, about)])
}
