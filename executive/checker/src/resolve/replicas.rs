//! Partitions that run three times: what their table says holds for each of the three replicas, and the partition itself becomes the
//! voter, through whose ports everything goes.
//!
//! Whoever names `NAME` or one of its ports means the voter and what it has decided; the replicas are `NAME_1` to `NAME_3`. Sampling
//! values reach the replicas directly; messages of a queue go through the voter, so that each replica has all of them.

use std::collections::BTreeMap;

use bateleur_contract::{OUTVOTED_BYTES, OUTVOTED_PORT, REPLICAS};

use crate::catalogue;
use crate::closed::{ChangeAction, Direction, Isolation, Kind, StartMode};
use crate::findings::{Finding, Findings, Span};
use crate::model::Attribute;
use crate::raw::{RawChain, RawChannel, RawFile, RawPartition, RawPort, RawRestart};
use crate::reader::{At, Bytes, Field, Nanoseconds, Permission, Replicas, Word};

use super::names::port_path;
use super::relays;

/// The voter's program.
const PROGRAM: &str = "voter";
/// Age up to which a voter takes a value: it compares values with each other, and looks at which are new.
const VOTER_REFRESH_NS: u64 = 10_000_000_000;
/// Messages that wait for the voter, where nobody receives what it hands on.
const DEPTH: u32 = 8;
/// What a voter retains, bytes.
const RETAINED: u64 = 64 << 10;
/// The most that a replica retains, bytes: as much as is copied in a part of a millisecond.
const MOST_RETAINED: u64 = 1 << 20;
/// What a partition's table can not say where it runs three times, and why.
const ONCE: &str = "would be done three times, and nobody votes on it";

/// Makes three partitions and a voter of every partition that has replicas.
pub(crate) fn expand(file: &mut RawFile, findings: &Findings<'_>) {
    unused(file, findings);
    let names: Vec<String> = file.partitions.iter().map(|partition| partition.name.value.clone()).collect();
    let mut replicated = BTreeMap::new();
    for (place, name) in names.iter().enumerate() {
        let (modules, span) = match &file.partitions[place].replicas {
            Field::Absent => continue,
            Field::Broken => (None, file.partitions[place].name.span.clone()),
            Field::Said(replicas) => (modules(replicas, findings), replicas.span.clone()),
        };
        let modules = modules.unwrap_or_else(|| vec![None; REPLICAS]);
        for taken in (1..=REPLICAS).map(|number| numbered(name, number)) {
            if let Some(other) = names.iter().position(|name| *name == taken) {
                let message = format!("`{taken}` is the name of a replica of `{name}`");
                wrong(findings, &file.partitions[other].name.span, message, "rename the partition");
            }
        }
        refuse(file, place, findings);
        replicate(file, place, &modules, &span);
        replicated.insert(name.clone(), distribute(file, place, findings));
        tell_elsewhere(file, place, &modules);
    }
    lead(file, &replicated);
}

/// The modules of the replicas; `None`: their number is another one, which is reported.
fn modules(replicas: &At<Replicas>, findings: &Findings<'_>) -> Option<Vec<Option<At<String>>>> {
    let found = match &replicas.value {
        Replicas::Number(number) if *number as usize == REPLICAS => return Some(vec![None; REPLICAS]),
        Replicas::On(modules) if modules.len() == REPLICAS => {
            return Some(modules.iter().cloned().map(Some).collect());
        }
        Replicas::Number(number) => number.to_string(),
        Replicas::On(modules) => modules.len().to_string(),
    };
    let mend = "write `replicas = 3`, or a list of three modules, where one may stand more than once";
    wrong(findings, &replicas.span, format!("{found} replicas: a majority against one takes three"), mend);
    None
}

/// What a replica of a partition is called, and a port of the voter for that replica; replicas are numbered from 1.
#[must_use]
pub fn numbered(name: &str, number: usize) -> String {
    format!("{name}_{number}")
}

fn wrong(findings: &Findings<'_>, span: &Span, message: String, mend: &str) {
    findings.add(Finding::new(&catalogue::REPLICAS, span, message, mend));
}

