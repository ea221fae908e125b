//! What a partition that ended by a fault has left: read from its crash memory, told as a report and as a minidump.
//!
//! Responsible for: reading that memory with bounds on everything ([`Captured`]), finding the frames of the stack and the functions and
//! lines that they belong to ([`backtrace`]), and the two files that are made of it. It runs in a helper process without
//! privileges, after the partition's successor has begun. The one thing it must never do: believe what the dead process wrote.

#![forbid(unsafe_code)]

pub mod backtrace;
mod captured;
mod frame;
mod maps;
pub mod minidump;
mod report;
mod sections;

pub use captured::{Captured, Unreadable};
pub use frame::{Frame, Word};
pub use maps::Mapping;
pub use report::{CrashReport, Death, PortOf};
pub use sections::Binaries;

/// Bytes of a report and of a minidump, most.
pub const MOST_BYTES: u64 = 256 << 10;
