//! How the links of a relay are: what it publishes for `bateleur links`.
//!
//! A message has room for [`LINKS`] links of [`NETWORKS`] networks each; what belongs to network `n` of link `l` stands at
//! place `l * NETWORKS + n`. Everything counts since the relay's start, which [`LinkStatus::starts`] counts.

use crate::field::message;

/// Links that a relay reports on, most.
pub const LINKS: usize = 8;
/// Networks of a link, most.
pub const NETWORKS: usize = 2;
/// Reasons to refuse a datagram, in the order of [`REASON_NAMES`].
pub const REASONS: usize = 12;
const PATHS: usize = LINKS * NETWORKS;
const REFUSALS: usize = LINKS * REASONS;

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
pub const DOWN: u64 = 0;
/// [`LinkStatus::state`]: both ends hear each other.
pub const UP: u64 = 1;
/// [`LinkStatus::state`]: the peer is there, with another plan.
pub const PLAN_DIFFERS: u64 = 2;

message! {
    /// Counters and states of all links of one relay.
    pub struct LinkStatus {
        /// Module time, ns.
        pub time_ns: u64,
        /// Incarnations of the relay, this one included.
        pub starts: u64,
        /// Links in use, at most 8: places behind are zero.
        pub links: u64,
        /// The link's number in the plan.
        pub id: [u64; LINKS],
        /// 0 down, 1 up, 2 the peer has another plan.
        pub state: [u64; LINKS],
        /// Lives of the peer's relay that were met.
        pub peer_lives: [u64; LINKS],
        /// Messages that were sent.
        pub messages_sent: [u64; LINKS],
        /// Messages that came in whole.
        pub messages_received: [u64; LINKS],
        /// Messages that were sent to here and did not come, as far as later ones have shown.
        pub messages_lost: [u64; LINKS],
        /// Messages that came after a newer one had been handed on: dropped.
        pub messages_late: [u64; LINKS],
        /// Messages for which a queue here was full.
        pub messages_overflowed: [u64; LINKS],
        /// Datagrams of the peer that came on no network, as far as later ones have shown.
        pub datagrams_lost: [u64; LINKS],
        /// The peer's module time less the own one, ns; nothing without an exchange.
        pub offset_ns: [f64; LINKS],
        /// How wrong that may be, ns.
        pub uncertainty_ns: [f64; LINKS],
        /// The shortest way there and back of late, ns.
        pub round_trip_ns: [f64; LINKS],
        /// Exchanges of time so far.
        pub exchanges: [u64; LINKS],
        /// 1 while the peer is heard on this network.
        pub up: [u64; PATHS],
        /// When the peer was heard on it last, module time, ns; 0: never.
        pub heard_ns: [u64; PATHS],
        /// Datagrams that were sent.
        pub sent: [u64; PATHS],
        /// Datagrams that could not be sent.
        pub unsent: [u64; PATHS],
        /// Datagrams that came, of any kind.
        pub received: [u64; PATHS],
        /// Datagrams of the peer that did not come on this network, as far as later ones have shown.
        pub lost: [u64; PATHS],
        /// Copies that came later than the skew limit allows.
        pub late: [u64; PATHS],
        /// Datagrams that had come on the same network before.
        pub duplicated: [u64; PATHS],
        /// Datagrams that had come on another network before.
        pub redundant: [u64; PATHS],
        /// Datagrams that came after a later one of the same network.
        pub reordered: [u64; PATHS],
        /// The longest that a datagram was on its way within the last second or two, ns, as far as the clocks of both ends are
        /// known; 0: nothing was measured.
        pub latency_ns: [f64; PATHS],
        /// The longest that it may be, as the plan says, ns; 0: nothing is said.
        pub allowed_ns: [f64; PATHS],
        /// Refused datagrams, by reason: truncated, giant, foreign, version, link, key, plan, restart, replay, malformed,
        /// channel, stranger; 12 for each link.
        pub rejected: [u64; REFUSALS],
    }
}

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
