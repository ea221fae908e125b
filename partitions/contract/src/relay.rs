//! What a relay is told about the links of its module: which channels cross, over which networks, in which bounds.
//!
//! Responsible for: the table that the executive writes and the relay reads, as JSON in the relay's description under
//! the attribute [`ATTRIBUTE`], and the layout of the keys behind [`RELAY_KEYS_FD`]. It must never hold a key:
//! descriptions are readable where keys must not be.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use crate::description::PortKind;

/// The name of the attribute that holds the [`RelayTable`].
pub const ATTRIBUTE: &str = "relay";
/// The name of the attribute that holds a [`LinkModelTable`]; absent: datagrams travel as they do.
pub const MODEL_ATTRIBUTE: &str = "link_model";
/// The transport for modules that share a virtual clock, see [`RelayTable::transport`].
pub const STEPPED: &str = "stepped";
/// The relay's own sampling source on which it says how its links are.
pub const STATUS_PORT: &str = "status";
/// Descriptor of the keys in a relay: [`KEY_BYTES`] for each link, in the order of the table; zeros for a link that is
/// not authenticated.
pub const RELAY_KEYS_FD: i32 = 6;
/// Bytes of a link's key.
pub const KEY_BYTES: usize = 32;
/// What a datagram has beside its messages, bytes, at most: its head, the exchange of time, the tag. The plan counts room
/// with it; a relay keeps below it.
pub const DATAGRAM_OVERHEAD_BYTES: u32 = 128;
/// What a message has beside its own bytes, at most: its head, for each piece if it was split. Counted as above.
pub const ENTRY_OVERHEAD_BYTES: u32 = 32;
/// What a relay takes at most to make a datagram and send it on a link's networks, ns: in the last part of a window that is as long
/// it begins none, and the plan counts with it.
pub const SENDING_NS: u64 = 100_000;
/// Datagrams that a relay takes out of its sockets in a window, most; each network of each link has the same share. A flood on one
/// network can not eat the window: what is more waits in the socket until it overflows, and the network counts as what it
/// is, unusable.
pub const TAKEN_IN_A_WINDOW: usize = 64;
/// The share of a network of a link is not smaller, however many there are.
pub const LEAST_SHARE: usize = 8;

/// What a relay with so many networks of links, counted for each link, takes of one of them in a window, datagrams.
#[must_use]
pub fn share_of_a_window(endpoints: usize) -> usize {
    (TAKEN_IN_A_WINDOW / endpoints.max(1)).max(LEAST_SHARE)
}

/// Links of a module, most: a relay reports on so many.
pub const MOST_LINKS: usize = 8;
/// Digits of the plan's digest, hexadecimal.
pub const DIGEST_DIGITS: usize = 64;

/// Everything that the relay of one module has to know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelayTable {
    /// The module whose relay it is.
    pub module: String,
    /// What both ends of a link have to agree on, as [`DIGEST_DIGITS`] hexadecimal digits: of the whole plan, without
    /// keys and comments.
    pub digest: String,
    /// Digests of parts of the plan by name, so that two relays whose plans differ can say where: any text that is the
    /// same for the same part. What the table itself holds needs none.
    #[serde(default)]
    pub sections: BTreeMap<String, String>,
    /// By which transport datagrams travel: `udp`, [`STEPPED`], or another that the relay was built with.
    pub transport: String,
    /// The links of this module, in the order of the plan.
    pub links: Vec<LinkTable>,
}

/// One link: a pair of modules, and what they say to each other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkTable {
    /// Its name in the plan.
    pub name: String,
    /// Its number: the same at both ends, and no other link of the plan has it.
    pub id: u16,
    /// The module at the other end.
    pub peer: String,
    /// This end is the one that the plan names first.
    pub initiator: bool,
    /// Every datagram carries a tag made with the link's key; false only where the plan says so by a key of its own.
    pub authenticated: bool,
    /// The bandwidth allocation gap: from the start of one datagram on a network to the start of the next, at least, ns.
    /// A power of two of milliseconds.
    pub gap_ns: u64,
    /// The longest datagram, bytes: what one UDP datagram carries as payload.
    pub max_datagram: u32,
    /// How much later than the first a copy may come on the other network and still be a copy, ns.
    pub skew_ns: u64,
    /// After so much silence a network counts as down, ns.
    pub lost_after_ns: u64,
    /// Who keeps the major frame that the other one follows.
    pub clock: ClockRole,
    /// The networks that carry the link: one, or two that carry the same.
    pub paths: Vec<PathTable>,
    /// What crosses here, both ways, by rising number.
    pub channels: Vec<RelayChannel>,
}

