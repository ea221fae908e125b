//! Turns a raw file that breaks no rule into a [`Plan`].
//!
//! Everything here is an `Option` because the raw types are; nothing is missing once the rules have passed.

use std::collections::BTreeMap;

use super::MessageCatalogue;
use super::closed::{
    ChangeAction, Direction, ErrorLevel, Isolation, Kind, PartitionAction, PartitionError, PartitionState,
    StartMode, SystemCalls,
};
use super::defaults;
use super::links;
use super::model::{
    Address, Chain, Channel, ChannelId, Health, HealthLog, Levels, Link, Module, ModuleHealth, ModuleId,
    Network, NetworkId, Partition, PartitionHealth, PartitionId, Payload, Plan, Port, PortId, Protection,
    Reset, Restart, Role, Schedule, ScheduleId, Window, default_level, default_module_action,
    default_partition_action,
};
use super::names::{Names, full_path};
use super::processes::{self, Windows};
use super::raw::{
    Answer, Numbers, RawFile, RawLink, RawModule, RawPartition, RawPort, RawSchedule, RawWindow,
};
use super::reader::{At, Bytes, Nanoseconds, Permission, Word};
use bateleur_plan::Processes;

/// Builds the plan; nothing if a rule has let through what it must not.
pub(super) fn plan(file: &RawFile, names: &Names, catalogue: &dyn MessageCatalogue) -> Option<Plan> {
    let builder = Builder { file, names, catalogue };
    let schedules: Vec<Schedule> =
        file.schedules.iter().map(|raw| builder.schedule(raw)).collect::<Option<_>>()?;
    Some(Plan {
        modules: file.modules.iter().map(|raw| builder.module(raw)).collect::<Option<_>>()?,
        networks: builder.networks()?,
        links: file.links.iter().map(|raw| builder.link(raw)).collect::<Option<_>>()?,
        partitions: builder.partitions(&schedules)?,
        ports: builder.ports()?,
        messages: builder.messages(),
        channels: builder.channels()?,
        chains: builder.chains()?,
        schedules,
        health: builder.health(),
    })
}

struct Builder<'a> {
    file: &'a RawFile,
    names: &'a Names,
    catalogue: &'a dyn MessageCatalogue,
}

fn numbers(list: &Numbers) -> Option<Vec<u32>> {
    Some(list.said()?.value.iter().map(|number| number.value).collect())
}

