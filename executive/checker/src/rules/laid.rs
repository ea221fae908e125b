//! The windows of a raw schedule laid out over its major frame, as far as they make sense.

use std::collections::BTreeMap;

use super::Context;
use crate::processes::Windows;
use crate::raw::{RawSchedule, RawWindow};
use bateleur_plan::bounds::{MOST_MINOR_FRAMES, MOST_WINDOWS};

/// One occurrence of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Slot {
    pub(super) module: usize,
    pub(super) core: u32,
    pub(super) start: u64,
    pub(super) end: u64,
    pub(super) partition: usize,
    /// The place of the window in its schedule.
    pub(super) window: usize,
}

/// Every occurrence of every sound window, by module, core and start.
pub(super) struct Laid {
    /// Zero where the frames make no sense, or have too many windows; then there are no slots.
    pub(super) major: u64,
    pub(super) slots: Vec<Slot>,
}

impl Laid {
    pub(super) fn of(cx: &Context<'_>, schedule: &RawSchedule) -> Self {
        let Some((minor, frames)) = minor_frames(schedule) else {
            return Self { major: 0, slots: Vec::new() };
        };
        if most_windows(cx, schedule, frames).is_some_and(|(_, count)| count > MOST_WINDOWS) {
            // Reported by a rule of its own; to lay them out could take all memory there is.
            return Self { major: 0, slots: Vec::new() };
        }
        let windows = schedule.windows.iter().enumerate();
        let slots = windows.filter_map(|(place, window)| slots(cx, place, window, (minor, frames)));
        let mut slots: Vec<Slot> = slots.flatten().collect();
        slots.sort_by_key(|slot| (slot.module, slot.core, slot.start, slot.window));
        Self { major: minor * frames, slots }
    }

    /// The windows of a partition in the major frame.
    pub(super) fn windows(&self, partition: usize) -> Vec<(u64, u64)> {
        let mine = self.slots.iter().filter(|slot| slot.partition == partition);
        mine.map(|slot| (slot.start, slot.end)).collect()
    }

    /// The same, by rising start, with the major frame.
    pub(super) fn all_windows(&self, partition: usize) -> Windows {
        let mut windows = self.windows(partition);
        windows.sort_unstable();
        Windows { windows, major_ns: self.major }
    }

    /// When the windows of a partition start in the major frame, rising.
    pub(super) fn starts(&self, partition: usize) -> Vec<u64> {
        let mine = self.slots.iter().filter(|slot| slot.partition == partition);
        let mut starts: Vec<u64> = mine.map(|slot| slot.start).collect();
        starts.sort_unstable();
        starts
    }
}

/// The minor frame and how many of it make the major frame; nothing where another rule objects.
pub(super) fn minor_frames(schedule: &RawSchedule) -> Option<(u64, u64)> {
    let (major, minor) = (schedule.major_frame.get()?.0, schedule.minor_frame.get()?.0);
    let whole = minor > 0 && major > 0 && major % minor == 0 && major / minor <= MOST_MINOR_FRAMES;
    whole.then(|| (minor, major / minor))
}

/// The core with the most windows in a major frame of so many minor `frames`, and how many: counted without laying them out.
pub(super) fn most_windows(
    cx: &Context<'_>,
    schedule: &RawSchedule,
    frames: u64,
) -> Option<((usize, u32), u64)> {
    let mut counts: BTreeMap<(usize, u32), u64> = BTreeMap::new();
    for window in &schedule.windows {
        let place = || {
            let module = cx.names.module_of(cx.file, cx.names.owner(window)?)?;
            Some((module, cx.names.core(cx.file, window)?))
        };
        let Some(place) = place() else { continue };
        let count = match window.minor.said() {
            Some(minor) => frames.min(minor.value.len() as u64),
            None => frames,
        };
        *counts.entry(place).or_default() += count;
    }
    // The first of equals.
    counts.into_iter().rev().max_by_key(|&(_, count)| count)
}

/// The occurrences of one window; nothing if it lacks a value or has no length.
fn slots(
    cx: &Context<'_>,
    place: usize,
    window: &RawWindow,
    (minor, frames): (u64, u64),
) -> Option<Vec<Slot>> {
    let partition = cx.names.owner(window)?;
    let module = cx.names.module_of(cx.file, partition)?;
    let core = cx.names.core(cx.file, window)?;
    let offset = window.offset.get()?.0;
    // What reaches past the minor frame is reported as that, not as an overlap with the next frame.
    let end = offset.saturating_add(window.duration.get()?.0).min(minor);
    if offset >= end {
        return None;
    }
    let slot = |index: u64| Slot {
        module,
        core,
        start: index * minor + offset,
        end: index * minor + end,
        partition,
        window: place,
    };
    Some(indices(window, frames)?.into_iter().map(slot).collect())
}

/// The minor frames that have the window, each once, without those that do not exist.
fn indices(window: &RawWindow, frames: u64) -> Option<Vec<u64>> {
    if window.minor.is_absent() {
        return Some((0..frames).collect());
    }
    let said = window.minor.said()?.value.iter().map(|index| u64::from(index.value));
    let mut indices: Vec<u64> = said.filter(|&index| index < frames).collect();
    indices.sort_unstable();
    indices.dedup();
    Some(indices)
}
