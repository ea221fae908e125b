//! What a link costs each of its ends.

use bateleur_contract::packing::{Waiting, datagrams_needed};
use bateleur_contract::relay::{DATAGRAM_OVERHEAD_BYTES, ENTRY_OVERHEAD_BYTES, SENDING_NS};
use bateleur_plan::local::AROUND_A_DATAGRAM;
use serde::Serialize;

use super::closed::Kind;
use super::cycle::most_between;
use super::model::{Channel, Link, LinkId, ModuleId, Plan, Schedule};

/// The message type in which a relay says how its links are.
pub(crate) const STATUS_MESSAGE: &str = "LinkStatus";
/// The smallest `max_bytes`, bytes: half of it is a datagram's own head.
pub const SMALLEST_DATAGRAM: u32 = 2 * DATAGRAM_OVERHEAD_BYTES;
/// The largest, bytes: what UDP over IPv4 carries.
pub const LARGEST_DATAGRAM: u32 = 65_507;
/// The longest bandwidth allocation gap, ms (as ARINC 664 part 7 has it).
pub const LONGEST_GAP_MS: u64 = 128;
/// A channel as its sender's relay sees it.
struct Carried {
    /// The longest message, bytes.
    bytes: u64,
    /// Every message counts, not only the latest.
    queuing: bool,
    /// When the windows of its source start in the major frame, ns.
    writes: Vec<u64>,
}

/// The most that a relay with windows at `starts` has to send in one of them: every latest value, and each message of every
/// queue since its last window, at one message in each window of its source.
fn window_load(carried: &[Carried], starts: &[u64], major_ns: u64) -> Vec<Waiting> {
    let one = |one: &Carried| {
        let count = if one.queuing { most_between(&one.writes, starts, major_ns).max(1) } else { 1 };
        Waiting { bytes: one.bytes, count }
    };
    carried.iter().map(one).collect()
}

/// The bytes of messages with a head for each.
pub(super) fn load_bytes(load: &[Waiting]) -> u64 {
    let head = u64::from(ENTRY_OVERHEAD_BYTES);
    let bytes = |one: &Waiting| one.bytes.saturating_add(head).saturating_mul(one.count);
    load.iter().map(bytes).fold(0, u64::saturating_add)
}

/// The least limit of a datagram with which a load needs no more than `most` of them, bytes; `None` if there is none.
pub(super) fn enough_bytes(load: &[Waiting], most: u64) -> Option<u32> {
    (SMALLEST_DATAGRAM..=LARGEST_DATAGRAM).find(|&bytes| datagrams_needed(load, bytes) <= most)
}

/// How many datagrams of a link a relay may send in a window: one, and others as long as there is time for one more.
fn datagrams_in(window_ns: u64, gap_ns: u64) -> u64 {
    1 + window_ns.saturating_sub(SENDING_NS) / gap_ns.max(1)
}

/// The room of a datagram for messages and their heads, bytes.
fn datagram_room_bytes(max_bytes: u32) -> u64 {
    max_bytes.saturating_sub(DATAGRAM_OVERHEAD_BYTES).into()
}

/// The bandwidth that a link sets aside on each of its networks, bit/s: a datagram of full length in every gap.
pub(super) fn reserved_bits_per_s(max_bytes: u32, gap_ns: u64) -> u64 {
    let bits = (u128::from(max_bytes) + u128::from(AROUND_A_DATAGRAM)) * 8;
    u64::try_from((bits * 1_000_000_000).div_ceil(u128::from(gap_ns.max(1)))).unwrap_or(u64::MAX)
}

/// What a relay sends over a link in one of its windows, at most.
pub(super) struct Sending {
    /// The messages of each channel.
    pub(super) load: Vec<Waiting>,
    /// The datagrams that they need.
    pub(super) datagrams: u64,
    /// Those that the gap lets it send in its shortest window.
    pub(super) most: u64,
}

