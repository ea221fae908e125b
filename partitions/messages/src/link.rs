//! How the links of a relay are: what it publishes for `bateleur links`.
//!
//! A message has room for [`LINKS`] links of [`NETWORKS`] networks each; what belongs to network `n` of link `l` stands at
//! place `l * NETWORKS + n`. Everything counts since the relay's start, which [`LinkStatus::starts`] counts.

use crate::LinkStatus;

/// Links that a relay reports on, most.
pub const LINKS: usize = 8;
/// Networks of a link, most.
pub const NETWORKS: usize = 2;
/// Reasons to refuse a datagram, in the order of [`REASON_NAMES`].
pub const REASONS: usize = 12;

/// Why a relay refuses a datagram: the names of the places in [`LinkStatus::rejected`].
pub const REASON_NAMES: [&str; REASONS] = [
    "truncated",
    "giant",
    "foreign",
    "version",
    "link",
    "key",
    "plan",
    "restart",
    "replay",
    "malformed",
    "channel",
    "stranger",
];

/// [`LinkStatus::state`]: nothing was heard of the peer, or not for too long.
pub const DOWN: u64 = LinkStatus::STATE_DOWN;
/// [`LinkStatus::state`]: both ends hear each other.
pub const UP: u64 = LinkStatus::STATE_UP;
/// [`LinkStatus::state`]: the peer is there, with another plan.
pub const PLAN_DIFFERS: u64 = LinkStatus::STATE_PLAN_DIFFERS;

impl LinkStatus {
    /// The place of network `network` of link `link` in the fields of networks.
    #[must_use]
    pub const fn path(link: usize, network: usize) -> usize {
        link * NETWORKS + network
    }

    /// The place of reason `reason` of link `link` in [`LinkStatus::rejected`].
    #[must_use]
    pub const fn refusal(link: usize, reason: usize) -> usize {
        link * REASONS + reason
    }
}
