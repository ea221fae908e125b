//! What is done about a fault of a partition: decided by the tables, told, carried out.
//!
//! Whatever found it (a death, a report, a window), it goes through here. It must never decide by anything but the plan and what the
//! partition is at.

use bateleur_contract::{ErrorCode, Mode, StartCondition};

use super::standby::TAKEOVER;
use super::watched::{Then, Until};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::health::decision::{Decision, Situation, decide, decide_restart};
use crate::health::log::Fault;
use crate::health::record::Level;
use bateleur_plan::{Closed, ModuleAction, ModuleError, PartitionError, PartitionState};

/// What the log calls a restart that a partition asked for; no error of a table.
const OWN_REQUEST: &str = "own_request";

impl Monitor {
    pub(super) fn fault(&mut self, place: usize, error: PartitionError, detail: String, module_ns: u64) {
        self.fault_in(place, error, None, detail, module_ns);
    }

    /// `state`: what the partition was at; `None`: what it is at now.
    pub(super) fn fault_in(
        &mut self,
        place: usize,
        error: PartitionError,
        state: Option<PartitionState>,
        detail: String,
        module_ns: u64,
    ) {
        let recent = self.recent_restarts(place, module_ns);
        let watched = &self.watched[place];
        let partition = &self.plan[watched.sandbox.id];
        let situation = Situation {
            state: state
                .filter(|_| partition.error_handler)
                .unwrap_or_else(|| watched.state(partition.error_handler)),
            // A process that does not become ready can be ignored as little as one that is gone: nothing would end the
            // wait.
            alive: watched.is_alive() && error != PartitionError::StartupTimeout,
            handler: partition.error_handler,
            recent,
        };
        let levels = &self.plan.health.levels;
        let decision = decide(error, levels, &partition.health, &partition.restart, &situation);
        if self.goes_on_after(error, decision)
            && !self.watched[place].repeats.is_told(error, decision, &detail, module_ns)
        {
            // Its handler is told of each.
            return self.tell_handler(place, decision, error, &detail);
        }
        self.decided(place, error.name(), decision, detail, situation.alive, module_ns);
    }

    /// Whether this may come again and again, because nothing is done that ends it.
    fn goes_on_after(&self, error: PartitionError, decision: Decision) -> bool {
        let ignored = || self.plan.health.module.action(ModuleError::PartitionError) == ModuleAction::Ignore;
        use PartitionError::{ApplicationError, DeadlineMissed, PortError, WindowOverrun};
        matches!(error, ApplicationError | PortError | WindowOverrun | DeadlineMissed)
            && match decision {
                Decision::Ignore | Decision::Handler => true,
                Decision::Module => ignored(),
                Decision::Idle | Decision::Stop | Decision::Restart { .. } => false,
            }
    }

    fn tell_handler(&self, place: usize, decision: Decision, error: PartitionError, detail: &str) {
        if decision == Decision::Handler
            && let Some(code) = handler_code(error)
        {
            self.watched[place].sandbox.control.page.raise(code, detail);
        }
    }

    /// A partition has ended itself to be started again or to be idle (SET_PARTITION_MODE). Its budget counts the starts.
    pub(super) fn do_as_asked(&mut self, place: usize, mode: Mode, module_ns: u64) {
        let recent = self.recent_restarts(place, module_ns);
        let restart = &self.plan[self.watched[place].sandbox.id].restart;
        let decision = match mode {
            Mode::Idle => Decision::Idle,
            mode => decide_restart(restart, mode == Mode::WarmStart, recent),
        };
        self.decided(place, OWN_REQUEST, decision, "its error handler asked for it".into(), false, module_ns);
    }

    pub(super) fn recent_restarts(&mut self, place: usize, module_ns: u64) -> u32 {
        let watched = &mut self.watched[place];
        let within_ns = self.plan[watched.sandbox.id].restart.within_ns;
        watched.restarts.retain(|at| module_ns.saturating_sub(*at) < within_ns);
        watched.restarts.len() as u32
    }

