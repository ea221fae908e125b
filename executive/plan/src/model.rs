//! The checked plan: what the rest of the executive works from.
//!
//! Every name has become an index, every default is filled in, every time is in nanoseconds and every size in
//! bytes. Outside of the checker a [`Plan`] exists only if no rule of severity error was violated, so nobody has to check again. The
//! checker makes one of every file, with stand-ins for what can not be resolved, and holds its rules against that.

use std::collections::BTreeMap;
use std::net::{SocketAddr, SocketAddrV4};
use std::ops::Index;

use serde::{Deserialize, Serialize};

use super::closed::{
    ChangeAction, Closed, Direction, ErrorLevel, Exhausted, Isolation, Kind, LogPolicy, ModuleAction,
    ModuleClock, ModuleError, PartitionAction, PartitionError, PartitionState, Standby, StartMode,
    SystemCalls, Transport,
};
use super::processes::Processes;

macro_rules! index {
    ($(#[$doc:meta])* $id:ident, $field:ident: $item:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $id(pub usize);

        impl $id {
            /// The place in the plan's list.
            #[must_use]
            pub fn index(self) -> usize {
                self.0
            }
        }

        impl Index<$id> for Plan {
            type Output = $item;

            fn index(&self, id: $id) -> &$item {
                &self.$field[id.0]
            }
        }
    };
}

index! {
    /// A module of the plan.
    ModuleId, modules: Module
}
index! {
    /// A network of the plan.
    NetworkId, networks: Network
}
index! {
    /// A link of the plan.
    LinkId, links: Link
}
index! {
    /// A partition of the plan.
    PartitionId, partitions: Partition
}
index! {
    /// A port of the plan.
    PortId, ports: Port
}
index! {
    /// A channel of the plan.
    ChannelId, channels: Channel
}
index! {
    /// A schedule of the plan.
    ScheduleId, schedules: Schedule
}

/// Everything a schedule file says, for every module, in the order of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The computers.
    pub modules: Vec<Module>,
    /// The networks between them.
    pub networks: Vec<Network>,
    /// The pairs of modules that talk to each other: none twice.
    pub links: Vec<Link>,
    /// The partitions of all modules; last the relays, which no table of the file names.
    pub partitions: Vec<Partition>,
    /// The ports of all partitions.
    pub ports: Vec<Port>,
    /// The message types that ports carry, as far as their fields are known: by name the text of each, and behind it those of the
    /// types within it. Who writes messages down or shows them takes them apart by it; what runs partitions never reads it.
    pub messages: BTreeMap<String, String>,
    /// The channels, whether inside one module or across.
    pub channels: Vec<Channel>,
    /// Memory that partitions share. Not written down where there is none: hosts of a plan that says nothing still agree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub memory_blocks: Vec<MemoryBlock>,
    /// The name services that partitions can ask for addresses, by name. As above.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub name_services: BTreeMap<String, BTreeMap<String, SocketAddrV4>>,
    /// The paths whose latency is bounded.
    pub chains: Vec<Chain>,
    /// The schedules; exactly one is initial.
    pub schedules: Vec<Schedule>,
    /// What holds for the health of every module.
    pub health: Health,
}

/// One computer that runs one executive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Module {
    /// Its name.
    pub name: String,
    /// The numbers of the processor cores whose time is partitioned: at least one, none twice.
    pub cores: Vec<u32>,
    /// The cores left to everything that is not a partition; empty where the machine may choose.
    pub housekeeping_cores: Vec<u32>,
    /// Where it is reached, by network; none twice.
    pub addresses: Vec<Address>,
    /// Whose major frame it follows; `None`: nobody's.
    pub follows: Option<ModuleId>,
    /// Where its major frames lie.
    pub clock: ModuleClock,
    /// The error of its major frame beyond which it has lost that of the module, or of the clock, that it follows, ns; not zero.
    pub follows_within_ns: u64,
}

impl Module {
    /// Where it is reached on a network.
    #[must_use]
    pub fn address_on(&self, network: NetworkId) -> Option<SocketAddr> {
        self.addresses.iter().find(|address| address.network == network).map(|address| address.socket)
    }
}

