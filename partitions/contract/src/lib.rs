//! The contract between the executive and a partition, and nothing else.
//!
//! Responsible for: the control page and the process table that both map, the memory in which a dying process leaves what happened, that of a logbook, the
//! description that a partition is started with, the table of a module's links that a relay is told, the numbers of the descriptors it inherits, and its exit codes. Both sides are
//! built from this crate, and the page carries a version, so that a partition built against another contract is refused
//! at its start. It must never grow policy: what a fault means is the executive's business, what a window computes is
//! the partition's.

pub mod crash;
pub mod description;
pub mod fault;
pub mod logbook;
pub mod packing;
pub mod page;
pub mod process_table;
pub mod relay;
mod ring;
pub mod sealed;
mod sync;

mod mapping;

pub use crash::CrashHead;
pub use description::{
    Clock, Description, Direction, LogbookDescription, MemoryBlockDescription, OUTVOTED_BYTES, OUTVOTED_PORT,
    PLAIN_BYTES, PartitionTimes, PlannedProcess, PortDescription, PortKind, ProcessPlan, StartCondition,
};
pub use fault::{FaultKind, FaultOrder};
pub use logbook::{Logbook, LogbookSizes};
pub use mapping::{Mapped, MappedWords, MappingError, SharedMemory};
pub use page::{
    AlignmentReport, AlignmentTold, ControlPage, ErrorCode, Mode, REPLICAS, ReportKind, Reported, Takeover,
};
pub use process_table::{ProcessRow, ProcessState, ProcessTable, Switch, ToldError};
pub use relay::{ClockRole, LinkTable, PathTable, RELAY_KEYS_FD, RelayChannel, RelayTable};
pub use sealed::SealedDescriptors;

/// Descriptor of the control page in a partition process.
pub const CONTROL_FD: i32 = 3;
/// Descriptor of the description (JSON) in a partition process.
pub const DESCRIPTION_FD: i32 = 4;
/// Descriptor of the retained memory in a partition process; not open when the plan grants none.
pub const RETAINED_FD: i32 = 5;
/// So long before the end of a window on the wall clock the processes of a partition are asked to stop, ns: a timer's wake-up, which is
/// this late on a virtual machine once in a thousand times, and the way of the signal. Later, the executive would find an overrun.
pub const WINDOW_MARGIN_NS: u64 = 150_000;
/// Set to the contract's version in the environment of a partition, so that a program started by hand can say what
/// it is and how it is started.
pub const ENVIRONMENT: &str = "BATELEUR_PARTITION";

/// How a partition process ends by itself. [`exit::IDLE`], [`exit::WARM_START`] and [`exit::COLD_START`] are requests only while its control
/// page says so (`page::ControlPage::handling`): of an error handler that is at work and that the plan counts on, or of the partition itself.
pub mod exit {
    /// It was asked to stop and did.
    pub const STOPPED: i32 = 0;
    /// Its `start` refused: a port, an attribute or a device was not as it needs it. The reason is on standard error.
    pub const START_REFUSED: i32 = 64;
    /// It was not started by an executive, or by one with another contract.
    pub const NO_CONTRACT: i32 = 65;
    /// It asked to be idle for good (SET_PARTITION_MODE IDLE).
    pub const IDLE: i32 = 66;
    /// It aborted: an allocation failed, or it called `abort`. Its last words tell which.
    pub const ABORTED: i32 = 67;
    /// The machine reported that memory of the process is damaged.
    pub const HARDWARE_FAULT: i32 = 68;
    /// One of its threads used more stack than it has.
    pub const STACK_OVERFLOW: i32 = 69;
    /// It asked to be started again with its retained memory (SET_PARTITION_MODE WARM_START).
    pub const WARM_START: i32 = 70;
    /// It asked to be started again from nothing (SET_PARTITION_MODE COLD_START).
    pub const COLD_START: i32 = 71;
}
