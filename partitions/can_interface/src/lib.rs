//! The function that has sensors and actuators on a CAN bus.
//!
//! Responsible for: the actuators as frames once in each window, sensors from frames before the sensor cut-off, and, where it
//! has a bus and the network, for carrying frames between them. It must never wait longer than the cut-off, whatever the bus does,
//! and never make up a value whose frame did not come.
//!
//! [`Wires`] moves frames, [`Conversation`] is what happens in one window, [`Supervision`] says when sensors fail to come and
//! come again.

mod conversation;
mod supervision;
mod wires;

pub use conversation::{Conversation, Counts, Moment, Sensors};
pub use supervision::{Event, Supervision};
pub use wires::{Settings, Waiting, Wires};

use bateleur_messages::ServoTimers;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// What the servo board is told before the Servo has spoken: surfaces neutral, throttle closed.
pub const AT_REST: ServoTimers = ServoTimers {
    aileron_left_us: 1500,
    aileron_right_us: 1500,
    elevator_us: 1500,
    rudder_us: 1500,
    throttle_us: 1000,
    autopilot: 0,
    cycle: 0,
};

/// What outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    /// 1 while it is switched on.
    pub enabled: u64,
    /// Windows so far.
    pub cycles: u64,
}