/// An interface of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Address {
    /// The network that it is on.
    pub network: NetworkId,
    /// Its number, and the port of the relay.
    pub socket: SocketAddr,
}

/// What carries datagrams between modules.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Network {
    /// Its name.
    pub name: String,
    /// How much it carries from each module, bit/s; not zero.
    pub rate_bits_per_s: u64,
    /// The most that a datagram takes from sender to receiver, ns.
    pub latency_ns: u64,
}

/// Two modules that talk to each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// The two; the first one begins.
    pub ends: [ModuleId; 2],
    /// The networks that carry the same: one or two, on which both modules have an address.
    pub networks: Vec<NetworkId>,
    /// By what datagrams travel.
    pub transport: Transport,
    /// What keeps others from speaking for either end.
    pub protection: Protection,
    /// From one datagram to the next on each network at least, ns: 1, 2, 4, … 128 ms.
    pub gap_ns: u64,
    /// The longest datagram, bytes.
    pub max_bytes: u32,
    /// How much later than the first a copy from the other network may come, ns.
    pub skew_ns: u64,
    /// After how much silence a network of it counts as down, ns.
    pub lost_after_ns: u64,
}

impl Link {
    /// The other end, seen from one of them.
    #[must_use]
    pub fn peer_of(&self, module: ModuleId) -> Option<ModuleId> {
        match self.ends {
            [one, other] if one == module => Some(other),
            [one, other] if other == module => Some(one),
            _ => None,
        }
    }
}

/// What keeps others from speaking for either end of a link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Protection {
    /// Every datagram carries a tag made with a key.
    Key {
        /// The key's file, relative to the schedule file. No part of what two hosts have to agree on: each keeps it
        /// where it likes.
        file: String,
    },
    /// Nothing does.
    Unauthenticated,
}

/// One isolated process tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Partition {
    /// Its name.
    pub name: String,
    /// The program: a name beside the executive, or a path.
    pub program: String,
    /// The computer that it runs on.
    pub module: ModuleId,
    /// The most memory that it may use, in bytes; not zero.
    pub memory_bytes: u64,
    /// The most threads that it may have; at least one.
    pub threads: u32,
    /// Its period, and what its processes may take.
    pub processes: Processes,
    /// When and how often it may start again.
    pub restart: Restart,
    /// What waits behind it; `None` if nothing does.
    pub standby: Option<Standby>,
    /// How long it may take, in real time, until it is ready.
    pub startup_timeout_ns: u64,
    /// Its time capacity: how long after the start of a window it must have closed it; `None`: until the window ends.
    pub deadline_ns: Option<u64>,
    /// Its SCHED_FIFO priority inside a window, 1 to 50.
    pub priority: u8,
    /// Whether it may use the network.
    pub network: bool,
    /// The devices that it may open, by name or path; none twice.
    pub devices: Vec<String>,
    /// The system calls beyond the ordinary ones that it may make; none twice.
    pub system_calls: Vec<SystemCalls>,
    /// The memory that survives a warm restart, in bytes; may be zero.
    pub retained_bytes: u64,
    /// Its logbooks. Not written down where there are none: hosts of a plan that says nothing still agree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub logbooks: Vec<Logbook>,
    /// What it is told at its start, as the file says it.
    pub attributes: BTreeMap<String, Attribute>,
    /// The schedules in which it may ask for another one.
    pub may_set_schedule: Vec<ScheduleId>,
    /// What is done about each of its errors.
    pub health: PartitionHealth,
    /// It has an error handler of its own, for errors at the level of a process.
    pub error_handler: bool,
    /// It is told what the health log says.
    pub health_texts: bool,
    /// Its ports, in the order of the file.
    pub ports: Vec<PortId>,
    /// The partitions whose words it votes on: none, or three. Not written down where there are none: hosts of a plan that says nothing
    /// still agree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub replicas: Vec<PartitionId>,
    /// It carries the channels that cross, and no table of the file names it.
    pub relay: bool,
    /// A recording stands in its place in this run: it is not started. No plan that is written down says so.
    #[serde(skip)]
    pub played: bool,
}