impl Builder<'_> {
    fn module(&self, raw: &RawModule) -> Option<Module> {
        let address = |(network, socket): &(At<String>, At<std::net::SocketAddr>)| {
            let network = NetworkId(self.names.network(self.file, &network.value)?);
            Some(Address { network, socket: socket.value })
        };
        let housekeeping = &raw.housekeeping_cores;
        let follows = raw.follows.said().map(|leader| self.names.module(&leader.value).map(ModuleId));
        Some(Module {
            name: raw.name.value.clone(),
            cores: numbers(&raw.cores)?,
            housekeeping_cores: if housekeeping.is_absent() { Vec::new() } else { numbers(housekeeping)? },
            addresses: raw.addresses.iter().map(address).collect::<Option<_>>()?,
            follows: match follows {
                Some(leader) => Some(leader?),
                None => None,
            },
            clock: raw.clock.or(Word(defaults::CLOCK))?.0,
            follows_within_ns: raw.follows_within.or(Nanoseconds(defaults::FOLLOWS_WITHIN_NS))?.0,
        })
    }

    fn networks(&self) -> Option<Vec<Network>> {
        let network = |raw: &super::raw::RawNetwork| {
            Some(Network {
                name: raw.name.value.clone(),
                rate_bits_per_s: raw.rate.get()?.0,
                latency_ns: raw.latency.or(Nanoseconds(defaults::NETWORK_LATENCY_NS))?.0,
            })
        };
        self.file.networks.iter().map(network).collect()
    }

    fn link(&self, raw: &RawLink) -> Option<Link> {
        let [one, other] = self.names.link_ends(raw)?;
        let networks = self.names.link_networks(self.file, raw).into_iter().map(NetworkId);
        Some(Link {
            name: raw.name.value.clone(),
            ends: [ModuleId(one), ModuleId(other)],
            networks: networks.collect(),
            transport: raw.transport.or(Word(defaults::TRANSPORT))?.0,
            protection: match raw.key.get() {
                Some(file) => Protection::Key { file },
                None => Protection::Unauthenticated,
            },
            gap_ns: raw.gap.get()?.0,
            max_bytes: raw.max_bytes.or(defaults::MAX_BYTES)?,
            skew_ns: raw.skew.or(Nanoseconds(defaults::SKEW_NS))?.0,
            lost_after_ns: raw.lost_after.or(Nanoseconds(defaults::LOST_AFTER_NS))?.0,
        })
    }

    /// Those of the file, and where a relay says how it is.
    fn ports(&self) -> Option<Vec<Port>> {
        let ports = (0..self.file.ports.len()).map(|place| self.port(place));
        let relays = self.file.partitions.iter().enumerate().filter(|(_, raw)| raw.generated);
        let status = relays.filter_map(|(place, _)| {
            let size_bytes = self.catalogue.size_of(links::STATUS_MESSAGE)?;
            Some(Some(Port {
                name: bateleur_contract::relay::STATUS_PORT.to_owned(),
                partition: PartitionId(place),
                role: Role::SamplingSource,
                payload: Payload::Message {
                    name: links::STATUS_MESSAGE.to_owned(),
                    size_bytes,
                    layout: self.catalogue.layout_of(links::STATUS_MESSAGE),
                },
                channel: None,
                optional: false,
                operator: false,
            }))
        });
        ports.chain(status).collect()
    }

    /// The texts of the types that ports name, and of a relay's status.
    fn messages(&self) -> BTreeMap<String, String> {
        let named = self.file.ports.iter().filter_map(|port| port.message.get());
        let relays =
            self.file.partitions.iter().filter(|raw| raw.generated).map(|_| links::STATUS_MESSAGE.to_owned());
        let known = |name: String| self.catalogue.definition_of(&name).map(|text| (name, text));
        named.chain(relays).filter_map(known).collect()
    }

    fn partitions(&self, schedules: &[Schedule]) -> Option<Vec<Partition>> {
        let identifiers = processes::identifiers(self.file);
        let all = self.file.partitions.iter().enumerate().zip(identifiers);
        all.map(|((place, raw), identifier)| {
            let processes = processes::of(raw, identifier, &rhythm_of(PartitionId(place), schedules))?;
            self.partition(place, raw, processes)
        })
        .collect()
    }

    fn partition(&self, place: usize, raw: &RawPartition, processes: Processes) -> Option<Partition> {
        let ports = self.file.ports.iter().enumerate().filter(|(_, port)| port.partition == place);
        let devices = raw.devices.or(Vec::new())?;
        Some(Partition {
            name: raw.name.value.clone(),
            program: raw.program.get()?,
            module: ModuleId(self.names.module_of(self.file, place)?),
            memory_bytes: raw.memory.get()?.0,
            threads: processes::threads(raw)?,
            processes,
            restart: restart(raw)?,
            standby: raw.standby.get().map(|word| word.0),
            startup_timeout_ns: raw.startup_timeout.or(Nanoseconds(defaults::STARTUP_TIMEOUT_NS))?.0,
            deadline_ns: raw.deadline.said().map(|deadline| deadline.value.0),
            priority: u8::try_from(raw.priority.or(defaults::PRIORITY)?).ok()?,
            network: raw.network.or(false)?,
            devices: devices.into_iter().map(|device| device.value).collect(),
            system_calls: system_calls(raw)?,
            retained_bytes: raw.retained.or(Bytes(0))?.0,
            attributes: raw.attributes.or(Default::default())?,
            may_set_schedule: self.may_set_schedule(raw)?,
            health: PartitionHealth::fill(|error| effective_action(self.file, raw, error)),
            error_handler: raw.error_handler.or(false)?,
            health_texts: raw.health_texts.or(false)?,
            ports: ports.map(|(port, _)| PortId(port)).chain(self.status_port(place)).collect(),
            relay: raw.generated,
        })
    }

    /// A relay's status port stands behind all ports of the file, in the order of the relays.
    fn status_port(&self, partition: usize) -> Option<PortId> {
        self.catalogue.size_of(links::STATUS_MESSAGE)?;
        let mut relays = self.file.partitions.iter().enumerate().filter(|(_, raw)| raw.generated);
        let place = relays.position(|(place, _)| place == partition)?;
        Some(PortId(self.file.ports.len() + place))
    }

    fn may_set_schedule(&self, raw: &RawPartition) -> Option<Vec<ScheduleId>> {
        let schedules = 0..self.file.schedules.len();
        let listed = match raw.may_set_schedule.or(Permission::Always(false))? {
            Permission::Always(may) => return Some(schedules.filter(|_| may).map(ScheduleId).collect()),
            Permission::In(listed) => listed,
        };
        let mut listed: Vec<_> = listed
            .iter()
            .map(|name| self.names.schedule(self.file, &name.value).map(ScheduleId))
            .collect::<Option<_>>()?;
        listed.sort_unstable();
        listed.dedup();
        Some(listed)
    }

    fn port(&self, place: usize) -> Option<Port> {
        let raw = &self.file.ports[place];
        Some(Port {
            name: raw.name.value.clone(),
            partition: PartitionId(raw.partition),
            role: role(raw)?,
            payload: self.payload(raw)?,
            optional: raw.optional.or(false)?,
            operator: raw.operator.or(false)?,
            channel: self.names.channel_of(place).map(ChannelId),
        })
    }

    fn payload(&self, raw: &RawPort) -> Option<Payload> {
        if let Some(name) = raw.message.get() {
            let size_bytes = self.catalogue.size_of(&name)?;
            let layout = self.catalogue.layout_of(&name);
            return Some(Payload::Message { name, size_bytes, layout });
        }
        Some(Payload::Bytes { max_size_bytes: usize::try_from(raw.max_size.get()?).ok()? })
    }

    fn channels(&self) -> Option<Vec<Channel>> {
        let channel = |raw: &super::raw::RawChannel| {
            let source = self.names.port(&raw.source.said()?.value)?;
            let destinations = raw.destinations.said()?.value.iter();
            let destinations = destinations.map(|path| self.names.port(&path.value).map(PortId));
            let kind = self.file.ports[source].kind.get()?.0;
            let isolation = match raw.isolation.is_absent() {
                true => self.file.isolation.or(Word(Isolation::default()))?.0,
                false => raw.isolation.get()?.0,
            };
            let destinations = destinations.collect::<Option<_>>()?;
            Some(Channel { source: PortId(source), destinations, kind, isolation })
        };
        self.file.channels.iter().map(channel).collect()
    }

    fn chains(&self) -> Option<Vec<Chain>> {
        let chain = |raw: &super::raw::RawChain| {
            let path = full_path(self.file, self.names, raw).ok()?;
            let path = path.into_iter().map(PortId).collect();
            Some(Chain { name: raw.name.get()?, path, max_age_ns: raw.max_age.get()?.0 })
        };
        self.file.chains.iter().map(chain).collect()
    }

    fn schedule(&self, raw: &RawSchedule) -> Option<Schedule> {
        let (major, minor) = (raw.major_frame.get()?.0, raw.minor_frame.get()?.0);
        let frames = u32::try_from(major.checked_div(minor)?).ok()?;
        Some(Schedule {
            name: raw.name.value.clone(),
            major_frame_ns: major,
            minor_frame_ns: minor,
            initial: raw.initial.or(self.file.schedules.len() == 1)?,
            windows: raw.windows.iter().map(|window| self.window(window, frames)).collect::<Option<_>>()?,
            change_actions: raw
                .change_actions
                .iter()
                .map(|(name, action)| {
                    Some((PartitionId(self.names.partition(&name.value)?), self.as_warm(name, action.value)))
                })
                .collect::<Option<_>>()?,
        })
    }

    /// A restart is as warm as the partition can be.
    fn as_warm(&self, name: &At<String>, action: ChangeAction) -> ChangeAction {
        let partition = self.names.partition(&name.value).map(|place| &self.file.partitions[place]);
        match action {
            ChangeAction::WarmRestart if partition.is_none_or(starts_cold) => ChangeAction::ColdRestart,
            action => action,
        }
    }

    fn window(&self, raw: &RawWindow, frames: u32) -> Option<Window> {
        let mut minor = if raw.minor.is_absent() { (0..frames).collect() } else { numbers(&raw.minor)? };
        minor.sort_unstable();
        Some(Window {
            partition: PartitionId(self.names.owner(raw)?),
            offset_ns: raw.offset.get()?.0,
            duration_ns: raw.duration.get()?.0,
            core: self.names.core(self.file, raw)?,
            minor,
        })
    }

    fn health(&self) -> Health {
        let raw = &self.file.health;
        Health {
            levels: Levels::fill(|error, state| effective_level(self.file, error, state)),
            module: ModuleHealth::fill(|error| {
                answer(&raw.module, error).unwrap_or_else(|| default_module_action(error))
            }),
            silence_windows: raw.silence_windows.as_ref().map_or(defaults::SILENCE_WINDOWS, |at| at.value),
            late_after_ns: nanoseconds(&raw.late_after, defaults::LATE_AFTER_NS),
            reset: Reset {
                budget: raw.reset_budget.as_ref().map_or(defaults::RESET_BUDGET, |at| at.value),
                within_ns: nanoseconds(&raw.reset_within, defaults::RESET_WITHIN_NS),
                startup_ns: nanoseconds(&raw.reset_startup, defaults::RESET_STARTUP_NS),
            },
            log: HealthLog {
                bytes: raw.log_size.as_ref().map_or(defaults::HEALTH_LOG_BYTES, |at| at.value.0),
                policy: raw.log_policy.as_ref().map_or(defaults::HEALTH_LOG_POLICY, |at| at.value.0),
            },
        }
    }
}

