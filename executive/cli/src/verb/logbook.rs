//! `bateleur logbook`: what partitions have written into their logbooks, from the files of a run, also while it runs.
//!
//! Exit codes: 0 it was read, 2 it could not be read.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_monitor::logbook_store::{FOLDER, files, read_file};
use serde::Serialize;

use super::notes::Notes;
use super::{Code, FINE, Format};

/// Read the logbooks that partitions have written.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    notes: Notes,
}

/// A message.
#[derive(Debug, Serialize)]
struct Entry {
    partition: String,
    logbook: String,
    /// As READ_LOGBOOK counts: 0 is the newest.
    entry: usize,
    /// What cannot be printed as `\xNN`; `null`: it was not written to its end.
    text: Option<String>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let notes = &arguments.notes;
    let files = notes.files(files);
    if files.is_empty() {
        bail!("no partition of this run has a logbook: there is nothing in its folder `{FOLDER}`");
    }
    let mut entries = Vec::new();
    for file in &files {
        let messages = read_file(file).with_context(|| format!("cannot read {}", file.display()))?;
        let (partition, logbook) = names(file);
        entries.extend(messages.into_iter().enumerate().rev().map(|(entry, message)| Entry {
            partition: partition.clone(),
            logbook: logbook.clone(),
            entry,
            text: message.map(|message| message.escape_ascii().to_string()),
        }));
    }
    notes.choose(&mut entries, |entry| &entry.partition);
    match notes.format {
        Format::Json => println!("{}", serde_json::to_string_pretty(&entries)?),
        Format::Text => print!("{}", table(&entries)),
    }
    Ok(FINE)
}

/// The partition and the logbook whose file that is.
fn names(file: &Path) -> (String, String) {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (partition, logbook) = name.split_once('.').unwrap_or(("", &name));
    (partition.to_owned(), logbook.to_owned())
}

fn table(entries: &[Entry]) -> String {
    let mut text = String::new();
    for Entry { partition, logbook, entry, text: message } in entries {
        let message = message.as_deref().unwrap_or("(not written to its end)");
        let _ = writeln!(text, "{partition}.{logbook} {entry:>5}  {message}"); // to a string
    }
    text
}
