//! What becomes of partitions when the module changes to another schedule.
//!
//! The dispatcher finds a partition's first window in a new schedule, and keeps that window back where the plan wants
//! something done; here it is done. It is no health error and uses up no budget.

use bateleur_contract::StartCondition;

use super::watched::{Life, Until};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::plan::{ChangeAction, Closed};
use crate::slot::Readiness;

impl Monitor {
    /// Does what the plan wants for the partition at `place`, which had its first window in `schedule` at `module_ns`.
    pub(super) fn change(&mut self, place: usize, action: ChangeAction, schedule: usize, module_ns: u64) {
        let watched = &mut self.watched[place];
        // Stopped since the dispatcher asked for it, by somebody whose word outlasts a schedule.
        let stopped = watched.cage.slot.readiness() == Readiness::Stopped;
        if action == ChangeAction::Ignore
            || matches!(watched.life, Life::Starting(..))
            || watched.held
            || stopped
        {
            return;
        }
        let text = format!("{} with schedule {}", action.name(), self.plan.schedules[schedule].name);
        let partition = watched.cage.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
        self.watched[place].start_failed = false;
        if action == ChangeAction::Idle {
            return self.lay_to_rest(place, Until::Change, module_ns);
        }
        let watched = &mut self.watched[place];
        watched.put_an_end();
        watched.next_start = match action {
            ChangeAction::WarmRestart => StartCondition::HmPartitionWarmRestart,
            _ => StartCondition::HmPartitionColdRestart,
        };
        self.bury(place, super::watched::Then::Successor, module_ns);
    }

    /// A partition has asked for a schedule.
    pub(super) fn note_request(&mut self, place: usize, schedule: usize, module_ns: u64) {
        self.events.tell(&Event::ScheduleRequested {
            time_s: seconds(module_ns),
            schedule: self.plan.schedules[schedule].name.clone(),
            by: self.watched[place].cage.name.clone(),
        });
    }
}
