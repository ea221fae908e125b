//! Helpers of the executive that touch what partitions may have damaged: memory and files of channels. Each is a process of the program
//! `bateleur_channels`, never the executive itself, and runs as a user that owns nothing else.
//!
//! - the [`channel_holder`] creates the module's channels before frame 0 and holds them;
//! - a [`channel_cleaner`] removes what a dead partition left in shared memory, and ends;
//! - a [`channel_probe`] finds out which channels are damaged, and ends.
//!
//! One that meets a bad channel leaves that one out, says which, and serves the others. None may work on when the executive is gone,
//! or when the run's directory is: the library makes what it misses, and nobody would remove it.

use bateleur_host::helper::orders::OrderedChannel;
use bateleur_ports::{ChannelError, ChannelType, Domain, Membership};

pub mod channel_cleaner;
pub mod channel_holder;
pub mod channel_probe;

/// Joins a channel whose directory is there.
///
/// # Errors
/// It is not there, is none, or can not be joined.
pub fn join(domain: &Domain, home: &str, name: &str) -> Result<Membership, ChannelError> {
    match std::fs::symlink_metadata(domain.directory(home)) {
        Ok(about) if about.is_dir() => domain.join(home, name),
        _ => Err(ChannelError::Absent(home.to_owned())),
    }
}

/// What lies in shared memory for a channel.
#[must_use]
pub fn channel_type(ordered: &OrderedChannel) -> ChannelType {
    ChannelType {
        name: ordered.name.clone(),
        message: ordered.message.clone(),
        size: ordered.size,
        depth: ordered.depth,
        destinations: ordered.destinations,
        spare_writers: ordered.spare_writers,
        spare_readers: ordered.spare_readers,
    }
}
