//! What a partition is told with a window, and what it made of it.

use crate::dispatcher::Occurrence;

/// What the partition made of its window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Use {
    /// When it took the window, CLOCK_MONOTONIC ns; none: not at all.
    pub opened_ns: Option<u64>,
    /// When it closed it; none: it had not when the window ended.
    pub closed_ns: Option<u64>,
}

/// What a partition is told with a window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Grant {
    /// Its start, module time, ns.
    pub start_ns: u64,
    /// Its end, module time, ns; 0: no window, but the last call before frame 0.
    pub end_ns: u64,
    /// Minor frames since module time 0.
    pub minor_frames: u64,
    /// The length of a minor frame, ns.
    pub minor_frame_ns: u64,
    /// Major frames since frame 0.
    pub major_frame: u64,
    /// When its major frame began, module time, ns.
    pub major_frame_ns: u64,
    /// The number of its schedule.
    pub schedule: usize,
    /// When that took effect, module time, ns.
    pub since_ns: u64,
    /// The number of the schedule of the next major frame, as far as is known.
    pub next_schedule: usize,
}

impl Grant {
    /// The grant of a window. `next_schedule`: the schedule of the next major frame, as far as is known.
    #[must_use]
    pub fn of(occurrence: &Occurrence, next_schedule: usize) -> Self {
        Self {
            start_ns: occurrence.start_ns,
            end_ns: occurrence.end_ns,
            minor_frames: occurrence.minor_frames,
            minor_frame_ns: occurrence.minor_frame_ns,
            major_frame: occurrence.major_frame,
            major_frame_ns: occurrence.major_frame_ns(),
            schedule: occurrence.reign.schedule,
            // 0 until the module changes, also where it was reset and frame 0 was later than that.
            since_ns: occurrence.reign.after.map_or(0, |_| occurrence.reign.since_ns),
            next_schedule,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn module_that_was_reset_has_not_changed_its_schedule_yet() {
        let text = "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";
        let plan = crate::test_support::plan_of(text);
        let timelines = crate::plan::Timeline::all(&plan, plan.module("m").unwrap().id());
        let reign =
            |after| crate::dispatcher::Reign { number: 0, schedule: 0, after, since_ns: 5_000_000_000 };
        let occurrence = |after| Occurrence {
            window: timelines[0].cores[0].windows[0],
            core: 0,
            reign: reign(after),
            major_frame: 0,
            minor_frames: 0,
            minor_frame_ns: 20_000_000,
            start_ns: 5_000_000_000,
            end_ns: 5_002_000_000,
            late_ns: 0,
        };
        assert_eq!(Grant::of(&occurrence(None), 0).since_ns, 0, "frame 0 is no change of schedule");
        assert_eq!(Grant::of(&occurrence(Some(1)), 0).since_ns, 5_000_000_000);
    }
}
