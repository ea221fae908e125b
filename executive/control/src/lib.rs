//! Control of a running module: a socket in the run's directory, one JSON object a line.
//!
//! Responsible for: letting the same user, or root, ask a running module for its figures and give it orders. Whatever a
//! client does (silence, garbage, floods, never reading its answers), the frame is not disturbed and memory stays
//! bounded: a thread of ordinary priority on the housekeeping cores talks to clients, and the monitor takes a few orders
//! in each of its steps from a short queue. It must never carry out an order itself.
//!
//! ```text
//! client ──line──▶ server thread ──queue──▶ monitor's step ──answer──▶ server thread ──line──▶ client
//! ```
//!
//! - [`protocol`]: what is asked and answered, and how lines are taken apart;
//! - [`status`]: what a module says about itself;
//! - [`server`]: the thread; [`client`]: the other end of the socket;
//! - [`discovery`]: which modules run on this machine.

pub mod client;
pub mod discovery;
pub mod protocol;
pub mod server;
pub mod status;

pub use client::{AskError, Client};
pub use discovery::{ChooseError, Running, SharedCore, choose, running, shared_cores};
pub use protocol::{Answer, Request};
pub use server::{Inbox, Ordered, Server};
pub use status::{
    ChannelStatus, LINKS_FILE, LastFault, LinkName, Observation, PartitionStatus, Publication, Status,
};

/// The socket's name in the run's directory.
pub const SOCKET: &str = "control";