impl Partition {
    /// The most memory that all its processes may use: one that stands by has as much as the one in office.
    #[must_use]
    pub fn all_memory_bytes(&self) -> u64 {
        self.memory_bytes.saturating_mul(if self.standby.is_some() { 2 } else { 1 })
    }
}

/// A logbook of a partition (ARINC 653 part 2).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Logbook {
    /// Its name, unique in its partition.
    pub name: String,
    /// Bytes of a message; not zero.
    pub max_size_bytes: u32,
    /// Messages that it keeps; at least one.
    pub max_logged: u32,
    /// Messages that may be on their way to the file; at least one.
    pub max_in_progress: u32,
}

/// When and how often a partition may start again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Restart {
    /// The warmest start that the partition supports.
    pub start: StartMode,
    /// How many restarts are allowed …
    pub budget: u32,
    /// … within this time.
    pub within_ns: u64,
    /// What happens at the first restart beyond the budget.
    pub then: Exhausted,
    /// How long a restart takes in virtual time.
    pub startup_ns: u64,
}

/// A value that a partition is told at its start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Attribute {
    /// A text.
    String(String),
    /// A whole number.
    Integer(i64),
    /// A number with a fraction.
    Float(f64),
    /// Yes or no.
    Boolean(bool),
    /// A list of values.
    Array(Vec<Attribute>),
}

/// A partition's end of a channel.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Its name, unique in its partition.
    pub name: String,
    /// Whose it is.
    pub partition: PartitionId,
    /// Direction and kind, with what only that pair has.
    pub role: Role,
    /// What a message on it is.
    pub payload: Payload,
    /// Its partition may leave it out.
    pub optional: bool,
    /// It is the operator's: the partition leaves it out, and what he publishes is written into it.
    pub operator: bool,
    /// The channel it is attached to; `None` only if it is left open, which is a warning.
    pub channel: Option<ChannelId>,
}

impl Port {
    /// Whether its partition writes or reads.
    #[must_use]
    pub fn direction(&self) -> Direction {
        match self.role {
            Role::SamplingSource | Role::QueuingSource => Direction::Source,
            Role::SamplingDestination { .. } | Role::QueuingDestination { .. } => Direction::Destination,
        }
    }

    /// Whether it keeps the latest value or all of them.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self.role {
            Role::SamplingSource | Role::SamplingDestination { .. } => Kind::Sampling,
            Role::QueuingSource | Role::QueuingDestination { .. } => Kind::Queuing,
        }
    }
}

/// Direction and kind of a port, with what only that pair has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Writes the latest value.
    SamplingSource,
    /// Reads the latest value.
    SamplingDestination {
        /// The age up to which a value is valid; not zero.
        refresh_ns: u64,
    },
    /// Sends messages.
    QueuingSource,
    /// Receives messages in order.
    QueuingDestination {
        /// How many messages wait at most; not zero.
        depth: u32,
    },
}

/// What a message on a port is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Payload {
    /// A message type of the catalogue.
    Message {
        /// Its name.
        name: String,
        /// Its size.
        size_bytes: usize,
        /// A number that differs where its fields do; 0: they are not known.
        layout: u32,
    },
    /// Bytes that the partitions give a meaning to, so many in each message as its writer likes.
    Bytes {
        /// The longest message; not zero.
        max_size_bytes: usize,
    },
}

impl Payload {
    /// The size of the longest message, in bytes.
    #[must_use]
    pub fn max_size_bytes(&self) -> usize {
        match self {
            Self::Message { size_bytes, .. } => *size_bytes,
            Self::Bytes { max_size_bytes } => *max_size_bytes,
        }
    }
}

