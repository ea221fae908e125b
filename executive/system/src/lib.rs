//! What the executive asks of the kernel. Every unsafe block of the executive lies in this crate.

pub mod account;
mod bpf;
pub mod cgroup;
pub mod cpu_starvation;
pub mod delegation;
pub mod destinations;
pub mod disposition;
pub mod filter;
pub mod folders;
pub mod handed_over;
pub mod kernel_log;
pub mod lock_calls;
pub mod privileges;
pub mod processes;
pub mod rules;
pub mod sched;
pub mod service_manager;
pub mod sockets;
pub mod spawn;
pub mod thread;
pub mod time;
pub mod trace;
pub mod tree;
pub mod users;
mod view;
pub mod wait;
