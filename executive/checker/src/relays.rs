//! Which channels cross from module to module, and the partitions that carry them: one relay for each module that has
//! such a channel. Nobody writes a relay's table; its windows stand in the file like everybody's, under its name.
//!
//! Works on the raw file, before any rule: what is not known yet is passed over, and other rules report it.

use std::collections::BTreeSet;

use super::names::Names;
use super::raw::{RawFile, RawPartition, RawRestart};
use super::reader::{At, Bytes, Field};

/// Before a module's name: what its relay is called.
pub(crate) const PREFIX: &str = "relay_";
/// The relay's program.
const PROGRAM: &str = "relay";
/// What a relay may use: as the other partitions of its size.
const MEMORY_BYTES: u64 = 32 << 20;

/// One channel that leads from one module to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crossing {
    /// The place of the channel in the file.
    pub(super) channel: usize,
    /// The port that is written.
    pub(super) source: usize,
    /// The module of its partition.
    pub(super) from: usize,
    /// The place among the channel's destinations.
    pub(super) place: usize,
    /// The port that is read.
    pub(super) destination: usize,
    /// The module of its partition.
    pub(super) to: usize,
}

/// Everything that crosses: once for each destination on another module than the source.
pub(super) fn crossings(file: &RawFile, names: &Names) -> Vec<Crossing> {
    let mut list = Vec::new();
    for (channel, raw) in file.channels.iter().enumerate() {
        let Some(source) = raw.source.said().and_then(|said| names.port(&said.value)) else { continue };
        let Some(from) = names.module_of(file, file.ports[source].partition) else { continue };
        let destinations = raw.destinations.said().into_iter().flat_map(|list| &list.value).enumerate();
        for (place, said) in destinations {
            let Some(destination) = names.port(&said.value) else { continue };
            let Some(to) = names.module_of(file, file.ports[destination].partition) else { continue };
            if to != from {
                list.push(Crossing { channel, source, from, place, destination, to });
            }
        }
    }
    list
}

/// The name of a module's relay.
pub(super) fn name(module: &str) -> String {
    format!("{PREFIX}{module}")
}

/// Adds the relays that the file needs. A name that is taken already is left alone: a rule reports it.
pub(super) fn add(file: &mut RawFile) {
    let names = Names::of(file);
    let crossings = crossings(file, &names);
    let needing: BTreeSet<usize> = crossings.iter().flat_map(|one| [one.from, one.to]).collect();
    for module in needing {
        let module = &file.modules[module].name;
        let name = At { value: name(&module.value), span: module.span.clone() };
        let module = module.clone();
        if names.partition(&name.value).is_none() {
            file.partitions.push(relay(name, module));
        }
    }
}

fn relay(name: At<String>, module: At<String>) -> RawPartition {
    let span = name.span.clone();
    RawPartition {
        generated: true,
        program: Field::Said(At { value: PROGRAM.to_owned(), span: span.clone() }),
        module: Field::Said(module),
        memory: Field::Said(At { value: Bytes(MEMORY_BYTES), span: span.clone() }),
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
        standby: Field::Absent,
        startup_timeout: Field::Absent,
        deadline: Field::Absent,
        priority: Field::Absent,
        network: Field::Said(At { value: true, span }),
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