/// Reports what three processes can not share.
fn refuse(file: &RawFile, place: usize, findings: &Findings<'_>) {
    let partition = &file.partitions[place];
    let name = &partition.name.value;
    let asks = partition.may_set_schedule.said().filter(|at| !matches!(at.value, Permission::Always(false)));
    let said = [
        ("network", partition.network.said().filter(|network| network.value).map(|at| &at.span)),
        ("devices", partition.devices.said().filter(|devices| !devices.value.is_empty()).map(|at| &at.span)),
        ("identifier", partition.identifier.said().map(|at| &at.span)),
        ("may_set_schedule", asks.map(|at| &at.span)),
        ("logbook", partition.logbooks.first().map(|logbook| &logbook.name.span)),
    ];
    for (key, span) in said.into_iter().filter_map(|(key, span)| Some((key, span?))) {
        let message = format!("`{name}` has replicas and `{key}`: what this is for {ONCE}");
        wrong(
            findings,
            span,
            message,
            "give it to a partition of its own, which talks to this one through ports",
        );
    }
    if let Some(retained) = partition.retained.said().filter(|retained| retained.value.0 > MOST_RETAINED) {
        let message = format!("`{name}` has replicas and retains more than {} KiB", MOST_RETAINED >> 10);
        wrong(
            findings,
            &retained.span,
            message,
            "retain less: a replica that starts again gets a copy of it between two windows",
        );
    }
    for port in file.ports.iter().filter(|port| port.partition == place) {
        let name = &port.name.value;
        if *name == OUTVOTED_PORT || (1..=REPLICAS).any(|number| *name == numbered(OUTVOTED_PORT, number)) {
            let message =
                format!("`{name}` is the name of a port through which a voter reaches its replicas");
            wrong(findings, &port.name.span, message, "rename the port");
        }
    }
    for block in &file.memory_blocks {
        if let Some(writer) = block.read_write.items().iter().find(|writer| writer.value == *name) {
            let message = format!("`{name}` has replicas and writes a memory block: this {ONCE}");
            wrong(findings, &writer.span, message, "let it read the block, and another partition write it");
        }
    }
}

/// Reports a key that only ports with replicas behind them have.
fn unused(file: &RawFile, findings: &Findings<'_>) {
    for port in &file.ports {
        let Some(outvote) = port.outvote.said() else { continue };
        let owner = &file.partitions[port.partition];
        let is_voted = !owner.replicas.is_absent()
            && port.direction.word() == Some(Direction::Source)
            && port.kind.word() == Some(Kind::Sampling)
            && port.operator.get() != Some(true);
        if !is_voted {
            let message = format!("port `{}` has `outvote`, and nobody votes there", port_path(file, port));
            wrong(
                findings,
                &outvote.span,
                message,
                "it is for the sampling sources of a partition with `replicas`",
            );
        }
    }
}

/// The table at `place` becomes the voter's, and those of the replicas come behind all others.
fn replicate(file: &mut RawFile, place: usize, modules: &[Option<At<String>>], span: &Span) {
    let first = file.partitions.len();
    let original = file.partitions[place].clone();
    let name = original.name.clone();
    for (number, module) in (1..).zip(modules) {
        let own = module.clone().map_or_else(|| original.module.clone(), Field::Said);
        let name = At { value: numbered(&name.value, number), span: name.span.clone() };
        let replica = RawPartition { name, module: own, replicas: Field::Absent, ..original.clone() };
        file.partitions.push(replica);
    }
    let module = At { value: String::new(), span: span.clone() };
    let at_name = |value| Field::Said(At { value, span: name.span.clone() });
    let table = relays::table(PROGRAM, name.clone(), module);
    file.partitions[place] = RawPartition {
        // How large the numbers of each field are.
        retained: Field::Said(At { value: Bytes(RETAINED), span: name.span.clone() }),
        restart: RawRestart { start: at_name(Word(StartMode::Warm)), ..table.restart.clone() },
        module: original.module,
        replicas: original.replicas,
        voted: (first..first + modules.len()).collect(),
        ..table
    };
    for schedule in &mut file.schedules {
        let of_it = |(name, _): &&(At<String>, At<ChangeAction>)| name.value == original.name.value;
        if let Some((name, action)) = schedule.change_actions.iter().find(of_it).cloned() {
            let each = |number| {
                (At { value: numbered(&name.value, number), span: name.span.clone() }, action.clone())
            };
            schedule.change_actions.extend((1..=REPLICAS).map(each));
        }
    }
    for block in &mut file.memory_blocks {
        let Field::Said(read) = &mut block.read else { continue };
        let name = &original.name.value;
        let each = |reader: At<String>| match reader.value == *name {
            true => (1..=REPLICAS)
                .map(|number| At { value: numbered(name, number), span: reader.span.clone() })
                .collect(),
            false => vec![reader],
        };
        read.value = std::mem::take(&mut read.value).into_iter().flat_map(each).collect();
    }
}

/// The ports of a partition with replicas, by what the voter does.
#[derive(Default)]
struct Ports {
    /// Sampling ports of which the replicas read the channel themselves.
    read: Vec<String>,
    /// Of all others: the port, as the file has it.
    passed: Vec<RawPort>,
}