impl Sending {
    /// Over a link from one of its ends; nothing where no relay has windows, or the link's numbers break a rule.
    pub(super) fn of(plan: &Plan, schedule: &Schedule, id: LinkId, from: ModuleId) -> Option<Self> {
        let (link, relay) = (&plan[id], plan.relay_of(from)?);
        let shortest = schedule.occurrences(relay).iter().map(|(start, end)| end - start).min()?;
        if link.gap_ns == 0 || link.max_bytes < SMALLEST_DATAGRAM {
            return None;
        }
        let carried: Vec<Carried> =
            plan.carried(id, from).map(|channel| carried_of(plan, schedule, &plan[channel])).collect();
        let load = window_load(&carried, &schedule.starts(relay), schedule.major_frame_ns);
        let datagrams = datagrams_needed(&load, link.max_bytes);
        Some(Self { load, datagrams, most: datagrams_in(shortest, link.gap_ns) })
    }
}

/// What a link costs one of its ends in one schedule.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkCost {
    /// The link.
    pub link: String,
    /// The end.
    pub module: String,
    /// The other end.
    pub peer: String,
    /// Channels that it sends.
    pub channels: usize,
    /// The time of the relay's windows in a major frame, ns, for all links of the module together.
    pub relay_ns: u64,
    /// The relay's windows in a major frame.
    pub relay_windows: usize,
    /// The whole cycle, ns.
    pub major_frame_ns: u64,
    /// The most that it has to send in one of them, bytes with the heads of messages.
    pub window_bytes: u64,
    /// The datagrams that this needs at most: messages are not divided to fill one.
    pub window_datagrams: u64,
    /// The datagrams that it may send in the shortest of them.
    pub window_datagrams_most: u64,
    /// The room of each, bytes.
    pub datagram_room_bytes: u64,
    /// The most that a datagram takes to the peer, ns.
    pub latency_ns: u64,
    /// How far apart the major frames of both ends may begin, ns; `None`: anyhow.
    pub aligned_within_ns: Option<u64>,
    /// What it sets aside on each network.
    pub networks: Vec<NetworkShare>,
}

/// What a link sets aside on one network, from one of its ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NetworkShare {
    /// The network.
    pub network: String,
    /// A datagram of full length in every gap, bit/s.
    pub reserved_bits_per_s: u64,
    /// What the network carries, bit/s.
    pub rate_bits_per_s: u64,
}

/// What every link costs each of its ends.
pub(super) fn costs(plan: &Plan, schedule: &Schedule) -> Vec<LinkCost> {
    let ends = (0..plan.links.len()).map(LinkId).flat_map(|id| plan[id].ends.map(|module| (id, module)));
    ends.filter_map(|(id, module)| cost(plan, schedule, id, module)).collect()
}

fn cost(plan: &Plan, schedule: &Schedule, id: LinkId, module: ModuleId) -> Option<LinkCost> {
    let link: &Link = &plan[id];
    let (peer, relay) = (link.peer_of(module)?, plan.relay_of(module)?);
    let own = schedule.occurrences(relay);
    let sending = Sending::of(plan, schedule, id, module)?;
    let reserved = reserved_bits_per_s(link.max_bytes, link.gap_ns);
    let share = |&network: &super::model::NetworkId| NetworkShare {
        network: plan[network].name.clone(),
        reserved_bits_per_s: reserved,
        rate_bits_per_s: plan[network].rate_bits_per_s,
    };
    Some(LinkCost {
        link: link.name.clone(),
        module: plan[module].name.clone(),
        peer: plan[peer].name.clone(),
        channels: sending.load.len(),
        relay_ns: own.iter().map(|(start, end)| end - start).sum(),
        relay_windows: own.len(),
        major_frame_ns: schedule.major_frame_ns,
        window_bytes: load_bytes(&sending.load),
        window_datagrams: sending.datagrams,
        window_datagrams_most: sending.most,
        datagram_room_bytes: datagram_room_bytes(link.max_bytes),
        latency_ns: plan.latency_ns(id),
        aligned_within_ns: plan.aligned_within_ns(module, peer),
        networks: link.networks.iter().map(share).collect(),
    })
}

fn carried_of(plan: &Plan, schedule: &Schedule, channel: &Channel) -> Carried {
    let source = &plan[channel.source];
    Carried {
        bytes: source.payload.max_size_bytes() as u64,
        queuing: channel.kind == Kind::Queuing,
        writes: schedule.starts(source.partition),
    }
}
