//! Changes of schedule as the gates see them: what a partition's first window in a new schedule means for it, and which
//! partition may ask for another schedule. Computed before frame 0; on the time-critical path it is only looked up.

use std::sync::Arc;

use crate::dispatcher::Occurrence;
use crate::partition_control::{PartitionControl, Readiness};
use crate::schedule_switch::{Requested, ScheduleSwitch};
use bateleur_plan::{ChangeAction, Plan};

/// See the module's head.
#[derive(Debug)]
pub struct Changes {
    schedule_switch: Arc<ScheduleSwitch>,
    schedules: usize,
    partitions: usize,
    /// By schedule before, schedule after, partition.
    actions: Vec<ChangeAction>,
    /// By schedule, partition.
    may_ask: Vec<bool>,
}

impl Changes {
    /// What the plan says.
    #[must_use]
    pub fn of(plan: &Plan, schedule_switch: Arc<ScheduleSwitch>) -> Self {
        let mut actions = Vec::new();
        let mut may_ask = Vec::new();
        for before in plan.schedule_ids() {
            for after in plan.schedule_ids() {
                actions.extend(plan.partition_ids().map(|id| plan.change_action(before, after, id)));
            }
            may_ask.extend(plan.partition_ids().map(|id| plan[id].may_set_schedule.contains(&before)));
        }
        Self {
            schedule_switch,
            schedules: plan.schedules.len(),
            partitions: plan.partitions.len(),
            actions,
            may_ask,
        }
    }

    /// The schedule of the next major frame, as far as is known now.
    #[must_use]
    pub fn next(&self) -> usize {
        self.schedule_switch.next()
    }

    /// What has to be done with the partition of a window before it may have one in this schedule. `None`: nothing, it
    /// may have this very window. Where there is something, the partition gets no window any more until it is done.
    pub fn action_due(&self, occurrence: &Occurrence, control: &PartitionControl) -> Option<ChangeAction> {
        // What an operator holds has its action with its first window afterwards.
        let is_held = || control.readiness() == Readiness::Held;
        if is_held() || !control.enters_epoch(occurrence.epoch.number) {
            return None;
        }
        let (before, after) = (occurrence.epoch.after?, occurrence.epoch.schedule);
        let partition = occurrence.window.partition.index();
        let action = self.actions[(before * self.schedules + after) * self.partitions + partition];
        let nothing = match action {
            ChangeAction::Ignore => true,
            // It has just started from nothing: doing it again would only cost windows.
            ChangeAction::ColdRestart => control.is_fresh(),
            ChangeAction::Idle | ChangeAction::WarmRestart => false,
        };
        // An operator may have held it since: then its action is kept until it is released.
        let due = !nothing && (control.withhold(action != ChangeAction::Idle) || is_held());
        due.then(|| control.set_pending_action(action, after));
        due.then_some(action)
    }

    /// Takes the request for another schedule that the partition of a window has left in its page, where it may ask.
    pub fn take_request(&self, occurrence: &Occurrence, control: &PartitionControl) -> Option<usize> {
        let wanted = control.take_schedule_request()? as usize;
        let at = occurrence.epoch.schedule * self.partitions + occurrence.window.partition.index();
        let legal = self.may_ask[at] && wanted < self.schedules;
        (legal && self.schedule_switch.request(wanted) == Requested::Pending).then_some(wanted)
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::dispatcher::ScheduleEpoch;
    use crate::partition_control::fixture::{control, occurrence, plan};

    fn restarting() -> Changes {
        Changes {
            schedules: 2,
            actions: vec![ChangeAction::WarmRestart; 4],
            ..Changes::of(&plan(), Arc::new(ScheduleSwitch::new(0)))
        }
    }

    fn after(number: u32) -> Occurrence {
        occurrence(ScheduleEpoch { number, schedule: 1, after: Some(0), since_ns: 0 })
    }

    #[test]
    fn partition_that_is_held_over_a_change_of_schedule_has_its_action_when_it_is_released() {
        let (changes, control) = (restarting(), control());
        control.set_readiness(Readiness::Ready);
        assert_eq!(changes.action_due(&after(1), &control), Some(ChangeAction::WarmRestart));
        for held in 2..5 {
            assert!(control.take_owed().is_some(), "the monitor has done it");
            control.set_readiness(Readiness::Ready);
            control.hold();
            assert_eq!(changes.action_due(&after(held), &control), None);
            control.release();
            assert_eq!(changes.action_due(&after(held), &control), Some(ChangeAction::WarmRestart));
            control.set_readiness(Readiness::Ready);
            assert_eq!(changes.action_due(&after(held), &control), None, "once");
        }
    }

    /// As when the operator's order comes between the partition's first window in the new schedule and the monitor's next step, or while
    /// the partition has no process.
    #[test]
    fn partition_that_is_held_before_its_action_is_done_has_no_window_before_that_when_it_is_released() {
        let (changes, first) = (restarting(), control());
        let standby = control().beside(&first);
        for (number, holder, releaser) in [(1, &first, &first), (2, &first, &standby)] {
            holder.set_readiness(Readiness::Ready);
            assert_eq!(changes.action_due(&after(number), holder), Some(ChangeAction::WarmRestart));
            releaser.hold(); // also one that has taken over meanwhile
            releaser.release();
            assert_eq!(releaser.readiness(), Readiness::Absent);
            assert_eq!(releaser.take_owed(), Some((ChangeAction::WarmRestart, 1)));
            releaser.hold();
            releaser.release();
            assert_eq!(releaser.readiness(), Readiness::Ready);
        }
    }
}
