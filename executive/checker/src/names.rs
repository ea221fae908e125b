//! Looks names up: from what the file writes to places in its lists.

use std::collections::HashMap;

use super::closed::Direction;
use super::raw::{RawChain, RawChannel, RawFile, RawLink, RawPort, RawWindow};

/// Where each name stands in the file.
pub(super) struct Names {
    modules: HashMap<String, usize>,
    partitions: HashMap<String, usize>,
    ports: HashMap<String, usize>,
    /// The channel of each port: as its source or as a destination, the first one that claims it.
    channels: HashMap<usize, usize>,
}

impl Names {
    pub(super) fn of(file: &RawFile) -> Self {
        let ports = file.ports.iter().enumerate();
        let mut names = Self {
            modules: places(file.modules.iter().map(|module| module.name.value.clone())),
            partitions: places(file.partitions.iter().map(|partition| partition.name.value.clone())),
            ports: ports.map(|(place, port)| (port_path(file, port), place)).collect(),
            channels: HashMap::new(),
        };
        for (place, channel) in file.channels.iter().enumerate() {
            let source = channel.source.said().map(|source| source.value.as_str());
            let destinations =
                channel.destinations.said().map(|list| list.value.as_slice()).unwrap_or_default();
            for path in source.into_iter().chain(destinations.iter().map(|at| at.value.as_str())) {
                if let Some(port) = names.port(path) {
                    names.channels.entry(port).or_insert(place);
                }
            }
        }
        names
    }

    pub(super) fn module(&self, name: &str) -> Option<usize> {
        self.modules.get(name).copied()
    }

    pub(super) fn schedule(&self, file: &RawFile, name: &str) -> Option<usize> {
        file.schedules.iter().position(|schedule| schedule.name.value == name)
    }

    pub(super) fn network(&self, file: &RawFile, name: &str) -> Option<usize> {
        file.networks.iter().position(|network| network.name.value == name)
    }

    /// The two modules of a link; nothing unless both are known, and two.
    pub(super) fn link_ends(&self, link: &RawLink) -> Option<[usize; 2]> {
        let [one, other] = link.modules.said()?.value.as_slice() else { return None };
        let (one, other) = (self.module(&one.value)?, self.module(&other.value)?);
        (one != other).then_some([one, other])
    }

    /// The first link between two modules.
    pub(super) fn link_between(&self, file: &RawFile, one: usize, other: usize) -> Option<usize> {
        let joins = |link: &RawLink| {
            self.link_ends(link).is_some_and(|ends| ends == [one, other] || ends == [other, one])
        };
        file.links.iter().position(joins)
    }

    /// The networks that carry a link: those that it names, or else those on which both its modules have an address.
    pub(super) fn link_networks(&self, file: &RawFile, link: &RawLink) -> Vec<usize> {
        if let Some(said) = link.networks.said() {
            return said.value.iter().filter_map(|network| self.network(file, &network.value)).collect();
        }
        let Some(ends) = self.link_ends(link) else { return Vec::new() };
        let on = |network: &usize| {
            ends.iter().all(|&module| {
                let mut addresses = file.modules[module].addresses.iter();
                addresses.any(|(name, _)| self.network(file, &name.value) == Some(*network))
            })
        };
        (0..file.networks.len()).filter(on).collect()
    }

    pub(super) fn partition(&self, name: &str) -> Option<usize> {
        self.partitions.get(name).copied()
    }

    /// The port written `partition.port`.
    pub(super) fn port(&self, path: &str) -> Option<usize> {
        self.ports.get(path).copied()
    }

    /// The channel that a port is attached to.
    pub(super) fn channel_of(&self, port: usize) -> Option<usize> {
        self.channels.get(&port).copied()
    }

    /// The module that a partition runs on.
    pub(super) fn module_of(&self, file: &RawFile, partition: usize) -> Option<usize> {
        self.module(&file.partitions[partition].module.said()?.value)
    }

    /// The partition of a window.
    pub(super) fn owner(&self, window: &RawWindow) -> Option<usize> {
        self.partition(&window.partition.said()?.value)
    }

    /// The core of a window: its own, or the first of its module.
    pub(super) fn core(&self, file: &RawFile, window: &RawWindow) -> Option<u32> {
        let module = self.module_of(file, self.owner(window)?)?;
        let first = file.modules[module].cores.said()?.value.first()?.value;
        window.core.or(first)
    }
}

/// A port as the file writes it in channels and chains.
pub(super) fn port_path(file: &RawFile, port: &RawPort) -> String {
    format!("{}.{}", file.partitions[port.partition].name.value, port.name.value)
}

fn places(names: impl Iterator<Item = String>) -> HashMap<String, usize> {
    names.enumerate().map(|(place, name)| (name, place)).collect()
}

/// Why a path is not one.
pub(super) enum Gap {
    /// A port is not known, which another rule reports.
    Unknown,
    /// Nothing leads from the port at this place of the written path to the one after.
    After(usize),
}

/// Every port of a chain, also those that the file leaves out.
pub(super) fn full_path(file: &RawFile, names: &Names, chain: &RawChain) -> Result<Vec<usize>, Gap> {
    let said = chain.path.said().ok_or(Gap::Unknown)?.value.iter();
    let ports =
        said.map(|port| names.port(&port.value)).collect::<Option<Vec<usize>>>().ok_or(Gap::Unknown)?;
    let mut path: Vec<usize> = ports.first().copied().into_iter().collect();
    for (place, step) in ports.windows(2).enumerate() {
        path.extend(between(file, names, step[0], step[1]).ok_or(Gap::After(place))?);
        path.push(step[1]);
    }
    Ok(path)
}

/// The ports left out between two ports of a path; nothing if there is no way.
fn between(file: &RawFile, names: &Names, from: usize, to: usize) -> Option<Option<usize>> {
    let direction = |port: usize| file.ports[port].direction.get().map(|word| word.0);
    let owner = |port: usize| file.ports[port].partition;
    match (direction(from)?, direction(to)?) {
        (Direction::Destination, Direction::Source) => (owner(from) == owner(to)).then_some(None),
        (Direction::Source, Direction::Destination) => {
            destinations(file, names, from).contains(&to).then_some(None)
        }
        (Direction::Source, Direction::Source) => {
            destinations(file, names, from).into_iter().find(|&port| owner(port) == owner(to)).map(Some)
        }
        (Direction::Destination, Direction::Destination) => {
            let source = source(file, names, to)?;
            (owner(from) == owner(source)).then_some(Some(source))
        }
    }
}

/// The ports that a source port reaches.
pub(super) fn destinations(file: &RawFile, names: &Names, source: usize) -> Vec<usize> {
    let path = port_path(file, &file.ports[source]);
    let mine = |channel: &&RawChannel| channel.source.said().is_some_and(|said| said.value == path);
    let lists = file.channels.iter().filter(mine).filter_map(|channel| channel.destinations.said());
    lists.flat_map(|list| list.value.iter().filter_map(|port| names.port(&port.value))).collect()
}

/// The port that feeds a destination port.
fn source(file: &RawFile, names: &Names, destination: usize) -> Option<usize> {
    let channel = &file.channels[names.channel_of(destination)?];
    names.port(&channel.source.said()?.value).filter(|&port| port != destination)
}
