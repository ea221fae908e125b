//! Rules about what a partition is granted: memory, threads, priority, devices, time to start.

use std::collections::HashMap;

use super::Context;
use crate::catalogue;
use crate::findings::{Finding, Span};
use crate::model::PartitionId;
use crate::raw::RawPartition;
use crate::reader::{At, Bytes, Field, Nanoseconds};
use crate::units::ShowSize;
use bateleur_plan::Standby;
use bateleur_plan::bounds::{
    HIGHEST_IDENTIFIER, HIGHEST_PRIORITY, LONGEST_BYTES, MOST_IN_PROGRESS, MOST_LOGBOOKS, MOST_LOGGED,
    MOST_PROCESSES, MOST_THREADS,
};

/// The smallest program of this repository starts with 2 MiB, each function of the aircraft with 4.
const SMALLEST_MEMORY_BYTES: u64 = 4 << 20;
/// Where devices lie.
const DEVICES: &str = "/dev/";
/// The device that has no path in the file: the line to the ground, which whoever starts the module says.
const GROUND_LINK: &str = "ground_link";

pub(super) fn check(cx: &Context<'_>) {
    for partition in &cx.file.partitions {
        memory(cx, partition);
        cx.in_range("threads", &partition.threads, 1, MOST_THREADS);
        cx.in_range("processes", &partition.processes, 1, MOST_PROCESSES);
        cx.in_range("identifier", &partition.identifier, 0, HIGHEST_IDENTIFIER);
        cx.in_range("priority", &partition.priority, 1, HIGHEST_PRIORITY.into());
        devices(cx, partition);
        granted_calls(cx, partition);
        program(cx, partition);
        standby_memory(cx, partition);
        not_zero(cx, "startup_timeout", &partition.startup_timeout);
        not_zero(cx, "deadline", &partition.deadline);
        not_zero(cx, "within", &partition.restart.within);
        not_zero(cx, "period", &partition.period);
        not_zero(cx, "duration", &partition.duration);
        threads_of_processes(cx, partition);
        stacks(cx, partition);
        standby_of_processes(cx, partition);
        logbooks(cx, partition);
    }
    shared_devices(cx);
    identifiers(cx);
}

fn logbooks(cx: &Context<'_>, partition: &RawPartition) {
    for logbook in &partition.logbooks {
        cx.in_range("max_size", &logbook.max_size, 1, LONGEST_BYTES);
        cx.in_range("max_logged", &logbook.max_logged, 1, MOST_LOGGED);
        cx.in_range("max_in_progress", &logbook.max_in_progress, 1, MOST_IN_PROGRESS);
    }
    let name = &partition.name.value;
    if let Some(one_more) = partition.logbooks.get(MOST_LOGBOOKS) {
        let message = format!("`{name}` has {} logbooks", partition.logbooks.len());
        let mend = format!("give it {MOST_LOGBOOKS} or fewer");
        cx.note(&catalogue::OUT_OF_RANGE, &one_more.name.span, message, mend);
    }
    if let (Some(standby), Some(logbook)) = (partition.standby.said(), partition.logbooks.first())
        && standby.value.0 != Standby::Spare
    {
        let message = format!("`{name}` has a logbook and a hot standby");
        let mend = "make it `standby = \"spare\"`, or let another partition keep the logbook";
        let finding = Finding::new(&catalogue::LOGBOOK_STANDBY, &standby.span, message, mend);
        cx.add(finding.also(&logbook.name.span, "its logbook"));
    }
}

fn program(cx: &Context<'_>, partition: &RawPartition) {
    let (Some(programs), Some(program)) = (cx.programs, partition.program.said()) else { return };
    if let Some(fault) = programs.fault(&program.value) {
        let message = format!("`{}` of partition `{}`: {fault}", program.value, partition.name.value);
        let mend = "build it, or correct its name or path";
        cx.note(&catalogue::PROGRAM_MISSING, &program.span, message, mend);
    }
}