/// One source and its destinations, all of one kind and one message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Channel {
    /// The port that is written.
    pub source: PortId,
    /// The ports that are read: at least one, and exactly one if the channel is queuing.
    pub destinations: Vec<PortId>,
    /// How the channel keeps messages.
    pub kind: Kind,
    /// What its ends can do to each other. Not written down where it is the default: hosts of a plan that says nothing still agree.
    #[serde(default, skip_serializing_if = "Isolation::is_default")]
    pub isolation: Isolation,
}

/// A memory block. All its partitions run on one module.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemoryBlock {
    /// Its name.
    pub name: String,
    /// Its size in bytes; not zero.
    pub size_bytes: u64,
    /// The file with what stands in it from its first byte on when the module starts, relative to the schedule file; `None`: zeros.
    pub content: Option<String>,
    /// The partitions that read it; none twice.
    pub read: Vec<PartitionId>,
    /// The partitions that read and write it; none of the above.
    pub read_write: Vec<PartitionId>,
}

/// A path from a sensor to an actuator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Chain {
    /// Its name.
    pub name: String,
    /// Every port on the way, also those that the file leaves out between two partitions.
    pub path: Vec<PortId>,
    /// How old the first value may be when it takes effect at the end.
    pub max_age_ns: u64,
}

/// A named table of windows that recurs with the major frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Schedule {
    /// Its name.
    pub name: String,
    /// The whole cycle: a whole number of minor frames.
    pub major_frame_ns: u64,
    /// The base period in which windows recur.
    pub minor_frame_ns: u64,
    /// Whether the module starts with it.
    pub initial: bool,
    /// The windows of all modules, in the order of the file.
    pub windows: Vec<Window>,
    /// What becomes of a partition when the module changes to this schedule, where the file says it.
    pub change_actions: BTreeMap<PartitionId, ChangeAction>,
}

impl Schedule {
    /// Whether a partition has a window in it.
    #[must_use]
    pub fn runs(&self, partition: PartitionId) -> bool {
        self.windows.iter().any(|window| window.partition == partition)
    }

    /// How many minor frames a major frame has.
    #[must_use]
    pub fn minor_frames(&self) -> u32 {
        u32::try_from(self.major_frame_ns / self.minor_frame_ns.max(1)).unwrap_or(u32::MAX)
    }
}

/// A stretch of time on one core that belongs to one partition.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Window {
    /// Whose it is.
    pub partition: PartitionId,
    /// Its start, from the start of the minor frame.
    pub offset_ns: u64,
    /// Its length; not zero, and not past the end of the minor frame.
    pub duration_ns: u64,
    /// The core, one of the module's.
    pub core: u32,
    /// The minor frames that have it, rising, at least one.
    pub minor: Vec<u32>,
}

impl Window {
    /// Its end, from the start of the minor frame.
    #[must_use]
    pub fn end_ns(&self) -> u64 {
        self.offset_ns + self.duration_ns
    }
}

/// What is done about each error of one partition.
///
/// `warm_restart` is in it only where the partition starts warm or overrides the action itself: the default table's
/// `warm_restart` reaches a partition that starts cold as `cold_restart`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PartitionHealth(pub BTreeMap<PartitionError, PartitionAction>);

impl PartitionHealth {
    /// The action for an error.
    #[must_use]
    pub fn action(&self, error: PartitionError) -> PartitionAction {
        self.0.get(&error).copied().unwrap_or_else(|| default_partition_action(error))
    }
}

/// At which level each error of a partition is dealt with, in each state that the partition can be in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Levels(BTreeMap<PartitionError, BTreeMap<PartitionState, ErrorLevel>>);

impl Levels {
    /// The table with a level for every error and state.
    #[must_use]
    pub fn fill(level: impl Fn(PartitionError, PartitionState) -> ErrorLevel) -> Self {
        let states = |error| PartitionState::ALL.iter().map(|&state| (state, level(error, state))).collect();
        Self(PartitionError::ALL.iter().map(|&error| (error, states(error))).collect())
    }

    /// The level of an error.
    #[must_use]
    pub fn level(&self, error: PartitionError, state: PartitionState) -> ErrorLevel {
        let said = self.0.get(&error).and_then(|states| states.get(&state));
        said.copied().unwrap_or_else(|| default_level(error, state))
    }
}

