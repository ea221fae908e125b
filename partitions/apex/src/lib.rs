//! What a partition links: windows, ports, time, health.
//!
//! Responsible for: the partition's side of the contract with the executive. A partition is a type with [`Partition::start`]
//! (create ports, read attributes) and [`Partition::window`] (called once for each granted window); its `main` is
//! `bateleur_apex::run::<MyPartition>()`. It must never let a partition see which clock drives it: time comes from the
//! control page, waiting ends with the window, and the same program gives the same answers in a flight on the wall clock
//! and in one that runs as fast as the machine can.
//!
//! ```no_run
//! use bateleur_apex::{Context, Partition, SamplingDestination, SamplingSource, StartError, Window};
//! use bateleur_messages::{Pressure, RawAnalog};
//! use std::process::ExitCode;
//!
//! struct Altimeter {
//!     raw: SamplingDestination<RawAnalog>,
//!     pressure: SamplingSource<Pressure>,
//! }
//!
//! impl Partition for Altimeter {
//!     fn start(context: &mut Context) -> Result<Self, StartError> {
//!         Ok(Self { raw: context.sampling_destination("raw")?, pressure: context.sampling_source("pressure")? })
//!     }
//!
//!     fn window(&mut self, _window: &Window) {
//!         if let Some(raw) = self.raw.read().filter(|raw| raw.valid) {
//!             let pressure = Pressure { static_pressure_pa: raw.value.static_pressure_pa, ..Default::default() };
//!             self.pressure.write(&pressure);
//!         }
//!     }
//! }
//!
//! fn main() -> ExitCode {
//!     bateleur_apex::run::<Altimeter>()
//! }
//! ```

mod alignment;
mod attributes;
mod context;
mod crash;
mod errors;
mod faults;
mod harness;
mod hosted;
mod line;
mod logbook;
mod memory_block;
mod notices;
#[cfg(test)]
mod port_rules;
mod ports;
pub mod processes;
mod raw;
mod retained;
mod run;
mod schedule;
pub mod serial;
mod signals;
mod supervision;
mod takeover;
mod time;
mod verdict;
mod window;

/// Declares the Rust types of a folder of message definitions, `messages!("messages")`: the path counts from the folder of the crate's
/// `Cargo.toml`. `Name.msg` becomes `Name`, `package/Name.msg` becomes `package::Name`.
#[macro_export]
macro_rules! messages {
    ($folder:literal) => {
        $crate::__message_macro::messages!($crate::message_format, $folder);
    };
}
/// What messages are: the trait that ports need, field tables, types as text.
pub use bateleur_message_format as message_format;
#[doc(hidden)]
pub use bateleur_message_macro as __message_macro;

pub use alignment::Alignment;
pub use attributes::{AttributeError, Attributes, parse_duration};
pub use bateleur_contract::LogbookSizes;
pub use bateleur_contract::logbook::{LogbookCounts, WriteStatus};
pub use bateleur_contract::{AlignmentReport, Direction, ErrorCode, PortKind, StartCondition};
pub use bateleur_ports::Stamp;
pub use bateleur_processes::ReturnCode;
pub use context::{Context, StartError};
pub use errors::{HealthError, Response};
pub use harness::{Harness, Incarnation};
pub use hosted::{Hosted, Hosting};
pub use line::Line;
pub use logbook::{Logbook, LogbookError, LogbookStore};
pub use memory_block::{MemoryBlock, MemoryBlockError};
pub use notices::{HealthNotice, HealthNotices};
pub use ports::{QueuingDestination, QueuingSource, Reading, SamplingDestination, SamplingSource, Sent};
pub use raw::{
    RawMessage, RawQueuingDestination, RawQueuingSource, RawReading, RawSamplingDestination,
    RawSamplingSource,
};
pub use retained::Retained;
pub use run::{Partition, run};
pub use schedule::{ModuleSchedules, ScheduleId, ScheduleStatus};
pub use supervision::{Supervision, SupervisionEvent};
pub use takeover::Takeover;
pub use time::Time;
pub use window::{MajorFrame, Window};
