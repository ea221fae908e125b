//! Figures of windows: when they start, what runs past their end, what a switch costs.

use std::time::Duration;

use anyhow::{Context, Result, bail};

use super::Settings;
use super::bare_switch;
use super::module::{Ended, start};
use super::probe;
use super::row::{Reach, Row};
use super::sketch::{Sketched, schedule};
use super::statistics::{median, quantile};

/// The frame of the module whose window starts are measured, us.
const FRAME_US: u64 = 3_000;

/// Samples of one run: of the module, of the loop that stands in for cyclictest.
struct Round {
    full: Vec<f64>,
    slack: Vec<f64>,
    overrun: Vec<f64>,
    cyclic: Vec<f64>,
    real: Option<Vec<f64>>,
}

/// Planned window start to the partition's first instruction.
pub(super) fn starts(settings: &Settings) -> Result<Vec<Row>> {
    let rounds = (0..settings.runs).map(|_| round(settings)).collect::<Result<Vec<_>>>()?;
    let loops: Vec<&Vec<f64>> = rounds.iter().map(|round| &round.cyclic).collect();
    let about =
        "clock_nanosleep(TIMER_ABSTIME) each millisecond on the same core at the dispatcher's priority";
    let mut rows = Vec::new();
    type Pick = fn(&Round) -> &Vec<f64>;
    let kinds: [(&str, Pick, Reach, Reach); 3] = [
        ("window start, window before full", |round| &round.full, Reach::Times(2.5), Reach::Times(3.0)),
        (
            "window start, window before closed early",
            |round| &round.slack,
            Reach::Times(1.2),
            Reach::Times(1.5),
        ),
        ("window start, window before overran", |round| &round.overrun, Reach::Stated, Reach::Stated),
    ];
    for (name, pick, reach_median, reach_rare) in kinds {
        let samples: Vec<&Vec<f64>> = rounds.iter().map(pick).collect();
        for (words, share, reach) in [("p50", 0.5, reach_median), ("p99.9", 0.999, reach_rare)] {
            let value = over_runs(&samples, share).context("no window was taken")?;
            let reference = over_runs(&loops, share);
            rows.push(Row::measured(format!("{name}, {words}"), "us", value, reference, reach, about));
        }
    }
    let real: Vec<&Vec<f64>> = rounds.iter().filter_map(|round| round.real.as_ref()).collect();
    if !real.is_empty() {
        for (words, share) in [("p50", 0.5), ("p99.9", 0.999)] {
            let value = over_runs(&real, share).context("cyclictest said nothing")?;
            let name = format!("cyclictest itself, {words}");
            rows.push(Row::measured(name, "us", value, over_runs(&loops, share), Reach::Stated, about));
        }
    }
    Ok(rows)
}

/// The median over the runs of a quantile of each run.
fn over_runs(runs: &[&Vec<f64>], share: f64) -> Option<f64> {
    let of_each: Vec<f64> = runs.iter().filter_map(|samples| quantile(samples, share)).collect();
    median(&of_each)
}

fn round(settings: &Settings) -> Result<Round> {
    let partitions = [
        Sketched::new("filler", "fill", &[(0, 800)]),
        Sketched::new("after_full", "touch", &[(800, 400)]),
        Sketched::new("after_slack", "touch", &[(1_200, 400)]),
    ];
    let text = schedule(settings.core, FRAME_US, &partitions, &[]);
    let ended = start(&text, settings.seconds)?.end()?;
    let overrunning = [
        Sketched {
            attributes: "does = \"spin\", frames = 20000".into(),
            threads: 8,
            ..Sketched::new("spinner", "spin", &[(0, 1_200)])
        },
        Sketched::new("after_overrun", "touch", &[(1_200, 400)]),
    ];
    let text = schedule(settings.core, FRAME_US, &overrunning, &[]);
    let overrun = start(&text, settings.seconds / 2.0)?.end()?;
    let cyclic = probe::cyclic(settings.core, 1_000, Duration::from_secs_f64(settings.seconds / 2.0))?;
    Ok(Round {
        full: starts_of(&ended, "after_full"),
        slack: starts_of(&ended, "after_slack"),
        overrun: starts_of(&overrun, "after_overrun"),
        cyclic,
        real: probe::cyclictest(settings.core, Duration::from_secs_f64(settings.seconds / 2.0)),
    })
}

fn starts_of(ended: &Ended, name: &str) -> Vec<f64> {
    ended.of(name).filter_map(super::module::Line::start_us).collect()
}

/// The frame and the window of the module whose fence is measured, us.
const FENCE_FRAME_US: u64 = 4_000;
const FENCE_WINDOW_US: u64 = 2_000;

/// What four spinning threads and a forked child do after their window's end.
pub(super) fn fence(settings: &Settings) -> Result<Vec<Row>> {
    let runs = (0..settings.runs).map(|_| past_end(settings)).collect::<Result<Vec<_>>>()?;
    let runs: Vec<&Vec<f64>> = runs.iter().collect();
    let about = "the last instant at which one of four spinning threads and a forked child ran, after the window's planned end";
    let row = |words: &str, share, reach| {
        let value = over_runs(&runs, share).context("the spinning partition told nothing")?;
        anyhow::Ok(Row::measured(
            format!("activity past the window's end, {words}"),
            "us",
            value,
            None,
            reach,
            about,
        ))
    };
    Ok(vec![row("p50", 0.5, Reach::AtMost(0.0))?, row("p99.9", 0.999, Reach::AtMost(20.0))?])
}

