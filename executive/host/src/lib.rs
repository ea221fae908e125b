//! A partition as a process of Linux: its start, its sandbox, what this machine can promise, and the helpers that touch what a
//! partition may have damaged.

mod crash_memory;
pub mod error_log;
pub mod guarantee;
pub mod helper;
pub mod instance;
pub mod keys;
pub mod logbooks;
pub mod machine;
pub mod memory_blocks;
mod network_limits;
pub mod partition;
pub mod processor;
pub mod programs;
pub mod sealed;
#[cfg(test)]
#[path = "../../test_support.rs"]
mod test_support;
pub mod trouble;
