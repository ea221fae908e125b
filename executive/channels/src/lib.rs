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
use bateleur_ports::{Channel, ChannelError, ChannelType, Domain, Handed, Membership, Reader, Writer};
use bateleur_system::handed_over::copy_of_inherited;

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

/// Attaches to a channel as somebody who looks at it, called `name`. What comes beside the reading end keeps the channel.
///
/// # Errors
/// It is not there, or can not be attached to.
pub fn observe(
    domain: &Domain,
    ordered: &OrderedChannel,
    name: &str,
) -> Result<(Reader, Channel, Option<Membership>), ChannelError> {
    let kind = channel_type(ordered);
    if let Some(channel) = handed(ordered)? {
        return Ok((kind.observer(&channel)?, channel, None));
    }
    let kind = if kind.depth.is_some() { kind.observed() } else { kind };
    let node = join(domain, kind.home(), name)?;
    let channel = kind.open(&node)?;
    Ok((kind.observer(&channel)?, channel, Some(node)))
}

/// Attaches to a channel as its source, called `name`: the writing end, that of the twin on which observers see a queue, and what keeps
/// both.
///
/// # Errors
/// As above.
pub fn publish(
    domain: &Domain,
    ordered: &OrderedChannel,
    name: &str,
) -> Result<(Writer, Option<Writer>, Option<Membership>), ChannelError> {
    let kind = channel_type(ordered);
    if let Some(channel) = handed(ordered)? {
        return Ok((kind.writer(&channel)?, None, None));
    }
    let node = join(domain, kind.home(), name)?;
    let writer = kind.writer(&kind.open(&node)?)?;
    let twin = kind.depth.map(|_| kind.observed());
    let twin = twin.map(|twin| twin.writer(&twin.open(&node)?)).transpose()?;
    Ok((writer, twin, Some(node)))
}

/// A sealed channel's memory, which the executive handed over.
fn handed(ordered: &OrderedChannel) -> Result<Option<Channel>, ChannelError> {
    let Some(at) = ordered.sealed else { return Ok(None) };
    let lost = |reason| ChannelError::Attach { channel: ordered.name.clone(), reason };
    let ring = copy_of_inherited(at.ring).map_err(lost)?;
    let index = at.index.map(copy_of_inherited).transpose().map_err(lost)?;
    Ok(Some(Channel::Sealed(Handed { ring, index, checked: at.checked, incarnation: 0 })))
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
