//! From what stands in the file to what it means: names become places in lists, what the file leaves out is filled in, relays are
//! added, windows get their minor frames and paths the ports between.
//!
//! The result is the [`Plan`] itself, made of every file, so that rules judge what is planned, with the functions that everybody uses. Its lists
//! have the tables of the raw file at the same places, where rules find what to point at. What can not be resolved is
//! reported, here or by the reader, and has a stand-in: a name that leads nowhere means [`Nobody`], a value that can not be
//! read is its default, a window that can not be laid out is in no minor frame, and a path with a gap has no port.

mod health;
mod memory_blocks;
mod names;
mod paths;
mod processes;
mod relays;
mod replicas;
mod schedules;

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddrV4;

use super::MessageCatalogue;
use super::closed::{Direction, Kind};
use super::defaults;
use super::findings::Findings;
use super::links::STATUS_MESSAGE;
use super::model::{
    Address, Channel, ChannelId, Link, Logbook, Module, ModuleId, Network, NetworkId, Partition,
    PartitionHealth, PartitionId, Payload, Plan, Port, PortId, Protection, Restart, Role, Schedule,
    ScheduleId,
};
use super::raw::{
    RawChannel, RawFile, RawLink, RawLogbook, RawModule, RawNameService, RawNetwork, RawPartition, RawPort,
};
use super::reader::{At, Permission};
use bateleur_contract::relay::STATUS_PORT;
use bateleur_plan::Processes;
use bateleur_plan::bounds::{self, OutOfBounds};
use names::Names;

pub(super) use names::Nobody;
pub use names::RELAY_PREFIX;
pub(super) use relays::add as add_relays;
pub(super) use replicas::expand as expand_replicas;
pub use replicas::numbered;
pub(super) use schedules::minor_frames;

/// What a file means.
pub(super) struct Resolved {
    /// With stand-ins: [`Self::into_plan`] gives it without.
    pub(super) plan: Plan,
    /// What names mean that lead nowhere.
    pub(super) nobody: Nobody,
}

impl Resolved {
    /// The plan of a file that breaks no rule.
    ///
    /// # Errors
    /// What no rule has found, and must not be planned.
    pub(super) fn into_plan(self) -> Result<Plan, OutOfBounds> {
        let mut plan = self.plan;
        plan.modules.pop();
        plan.partitions.pop();
        plan.ports.pop();
        bounds::check(&plan).map(|()| plan)
    }
}

struct Resolver<'a> {
    file: &'a RawFile,
    names: Names<'a>,
    nobody: Nobody,
    catalogue: &'a dyn MessageCatalogue,
    findings: &'a Findings<'a>,
    /// The module of each partition.
    owners: Vec<ModuleId>,
}

/// Resolves a file to which relays have been added.
pub(super) fn resolve(file: &RawFile, catalogue: &dyn MessageCatalogue, findings: &Findings<'_>) -> Resolved {
    let told = relays_that_tell(file, catalogue).count();
    let nobody = Nobody {
        module: ModuleId(file.modules.len()),
        partition: PartitionId(file.partitions.len()),
        port: PortId(file.ports.len() + told),
    };
    let names = Names::of(file, nobody, findings);
    let module = |raw: &RawPartition| raw.module.said().map_or(nobody.module, |name| names.module(name));
    let owners = file.partitions.iter().map(module).collect();
    let resolver = Resolver { file, names, nobody, catalogue, findings, owners };
    Resolved { plan: resolver.plan(), nobody }
}

/// The places of the relays that say how their links are.
fn relays_that_tell(file: &RawFile, catalogue: &dyn MessageCatalogue) -> impl Iterator<Item = usize> {
    let told = catalogue.size_of(STATUS_MESSAGE).is_some();
    file.partitions.iter().enumerate().filter(move |(_, raw)| told && raw.generated).map(|(place, _)| place)
}

