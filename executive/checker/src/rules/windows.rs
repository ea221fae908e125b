//! Rules about windows: that each lies in its frame, and that no two are in each other's way.

use bateleur_plan::timeline::{TimelineWindow, gaps};
use std::collections::{BTreeMap, BTreeSet};

use super::Context;
use crate::catalogue::{self, Rule};
use crate::findings::{Finding, Span};
use crate::model::{ModuleId, PartitionId, Schedule};
use crate::raw::{RawSchedule, RawWindow};
use crate::reader::At;
use crate::resolve::minor_frames;
use crate::units::ShowTime;

/// A thaw, a wake-up, a freeze and its check take some tens of microseconds; a window below this is mostly switch.
const SHORTEST_NS: u64 = 100_000;
/// Linux by default gives real-time threads 95 % of every second; the dispatcher and the kernel need some of that.
const FULLEST_PERCENT: u64 = 90;

pub(super) fn check(cx: &Context<'_>) {
    for (raw, schedule) in cx.schedules() {
        for (window, meant) in raw.windows.iter().zip(&schedule.windows) {
            duration(cx, window);
            frame(cx, raw, window);
            minor(cx, (raw, schedule), window);
            core(cx, window, meant.partition);
        }
        let core = |window: &TimelineWindow| core_of(cx, schedule, window);
        let mut laid = schedule.laid(|_| true);
        laid.sort_by_key(core);
        overlaps(cx, (raw, schedule), &laid);
        fill(cx, (raw, schedule), &laid);
        laid.sort_by_key(|window| (window.partition, window.start_ns, window.declared));
        two_cores(cx, (raw, schedule), &laid);
    }
}

/// Where a window is.
fn core_of(cx: &Context<'_>, schedule: &Schedule, window: &TimelineWindow) -> (ModuleId, u32) {
    (cx.plan[window.partition].module, schedule.windows[window.declared].core)
}

/// The name of the partition of a window, for messages.
fn whose(window: &RawWindow) -> &str {
    window.partition.said().map_or("?", |partition| partition.value.as_str())
}

fn duration(cx: &Context<'_>, window: &RawWindow) {
    let Some(duration) = window.duration.said() else { return };
    let (name, time) = (whose(window), ShowTime(duration.value.0));
    if time.0 == 0 {
        let message = format!("a window of `{name}` has no length");
        cx.note(
            &catalogue::ZERO_DURATION,
            &duration.span,
            message,
            "give it a time above zero, or remove it",
        );
    } else if time.0 < SHORTEST_NS {
        let message = format!("a window of `{name}` is only {time} long");
        let mend = format!("make it {} at least", ShowTime(SHORTEST_NS));
        cx.note(&catalogue::WINDOW_TOO_SHORT, &duration.span, message, mend);
    }
}

fn frame(cx: &Context<'_>, schedule: &RawSchedule, window: &RawWindow) {
    let (Some(offset), Some(duration)) = (window.offset.said(), window.duration.said()) else { return };
    let Some(frame) = schedule.minor_frame.said().filter(|frame| frame.value.0 > 0) else { return };
    let end = offset.value.0.saturating_add(duration.value.0);
    if end <= frame.value.0 {
        return;
    }
    let (end, minor) = (ShowTime(end), ShowTime(frame.value.0));
    let message = format!("a window of `{}` ends at {end} of a {minor} minor frame", whose(window));
    let mend = "let it start earlier, shorten it, or make the minor frame longer";
    let finding = Finding::new(&catalogue::WINDOW_OUTSIDE_FRAME, &duration.span, message, mend);
    cx.add(finding.also(&offset.span, "it starts here").also(&frame.span, "the minor frame"));
}

fn minor(cx: &Context<'_>, (raw, schedule): (&RawSchedule, &Schedule), window: &RawWindow) {
    let Some(list) = window.minor.said() else { return };
    let name = whose(window);
    if list.value.is_empty() {
        let message = format!("a window of `{name}` is in no minor frame");
        let mend = "leave `minor` out for every frame, or remove the window";
        cx.note(&catalogue::NO_MINOR, &list.span, message, mend);
    }
    let mut seen: BTreeMap<u32, &Span> = BTreeMap::new();
    for index in &list.value {
        if let Some(first) = seen.insert(index.value, &index.span) {
            let message = format!("a window of `{name}` is in minor frame {} twice", index.value);
            let finding =
                Finding::new(&catalogue::MINOR_TWICE, &index.span, message, "remove one of the two");
            cx.add(finding.also(first, "it is here before"));
        }
    }
    let minor_ns = schedule.minor_frame_ns;
    let Some(frames) = minor_frames(schedule.major_frame_ns, minor_ns) else { return };
    if !minor_beyond(cx, raw, &list.value, frames) && !even(&seen, frames) {
        let message = format!("the windows of `{name}` come at uneven intervals");
        let mend = format!(
            "choose minor frames that lie equally far apart, also across the end of the major frame: {}",
            periods(minor_ns, frames)
        );
        cx.note(&catalogue::UNEVEN_MINOR, &list.span, message, mend);
    }
}

/// Notes the minor frames that do not exist, and says whether there are any.
fn minor_beyond(cx: &Context<'_>, schedule: &RawSchedule, list: &[At<u32>], frames: u64) -> bool {
    let mut any = false;
    for index in list.iter().filter(|index| u64::from(index.value) >= frames) {
        any = true;
        let message = format!("there is no minor frame {}: the major frame has {frames}", index.value);
        let mend = format!("they are counted from 0: the last is {}", frames - 1);
        let finding = Finding::new(&catalogue::MINOR_OUT_OF_RANGE, &index.span, message, mend);
        cx.add(match schedule.major_frame.said() {
            Some(major) => finding.also(&major.span, "the major frame"),
            None => finding,
        });
    }
    any
}

