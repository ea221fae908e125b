//! `bateleur crash`: how partitions of a run ended by faults: the signal, the function and line that it hit, who had called it, registers,
//! and what the partition did last: its windows, and the last messages of its ports where the run was recorded.
//!
//! A partition that is about to end by SIGSEGV, SIGBUS, SIGILL, SIGFPE, an abort or a panic writes down where it is; a helper makes a report
//! and a minidump of that, in the folder `crashes` of the run. SIGKILL leaves none, and neither does a system call that a filter forbids: such
//! deaths are told from the health log. Exit codes: 0 it was read, 1 a report is damaged, 2 it could not be read.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_crash::{CrashReport, Frame, MOST_BYTES, Word};
use bateleur_host::helper::crash::{DUMP, FOLDER, MOST_OF_A_PARTITION, REPORT};
use bateleur_monitor::health::record::Entry;
use bateleur_monitor::health::ring;
use bateleur_recording::windows::{self, Window};
use bateleur_recording::{PORTS_FILE, for_each};
use serde::Serialize;

use super::notes::file_of;
use super::{Code, FINE, Format, WRONG};
use crate::installed;

/// Say how partitions of a run ended by faults, with function and line.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of a run [default: target/runs/latest].
    #[arg(value_name = "RUN")]
    run: Option<PathBuf>,
    /// Only this partition.
    #[arg(value_name = "PARTITION")]
    partition: Option<String>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// Windows and messages of a partition that are shown.
const LAST_WINDOWS: usize = 5;
/// Bytes of a message that are shown.
const SHOWN_BYTES: usize = 32;
/// Functions of the stack that are shown as text.
const SHOWN_FRAMES: usize = 32;
/// Errors of the health tables that end a process.
const DEATHS: [&str; 9] = [
    "memory_violation",
    "numeric_error",
    "illegal_request",
    "stack_overflow",
    "memory_limit",
    "hardware_fault",
    "killed",
    "exit",
    "startup_timeout",
];

/// What is known of a run's deaths.
#[derive(Debug, Default, Serialize)]
struct Deaths {
    /// Those with a report.
    reports: Vec<Told>,
    /// Those without.
    without: Vec<Without>,
}

#[derive(Debug, Serialize)]
struct Told {
    #[serde(flatten)]
    report: CrashReport,
    /// The minidump's file in the run's folder.
    minidump: Option<String>,
    /// The partition's last windows, oldest first.
    windows: Vec<LastWindow>,
    /// The last message of each of its ports.
    messages: Vec<LastMessage>,
}

#[derive(Debug, Serialize)]
struct LastWindow {
    frame: u64,
    core: u32,
    planned_start_ns: u64,
    planned_end_ns: u64,
    closed: bool,
    flags: String,
}

#[derive(Debug, Clone, Serialize)]
struct LastMessage {
    port: String,
    source: String,
    time_ns: u64,
    sequence: u32,
    bytes: usize,
    /// The first of its bytes, in hexadecimal digits.
    begins: String,
}

#[derive(Debug, Serialize)]
struct Without {
    partition: String,
    generation: u32,
    time_ns: u64,
    error: String,
    detail: String,
    /// Why there is no report.
    why: String,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let folder = arguments.run.clone().unwrap_or_else(installed::latest_run);
    if !folder.is_dir() {
        bail!("{} is no folder of a run (such as one below target/flights)", folder.display());
    }
    let health = file_of(Some(&folder), ring::FILE)?;
    let wanted = |name: &str| arguments.partition.as_deref().is_none_or(|partition| partition == name);
    let (mut reports, damaged) = read_reports(&folder)?;
    reports.retain(|told| wanted(&told.report.death.partition));
    add_windows(&folder, &mut reports);
    add_messages(&folder, &mut reports);
    let without = ring::read_file(&health).map_or_else(
        |_| Vec::new(),
        |log| {
            let entries = log.entries.iter().filter(|entry| wanted(&entry.partition));
            without_report(entries, &reports)
        },
    );
    let deaths = Deaths { reports, without };
    match arguments.format {
        Format::Json => println!("{}", serde_json::to_string_pretty(&deaths)?),
        Format::Text => print!("{}", text(&deaths)),
    }
    for (path, why) in &damaged {
        eprintln!("{}: {why}", path.display());
    }
    Ok(if damaged.is_empty() { FINE } else { WRONG })
}

/// A file that is no report, and why.
type Damaged = (PathBuf, String);