fn memory(cx: &Context<'_>, partition: &RawPartition) {
    let Some(memory) = partition.memory.said() else { return };
    let name = &partition.name.value;
    if memory.value.0 == 0 {
        let message = format!("partition `{name}` has no memory");
        cx.note(&catalogue::MEMORY_ZERO, &memory.span, message, "give it some, such as \"32MiB\"");
        return;
    }
    if memory.value.0 < SMALLEST_MEMORY_BYTES {
        let message = format!("partition `{name}` has {} of memory to start with", ShowSize(memory.value.0));
        let mend = format!(
            "give it {} or more: what a program and its libraries take at the start counts too",
            ShowSize(SMALLEST_MEMORY_BYTES)
        );
        cx.note(&catalogue::MEMORY_SMALL, &memory.span, message, mend);
    }
    if let Some(retained) = partition.retained.said().filter(|retained| retained.value > memory.value) {
        let (Bytes(retained_bytes), Bytes(memory_bytes)) = (retained.value, memory.value);
        let (retained_bytes, memory_bytes) = (ShowSize(retained_bytes), ShowSize(memory_bytes));
        let message = format!("partition `{name}` retains {retained_bytes} of {memory_bytes} memory");
        let mend = "retain less, or give the partition more memory";
        let finding = Finding::new(&catalogue::RETAINED_TOO_LARGE, &retained.span, message, mend);
        cx.add(finding.also(&memory.span, "all its memory"));
    }
}

fn threads_of_processes(cx: &Context<'_>, partition: &RawPartition) {
    let (Some(threads), Some((processes, span))) = (partition.threads.said(), processes(partition)) else {
        return;
    };
    if threads.value as usize > processes {
        return;
    }
    let name = &partition.name.value;
    let message = format!("`{name}` may have {processes} processes, and {} threads", threads.value);
    let mend = "leave `threads` out: it follows from `processes`";
    let finding = Finding::new(&catalogue::TOO_FEW_THREADS, &threads.span, message, mend);
    cx.add(finding.also(span, "a thread for each of these, and one more"));
}

/// How many processes a partition may have, and where that is said; `None`: it is one loop, or does not say.
pub(super) fn processes(partition: &RawPartition) -> Option<(usize, &Span)> {
    let said = partition.processes.said().map(|said| (said.value as usize, &said.span));
    said.or_else(|| Some((partition.declared.len(), &partition.declared.first()?.name.span)))
}

fn stacks(cx: &Context<'_>, partition: &RawPartition) {
    let (Some(stacks), Some(memory)) = (partition.stacks.said(), partition.memory.said()) else { return };
    if stacks.value <= memory.value {
        return;
    }
    let (name, all) = (&partition.name.value, ShowSize(memory.value.0));
    let message = format!("the stacks of `{name}` may have {} of {all} memory", ShowSize(stacks.value.0));
    let mend = "make `stacks` smaller, or give the partition more memory";
    let finding = Finding::new(&catalogue::STACKS_TOO_LARGE, &stacks.span, message, mend);
    cx.add(finding.also(&memory.span, "all its memory"));
}

fn standby_of_processes(cx: &Context<'_>, partition: &RawPartition) {
    let (Some(standby), Some((_, span))) = (partition.standby.said(), processes(partition)) else { return };
    if standby.value.0 == Standby::Spare {
        return; // it has not begun, and has no process yet
    }
    let message = format!("`{}` has processes and a hot standby", partition.name.value);
    let mend = "make it `standby = \"spare\"`, or make the partition one loop without processes";
    let finding = Finding::new(&catalogue::PROCESSES_STANDBY, &standby.span, message, mend);
    cx.add(finding.also(span, "its processes"));
}

