//! Rules about schedules as a whole: their frames, which one is initial, and who is in them.

use super::Context;
use crate::catalogue;
use crate::closed::{ChangeAction, StartMode};
use crate::findings::Finding;
use crate::model::{PartitionId, Schedule};
use crate::raw::RawSchedule;
use crate::reader::{At, Field, Nanoseconds, Permission};
use crate::units::ShowTime;
use bateleur_plan::bounds::MOST_MINOR_FRAMES;
use bateleur_plan::words::listed;

pub(super) fn check(cx: &Context<'_>) {
    cx.file.schedules.iter().for_each(|schedule| frames(cx, schedule));
    initial(cx);
    major_frames(cx);
    minor_frames_differ(cx);
    partitions(cx);
    cx.schedules().for_each(|pair| change_actions(cx, pair));
    permissions(cx);
}

fn frames(cx: &Context<'_>, schedule: &RawSchedule) {
    zero(cx, "major", &schedule.major_frame);
    zero(cx, "minor", &schedule.minor_frame);
    let (Some(major), Some(minor)) = (schedule.major_frame.said(), schedule.minor_frame.said()) else {
        return;
    };
    let (major_ns, minor_ns) = (major.value.0, minor.value.0);
    if major_ns == 0 || minor_ns == 0 {
        return;
    }
    if major_ns % minor_ns != 0 {
        let (major_time, minor_time) = (ShowTime(major_ns), ShowTime(minor_ns));
        let message =
            format!("a major frame of {major_time} is no whole number of {minor_time} minor frames");
        let mend =
            format!("make it {} or {}", below(major_ns, minor_ns), ShowTime(above(major_ns, minor_ns)));
        let finding = Finding::new(&catalogue::MAJOR_NOT_MULTIPLE, &major.span, message, mend);
        cx.add(finding.also(&minor.span, "the minor frame"));
    } else if major_ns / minor_ns > MOST_MINOR_FRAMES {
        let message = format!("the major frame has {} minor frames", major_ns / minor_ns);
        let mend = format!("shorten it: {MOST_MINOR_FRAMES} is the most");
        let finding = Finding::new(&catalogue::TOO_MANY_MINOR_FRAMES, &major.span, message, mend);
        cx.add(finding.also(&minor.span, "the minor frame"));
    }
}

/// The next shorter whole major frame, but at least one minor frame.
fn below(major_ns: u64, minor_ns: u64) -> ShowTime {
    ShowTime((major_ns / minor_ns).max(1) * minor_ns)
}

fn above(major_ns: u64, minor_ns: u64) -> u64 {
    (major_ns / minor_ns + 1).max(2).saturating_mul(minor_ns)
}

fn zero(cx: &Context<'_>, what: &str, frame: &Field<Nanoseconds>) {
    if let Some(frame) = frame.said().filter(|frame| frame.value.0 == 0) {
        let message = format!("the {what} frame is zero");
        cx.note(&catalogue::ZERO_FRAME, &frame.span, message, "write a time above zero, such as \"20ms\"");
    }
}

fn initial(cx: &Context<'_>) {
    let schedules = &cx.file.schedules;
    // The only schedule need not say so.
    let alone = schedules.len() == 1;
    let says = |schedule: &&RawSchedule| schedule.initial.or(alone) != Some(false);
    let mut initial = schedules.iter().filter(says);
    let Some(first) = initial.next() else { return no_initial(cx) };
    for other in initial {
        let message = format!("`{}` and `{}` are both initial", first.name.value, other.name.value);
        let mend = "leave `initial = true` to one of them";
        let finding = Finding::new(&catalogue::TWO_INITIAL_SCHEDULES, &other.name.span, message, mend);
        cx.add(finding.also(&first.name.span, "the other one"));
    }
}

fn no_initial(cx: &Context<'_>) {
    let (span, message, mend) = match cx.file.schedules.first() {
        None => (0..0, "the file has no schedule", "add `[schedule.NAME]` with its frames and windows"),
        Some(first) => (first.name.span.clone(), "no schedule is initial", "add `initial = true` to one"),
    };
    cx.note(&catalogue::NO_INITIAL_SCHEDULE, &span, message, mend);
}

fn major_frames(cx: &Context<'_>) {
    let mut frames =
        cx.file.schedules.iter().filter_map(|schedule| Some((schedule, schedule.major_frame.said()?)));
    let Some((first, one)) = frames.next() else { return };
    for (schedule, other) in frames.filter(|(_, other)| other.value != one.value) {
        let message = format!(
            "the major frames of `{}` and `{}` differ: {} and {}",
            first.name.value,
            schedule.name.value,
            ShowTime(one.value.0),
            ShowTime(other.value.0)
        );
        let mend = "make them equal, or accept that a change takes up to the longer of the two";
        let finding = Finding::new(&catalogue::MAJOR_FRAMES_DIFFER, &other.span, message, mend);
        cx.add(finding.also(&one.span, "the other one"));
    }
}

fn minor_frames_differ(cx: &Context<'_>) {
    let mut frames =
        cx.file.schedules.iter().filter_map(|schedule| Some((schedule, schedule.minor_frame.said()?)));
    let Some((first, one)) = frames.next() else { return };
    for (schedule, other) in frames.filter(|(_, other)| other.value != one.value) {
        let message = format!(
            "the minor frames of `{}` and `{}` differ: {} and {}",
            first.name.value,
            schedule.name.value,
            ShowTime(one.value.0),
            ShowTime(other.value.0)
        );
        let mend =
            "make them equal, or see that every partition, refresh period and queue stands both periods";
        let finding = Finding::new(&catalogue::MINOR_FRAMES_DIFFER, &other.span, message, mend);
        cx.add(finding.also(&one.span, "the other one"));
    }
}

