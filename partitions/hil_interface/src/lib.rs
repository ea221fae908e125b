//! The function that exchanges sensors and actuators with a simulator, in one of three protocols.
//!
//! Responsible for: one question to the simulator in each cycle (the actuators, and the module time to advance to), and
//! for publishing its answer before the sensor cut-off. It must never wait longer than that, whatever the network does,
//! and never let one bad datagram decide what is taken afterwards.
//!
//! [`Inbox`] decides what to believe, `Link` moves bytes (UDP, TCP), `Mavlink` puts them into that protocol's words, [`Conversation`]
//! is what happens in one window and [`bateleur_apex::Supervision`] says when the simulator has gone and come back;
//! `Remarks` says once what a simulator can hardly mean.

mod exchange;
mod inbox;
mod link;
mod mavlink;
mod parameters;
mod remarks;
mod tcp;
mod udp;

pub use exchange::{Conversation, Moment, Settings, Waiting};
pub use inbox::{Counters, Inbox, Sensors};
pub use link::LinkError;
pub use parameters::{Numbers, parameters};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// What outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    /// Questions so far.
    pub sequence: u64,
    /// 1 while HIL mode is on.
    pub enabled: u64,
}
