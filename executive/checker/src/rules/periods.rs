//! Rules about the periods of partitions: that each has its time in every one of them, and from its start on.

use super::Context;
use super::partitions::processes;
use crate::catalogue;
use crate::findings::{Finding, Span};
use crate::raw::{RawPartition, RawSchedule};
use crate::units::ShowTime;
use bateleur_plan::processes::{Share, shares};

pub(super) fn check(cx: &Context<'_>) {
    for (id, partition) in cx.partitions() {
        // Who says nothing has no use for periods.
        let Some(asked) = Asked::of(partition) else { continue };
        let told = &cx.plan[id].processes;
        for (place, (raw, schedule)) in cx.schedules().enumerate() {
            let (windows, times) = (schedule.occurrences(id), told.times_in(place));
            if told.period_ns > 0 && !windows.is_empty() {
                let grid = (times.release_ns, times.period_ns);
                in_schedule(cx, &asked, (raw, &windows), schedule.major_frame_ns, grid);
            }
        }
    }
}

/// A partition that asks for a period, and where it does.
struct Asked<'a> {
    partition: &'a RawPartition,
    span: &'a Span,
}

impl<'a> Asked<'a> {
    fn of(partition: &'a RawPartition) -> Option<Self> {
        let time = partition.period.said().or(partition.duration.said()).map(|at| &at.span);
        let span = time.or_else(|| processes(partition).map(|(_, span)| span))?;
        Some(Self { partition, span })
    }

    fn name(&self) -> &str {
        &self.partition.name.value
    }
}

fn in_schedule(
    cx: &Context<'_>,
    asked: &Asked<'_>,
    (schedule, windows): (&RawSchedule, &[(u64, u64)]),
    major_ns: u64,
    grid: (u64, u64),
) {
    let (name, flight) = (asked.name(), &schedule.name.value);
    let shares = shares(windows, major_ns, grid);
    let Some(least) = shares.iter().min_by_key(|share| share.time_ns) else {
        let (period, major) = (ShowTime(grid.1), ShowTime(major_ns));
        let message = format!(
            "the major frame of `{flight}`, {major}, is no multiple of the period of `{name}`, {period}"
        );
        let mend = "choose a `period` that divides the major frame of each schedule in which it has windows";
        let finding = Finding::new(&catalogue::PERIOD_NOT_DIVISOR, asked.span, message, mend);
        return cx.add(finding.also(&schedule.name.span, "the schedule"));
    };
    if let Some(crossed) = shares.iter().find(|share| share.crossed) {
        let end = ShowTime((crossed.release_ns + grid.1) % major_ns);
        let message =
            format!("a window of `{name}` in `{flight}` goes on beyond the end of a period at {end}");
        let mend = format!(
            "its periods begin {} after the frame and last {}: let the window end there",
            ShowTime(grid.0),
            ShowTime(grid.1)
        );
        let finding = Finding::new(&catalogue::WINDOW_CROSSES_PERIOD, asked.span, message, mend);
        cx.add(finding.also(&schedule.name.span, "the schedule"));
    }
    amount(cx, asked, schedule, least);
    let latest = shares.iter().filter(|share| share.time_ns > 0).max_by_key(|share| share.waits_ns);
    if let Some(latest) = latest.filter(|share| share.waits_ns > 0) {
        let (at, wait) = (ShowTime(latest.release_ns), ShowTime(latest.waits_ns));
        let message =
            format!("the release point of `{name}` at {at} of `{flight}` is {wait} before its window");
        let mend = "let a window start there, or count this wait into the deadlines of its processes";
        let finding = Finding::new(&catalogue::RELEASE_WITHOUT_WINDOW, asked.span, message, mend);
        cx.add(finding.also(&schedule.name.span, "the schedule"));
    }
}

/// A partition has its duration in the period that has least.
fn amount(cx: &Context<'_>, asked: &Asked<'_>, schedule: &RawSchedule, least: &Share) {
    let (name, flight) = (asked.name(), &schedule.name.value);
    let (at, time) = (ShowTime(least.release_ns), ShowTime(least.time_ns));
    if least.time_ns == 0 {
        let message = format!("`{name}` has no window in its period from {at} on in `{flight}`");
        let mend = "give it a window in each period, or choose a longer `period`";
        let finding = Finding::new(&catalogue::PERIOD_WITHOUT_WINDOW, asked.span, message, mend);
        return cx.add(finding.also(&schedule.name.span, "the schedule"));
    }
    let Some(duration) = asked.partition.duration.said() else { return };
    let message = format!(
        "`{name}` has {time} in its period from {at} on in `{flight}`, and its duration is {}",
        ShowTime(duration.value.0)
    );
    let (rule, mend) = if least.time_ns < duration.value.0 {
        (&catalogue::DURATION_SHORT, "give it longer windows, or more of them, in that period".to_owned())
    } else if least.time_ns > duration.value.0 {
        let mend = format!("shorten its windows, or let the duration be {time}: every period has that much");
        (&catalogue::DURATION_EXCEEDED, mend)
    } else {
        return;
    };
    let finding = Finding::new(rule, &duration.span, message, mend);
    cx.add(finding.also(&schedule.name.span, "the schedule"));
}
