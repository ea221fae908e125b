//! Rules about schedules as a whole: their frames, which one is initial, and who is in them.

use super::Context;
use super::laid::{self, minor_frames};
use crate::build::starts_cold;
use crate::catalogue;
use crate::closed::ChangeAction;
use crate::findings::Finding;
use crate::raw::RawSchedule;
use crate::reader::{At, Field, Nanoseconds, Permission};
use crate::units::ShowTime;
use bateleur_plan::bounds::{MOST_MINOR_FRAMES, MOST_WINDOWS};
use bateleur_plan::words::{did_you_mean, listed};

pub(super) fn check(cx: &Context<'_>) {
    for schedule in &cx.file.schedules {
        frames(cx, schedule);
        windows(cx, schedule);
    }
    initial(cx);
    major_frames(cx);
    minor_frames_differ(cx);
    partitions(cx);
    for schedule in &cx.file.schedules {
        change_actions(cx, schedule);
    }
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

fn windows(cx: &Context<'_>, schedule: &RawSchedule) {
    let Some((_, frames)) = minor_frames(schedule) else { return };
    let Some(((module, core), count)) = laid::most_windows(cx, schedule, frames) else { return };
    if count > MOST_WINDOWS {
        let module = &cx.file.modules[module].name.value;
        let message = format!("core {core} of `{module}` has {count} windows in a major frame");
        let mend =
            format!("shorten the major frame, or let windows recur less often: {MOST_WINDOWS} is the most");
        let finding = Finding::new(&catalogue::TOO_MANY_WINDOWS, &schedule.name.span, message, mend);
        cx.add(match schedule.major_frame.said() {
            Some(major) => finding.also(&major.span, "the major frame"),
            None => finding,
        });
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

fn runs_in(cx: &Context<'_>, schedule: &RawSchedule, partition: usize) -> bool {
    schedule.windows.iter().any(|window| cx.names.owner(window) == Some(partition))
}

fn change_actions(cx: &Context<'_>, schedule: &RawSchedule) {
    for (name, action) in &schedule.change_actions {
        let Some(partition) = cx.names.partition(&name.value) else {
            let known = cx.file.partitions.iter().map(|partition| partition.name.value.as_str());
            let message = format!("there is no partition `{}`", name.value);
            cx.note(&catalogue::UNKNOWN_PARTITION, &name.span, message, did_you_mean(&name.value, known));
            continue;
        };
        let name_there = &cx.file.partitions[partition].name;
        if !runs_in(cx, schedule, partition) {
            if action.value == ChangeAction::Ignore {
                continue; // it is meant to stand still there
            }
            let message =
                format!("`{}` has a change action in `{}`, but no window", name.value, schedule.name.value);
            let mend = "give the partition a window there, or write `ignore`: it stands still there, and is meant to";
            let finding = Finding::new(&catalogue::CHANGE_ACTION_UNUSED, &name.span, message, mend);
            cx.add(finding.also(&name_there.span, "the partition"));
            continue;
        }
        let without = cx.file.schedules.iter().find(|other| !runs_in(cx, other, partition));
        if let (ChangeAction::Ignore, Some(other)) = (action.value, without) {
            let (name, here, other_name) = (&name.value, &schedule.name.value, &other.name.value);
            let message =
                format!("`{name}` goes on as if nothing had been when `{here}` follows `{other_name}`");
            let mend = "leave the action out: a newly scheduled partition starts cold";
            let finding = Finding::new(&catalogue::NEWLY_SCHEDULED_IGNORED, &action.span, message, mend);
            cx.add(finding.also(&other.name.span, "the schedule in which it stands still"));
        }
        if action.value == ChangeAction::WarmRestart && starts_cold(&cx.file.partitions[partition]) {
            let message = format!("a warm restart is asked for, but `{}` starts cold", name.value);
            let mend =
                "write `cold_restart`, or let the partition start warm: `restart = { start = \"warm\" }`";
            let finding = Finding::new(&catalogue::WARM_WHERE_COLD, &action.span, message, mend);
            cx.add(finding.also(&name_there.span, "the partition"));
        }
    }
}

fn permissions(cx: &Context<'_>) {
    for (place, partition) in cx.file.partitions.iter().enumerate() {
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
            permission(cx, place, schedule, alone);
        }
    }
}

fn permission(cx: &Context<'_>, partition: usize, schedule: &At<String>, alone: bool) {
    let name = cx.partition_name(partition);
    match cx.names.schedule(cx.file, &schedule.value) {
        None => {
            let known = cx.file.schedules.iter().map(|schedule| schedule.name.value.as_str());
            let message = format!("there is no schedule `{}`", schedule.value);
            let mend = did_you_mean(&schedule.value, known);
            cx.note(&catalogue::UNKNOWN_SCHEDULE, &schedule.span, message, mend);
        }
        Some(place) if !alone && !runs_in(cx, &cx.file.schedules[place], partition) => {
            let message =
                format!("`{name}` may ask in schedule `{}`, where it has no window", schedule.value);
            let mend = "remove the schedule from the list, or give the partition a window there";
            let finding = Finding::new(&catalogue::PERMISSION_UNUSED, &schedule.span, message, mend);
            cx.add(finding.also(&cx.file.schedules[place].name.span, "the schedule"));
        }
        Some(_) => {}
    }
}

/// Every partition has a window, in every schedule at best.
fn partitions(cx: &Context<'_>) {
    let windows = || cx.file.schedules.iter().flat_map(|schedule| &schedule.windows);
    let is_mistyped = cx.file.schedules.iter().any(|schedule| schedule.windows_mistyped);
    if cx.file.schedules.is_empty() || is_mistyped || windows().any(|window| cx.names.owner(window).is_none())
    {
        // A window of an unknown partition, or under an unknown key, may well be the one that seems to be missing.
        return;
    }
    let mut absent: Vec<Vec<&str>> = vec![Vec::new(); cx.file.schedules.len()];
    // What a relay needs is a rule of the links.
    let own = cx.file.partitions.iter().enumerate().filter(|(_, partition)| !partition.generated);
    for (place, partition) in own {
        let name = &partition.name;
        if !cx.file.schedules.iter().any(|schedule| runs_in(cx, schedule, place)) {
            let message = format!("partition `{}` has no window in any schedule", name.value);
            let mend = format!(
                "add `{{ partition = \"{}\", offset = \"…\", duration = \"…\" }}` to the windows of a schedule, or remove it",
                name.value
            );
            cx.note(&catalogue::NEVER_SCHEDULED, &name.span, message, &mend);
            continue;
        }
        for (schedule, absent) in cx.file.schedules.iter().zip(&mut absent) {
            let mut said = schedule.change_actions.iter().map(|(name, action)| (&name.value, action.value));
            let is_meant = said.any(|said| said == (&name.value, ChangeAction::Ignore));
            if !is_meant && !runs_in(cx, schedule, place) {
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
