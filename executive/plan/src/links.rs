//! From one plan for all modules to what each of them runs: the local plan, the table of its relay, the digest that both
//! ends compare, and what a link costs.
//!
//! All of it is computed from the checked plan and nothing else, so that two hosts with the same file agree without a
//! word. It must never look at the machine, nor hold a key.

use std::collections::BTreeMap;

use bateleur_contract::packing::{Waiting, datagrams_needed};
use bateleur_contract::relay::{DATAGRAM_OVERHEAD_BYTES, ENTRY_OVERHEAD_BYTES, SENDING_NS, STATUS_PORT};
use bateleur_contract::{ClockRole, LinkTable, PathTable, PortKind, RelayChannel, RelayTable};
use serde::Serialize;

use super::closed::{Closed, Kind};
use super::facts::windows;
use super::latency::Hop;
use super::model::{
    Channel, ChannelId, Link, LinkId, ModuleId, PartitionId, Plan, Port, PortId, Protection, Role, Schedule,
};

/// The message type in which a relay says how its links are.
pub(crate) const STATUS_MESSAGE: &str = "LinkStatus";
/// The smallest `max_bytes`, bytes: half of it is a datagram's own head.
pub const SMALLEST_DATAGRAM: u32 = 2 * DATAGRAM_OVERHEAD_BYTES;
/// The largest, bytes: what UDP over IPv4 carries.
pub const LARGEST_DATAGRAM: u32 = 65_507;
/// The longest bandwidth allocation gap, ms (as ARINC 664 part 7 has it).
pub const LONGEST_GAP_MS: u64 = 128;
/// What a datagram has around it on an Ethernet, bytes, at most: preamble 8, head 14, check 4 and gap 12 of the frame,
/// 40 of IPv6, 8 of UDP.
const AROUND_A_DATAGRAM: u64 = 86;
/// Age up to which a relay takes a value: it passes on whatever there is, with its time, and the reader judges.
const ANY_AGE_NS: u64 = i64::MAX as u64;

/// A channel as its sender's relay sees it.
pub(super) struct Carried {
    /// The longest message, bytes.
    pub(super) bytes: u64,
    /// Every message counts, not only the latest.
    pub(super) queuing: bool,
    /// When the windows of its source start in the major frame, ns.
    pub(super) writes: Vec<u64>,
}