/// The windows of a partition in the schedule that decides about its periods.
fn rhythm_of(partition: PartitionId, schedules: &[Schedule]) -> Windows {
    let windows = |schedule: &Schedule| {
        let mut windows = schedule.occurrences(partition);
        windows.sort_unstable();
        Windows { windows, major_ns: schedule.major_frame_ns }
    };
    let initial = schedules.iter().filter(|schedule| schedule.initial);
    processes::deciding(initial.chain(schedules).map(windows))
}

fn nanoseconds(said: &Option<At<Nanoseconds>>, otherwise: u64) -> u64 {
    said.as_ref().map_or(otherwise, |at| at.value.0)
}

/// Each once, in the order of the documentation.
fn system_calls(raw: &RawPartition) -> Option<Vec<SystemCalls>> {
    let mut granted: Vec<_> = raw.system_calls.or(Vec::new())?.into_iter().map(|word| word.value.0).collect();
    granted.sort_unstable();
    granted.dedup();
    Some(granted)
}

fn restart(raw: &RawPartition) -> Option<Restart> {
    let raw = &raw.restart;
    Some(Restart {
        start: raw.start.or(Word(defaults::START))?.0,
        budget: raw.budget.or(defaults::BUDGET)?,
        within_ns: raw.within.or(Nanoseconds(defaults::WITHIN_NS))?.0,
        then: raw.then.or(Word(defaults::THEN))?.0,
        startup_ns: raw.startup.or(Nanoseconds(defaults::STARTUP_NS))?.0,
    })
}

