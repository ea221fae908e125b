//! Looks names up: from what the file writes to places in its lists.

use std::collections::HashMap;

use super::raw::{RawFile, RawPort, RawWindow};

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
