//! Looks names up: from what the file writes to places in its lists.

use std::collections::HashMap;

use super::raw::{RawFile, RawLink, RawPort, RawWindow};

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
