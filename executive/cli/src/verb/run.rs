//! `bateleur run`: runs one module of a schedule file until Ctrl-C, SIGTERM, a partition's stop, or `--until`.
//!
//! Says at its start what this machine can not promise; writes `windows.csv`, `health.jsonl` and the partitions'
//! standard error into `--output`. Leaves nothing behind, however it ends. Exit codes: 0 it ran and was stopped,
//! 1 an error of the module ended it, by the table `[health.module]`, or a log could not be written, 2 it could not run.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::net::SocketAddr;
use std::os::fd::{FromRawFd, OwnedFd, RawFd};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, anyhow};
use bateleur_contract::Clock;
use bateleur_daemon::module::{Options, run as run_module};
use bateleur_daemon::world::Companion;
use bateleur_monitor::event::{Event, Events};
use bateleur_time::shared_clock::SharedClock;
use rustix::fs::{FlockOperation, flock};

use super::air::module_time;
use super::faults::Faults;
use super::{CANNOT_RUN, Code, FINE, WRONG};
use crate::plan_file;

/// The supply is going: what a machine's guard sends to whoever shall save what it can. The same number on x86-64 and aarch64.
const SIGPWR: i32 = 30;
/// Where a run writes that was not told otherwise.
const LATEST: &str = "target/runs/latest";

/// Run a module of a schedule file.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The schedule file.
    #[arg(long, short, default_value = "schedule.toml")]
    pub(crate) schedule: PathBuf,
    /// The module to run; may be left out where the file has one.
    #[arg(long, short)]
    pub(crate) module: Option<String>,
    /// Folder for logs; the default is target/runs/latest, which every run writes over that finds no other at it.
    #[arg(long, short)]
    pub(crate) output: Option<PathBuf>,
    /// Run on the virtual clock: as fast as the machine can.
    #[arg(long)]
    pub(crate) fast: bool,
    /// Share the virtual clock with other modules on this machine, through this file: their windows come in one order, the
    /// same in every run. The first module makes the file, the last removes it.
    #[arg(long, value_name = "FILE", requires = "fast", requires = "place")]
    pub(crate) together: Option<PathBuf>,
    /// This module's place among those that share the virtual clock, and how many they are, such as 0/2; of windows at one
    /// instant the lower place comes first.
    #[arg(long, value_name = "PLACE/COUNT", requires = "together", value_parser = parse_place)]
    pub(crate) place: Option<(usize, usize)>,
    /// Its process was killed and this is the next: the module time at which its windows begin again, ns.
    #[arg(long, hide = true, value_name = "NANOSECONDS", requires = "together")]
    pub(crate) back_at: Option<u64>,
    /// End at this module time, seconds.
    #[arg(long, value_name = "SECONDS", value_parser = module_time, allow_negative_numbers = true)]
    pub(crate) until: Option<f64>,
    /// Replace an attribute of the plan.
    #[arg(long, value_name = "PARTITION.ATTRIBUTE=VALUE", value_parser = parse_setting)]
    pub(crate) set: Vec<Setting>,
    /// Take the key of a link from another file than the plan's; relative to the schedule file.
    #[arg(long, value_name = "LINK=FILE", value_parser = parse_key)]
    pub(crate) key: Vec<(String, PathBuf)>,
    /// Use another address in place of one of the plan's, for this module and its peers.
    #[arg(long, value_name = "PLANNED=OTHER", value_parser = parse_address)]
    pub(crate) address: Vec<(SocketAddr, SocketAddr)>,
    #[command(flatten)]
    pub(crate) faults: Faults,
    /// Refuse to start where this machine lacks something.
    #[arg(long, value_name = "HOW", value_parser = ["strict"])]
    pub(crate) require: Option<String>,
    /// Write every message of every port into ports.mcap.
    #[arg(long)]
    pub(crate) record: bool,
    /// Stop when standard input closes.
    #[arg(long)]
    until_stdin_closes: bool,
    /// Descriptor for events, one JSON object a line.
    #[arg(long, hide = true)]
    events_fd: Option<RawFd>,
    /// Descriptor of the socket to whoever holds the other end of a partition's line under the virtual clock.
    #[arg(long, hide = true)]
    companion_fd: Option<RawFd>,
}

/// One `--set`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Setting {
    pub(crate) partition: String,
    pub(crate) attribute: String,
    pub(crate) value: serde_json::Value,
}

pub(crate) fn parse_setting(text: &str) -> Result<Setting, String> {
    let wrong = || format!("\"{text}\" is not PARTITION.ATTRIBUTE=VALUE, such as controller.laps=3");
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let (partition, attribute) = name.split_once('.').ok_or_else(wrong)?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    Ok(Setting { partition: partition.into(), attribute: attribute.into(), value })
}

