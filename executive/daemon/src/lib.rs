//! The executive that runs one module: its start, its frames on either clock, its end.

pub mod fast;
pub mod module;
pub mod recording;
pub mod supervisor;
pub mod world;

/// Exit code: it ran, and something was wrong.
pub const WRONG: u8 = 1;
/// The supply is going: what a machine's guard sends to whoever shall save what it can. The same number on x86-64 and aarch64.
pub const SIGPWR: i32 = 30;
