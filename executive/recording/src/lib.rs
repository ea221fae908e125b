//! The log of the ports: one MCAP file with one channel for each source port.
//!
//! [`PortLog`] writes it while the module runs, [`for_each`] and [`read`] take it apart afterwards. Payloads are
//! CDR (four bytes of header, then the message as it lies in the port) and schemas are ROS 2 message definitions, so that
//! other people's viewers show the values by name. [`hosts`] says which folders a run on several hosts has left, and
//! [`windows`] and [`processes`] read the logs of windows and of the processes in them.
//!
//! The one thing it must never do: take a log that is damaged or cut short for a whole one.

#![forbid(unsafe_code)]

pub mod hosts;
mod layout;
pub mod processes;
mod read;
mod tail;
pub mod windows;
mod write;

pub use bateleur_messages::format::Scalar;
pub use layout::{Layout, values, word_of};
pub use read::{Ending, Entry, LogReader, Recording, Track, for_each, read};
pub use tail::Tail;
pub use write::{ChannelId, PortLog, topic};

use std::path::PathBuf;
use thiserror::Error;

/// The log of the ports, in a run's folder.
pub const PORTS_FILE: &str = "ports.mcap";
/// Header of a little-endian CDR payload.
pub const CDR_HEADER: [u8; 4] = [0, 1, 0, 0];
/// Encoding of the payloads.
pub const MESSAGE_ENCODING: &str = "cdr";
/// Encoding of the schemas.
pub const SCHEMA_ENCODING: &str = "ros2msg";

/// Why a log could not be written or read.
#[derive(Debug, Error)]
pub enum LogError {
    /// The file system refused.
    #[error("{}: {why}", path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        why: std::io::Error,
    },
    /// The container refused.
    #[error("{}: {why}", path.display())]
    Container {
        /// Which file.
        path: PathBuf,
        /// What was wrong.
        why: mcap::McapError,
    },
    /// A message of another size than its type.
    #[error("a {message} on {topic} has {found} bytes where {expected} belong")]
    Size {
        /// The channel's topic.
        topic: String,
        /// The message type.
        message: String,
        /// Bytes given.
        found: usize,
        /// Bytes of the type.
        expected: usize,
    },
    /// A channel number that this log never gave out.
    #[error("channel {0} was never added to this log")]
    UnknownChannel(usize),
}

impl LogError {
    /// Whether the disk has no room for more.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let (Self::File { why, .. } | Self::Container { why: mcap::McapError::Io(why), .. }) = self else {
            return false;
        };
        matches!(why.kind(), std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded)
    }
}
