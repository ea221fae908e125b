//! What the executive asks of the kernel. Every unsafe block of this crate lies below this folder.

pub mod account;
pub mod cgroup;
pub mod chance;
pub mod delegation;
pub mod filter;
pub mod kernel_log;
pub mod rules;
pub mod sched;
pub mod spawn;
pub mod time;
mod view;
