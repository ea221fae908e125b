//! The executive that runs one module: its start, its frames on either clock, its end.

pub mod fast;
pub mod lost_supervisor;
pub mod module;
pub mod playing;
pub mod recording;
pub mod supervisor;
mod watched_executive;
pub mod world;

/// Exit code: it ran, and nothing was wrong.
pub const FINE: u8 = 0;
/// Exit code: it ran, and something was wrong.
pub const WRONG: u8 = 1;
/// Exit code: it could not run.
pub const CANNOT_RUN: u8 = 2;
/// The supply is going: what a machine's guard sends to whoever shall save what it can. The same number on x86-64 and aarch64.
pub const SIGPWR: i32 = 30;

/// A line for a person, in one write, as others write to the same standard error. Nobody may read it.
pub(crate) fn say(text: &str) {
    let _ = std::io::Write::write_all(&mut std::io::stderr(), format!("{text}\n").as_bytes());
}
