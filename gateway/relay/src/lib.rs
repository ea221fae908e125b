//! The relay: channels between the modules of a plan, over datagrams.
//!
//! Responsible for: the datagram and everything that two relays agree on by it. Whose datagram it is (authentication, the
//! lives of both ends, replay), which came first (redundant networks), what is in it (messages, whole or in pieces), what the
//! peer's clock says, and counters of all of that. It knows no executive and no shared memory: messages are bytes, time is
//! an argument, and datagrams are handed in and out, so that everything here can be tested in virtual time. It must
//! never deliver anything of a datagram of which not every byte has been checked, and never send anything twice.
//!
//! - [`Link`]: one end of a link between two modules
//! - [`transport`]: ways for datagrams, behind one trait: UDP, and one for modules that share a virtual clock
//! - [`model`]: a network with delay, jitter, loss, duplication, reordering and a rate, seeded and counted
//!
//! The program `relay` beside it is the partition; `link_model` is a modelled network between real sockets.

pub mod clock;
pub mod counters;
mod incoming;
mod link;
pub mod model;
mod outgoing;
mod pace;
mod presence;
mod sections;
mod sequence;
mod session;
mod tag;
#[cfg(test)]
mod tests;
mod transit;
pub mod transport;
mod wire;

pub use incoming::Delivery;
pub use link::{Arrival, Event, Frame, Link, LinkError, Sealed};
pub use outgoing::{Composer, Stamp};
pub use tag::{Key, TAG_BYTES};
pub use wire::{HEADER_BYTES, MAGIC, MESSAGE_BYTES, PIECE_BYTES, Rejection, VERSION, link_of};
