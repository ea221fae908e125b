//! `bateleur logbook`: what partitions have written into their logbooks, also while the module runs.
//!
//! Exit codes: 0 all were read, 1 some could not be read, 2 there is none.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use bateleur_monitor::logbook_store::{files, read_file};
use serde::Serialize;

use super::notes::Notes;
use super::run::LOGBOOKS;
use super::{Code, FINE, Format, WRONG};
use crate::installed;

/// Read the logbooks that partitions have written.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of `run --logbooks`, that of a run on the virtual clock, or one file [default: target/logbooks].
    #[arg(value_name = "FOLDER|FILE")]
    path: Option<PathBuf>,
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
    let files = match arguments.path.as_deref() {
        Some(path) if path.is_dir() => first_files(&[path.join(LOGBOOKS), path.to_owned()]),
        Some(path) => vec![path.to_owned()],
        None => first_files(&[installed::outputs(LOGBOOKS), installed::latest_run().join(LOGBOOKS)]),
    };
    if files.is_empty() {
        bail!(
            "there is no logbook: name the folder of `run --logbooks`, or that of a run on the virtual clock"
        );
    }
    let (mut entries, mut code) = (Vec::new(), FINE);
    for file in &files {
        let messages = match read_file(file) {
            Ok(messages) => messages,
            Err(error) => {
                eprintln!("cannot read {}: {error}", file.display().to_string().escape_default());
                code = WRONG;
                continue;
            }
        };
        let (partition, logbook) = names(file);
        entries.extend(messages.into_iter().enumerate().rev().map(|(entry, message)| Entry {
            partition: partition.clone(),
            logbook: logbook.clone(),
            entry,
            text: message.as_deref().map(printable),
        }));
    }
    notes.choose(&mut entries, |entry| &entry.partition);
    match notes.format {
        Format::Json => println!("{}", serde_json::to_string_pretty(&entries)?),
        Format::Text => print!("{}", table(&entries)),
    }
    Ok(code)
}

/// Those of the first folder that has any.
fn first_files(folders: &[PathBuf]) -> Vec<PathBuf> {
    folders.iter().map(|folder| files(folder)).find(|files| !files.is_empty()).unwrap_or_default()
}

/// Text as it is, with `\xNN` for whatever a terminal does not print.
fn printable(message: &[u8]) -> String {
    let mut text = String::new();
    for chunk in message.utf8_chunks() {
        for letter in chunk.valid().chars() {
            match letter.is_control() {
                true => {
                    text.extend(letter.encode_utf8(&mut [0; 4]).bytes().map(|byte| format!("\\x{byte:02x}")))
                }
                false => text.push(letter),
            }
        }
        text.extend(chunk.invalid().iter().map(|byte| format!("\\x{byte:02x}")));
    }
    text
}

/// The partition and the logbook whose file that is.
fn names(file: &Path) -> (String, String) {
    let name = printable(file.file_name().unwrap_or_default().as_encoded_bytes());
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
