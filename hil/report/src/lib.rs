//! What a flight is turned into: scores, plots, one HTML page.
//!
//! Responsible for: reading a flight's folder, scoring it against the truth and showing it.
//! The one thing it must never do: make a flight look better than it was. What is missing is said, what the aircraft says
//! of itself is checked against the truth, and a flight that failed still gets its report.

#![forbid(unsafe_code)]

pub mod air;
pub mod believed;
pub mod beside;
pub mod campaign;
pub mod chains;
pub mod compare;
mod envelope;
mod error;
pub mod export;
pub mod figures;
pub mod flight;
pub mod health;
pub mod hosts;
pub mod html;
pub mod mission;
pub mod planned;
pub mod plot;
pub mod presence;
pub mod reasons;
pub mod run;
pub mod score;
pub mod summary;
pub mod text;
pub mod timeline;
pub mod timing;
pub mod touchdown;
pub use bateleur_recording::windows;

pub use error::ReportError;
pub use flight::{Flight, Inputs};
pub use summary::{Analysis, Judge, Summary};

use std::path::Path;

/// Reads a flight's folder and writes `summary.json` and `report.html` there. A flight that failed, or whose files are
/// short or missing, gets a report that says so; only a folder that is not there or cannot be written is an error.
pub fn write(dir: impl AsRef<Path>, inputs: &Inputs) -> Result<Summary, ReportError> {
    let dir = dir.as_ref();
    let flight = Flight::load(dir, inputs)?;
    let analysis = Analysis::of(&flight);
    let summary = analysis.summary(&flight);
    summary::write(dir, &summary)?;
    error::write(&dir.join(html::FILE), &html::page(&flight, &analysis, &summary))?;
    Ok(summary)
}