fn parse_key(text: &str) -> Result<(String, PathBuf), String> {
    let wrong = || format!("\"{text}\" is not LINK=FILE, such as nav=keys/nav.key");
    text.split_once('=').map(|(link, file)| (link.to_owned(), PathBuf::from(file))).ok_or_else(wrong)
}

fn parse_address(text: &str) -> Result<(SocketAddr, SocketAddr), String> {
    let addresses =
        text.split_once('=').and_then(|(one, other)| Some((one.parse().ok()?, other.parse().ok()?)));
    addresses
        .ok_or_else(|| format!("\"{text}\" is not PLANNED=OTHER, such as 10.77.0.1:15300=127.0.0.1:15300"))
}

/// A module's place among several, and their count.
fn parse_place(text: &str) -> Result<(usize, usize), String> {
    let numbers =
        text.split_once('/').and_then(|(place, count)| Some((place.parse().ok()?, count.parse().ok()?)));
    numbers.ok_or_else(|| format!("\"{text}\" is not PLACE/COUNT, such as 0/2 for the first of two modules"))
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    // Whoever started it with a channel for events has read the file too, and said so.
    let read = if arguments.events_fd.is_some() { plan_file::read_quietly } else { plan_file::read_or_say };
    let Some(plan) = read(&arguments.schedule)? else { return Ok(CANNOT_RUN) };
    let module = match (&arguments.module, plan.modules.as_slice()) {
        (Some(name), _) => name.clone(),
        (None, [only]) => only.name.clone(),
        (None, several) => {
            let names: Vec<_> = several.iter().map(|module| module.name.as_str()).collect();
            return Err(anyhow!(
                "the plan has several modules: choose one with --module ({}); `bateleur fly --hosts` starts all of them",
                names.join(", ")
            ));
        }
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    if arguments.until_stdin_closes {
        stop_with_standard_input(stop.clone());
    }
    let power_fail = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGPWR, power_fail.clone()).context("cannot watch for signals")?;
    let (folder, _alone) = folder(arguments)?;
    let outcome = run_module(plan, options(arguments, module, &folder, stop, power_fail)?)?;
    if arguments.events_fd.is_none() {
        let missed = arguments.faults.not_reached(outcome.module_ns as f64 / 1e9);
        missed.iter().for_each(|line| eprintln!("{line}"));
    }
    Ok(if outcome.faulty || outcome.logs_lost || outcome.left_behind { WRONG } else { FINE })
}

/// The folder for logs, made where it is missing, and what keeps other runs out of it as long as it is kept.
fn folder(arguments: &Arguments) -> Result<(PathBuf, File)> {
    let folder = match &arguments.output {
        Some(folder) => {
            crate::output::refuse_used(folder)?;
            folder.clone()
        }
        None => PathBuf::from(LATEST),
    };
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let alone =
        File::open(&folder).with_context(|| format!("cannot open the folder {}", folder.display()))?;
    if flock(&alone, FlockOperation::NonBlockingLockExclusive).is_err() {
        return Err(anyhow!(
            "another run writes into {}: wait for its end, or name another folder with --output",
            folder.display()
        ));
    }
    Ok((folder, alone))
}

fn options(
    arguments: &Arguments,
    module: String,
    folder: &Path,
    stop: Arc<AtomicBool>,
    power_fail: Arc<AtomicBool>,
) -> Result<Options> {
    let mut overrides: BTreeMap<String, BTreeMap<String, serde_json::Value>> = BTreeMap::new();
    for setting in &arguments.set {
        overrides
            .entry(setting.partition.clone())
            .or_default()
            .insert(setting.attribute.clone(), setting.value.clone());
    }
    let plan_folder = arguments.schedule.parent().map(Path::to_owned).unwrap_or_default();
    let nanoseconds = |seconds: f64| (seconds * 1e9) as u64;
    Ok(Options {
        module,
        clock: if arguments.fast { Clock::Virtual } else { Clock::Wall },
        output: folder.to_owned(),
        plan_folder: plan_folder.clone(),
        key_files: arguments.key.iter().map(|(link, file)| (link.clone(), plan_folder.join(file))).collect(),
        addresses: arguments.address.iter().copied().collect(),
        link_keys: Vec::new(),
        overrides,
        acts: arguments.faults.planned(),
        killings: arguments.faults.killings(),
        schedule_changes: arguments.faults.schedule_changes(),
        together: arguments.together.clone().zip(arguments.place).map(|(file, (place, count))| SharedClock {
            file,
            place,
            count,
            back_ns: arguments.back_at,
        }),
        until_ns: arguments.until.map(nanoseconds),
        strict: arguments.require.is_some(),
        record: arguments.record.then(|| folder.join("ports.mcap")),
        companion: arguments.companion_fd.map(companion).transpose()?,
        events: Events::new(Some(events(arguments.events_fd))),
        stop,
        power_fail,
    })
}

