//! A partition as a process of Linux: its start, its sandbox, what this machine can promise, and the helpers that touch what a
//! partition may have damaged.

pub mod error_log;
pub mod guarantee;
pub mod helper;
pub mod instance;
pub mod keys;
pub mod machine;
pub mod partition;
pub mod programs;
pub mod sealed;
pub mod trouble;