fn role(raw: &RawPort) -> Option<Role> {
    Some(match (raw.kind.get()?.0, raw.direction.get()?.0) {
        (Kind::Sampling, Direction::Source) => Role::SamplingSource,
        (Kind::Sampling, Direction::Destination) => {
            Role::SamplingDestination { refresh_ns: raw.refresh.get()?.0 }
        }
        (Kind::Queuing, Direction::Source) => Role::QueuingSource,
        (Kind::Queuing, Direction::Destination) => Role::QueuingDestination { depth: raw.depth.get()? },
    })
}

fn answer<E: Copy + PartialEq, A: Copy>(table: &[Answer<E, A>], error: E) -> Option<A> {
    table.iter().find(|answer| answer.error == error).map(|answer| answer.action.value)
}

/// At which level an error is dealt with: as the file says for the state, else for the error, else as the executive does.
pub(super) fn effective_level(file: &RawFile, error: PartitionError, state: PartitionState) -> ErrorLevel {
    let of_error = || file.health.levels.iter().filter(move |said| said.error == error);
    let said = of_error()
        .find(|said| said.state == Some(state))
        .or_else(|| of_error().find(|said| said.state.is_none()));
    match said.map(|said| said.level.value) {
        // A level for the error as a whole is meant for where it can be.
        Some(ErrorLevel::Process) if state != PartitionState::Normal => ErrorLevel::Partition,
        Some(level) => level,
        None => default_level(error, state),
    }
}

/// Whether a partition can not use what an incarnation before it left.
pub(super) fn starts_cold(raw: &RawPartition) -> bool {
    raw.restart.start.get().map_or(defaults::START, |word| word.0) == StartMode::Cold
}

/// What is done about an error: the partition's own answer, else the file's, else the executive's.
pub(super) fn effective_action(file: &RawFile, raw: &RawPartition, error: PartitionError) -> PartitionAction {
    if let Some(own) = answer(&raw.health, error) {
        return own;
    }
    let cold = starts_cold(raw);
    match answer(&file.health.partition, error).unwrap_or_else(|| default_partition_action(error)) {
        // A default is as warm as the partition can be.
        PartitionAction::WarmRestart if cold => PartitionAction::ColdRestart,
        action => action,
    }
}
