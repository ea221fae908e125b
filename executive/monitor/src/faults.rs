//! Errors of partitions: what they mean is said by the health tables, and what follows by the life cycle; here they are noted and told.

use crate::event::Event as Told;
use crate::health::decision::{Decision, Situation, decide, handler_code};
use crate::health::log::Fault;
use crate::lifecycle::{Cause, Event, PairMember};
use crate::module_level::seconds;
use crate::monitor::Monitor;
use crate::repeats::{Repeats, Untold, goes_on_after};
use bateleur_plan::{Closed, ModuleAction, ModuleError, PartitionError, PartitionState};

/// What the log calls a restart that a partition asked for; no error of a table.
pub(crate) const OWN_REQUEST: &str = "own_request";
/// What it says was done where a standby has taken over.
const TAKEOVER: &str = "takeover";

impl Monitor {
    pub(crate) fn fault(&mut self, place: usize, error: PartitionError, detail: String, module_ns: u64) {
        self.fault_in(place, error, None, detail, module_ns);
    }

    /// `state`: what the partition was at; `None`: what it is at now.
    pub(crate) fn fault_in(
        &mut self,
        place: usize,
        error: PartitionError,
        state: Option<PartitionState>,
        detail: String,
        module_ns: u64,
    ) {
        let partition = &mut self.partitions[place];
        let plan = &self.plan[partition.active.sandbox.id];
        let handler = plan.error_handler;
        let in_handler = handler && partition.is_in_handler();
        let situation = Situation {
            state: state.filter(|_| handler).unwrap_or_else(|| partition.life.state(in_handler)),
            // A process that does not become ready can be ignored as little as one that is gone: nothing would end the
            // wait.
            alive: partition.life.has_process() && error != PartitionError::StartupTimeout,
            handler,
            recent: partition.life.recent_restarts(module_ns),
        };
        let health = &self.plan.health;
        let decision = decide(error, &health.levels, &plan.health, &plan.restart, &situation);
        self.tell_handler(place, decision, error, &detail);
        if !situation.alive || matches!(decision, Decision::Restart { .. } | Decision::Idle | Decision::Stop)
        {
            // Before the successor has that memory anew.
            self.collect_crash(place, PairMember::Active, (error, &detail), module_ns);
        }
        let partition = &mut self.partitions[place];
        let module_ignores =
            self.plan.health.module.action(ModuleError::PartitionError) == ModuleAction::Ignore;
        if goes_on_after(error, decision, module_ignores)
            && !partition.repeats.is_told(error, decision, &detail, module_ns)
        {
            return;
        }
        self.decided(place, error.name(), (decision, Cause::Health), detail, situation.alive, module_ns);
    }

    /// An error that somebody else deals with, as `decision` says: it is noted.
    pub(crate) fn note(
        &mut self,
        place: usize,
        (error, decision): (PartitionError, Decision),
        detail: String,
        module_ns: u64,
    ) {
        let partition = &mut self.partitions[place];
        if partition.repeats.is_told(error, decision, &detail, module_ns) {
            self.decided(place, error.name(), (decision, Cause::Health), detail, true, module_ns);
        }
    }

    /// Its handler is told of each error that is its own.
    fn tell_handler(&self, place: usize, decision: Decision, error: PartitionError, detail: &str) {
        if decision == Decision::Handler
            && let Some(code) = handler_code(error)
        {
            self.partitions[place].active.sandbox.control.page.raise(code, detail);
        }
    }

    /// Notes, tells and does what was decided. `survives`: its process can go on.
    pub(crate) fn decided(
        &mut self,
        place: usize,
        error: &str,
        (decision, cause): (Decision, Cause),
        detail: String,
        survives: bool,
        module_ns: u64,
    ) {
        if matches!(decision, Decision::Idle | Decision::Stop | Decision::Restart { .. }) {
            self.close_series(place, module_ns);
        }
        let mut fault = self.partitions[place].entry(error, decision, detail, module_ns);
        if matches!(decision, Decision::Restart { .. }) && self.partitions[place].can_take_over(module_ns) {
            fault.action = TAKEOVER.into();
        }
        self.tell_fault(place, &fault);
        let event = Event::Decided { decision, survives, cause };
        if matches!(decision, Decision::Restart { .. }) {
            // A second fault before the first window: the first is what the user waits to see the end of.
            self.open_fault(place, fault);
            return self.feed(place, event, module_ns);
        }
        if decision == Decision::Module && !survives {
            self.close_series(place, module_ns);
        }
        self.feed(place, event, module_ns);
        self.kept.health_log.write(&fault);
        let name = self.partitions[place].name();
        match decision {
            Decision::Module => {
                let detail = format!("{} of partition {name} ({})", fault.error, fault.detail);
                self.module_fault(ModuleError::PartitionError, &detail, true, module_ns);
            }
            Decision::Stop => {
                let detail = format!("partition {name} is stopped ({})", fault.error);
                self.module_fault(ModuleError::PartitionStopped, &detail, true, module_ns);
            }
            _ => {}
        }
    }

    /// A fault is written when its successor has had a window, or another one follows it.
    pub(crate) fn open_fault(&mut self, place: usize, fault: Fault) {
        if let Some(before) = self.partitions[place].fault.replace(fault) {
            self.kept.health_log.write(&before);
        }
    }

    /// Makes known what has been decided about a fault of the partition at `place`.
    pub(crate) fn tell_fault(&mut self, place: usize, fault: &Fault) {
        let partition = &mut self.partitions[place];
        partition.figures.fault(fault);
        self.kept.health_log.note(fault);
        self.kept.events.tell(&Told::Fault {
            time_s: seconds(fault.time_ns),
            partition: partition.name().to_owned(),
            error: fault.error.clone(),
            action: fault.action.clone(),
            detail: fault.detail.clone(),
        });
    }

    /// Makes an entry of the errors that had none of their own, where it is time to, or where `all` says so.
    pub(crate) fn tell_repeats(&mut self, place: usize, module_ns: u64, all: bool) {
        while let Some(untold) = self.partitions[place].repeats.take_untold(module_ns, all) {
            let Untold { error, decision, detail } = untold;
            let fault = self.partitions[place].entry(error.name(), decision, detail, module_ns);
            self.tell_fault(place, &fault);
            self.kept.health_log.write(&fault);
        }
        let partition = &mut self.partitions[place];
        if all && let more @ 1.. = partition.messages.take_unrecorded() {
            let text = format!("{more} more are not recorded");
            let generation = partition.life.generation();
            self.kept.health_log.note_message(partition.name(), generation, text, module_ns);
        }
    }

    /// What an incarnation said again and again is told as its own, before its successor begins.
    pub(crate) fn close_series(&mut self, place: usize, module_ns: u64) {
        self.tell_repeats(place, module_ns, true);
        self.partitions[place].repeats = Repeats::default();
    }
}
