//! The processes of one partition and the services of ARINC 653 Part 1 (supplement 5), without an operating system.
//!
//! Responsible for: which process of a partition runs, and what each service returns. A driver tells it what happens and does what it
//! says:
//!
//! 1. [`Partition::advance`] says what time it is; due release points, time-outs and deadlines take effect.
//! 2. [`Partition::dispatch`] says who runs. A number of starts that the driver has not seen means: begin at the entry point.
//! 3. Whoever runs calls services; they are methods of [`Partition`], and the caller is the one whom `dispatch` named. A service that
//!    returns [`Progress::Waits`] has its result in [`Partition::result`] when its caller runs again.
//! 4. [`Partition::next_timer`] says when time alone changes something.
//!
//! It must never read a clock, start a thread, or allocate after the partition has entered NORMAL.
//!
//! ```
//! use bateleur_processes::standard::*;
//! use bateleur_processes::{Dispatch, Partition, Runner, Settings};
//!
//! let mut partition = Partition::new(Settings::every(100_000_000));
//! let attributes = ProcessAttributes {
//!     name: Name::new("fast").unwrap(),
//!     entry_point: 0,
//!     stack_size: 64 << 10,
//!     base_priority: 20,
//!     period: INFINITE_TIME_VALUE,
//!     time_capacity: INFINITE_TIME_VALUE,
//!     deadline: Deadline::Soft,
//! };
//! let fast = partition.create_process(&attributes).unwrap();
//! partition.start(fast).unwrap();
//! assert_eq!(partition.dispatch(), Dispatch::Run { who: Runner::Main, life: 1 });
//! partition.set_partition_mode(OperatingMode::Normal).unwrap();
//! assert_eq!(partition.dispatch(), Dispatch::Run { who: Runner::Process(fast), life: 1 });
//! ```
#![forbid(unsafe_code)]

pub mod functional_status;
mod health;
mod lending;
pub mod logbooks;
mod objects;
mod partition;
pub mod ports;
mod process;
mod queues;
mod return_code;
mod scheduling;
mod services;
mod settings;
pub mod standard;
mod timers;

pub use health::{Notice, Verdict};
pub use partition::{Dispatch, End, Partition, Progress, Runner, Standing};
pub use return_code::ReturnCode;
pub use settings::{
    AffinityPermission, HealthTable, Level, Limit, Limits, PartitionAction, PeriodGrid, Settings,
};
