//! A run's folder for other people's tools: a trace for Perfetto, a log for MCAP viewers, tables.
//!
//! Responsible for: reading `windows.csv`, `health.jsonl` and `ports.mcap` once each, from front to back, and writing as it
//! reads, so that an hour takes no more memory than a minute. It must never fail because an input is damaged or cut off: what
//! can be read is written, and what could not is said.

mod chrome;
mod mcap;
mod tables;

pub use chrome::chrome;
pub use mcap::{Encoding, mcap};
pub use tables::tables;

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use bateleur_recording::LogError;

/// Why there is no export at all. Everything less than that is a note.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The folder is not there.
    #[error("{} is not a folder: name that of a run or a flight, such as target/flights/…", .0.display())]
    NoFolder(PathBuf),
    /// None of the inputs could be read.
    #[error("nothing could be exported: {}", .0.join("; "))]
    Nothing(Vec<String>),
    /// The output is one of the inputs.
    #[error("{} is what is to be exported: name another file", .0.display())]
    OwnInput(PathBuf),
    /// The output cannot be written.
    #[error("{}: {why}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        why: std::io::Error,
    },
    /// The container refused.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// What was exported.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Exported {
    /// Windows, faults and messages that were written.
    pub records: u64,
    /// What was missing or damaged.
    pub notes: Vec<String>,
}

impl Exported {
    fn note(&mut self, file: &str, what: impl std::fmt::Display) {
        self.notes.push(format!("{file}: {what}"));
    }

    fn note_broken(&mut self, file: &str, lines: usize) {
        if lines > 0 {
            self.note(file, format_args!("{lines} lines are damaged and left out"));
        }
    }

    fn note_ending(&mut self, ending: &bateleur_recording::Ending) {
        if let Some(flaw) = ending.flaw() {
            self.note(bateleur_recording::PORTS_FILE, format_args!("{flaw}; what it holds is exported"));
        }
    }

    /// Nothing at all is an error.
    fn or_nothing(self) -> Result<Self, ExportError> {
        if self.records == 0 && !self.notes.is_empty() {
            Err(ExportError::Nothing(self.notes))
        } else {
            Ok(self)
        }
    }
}

fn check_folder(folder: &Path) -> Result<(), ExportError> {
    if folder.is_dir() { Ok(()) } else { Err(ExportError::NoFolder(folder.to_path_buf())) }
}

/// A file that is written from front to back, and the first error that it met: whoever writes a million lines looks once.
struct Sink {
    path: PathBuf,
    file: BufWriter<File>,
    error: Option<std::io::Error>,
}

impl Sink {
    fn create(path: &Path) -> Result<Self, ExportError> {
        let wrong = |why| ExportError::Write { path: path.to_path_buf(), why };
        let file = File::create(path).map_err(wrong)?;
        Ok(Self { path: path.to_path_buf(), file: BufWriter::with_capacity(1 << 16, file), error: None })
    }

    fn write(&mut self, bytes: &[u8]) {
        if self.error.is_none() {
            self.error = self.file.write_all(bytes).err();
        }
    }

    fn finish(mut self) -> Result<(), ExportError> {
        let flushed = self.file.flush().err();
        match self.error.or(flushed) {
            None => Ok(()),
            Some(why) => Err(ExportError::Write { path: self.path, why }),
        }
    }
}
