//! `bateleur export FOLDER`: what a run or a flight left, for other people's tools.
//!
//! `--chrome` writes a trace that Perfetto (ui.perfetto.dev) and chrome://tracing open, `--mcap` a log of all ports with an
//! index and the faults, `--csv` a table for each port. All may be asked for at once. Exit codes: 0 all was exported, 1 some
//! of the folder was missing or damaged (what could be read was exported), 2 nothing could be exported.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use bateleur_report::export::{Encoding, Exported, chrome, mcap, tables};
use bateleur_report::hosts;

use super::{Code, FINE, WRONG};
use bateleur_executive_cli::output::{LOG_BEGINNING, refuse_file};

/// Turn a run's folder into what other tools open.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true).multiple(true).args(["chrome", "mcap", "csv"]))]
pub struct Arguments {
    /// The folder of a run or a flight.
    folder: PathBuf,
    /// Trace of windows, faults and messages, for Perfetto and chrome://tracing.
    #[arg(long, value_name = "FILE")]
    chrome: Option<PathBuf>,
    /// Log of all ports and faults, indexed, for Foxglove and other MCAP viewers.
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// Write the messages of --mcap as JSON, for tools that do not know ROS 2's encoding.
    #[arg(long, requires = "mcap")]
    json: bool,
    /// One file of comma-separated values a port, into this folder.
    #[arg(long, value_name = "FOLDER")]
    csv: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let folder = &arguments.folder;
    refuse(arguments)?;
    let mut notes: Vec<String> = Vec::new();
    let mut told = |path: &PathBuf, exported: Exported| {
        println!("{}: {} records", path.display(), exported.records);
        notes.extend(exported.notes);
    };
    if let Some(path) = &arguments.chrome {
        told(path, chrome(folder, path)?);
    }
    if let Some(path) = &arguments.mcap {
        let encoding = if arguments.json { Encoding::Json } else { Encoding::Cdr };
        told(path, mcap(folder, path, encoding)?);
    }
    if let Some(path) = &arguments.csv {
        told(path, tables(folder, path)?);
    }
    notes.sort();
    notes.dedup();
    notes.iter().for_each(|note| eprintln!("{note}"));
    Ok(if notes.is_empty() { FINE } else { WRONG })
}

/// What a trace begins with.
const TRACE_BEGINNING: &str = "{\"displayTimeUnit\"";

/// The logs of messages in a folder: those of every host, each with the parts that later recorders wrote.
fn logs(folder: &Path) -> Vec<PathBuf> {
    let hosts = hosts::of(folder).into_iter().map(|host| hosts::folder_of(folder, &host));
    let files =
        std::iter::once(folder.to_path_buf()).chain(hosts).filter_map(|folder| folder.read_dir().ok());
    let is_log = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        name.starts_with(LOG_STEM) && name.ends_with(".mcap")
    };
    files.flatten().flatten().map(|entry| entry.path()).filter(is_log).collect()
}

/// How the names of all of them begin.
const LOG_STEM: &str = "ports.";

/// What was flown is the only one of its kind: no file of it is written over.
fn refuse(arguments: &Arguments) -> Result<()> {
    let logs = logs(&arguments.folder);
    let logs: Vec<&Path> = logs.iter().map(PathBuf::as_path).collect();
    if let Some(output) = &arguments.chrome {
        refuse_file(output, TRACE_BEGINNING, &logs)?;
    }
    if let Some(output) = &arguments.mcap {
        refuse_file(output, LOG_BEGINNING, &logs)?;
    }
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    match &arguments.csv {
        Some(tables) if same(tables, &arguments.folder) => {
            bail!("{} is the folder that is read: name another one for the tables", tables.display())
        }
        _ => Ok(()),
    }
}