/// Gives the replicas and the voter their ports, and tells the voter what it votes on.
fn distribute(file: &mut RawFile, place: usize, findings: &Findings<'_>) -> Ports {
    let replicas = file.partitions[place].voted.clone();
    let mut ports = Ports::default();
    let mut told: BTreeMap<&str, Vec<Attribute>> = BTreeMap::new();
    let own: Vec<usize> = (0..file.ports.len()).filter(|&port| file.ports[port].partition == place).collect();
    let stays = |port: &&usize| {
        let port = &file.ports[**port];
        (port.kind.word(), port.direction.word()) != (Some(Kind::Sampling), Some(Direction::Destination))
    };
    let names: Vec<String> =
        own.iter().filter(stays).map(|&port| file.ports[port].name.value.clone()).collect();
    let mut further = Vec::new();
    for port in own {
        let original = file.ports[port].clone();
        if original.operator.get() == Some(true) {
            continue; // his messages do not come from the program
        }
        let name = original.name.value.clone();
        let direction = original.direction.word().unwrap_or(Direction::Source);
        let kind = original.kind.word().unwrap_or(Kind::Sampling);
        let of_replica =
            |replica: usize| RawPort { partition: replica, outvote: Field::Absent, ..original.clone() };
        if (kind, direction) == (Kind::Sampling, Direction::Destination) {
            // The place of the port in the file stays taken.
            file.ports[port] = of_replica(replicas[0]);
            further.extend(replicas[1..].iter().map(|&replica| of_replica(replica)));
            ports.read.push(name);
            continue;
        }
        further.extend(replicas.iter().map(|&replica| of_replica(replica)));
        let depth = depth_behind(file, place, &original).or(original.depth.get()).unwrap_or(DEPTH);
        for number in 1..=REPLICAS {
            let numbered = numbered(&name, number);
            if names.contains(&numbered) {
                let message = format!("the voter has a port `{numbered}` for `{name}` of each replica");
                wrong(findings, &original.name.span, message, "rename one of the two ports");
            }
            further.push(opposite(&original, numbered, depth));
        }
        let list = match (kind, direction) {
            (Kind::Sampling, _) => "values",
            (Kind::Queuing, Direction::Source) => "messages",
            (Kind::Queuing, Direction::Destination) => "orders",
        };
        told.entry(list).or_default().push(Attribute::String(name.clone()));
        if original.outvote.get() == Some(false) {
            told.entry("not_outvoted").or_default().push(Attribute::String(name));
        }
        ports.passed.push(original);
    }
    file.ports.extend(further);
    let span = file.partitions[place].name.span.clone();
    let value = told.into_iter().map(|(list, names)| (list.to_owned(), Attribute::Array(names))).collect();
    file.partitions[place].attributes = Field::Said(At { value, span });
    ports
}

/// Gives a replica on another module than its voter's a port, its last one, through which the voter tells it that it is outvoted.
fn tell_elsewhere(file: &mut RawFile, place: usize, modules: &[Option<At<String>>]) {
    let voter = &file.partitions[place];
    let (name, replicas) = (voter.name.clone(), voter.voted.clone());
    let Some(home) = voter.module.said().map(|home| home.value.clone()) else { return };
    for (number, module) in (1..).zip(modules) {
        let Some(module) = module.as_ref().filter(|module| module.value != home) else { continue };
        let replica = replicas[number - 1];
        let span = &module.span;
        let said = |value| Field::Said(At { value, span: span.clone() });
        let port = |partition, name, direction, refresh| RawPort {
            partition,
            name: At { value: name, span: span.clone() },
            direction: Field::Said(At { value: Word(direction), span: span.clone() }),
            kind: Field::Said(At { value: Word(Kind::Sampling), span: span.clone() }),
            message: Field::Absent,
            max_size: said(OUTVOTED_BYTES),
            refresh,
            depth: Field::Absent,
            optional: Field::Absent,
            operator: Field::Absent,
            outvote: Field::Absent,
        };
        let refresh = Field::Said(At { value: Nanoseconds(VOTER_REFRESH_NS), span: span.clone() });
        let from = port(place, numbered(OUTVOTED_PORT, number), Direction::Source, Field::Absent);
        let to = port(replica, OUTVOTED_PORT.to_owned(), Direction::Destination, refresh);
        file.channels.push(between(&name.value, &to, number));
        file.ports.extend([from, to]);
    }
}

/// The voter's end of a channel to or from one replica.
fn opposite(port: &RawPort, name: String, depth: u32) -> RawPort {
    let span = port.name.span.clone();
    let is_source = port.direction.word() != Some(Direction::Destination);
    let is_queue = port.kind.word() == Some(Kind::Queuing);
    let direction = if is_source { Direction::Destination } else { Direction::Source };
    RawPort {
        name: At { value: name, span: span.clone() },
        direction: Field::Said(At { value: Word(direction), span: span.clone() }),
        refresh: match is_source && !is_queue {
            true => Field::Said(At { value: Nanoseconds(VOTER_REFRESH_NS), span: span.clone() }),
            false => Field::Absent,
        },
        depth: if is_source && is_queue { Field::Said(At { value: depth, span }) } else { Field::Absent },
        optional: Field::Absent,
        outvote: Field::Absent,
        ..port.clone()
    }
}

