//! What the file says, table by table, with the place of every value: names are not yet looked up, and nothing is
//! compared with anything else.

use std::net::{SocketAddr, SocketAddrV4};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::catalogue;
use super::closed::{
    ChangeAction, Closed, Direction, ErrorLevel, Exhausted, Isolation, Kind, LogPolicy, ModuleAction,
    ModuleClock, ModuleError, PartitionAction, PartitionError, PartitionState, Standby, StartMode,
    SystemCalls, Transport,
};
use super::findings::{Finding, Findings, Span};
use super::reader::{
    At, Attributes, Bytes, Entry, Field, FromToml, Nanoseconds, Permission, Rate, Replicas, TableReader,
    Word, in_order, table_of,
};
use super::units;
use bateleur_plan::words::{did_you_mean, listed};

/// The whole file.
pub(super) struct RawFile {
    pub(super) modules: Vec<RawModule>,
    pub(super) networks: Vec<RawNetwork>,
    pub(super) links: Vec<RawLink>,
    pub(super) partitions: Vec<RawPartition>,
    /// The ports of all partitions.
    pub(super) ports: Vec<RawPort>,
    /// The folder with message types.
    pub(super) messages: Field<String>,
    /// Of channels that say nothing themselves.
    pub(super) isolation: Field<Word<Isolation>>,
    pub(super) channels: Vec<RawChannel>,
    pub(super) memory_blocks: Vec<RawMemoryBlock>,
    pub(super) name_services: Vec<RawNameService>,
    pub(super) chains: Vec<RawChain>,
    pub(super) schedules: Vec<RawSchedule>,
    pub(super) health: RawHealth,
}

pub(super) type Names = Field<Vec<At<String>>>;
pub(super) type Numbers = Field<Vec<At<u32>>>;

pub(super) struct RawModule {
    pub(super) name: At<String>,
    pub(super) cores: Numbers,
    pub(super) housekeeping_cores: Numbers,
    /// Where it is reached, by network.
    pub(super) addresses: Vec<(At<String>, At<SocketAddr>)>,
    pub(super) follows: Field<String>,
    pub(super) clock: Field<Word<ModuleClock>>,
    pub(super) follows_within: Field<Nanoseconds>,
}

pub(super) struct RawNetwork {
    pub(super) name: At<String>,
    pub(super) rate: Field<Rate>,
    pub(super) latency: Field<Nanoseconds>,
}

pub(super) struct RawLink {
    pub(super) name: At<String>,
    pub(super) modules: Names,
    pub(super) networks: Names,
    pub(super) transport: Field<Word<Transport>>,
    pub(super) key: Field<String>,
    pub(super) unauthenticated: Field<bool>,
    pub(super) gap: Field<Nanoseconds>,
    pub(super) max_bytes: Field<u32>,
    pub(super) skew: Field<Nanoseconds>,
    pub(super) lost_after: Field<Nanoseconds>,
}

#[derive(Clone)]
pub(super) struct RawPartition {
    /// No table of the file: see [`super::relays`].
    pub(super) generated: bool,
    pub(super) name: At<String>,
    /// Three of it, or where each of the three runs.
    pub(super) replicas: Field<Replicas>,
    /// The places of its replicas, filled in by `resolve::replicas`.
    pub(super) voted: Vec<usize>,
    pub(super) program: Field<String>,
    pub(super) module: Field<String>,
    pub(super) memory: Field<Bytes>,
    pub(super) threads: Field<u32>,
    pub(super) identifier: Field<u32>,
    pub(super) period: Field<Nanoseconds>,
    pub(super) duration: Field<Nanoseconds>,
    pub(super) processes: Field<u32>,
    pub(super) stacks: Field<Bytes>,
    pub(super) declared: Vec<RawProcess>,
    pub(super) restart: RawRestart,
    pub(super) standby: Field<Word<Standby>>,
    pub(super) startup_timeout: Field<Nanoseconds>,
    pub(super) deadline: Field<Nanoseconds>,
    pub(super) priority: Field<u32>,
    pub(super) network: Field<bool>,
    pub(super) devices: Names,
    pub(super) system_calls: Field<Vec<At<Word<SystemCalls>>>>,
    pub(super) retained: Field<Bytes>,
    pub(super) logbooks: Vec<RawLogbook>,
    pub(super) attributes: Field<Attributes>,
    pub(super) may_set_schedule: Field<Permission>,
    pub(super) health: Vec<Answer<PartitionError, PartitionAction>>,
    pub(super) error_handler: Field<bool>,
    pub(super) health_texts: Field<bool>,
}