impl Resolver<'_> {
    fn plan(&self) -> Plan {
        let file = self.file;
        let modules = self.modules();
        let schedules = self.schedules(&modules);
        let channels: Vec<Channel> = file.channels.iter().map(|raw| self.channel(raw)).collect();
        let mut plan = Plan {
            networks: file.networks.iter().map(network).collect(),
            links: file.links.iter().map(|raw| self.link(raw, &modules)).collect(),
            partitions: self.partitions(&schedules),
            ports: self.ports(&channels),
            messages: self.messages(),
            memory_blocks: file.memory_blocks.iter().map(|raw| self.memory_block(raw)).collect(),
            name_services: file.name_services.iter().map(name_service).collect(),
            chains: Vec::new(),
            health: self.health(),
            modules,
            channels,
            schedules,
        };
        plan.chains = file.chains.iter().map(|raw| self.chain(&plan, raw)).collect();
        plan
    }

    fn modules(&self) -> Vec<Module> {
        let module = |raw: &RawModule| {
            let address = |(network, socket): &(At<String>, At<std::net::SocketAddr>)| {
                Some(Address { network: self.names.network(network)?, socket: socket.value })
            };
            let numbers = |list: &[At<u32>]| list.iter().map(|number| number.value).collect();
            let leader = raw.follows.said().map(|leader| self.names.module(leader));
            Module {
                name: raw.name.value.clone(),
                cores: numbers(raw.cores.items()),
                housekeeping_cores: numbers(raw.housekeeping_cores.items()),
                addresses: raw.addresses.iter().filter_map(address).collect(),
                follows: leader.filter(|leader| *leader != self.nobody.module),
                clock: raw.clock.word().unwrap_or(defaults::CLOCK),
                follows_within_ns: raw.follows_within.ns(defaults::FOLLOWS_WITHIN_NS),
            }
        };
        let nobody = Module {
            name: String::new(),
            cores: Vec::new(),
            housekeeping_cores: Vec::new(),
            addresses: Vec::new(),
            follows: None,
            clock: defaults::CLOCK,
            follows_within_ns: defaults::FOLLOWS_WITHIN_NS,
        };
        self.file.modules.iter().map(module).chain([nobody]).collect()
    }

    fn link(&self, raw: &RawLink, modules: &[Module]) -> Link {
        let named: Vec<ModuleId> = raw.modules.items().iter().map(|name| self.names.module(name)).collect();
        let ends = match named.as_slice() {
            &[one, other] if one != other && !named.contains(&self.nobody.module) => [one, other],
            _ => [self.nobody.module; 2],
        };
        let networks = match raw.networks.said() {
            Some(said) => said.value.iter().filter_map(|name| self.names.network(name)).collect(),
            // Those that both have.
            None => (0..self.file.networks.len())
                .map(NetworkId)
                .filter(|network| ends.iter().all(|end| modules[end.0].address_on(*network).is_some()))
                .collect(),
        };
        Link {
            name: raw.name.value.clone(),
            ends,
            networks,
            transport: raw.transport.word().unwrap_or(defaults::TRANSPORT),
            protection: match raw.key.get() {
                Some(file) => Protection::Key { file },
                None => Protection::Unauthenticated,
            },
            gap_ns: raw.gap.ns(0),
            max_bytes: raw.max_bytes.get().unwrap_or(defaults::MAX_BYTES),
            skew_ns: raw.skew.ns(defaults::SKEW_NS),
            lost_after_ns: raw.lost_after.ns(defaults::LOST_AFTER_NS),
        }
    }

    fn partitions(&self, schedules: &[Schedule]) -> Vec<Partition> {
        let identifiers = self.identifiers();
        let own =
            self.file.partitions.iter().enumerate().zip(identifiers).map(|((place, raw), identifier)| {
                let memory_bytes = raw.memory.get().map_or(0, |bytes| bytes.0);
                let processes = processes::of((PartitionId(place), raw), identifier, memory_bytes, schedules);
                self.partition(PartitionId(place), raw, processes)
            });
        let nameless = || At { value: String::new(), span: 0..0 };
        let raw = relays::table("", nameless(), nameless());
        let processes = processes::of((self.nobody.partition, &raw), 0, 0, &[]);
        let nobody = Partition {
            relay: false,
            ports: vec![self.nobody.port],
            ..self.partition(self.nobody.partition, &raw, processes)
        };
        own.chain([nobody]).collect()
    }

    fn partition(&self, id: PartitionId, raw: &RawPartition, processes: Processes) -> Partition {
        let ports = self.file.ports.iter().enumerate().filter(|(_, port)| port.partition == id.0);
        // The status ports of relays stand behind all ports of the file, in the order of the relays.
        let status = relays_that_tell(self.file, self.catalogue).position(|place| place == id.0);
        let status = status.map(|place| PortId(self.file.ports.len() + place));
        Partition {
            name: raw.name.value.clone(),
            program: raw.program.get().unwrap_or_default(),
            module: self.owners.get(id.0).copied().unwrap_or(self.nobody.module),
            memory_bytes: raw.memory.get().map_or(0, |bytes| bytes.0),
            threads: processes::threads(raw),
            processes,
            restart: restart(raw),
            standby: raw.standby.word(),
            startup_timeout_ns: raw.startup_timeout.ns(defaults::STARTUP_TIMEOUT_NS),
            deadline_ns: raw.deadline.said().map(|deadline| deadline.value.0),
            priority: u8::try_from(raw.priority.get().unwrap_or(defaults::PRIORITY)).unwrap_or(u8::MAX),
            network: raw.network.get().unwrap_or_default(),
            devices: raw.devices.items().iter().map(|device| device.value.clone()).collect(),
            system_calls: each_once(raw.system_calls.items().iter().map(|calls| calls.value.0)),
            retained_bytes: raw.retained.get().map_or(0, |bytes| bytes.0),
            logbooks: raw.logbooks.iter().map(logbook).collect(),
            attributes: raw.attributes.get().unwrap_or_default(),
            may_set_schedule: self.may_set_schedule(raw),
            health: PartitionHealth::fill(|error| self.action(raw, error)),
            error_handler: raw.error_handler.get().unwrap_or_default(),
            health_texts: raw.health_texts.get().unwrap_or_default(),
            ports: ports.map(|(port, _)| PortId(port)).chain(status).collect(),
            replicas: raw.voted.iter().copied().map(PartitionId).collect(),
            relay: raw.generated,
            played: false,
        }
    }

    fn may_set_schedule(&self, raw: &RawPartition) -> Vec<ScheduleId> {
        match raw.may_set_schedule.said().map(|said| &said.value) {
            None | Some(Permission::Always(false)) => Vec::new(),
            Some(Permission::Always(true)) => (0..self.file.schedules.len()).map(ScheduleId).collect(),
            Some(Permission::In(listed)) => {
                each_once(listed.iter().filter_map(|name| self.names.schedule(name)))
            }
        }
    }

    fn channel(&self, raw: &RawChannel) -> Channel {
        let source = raw.source.said().map_or(self.nobody.port, |path| self.names.port(path));
        let isolation = if raw.isolation.is_absent() { &self.file.isolation } else { &raw.isolation };
        Channel {
            source,
            destinations: raw.destinations.items().iter().map(|path| self.names.port(path)).collect(),
            kind: self.file.ports.get(source.0).map_or(Kind::Sampling, kind),
            isolation: isolation.word().unwrap_or_default(),
        }
    }

    /// Those of the file, and where a relay says how it is.
    fn ports(&self, channels: &[Channel]) -> Vec<Port> {
        let mut attached: HashMap<PortId, ChannelId> = HashMap::new();
        for (place, channel) in channels.iter().enumerate() {
            for port in [channel.source].iter().chain(&channel.destinations) {
                attached.entry(*port).or_insert(ChannelId(place));
            }
        }
        let own = self.file.ports.iter().enumerate().map(|(place, raw)| Port {
            name: raw.name.value.clone(),
            partition: PartitionId(raw.partition),
            role: role(raw),
            payload: self.payload(raw),
            optional: raw.optional.get().unwrap_or_default(),
            operator: raw.operator.get().unwrap_or_default(),
            channel: attached.get(&PortId(place)).copied(),
        });
        let further = |name: &str, partition, payload| Port {
            name: name.to_owned(),
            partition,
            role: Role::SamplingSource,
            payload,
            optional: false,
            operator: false,
            channel: None,
        };
        let status = relays_that_tell(self.file, self.catalogue)
            .map(|place| further(STATUS_PORT, PartitionId(place), self.message(STATUS_MESSAGE)));
        let nobody = further("", self.nobody.partition, Payload::Bytes { max_size_bytes: 0 });
        own.chain(status).chain([nobody]).collect()
    }

    fn payload(&self, raw: &RawPort) -> Payload {
        match raw.message.said() {
            Some(name) => self.message(&name.value),
            None => Payload::Bytes { max_size_bytes: raw.max_size.get().unwrap_or_default() as usize },
        }
    }

    fn message(&self, name: &str) -> Payload {
        Payload::Message {
            name: name.to_owned(),
            size_bytes: self.catalogue.size_of(name).unwrap_or_default(),
            layout: self.catalogue.layout_of(name),
        }
    }

    /// The texts of the types that ports name, and of a relay's status.
    fn messages(&self) -> BTreeMap<String, String> {
        let named = self.file.ports.iter().filter_map(|port| port.message.get());
        let relays = self.file.partitions.iter().filter(|raw| raw.generated);
        let known = |name: String| self.catalogue.definition_of(&name).map(|text| (name, text));
        named.chain(relays.map(|_| STATUS_MESSAGE.to_owned())).filter_map(known).collect()
    }
}