    /// Notes, tells and does what was decided.
    pub(super) fn decided(
        &mut self,
        place: usize,
        error: &str,
        decision: Decision,
        detail: String,
        alive: bool,
        module_ns: u64,
    ) {
        if matches!(decision, Decision::Idle | Decision::Stop | Decision::Restart { .. }) {
            self.close_series(place, module_ns);
        }
        let mut fault = self.entry(place, error, decision, detail, module_ns);
        if matches!(decision, Decision::Restart { .. }) && self.can_take_over(place, module_ns) {
            fault.action = TAKEOVER.into();
        }
        self.tell_fault(place, &fault);
        self.act(place, decision, fault, alive, module_ns);
    }

    /// What the log says of an error of the partition at `place`.
    pub(super) fn entry(
        &self,
        place: usize,
        error: &str,
        decision: Decision,
        detail: String,
        module_ns: u64,
    ) -> Fault {
        let watched = &self.watched[place];
        let level = match decision {
            Decision::Handler => Level::Process,
            Decision::Module => Level::Module,
            _ => Level::Partition,
        };
        Fault {
            time_ns: module_ns,
            level,
            partition: Some(watched.sandbox.name.clone()),
            generation: watched.generation,
            error: error.into(),
            action: decision.name().into(),
            detail,
            recovered_ns: None,
        }
    }

    /// Makes known what has been decided about a fault of the partition at `place`.
    pub(super) fn tell_fault(&mut self, place: usize, fault: &Fault) {
        let watched = &mut self.watched[place];
        watched.figures.fault(fault);
        self.health_log.note(fault);
        self.events.tell(&Event::Fault {
            time_s: seconds(fault.time_ns),
            partition: watched.sandbox.name.clone(),
            error: fault.error.clone(),
            action: fault.action.clone(),
            detail: fault.detail.clone(),
        });
    }

    fn act(&mut self, place: usize, decision: Decision, fault: Fault, alive: bool, module_ns: u64) {
        match decision {
            Decision::Ignore => {
                self.health_log.write(&fault);
            }
            Decision::Handler => {
                self.health_log.write(&fault);
                if let Some(error) = PartitionError::from_name(&fault.error) {
                    self.tell_handler(place, decision, error, &fault.detail);
                }
            }
            Decision::Module => {
                if !alive {
                    // Whatever the module makes of it, nothing starts it again.
                    self.lay_to_rest(place, Until::Started, module_ns);
                }
                self.health_log.write(&fault);
                let name = &self.watched[place].sandbox.name;
                let detail = format!("{} of partition {name} ({})", fault.error, fault.detail);
                self.module_fault(ModuleError::PartitionError, &detail, true, module_ns);
            }
            Decision::Idle | Decision::Stop => {
                self.lay_to_rest(place, Until::Started, module_ns);
                self.health_log.write(&fault);
                if decision == Decision::Stop {
                    let partition = self.watched[place].sandbox.name.clone();
                    self.partition_stopped(&partition, &fault.error, module_ns);
                }
            }
            Decision::Restart { warm } => {
                let watched = &mut self.watched[place];
                watched.put_an_end();
                watched.next_start = match (warm, fault.error == OWN_REQUEST) {
                    (true, false) => StartCondition::HmPartitionWarmRestart,
                    (false, false) => StartCondition::HmPartitionColdRestart,
                    (true, true) => StartCondition::PartitionWarmRestart,
                    (false, true) => StartCondition::PartitionRestart,
                };
                watched.restarts.push(module_ns);
                // A second fault before the first window: the first is what the user waits to see the end of.
                if let Some(before) = watched.fault.replace(fault) {
                    self.health_log.write(&before);
                }
                if self.take_over(place, warm, module_ns) {
                    return;
                }
                if let Some(fault) = &mut self.watched[place].fault {
                    fault.action = decision.name().into();
                }
                self.clean_up(place, Then::Successor, module_ns);
            }
        }
    }
}

/// What a partition's handler is told that an error is; `None` if it is told of no such error.
fn handler_code(error: PartitionError) -> Option<ErrorCode> {
    match error {
        PartitionError::DeadlineMissed => Some(ErrorCode::DeadlineMissed),
        PartitionError::ApplicationError => Some(ErrorCode::ApplicationError),
        PartitionError::PortError => Some(ErrorCode::PortError),
        PartitionError::WindowOverrun => Some(ErrorCode::WindowOverrun),
        _ => None,
    }
}