fn past_end(settings: &Settings) -> Result<Vec<f64>> {
    let frames = (settings.seconds * 1e6) as u64 / FENCE_FRAME_US;
    let spinner = Sketched {
        attributes: format!("does = \"spin\", frames = {frames}"),
        threads: 8,
        ..Sketched::new("spinner", "spin", &[(0, FENCE_WINDOW_US)])
    };
    let other = Sketched::new("neighbour", "touch", &[(FENCE_WINDOW_US, 500)]);
    let text = schedule(settings.core, FENCE_FRAME_US, &[spinner, other], &[]);
    let ended = start(&text, settings.seconds + 0.5)?.end()?;
    let words = ended.words_of("spinner");
    let Some(last) = words.lines().find_map(|line| line.strip_prefix("last ")) else {
        bail!("the spinning partition did not tell when it ran: {}", words.trim());
    };
    let instants = last.split(',').filter_map(|number| number.parse::<f64>().ok()).filter(|ns| *ns > 0.0);
    Ok(instants.map(|ns| ns / 1e3 - FENCE_WINDOW_US as f64).collect())
}

/// Windows of the module whose switches are counted: each touches the next and is full, so that nothing is spun away.
const SWITCHES: u64 = 8;
const SWITCH_WINDOW_US: u64 = 1_000;
const SWITCH_FRAME_US: u64 = 10_000;

/// The executive's processor time for each switch of windows.
pub(super) fn switches(settings: &Settings) -> Result<Vec<Row>> {
    let (mut whole, mut dispatcher, mut spun) = (Vec::new(), Vec::new(), Vec::new());
    let (mut futex, mut timer, mut bare) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..settings.runs {
        let partitions: Vec<Sketched> = (0..SWITCHES)
            .map(|number| {
                Sketched::new(format!("p{number}"), "fill", &[(number * SWITCH_WINDOW_US, SWITCH_WINDOW_US)])
            })
            .collect();
        let text = schedule(settings.core, SWITCH_FRAME_US, &partitions, &[]);
        let used =
            used_by_switches(&text, settings.seconds, SWITCHES as f64 / (SWITCH_FRAME_US as f64 / 1e6))?;
        whole.push(used.whole_us);
        dispatcher.extend(used.dispatcher_us);
        spun.push(used.spun_us);
        let (short, long) = if settings.quick { (100, 2_000) } else { (2_000, 20_000) };
        futex.push(probe::futex_switch(settings.core, long)?);
        timer.push(probe::timer_wake_us(settings.core, short)?);
        bare.push(bare_switch::switch_us(settings.core, short)?);
    }
    let reference = median(&futex);
    let about = "a futex wake and the switch to the woken thread on the same core, measured alone";
    let mut rows = Vec::new();
    let value = median(&whole).context("no run")?;
    rows.push(Row::measured(
        "executive's processor time per switch",
        "us",
        value,
        reference,
        Reach::Times(12.0),
        about,
    ));
    let value = median(&timer).context("no run")?;
    let alone = "one clock_nanosleep while a partition's thread spins: the least that being woken by the clock costs here";
    rows.push(Row::measured("a timer wake-up alone", "us", value, reference, Reach::Stated, alone));
    let value = median(&bare).context("no run")?;
    let steps = "a dispatcher of two bare threads: a wait with a limit, a wake, and a priority given and taken, without an executive";
    rows.push(Row::measured("the steps of a switch alone", "us", value, reference, Reach::Stated, steps));
    rows.push(match median(&dispatcher) {
        Some(value) => Row::measured(
            "dispatcher's processor time per switch",
            "us",
            value,
            reference,
            Reach::Stated,
            about,
        ),
        None => Row::impossible(
            "dispatcher's processor time per switch",
            "this kernel does not count it (schedstat)",
        ),
    });
    let value = median(&spun).context("no run")?;
    let held = "taken off the rows above: the dispatcher is awake before the instant where the window was closed early; nobody else has the processor then";
    rows.push(Row::measured("spun in slack per switch", "us", value, None, Reach::Stated, held));
    Ok(rows)
}

/// Processor time for each switch.
pub(super) struct Used {
    /// Of the executive's whole process, us.
    pub(super) whole_us: f64,
    /// Of its dispatcher threads, us; `None`: not counted here.
    pub(super) dispatcher_us: Option<f64>,
    /// What the dispatcher held the processor for in slack beside both, us.
    pub(super) spun_us: f64,
}

/// Runs a module for `seconds` and counts what its `switches_per_s` cost in between. The time that a dispatcher spins in
/// slack is taken off: nobody else has use for it, and it depends on the partitions.
pub(super) fn used_by_switches(schedule: &str, seconds: f64, switches_per_s: f64) -> Result<Used> {
    let mut running = start(schedule, seconds + 1.0)?;
    if !running.await_windows() {
        running.end()?;
        bail!("the module did not begin");
    }
    std::thread::sleep(Duration::from_millis(300));
    let look = |pid| {
        let whole = probe::processor_time_us(pid).context("the executive has ended")?;
        anyhow::Ok((std::time::Instant::now(), whole, probe::thread_time_us(pid, "dispatch")))
    };
    let before = look(running.pid())?;
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let after = look(running.pid())?;
    let ended = running.end()?;
    let windows = ended.windows.iter().filter(|line| line.opened_ns.is_some()).count().max(1);
    let spun_us = ended.spun_s * 1e6 / windows as f64;
    let switches = (after.0 - before.0).as_secs_f64() * switches_per_s;
    let each = |before: f64, after: f64| (after - before) / switches - spun_us;
    let dispatcher_us = before.2.zip(after.2).map(|(before, after)| each(before, after));
    Ok(Used { whole_us: each(before.1, after.1), dispatcher_us, spun_us })
}