/// The most that a relay with windows at `starts` has to send in one of them: every latest value, and each message of every
/// queue since its last window, at one message in each window of its source.
pub(super) fn window_load(carried: &[Carried], starts: &[u64], major_ns: u64) -> Vec<Waiting> {
    let most = |writes: &[u64]| {
        let since = |(place, &start): (usize, &u64)| {
            let before = starts[(place + starts.len() - 1) % starts.len()];
            let span = (start + major_ns - before) % major_ns.max(1);
            let span = if span == 0 { major_ns } else { span };
            writes.iter().filter(|&&write| (write + major_ns - before) % major_ns.max(1) < span).count()
        };
        starts.iter().enumerate().map(since).max().unwrap_or(0) as u64
    };
    let one = |one: &Carried| {
        let count = if one.queuing { most(&one.writes).max(1) } else { 1 };
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
pub(super) fn datagrams_in(window_ns: u64, gap_ns: u64) -> u64 {
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

/// How long the longest datagram takes to pass a point of a network, ns; 0 where its rate is not known.
pub(super) fn time_on_the_wire_ns(max_bytes: u32, rate_bits_per_s: u64) -> u64 {
    let bits = (u128::from(max_bytes) + u128::from(AROUND_A_DATAGRAM)) * 8;
    let time = (bits * 1_000_000_000).checked_div(u128::from(rate_bits_per_s));
    time.and_then(|time| u64::try_from(time).ok()).unwrap_or_default()
}

/// The partitions of a path with the relays between them, and how the value comes to each; nothing where modules are not
/// joined.
pub(super) fn legs(plan: &Plan, stations: &[PartitionId]) -> Option<Vec<(PartitionId, Option<Hop>)>> {
    let mut legs: Vec<(PartitionId, Option<Hop>)> = Vec::new();
    for &partition in stations {
        let module = plan[partition].module;
        if let Some(from) = legs.last().map(|before| plan[before.0].module).filter(|&from| from != module) {
            let link = plan.link_between(from, module)?;
            let aligned_within_ns = plan.aligned_within_ns(from, module);
            let beside_first_ns = match plan[stations.first().copied()?].module {
                first if first == module => 0,
                first => plan.aligned_within_ns(first, module).or(aligned_within_ns).unwrap_or(0),
            };
            let hop = Hop { latency_ns: plan.latency_ns(link), aligned_within_ns, beside_first_ns };
            legs.push((plan.relay_of(from)?, None));
            legs.push((plan.relay_of(module)?, Some(hop)));
        }
        legs.push((partition, None));
    }
    Some(legs)
}

impl Plan {
    /// The most that a datagram of a link takes, ns: on the slowest of its networks, which may be the one that is left.
    #[must_use]
    pub fn latency_ns(&self, link: LinkId) -> u64 {
        let link = &self[link];
        let on = |network: &super::model::Network| {
            let wire_ns = time_on_the_wire_ns(link.max_bytes, network.rate_bits_per_s);
            network.latency_ns.saturating_add(wire_ns)
        };
        link.networks.iter().map(|&network| on(&self[network])).max().unwrap_or_default()
    }

    /// The channels that a link carries from one of its ends to the other, in the order of the file.
    pub fn carried(&self, link: LinkId, from: ModuleId) -> impl Iterator<Item = ChannelId> + use<'_> {
        let to = self[link].peer_of(from);
        self.channel_ids().filter(move |&id| {
            let channel = &self[id];
            let module = |port: PortId| self[self[port].partition].module;
            module(channel.source) == from
                && channel.destinations.iter().any(|&port| Some(module(port)) == to)
        })
    }

    /// What two hosts have to agree on, as 64 hexadecimal digits: the whole checked plan, of all modules, without what each
    /// host may choose for itself (where it keeps its keys).
    ///
    /// # Errors
    /// Never, for a plan that was read from a file: the plan could not be written down.
    pub fn digest(&self) -> Result<String, serde_json::Error> {
        // Lists in the order of the file, tables in that of their keys: the same text for the same plan.
        Ok(blake3::hash(&serde_json::to_vec(self)?).to_hex().to_string())
    }

    /// Digests of parts of the plan, by what a person calls them: where those of two hosts differ, their plans do.
    fn sections(&self) -> Result<BTreeMap<String, String>, serde_json::Error> {
        let mut sections = BTreeMap::new();
        for module in &self.modules {
            sections.insert(format!("module {}", module.name), short_digest(module)?);
        }
        for partition in self.partitions.iter().filter(|partition| !partition.relay) {
            let ports: Vec<&Port> = partition.ports.iter().map(|&port| &self[port]).collect();
            sections.insert(format!("partition {}", partition.name), short_digest(&(partition, ports))?);
        }
        for schedule in &self.schedules {
            sections.insert(format!("schedule {}", schedule.name), short_digest(schedule)?);
        }
        sections.insert("networks".to_owned(), short_digest(&self.networks)?);
        sections.insert("links".to_owned(), short_digest(&self.links)?);
        sections.insert("channels".to_owned(), short_digest(&self.channels)?);
        sections.insert("chains".to_owned(), short_digest(&self.chains)?);
        sections.insert("health".to_owned(), short_digest(&self.health)?);
        Ok(sections)
    }

    /// The plan as one module runs it: every channel that crosses leads to its relay, or from it, as one of the module's own.
    /// Everything else is as it was, with the same places in all lists.
    #[must_use]
    pub fn local(&self, module: ModuleId) -> Self {
        let mut local = self.clone();
        let Some(relay) = self.relay_of(module) else { return local };
        for id in self.channel_ids() {
            let source = self[id].source;
            if self[self[source].partition].module == module {
                self.lead_out(&mut local, id, relay);
            } else {
                self.lead_in(&mut local, id, relay);
            }
        }
        // What the relay says of its links is read by whoever asks, and recorded, as any other channel.
        let status = self[relay].ports.iter().copied().find(|&port| self[port].name == STATUS_PORT);
        if let Some(source) = status {
            let kind = Kind::Sampling;
            local.ports[source.0].channel = Some(ChannelId(local.channels.len()));
            local.channels.push(Channel { source, destinations: Vec::new(), kind });
        }
        local
    }

    /// The destinations on other modules become ports of the relay, one for each link.
    fn lead_out(&self, local: &mut Self, id: ChannelId, relay: PartitionId) {
        let channel = &self[id];
        let module = self[relay].module;
        let is_here = |port: &PortId| self[self[*port].partition].module == module;
        let mut destinations: Vec<PortId> = channel.destinations.iter().copied().filter(is_here).collect();
        for link in self.links_of(module) {
            if !self.carried(link, module).any(|carried| carried == id) {
                continue;
            }
            let role = match channel.kind {
                Kind::Sampling => Role::SamplingDestination { refresh_ns: ANY_AGE_NS },
                Kind::Queuing => Role::QueuingDestination { depth: self.depth(channel) },
            };
            let name = self.out_port(id, link);
            destinations.push(local.add_port(name, relay, role, (channel.source, id)));
        }
        local.channels[id.0].destinations = destinations;
    }

    /// The source on another module becomes a port of the relay.
    fn lead_in(&self, local: &mut Self, id: ChannelId, relay: PartitionId) {
        let channel = &self[id];
        let module = self[relay].module;
        let is_here = |port: &PortId| self[self[*port].partition].module == module;
        let destinations: Vec<PortId> = channel.destinations.iter().copied().filter(is_here).collect();
        if destinations.is_empty() {
            return; // between others, or away from here
        }
        let role = match channel.kind {
            Kind::Sampling => Role::SamplingSource,
            Kind::Queuing => Role::QueuingSource,
        };
        let source = local.add_port(self.in_port(id), relay, role, (channel.source, id));
        local.channels[id.0] = Channel { source, destinations, kind: channel.kind };
    }

    fn add_port(
        &mut self,
        name: String,
        owner: PartitionId,
        role: Role,
        (like, channel): (PortId, ChannelId),
    ) -> PortId {
        let id = PortId(self.ports.len());
        let payload = self[like].payload.clone();
        self.ports.push(Port { name, partition: owner, role, payload, channel: Some(channel) });
        self.partitions[owner.0].ports.push(id);
        id
    }

    /// The relay's port through which a channel comes in.
    fn in_port(&self, channel: ChannelId) -> String {
        self.port_path(self[channel].source)
    }

    /// The relay's port through which a channel goes out over a link.
    fn out_port(&self, channel: ChannelId, link: LinkId) -> String {
        format!("{}.{}", self.port_path(self[channel].source), self[link].name)
    }

    fn depth(&self, channel: &Channel) -> u32 {
        let depth = |&port: &PortId| match self[port].role {
            Role::QueuingDestination { depth } => Some(depth),
            _ => None,
        };
        channel.destinations.iter().find_map(depth).unwrap_or(1)
    }

    /// What the relay of a module is told; none where nothing crosses there.
    ///
    /// # Errors
    /// As [`Plan::digest`].
    pub fn relay_table(&self, module: ModuleId) -> Result<Option<RelayTable>, serde_json::Error> {
        if self.relay_of(module).is_none() {
            return Ok(None);
        }
        let links: Vec<LinkId> = self.links_of(module).collect();
        let transport = links.first().map_or("", |&link| self[link].transport.name());
        Ok(Some(RelayTable {
            module: self[module].name.clone(),
            digest: self.digest()?,
            sections: self.sections()?,
            transport: transport.to_owned(),
            links: links.into_iter().filter_map(|link| self.link_table(link, module)).collect(),
        }))
    }

    fn link_table(&self, id: LinkId, module: ModuleId) -> Option<LinkTable> {
        let link = &self[id];
        let peer = link.peer_of(module)?;
        let path = |&network: &super::model::NetworkId| {
            Some(PathTable {
                network: self[network].name.clone(),
                local: self[module].address_on(network)?,
                remote: self[peer].address_on(network)?,
                latency_ns: self[network]
                    .latency_ns
                    .saturating_add(time_on_the_wire_ns(link.max_bytes, self[network].rate_bits_per_s)),
            })
        };
        Some(LinkTable {
            name: link.name.clone(),
            id: u16::try_from(id.0).ok()?,
            peer: self[peer].name.clone(),
            initiator: link.ends[0] == module,
            authenticated: matches!(link.protection, Protection::Key { .. }),
            gap_ns: link.gap_ns,
            max_datagram: link.max_bytes,
            skew_ns: link.skew_ns,
            lost_after_ns: link.lost_after_ns,
            clock: match (self[module].follows, self[peer].follows) {
                (Some(leader), _) if leader == peer => ClockRole::Follower,
                (_, Some(leader)) if leader == module => ClockRole::Leader,
                _ => ClockRole::None,
            },
            paths: link.networks.iter().filter_map(path).collect(),
            channels: self.relay_channels(id, module, peer)?,
        })
    }

    fn relay_channels(&self, link: LinkId, module: ModuleId, peer: ModuleId) -> Option<Vec<RelayChannel>> {
        let outgoing = self.carried(link, module).map(|id| (id, true));
        let mut all: Vec<(ChannelId, bool)> =
            outgoing.chain(self.carried(link, peer).map(|id| (id, false))).collect();
        all.sort_unstable();
        let channel = |(id, outgoing): (ChannelId, bool)| {
            let channel = &self[id];
            Some(RelayChannel {
                // The place in the file: the same for whoever reads the file.
                id: u16::try_from(id.0).ok()?,
                name: self.port_path(channel.source),
                port: if outgoing { self.out_port(id, link) } else { self.in_port(id) },
                outgoing,
                kind: match channel.kind {
                    Kind::Sampling => PortKind::Sampling,
                    Kind::Queuing => PortKind::Queuing,
                },
                max_bytes: u32::try_from(self[channel.source].payload.max_size_bytes()).ok()?,
                depth: match channel.kind {
                    Kind::Sampling => 1,
                    Kind::Queuing => self.depth(channel),
                },
                period_ns: self.longest_period_ns(self[channel.source].partition),
            })
        };
        all.into_iter().map(channel).collect()
    }

    /// The longest time between two windows of a partition in any schedule that runs it, ns; 0 where none does.
    fn longest_period_ns(&self, partition: PartitionId) -> u64 {
        let periods = self.schedules.iter().flat_map(|schedule| {
            let starts = starts(schedule, partition);
            super::rules::gaps(&starts, schedule.major_frame_ns).max()
        });
        periods.max().unwrap_or_default()
    }
}

fn starts(schedule: &Schedule, partition: PartitionId) -> Vec<u64> {
    let mut starts: Vec<u64> = windows(schedule, partition).into_iter().map(|window| window.0).collect();
    starts.sort_unstable();
    starts
}

/// Enough digits to tell parts of two plans apart: what guards is the digest of the whole.
const SHORT_DIGITS: usize = 16;

fn short_digest(part: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut digest = blake3::hash(&serde_json::to_vec(part)?).to_hex().to_string();
    digest.truncate(SHORT_DIGITS);
    Ok(digest)
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
    let own = windows(schedule, relay);
    let shortest = own.iter().map(|(start, end)| end - start).min()?;
    let carried: BTreeMap<ChannelId, Carried> = plan
        .carried(id, module)
        .map(|channel| (channel, carried_of(plan, schedule, &plan[channel])))
        .collect();
    let carried: Vec<Carried> = carried.into_values().collect();
    let load = window_load(&carried, &starts(schedule, relay), schedule.major_frame_ns);
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
        channels: carried.len(),
        relay_ns: own.iter().map(|(start, end)| end - start).sum(),
        relay_windows: own.len(),
        major_frame_ns: schedule.major_frame_ns,
        window_bytes: load_bytes(&load),
        window_datagrams: datagrams_needed(&load, link.max_bytes),
        window_datagrams_most: datagrams_in(shortest, link.gap_ns),
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
        writes: starts(schedule, source.partition),
    }
}