#[derive(Clone)]
pub(super) struct RawProcess {
    pub(super) name: At<String>,
    pub(super) priority: Field<u32>,
    pub(super) period: Field<Nanoseconds>,
    pub(super) deadline: Field<Nanoseconds>,
    pub(super) wcet: Field<Nanoseconds>,
}

#[derive(Clone)]
pub(super) struct RawLogbook {
    pub(super) name: At<String>,
    pub(super) max_size: Field<u32>,
    pub(super) max_logged: Field<u32>,
    pub(super) max_in_progress: Field<u32>,
}

#[derive(Clone)]
pub(super) struct RawRestart {
    pub(super) start: Field<Word<StartMode>>,
    pub(super) budget: Field<u32>,
    pub(super) within: Field<Nanoseconds>,
    pub(super) then: Field<Word<Exhausted>>,
    pub(super) startup: Field<Nanoseconds>,
}

#[derive(Clone)]
pub(super) struct RawPort {
    /// The place of the partition in the file.
    pub(super) partition: usize,
    pub(super) name: At<String>,
    pub(super) direction: Field<Word<Direction>>,
    pub(super) kind: Field<Word<Kind>>,
    pub(super) message: Field<String>,
    pub(super) max_size: Field<u32>,
    pub(super) refresh: Field<Nanoseconds>,
    pub(super) depth: Field<u32>,
    pub(super) optional: Field<bool>,
    pub(super) operator: Field<bool>,
    pub(super) outvote: Field<bool>,
}

#[derive(Clone)]
pub(super) struct RawChannel {
    pub(super) span: Span,
    pub(super) source: Field<String>,
    pub(super) destinations: Names,
    pub(super) isolation: Field<Word<Isolation>>,
}

#[derive(Clone)]
pub(super) struct RawChain {
    pub(super) name: Field<String>,
    pub(super) path: Names,
    pub(super) max_age: Field<Nanoseconds>,
}

pub(super) struct RawSchedule {
    pub(super) name: At<String>,
    pub(super) major_frame: Field<Nanoseconds>,
    pub(super) minor_frame: Field<Nanoseconds>,
    pub(super) initial: Field<bool>,
    pub(super) windows: Vec<RawWindow>,
    /// It has no windows, and a key that nobody knows: they may well stand under that.
    pub(super) windows_mistyped: bool,
    /// What becomes of partitions when the module changes to it, by name.
    pub(super) change_actions: Vec<(At<String>, At<ChangeAction>)>,
}

pub(super) struct RawWindow {
    pub(super) partition: Field<String>,
    pub(super) offset: Field<Nanoseconds>,
    pub(super) duration: Field<Nanoseconds>,
    pub(super) core: Field<u32>,
    pub(super) minor: Numbers,
}

#[derive(Default)]
pub(super) struct RawHealth {
    pub(super) partition: Vec<Answer<PartitionError, PartitionAction>>,
    /// Where the table for all partitions begins, if there is one.
    pub(super) partition_span: Option<Span>,
    pub(super) module: Vec<Answer<ModuleError, ModuleAction>>,
    /// Where the table of the module begins, if there is one.
    pub(super) module_span: Option<Span>,
    pub(super) levels: Vec<RawLevel>,
    pub(super) silence_windows: Option<At<u32>>,
    pub(super) late_after: Option<At<Nanoseconds>>,
    pub(super) reset_budget: Option<At<u32>>,
    pub(super) reset_within: Option<At<Nanoseconds>>,
    pub(super) reset_startup: Option<At<Nanoseconds>>,
    pub(super) log_size: Option<At<Bytes>>,
    pub(super) log_policy: Option<At<Word<LogPolicy>>>,
}

/// At which level one error is dealt with.
#[derive(Clone, Debug)]
pub(super) struct RawLevel {
    pub(super) error: PartitionError,
    /// In this state; `None`: in every one.
    pub(super) state: Option<PartitionState>,
    pub(super) level: At<ErrorLevel>,
}

