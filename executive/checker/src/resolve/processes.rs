//! What a partition's processes are told: from the file, and from its windows where the file says nothing.

use std::collections::{BTreeMap, BTreeSet};

use crate::defaults;
use crate::model::{ModuleId, PartitionId, Schedule};
use crate::raw::{RawPartition, RawProcess};
use crate::reader::{Field, Nanoseconds};
use bateleur_plan::bounds::MOST_PROCESSES;
use bateleur_plan::processes::{Times, Windows, recurrence, shares};
use bateleur_plan::{Process, Processes};

use super::Resolver;

/// Those of a partition. Its period is zero where nothing says it: where it has no windows.
pub(super) fn of(
    (id, raw): (PartitionId, &RawPartition),
    identifier: u32,
    memory_bytes: u64,
    schedules: &[Schedule],
) -> Processes {
    let (windows, major_ns) = deciding(id, schedules);
    let first = times(raw, &windows, major_ns);
    let Times { period_ns, release_ns, duration_ns } = first;
    let others = schedules.iter().enumerate().filter_map(|(place, schedule)| {
        let windows = schedule.occurrences(id);
        let found = times(raw, &windows, schedule.major_frame_ns);
        (found.period_ns > 0 && found != first).then_some((place, found))
    });
    Processes {
        identifier,
        period_ns,
        release_ns,
        duration_ns,
        in_schedules: others.collect(),
        most: most(raw),
        stacks_bytes: raw.stacks.get().map_or(memory_bytes, |bytes| bytes.0),
        declared: raw.declared.iter().map(declared).collect::<Option<_>>().unwrap_or_default(),
    }
}

/// As the file says, or as the windows recur.
fn times(raw: &RawPartition, windows: &Windows, major_ns: u64) -> Times {
    let period_ns = match raw.period.or(Nanoseconds(0)) {
        Some(Nanoseconds(0)) => recurrence(windows, major_ns).unwrap_or_default(),
        Some(said) if !windows.is_empty() => said.0,
        _ => 0,
    };
    let release_ns = windows.first().and_then(|first| first.0.checked_rem(period_ns)).unwrap_or_default();
    let shares = shares(windows, major_ns, (release_ns, period_ns));
    let least_ns = shares.iter().map(|share| share.time_ns).min().unwrap_or_default();
    Times { period_ns, release_ns, duration_ns: raw.duration.ns(least_ns) }
}

/// A partition's windows in the schedule that decides about its periods, and the major frame: the first that has any. The schedule that
/// modules start with comes first.
fn deciding(partition: PartitionId, schedules: &[Schedule]) -> (Vec<(u64, u64)>, u64) {
    let initial = schedules.iter().filter(|schedule| schedule.initial);
    let all = initial.chain(schedules);
    let mut laid = all.map(|schedule| (schedule.occurrences(partition), schedule.major_frame_ns));
    laid.find(|(windows, _)| !windows.is_empty()).unwrap_or_default()
}

/// A process with its times; `None` where one of them can not be read.
fn declared(raw: &RawProcess) -> Option<Process> {
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
fn most(raw: &RawPartition) -> u32 {
    let threads = raw.threads.get().unwrap_or(defaults::THREADS);
    let threaded = threads.saturating_sub(1).min(MOST_PROCESSES);
    let named = u32::try_from(raw.declared.len()).unwrap_or(u32::MAX);
    raw.processes.get().unwrap_or(threaded.max(named))
}

/// The most threads: as the file says, or enough for its processes.
pub(super) fn threads(raw: &RawPartition) -> u32 {
    let enough = match most(raw) {
        0 => defaults::THREADS,
        most => most.saturating_add(defaults::THREADS_BESIDE),
    };
    raw.threads.get().unwrap_or(enough)
}

impl Resolver<'_> {
    /// The number of each partition: as the file says; the others of a module have the lowest that are free, from 1, in its order.
    pub(super) fn identifiers(&self) -> Vec<u32> {
        let all = || self.file.partitions.iter().zip(&self.owners);
        let said = |module: &ModuleId| {
            let mine = all().filter(|(_, owner)| *owner == module);
            mine.filter_map(|(raw, _)| raw.identifier.get()).collect::<BTreeSet<u32>>()
        };
        let mut taken = BTreeMap::new();
        let number = |(raw, module): (&RawPartition, _)| {
            let taken = taken.entry(module).or_insert_with(|| said(module));
            let free = || (1..=u32::MAX).find(|number| !taken.contains(number)).unwrap_or_default();
            let identifier = raw.identifier.get().unwrap_or_else(free);
            taken.insert(identifier);
            identifier
        };
        all().map(number).collect()
    }
}