fn identifiers(cx: &Context<'_>) {
    let mut seen = HashMap::new();
    for partition in &cx.file.partitions {
        let Some(identifier) = partition.identifier.said() else { continue };
        let key = (partition.module.get(), identifier.value);
        let Some((one, first)) = seen.insert(key, (&partition.name.value, &identifier.span)) else {
            continue;
        };
        let message = format!("`{one}` and `{}` have the number {}", partition.name.value, identifier.value);
        let mend = "give one of them another, or leave it out for one that is free";
        let finding = Finding::new(&catalogue::IDENTIFIER_TWICE, &identifier.span, message, mend);
        cx.add(finding.also(first, format!("the number of `{one}`")));
    }
}

fn standby_memory(cx: &Context<'_>, partition: &RawPartition) {
    let (Some(standby), Some(memory)) = (partition.standby.said(), partition.memory.said()) else { return };
    let (once, twice) = (ShowSize(memory.value.0), ShowSize(memory.value.0.saturating_mul(2)));
    let message =
        format!("the two processes of `{}` may use {twice} together, {once} each", partition.name.value);
    let mend = "nothing is to be mended as long as the machine has it";
    let finding = Finding::new(&catalogue::STANDBY_MEMORY, &standby.span, message, mend);
    cx.add(finding.also(&memory.span, "of each process"));
}

pub(super) fn not_zero(cx: &Context<'_>, what: &str, time: &Field<Nanoseconds>) {
    if let Some(time) = time.said().filter(|time| time.value.0 == 0) {
        let mend = "write a time above zero, or leave the key out for its default";
        cx.note(&catalogue::ZERO_TIME, &time.span, format!("`{what}` is zero"), mend);
    }
}

fn devices(cx: &Context<'_>, partition: &RawPartition) {
    let mut seen = HashMap::new();
    for device in partition.devices.items() {
        known_device(cx, partition, device);
        let Some(first) = seen.insert(&device.value, &device.span) else { continue };
        let message = format!("partition `{}` is granted `{}` twice", partition.name.value, device.value);
        let finding = Finding::new(&catalogue::DEVICE_TWICE, &device.span, message, "remove one of the two");
        cx.add(finding.also(first, "it is granted here before"));
    }
}

fn granted_calls(cx: &Context<'_>, partition: &RawPartition) {
    for granted in partition.system_calls.items() {
        let calls = granted.value.0;
        let message = format!("partition `{}` may use `{calls}`: {}", partition.name.value, calls.cost());
        let mend = "nothing, if it needs them: the page on system calls says what bounds them";
        cx.note(&catalogue::GRANTED_CALLS, &granted.span, message, mend);
    }
}

fn known_device(cx: &Context<'_>, partition: &RawPartition, device: &At<String>) {
    let is_file_below = device
        .value
        .strip_prefix(DEVICES)
        .is_some_and(|rest| !rest.is_empty() && rest.split('/').all(|step| !matches!(step, "" | "." | "..")));
    if is_file_below || device.value == GROUND_LINK {
        return;
    }
    let message = format!("`{}` of partition `{}` is no device", device.value, partition.name.value);
    let mend = if device.value.contains('/') {
        format!("name a file below {DEVICES}")
    } else {
        format!(
            "name a file below {DEVICES}, or write `{GROUND_LINK}` for the line that is named at the start"
        )
    };
    cx.note(&catalogue::UNKNOWN_DEVICE, &device.span, message, mend);
}

fn shared_devices(cx: &Context<'_>) {
    let mut seen: HashMap<(Option<String>, &str), (PartitionId, _)> = HashMap::new();
    for (id, partition) in cx.partitions() {
        for device in partition.devices.items() {
            let key = (partition.module.get(), device.value.as_str());
            let (owner, first) = *seen.entry(key).or_insert((id, &device.span));
            if owner == id {
                continue;
            }
            let (one, other) = (cx.partition_name(owner), &partition.name.value);
            let message = format!("`{one}` and `{other}` share the device `{}`", device.value);
            let mend = "grant it to one of them, and let the other ask through a port";
            let finding = Finding::new(&catalogue::DEVICE_SHARED, &device.span, message, mend);
            cx.add(finding.also(first, format!("`{one}` has it here")));
        }
    }
}
