//! The gateway between CAN and Ethernet.
//!
//! Responsible for: carrying the frames of a CAN bus over UDP to whoever asked for them, and theirs back onto the bus. It must
//! never lose a frame without counting it, never send a frame back to where it came from, and never hand out an old one as if it
//! were new.
//!
//! [`Gateway`] decides, without a socket or a clock; `wire` holds the codecs, `bus` what can stand for a bus, [`node`] joins
//! them to sockets and the clock of a machine.

pub mod bus;
pub mod cli;
mod counters;
mod events;
pub mod frame;
mod gateway;
mod ids;
pub mod node;
mod ring;
pub mod server;
pub mod soak;
pub mod status;
mod track;
pub mod wire;

pub use counters::Counters;
pub use events::Event;
pub use frame::{Frame, FrameError, Id, Kind};
pub use gateway::{Gateway, MAX_TARGETS, Protocol, Settings, State, TargetStatus};
pub use ids::{Ids, NotIds, one as id_of};
pub use ring::{GivenUp, Ring, Rules};
pub use track::{Tally, Track};