/// What is to be done about one error.
#[derive(Clone, Debug)]
pub(super) struct Answer<E, A> {
    pub(super) error: E,
    pub(super) action: At<A>,
}

impl RawFile {
    /// Reads a parsed document; whatever is wrong with it is noted.
    pub(super) fn read(document: &DeTable<'_>, findings: &Findings<'_>) -> Self {
        let mut file = TableReader::new(document, 0..0, "the file", findings);
        let messages = file.optional("messages");
        let isolation = file.optional("isolation");
        let modules = file.entries("module");
        let networks = file.entries("network");
        let links = file.entries("link");
        let partitions = file.entries("partition");
        let channels = file.tables("channel");
        let memory_blocks = file.entries("memory_block").into_iter();
        let name_services = file.entries("name_service").into_iter();
        let chains = file.tables("chain");
        let schedules = file.entries("schedule");
        let health = file.table("health");
        file.finish();
        let beside = Beside::of(&modules, &partitions);
        let mut ports = Vec::new();
        let mut owners = Vec::new();
        for entry in partitions {
            owners.extend(RawPartition::read(entry, owners.len(), &mut ports, (&beside, findings)));
        }
        Self {
            partitions: owners,
            modules: modules.into_iter().filter_map(|entry| RawModule::read(entry, findings)).collect(),
            networks: networks.into_iter().filter_map(|entry| RawNetwork::read(entry, findings)).collect(),
            links: links.into_iter().filter_map(|entry| RawLink::read(entry, &beside, findings)).collect(),
            ports,
            messages,
            isolation,
            channels: channels.into_iter().map(|table| RawChannel::read(table, findings)).collect(),
            memory_blocks: memory_blocks.filter_map(|entry| RawMemoryBlock::read(entry, findings)).collect(),
            name_services: name_services.filter_map(|entry| RawNameService::read(entry, findings)).collect(),
            chains: chains.into_iter().map(|table| RawChain::read(table, findings)).collect(),
            schedules: schedules.into_iter().filter_map(|entry| RawSchedule::read(entry, findings)).collect(),
            health: health.map(|table| RawHealth::read(table, &beside, findings)).unwrap_or_default(),
        }
    }
}

/// Names in the file that the mends of other tables need.
struct Beside {
    modules: Vec<String>,
    partitions: Vec<String>,
    /// The partitions without ports.
    portless: Vec<String>,
}

impl Beside {
    fn of(modules: &[Entry<'_, '_>], partitions: &[Entry<'_, '_>]) -> Self {
        let has_ports =
            |value: &DeValue<'_>| value.as_table().is_some_and(|table| table.contains_key("port"));
        let portless = partitions.iter().filter(|(_, value)| !has_ports(value.get_ref()));
        let name = |(name, _): &Entry<'_, '_>| name.value.clone();
        Self {
            modules: modules.iter().map(name).collect(),
            partitions: partitions.iter().map(name).collect(),
            portless: portless.map(name).collect(),
        }
    }

    /// An example of a module: one of the file where it has one.
    fn module(&self) -> String {
        format!("\"{}\"", self.modules.first().map_or("fcu", String::as_str))
    }

    /// An example of the two ends of a link.
    fn two_modules(&self) -> String {
        match self.modules.as_slice() {
            [one, other, ..] => format!("[\"{one}\", \"{other}\"]"),
            _ => "[\"fcu\", \"nav\"]".to_owned(),
        }
    }

    /// Where the answers of one partition belong, if this is one.
    fn own_answers(&self, name: &str) -> Option<String> {
        let is_one = self.partitions.iter().any(|partition| partition == name);
        is_one.then(|| format!("what holds for `{name}` alone is `health = {{ … }}` in `[partition.{name}]`"))
    }
}

/// A memory block.
pub(super) struct RawMemoryBlock {
    pub(super) name: At<String>,
    pub(super) size: Field<Bytes>,
    pub(super) content: Field<String>,
    pub(super) read: Names,
    pub(super) read_write: Names,
}

