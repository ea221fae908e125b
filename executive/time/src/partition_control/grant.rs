//! What a partition is told with a window, and what it made of it.

use bateleur_contract::page::WindowGrant;

use crate::dispatcher::Occurrence;

/// What the partition made of its window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Use {
    /// When it took the window, CLOCK_MONOTONIC ns; `None`: not at all.
    pub opened_ns: Option<u64>,
    /// When it closed it; `None` if it had not when the window ended.
    pub closed_ns: Option<u64>,
}

/// What a partition is told with the window of `occurrence`. `next_schedule`: the schedule of the next major frame, as far as is known.
#[must_use]
pub fn grant_of(occurrence: &Occurrence, next_schedule: usize) -> WindowGrant {
    WindowGrant {
        start_ns: occurrence.start_ns,
        end_ns: occurrence.end_ns,
        minor_frames: occurrence.minor_frames,
        minor_frame_ns: occurrence.minor_frame_ns,
        major_frame: occurrence.major_frame,
        major_frame_ns: occurrence.major_frame_ns(),
        schedule: occurrence.epoch.schedule as u32,
        next_schedule: next_schedule as u32,
        // 0 until the module changes, also where it was reset and frame 0 was later than that.
        schedule_since_ns: occurrence.epoch.after.map_or(0, |_| occurrence.epoch.since_ns),
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::occurrence;
    use super::*;
    use crate::dispatcher::ScheduleEpoch;

    #[test]
    fn module_that_was_reset_has_not_changed_its_schedule_yet() {
        let epoch = |after| ScheduleEpoch { number: 0, schedule: 0, after, since_ns: 5_000_000_000 };
        let since_ns = |after| grant_of(&occurrence(epoch(after)), 0).schedule_since_ns;
        assert_eq!(since_ns(None), 0, "frame 0 is no change of schedule");
        assert_eq!(since_ns(Some(1)), 5_000_000_000);
    }
}