#[allow(unsafe_code)]
fn inherited(descriptor: RawFd) -> OwnedFd {
    // SAFETY: the caller of this program passed the descriptor for this purpose; each is taken once.
    unsafe { OwnedFd::from_raw_fd(descriptor) }
}

fn companion(descriptor: RawFd) -> Result<Companion> {
    Companion::new(UnixStream::from(inherited(descriptor))).context("the companion's socket can not be used")
}

/// Events for a program, or for a person.
fn events(descriptor: Option<RawFd>) -> Box<dyn Write + Send> {
    match descriptor {
        Some(descriptor) => Box::new(File::from(inherited(descriptor))),
        None => Box::new(Person),
    }
}

pub(crate) fn stop_with_standard_input(stop: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // closed either way
        stop.store(true, Ordering::Release);
    });
}

/// Turns events into lines for a terminal.
struct Person;

impl Write for Person {
    fn write(&mut self, line: &[u8]) -> std::io::Result<usize> {
        if let Ok(event) = serde_json::from_slice::<Event>(line) {
            say(&event);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// What helps whoever runs the module by hand without a line to the ground.
const GROUND_HINT: &str =
    "\n             (a line without a radio: docs/src/three-terminals.md, or `cargo fly`, which makes one)";

/// One event as a line for a person. A terminal or a pipe that is gone must not end the flight.
pub(crate) fn say(event: &Event) {
    let text = text_of(event);
    if !text.is_empty() {
        let _ = writeln!(std::io::stderr(), "{text}"); // nobody reads
    }
}

fn text_of(event: &Event) -> String {
    match event {
        Event::Guarantees { list } => {
            let lacking = list.iter().filter(|guarantee| !guarantee.held);
            let lines: Vec<_> = lacking
                .map(|lack| format!("not on this machine: {} ({})", lack.promise, lack.detail))
                .collect();
            lines.join("\n")
        }
        Event::Ready { partitions } => format!("{partitions} partitions are ready"),
        Event::Fault { time_s, partition, error, action, detail } => {
            let line = format!("{time_s:9.3} s  {partition}: {error} ({}) -> {action}", printable(detail));
            let lacks_line = detail.starts_with("ground link") && !detail.contains("is gone");
            if lacks_line { line + GROUND_HINT } else { line }
        }
        Event::ModuleFault { time_s, error, action, detail } => {
            format!("{time_s:9.3} s  module: {error} ({}) -> {action}", printable(detail))
        }
        Event::ModuleRestarted { time_s, after_ms } => {
            format!("{time_s:9.3} s  module: frame 0 again after {after_ms:.1} ms")
        }
        Event::Recovered { time_s, partition, after_ms } => {
            format!("{time_s:9.3} s  {partition}: back after {after_ms:.1} ms")
        }
        Event::Message { time_s, partition, text } | Event::Undone { time_s, partition, text } => {
            format!("{time_s:9.3} s  {partition}: {}", printable(text))
        }
        Event::ScheduleRequested { time_s, schedule, by } => {
            format!("{time_s:9.3} s  {by}: asks for schedule {schedule}")
        }
        Event::ScheduleChanged { time_s, schedule, before } => {
            format!("{time_s:9.3} s  schedule {schedule} after {before}")
        }
        Event::LogLost { time_s, log, reason } => {
            format!("{time_s:9.3} s  {log} can not be written any more: {}", printable(reason))
        }
        Event::LogCut { time_s, log, reason } => format!("{time_s:9.3} s  {log} ends: {}", printable(reason)),
        Event::LogLacks { time_s, log, reason } => format!("{time_s:9.3} s  {log}: {}", printable(reason)),
        Event::Stopped {
            reason,
            module_time_s,
            windows,
            late_windows,
            window_overruns,
            lost_records,
            lost_windows,
            unwritten_records,
            ..
        } => {
            let mut lost = String::new();
            if *lost_windows > 0 {
                lost = format!(", {lost_windows} lost because the dispatcher came too late");
            }
            if *lost_records > 0 {
                lost += &format!("\n{lost_records} window records were lost: the log could not keep up");
            }
            if *unwritten_records > 0 {
                lost +=
                    &format!("\n{unwritten_records} records are missing in logs that could not be written");
            }
            format!(
                "stopped after {module_time_s:.2} s: {reason}; {windows} windows, {late_windows} late, {window_overruns} overrun{lost}"
            )
        }
    }
}

/// A partition's words without the control characters that a terminal would obey.
fn printable(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { '\u{fffd}' } else { letter }).collect()
}