impl RawMemoryBlock {
    fn read(entry: Entry<'_, '_>, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("memory block", &entry, findings)?;
        let block = Self {
            name: entry.0,
            size: table.required("size", "\"64KiB\""),
            content: table.optional("content"),
            read: table.optional("read"),
            read_write: table.optional("read_write"),
        };
        table.finish();
        Some(block)
    }

    /// The partitions that it names, first those that only read.
    pub(super) fn partitions(&self) -> impl Iterator<Item = &At<String>> {
        self.read.items().iter().chain(self.read_write.items())
    }
}

/// What a name service knows.
pub(super) struct RawNameService {
    pub(super) name: At<String>,
    /// Addresses of service access points, by their names.
    pub(super) addresses: Vec<(At<String>, At<SocketAddrV4>)>,
}

impl RawNameService {
    fn read((name, value): Entry<'_, '_>, findings: &Findings<'_>) -> Option<Self> {
        let addresses = in_order(table_of(value, findings)?).into_iter().filter_map(|(point, value)| {
            let address = SocketAddrV4::from_toml(value, findings)?;
            Some((point, At { value: address, span: value.span() }))
        });
        Some(Self { addresses: addresses.collect(), name })
    }
}

/// A reader for a table that has a name.
fn named<'r, 'i>(
    what: &str,
    entry: &Entry<'r, 'i>,
    findings: &'r Findings<'r>,
) -> Option<TableReader<'r, 'i>> {
    let (name, value) = entry;
    let table = table_of(value, findings)?;
    Some(TableReader::new(table, name.span.clone(), format!("{what} `{}`", name.value), findings))
}

impl RawModule {
    fn read(entry: Entry<'_, '_>, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("module", &entry, findings)?;
        let cores = table.required("cores", "[1]");
        let housekeeping_cores = table.optional("housekeeping_cores");
        let addresses = table.entries("addresses").into_iter();
        let addresses = addresses.filter_map(|(network, value)| {
            let socket = SocketAddr::from_toml(value, findings)?;
            Some((network, At { value: socket, span: value.span() }))
        });
        let addresses = addresses.collect();
        let follows = table.optional("follows");
        let clock = table.optional("clock");
        let follows_within = table.optional("follows_within");
        table.finish();
        Some(Self { name: entry.0, cores, housekeeping_cores, addresses, follows, clock, follows_within })
    }
}

impl RawNetwork {
    fn read(entry: Entry<'_, '_>, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("network", &entry, findings)?;
        let rate = table.required("rate", "\"100Mbit/s\"");
        let network = Self { name: entry.0, rate, latency: table.optional("latency") };
        table.finish();
        Some(network)
    }
}

impl RawLink {
    fn read(entry: Entry<'_, '_>, beside: &Beside, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("link", &entry, findings)?;
        let link = Self {
            modules: table.required("modules", &beside.two_modules()),
            networks: table.optional("networks"),
            transport: table.optional("transport"),
            key: table.optional("key"),
            unauthenticated: table.optional("unauthenticated"),
            gap: table.required("gap", "\"4ms\""),
            max_bytes: table.optional("max_bytes"),
            skew: table.optional("skew"),
            lost_after: table.optional("lost_after"),
            name: entry.0,
        };
        table.finish();
        Some(link)
    }
}