/// How many messages wait at the end of the channel that a queuing source of the partition at `place` leads into.
fn depth_behind(file: &RawFile, place: usize, port: &RawPort) -> Option<u32> {
    let path = format!("{}.{}", file.partitions[place].name.value, port.name.value);
    let channel = file
        .channels
        .iter()
        .find(|channel| channel.source.said().is_some_and(|source| source.value == path))?;
    let destination = &channel.destinations.items().first()?.value;
    file.ports.iter().find(|port| port_path(file, port) == *destination)?.depth.get()
}

/// Channels and chains lead through voters.
fn lead(file: &mut RawFile, replicated: &BTreeMap<String, Ports>) {
    let of_path = |path: &str| {
        let (owner, port) = path.split_once('.')?;
        Some((owner.to_owned(), port.to_owned(), replicated.get(owner)?))
    };
    for channel in &mut file.channels {
        let Field::Said(destinations) = &mut channel.destinations else { continue };
        let each = |path: At<String>| match of_path(&path.value) {
            Some((owner, port, ports)) if ports.read.contains(&port) => (1..=REPLICAS)
                .map(|number| At {
                    value: format!("{}.{port}", numbered(&owner, number)),
                    span: path.span.clone(),
                })
                .collect(),
            _ => vec![path],
        };
        destinations.value = std::mem::take(&mut destinations.value).into_iter().flat_map(each).collect();
    }
    for (name, ports) in replicated {
        for port in &ports.passed {
            file.channels.extend((1..=REPLICAS).map(|number| between(name, port, number)));
        }
    }
    let chains = std::mem::take(&mut file.chains);
    file.chains = chains.into_iter().flat_map(|chain| through_each(&chain, &of_path)).collect();
}

/// A chain that leads through replicas is one for each of them: they are at different instants.
fn through_each<'p>(
    chain: &RawChain,
    of_path: &impl Fn(&str) -> Option<(String, String, &'p Ports)>,
) -> Vec<RawChain> {
    let through = |number: usize| {
        let mut replica = None;
        let mut path: Vec<At<String>> = Vec::new();
        for hop in chain.path.items() {
            let Some((owner, port, ports)) = of_path(&hop.value) else {
                path.push(hop.clone());
                continue;
            };
            let of_replica = format!("{}.{port}", numbered(&owner, number));
            let of_replica = At { value: of_replica, span: hop.span.clone() };
            replica = Some(numbered(&owner, number));
            let passed = ports.passed.iter().find(|passed| passed.name.value == port);
            let of_any = |number| format!("{}.{port}", numbered(&owner, number));
            let is_named =
                path.last().is_some_and(|last| (1..=REPLICAS).any(|one| last.value == of_any(one)));
            match passed.map(|passed| passed.direction.word()) {
                Some(_) if is_named => path.push(hop.clone()),
                None => path.push(of_replica),
                Some(Some(Direction::Destination)) => path.extend([hop.clone(), of_replica]),
                Some(_) => path.extend([of_replica, hop.clone()]),
            }
        }
        let Field::Said(said) = &chain.path else { return None };
        let path = Field::Said(At { value: path, span: said.span.clone() });
        let name = match &chain.name {
            Field::Said(name) => {
                Field::Said(At { value: format!("{}, {}", name.value, replica?), span: name.span.clone() })
            }
            other => other.clone(),
        };
        Some(RawChain { name, path, max_age: chain.max_age.clone() })
    };
    let each: Option<Vec<RawChain>> = (1..=REPLICAS).map(through).collect();
    each.unwrap_or_else(|| vec![chain.clone()])
}

/// The channel between a replica's port and its voter.
fn between(name: &str, port: &RawPort, number: usize) -> RawChannel {
    let span = &port.name.span;
    let at = |value: String| At { value, span: span.clone() };
    let replica = at(format!("{}.{}", numbered(name, number), port.name.value));
    let voter = at(format!("{name}.{}", numbered(&port.name.value, number)));
    let from_replica = port.direction.word() != Some(Direction::Destination);
    let (source, destination) = if from_replica { (replica, voter) } else { (voter, replica) };
    RawChannel {
        span: span.clone(),
        source: Field::Said(source),
        destinations: Field::Said(At { value: vec![destination], span: span.clone() }),
        // A replica that writes wildly must not take the voter with it.
        isolation: Field::Said(At { value: Word(Isolation::Sealed), span: span.clone() }),
    }
}