/// This end's part in aligning the major frames of both ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockRole {
    /// The other end follows this one's major frame.
    Leader,
    /// This end's major frame follows the other one's.
    Follower,
    /// Neither follows the other.
    None,
}

/// One network of a link, as seen from here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathTable {
    /// Its name in the plan.
    pub network: String,
    /// Where this end listens and sends from.
    pub local: SocketAddr,
    /// Where the other end does.
    pub remote: SocketAddr,
    /// The most that a datagram of full length takes on it, as the plan says, ns: one that takes longer is told. 0: nothing is
    /// said.
    #[serde(default)]
    pub latency_ns: u64,
}

/// One channel that crosses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelayChannel {
    /// Its number: the same at both ends of the link.
    pub id: u16,
    /// The channel's source as the plan writes it, `estimator.state`: for counters and messages.
    pub name: String,
    /// The port of this relay that it is attached to.
    pub port: String,
    /// From here to the peer; false: from the peer to here.
    pub outgoing: bool,
    /// The latest value, or messages in order.
    pub kind: PortKind,
    /// Bytes without a message type.
    #[serde(default)]
    pub plain: bool,
    /// The longest message, bytes; for sampling each one's length, unless they are plain bytes.
    pub max_bytes: u32,
    /// Queuing: messages that wait at most on either side; sampling: 1.
    pub depth: u32,
    /// The longest time between two messages of the source when it writes in every window, ns; 0: not known.
    pub period_ns: u64,
}

/// What a modelled network does to the datagrams that this end sends: the same seed does the same to the same datagrams.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinkModelTable {
    /// What is drawn follows from this, the link, the network and the direction.
    pub seed: u64,
    /// Time on the way, ns.
    pub delay_ns: u64,
    /// Added to it, evenly between 0 and this, ns. Datagrams overtake each other where it is longer than the time between
    /// them.
    pub jitter_ns: u64,
    /// Share of datagrams that get lost, 0 to 1.
    pub loss: f64,
    /// Share of those that arrive twice, 0 to 1.
    pub duplicate: f64,
    /// Share of those that are held up by [`LinkModelTable::reorder_ns`] beside the delay, 0 to 1.
    pub reorder: f64,
    /// See [`LinkModelTable::reorder`], ns.
    pub reorder_ns: u64,
    /// What the network carries, bit/s; 0: as much as comes.
    pub rate_bps: u64,
    /// Stretches of time in which a network carries nothing.
    pub cuts: Vec<CutTable>,
}

/// A network that is cut for a while.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CutTable {
    /// The network's name in the plan.
    pub network: String,
    /// From this module time on, ns.
    pub from_ns: u64,
    /// Until this one, ns.
    pub until_ns: u64,
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_table_survives_the_way_through_a_description() {
        let table = RelayTable {
            module: "fcu".into(),
            digest: "ab".repeat(DIGEST_DIGITS / 2),
            sections: BTreeMap::from([("module.nav".into(), "cd".into())]),
            transport: "udp".into(),
            links: vec![LinkTable {
                name: "bus".into(),
                id: 0,
                peer: "nav".into(),
                initiator: true,
                authenticated: true,
                gap_ns: 4_000_000,
                max_datagram: 1472,
                skew_ns: 2_000_000,
                lost_after_ns: 100_000_000,
                clock: ClockRole::Leader,
                paths: vec![PathTable {
                    network: "a".into(),
                    local: "10.77.0.1:15300".parse().unwrap(),
                    remote: "[fd00::2]:15300".parse().unwrap(),
                    latency_ns: 623_000,
                }],
                channels: vec![RelayChannel {
                    id: 3,
                    name: "estimator.state".into(),
                    port: "estimator-state".into(),
                    outgoing: false,
                    kind: PortKind::Sampling,
                    plain: false,
                    max_bytes: 128,
                    depth: 1,
                    period_ns: 20_000_000,
                }],
            }],
        };
        let value = serde_json::to_value(&table).unwrap();
        assert_eq!(value["links"][0]["clock"], "leader");
        assert_eq!(serde_json::from_value::<RelayTable>(value).unwrap(), table);
    }

    #[test]
    fn a_key_in_the_table_is_refused() {
        let said = r#"{"module":"fcu","digest":"","transport":"udp","links":[],"key":"00"}"#;
        assert!(serde_json::from_str::<RelayTable>(said).is_err());
    }
}