/// The periods that windows can have in a major frame of `frames` minor frames.
fn periods(minor_ns: u64, frames: u64) -> String {
    let every = (1..=frames).filter(|every| frames.is_multiple_of(*every));
    let shown: Vec<String> = every.map(|every| ShowTime(every * minor_ns).to_string()).collect();
    format!("with {frames} minor frames of {} a period may be {}", ShowTime(minor_ns), shown.join(", "))
}

/// Whether minor frames lie equally far apart in a cycle of `frames`.
fn even(indices: &BTreeMap<u32, &Span>, frames: u64) -> bool {
    let starts: Vec<u64> = indices.keys().map(|&index| u64::from(index)).collect();
    let gaps: BTreeSet<u64> = gaps(&starts, frames).collect();
    gaps.len() <= 1
}

fn core(cx: &Context<'_>, window: &RawWindow, owner: PartitionId) {
    let (Some(core), Some(module)) = (window.core.said(), cx.module_of(owner)) else { return };
    let module = &cx.file.modules[module.0];
    let Some(cores) = module.cores.said() else { return };
    if cores.value.iter().any(|known| known.value == core.value) {
        return;
    }
    let module = &module.name.value;
    let message = format!(
        "core {} is not partitioned by module `{module}`, where `{}` runs",
        core.value,
        whose(window)
    );
    let mend = format!("choose one of its cores, or add {} to them", core.value);
    let finding = Finding::new(&catalogue::CORE_NOT_IN_MODULE, &core.span, message, mend);
    cx.add(finding.also(&cores.span, format!("the cores of `{module}`")));
}

fn overlaps(cx: &Context<'_>, pair: (&RawSchedule, &Schedule), laid: &[TimelineWindow]) {
    let core = |window: &TimelineWindow| core_of(cx, pair.1, window);
    for (a, b) in collisions(laid, |a, b| core(a) == core(b)) {
        let (module, core) = core(&b);
        let place = format!("core {core} of `{}`", cx.module_name(module));
        collision(cx, &catalogue::WINDOW_OVERLAP, pair, (a, b), &place);
    }
}

fn two_cores(cx: &Context<'_>, pair: (&RawSchedule, &Schedule), laid: &[TimelineWindow]) {
    let core = |window: &TimelineWindow| core_of(cx, pair.1, window).1;
    for (a, b) in collisions(laid, |a, b| a.partition == b.partition) {
        if core(&a) != core(&b) {
            let place = format!("cores {} and {}", core(&a), core(&b));
            collision(cx, &catalogue::TWO_CORES_AT_ONCE, pair, (a, b), &place);
        }
    }
}

/// Windows that collide with one before them, each declared pair once. They come sorted by what `rivals` compares, then by start.
fn collisions(
    laid: &[TimelineWindow],
    rivals: impl Fn(&TimelineWindow, &TimelineWindow) -> bool,
) -> Vec<(TimelineWindow, TimelineWindow)> {
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for (place, a) in laid.iter().enumerate() {
        let later = laid[place + 1..].iter().take_while(|b| rivals(a, b) && b.start_ns < a.end_ns);
        for b in later {
            if seen.insert((a.declared.min(b.declared), a.declared.max(b.declared))) {
                found.push((*a, *b));
            }
        }
    }
    found
}

fn collision(
    cx: &Context<'_>,
    rule: &'static Rule,
    (raw, schedule): (&RawSchedule, &Schedule),
    (a, b): (TimelineWindow, TimelineWindow),
    place: &str,
) {
    let (first, second) = (&raw.windows[a.declared], &raw.windows[b.declared]);
    let (Some(here), Some(there)) = (second.offset.said(), first.offset.said()) else { return };
    let (from, to) = (ShowTime(b.start_ns), ShowTime(a.end_ns.min(b.end_ns)));
    let (one, other) = (cx.partition_name(a.partition), cx.partition_name(b.partition));
    let message = if rule.id == catalogue::WINDOW_OVERLAP.id {
        format!("windows of `{one}` and `{other}` overlap on {place} from {from} to {to}")
    } else {
        format!("`{other}` has windows on {place} at once from {from} to {to}")
    };
    let mend =
        format!("let it start at {} of the minor frame or later, or shorten the other window", ends(first));
    let (_, core) = core_of(cx, schedule, &a);
    let label = format!("`{one}` has core {core} from {} to {}", ShowTime(a.start_ns), ShowTime(a.end_ns));
    cx.add(Finding::new(rule, &here.span, message, mend).also(&there.span, label));
}

/// The end of a window in its minor frame.
fn ends(window: &RawWindow) -> ShowTime {
    ShowTime(window.offset.ns(0).saturating_add(window.duration.ns(0)))
}

fn fill(cx: &Context<'_>, (raw, schedule): (&RawSchedule, &Schedule), laid: &[TimelineWindow]) {
    let mut used: BTreeMap<(ModuleId, u32), u64> = BTreeMap::new();
    for window in laid {
        *used.entry(core_of(cx, schedule, window)).or_default() += window.duration_ns();
    }
    let major_ns = schedule.major_frame_ns;
    for ((module, core), used) in used {
        let percent = u128::from(used) * 100 / u128::from(major_ns);
        if u128::from(used) * 100 <= u128::from(major_ns) * u128::from(FULLEST_PERCENT) {
            continue;
        }
        let (module, name) = (cx.module_name(module), &raw.name);
        let message =
            format!("windows take {percent} % of core {core} of `{module}` in schedule `{}`", name.value);
        let mend = format!("shorten some to {FULLEST_PERCENT} % in all, or move some to another core");
        cx.note(&catalogue::CORE_TOO_FULL, &name.span, message, mend);
    }
}