impl RawPartition {
    fn read(
        entry: Entry<'_, '_>,
        place: usize,
        ports: &mut Vec<RawPort>,
        (beside, findings): (&Beside, &Findings<'_>),
    ) -> Option<Self> {
        let mut table = named("partition", &entry, findings)?;
        // Where the name is followed by another, it has no table of its own.
        let name_end = entry.0.span.end;
        let has_only_ports = findings.source(&(name_end..name_end + 1)) == "."
            && entry
                .1
                .get_ref()
                .as_table()
                .is_some_and(|table| table.len() == 1 && table.contains_key("port"));
        let partition = Self {
            generated: false,
            replicas: table.optional("replicas"),
            voted: Vec::new(),
            program: table.required("program", &format!("\"{}\"", entry.0.value)),
            module: table.required("module", &beside.module()),
            memory: table.required("memory", "\"32MiB\""),
            threads: table.optional("threads"),
            identifier: table.optional("identifier"),
            period: table.optional("period"),
            duration: table.optional("duration"),
            processes: table.optional("processes"),
            stacks: table.optional("stacks"),
            declared: RawProcess::all(&mut table, findings),
            restart: RawRestart::read(table.table("restart"), findings),
            standby: table.optional("standby"),
            startup_timeout: table.optional("startup_timeout"),
            deadline: table.optional("deadline"),
            priority: table.optional("priority"),
            network: table.optional("network"),
            devices: table.optional("devices"),
            system_calls: table.optional("system_calls"),
            retained: table.optional("retained"),
            logbooks: RawLogbook::all(&mut table, findings),
            attributes: table.optional("attributes"),
            may_set_schedule: table.optional("may_set_schedule"),
            health: answers(&table.entries("health"), &PARTITION_LEVEL, (beside, findings)),
            error_handler: table.optional("error_handler"),
            health_texts: table.optional("health_texts"),
            name: entry.0,
        };
        let entries = table.entries("port").into_iter();
        ports.extend(entries.filter_map(|entry| RawPort::read(entry, place, findings)));
        if has_only_ports {
            let name = &partition.name.value;
            let message =
                format!("partition `{name}` has ports, but no table with `program`, `module` and `memory`");
            let mend = match beside.portless.as_slice() {
                [other] => format!("write `[partition.{other}.port]`, or add `[partition.{name}]`"),
                _ => format!("add `[partition.{name}]`, or give the ports to another partition"),
            };
            table.missing_all(message, mend);
        }
        table.finish();
        Some(partition)
    }
}

impl RawProcess {
    /// Those of a partition's table.
    fn all(partition: &mut TableReader<'_, '_>, findings: &Findings<'_>) -> Vec<Self> {
        let entries = partition.entries("process").into_iter();
        let read = |entry: Entry<'_, '_>| {
            let mut table = named("process", &entry, findings)?;
            let process = Self {
                name: entry.0,
                priority: table.required("priority", "20"),
                period: table.optional("period"),
                deadline: table.optional("deadline"),
                wcet: table.required("wcet", "\"1ms\""),
            };
            table.finish();
            Some(process)
        };
        entries.filter_map(read).collect()
    }
}

impl RawLogbook {
    /// Those of a partition's table.
    fn all(partition: &mut TableReader<'_, '_>, findings: &Findings<'_>) -> Vec<Self> {
        let entries = partition.entries("logbook").into_iter();
        let read = |entry: Entry<'_, '_>| {
            let mut table = named("logbook", &entry, findings)?;
            let logbook = Self {
                name: entry.0,
                max_size: table.required("max_size", "64"),
                max_logged: table.required("max_logged", "100"),
                max_in_progress: table.required("max_in_progress", "4"),
            };
            table.finish();
            Some(logbook)
        };
        entries.filter_map(read).collect()
    }
}

impl RawRestart {
    fn read(table: Option<(&DeTable<'_>, Span)>, findings: &Findings<'_>) -> Self {
        let empty = DeTable::new();
        let (table, span) = table.unwrap_or((&empty, 0..0));
        let mut table = TableReader::new(table, span, "`restart`", findings);
        let restart = Self {
            start: table.optional("start"),
            budget: table.optional("budget"),
            within: table.optional("within"),
            then: table.optional("then"),
            startup: table.optional("startup"),
        };
        table.finish();
        restart
    }
}

impl RawPort {
    fn read(entry: Entry<'_, '_>, partition: usize, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("port", &entry, findings)?;
        let port = Self {
            partition,
            name: entry.0,
            direction: table.required("direction", "\"source\""),
            kind: table.required("kind", "\"sampling\""),
            message: table.optional("message"),
            max_size: table.optional("max_size"),
            refresh: table.optional("refresh"),
            depth: table.optional("depth"),
            optional: table.optional("optional"),
            operator: table.optional("operator"),
            outvote: table.optional("outvote"),
        };
        table.finish();
        Some(port)
    }
}

impl RawChannel {
    fn read((table, span): (&DeTable<'_>, Span), findings: &Findings<'_>) -> Self {
        let mut table = TableReader::new(table, span.clone(), "channel", findings);
        let channel = Self {
            span,
            source: table.required("source", "\"partition.port\""),
            destinations: table.required("destinations", "[\"partition.port\"]"),
            isolation: table.optional("isolation"),
        };
        table.finish();
        channel
    }
}

impl RawChain {
    fn read((table, span): (&DeTable<'_>, Span), findings: &Findings<'_>) -> Self {
        let mut table = TableReader::new(table, span, "chain", findings);
        let chain = Self {
            name: table.required("name", "\"sensor to actuator\""),
            path: table.required("path", "[\"partition.port\", \"partition.port\"]"),
            max_age: table.required("max_age", "\"25ms\""),
        };
        table.finish();
        chain
    }
}

impl RawSchedule {
    fn read(entry: Entry<'_, '_>, findings: &Findings<'_>) -> Option<Self> {
        let mut table = named("schedule", &entry, findings)?;
        let major_frame = table.required("major_frame", "\"100ms\"");
        let minor_frame = table.required("minor_frame", "\"20ms\"");
        let initial = table.optional("initial");
        let windows = table.tables("window").into_iter();
        let windows: Vec<_> = windows.map(|window| RawWindow::read(window, findings)).collect();
        let actions = table.entries("change_action").into_iter();
        let change_actions = actions.filter_map(|(name, value)| {
            let action = Word::<ChangeAction>::from_toml(value, findings)?.0;
            Some((name, At { value: action, span: value.span() }))
        });
        let change_actions = change_actions.collect();
        let windows_mistyped = windows.is_empty() && table.has_unknown_keys();
        table.finish();
        let name = entry.0;
        Some(Self { name, major_frame, minor_frame, initial, windows, windows_mistyped, change_actions })
    }
}

impl RawWindow {
    fn read((table, span): (&DeTable<'_>, Span), findings: &Findings<'_>) -> Self {
        let mut table = TableReader::new(table, span, "window", findings);
        let window = Self {
            partition: table.required("partition", "\"imu\""),
            offset: table.required("offset", "\"3ms\""),
            duration: table.required("duration", "\"500us\""),
            core: table.optional("core"),
            minor: table.optional("minor"),
        };
        table.finish();
        window
    }
}

impl RawHealth {
    fn read((table, span): (&DeTable<'_>, Span), beside: &Beside, findings: &Findings<'_>) -> Self {
        let mut table = TableReader::new(table, span, "`health`", findings);
        let mut health = Self {
            partition_span: table.table("partition").map(|(_, span)| span),
            partition: answers(&table.entries("partition"), &PARTITION_LEVEL, (beside, findings)),
            module_span: table.table("module").map(|(_, span)| span),
            module: answers(&table.entries("module"), &MODULE_LEVEL, (beside, findings)),
            levels: levels(&table.entries("level"), findings),
            silence_windows: match table.optional("silence_windows") {
                Field::Said(at) => Some(at),
                Field::Absent | Field::Broken => None,
            },
            late_after: table.optional("late_after").said().cloned(),
            ..Self::default()
        };
        if let Some((reset, span)) = table.table("reset") {
            let mut reset = TableReader::new(reset, span, "the reset of the module", findings);
            health.reset_budget = reset.optional("budget").said().cloned();
            health.reset_within = reset.optional("within").said().cloned();
            health.reset_startup = reset.optional("startup").said().cloned();
            reset.finish();
        }
        if let Some((log, span)) = table.table("log") {
            let mut log = TableReader::new(log, span, "the health log", findings);
            health.log_size = log.optional("size").said().cloned();
            health.log_policy = log.optional("policy").said().cloned();
            log.finish();
        }
        table.finish_with(|key| beside.own_answers(key));
        health
    }
}

/// A level of the health monitor: its own name, and what belongs to the other one.
struct Level {
    own: &'static str,
    other: &'static str,
    is_other_error: fn(&str) -> bool,
    is_other_action: fn(&str) -> bool,
}

const PARTITION_LEVEL: Level = Level {
    own: "partition",
    other: "module",
    is_other_error: |name| ModuleError::from_name(name).is_some(),
    is_other_action: |name| ModuleAction::from_name(name).is_some(),
};

const MODULE_LEVEL: Level = Level {
    own: "module",
    other: "partition",
    is_other_error: |name| PartitionError::from_name(name).is_some(),
    is_other_action: |name| PartitionAction::from_name(name).is_some(),
};

fn levels(entries: &[Entry<'_, '_>], findings: &Findings<'_>) -> Vec<RawLevel> {
    let mut levels = Vec::new();
    for (key, value) in entries {
        let error = error_named::<PartitionError>(key, &PARTITION_LEVEL, findings);
        let mut found = Vec::new();
        match value.get_ref() {
            DeValue::Table(states) => {
                let what = format!("the level of `{}`", key.value);
                let mut table = TableReader::new(states, key.span.clone(), what, findings);
                for state in PartitionState::ALL {
                    found.push((Some(*state), table.optional::<Word<ErrorLevel>>(state.name())));
                }
                table.finish();
            }
            _ => {
                let said = Word::from_toml(value, findings);
                found.extend(said.map(|word| (None, Field::Said(At { value: word, span: value.span() }))));
            }
        }
        let Some(error) = error else { continue };
        levels.extend(found.into_iter().filter_map(|(state, field)| {
            let said = field.said()?;
            Some(RawLevel { error, state, level: At { value: said.value.0, span: said.span.clone() } })
        }));
    }
    levels
}

fn answers<E: Closed, A: Closed>(
    entries: &[Entry<'_, '_>],
    level: &Level,
    (beside, findings): (&Beside, &Findings<'_>),
) -> Vec<Answer<E, A>> {
    let read = |(key, value): &Entry<'_, '_>| {
        let own = beside.own_answers(&key.value).filter(|_| value.get_ref().is_table());
        if let Some(mend) = own {
            let message = format!("`{}` is a partition, and no error of a {}", key.value, level.own);
            findings.add(Finding::new(&catalogue::UNKNOWN_ERROR, &key.span, message, mend));
            return None;
        }
        // Both are read before either is given up, so that both faults of a line are reported.
        let error = error_named(key, level, findings);
        let action = action_in(value, level, findings);
        Some(Answer { error: error?, action: action? })
    };
    entries.iter().filter_map(read).collect()
}

fn error_named<E: Closed>(key: &At<String>, level: &Level, findings: &Findings<'_>) -> Option<E> {
    let error = E::from_name(&key.value);
    if error.is_none() {
        let (own, other) = (level.own, level.other);
        let message = format!("`{}` is no error of a {own}", key.value);
        let mend = if (level.is_other_error)(&key.value) {
            format!("it is an error of a {other}: move it to `[health.{other}]`")
        } else {
            did_you_mean(&key.value, E::ALL.iter().map(|error| error.name()))
        };
        findings.add(Finding::new(&catalogue::UNKNOWN_ERROR, &key.span, message, mend));
    }
    error
}

fn action_in<A: Closed>(
    value: &Spanned<DeValue<'_>>,
    level: &Level,
    findings: &Findings<'_>,
) -> Option<At<A>> {
    let name = String::from_toml(value, findings)?;
    let action = A::from_name(&name);
    if action.is_none() {
        let (own, other) = (level.own, level.other);
        let legal = || A::ALL.iter().map(|action| action.name());
        let (message, mend) = if (level.is_other_action)(&name) {
            (format!("`{name}` is an action of a {other}, not of a {own}"), listed(legal()))
        } else {
            (format!("`{name}` is no action of a {own}"), String::new())
        };
        let mend =
            if mend.is_empty() { did_you_mean(&name, legal()) } else { format!("choose one of {mend}") };
        findings.add(Finding::new(&catalogue::ILLEGAL_ACTION, &value.span(), message, mend));
    }
    action.map(|value_| At { value: value_, span: value.span() })
}

/// Parses a file; the parser's first complaint is noted, and then there is nothing to read.
///
/// The parser goes on after a fault, but what it finds then is mostly a consequence of the first.
pub(super) fn parse<'i>(text: &'i str, findings: &Findings<'_>) -> Option<Spanned<DeTable<'i>>> {
    let error = match DeTable::parse(text) {
        Ok(document) => return Some(document),
        Err(error) => error,
    };
    let span = error.span().unwrap_or(0..0);
    // The parser tells its complaints apart by their text only.
    findings.add(if error.message() == "duplicate key" {
        twice(text, &span)
    } else if let Some((span, value)) = unquoted(text, span.start, error.message()) {
        let (message, mend) = (format!("`{value}` stands without quotes"), format!("write `\"{value}\"`"));
        Finding::new(&catalogue::SYNTAX, &span, message, mend)
    } else {
        let mend = "how TOML is written stands at https://toml.io";
        Finding::new(&catalogue::SYNTAX, &span, error.message(), mend)
    });
    None
}

/// The value around a place at which the parser stopped, if all that it lacks is quotes.
fn unquoted<'t>(text: &'t str, at: usize, complaint: &str) -> Option<(Span, &'t str)> {
    let before = |letter: char| letter.is_ascii_whitespace() || "=[,{".contains(letter);
    let behind = |letter: char| letter.is_ascii_whitespace() || ",]}#".contains(letter);
    let start = text.get(..at)?.rfind(before)? + 1;
    let end = at + text[at..].find(behind).unwrap_or(text.len() - at);
    let value = &text[start..end];
    let is_value = text[..start].trim_end().ends_with(['=', '[', ',']);
    let is_word = value.chars().all(|letter| letter.is_alphanumeric() || "._-/".contains(letter));
    let is_quantity = units::duration_ns(value).is_ok()
        || units::size_bytes(value).is_ok()
        || units::rate_bits_per_s(value).is_ok();
    let lacks_quotes = is_quantity || complaint.contains("must be quoted");
    (is_value && is_word && !value.is_empty() && lacks_quotes).then_some((start..end, value))
}

/// A key that is in its table already, with the place of the first one.
fn twice(text: &str, span: &Span) -> Finding {
    /// In place of the second one, which the parser then takes.
    const SECOND: &str = "the-second-of-two";
    let key = text.get(span.clone()).unwrap_or("this key");
    let renamed = [&text[..span.start], SECOND, &text[span.end..]].concat();
    let (document, _) = DeTable::parse_recoverable(&renamed);
    let first = beside_key(document.get_ref(), SECOND, key.trim_matches(['"', '\'']));
    let first = first.filter(|(_, first)| first.start < span.start);
    let message = format!("`{key}` is there already");
    let Some((tables, first)) = first else {
        return Finding::new(
            &catalogue::DUPLICATE_NAME,
            span,
            message,
            "rename one of the two, or join them",
        );
    };
    let is_list = match tables.as_slice() {
        [] => ["channel", "chain"].contains(&key),
        [table, _] => table == "schedule" && key == "window",
        _ => false,
    };
    let line = |at: usize| text[..at].rsplit('\n').next().unwrap_or_default().trim_start();
    let in_header = |at: usize| line(at).starts_with('[');
    let path = tables.iter().map(String::as_str).chain([key]).collect::<Vec<_>>().join(".");
    let mend = match (is_list && in_header(span.start), in_header(first.start)) {
        (true, true) => format!("write `[[{path}]]`, in double brackets, each time"),
        (true, false) => "write it into the list there".to_owned(),
        (false, _) => "rename one of the two, or join them".to_owned(),
    };
    Finding::new(&catalogue::DUPLICATE_NAME, span, message, mend).also(&first, "the first one is here")
}

/// Where the key `first` stands in the table that has `second`, with the names of the tables above it.
fn beside_key(table: &DeTable<'_>, second: &str, first: &str) -> Option<(Vec<String>, Span)> {
    if table.contains_key(second) {
        return Some((Vec::new(), table.get_key_value(first)?.0.span()));
    }
    table.iter().find_map(|(key, value)| {
        let (mut tables, span) = match value.get_ref() {
            DeValue::Table(table) => beside_key(table, second, first)?,
            DeValue::Array(items) => {
                items.iter().find_map(|item| beside_key(item.get_ref().as_table()?, second, first))?
            }
            _ => return None,
        };
        tables.insert(0, key.get_ref().to_string());
        Some((tables, span))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_read_in_the_order_of_the_file() {
        let text = "[module.z]\ncores = [1]\n[module.a]\ncores = [2]\n";
        let findings = Findings::new(text, |_| Vec::new());
        let document = parse(text, &findings).unwrap();
        let file = RawFile::read(document.get_ref(), &findings);
        let names: Vec<&str> = file.modules.iter().map(|module| module.name.value.as_str()).collect();
        assert_eq!(names, ["z", "a"]);
    }
}
