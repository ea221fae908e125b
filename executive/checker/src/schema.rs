//! The schedule file as a JSON schema (draft 2020-12), for editors.
//!
//! Keys and types are the reader's own: it reads a file that has one table of each kind, and says what it asked each of
//! them for. So a new key is in the schema as soon as it is read; only its description stands here. The schema must never
//! refuse what the reader takes.

use std::net::{SocketAddr, SocketAddrV4};

use serde_json::{Map, Value, json};

use super::closed::{
    ChangeAction, Closed, ErrorLevel, ModuleAction, ModuleError, PartitionAction, PartitionError,
    PartitionState,
};
use super::findings::{Findings, Key, Under};
use super::raw::{self, RawFile};
use super::reader::{FromToml, one_of_the_words};

/// A file with one table of each kind.
const PROBE: &str = "
module.x = { addresses = {} }
network.x = {}
link.x = {}
partition.x = { restart = {}, process.x = {}, logbook.x = {}, port.x = {}, health = {} }
channel = [{}]
memory_block.x = {}
name_service.x = {}
chain = [{}]
schedule.x = { window = [{}], change_action = {} }
health = { level = {}, partition = {}, module = {}, reset = {}, log = {} }
";

/// What stands in a table that is no value.
enum Inner {
    /// Tables of this kind by their names.
    Named(&'static str),
    /// One table of this kind, or a list of them.
    Plain(&'static str),
    /// Something else.
    Words(fn() -> Value),
}

/// A key of a table with what an editor says about it.
type Described = (&'static str, &'static str, &'static str);

const FILE: &str = "the file";
const MODULE: &str = "module `x`";
const NETWORK: &str = "network `x`";
const LINK: &str = "link `x`";
const PARTITION: &str = "partition `x`";
const RESTART: &str = "`restart`";
const PROCESS: &str = "process `x`";
const LOGBOOK: &str = "logbook `x`";
const PORT: &str = "port `x`";
const CHANNEL: &str = "channel";
const MEMORY_BLOCK: &str = "memory block `x`";
const CHAIN: &str = "chain";
const SCHEDULE: &str = "schedule `x`";
const WINDOW: &str = "window";
const HEALTH: &str = "`health`";
const RESET: &str = "the reset of the module";
const LOG: &str = "the health log";

const INNER: &[(&str, &str, Inner)] = &[
    (FILE, "module", Inner::Named(MODULE)),
    (FILE, "network", Inner::Named(NETWORK)),
    (FILE, "link", Inner::Named(LINK)),
    (MODULE, "addresses", Inner::Words(addresses)),
    (FILE, "partition", Inner::Named(PARTITION)),
    (FILE, "channel", Inner::Plain(CHANNEL)),
    (FILE, "memory_block", Inner::Named(MEMORY_BLOCK)),
    (FILE, "name_service", Inner::Words(name_services)),
    (FILE, "chain", Inner::Plain(CHAIN)),
    (FILE, "schedule", Inner::Named(SCHEDULE)),
    (FILE, "health", Inner::Plain(HEALTH)),
    (PARTITION, "restart", Inner::Plain(RESTART)),
    (PARTITION, "process", Inner::Named(PROCESS)),
    (PARTITION, "logbook", Inner::Named(LOGBOOK)),
    (PARTITION, "port", Inner::Named(PORT)),
    (PARTITION, "health", Inner::Words(answers::<PartitionError, PartitionAction>)),
    (SCHEDULE, "window", Inner::Plain(WINDOW)),
    (SCHEDULE, "change_action", Inner::Words(change_actions)),
    (HEALTH, "level", Inner::Words(levels)),
    (HEALTH, "partition", Inner::Words(answers::<PartitionError, PartitionAction>)),
    (HEALTH, "module", Inner::Words(answers::<ModuleError, ModuleAction>)),
    (HEALTH, "reset", Inner::Plain(RESET)),
    (HEALTH, "log", Inner::Plain(LOG)),
];

const DESCRIPTIONS: &[Described] = &[
    (
        FILE,
        "messages",
        "The folder with message types of your own, relative to this file; \"messages\" where there is such a folder and nothing is said.",
    ),
    (
        FILE,
        "isolation",
        "What the ends of channels can do to each other, where a channel says nothing itself; shared, if not said.",
    ),
    (FILE, "module", "Computers, by name: each runs one executive."),
    (FILE, "network", "Networks between the computers, by name."),
    (FILE, "link", "Pairs of modules that talk to each other, by name."),
    (FILE, "partition", "Partitions, by name."),
    (FILE, "channel", "From one source port to its destination ports."),
    (FILE, "memory_block", "Memory that partitions of a module share, by name."),
    (
        FILE,
        "name_service",
        "What partitions can ask for by GET_ADDRESS and GET_NAME, by name: \"address:port\" of service access points, by theirs.",
    ),
    (FILE, "chain", "A path through channels with a bound on the age of its first value."),
    (FILE, "schedule", "Schedules, by name: windows in a major frame."),
    (FILE, "health", "What is done about errors."),
    (MEMORY_BLOCK, "size", "Its size, such as \"64KiB\"."),
    (
        MEMORY_BLOCK,
        "content",
        "The file with what stands in it when the module starts, relative to this file; zeros, if not said.",
    ),
    (MEMORY_BLOCK, "read", "The partitions that read it."),
    (MEMORY_BLOCK, "read_write", "The partitions that read and write it."),
    (MODULE, "cores", "The cores whose time is partitioned."),
    (MODULE, "housekeeping_cores", "The cores for everything else."),
    (MODULE, "addresses", "Where it is reached, by network, as \"address:port\"."),
    (MODULE, "follows", "The module whose major frame it follows."),
    (
        MODULE,
        "clock",
        "Where its major frames lie: on its own clock, or at multiples of their length on the disciplined clock.",
    ),
    (MODULE, "follows_within", "The error of its major frame beyond which it has lost that module's."),
    (NETWORK, "rate", "How much it carries, such as \"100Mbit/s\"."),
    (NETWORK, "latency", "The most that a datagram takes from sender to receiver."),
    (LINK, "modules", "The two modules; the first one begins."),
    (LINK, "networks", "The networks that carry it, at most two; those that both modules have, if not said."),
    (LINK, "transport", "By what datagrams travel."),
    (
        LINK,
        "key",
        "The file with its key, relative to this file: 64 hexadecimal digits, for the executive only.",
    ),
    (
        LINK,
        "unauthenticated",
        "True: without a key, so that anybody on the network can speak for either end.",
    ),
    (LINK, "gap", "The bandwidth allocation gap: from one datagram to the next at least; 1, 2, 4, … 128 ms."),
    (LINK, "max_bytes", "The longest datagram, bytes."),
    (LINK, "skew", "How much later than the first a copy from the other network may come."),
    (LINK, "lost_after", "After how much silence a network of it counts as down."),
    (PARTITION, "program", "The program, relative to the folder of `bateleur`."),
    (PARTITION, "module", "The module that it runs in."),
    (PARTITION, "memory", "The most memory that it may have, such as \"32MiB\"."),
    (PARTITION, "threads", "The most threads that it may have."),
    (PARTITION, "identifier", "Its number in its module; the lowest that is free if not said."),
    (
        PARTITION,
        "period",
        "From one release point of its processes to the next; as its windows recur if not said.",
    ),
    (PARTITION, "duration", "The time that it has in each period; what its windows give if not said."),
    (PARTITION, "processes", "The most ARINC 653 processes that it may create."),
    (PARTITION, "logbook", "Its logbooks (ARINC 653 part 2), by name."),
    (LOGBOOK, "max_size", "The longest message, bytes."),
    (LOGBOOK, "max_logged", "How many messages it keeps."),
    (LOGBOOK, "max_in_progress", "How many messages may be on their way to its file."),
    (PARTITION, "process", "Processes with their worst-case execution times, by name."),
    (PROCESS, "priority", "1 to 239, the highest is the most urgent."),
    (
        PROCESS,
        "period",
        "From one release to the next, a multiple of the partition's; without it, it is not periodic.",
    ),
    (PROCESS, "deadline", "From a release until it must be done."),
    (PROCESS, "wcet", "The longest time that it computes after a release."),
    (PARTITION, "stacks", "The most memory of its processes' stacks together, such as \"1MiB\"."),
    (PARTITION, "restart", "How, and how often, it is started again."),
    (
        PARTITION,
        "standby",
        "What waits behind it: its next process before its start, or one that has initialised and takes over; without it, nothing does.",
    ),
    (PARTITION, "startup_timeout", "The longest time from its start to its readiness."),
    (PARTITION, "deadline", "From the opening of its window until its work must be done."),
    (PARTITION, "priority", "Its priority among the partitions."),
    (PARTITION, "network", "Whether it may use the network."),
    (PARTITION, "devices", "The devices that it may open."),
    (PARTITION, "system_calls", "System calls beyond the ordinary ones that it may make, by family."),
    (PARTITION, "retained", "Memory that outlives a warm restart, such as \"16KiB\"."),
    (PARTITION, "attributes", "A free table that it is told at its start."),
    (
        PARTITION,
        "may_set_schedule",
        "Whether it may ask for another schedule: true, false, or the schedules in which it may.",
    ),
    (
        PARTITION,
        "replicas",
        "3: three processes run its program and a voter writes what most of them say; or the three modules that they run on.",
    ),
    (PARTITION, "health", "Its own answers to errors, in place of those of `health.partition`."),
    (PARTITION, "error_handler", "Whether it has an error handler of its own."),
    (PARTITION, "health_texts", "Whether it is told of every fault in the module, to pass it on."),
    (PARTITION, "port", "Its ports, by name."),
    (RESTART, "start", "What it finds when it starts again by default."),
    (RESTART, "budget", "How many restarts it has within the time `within`."),
    (RESTART, "within", "The time over which restarts are counted."),
    (RESTART, "then", "What becomes of it when its restarts are used up."),
    (RESTART, "startup", "The longest time that a start may take."),
    (PORT, "direction", "Which way messages go, seen from the partition."),
    (PORT, "kind", "The latest value only, or every message in order."),
    (PORT, "message", "The message type."),
    (PORT, "max_size", "The size of a message without a type, bytes."),
    (PORT, "refresh", "The age up to which a sampling destination is valid."),
    (PORT, "depth", "How many messages a queuing destination holds."),
    (PORT, "optional", "Whether the program may leave it out."),
    (
        PORT,
        "operator",
        "Whether the program leaves a source to the operator, who writes with `bateleur ports pub`.",
    ),
    (
        PORT,
        "outvote",
        "Of a source with replicas: whether one that writes otherwise is restarted; false: what most say is written, and that is all.",
    ),
    (CHANNEL, "source", "The port that writes, as \"partition.port\"."),
    (CHANNEL, "destinations", "The ports that read, as \"partition.port\"."),
    (
        CHANNEL,
        "isolation",
        "Whether its ends can damage its memory for each other; what the file says for all, if not said.",
    ),
    (CHAIN, "name", "What reports call it."),
    (CHAIN, "path", "Its ports in order, as \"partition.port\"."),
    (CHAIN, "max_age", "How old its first value may be at its end."),
    (SCHEDULE, "major_frame", "The whole cycle; a multiple of the minor frame."),
    (SCHEDULE, "minor_frame", "The beat."),
    (SCHEDULE, "initial", "Whether the module begins with it."),
    (SCHEDULE, "window", "Its windows."),
    (SCHEDULE, "change_action", "What becomes of partitions when the module changes to it, by name."),
    (WINDOW, "partition", "Whose window it is."),
    (WINDOW, "offset", "When it opens in the minor frame."),
    (WINDOW, "duration", "How long it lasts."),
    (WINDOW, "core", "On which core; the first of the module if not said."),
    (WINDOW, "minor", "In which minor frames, from 0; in every one if not said."),
    (HEALTH, "silence_windows", "How many granted windows in a row a partition may leave open."),
    (
        HEALTH,
        "level",
        "At which level errors of a partition are dealt with, in each of its states or in all.",
    ),
    (HEALTH, "partition", "What is done about errors of a partition."),
    (HEALTH, "module", "What is done about errors of the module."),
    (HEALTH, "late_after", "A switch that comes later than this is the error `late_dispatcher`."),
    (HEALTH, "reset", "How, and how often, the module is reset."),
    (HEALTH, "log", "The health log that outlives the executive."),
    (RESET, "budget", "How many resets the module has within the time `within`; after them it shuts down."),
    (RESET, "within", "The time over which resets are counted."),
    (RESET, "startup", "How long a reset takes on the virtual clock."),
    (LOG, "size", "Its length on the disk, such as \"256KiB\"."),
    (LOG, "policy", "What becomes of new entries when it is full."),
];

/// The schema.
#[must_use]
pub fn schema() -> Value {
    let mut definitions = Map::new();
    let mut tables = tables();
    let file = tables.iter().position(|(table, _)| table == FILE).map(|place| tables.remove(place));
    for (table, keys) in tables {
        definitions.insert(definition(&table), object(&table, &keys));
    }
    definitions.insert("attribute".to_owned(), attribute());
    let mut schema = Map::new();
    schema.insert("$schema".to_owned(), json!("https://json-schema.org/draft/2020-12/schema"));
    schema.insert("title".to_owned(), json!("Schedule file of Bateleur"));
    if let Some((table, keys)) = file
        && let Value::Object(top) = object(&table, &keys)
    {
        schema.extend(top);
    }
    schema.insert("$defs".to_owned(), Value::Object(definitions));
    Value::Object(schema)
}

/// What the reader asks each kind of table for.
fn tables() -> Vec<(String, Vec<Key>)> {
    let findings = Findings::with_keys(PROBE);
    if let Some(document) = raw::parse(PROBE, &findings) {
        RawFile::read(document.get_ref(), &findings);
    }
    findings.into_keys()
}

/// What a kind of table is called among the definitions.
fn definition(table: &str) -> String {
    table.trim_end_matches(" `x`").trim_matches('`').to_owned()
}

fn object(table: &str, keys: &[Key]) -> Value {
    let mut properties = Map::new();
    for key in keys {
        let mut schema = match key.under {
            Under::Value(schema) => schema(),
            Under::Table => inner(table, key.name),
            Under::Tables => json!({ "type": "array", "items": inner(table, key.name) }),
        };
        if let (Some(text), Some(schema)) = (description(table, key.name), schema.as_object_mut()) {
            schema.insert("description".to_owned(), json!(text));
        }
        properties.insert(key.name.to_owned(), schema);
    }
    let required: Vec<&str> = keys.iter().filter(|key| key.required).map(|key| key.name).collect();
    json!({ "type": "object", "properties": properties, "required": required, "additionalProperties": false })
}

/// The tables that have a key of this name, as messages call them.
pub(super) fn tables_with(key: &str) -> Vec<String> {
    let having = tables().into_iter().filter(|(_, keys)| keys.iter().any(|known| known.name == key));
    having.map(|(table, _)| table.replace(" `x`", "")).collect()
}

fn description(table: &str, key: &str) -> Option<&'static str> {
    DESCRIPTIONS.iter().find(|(of, name, _)| (*of, *name) == (table, key)).map(|(_, _, text)| *text)
}

/// The schema of a table under a key; of any table where nothing is known of it.
fn inner(table: &str, key: &str) -> Value {
    let reference = |kind: &str| json!({ "$ref": format!("#/$defs/{}", definition(kind)) });
    match INNER.iter().find(|(of, name, _)| (*of, *name) == (table, key)) {
        Some((_, _, Inner::Named(kind))) => {
            json!({ "type": "object", "additionalProperties": reference(kind) })
        }
        Some((_, _, Inner::Plain(kind))) => reference(kind),
        Some((_, _, Inner::Words(schema))) => schema(),
        None => json!({ "type": "object" }),
    }
}

/// Errors with what is done about each.
fn answers<E: Closed, A: Closed>() -> Value {
    let errors = E::ALL.iter().map(|error| (error.name().to_owned(), one_of_the_words::<A>()));
    let properties: Map<String, Value> = errors.collect();
    json!({ "type": "object", "properties": properties, "additionalProperties": false })
}

/// Errors with the level of each, or one for each state.
fn levels() -> Value {
    let states =
        PartitionState::ALL.iter().map(|state| (state.name().to_owned(), one_of_the_words::<ErrorLevel>()));
    let states: Map<String, Value> = states.collect();
    let by_state = json!({ "type": "object", "properties": states, "additionalProperties": false });
    let level = json!({ "anyOf": [one_of_the_words::<ErrorLevel>(), by_state] });
    let errors = PartitionError::ALL.iter().map(|error| (error.name().to_owned(), level.clone()));
    let properties: Map<String, Value> = errors.collect();
    json!({ "type": "object", "properties": properties, "additionalProperties": false })
}

fn addresses() -> Value {
    json!({ "type": "object", "additionalProperties": <SocketAddr as FromToml>::schema() })
}

fn name_services() -> Value {
    let addresses = json!({ "type": "object", "additionalProperties": <SocketAddrV4 as FromToml>::schema() });
    json!({ "type": "object", "additionalProperties": addresses })
}

fn change_actions() -> Value {
    json!({ "type": "object", "additionalProperties": one_of_the_words::<ChangeAction>() })
}

fn attribute() -> Value {
    json!({
        "anyOf": [
            { "type": ["string", "number", "boolean"] },
            { "type": "array", "items": { "$ref": "#/$defs/attribute" } },
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_that_is_read_is_described_and_no_other() {
        let read: Vec<(String, &str)> = tables()
            .into_iter()
            .flat_map(|(table, keys)| keys.into_iter().map(move |key| (table.clone(), key.name)))
            .collect();
        let missing: Vec<_> = read.iter().filter(|(table, key)| description(table, key).is_none()).collect();
        assert!(missing.is_empty(), "DESCRIPTIONS in schema.rs lacks, as (table, key): {missing:?}");
        for (table, key, _) in DESCRIPTIONS {
            assert!(
                read.iter().any(|(of, name)| of == table && name == key),
                "DESCRIPTIONS in schema.rs describes `{key}` of {table}, which the reader does not know"
            );
        }
    }

    #[test]
    fn every_table_within_a_table_has_a_schema_of_its_own() {
        for (table, keys) in tables() {
            for key in keys.iter().filter(|key| !matches!(key.under, Under::Value(_))) {
                assert!(
                    INNER.iter().any(|(of, name, _)| *of == table && *name == key.name),
                    "INNER in schema.rs lacks `{}` of {table}; its probe needs such a table too",
                    key.name
                );
            }
        }
        let known: Vec<String> = tables().into_iter().map(|(table, _)| table).collect();
        for (_, key, inner) in INNER {
            if let Inner::Named(kind) | Inner::Plain(kind) = inner {
                assert!(known.iter().any(|table| table == kind), "the probe has no `{key}`");
            }
        }
    }
}
