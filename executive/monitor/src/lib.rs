//! The monitor: sees processes live and die, decides by the health tables, and brings successors up.
//!
//! It runs beside the dispatchers on the wall clock and between two minor frames on the virtual one; either way it is
//! stepped and never waits for a partition for longer than a step. It is in four parts. A file imports only files that stand above it in
//! this list, which a test compares.
//!
//! Logs:
//!
//! - `lines`: lines that a thread of their own writes, so that the monitor waits for no disk
//! - `logbook_store`: partitions' logbooks on the disk, likewise
//! - `process_log`: which process of a partition ran when
//! - `event`, `event_text`: what a run tells whoever watches
//! - `health`: the decisions of the health tables, and the logs of faults and windows
//! - `repeats`: how often the same is logged
//! - `why`: who had the processor when a window was late, lost or used up
//! - `crashes`: who reads what dead processes have written down
//! - `module_level`: errors of the module, and what outlives its reset
//!
//! Life cycle:
//!
//! - `lifecycle`: a state machine for each partition: events in, commands out
//! - `cleanup`: what a dead process left in shared memory
//! - `rebuild`: channels that a partition damaged
//! - `figures`: what a status tells of a partition
//! - `inject`, `act`: what can be done to a partition
//! - `provoke`: faults that end or stop its process
//! - `unclosed`: windows that it leaves open
//! - `partition`: its processes, and what is remembered of its windows
//!
//! Operator:
//!
//! - `observers`: who shows channels to operators
//! - `operator`: where orders come from and answers go
//!
//! The driver, which turns what happens into events of life cycles and carries their commands out:
//!
//! - `align`: another module's frames
//! - `neighbours`: other modules on the same processors
//! - `monitor`: what it consists of
//! - `commands`: what life cycles command
//! - `faults`: errors of partitions
//! - `processes`: processes that become ready, die or stand by
//! - `channels`: channels of a dead process
//! - `written_down`: what a dead process has written down
//! - `windows`: what windows and control pages tell
//! - `orders`: what an operator or a plan of faults does
//! - `requests`: how operators are answered
//! - `step`: the run from the first launch to the last end
//! - `planned`, `run_order`: what is to happen, and when

mod act;
mod align;
mod channels;
pub mod cleanup;
mod commands;
mod crashes;
pub mod event;
pub mod event_text;
mod faults;
mod figures;
pub mod health;
pub mod inject;
pub mod lifecycle;
pub mod lines;
pub mod logbook_store;
mod module_level;
mod monitor;
mod neighbours;
pub mod observers;
pub mod operator;
mod orders;
mod partition;
pub mod planned;
mod process_log;
mod processes;
mod provoke;
pub mod rebuild;
pub mod repeats;
mod requests;
pub mod run_order;
mod step;
mod unclosed;
pub mod why;
mod windows;
mod written_down;

pub use align::Alignment;
pub use cleanup::StartChannelCleaner;
pub use crashes::{CrashReporter, MakeCrashFiles, StartCrashReporter};
pub use module_level::{Kept, Stop, Totals};
pub use monitor::{Monitor, MonitorConfig, TakeRecord};
pub use orders::UnknownSchedule;

#[cfg(test)]
#[path = "../../test_support.rs"]
mod test_support;
