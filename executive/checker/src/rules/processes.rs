//! Rules about processes whose times the file says: that they can be created, and that they keep their deadlines at worst.

use std::collections::BTreeSet;

use super::Context;
use super::partitions::not_zero;
use crate::catalogue;
use crate::findings::Finding;
use crate::model::{PartitionId, Schedule};
use crate::raw::{RawPartition, RawProcess, RawSchedule};
use crate::response::Response;
use crate::responses::worst;
use crate::units::ShowTime;
use bateleur_plan::bounds::MOST_URGENT;
use bateleur_plan::{Process, words::listed};

pub(super) fn check(cx: &Context<'_>) {
    for (id, partition) in cx.partitions() {
        let Some(first) = partition.declared.first() else { continue };
        for process in &partition.declared {
            cx.in_range("priority", &process.priority, 1, MOST_URGENT.into());
            not_zero(cx, "period", &process.period);
            not_zero(cx, "deadline", &process.deadline);
            not_zero(cx, "wcet", &process.wcet);
            deadline(cx, process);
        }
        count(cx, partition, first);
        let told = &cx.plan[id].processes;
        if told.period_ns == 0 {
            continue;
        }
        let periods: BTreeSet<u64> =
            told.in_schedules.values().map(|times| times.period_ns).chain([told.period_ns]).collect();
        let misfits = |process: &RawProcess| periods.iter().any(|of| !period(cx, partition, process, *of));
        let is_misfit = |process: &&RawProcess| misfits(process);
        if partition.declared.iter().filter(is_misfit).count() == 0 {
            cx.schedules().for_each(|pair| in_schedule(cx, (id, partition), pair));
        }
    }
}

fn count(cx: &Context<'_>, partition: &RawPartition, first: &RawProcess) {
    let (Some(most), count) = (partition.processes.said(), partition.declared.len()) else { return };
    if count <= most.value as usize {
        return;
    }
    let message = format!("`{}` has {count} processes, and may have {}", partition.name.value, most.value);
    let mend = format!("let `processes` be {count}, or leave it out");
    let finding = Finding::new(&catalogue::TOO_MANY_PROCESSES, &most.span, message, mend);
    cx.add(finding.also(&first.name.span, "the first of them"));
}

fn deadline(cx: &Context<'_>, process: &RawProcess) {
    let (Some(deadline), Some(period)) = (process.deadline.said(), process.period.said()) else { return };
    if deadline.value <= period.value {
        return;
    }
    let (late, next) = (ShowTime(deadline.value.0), ShowTime(period.value.0));
    let message =
        format!("the deadline of `{}`, {late}, is after its next release, {next}", process.name.value);
    let mend = "make the deadline no longer than the period, or leave it out";
    let finding = Finding::new(&catalogue::DEADLINE_AFTER_PERIOD, &deadline.span, message, mend);
    cx.add(finding.also(&period.span, "the period"));
}

/// Whether the period of a process fits that of its partition.
fn period(cx: &Context<'_>, partition: &RawPartition, process: &RawProcess, of_partition: u64) -> bool {
    let Some(period) = process.period.said() else { return process.period.is_absent() };
    if period.value.0 > 0 && period.value.0.is_multiple_of(of_partition) {
        return true;
    }
    let (own, all) = (ShowTime(period.value.0), ShowTime(of_partition));
    let message = format!(
        "the period of `{}`, {own}, is no multiple of that of `{}`, {all}",
        process.name.value, partition.name.value
    );
    let mend = format!("choose a multiple of {all}, or another `period` of the partition");
    let finding = Finding::new(&catalogue::PROCESS_PERIOD, &period.span, message, mend);
    cx.add(match partition.period.said() {
        Some(said) => finding.also(&said.span, "the period of the partition"),
        None => finding,
    });
    false
}

fn in_schedule(
    cx: &Context<'_>,
    (id, partition): (PartitionId, &RawPartition),
    (raw, schedule): (&RawSchedule, &Schedule),
) {
    let Some(responses) = worst(cx.plan, schedule, id) else { return };
    let processes = &cx.plan[id].processes.declared;
    for ((process, response), raw_process) in processes.iter().zip(responses).zip(&partition.declared) {
        let (Some(deadline_ns), Some(said)) = (process.deadline_ns, raw_process.deadline.said()) else {
            continue;
        };
        let who = format!("`{}` of `{}`", process.name, partition.name.value);
        let flight = &schedule.name;
        let (rule, message) = match response {
            Response::Within(response) if response <= deadline_ns => continue,
            Response::Within(response) => {
                let (done, late) = (ShowTime(response), ShowTime(response - deadline_ns));
                let message = format!(
                    "{who} may be done {done} after its release in `{flight}`, {late} after its deadline"
                );
                (&catalogue::RESPONSE_TOO_LATE, message)
            }
            Response::TooMuch => {
                let why = "it and those that go before it ask for more than the windows give";
                (
                    &catalogue::RESPONSE_UNBOUNDED,
                    format!("nothing bounds when {who} is done in `{flight}`: {why}"),
                )
            }
            Response::Unlimited(other) => {
                let other = &processes[other].name;
                let why = format!("`{other}` goes before it and has no period");
                (
                    &catalogue::RESPONSE_UNBOUNDED,
                    format!("nothing bounds when {who} is done in `{flight}`: {why}"),
                )
            }
        };
        let finding = Finding::new(rule, &said.span, message, mend(processes, process));
        cx.add(finding.also(&raw.name.span, "the schedule"));
    }
}

/// What could be changed.
fn mend(processes: &[Process], late: &Process) -> String {
    let before = processes.iter().filter(|other| other.name != late.name && other.priority >= late.priority);
    let before: Vec<&str> = before.map(|process| process.name.as_str()).collect();
    let first = "give its partition more time, or windows that lie closer together";
    match before.as_slice() {
        [] => format!("{first}, or allow a longer deadline"),
        names => format!("{first}; or let it go before {}", listed(names.iter().copied())),
    }
}
