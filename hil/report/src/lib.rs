//! What a flight is turned into: scores, plots, one HTML page.
//!
//! Responsible for: the log of the ports, reading a flight's folder, scoring it against the truth and showing it.
//! The one thing it must never do: make a flight look better than it was. What is missing is said, what the aircraft says
//! of itself is checked against the truth, and a flight that failed still gets its report.

#![forbid(unsafe_code)]

pub mod believed;
mod error;
pub mod flight;
pub mod health;
pub mod log;
pub mod mission;
pub mod planned;
pub mod plot;
pub mod run;
pub mod score;
pub mod summary;
pub mod text;
pub mod timing;
pub mod windows;

pub use error::ReportError;
pub use flight::{Flight, Inputs};
pub use summary::{Analysis, Summary};
