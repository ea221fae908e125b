//! Windows in time: which core has which window when, on the wall clock and on the virtual one, how a partition is held outside of its own,
//! and how schedules and frames of several modules change together. It never waits for a partition.

pub mod alignment;
pub mod change;
pub mod dispatcher;
pub mod freeze_worker;
mod hold_request;
pub mod line_counts;
pub mod partition_control;
pub mod redundant_pair;
pub mod run_page;
pub mod schedule_switch;
pub mod shared_clock;
pub mod stall;
mod sync;
#[cfg(test)]
#[path = "../../test_support.rs"]
mod test_support;
pub mod time_guard;
pub mod wall;
mod window_owner;
pub mod window_record;
