//! The plant behind a socket.
//!
//! Responsible for: advancing the aircraft to the time that a flight computer names, answering with one sensor set,
//! playing the safety pilot at the field, and logging what was really the case. The one thing it must never do: let
//! anything but the seed, the packets' content and their order decide what it answers in lockstep.
//!
//! Three layers, each usable alone: [`Flight`] (plant, pilot and supply on one clock), [`Session`] (the protocol,
//! bytes in and bytes out, no socket), [`Server`] (the socket).

#![forbid(unsafe_code)]

mod counters;
mod dialect;
mod flight;
pub mod flightgear;
mod options;
mod outside;
mod pilot;
mod server;
mod session;
mod supply;
pub mod timers;
pub mod truth;

pub use counters::Counters;
pub use flight::{Flight, STEP_NS, STEPS_PER_CYCLE, Sample};
pub use options::{AirframeChoiceError, DEFAULT_PORT, Options, airframe};
pub use outside::{Outside, OutsideError};
pub use pilot::{LEVEL_OFF_M, SafetyPilot};
pub use server::{RunError, Server, StartError};
pub use session::{Session, SessionError};
