//! CAN without a program around it: frames, what can stand for a bus, the byte formats that carry frames, and the gateway's protocol.
//!
//! Responsible for: sending and receiving frames on SocketCAN, an adapter on a serial line, a recording or a bus in memory; turning frames
//! into bytes and back; and [`Gateway`], which decides what goes where, without a socket or a clock. Both ends of a link are built on it: the
//! gateway's program, and the partition that is on the bus. It must never lose a frame without counting it, never send a frame back to
//! where it came from, and never hand out an old one as if it were new.

pub mod bus;
mod counters;
mod events;
pub mod frame;
mod gateway;
pub mod identity;
mod ids;
mod ring;
mod track;
pub mod wire;

pub use counters::Counters;
pub use events::Event;
pub use frame::{Frame, FrameError, Id, Kind};
pub use gateway::{Gateway, MAX_TARGETS, Protocol, Settings, State, TargetStatus};
pub use ids::{Ids, NotIds, one as id_of};
pub use ring::{GivenUp, Ring, Rules};
pub use track::{Tally, Track};
