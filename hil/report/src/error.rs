//! What can keep a report from being made.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why there is no report at all. Everything less than that becomes a note in the report.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The flight's folder is not there.
    #[error("{} is not a folder, so there is no flight to report", .0.display())]
    NoFlight(PathBuf),
    /// The report could not be written.
    #[error("{}: {why}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        why: std::io::Error,
    },
    /// The summary could not be turned into JSON.
    #[error("{}: {why}", path.display())]
    Json {
        /// Which file.
        path: PathBuf,
        /// What was wrong.
        why: serde_json::Error,
    },
}

pub(crate) fn write(path: &Path, text: &str) -> Result<(), ReportError> {
    std::fs::write(path, text).map_err(|why| ReportError::Write { path: path.to_path_buf(), why })
}
