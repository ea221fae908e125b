//! What a change of schedule leaves to be done with the partition: found by a dispatcher, done by the monitor.

use std::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};

use super::{PartitionControl, Readiness};
use bateleur_plan::ChangeAction;

/// What a change of schedule can owe a partition.
const OWED: [ChangeAction; 3] = [ChangeAction::ColdRestart, ChangeAction::WarmRestart, ChangeAction::Idle];

impl PartitionControl {
    /// Whether this is the partition's first window in the epoch of that number.
    pub fn enters_epoch(&self, number: u32) -> bool {
        // A dispatcher that comes late, from before another one's change, turns nothing back.
        self.epoch.load(Relaxed) < number && self.epoch.fetch_max(number, Relaxed) < number
    }

    /// Whether the process has started from nothing and had no window yet.
    pub fn is_fresh(&self) -> bool {
        self.fresh.load(Relaxed)
    }

    /// Keeps the partition's windows back until the monitor has done what a change of schedule means for it, also one that is being
    /// restarted; false: it was stopped or is held, whatever the schedule says. `revive`: also one that a change has made idle.
    pub fn withhold(&self, revive: bool) -> bool {
        let from = |readiness: Readiness| {
            let (from, to) = (readiness as u32, Readiness::Absent as u32);
            self.readiness.compare_exchange(from, to, SeqCst, Relaxed).is_ok()
        };
        from(Readiness::Ready) || from(Readiness::Absent) || (revive && from(Readiness::Idle))
    }

    /// Leaves to the monitor what a change to `schedule` means for the partition: not in the window's record alone, for
    /// which there may be no room.
    pub fn set_pending_action(&self, action: ChangeAction, schedule: usize) {
        let place = OWED.iter().position(|owed| *owed == action).map_or(0, |place| place + 1);
        self.owed.store((schedule as u32) << 2 | place as u32, Release);
    }

    /// Whether something is owed.
    pub(super) fn owes(&self) -> bool {
        self.owed.load(Acquire) != 0
    }

    /// Takes what is owed.
    pub fn take_owed(&self) -> Option<(ChangeAction, usize)> {
        if self.owed.load(Relaxed) == 0 {
            return None;
        }
        let owed = self.owed.swap(0, Acquire);
        let place = (owed & 3).checked_sub(1)? as usize;
        Some((OWED[place], (owed >> 2) as usize))
    }

    /// The schedule that the partition has asked for since the last look, whether it may or not.
    pub fn take_schedule_request(&self) -> Option<u32> {
        let (number, schedule) = self.page.schedule_requested();
        let seen = self.schedule_requests.load(Relaxed);
        (number != seen).then(|| {
            self.schedule_requests.store(number, Relaxed);
            schedule
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::control;
    use super::*;

    #[test]
    fn what_a_change_of_schedule_owes_is_taken_once_and_whole() {
        let control = control();
        assert_eq!(control.take_owed(), None);
        for action in OWED {
            control.set_pending_action(action, 65_535);
            assert_eq!((control.take_owed(), control.take_owed()), (Some((action, 65_535)), None));
        }
    }

    #[test]
    fn a_dispatcher_from_before_a_change_turns_it_not_back() {
        let control = control();
        assert!(control.enters_epoch(2));
        assert!(!control.enters_epoch(1) && !control.enters_epoch(2) && control.enters_epoch(3));
    }

    #[test]
    fn change_of_schedule_revives_what_a_change_made_idle_and_nothing_that_was_stopped() {
        let control = control();
        control.set_readiness(Readiness::Stopped);
        assert!(!control.withhold(true));
        assert_eq!(control.readiness(), Readiness::Stopped);
        control.set_readiness(Readiness::Idle);
        assert!(!control.withhold(false) && control.withhold(true));
        assert_eq!(control.readiness(), Readiness::Absent);
        assert!(control.withhold(false), "one that is being restarted is not left out");
    }
}
