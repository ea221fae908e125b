//! The flight functions in one loop of one process, fed with what a flight recorded.
//!
//! Responsible for: the older way of building a flight computer, to hold the partitioned one against it: the same functions,
//! called one after the other, with a struct of latest values in place of ports. It must never look at what the recorded
//! functions gave: only sensors, sticks and orders go in.

#![forbid(unsafe_code)]

mod cycle;
mod replay;
mod settings;

pub use cycle::{MainCycle, Outputs};
pub use replay::{OUTPUTS, ReplayError, Replayed, Topics, Words, replay};
pub use settings::{Given, Instants, Settings, Validity};
