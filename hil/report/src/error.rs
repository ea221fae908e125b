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
    #[error("{}: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The summary could not be turned into JSON.
    #[error("{}: {source}", path.display())]
    Json {
        /// Which file.
        path: PathBuf,
        /// What was wrong.
        source: serde_json::Error,
    },
}

pub(crate) fn write(path: &Path, text: &str) -> Result<(), ReportError> {
    std::fs::write(path, text).map_err(|source| ReportError::Write { path: path.to_path_buf(), source })
}