/// The reports in the order of time, and what is none.
fn read_reports(run: &Path) -> Result<(Vec<Told>, Vec<Damaged>)> {
    let folder = run.join(FOLDER);
    let (mut reports, mut damaged) = (Vec::new(), Vec::new());
    let files = match std::fs::read_dir(&folder) {
        Ok(files) => files,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok((reports, damaged)),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", folder.display())),
    };
    for path in files.flatten().map(|file| file.path()) {
        if path.extension().is_none_or(|end| end != REPORT) {
            continue;
        }
        match read_report(&path) {
            Ok(report) => {
                let dump = path.with_extension(DUMP);
                let is_there = dump.metadata().is_ok_and(|about| about.len() > 0);
                let name = dump.file_name().map(|name| format!("{FOLDER}/{}", name.to_string_lossy()));
                reports.push(Told {
                    report,
                    minidump: name.filter(|_| is_there),
                    windows: Vec::new(),
                    messages: Vec::new(),
                });
            }
            Err(why) => damaged.push((path, why)),
        }
    }
    reports.sort_by(|one, other| {
        let key = |told: &Told| (told.report.death.time_ns, told.report.death.partition.clone());
        key(one).cmp(&key(other))
    });
    Ok((reports, damaged))
}

fn read_report(path: &Path) -> Result<CrashReport, String> {
    let about = path.metadata().map_err(|error| error.to_string())?;
    match about.len() {
        0 => {
            return Err(
                "it is empty: its reader is still at work, or has ended early (partitions/helpers.log)"
                    .into(),
            );
        }
        bytes if bytes > MOST_BYTES => return Err("it is longer than any report".into()),
        _ => {}
    }
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    serde_json::from_str(&text).map_err(|error| format!("it is damaged: {error}"))
}

/// A run that was cut off early has no such file; then there are no windows to show.
fn add_windows(run: &Path, reports: &mut [Told]) {
    if reports.is_empty() {
        return;
    }
    let _ = windows::for_each(&run.join(windows::FILE), |window| {
        for told in reports.iter_mut() {
            let death = &told.report.death;
            if window.partition == death.partition && window.planned_start_ns <= death.time_ns {
                if told.windows.len() == LAST_WINDOWS {
                    told.windows.remove(0);
                }
                told.windows.push(LastWindow::of(&window));
            }
        }
    });
}

impl LastWindow {
    fn of(window: &Window) -> Self {
        Self {
            frame: window.frame,
            core: window.core,
            planned_start_ns: window.planned_start_ns,
            planned_end_ns: window.planned_end_ns,
            closed: window.closed_ns.is_some(),
            flags: window.flags.clone(),
        }
    }
}

/// From the recording, where there is one.
fn add_messages(run: &Path, reports: &mut [Told]) {
    let log = run.join(PORTS_FILE);
    if reports.is_empty() || !log.exists() {
        return;
    }
    let mut found: Vec<BTreeMap<String, LastMessage>> = vec![BTreeMap::new(); reports.len()];
    let _ = for_each(&log, |entry| {
        let source = entry.topic.trim_start_matches('/').replacen('/', ".", 1);
        for (told, found) in reports.iter().zip(&mut found) {
            if entry.time_ns > told.report.death.time_ns {
                continue;
            }
            for port in told.report.death.ports.iter().filter(|port| port.source == source) {
                let begins = entry.bytes.iter().take(SHOWN_BYTES).map(|byte| format!("{byte:02x}"));
                let message = LastMessage {
                    port: port.name.clone(),
                    source: source.clone(),
                    time_ns: entry.time_ns,
                    sequence: entry.sequence,
                    bytes: entry.bytes.len(),
                    begins: begins.collect(),
                };
                found.insert(port.name.clone(), message);
            }
        }
    });
    for (told, found) in reports.iter_mut().zip(found) {
        told.messages = found.into_values().collect();
    }
}

/// Deaths of the health log that have no report.
fn without_report<'a>(entries: impl Iterator<Item = &'a Entry>, reports: &[Told]) -> Vec<Without> {
    let of =
        |entry: &Entry| reports.iter().filter(|told| told.report.death.partition == entry.partition).count();
    let has_report = |entry: &Entry| {
        reports.iter().any(|told| {
            let death = &told.report.death;
            death.partition == entry.partition && death.time_ns == entry.time_ns && death.error == entry.error
        })
    };
    let deaths = entries.filter(|entry| {
        DEATHS.contains(&entry.error.as_str()) && entry.action != "error_handler" && !has_report(entry)
    });
    deaths
        .map(|entry| Without {
            partition: entry.partition.clone(),
            generation: entry.generation,
            time_ns: entry.time_ns,
            error: entry.error.clone(),
            detail: entry.detail.clone(),
            why: why_none(entry, of(entry) >= MOST_OF_A_PARTITION as usize),
        })
        .collect()
}

