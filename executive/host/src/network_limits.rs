//! What bounds a partition with the network: how many sockets it has, and to how many addresses it sends. Both are kept by programs
//! inside the kernel, which need control groups of version 2 and root.

use std::io;

use bateleur_system::cgroup::Group;
use bateleur_system::destinations::Destinations;
use bateleur_system::sockets::SocketPlaces;

/// Addresses to which a partition may send over its life, a relay too: 8 links of two networks each, with a group and some computers.
pub(crate) const MOST_ADDRESSES: usize = 64;

/// The limits of one control group.
#[derive(Debug)]
pub(crate) struct NetworkLimits {
    sockets: SocketPlaces,
    destinations: Destinations,
}

impl NetworkLimits {
    pub(crate) fn of(group: &Group, sockets: usize) -> io::Result<Self> {
        Ok(Self {
            sockets: SocketPlaces::limit(group.as_fd(), sockets)?,
            destinations: Destinations::limit(group.as_fd(), MOST_ADDRESSES)?,
        })
    }

    /// Nothing is used up: for a group whose processes have ended.
    pub(crate) fn clear(&self) -> io::Result<()> {
        self.sockets.clear()?;
        self.destinations.clear()
    }
}
