//! Helpers of the whole-system tests: start the programs, look at what they leave, and never wait for ever.
//!
//! A test is a user: it sees exit codes, text and files, and the processes and sockets that the machine shows to
//! everyone. It only ever signals processes that it started.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // as in any test

mod browser;
mod c_programs;
mod children;
mod crates;
pub mod fuzzed;
mod guest;
mod harm;
mod line;
mod output;
mod page;
mod peer;
mod programs;
mod schedule;
mod turn;

pub use browser::{Browser, Seen};
pub use c_programs::{c_library, compile_c};
pub use children::{Process, Traces, children_of, executive_of, process_named};
pub use crates::{building, cargo, copy, crates_target, empty_folder, expect_success};
pub use guest::{Guest, Processor, patient};
pub use harm::{DISK, KERNEL, NEEDS, Sample, held, is_noticed, is_walled_in, run_watched, taken};
pub use line::Ground;
pub use output::{Fault, Window, quantile};
pub use page::Page;
pub use peer::{Peer, jsbsim, python};
pub use programs::{
    EXECUTIVE, Ended, ORDINARY, Started, bateleur, bateleur_as_ordinary, daemon, other, program, repository,
};
pub use schedule::{
    Sketch, channel_between, edited, flight_schedule, laps_of_small_mission, line_of, ports_of, small_mission,
};
pub use turn::{Turn, alone, among_others};

use std::time::{Duration, Instant};

/// Whether tests fly long missions, more seeds and more repetitions, as before a release: `cargo verify --long` says so.
pub fn is_long() -> bool {
    std::env::var_os("BATELEUR_LONG").is_some_and(|value| value == "1")
}

/// The nine partitions of the flight, in the order of their windows.
pub const NINE: [&str; 9] = [
    "rate_generator",
    "hil_interface",
    "gps",
    "imu",
    "estimator",
    "controller",
    "servo",
    "onboard_computer",
    "command",
];

/// How `fly` is told to fly all partitions in one process: the same flight to the bit, and over sooner, where nothing of it needs processes.
pub const ONE_PROCESS: [&str; 2] = ["--engine", "one-process"];

/// The way-points of two laps.
pub const TWO_LAPS: [&str; 9] = ["WP0", "WP1", "WP2", "WP3", "WP0", "WP1", "WP2", "WP3", "WP0"];

/// Longer than anything takes that works, on a machine that is busy with other things.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Looks every few milliseconds until `found` finds something; nothing: it did not within `limit`.
pub fn await_some<T>(limit: Duration, mut found: impl FnMut() -> Option<T>) -> Option<T> {
    let begun = Instant::now();
    loop {
        match found() {
            Some(thing) => return Some(thing),
            None if begun.elapsed() > limit => return None,
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}
