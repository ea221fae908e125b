//! Where the names of a file lead: to places in its lists. One that leads nowhere is reported as it is looked up, and a
//! stand-in takes the place of what it means.

use std::collections::HashMap;

use crate::catalogue::{self, Rule};
use crate::findings::{Finding, Findings};
use crate::model::{ModuleId, NetworkId, PartitionId, PortId, ScheduleId};
use crate::raw::{RawFile, RawPort};
use crate::reader::At;
use bateleur_plan::words::{did_you_mean, listed, nearest};

/// Before a module's name: what its relay is called.
pub const RELAY_PREFIX: &str = "relay_";

/// What names lead to that lead nowhere: the last entries of their lists, which stand for no table of the file. Nothing runs
/// there, and nothing is joined to them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nobody {
    pub(crate) module: ModuleId,
    pub(crate) partition: PartitionId,
    pub(crate) port: PortId,
}

/// The names of one list of the file.
struct List<'a> {
    what: &'static str,
    rule: &'static Rule,
    names: Vec<&'a str>,
    places: HashMap<&'a str, usize>,
}

impl<'a> List<'a> {
    fn of(what: &'static str, rule: &'static Rule, names: impl Iterator<Item = &'a At<String>>) -> Self {
        let names: Vec<&str> = names.map(|name| name.value.as_str()).collect();
        let places = names.iter().enumerate().map(|(place, name)| (*name, place)).collect();
        Self { what, rule, names, places }
    }

    fn place(&self, name: &str) -> Option<usize> {
        self.places.get(name).copied()
    }

    /// Where a name leads; if nowhere, that is reported.
    fn find(&self, name: &At<String>, findings: &Findings<'_>) -> Option<usize> {
        let place = self.place(&name.value);
        if place.is_none() {
            let message = format!("there is no {} `{}`", self.what, name.value);
            let mend = did_you_mean(&name.value, self.names.iter().copied());
            findings.add(Finding::new(self.rule, &name.span, message, mend));
        }
        place
    }
}

/// All names that others refer to.
pub(super) struct Names<'a> {
    file: &'a RawFile,
    findings: &'a Findings<'a>,
    nobody: Nobody,
    modules: List<'a>,
    networks: List<'a>,
    partitions: List<'a>,
    schedules: List<'a>,
    ports: HashMap<String, usize>,
}

impl<'a> Names<'a> {
    pub(super) fn of(file: &'a RawFile, nobody: Nobody, findings: &'a Findings<'a>) -> Self {
        let modules = file.modules.iter().map(|module| &module.name);
        let networks = file.networks.iter().map(|network| &network.name);
        let partitions = file.partitions.iter().map(|partition| &partition.name);
        let schedules = file.schedules.iter().map(|schedule| &schedule.name);
        let ports = file.ports.iter().enumerate();
        Self {
            file,
            findings,
            nobody,
            modules: List::of("module", &catalogue::UNKNOWN_MODULE, modules),
            networks: List::of("network", &catalogue::UNKNOWN_NETWORK, networks),
            partitions: List::of("partition", &catalogue::UNKNOWN_PARTITION, partitions),
            schedules: List::of("schedule", &catalogue::UNKNOWN_SCHEDULE, schedules),
            ports: ports.map(|(place, port)| (port_path(file, port), place)).collect(),
        }
    }

    pub(super) fn module(&self, name: &At<String>) -> ModuleId {
        self.modules.find(name, self.findings).map_or(self.nobody.module, ModuleId)
    }

    pub(super) fn network(&self, name: &At<String>) -> Option<NetworkId> {
        self.networks.find(name, self.findings).map(NetworkId)
    }

    pub(super) fn schedule(&self, name: &At<String>) -> Option<ScheduleId> {
        self.schedules.find(name, self.findings).map(ScheduleId)
    }

    pub(super) fn partition(&self, name: &At<String>) -> PartitionId {
        let known = self.partitions.place(&name.value).is_some() || !self.idle_relay(name);
        let place = if known { self.partitions.find(name, self.findings) } else { None };
        place.map_or(self.nobody.partition, PartitionId)
    }

    /// Reports a relay that would carry nothing, and says whether this is one.
    fn idle_relay(&self, name: &At<String>) -> bool {
        let module = name.value.strip_prefix(RELAY_PREFIX);
        let Some(module) = module.filter(|module| self.modules.place(module).is_some()) else { return false };
        let message =
            format!("there is no `{}`: no channel leads to module `{module}` or from it", name.value);
        let mend = format!("remove its window, or move a partition to `{module}`");
        self.findings.add(Finding::new(&catalogue::UNKNOWN_PARTITION, &name.span, message, mend));
        true
    }

    /// The port that is written `partition.port`.
    pub(super) fn port(&self, path: &At<String>) -> PortId {
        let place = self.ports.get(&path.value).copied();
        if place.is_none() {
            self.unknown_port(path);
        }
        place.map_or(self.nobody.port, PortId)
    }

    fn unknown_port(&self, port: &At<String>) {
        let why = match port.value.split_once('.') {
            None => ": a port is written `partition.port`".to_owned(),
            Some((partition, _)) if self.partitions.place(partition).is_none() => {
                format!(": no partition is called `{partition}`")
            }
            Some(_) => String::new(),
        };
        let message = format!("there is no port `{}`{why}", port.value);
        // All ports of a plan are too many to list; what has only the partition's name in common is not alike.
        let own_name = |path: &str| path.split_once('.').map(|(_, name)| name.to_owned()).unwrap_or_default();
        let wanted = own_name(&port.value);
        let alike = |path: &&str| wanted.is_empty() || nearest(&wanted, [own_name(path).as_str()]).is_some();
        let known: Vec<String> = self.file.ports.iter().map(|port| port_path(self.file, port)).collect();
        let mend = match nearest(&port.value, known.iter().map(String::as_str).filter(alike)) {
            Some(near) => format!("did you mean `{near}`?"),
            None => self.ports_beside(port),
        };
        self.findings.add(Finding::new(&catalogue::UNKNOWN_PORT, &port.span, message, mend));
    }

    /// The ports of the partition that an unknown port names, if there are any.
    fn ports_beside(&self, port: &At<String>) -> String {
        let partition = port.value.split('.').next().unwrap_or_default();
        let owner = self.partitions.place(partition);
        let ports = self.file.ports.iter().filter(|port| Some(port.partition) == owner);
        let ports: Vec<&str> = ports.map(|port| port.name.value.as_str()).collect();
        if ports.is_empty() {
            "declare it under its partition as `[partition.NAME.port.PORT]`".to_owned()
        } else {
            format!("the ports of `{partition}` are {}", listed(ports))
        }
    }
}

/// A port as the file writes it in channels and chains.
pub(super) fn port_path(file: &RawFile, port: &RawPort) -> String {
    format!("{}.{}", file.partitions[port.partition].name.value, port.name.value)
}
