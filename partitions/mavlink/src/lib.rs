//! MAVLink as this project speaks it: to simulators and to ground stations.
//!
//! Responsible for: finding sound messages in whatever bytes come ([`Decoder`]), writing messages ([`Encoder`]), and the
//! translation between messages of the simulator link and those of the ports ([`hil`]), and degrees as metres from the runway ([`Runway`]). The messages themselves are those of the crate
//! `mavlink`, dialect "common". It must never panic on a byte that came from outside, never let half a message swallow
//! the next one, and never know a partition, a port or a clock.

mod decoder;
mod encoder;
mod foreign;
pub mod hil;
mod place;

pub use decoder::{Decoder, Received, Refused};
pub use encoder::Encoder;
pub use foreign::Foreign;
pub use mavlink::dialects::common;
pub use place::Runway;
