//! What a partition's processes are told: from the file, and from its windows where the file says nothing.
//!
//! Rules ask here as well, so that what is checked is what is planned.

use std::collections::{BTreeMap, BTreeSet};

use super::defaults;
use super::raw::{RawFile, RawPartition, RawProcess};
use super::reader::{Bytes, Field, Nanoseconds};
use bateleur_plan::bounds::MOST_PROCESSES;
use bateleur_plan::processes::{Share, recurrence, shares};
use bateleur_plan::{Process, Processes};

/// The windows of one partition in a schedule.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Windows {
    /// By rising start.
    pub(super) windows: Vec<(u64, u64)>,
    /// The major frame.
    pub(super) major_ns: u64,
}

impl Windows {
    /// When the first of them starts in its period, and that period.
    pub(super) fn grid(&self, raw: &RawPartition) -> Option<(u64, u64)> {
        let said = raw.period.or(Nanoseconds(0))?.0;
        let period_ns = if said > 0 { said } else { recurrence(&self.windows, self.major_ns)? };
        Some((self.windows.first()?.0 % period_ns, period_ns))
    }

    /// What the partition has of each of its periods; nothing where they do not divide the major frame.
    pub(super) fn shares(&self, grid: (u64, u64)) -> Vec<Share> {
        shares(&self.windows, self.major_ns, grid)
    }
}

/// The windows that decide about a partition's periods: the first that are any. The schedule that modules start with comes first.
pub(super) fn deciding(mut schedules: impl Iterator<Item = Windows>) -> Windows {
    schedules.find(|schedule| !schedule.windows.is_empty()).unwrap_or_default()
}

/// What the plan says of a partition's processes.
pub(super) fn of(raw: &RawPartition, identifier: u32, windows: &Windows) -> Option<Processes> {
    let (release_ns, period_ns) = windows.grid(raw)?;
    let least_ns = || windows.shares((release_ns, period_ns)).iter().map(|share| share.time_ns).min();
    Some(Processes {
        identifier,
        period_ns,
        release_ns,
        duration_ns: match raw.duration.get() {
            Some(said) => said.0,
            None => least_ns()?,
        },
        most: most(raw)?,
        stacks_bytes: raw.stacks.or(Bytes(raw.memory.get()?.0))?.0,
        declared: raw.declared.iter().map(declared).collect::<Option<_>>()?,
    })
}

/// A process with its times.
pub(super) fn declared(raw: &RawProcess) -> Option<Process> {
    let time = |field: &Field<Nanoseconds>| match field {
        Field::Absent => Some(None),
        Field::Said(at) => Some(Some(at.value.0)),
        Field::Broken => None,
    };
    Some(Process {
        name: raw.name.value.clone(),
        priority: u8::try_from(raw.priority.get()?).ok()?,
        period_ns: time(&raw.period)?,
        deadline_ns: time(&raw.deadline)?,
        wcet_ns: raw.wcet.get()?.0,
    })
}

/// The most processes: as the file says, as many as it names, or as there are threads for beside the main one.
pub(super) fn most(raw: &RawPartition) -> Option<u32> {
    let threads = raw.threads.or(defaults::THREADS)?;
    let threaded = threads.saturating_sub(1).min(MOST_PROCESSES);
    raw.processes.or(threaded.max(u32::try_from(raw.declared.len()).ok()?))
}

/// The most threads: as the file says, or enough for its processes.
pub(super) fn threads(raw: &RawPartition) -> Option<u32> {
    let most = most(raw).filter(|most| *most > 0);
    raw.threads.or(most.map_or(defaults::THREADS, |most| most.saturating_add(defaults::THREADS_BESIDE)))
}

/// The number of each partition: as the file says; the others of a module have the lowest that are free, from 1, in its order.
pub(super) fn identifiers(file: &RawFile) -> Vec<u32> {
    let said = |module: Option<&str>| {
        let mine = file.partitions.iter().filter(|raw| module_of(raw) == module);
        mine.filter_map(|raw| raw.identifier.get()).collect::<BTreeSet<u32>>()
    };
    let (mut taken, mut identifiers) = (BTreeMap::new(), Vec::new());
    for raw in &file.partitions {
        let module = module_of(raw);
        let taken = taken.entry(module).or_insert_with(|| said(module));
        let free = || (1..=u32::MAX).find(|number| !taken.contains(number)).unwrap_or_default();
        let identifier = raw.identifier.get().unwrap_or_else(free);
        taken.insert(identifier);
        identifiers.push(identifier);
    }
    identifiers
}

fn module_of(raw: &RawPartition) -> Option<&str> {
    raw.module.said().map(|module| module.value.as_str())
}