fn network(raw: &RawNetwork) -> Network {
    Network {
        name: raw.name.value.clone(),
        rate_bits_per_s: raw.rate.get().map_or(0, |rate| rate.0),
        latency_ns: raw.latency.ns(defaults::NETWORK_LATENCY_NS),
    }
}

fn name_service(raw: &RawNameService) -> (String, BTreeMap<String, SocketAddrV4>) {
    let addresses = raw.addresses.iter().map(|(point, address)| (point.value.clone(), address.value));
    (raw.name.value.clone(), addresses.collect())
}

/// Each once, in their order.
fn each_once<T: Ord>(items: impl Iterator<Item = T>) -> Vec<T> {
    let items: std::collections::BTreeSet<T> = items.collect();
    items.into_iter().collect()
}

fn logbook(raw: &RawLogbook) -> Logbook {
    Logbook {
        name: raw.name.value.clone(),
        max_size_bytes: raw.max_size.get().unwrap_or_default(),
        max_logged: raw.max_logged.get().unwrap_or_default(),
        max_in_progress: raw.max_in_progress.get().unwrap_or_default(),
    }
}

fn restart(raw: &RawPartition) -> Restart {
    let raw = &raw.restart;
    Restart {
        start: raw.start.word().unwrap_or(defaults::START),
        budget: raw.budget.get().unwrap_or(defaults::BUDGET),
        within_ns: raw.within.ns(defaults::WITHIN_NS),
        then: raw.then.word().unwrap_or(defaults::THEN),
        startup_ns: raw.startup.ns(defaults::STARTUP_NS),
    }
}

fn kind(raw: &RawPort) -> Kind {
    raw.kind.word().unwrap_or(Kind::Sampling)
}

fn role(raw: &RawPort) -> Role {
    match (kind(raw), raw.direction.word().unwrap_or(Direction::Source)) {
        (Kind::Sampling, Direction::Source) => Role::SamplingSource,
        (Kind::Sampling, Direction::Destination) => {
            Role::SamplingDestination { refresh_ns: raw.refresh.ns(0) }
        }
        (Kind::Queuing, Direction::Source) => Role::QueuingSource,
        (Kind::Queuing, Direction::Destination) => {
            Role::QueuingDestination { depth: raw.depth.get().unwrap_or_default() }
        }
    }
}