/// The errors after which a partition's process can still deal with them itself.
#[must_use]
pub fn leaves_the_process(error: PartitionError) -> bool {
    matches!(
        error,
        PartitionError::ApplicationError
            | PartitionError::PortError
            | PartitionError::DeadlineMissed
            | PartitionError::WindowOverrun
    )
}

/// The level of an error where the file does not say: what a handler can deal with is its own, if there is one.
#[must_use]
pub fn default_level(error: PartitionError, state: PartitionState) -> ErrorLevel {
    match state {
        PartitionState::Normal if leaves_the_process(error) => ErrorLevel::Process,
        _ => ErrorLevel::Partition,
    }
}

/// What is done about each error of a module.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ModuleHealth(pub BTreeMap<ModuleError, ModuleAction>);

impl ModuleHealth {
    /// The action for an error.
    #[must_use]
    pub fn action(&self, error: ModuleError) -> ModuleAction {
        self.0.get(&error).copied().unwrap_or_else(|| default_module_action(error))
    }
}

/// What holds for the health of every module.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Health {
    /// At which level the errors of partitions are dealt with.
    pub levels: Levels,
    /// What is done about the errors of a module.
    pub module: ModuleHealth,
    /// How many windows in a row a partition may leave open before that is silence; not zero.
    pub silence_windows: u32,
    /// A switch that the dispatcher comes later to is the error `late_dispatcher`, ns; not zero.
    pub late_after_ns: u64,
    /// How often a module may be reset.
    pub reset: Reset,
    /// The persistent log.
    pub log: HealthLog,
}

/// How often a module may start again by itself; the next error that asks for a reset shuts it down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reset {
    /// How many resets are allowed …
    pub budget: u32,
    /// … within this time.
    pub within_ns: u64,
    /// How long a reset takes in virtual time.
    pub startup_ns: u64,
}

/// How much the persistent health log holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HealthLog {
    /// Bytes of its file, at most.
    pub bytes: u64,
    /// What becomes of it when it is full.
    pub policy: LogPolicy,
}

/// What is done about a partition's error where the file does not say.
#[must_use]
pub fn default_partition_action(error: PartitionError) -> PartitionAction {
    match error {
        PartitionError::WindowOverrun
        | PartitionError::DeadlineMissed
        | PartitionError::ApplicationError
        | PartitionError::PortError => PartitionAction::Ignore,
        // What it retained may be the very cause: it is not kept.
        PartitionError::StartupTimeout | PartitionError::HardwareFault => PartitionAction::ColdRestart,
        _ => PartitionAction::WarmRestart,
    }
}

/// What is done about a module's error where the file does not say.
#[must_use]
pub fn default_module_action(error: ModuleError) -> ModuleAction {
    match error {
        // A configuration that can not even be started is the end anyway; one partition that can not be started again in
        // flight is better than none.
        ModuleError::LateDispatcher
        | ModuleError::ProcessorTaken
        | ModuleError::PartitionStopped
        | ModuleError::ConfigError
        | ModuleError::SyncLost => ModuleAction::Ignore,
        ModuleError::PowerFail
        | ModuleError::PartitionError
        | ModuleError::ExecutiveDied
        | ModuleError::ExecutiveHung => ModuleAction::Shutdown,
    }
}

