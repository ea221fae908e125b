//! The driver of a satellite receiver that speaks UBX (u-blox), over a serial line or a serial-to-Ethernet converter.
//!
//! Responsible for: asking the receiver for its navigation solution (NAV-PVT) at a rate, and turning each into a `RawGps`
//! with the module time at which it was measured. It must never invent one: what is damaged is counted and left out, and a
//! receiver without a fix says so in what it publishes. The function `gps` reads it as it reads a simulator's.
//!
//! Source of fields, scales and flags: u-blox 8 / M8 receiver description including protocol specification, UBX-13003221,
//! sections 32.10 (CFG), 32.17.15 (NAV-PVT); u-blox F9 and M10 interface descriptions for CFG-VALSET.

mod epoch;
mod link;
mod orders;
mod solution;

pub use epoch::Epoch;
pub use link::{Link, LinkError, Place};
pub use orders::{Orders, Settings};
pub use solution::{Counters, Decoder, Heard};
