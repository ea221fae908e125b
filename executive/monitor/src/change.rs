//! Changes of schedule: asked for, told, and what becomes of the partitions.
//!
//! The dispatcher finds a partition's first window in a new schedule, and keeps that window back where the plan wants
//! something done; here it is done. It is no health error and uses up no budget.

use bateleur_contract::StartCondition;

use super::watched::{Life, Until};
use super::{Monitor, seconds};
use crate::event::Event;
use bateleur_plan::{ChangeAction, Closed};
use bateleur_time::partition_control::Readiness;
use bateleur_time::schedule_switch::Requested;

/// A schedule that the plan does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the plan has no schedule \"{name}\"; it has {known}")]
pub struct UnknownSchedule {
    /// What was asked for.
    pub name: String,
    /// What there is.
    pub known: String,
}

impl Monitor {
    /// Asks for the schedule of that name, from the next major frame on. The last request wins.
    ///
    /// # Errors
    /// The plan has no such schedule.
    pub fn request_schedule(&mut self, name: &str, module_ns: u64) -> Result<Requested, UnknownSchedule> {
        let Some(schedule) = self.plan.schedule(name) else {
            let known = self.plan.schedules.iter().map(|schedule| schedule.name.as_str());
            return Err(UnknownSchedule { name: name.into(), known: known.collect::<Vec<_>>().join(", ") });
        };
        let requested = self.schedule_switch.request(schedule.index());
        if requested == Requested::Pending {
            self.events.tell(&Event::ScheduleRequested {
                time_s: seconds(module_ns),
                schedule: name.into(),
                by: "operator".into(),
            });
        }
        Ok(requested)
    }

    /// Tells about a change of schedule that has taken effect.
    pub(super) fn tell_schedule(&mut self) {
        let current = self.schedule_switch.current();
        if current == self.told_schedule {
            return;
        }
        let before = std::mem::replace(&mut self.told_schedule, current);
        self.events.tell(&Event::ScheduleChanged {
            time_s: seconds(self.schedule_switch.changed_ns()),
            schedule: self.plan.schedules[current].name.clone(),
            before: self.plan.schedules[before].name.clone(),
        });
    }

    /// Does what the plan wants for the partition at `place`, which had its first window in `schedule` at `module_ns`.
    pub(super) fn change(&mut self, place: usize, action: ChangeAction, schedule: usize, module_ns: u64) {
        let watched = &mut self.watched[place];
        // Stopped since the dispatcher asked for it, by somebody whose word outlasts a schedule.
        let stopped = watched.sandbox.control.readiness() == Readiness::Stopped;
        // A process that is starting has no state to keep; what it starts from, and whether it shall run, is the schedule's to say.
        let restarts = action == ChangeAction::WarmRestart && matches!(watched.life, Life::Starting(..));
        if action == ChangeAction::Ignore || restarts || watched.held || stopped {
            return;
        }
        let text = format!("{} with schedule {}", action.name(), self.plan.schedules[schedule].name);
        let partition = watched.sandbox.name.clone();
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
        self.clean_up(place, super::watched::Then::Successor, module_ns);
    }

    /// A partition has asked for a schedule.
    pub(super) fn note_request(&mut self, place: usize, schedule: usize, module_ns: u64) {
        self.events.tell(&Event::ScheduleRequested {
            time_s: seconds(module_ns),
            schedule: self.plan.schedules[schedule].name.clone(),
            by: self.watched[place].sandbox.name.clone(),
        });
    }
}