impl Plan {
    /// The module of that name.
    #[must_use]
    pub fn module(&self, name: &str) -> Option<ModuleView<'_>> {
        let place = self.modules.iter().position(|module| module.name == name)?;
        Some(ModuleView { plan: self, id: ModuleId(place) })
    }

    /// The partition of that name.
    #[must_use]
    pub fn partition(&self, name: &str) -> Option<PartitionId> {
        self.partitions.iter().position(|partition| partition.name == name).map(PartitionId)
    }

    /// The port that is written `partition.port`.
    #[must_use]
    pub fn port(&self, path: &str) -> Option<PortId> {
        let (partition, port) = path.split_once('.')?;
        let owner = &self[self.partition(partition)?];
        owner.ports.iter().copied().find(|&id| self[id].name == port)
    }

    /// The length of a channel's queue; `None`: sampling.
    pub fn queue_depth(&self, channel: &Channel) -> Option<u32> {
        channel.destinations.iter().find_map(|id| match self[*id].role {
            Role::QueuingDestination { depth } => Some(depth),
            _ => None,
        })
    }

    /// The ports of a partition that its program opens: all but those of the operator.
    pub fn own_ports<'a>(&'a self, partition: &'a Partition) -> impl Iterator<Item = PortId> + 'a {
        partition.ports.iter().copied().filter(|id| !self[*id].operator)
    }

    /// The schedule of that name.
    #[must_use]
    pub fn schedule(&self, name: &str) -> Option<ScheduleId> {
        self.schedules.iter().position(|schedule| schedule.name == name).map(ScheduleId)
    }

    /// The schedule that every module starts with.
    #[must_use]
    pub fn initial_schedule(&self) -> ScheduleId {
        ScheduleId(self.schedules.iter().position(|schedule| schedule.initial).unwrap_or(0))
    }

    /// The link between two modules, if there is one.
    #[must_use]
    pub fn link_between(&self, one: ModuleId, other: ModuleId) -> Option<LinkId> {
        self.links.iter().position(|link| link.peer_of(one) == Some(other)).map(LinkId)
    }

    /// The links of a module, in the order of the file.
    pub fn links_of(&self, module: ModuleId) -> impl Iterator<Item = LinkId> + use<'_> {
        (0..self.links.len()).map(LinkId).filter(move |&id| self[id].peer_of(module).is_some())
    }

    /// The partition that votes on what this one writes; `None`: it is no replica.
    #[must_use]
    pub fn voter_of(&self, replica: PartitionId) -> Option<PartitionId> {
        self.partition_ids().find(|&id| self[id].replicas.contains(&replica))
    }

    /// The processors that its modules name.
    #[must_use]
    pub fn cores(&self) -> Vec<u32> {
        self.modules.iter().flat_map(|module| module.cores.clone()).collect()
    }

    /// Whether the partition is a replica whose voter is on another module.
    #[must_use]
    pub fn is_voted_elsewhere(&self, partition: &Partition) -> bool {
        let has_it = |voter: &Partition| voter.replicas.iter().any(|&id| self[id].name == partition.name);
        self.partitions.iter().any(|voter| voter.module != partition.module && has_it(voter))
    }

    /// Whether what is set in the partition of that name is set in this one: a voter hands it to its replicas.
    #[must_use]
    pub fn takes_settings_of(&self, id: PartitionId, name: &str) -> bool {
        let by_voter = || self.voter_of(id).is_some_and(|voter| self[voter].name == name);
        (self[id].name == name && self[id].replicas.is_empty()) || by_voter()
    }

    /// The relay of a module, where something crosses.
    #[must_use]
    pub fn relay_of(&self, module: ModuleId) -> Option<PartitionId> {
        self.partition_ids().find(|&id| self[id].relay && self[id].module == module)
    }

    /// How far apart the major frames of two modules may begin, ns; `None`: anyhow, because neither follows the other and
    /// both do not follow a third, or the disciplined clock.
    #[must_use]
    pub fn aligned_within_ns(&self, one: ModuleId, other: ModuleId) -> Option<u64> {
        let (first, own) = self.followed_to_the_end(one);
        let (second, others) = self.followed_to_the_end(other);
        (first == second).then_some(own.saturating_add(others))
    }

    /// Who is followed in the end, directly or through others, and with which error at most, ns; nobody: the disciplined clock.
    fn followed_to_the_end(&self, module: ModuleId) -> (Option<ModuleId>, u64) {
        let (mut at, mut error_ns) = (module, 0_u64);
        // No longer than there are modules: the rules let no circle through.
        for _ in 0..self.modules.len() {
            let Some(leader) = self[at].follows else { break };
            error_ns = error_ns.saturating_add(self[at].follows_within_ns);
            at = leader;
        }
        if self[at].clock == ModuleClock::Realtime {
            return (None, error_ns.saturating_add(self[at].follows_within_ns));
        }
        (Some(at), error_ns)
    }

    /// What becomes of a partition when the module changes from one schedule to another. A partition that did not run
    /// before starts from nothing, unless the file says otherwise.
    #[must_use]
    pub fn change_action(
        &self,
        before: ScheduleId,
        after: ScheduleId,
        partition: PartitionId,
    ) -> ChangeAction {
        match self[after].change_actions.get(&partition) {
            Some(action) => *action,
            None if !self[before].runs(partition) => ChangeAction::ColdRestart,
            None => ChangeAction::Ignore,
        }
    }

    /// A port as the file writes it: `partition.port`.
    #[must_use]
    pub fn port_path(&self, id: PortId) -> String {
        format!("{}.{}", self[self[id].partition].name, self[id].name)
    }

    /// Every schedule's place in the plan.
    pub fn schedule_ids(&self) -> impl Iterator<Item = ScheduleId> + use<> {
        (0..self.schedules.len()).map(ScheduleId)
    }

    /// Every channel's place in the plan.
    pub fn channel_ids(&self) -> impl Iterator<Item = ChannelId> + use<> {
        (0..self.channels.len()).map(ChannelId)
    }

    /// Every partition with its place in the plan.
    pub fn partition_ids(&self) -> impl Iterator<Item = PartitionId> + use<> {
        (0..self.partitions.len()).map(PartitionId)
    }
}

