//! What a link has counted since its relay's start.

use bateleur_messages::link::{NETWORKS, REASONS};

use crate::wire::Rejection;

/// Counters of one link.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Lives of the peer that were met.
    pub peer_lives: u64,
    /// Messages that were sent, all their pieces.
    pub messages_sent: u64,
    /// Messages that came in whole.
    pub messages_received: u64,
    /// Messages of the peer that did not come, or not all of their pieces, as far as later ones show.
    pub messages_lost: u64,
    /// Messages that came after a newer one had been handed on: dropped.
    pub messages_late: u64,
    /// Messages for which a queue here was full.
    pub messages_overflowed: u64,
    /// Datagrams that came on no network, as far as later ones show.
    pub datagrams_lost: u64,
    /// By reason.
    pub rejected: [u64; REASONS],
    /// By network.
    pub networks: [NetworkCounters; NETWORKS],
}

/// Counters of one network of a link.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NetworkCounters {
    /// Datagrams that were handed to the transport.
    pub sent: u64,
    /// Datagrams that the transport could not send.
    pub unsent: u64,
    /// Datagrams that came, of any kind.
    pub received: u64,
    /// Datagrams of the peer that did not come here, as far as later ones show.
    pub lost: u64,
    /// Copies beyond the skew limit.
    pub late: u64,
    /// Datagrams that had come here before.
    pub duplicated: u64,
    /// Datagrams that had come on another network before.
    pub redundant: u64,
    /// Datagrams that came after a later one.
    pub reordered: u64,
}

impl LinkCounters {
    /// Refused datagrams for one reason.
    #[must_use]
    pub fn rejections(&self, reason: Rejection) -> u64 {
        self.rejected[reason as usize]
    }

    /// All refused datagrams.
    #[must_use]
    pub fn all_rejections(&self) -> u64 {
        self.rejected.iter().sum()
    }
}