fn change_actions(cx: &Context<'_>, (raw, schedule): (&RawSchedule, &Schedule)) {
    for (name, action) in &raw.change_actions {
        let Some(partition) = cx.plan.partition(&name.value) else { continue };
        let name_there = &cx.file.partitions[partition.0].name;
        if !schedule.runs(partition) {
            if action.value == ChangeAction::Ignore {
                continue; // it is meant to stand still there
            }
            let message =
                format!("`{}` has a change action in `{}`, but no window", name.value, schedule.name);
            let mend = "give the partition a window there, or write `ignore`: it stands still there, and is meant to";
            let finding = Finding::new(&catalogue::CHANGE_ACTION_UNUSED, &name.span, message, mend);
            cx.add(finding.also(&name_there.span, "the partition"));
            continue;
        }
        let without = cx.schedules().find(|(_, other)| !other.runs(partition));
        if let (ChangeAction::Ignore, Some((other, _))) = (action.value, without) {
            let (name, here, other_name) = (&name.value, &schedule.name, &other.name.value);
            let message =
                format!("`{name}` goes on as if nothing had been when `{here}` follows `{other_name}`");
            let mend = "leave the action out: a newly scheduled partition starts cold";
            let finding = Finding::new(&catalogue::NEWLY_SCHEDULED_IGNORED, &action.span, message, mend);
            cx.add(finding.also(&other.name.span, "the schedule in which it stands still"));
        }
        if action.value == ChangeAction::WarmRestart && cx.plan[partition].restart.start == StartMode::Cold {
            let message = format!("a warm restart is asked for, but `{}` starts cold", name.value);
            let mend =
                "write `cold_restart`, or let the partition start warm: `restart = { start = \"warm\" }`";
            let finding = Finding::new(&catalogue::WARM_WHERE_COLD, &action.span, message, mend);
            cx.add(finding.also(&name_there.span, "the partition"));
        }
    }
}

fn permissions(cx: &Context<'_>) {
    for (id, partition) in cx.partitions() {
        let Some(said) = partition.may_set_schedule.said() else { continue };
        let name = &partition.name.value;
        let listed: &[At<String>] = match &said.value {
            Permission::Always(false) => continue,
            Permission::Always(true) => &[],
            Permission::In(listed) => listed,
        };
        let alone = cx.file.schedules.len() == 1;
        if alone {
            let message = format!("`{name}` may ask for another schedule, and there is no other");
            let mend = "remove `may_set_schedule`, or add a schedule";
            cx.note(&catalogue::PERMISSION_UNUSED, &said.span, message, mend);
        }
        for schedule in listed {
            permission(cx, id, schedule, alone);
        }
    }
}

fn permission(cx: &Context<'_>, partition: PartitionId, said: &At<String>, alone: bool) {
    let Some((raw, schedule)) = cx.schedules().find(|(_, schedule)| schedule.name == said.value) else {
        return;
    };
    if !alone && !schedule.runs(partition) {
        let name = cx.partition_name(partition);
        let message = format!("`{name}` may ask in schedule `{}`, where it has no window", said.value);
        let mend = "remove the schedule from the list, or give the partition a window there";
        let finding = Finding::new(&catalogue::PERMISSION_UNUSED, &said.span, message, mend);
        cx.add(finding.also(&raw.name.span, "the schedule"));
    }
}

/// Every partition has a window, in every schedule at best.
fn partitions(cx: &Context<'_>) {
    let is_mistyped = cx.file.schedules.iter().any(|schedule| schedule.windows_mistyped);
    let of_nobody = cx.plan.schedules.iter().any(|schedule| cx.has_window_of_nobody(schedule));
    if cx.file.schedules.is_empty() || is_mistyped || of_nobody {
        // A window of an unknown partition, or under an unknown key, may well be the one that seems to be missing.
        return;
    }
    let mut absent: Vec<Vec<&str>> = vec![Vec::new(); cx.file.schedules.len()];
    // What a relay needs is a rule of the links.
    for (id, partition) in cx.partitions().filter(|(_, partition)| !partition.generated) {
        let name = &partition.name;
        if !cx.plan.schedules.iter().any(|schedule| schedule.runs(id)) {
            let message = format!("partition `{}` has no window in any schedule", name.value);
            let mend = format!(
                "add `{{ partition = \"{}\", offset = \"…\", duration = \"…\" }}` to the windows of a schedule, or remove it",
                name.value
            );
            cx.note(&catalogue::NEVER_SCHEDULED, &name.span, message, &mend);
            continue;
        }
        for (schedule, absent) in cx.plan.schedules.iter().zip(&mut absent) {
            let is_meant = schedule.change_actions.get(&id) == Some(&ChangeAction::Ignore);
            if !is_meant && !schedule.runs(id) {
                absent.push(&name.value);
            }
        }
    }
    for (schedule, absent) in cx.file.schedules.iter().zip(absent) {
        if absent.is_empty() {
            continue;
        }
        let message =
            format!("schedule `{}` has no window of {}", schedule.name.value, listed(absent.iter().copied()));
        let said: Vec<_> = absent.iter().map(|name| format!("{name} = \"ignore\"")).collect();
        let mend = format!(
            "add one of each, or say that they are meant to stand still there: `change_action = {{ {} }}`",
            said.join(", ")
        );
        cx.note(&catalogue::NOT_IN_SCHEDULE, &schedule.name.span, message, mend);
    }
}