/// The part of a plan that one module runs.
#[derive(Clone, Copy, Debug)]
pub struct ModuleView<'a> {
    plan: &'a Plan,
    id: ModuleId,
}

impl<'a> ModuleView<'a> {
    /// The module's place in the plan.
    #[must_use]
    pub fn id(self) -> ModuleId {
        self.id
    }

    /// The whole plan.
    #[must_use]
    pub fn plan(self) -> &'a Plan {
        self.plan
    }

    /// The module's name.
    #[must_use]
    pub fn name(self) -> &'a str {
        &self.plan[self.id].name
    }

    /// The cores whose time is partitioned.
    #[must_use]
    pub fn cores(self) -> &'a [u32] {
        &self.plan[self.id].cores
    }

    /// The partitions that run here.
    pub fn partitions(self) -> impl Iterator<Item = PartitionId> + use<'a> {
        let plan = self.plan;
        plan.partition_ids().filter(move |&id| plan[id].module == self.id && !plan[id].played)
    }

    /// The channels with every end here.
    pub fn channels(self) -> impl Iterator<Item = ChannelId> + use<'a> {
        self.channels_where(|here, ends| here == ends)
    }

    /// The channels with some ends here and others elsewhere.
    pub fn crossing_channels(self) -> impl Iterator<Item = ChannelId> + use<'a> {
        self.channels_where(|here, ends| here > 0 && here < ends)
    }

    fn channels_where(self, wanted: fn(usize, usize) -> bool) -> impl Iterator<Item = ChannelId> + use<'a> {
        (0..self.plan.channels.len()).map(ChannelId).filter(move |&id| {
            let channel = &self.plan[id];
            let ends = channel.destinations.iter().chain([&channel.source]);
            let here = ends.filter(|&&port| self.hosts(port)).count();
            wanted(here, channel.destinations.len() + 1)
        })
    }

    fn hosts(self, port: PortId) -> bool {
        self.plan[self.plan[port].partition].module == self.id
    }
}

impl PartitionHealth {
    /// The table with an action for every error of the set.
    #[must_use]
    pub fn fill(action: impl Fn(PartitionError) -> PartitionAction) -> Self {
        Self(PartitionError::ALL.iter().map(|&error| (error, action(error))).collect())
    }
}

impl ModuleHealth {
    /// The table with an action for every error of the set.
    #[must_use]
    pub fn fill(action: impl Fn(ModuleError) -> ModuleAction) -> Self {
        Self(ModuleError::ALL.iter().map(|&error| (error, action(error))).collect())
    }
}