fn why_none(entry: &Entry, enough: bool) -> String {
    let detail = entry.detail.as_str();
    if detail.contains("SIGKILL") || detail.starts_with("ended by the kernel") {
        "SIGKILL ends a process before it can write anything down".into()
    } else if detail.contains("SIGSYS") {
        "a forbidden system call ends a process before it can write anything down".into()
    } else if enough {
        format!("{MOST_OF_A_PARTITION} reports of a partition are kept, the first ones")
    } else if entry.error == "exit" && !detail.starts_with("aborted") && !detail.starts_with("panicked") {
        "it ended by itself".into()
    } else {
        "it had written nothing down".into()
    }
}

fn text(deaths: &Deaths) -> String {
    let Deaths { reports, without } = deaths;
    if reports.is_empty() && without.is_empty() {
        return "no partition ended by a fault\n".into();
    }
    let mut text = String::new();
    for told in reports {
        if !text.is_empty() {
            text.push('\n');
        }
        let _ = write_report(&mut text, told); // a text takes everything
    }
    if !without.is_empty() && !text.is_empty() {
        text.push('\n');
    }
    for death in without {
        let Without { partition, generation, error, detail, why, .. } = death;
        let _ = writeln!(
            text,
            "{:>11.3} s  {partition} (incarnation {generation}): {error}, {}. No report: {why}",
            seconds(death.time_ns),
            plain(detail)
        );
    }
    text
}

fn write_report(text: &mut String, told: &Told) -> std::fmt::Result {
    let report = &told.report;
    let death = &report.death;
    writeln!(
        text,
        "{:>11.3} s  {} (incarnation {}): {}, {}",
        seconds(death.time_ns),
        death.partition,
        death.generation,
        death.error,
        plain(&death.detail)
    )?;
    let reason = report.reason.as_ref().map_or_else(String::new, |reason| format!(" ({reason})"));
    let address =
        report.address.map_or_else(String::new, |Word(address)| format!(" at address {address:#x}"));
    let thread = match (&report.process, report.main_thread) {
        (Some(process), _) => format!("process {}", plain(process)),
        (None, true) => "the main thread".into(),
        (None, false) => format!("thread {}", report.thread),
    };
    writeln!(text, "  {}{reason}{address} in {thread}", report.signal)?;
    match &report.backtrace {
        None => writeln!(text, "  the stack was not looked into: its reader is at work, or has ended early")?,
        Some(frames) => write_frames(text, frames)?,
    }
    let registers = report.registers.iter().filter(|(_, value)| value.0 != 0);
    let registers: Vec<String> = registers.map(|(name, value)| format!("{name} {:#x}", value.0)).collect();
    for line in registers.chunks(4) {
        writeln!(text, "  {}", line.join("  "))?;
    }
    for window in &told.windows {
        let closed = if window.closed { "closed" } else { "not closed" };
        let flags = if window.flags.is_empty() { String::new() } else { format!(" ({})", window.flags) };
        let (from, core) = (seconds(window.planned_start_ns), window.core);
        writeln!(text, "  window at {from:.3} s on core {core}, {closed}{flags}")?;
    }
    for message in &told.messages {
        let LastMessage { port, source, sequence, bytes, begins, .. } = message;
        let (time, rest) = (seconds(message.time_ns), if *bytes > SHOWN_BYTES { "…" } else { "" });
        writeln!(
            text,
            "  port {port}: number {sequence} of {source} at {time:.3} s, {bytes} bytes {begins}{rest}"
        )?;
    }
    if let Some(dump) = &told.minidump {
        writeln!(text, "  minidump: {dump}")?;
    }
    Ok(())
}

fn write_frames(text: &mut String, frames: &[Frame]) -> std::fmt::Result {
    let own: Vec<&Frame> = frames.iter().filter(|frame| !frame.runtime).collect();
    for frame in own.iter().take(SHOWN_FRAMES) {
        let function = frame.function.as_deref().map_or_else(|| unknown(frame), plain);
        let place = match (&frame.file, frame.line) {
            (Some(file), Some(line)) => format!("  {}:{line}", plain(file)),
            (Some(file), None) => format!("  {}", plain(file)),
            _ => String::new(),
        };
        writeln!(text, "    {function}{place}")?;
    }
    if own.len() > SHOWN_FRAMES {
        writeln!(text, "    and {} more", own.len() - SHOWN_FRAMES)?;
    }
    Ok(())
}

/// A function without a name.
fn unknown(frame: &Frame) -> String {
    match (&frame.module, frame.offset) {
        (Some(module), Some(offset)) => format!("{}+{offset:#x}", plain(module)),
        (Some(module), None) => format!("{:#x} in {}", frame.address, plain(module)),
        (None, _) => format!("{:#x}, where no program is", frame.address),
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

/// Without the control characters that a terminal would obey.
fn plain(text: &str) -> String {
    text.replace(char::is_control, "\u{fffd}")
}
