//! From one plan for all modules to what each of them runs: the local plan, the table of its relay, and the digest that both
//! ends of a link compare.
//!
//! All of it is computed from the checked plan and nothing else, so that two hosts with the same file agree without a
//! word. It must never look at the machine, nor hold a key.

use std::collections::BTreeMap;

use bateleur_contract::relay::STATUS_PORT;
use bateleur_contract::{ClockRole, LinkTable, PathTable, PortKind, RelayChannel, RelayTable};
use serde::Serialize;

use crate::closed::{Closed, Kind};
use crate::model::{
    Channel, ChannelId, LinkId, ModuleId, PartitionId, Payload, Plan, Port, PortId, Protection, Role,
};
use crate::timeline::gaps;

/// What a datagram has around it on an Ethernet, bytes, at most: preamble 8, head 14, check 4 and gap 12 of the frame,
/// 40 of IPv6, 8 of UDP.
pub const AROUND_A_DATAGRAM: u64 = 86;
/// Age up to which a relay takes a value: it passes on whatever there is, with its time, and the reader judges.
const ANY_AGE_NS: u64 = i64::MAX as u64;

/// How long the longest datagram takes to pass a point of a network, ns; 0 where its rate is not known.
#[must_use]
pub fn time_on_the_wire_ns(max_bytes: u32, rate_bits_per_s: u64) -> u64 {
    let bits = (u128::from(max_bytes) + u128::from(AROUND_A_DATAGRAM)) * 8;
    let time = (bits * 1_000_000_000).checked_div(u128::from(rate_bits_per_s));
    time.and_then(|time| u64::try_from(time).ok()).unwrap_or_default()
}

impl Plan {
    /// The most that a datagram of a link takes, ns: on the slowest of its networks, which may be the one that is left.
    #[must_use]
    pub fn latency_ns(&self, link: LinkId) -> u64 {
        let link = &self[link];
        let on = |network: &crate::model::Network| {
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
        Ok(blake3::hash(&serde_json::to_vec(&self.without_key_files())?).to_hex().to_string())
    }

    /// Without what each host may choose for itself.
    fn without_key_files(&self) -> Self {
        let mut agreed = self.clone();
        for link in &mut agreed.links {
            if let Protection::Key { file } = &mut link.protection {
                file.clear();
            }
        }
        agreed
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
        sections.insert("links".to_owned(), short_digest(&self.without_key_files().links)?);
        sections.insert("channels".to_owned(), short_digest(&self.channels)?);
        if !self.memory_blocks.is_empty() {
            sections.insert("memory blocks".to_owned(), short_digest(&self.memory_blocks)?);
        }
        if !self.name_services.is_empty() {
            sections.insert("name services".to_owned(), short_digest(&self.name_services)?);
        }
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
            // As the most careful of the plan's own.
            let isolation = self.channels.iter().map(|channel| channel.isolation).max().unwrap_or_default();
            local.channels.push(Channel { source, destinations: Vec::new(), kind, isolation });
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
        local.channels[id.0] = Channel { source, destinations, ..channel.clone() };
    }

    fn add_port(
        &mut self,
        name: String,
        owner: PartitionId,
        role: Role,
        (like, channel): (PortId, ChannelId),
    ) -> PortId {
        let id = PortId(self.ports.len());
        let (payload, channel) = (self[like].payload.clone(), Some(channel));
        self.ports.push(Port {
            name,
            partition: owner,
            role,
            payload,
            optional: false,
            operator: false,
            channel,
        });
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

    /// What the relay of a module is told; `None` if nothing crosses there.
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
        let path = |&network: &crate::model::NetworkId| {
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
                plain: matches!(self[channel.source].payload, Payload::Bytes { .. }),
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
            let starts = schedule.starts(partition);
            gaps(&starts, schedule.major_frame_ns).max()
        });
        periods.max().unwrap_or_default()
    }
}

/// Enough digits to tell parts of two plans apart: what guards is the digest of the whole.
const SHORT_DIGITS: usize = 16;

fn short_digest(part: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut digest = blake3::hash(&serde_json::to_vec(part)?).to_hex().to_string();
    digest.truncate(SHORT_DIGITS);
    Ok(digest)
}
