//! Rules about the windows of replicas: those that are voted on together have read the same.

use std::collections::{BTreeMap, BTreeSet};

use bateleur_contract::OUTVOTED_PORT;

use super::Context;
use crate::catalogue;
use crate::findings::{Finding, Span};
use crate::model::{ModuleId, PartitionId, PortId, Schedule};
use crate::raw::RawSchedule;
use crate::reader::Field;
use crate::units::ShowTime;

pub(super) fn check(cx: &Context<'_>) {
    for (voter, raw) in cx.partitions() {
        let Field::Said(said) = &raw.replicas else { continue };
        let mut by_module: BTreeMap<ModuleId, Vec<PartitionId>> = BTreeMap::new();
        for &replica in &cx.plan[voter].replicas {
            by_module.entry(cx.plan[replica].module).or_default().push(replica);
        }
        for (module, replicas) in by_module.into_iter().filter(|(_, replicas)| replicas.len() > 1) {
            let mut others = writers(cx, module, &replicas);
            others.extend(Some(voter).filter(|voter| cx.plan[*voter].module == module));
            for (raw, schedule) in cx.schedules() {
                in_schedule(cx, &said.span, (raw, schedule), &replicas, &others);
            }
        }
    }
}

/// The partitions of the module that write what the replicas read.
fn writers(cx: &Context<'_>, module: ModuleId, replicas: &[PartitionId]) -> BTreeSet<PartitionId> {
    let reads = |port: PortId| {
        let port = &cx.plan[port];
        replicas.contains(&port.partition) && port.name != OUTVOTED_PORT
    };
    let channels =
        cx.plan.channels.iter().filter(|channel| channel.destinations.iter().any(|&port| reads(port)));
    let writer = |source: PartitionId| match cx.plan[source].module == module {
        true => Some(source),
        false => cx.plan.relay_of(module),
    };
    channels.filter_map(|channel| writer(cx.plan[channel.source].partition)).collect()
}

/// The first windows of the replicas, their second ones and so on: nobody of the others has one between them.
fn in_schedule(
    cx: &Context<'_>,
    span: &Span,
    (raw, schedule): (&RawSchedule, &Schedule),
    replicas: &[PartitionId],
    others: &BTreeSet<PartitionId>,
) {
    let starts: Vec<Vec<u64>> = replicas.iter().map(|&replica| schedule.starts(replica)).collect();
    let flight = &raw.name.value;
    let note = |message: String, mend: &str| {
        let finding = Finding::new(&catalogue::REPLICAS_APART, span, message, mend);
        cx.add(finding.also(&raw.name.span, "the schedule"));
    };
    let name = |place: usize| cx.partition_name(replicas[place]);
    if let Some(other) = (1..starts.len()).find(|&other| starts[other].len() != starts[0].len()) {
        let (one, other) = ((name(0), starts[0].len()), (name(other), starts[other].len()));
        let message =
            format!("`{}` has {} windows in `{flight}`, and `{}` {}", one.0, one.1, other.0, other.1);
        return note(message, "give each replica as many: the voter compares what they write in them");
    }
    for round in 0..starts[0].len() {
        let of_round = || starts.iter().map(|starts| starts[round]);
        let (Some(first), Some(last)) = (of_round().min(), of_round().max()) else { continue };
        let between = |&other: &PartitionId| {
            let windows = schedule.occurrences(other).into_iter();
            let (at, _) = windows.into_iter().find(|(start, end)| *start < last && *end > first)?;
            Some((other, at))
        };
        if let Some((other, at)) = others.iter().find_map(between) {
            let at = ShowTime(at);
            let message = format!(
                "`{}` has a window at {at} of `{flight}`, between those of the replicas",
                cx.partition_name(other)
            );
            let mend = "let it run before the first replica or behind the last one: replicas that read before it and after it differ";
            return note(message, mend);
        }
    }
}
