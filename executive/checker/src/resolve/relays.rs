//! The partitions that carry what crosses from module to module: one relay for each module that has such a channel. Nobody
//! writes a relay's table; its windows stand in the file like everybody's, under its name.

use std::collections::{BTreeSet, HashMap};

use crate::catalogue;
use crate::findings::{Finding, Findings};
use crate::raw::{RawFile, RawPartition, RawRestart};
use crate::reader::{At, Bytes, Field};

use super::names::{RELAY_PREFIX, port_path};

/// The relay's program.
const PROGRAM: &str = "relay";
/// What a relay or a voter may use: as the other partitions of its size.
const MEMORY_BYTES: u64 = 32 << 20;

/// Adds the tables of the relays that the file needs, behind all others.
pub(crate) fn add(file: &mut RawFile, findings: &Findings<'_>) {
    for module in needing(file) {
        let module = file.modules[module].name.clone();
        let name = At { value: format!("{RELAY_PREFIX}{}", module.value), span: module.span.clone() };
        match file.partitions.iter().find(|partition| partition.name.value == name.value) {
            None => file.partitions.push(RawPartition {
                generated: true,
                network: Field::Said(At { value: true, span: name.span.clone() }),
                ..table(PROGRAM, name, module)
            }),
            Some(taken) => {
                let message =
                    format!("`{}` is the name of the relay of module `{}`", name.value, module.value);
                let mend = "rename the partition; a relay needs windows in the schedules, and no table";
                findings.add(Finding::new(&catalogue::RELAY_NAME_TAKEN, &taken.name.span, message, mend));
            }
        }
    }
}

/// The modules that a channel leads to or from another one.
fn needing(file: &RawFile) -> BTreeSet<usize> {
    let place = |name: &At<String>| file.modules.iter().position(|module| module.name.value == name.value);
    let of_port = file.ports.iter().filter_map(|port| {
        let module = file.partitions[port.partition].module.said().and_then(place)?;
        Some((port_path(file, port), module))
    });
    let of_port: HashMap<String, usize> = of_port.collect();
    let mut needing = BTreeSet::new();
    for channel in &file.channels {
        let Some(from) = channel.source.said().and_then(|source| of_port.get(&source.value)) else {
            continue;
        };
        let reached = channel.destinations.items().iter().filter_map(|port| of_port.get(&port.value));
        needing.extend(reached.filter(|to| *to != from).flat_map(|to| [*from, *to]));
    }
    needing
}

/// As the file would write it, without network.
pub(super) fn table(program: &str, name: At<String>, module: At<String>) -> RawPartition {
    let span = name.span.clone();
    RawPartition {
        generated: false,
        replicas: Field::Absent,
        voted: Vec::new(),
        program: Field::Said(At { value: program.to_owned(), span: span.clone() }),
        module: Field::Said(module),
        memory: Field::Said(At { value: Bytes(MEMORY_BYTES), span }),
        threads: Field::Absent,
        identifier: Field::Absent,
        period: Field::Absent,
        duration: Field::Absent,
        processes: Field::Absent,
        stacks: Field::Absent,
        declared: Vec::new(),
        restart: RawRestart {
            start: Field::Absent,
            budget: Field::Absent,
            within: Field::Absent,
            then: Field::Absent,
            startup: Field::Absent,
        },
        logbooks: Vec::new(),
        standby: Field::Absent,
        startup_timeout: Field::Absent,
        deadline: Field::Absent,
        priority: Field::Absent,
        network: Field::Absent,
        devices: Field::Absent,
        system_calls: Field::Absent,
        retained: Field::Absent,
        attributes: Field::Absent,
        may_set_schedule: Field::Absent,
        health: Vec::new(),
        error_handler: Field::Absent,
        health_texts: Field::Absent,
        name,
    }
}
