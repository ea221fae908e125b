//! The monitor: sees processes live and die, decides by the health tables, and brings successors up.
//!
//! It runs beside the dispatchers on the wall clock and between two minor frames on the virtual one; either way it is
//! stepped and never waits for a partition for longer than a step. It is in four parts, and each file imports files above it in this list
//! only:
//!
//! - logs: `event`, `event_text`: what a run tells whoever watches; [`health`]: the health tables' decisions, and the logs of faults and
//!   windows; `repeats`: how often the same is logged; `module_level`: errors of the module, and what outlives its reset;
//! - life cycle: [`lifecycle`] is a state machine for each partition: events in, commands out;
//! - helpers and figures: `cleanup`: what a dead process left; `rebuild`: channels that it damaged; `observers`: who shows channels to
//!   operators; `align`: another module's frames; `neighbours`: other modules on the same processors; `figures`: what a status tells;
//!   `inject`, `act`, `provoke`: what can be done to a partition;
//! - the driver: `partition`: the processes of one; `monitor`: what the monitor consists of; `supervision`: carries out what the life
//!   cycles command; `windows`: what windows and control pages tell; `orders`: what operators and plans of faults do; `requests`: how
//!   operators are answered; `step`: the run from the first launch to the last end; `planned`: what is to happen when.

mod act;
mod align;
pub mod cleanup;
pub mod event;
mod event_text;
mod figures;
pub mod health;
pub mod inject;
pub mod lifecycle;
mod module_level;
mod monitor;
mod neighbours;
pub mod observers;
pub mod operator;
mod orders;
mod partition;
pub mod planned;
mod provoke;
pub mod rebuild;
mod repeats;
mod requests;
pub mod run_order;
mod step;
mod supervision;
mod windows;

pub use align::Alignment;
pub use cleanup::StartChannelCleaner;
pub use module_level::{Kept, Stop, Totals};
pub use monitor::{Monitor, MonitorConfig, TakeRecord};
pub use orders::UnknownSchedule;

#[cfg(test)]
#[path = "../../test_support.rs"]
mod test_support;
