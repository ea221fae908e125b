//! The schedule file: read, checked, and turned into a [`Plan`].

pub mod closed;
pub mod model;
pub mod report;
pub mod timeline;
pub mod units;

pub use closed::{
    Closed, Direction, Exhausted, Kind, ModuleAction, ModuleError, PartitionAction, PartitionError, StartMode,
};
pub use model::{
    Attribute, Chain, Channel, ChannelId, Health, Module, ModuleHealth, ModuleId, ModuleView, Partition,
    PartitionHealth, PartitionId, Payload, Plan, Port, PortId, Restart, Role, Schedule, ScheduleId, Window,
};
pub use report::{Place, Related, Report, Severity, Violation};
pub use timeline::{CoreTimeline, Timeline, TimelineWindow};

/// The message types that ports may name.
pub trait MessageCatalogue {
    /// The size of a message type in bytes, or nothing if there is no such type.
    fn size_of(&self, name: &str) -> Option<usize>;
    /// The name of every message type.
    fn names(&self) -> Vec<&str>;
}
