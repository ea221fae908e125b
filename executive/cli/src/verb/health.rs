//! `bateleur health`: what the health monitor noted, from the persistent log `health.ring` of a run: time, frame,
//! partition and incarnation, error, action, and what is known beside it.
//!
//! Takes the file or the folder of a run. Reads a log that was cut off, or that is being written, as far as its records are
//! whole, and says how many are not. Exit codes: 0 it was read, 1 it was read and some records are damaged, 2 it could not be
//! read.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use bateleur_monitor::health::record::{Contents, Entry};
use bateleur_monitor::health::ring::{FILE, read_file};
use bateleur_plan::LogPolicy;

use super::notes::{Notes, file_of};
use super::{Code, FINE, Format, WRONG};

/// Read the health log of a run.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of a run, or the file itself [default: target/runs/latest].
    #[arg(value_name = "FOLDER|FILE")]
    path: Option<PathBuf>,
    #[command(flatten)]
    notes: Notes,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let notes = &arguments.notes;
    let path = file_of(arguments.path.as_deref(), FILE)?;
    // First of all, so that the system says what is wrong with a path.
    let read = std::fs::metadata(&path).and_then(|_| read_file(&path));
    let mut log = read.with_context(|| {
        format!("cannot read {} (name the folder of a run, such as one below target/flights)", path.display())
    })?;
    let full = log.is_full();
    let about = about(&log);
    notes.choose(&mut log.entries, |entry| &entry.partition);
    let text = match notes.format {
        Format::Json => serde_json::to_string_pretty(&log)? + "\n",
        Format::Text => match &notes.partition {
            Some(name) if log.entries.is_empty() => {
                format!("nothing was noted about a partition {name}; entries are {about}\n")
            }
            _ => table(&log, full),
        },
    };
    print!("{text}");
    Ok(if log.damaged == 0 { FINE } else { WRONG })
}

/// Whom the entries of a log are about, in words.
fn about(log: &Contents) -> String {
    let names: BTreeSet<&str> = log.entries.iter().map(|entry| entry.partition.as_str()).collect();
    let names: Vec<&str> = names.into_iter().filter(|name| !name.is_empty()).collect();
    match names.as_slice() {
        [] => "about the module alone".into(),
        names => format!("about {}", names.join(", ")),
    }
}

fn table(log: &Contents, full: bool) -> String {
    let mut text = String::new();
    log.entries.iter().for_each(|entry| text.push_str(&line(entry)));
    if log.entries.is_empty() {
        text.push_str("nothing was noted\n");
    }
    if log.policy == LogPolicy::Keep && full {
        text.push_str("the log is full and keeps what it has: later entries were dropped\n");
    }
    if log.overwritten > 0 {
        let _ = writeln!(text, "{} older records were written over", log.overwritten);
    }
    if log.damaged > 0 {
        let _ = writeln!(text, "{} records are damaged or were cut off", log.damaged);
    }
    text
}

fn line(entry: &Entry) -> String {
    let Entry { error, action, detail, .. } = entry;
    let what = format!("{error}{}", in_brackets(detail));
    if error == "module_start" {
        return format!("--- a run began{}\n", in_brackets(detail));
    }
    let whom = match entry.partition.is_empty() {
        true => "module".into(),
        false => format!("{}[{}]", entry.partition, entry.generation),
    };
    let then = if action.is_empty() { String::new() } else { format!(" -> {action}") };
    format!("{:>11.3} s  frame {:<7} {whom}: {what}{then}\n", entry.time_ns as f64 / 1e9, entry.frame)
}

fn in_brackets(detail: &str) -> String {
    // Without the control characters that a terminal would obey.
    let words: String =
        detail.chars().map(|letter| if letter.is_control() { '\u{fffd}' } else { letter }).collect();
    if words.is_empty() { words } else { format!(" ({words})") }
}
