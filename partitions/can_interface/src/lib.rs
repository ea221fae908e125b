//! The function that has sensors and actuators on a CAN bus.
//!
//! Responsible for: the actuators as frames once in each window, sensors from frames before the sensor cut-off, and, where it
//! has a bus and the network, for carrying frames between them. It must never wait longer than the cut-off, whatever the bus does,
//! and never make up a value whose frame did not come.
//!
//! [`Wires`] moves frames, [`Conversation`] is what happens in one window, [`bateleur_apex::Supervision`] says when sensors fail to come and
//! come again.

mod conversation;
mod wires;

pub use conversation::{Actuators, Conversation, Counts, Moment, OWN_PORTS, Sensors, nothing_for};
pub use wires::{Settings, Waiting, Wires};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// What outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    /// 1 while it is switched on.
    pub enabled: u64,
    /// Windows so far.
    pub cycles: u64,
}
