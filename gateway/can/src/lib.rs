//! The gateway between CAN and Ethernet.
//!
//! Responsible for: carrying the frames of a CAN bus over UDP to whoever asked for them, and theirs back onto the bus.
//! [`bateleur_can_core::Gateway`] decides; [`node`] joins it to a bus, to sockets and to the clock of a machine.

pub mod cli;
pub mod node;
pub mod server;
pub mod soak;
pub mod status;
