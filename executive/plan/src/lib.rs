//! The checked plan of all modules: what the executive works from, and the compiled file that carries it there.
//!
//! `executive/checker` makes a [`Plan`] from a schedule file; [`compiled`] writes it down and reads it again. Nothing here reads
//! TOML or touches the machine.

pub mod bounds;
pub mod closed;
pub mod compiled;
pub mod local;
pub mod memory_block;
pub mod model;
pub mod processes;
pub mod timeline;
pub mod units;
pub mod words;

pub use closed::{
    ChangeAction, Closed, Direction, ErrorLevel, Exhausted, Isolation, Kind, LogPolicy, ModuleAction,
    ModuleClock, ModuleError, PartitionAction, PartitionError, PartitionState, Standby, StartMode,
    SystemCalls, Transport,
};
pub use memory_block::MemoryAccess;
pub use model::{
    Address, Attribute, Chain, Channel, ChannelId, Health, HealthLog, Levels, Link, LinkId, Logbook,
    MemoryBlock, Module, ModuleHealth, ModuleId, ModuleView, Network, NetworkId, Partition, PartitionHealth,
    PartitionId, Payload, Plan, Port, PortId, Protection, Reset, Restart, Role, Schedule, ScheduleId, Window,
    leaves_the_process,
};
pub use processes::{Process, Processes, Times};
pub use timeline::{CoreTimeline, Timeline, TimelineWindow};
pub use words::{did_you_mean, nearest};
