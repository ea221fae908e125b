//! The module level of health monitoring: errors of the module itself, and what goes on over a reset.
//!
//! Here it is only decided and noted that the module ends or starts again; whoever conducts it does so. It must never hold
//! up anybody: an error that comes again and again is told once a second, and counted always.

use super::{Monitor, Totals, seconds};
use crate::event::{Event, Events};
use crate::health::decision::decide_module;
use crate::health::log::{Fault, HealthLog, WindowLog};
use crate::health::record::Level;
use bateleur_plan::{Closed, ModuleAction, ModuleError};
use bateleur_time::window_record::{Missed, WindowRecord};

/// Between two health entries about a late dispatcher, module time: each switch is counted, not each is told.
const LATE_SILENCE_NS: u64 = 1_000_000_000;

/// What outlives a reset of the module: who watches, the logs, the counts and the budget.
pub struct Kept {
    /// The window log.
    pub window_log: WindowLog,
    /// The health log.
    pub health_log: HealthLog,
    /// Who watches.
    pub events: Events,
    pub(super) totals: Totals,
    pub(super) module: ModuleLevel,
}

impl Kept {
    /// Of a module that has not started yet.
    #[must_use]
    pub fn new(window_log: WindowLog, health_log: HealthLog, events: Events) -> Self {
        Self { window_log, health_log, events, totals: Totals::default(), module: ModuleLevel::default() }
    }

    /// Resets so far.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.module.resets
    }

    /// Totals over all starts.
    #[must_use]
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// Records that logs lost because they could not be written.
    #[must_use]
    pub fn unwritten(&self) -> u64 {
        self.health_log.lost() + self.window_log.lost()
    }
}

/// What is remembered of the module's own errors.
#[derive(Debug, Default)]
pub(super) struct ModuleLevel {
    /// Resets so far.
    resets: u32,
    /// Module time of those within the budget's time.
    recent: Vec<u64>,
    /// The error that is being mended by a reset.
    fault: Option<Fault>,
    late_told_ns: Option<u64>,
}

/// Why the module shall stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stop {
    /// In words.
    pub reason: String,
    /// It shall start again.
    pub reset: bool,
}

impl Monitor {
    /// An error of the module: decided, noted, told. `can_go_on`: the module can do its work in spite of it.
    pub fn module_fault(&mut self, error: ModuleError, detail: &str, can_go_on: bool, module_ns: u64) {
        let reason = format!("{error}: {detail}");
        self.module_fault_because(error, detail, reason, can_go_on, module_ns);
    }

    /// A partition has been stopped by its health table, and the module is told.
    pub(super) fn partition_stopped(&mut self, partition: &str, why: &str, module_ns: u64) {
        let reason = format!("partition {partition} is stopped ({why})");
        self.module_fault_because(ModuleError::PartitionStopped, &reason.clone(), reason, true, module_ns);
    }

    fn module_fault_because(
        &mut self,
        error: ModuleError,
        detail: &str,
        reason: String,
        can_go_on: bool,
        module_ns: u64,
    ) {
        let noted = Noted { plan: &self.plan.health, log: &mut self.health_log, module: &mut self.module };
        let (fault, action) = noted.decide(error, detail, can_go_on, module_ns);
        self.events.tell(&event_of(&fault));
        // The first that ends the module is the reason for its end; a shutdown is the end of a reset too.
        let reset = action == ModuleAction::Reset;
        let first = self.stop.as_ref().is_none_or(|stop| stop.reset && !reset);
        if action != ModuleAction::Ignore && first {
            self.stop = Some(Stop { reason, reset });
        }
    }

    /// Takes notice of how late the dispatcher came to the switches of a window, and of one that was lost otherwise.
    pub(super) fn judge_lateness(&mut self, record: &WindowRecord, module_ns: u64) {
        let late_ns = record.latest_ns();
        let at = record.occurrence;
        let partition = &self.plan[at.window.partition].name;
        let why = match record.missed {
            Some(Missed::OtherCore) => format!(
                "{partition}'s window on core {} was lost: the one on another core had not ended",
                at.core
            ),
            Some(Missed::StillFrozen) => format!(
                "{partition}'s window on core {} was lost: the kernel had not thawed the partition at its end",
                at.core
            ),
            _ if late_ns <= self.plan.health.late_after_ns => return,
            _ => format!("the dispatcher of core {} came {:.1} ms late", at.core, late_ns as f64 / 1e6),
        };
        self.totals.too_late += 1;
        let told = self.module.late_told_ns.is_some_and(|told| module_ns < told + LATE_SILENCE_NS);
        if told {
            return;
        }
        self.module.late_told_ns = Some(module_ns);
        let detail =
            format!("{why} in frame {}, number {} of such switches", at.minor_frames, self.totals.too_late);
        self.module_fault(ModuleError::LateDispatcher, &detail, true, module_ns);
    }

    /// Frame 0 begins at `begin_ns` of module time: where the module was reset, that is over.
    pub fn begin(&mut self, begin_ns: u64) {
        let Some(mut fault) = self.module.fault.take() else { return };
        fault.recovered_ns = Some(begin_ns);
        let after_ms = begin_ns.saturating_sub(fault.time_ns) as f64 / 1e6;
        self.health_log.write(&fault);
        self.health_log.note_recovery(&fault, self.module.resets, begin_ns);
        self.events.tell(&Event::ModuleRestarted { time_s: seconds(begin_ns), after_ms });
    }

    /// What goes on when the module starts again.
    #[must_use]
    pub fn hand_on(self) -> Kept {
        let Self { window_log, health_log, events, totals, module, .. } = self;
        Kept { window_log, health_log, events, totals, module }
    }
}

impl Kept {
    /// A start that the machine can not carry. True: it is tried again.
    pub fn cannot_start(&mut self, plan: &bateleur_plan::Health, detail: &str, module_ns: u64) -> bool {
        // The reset that led here has failed.
        if let Some(fault) = self.module.fault.take() {
            self.health_log.write(&fault);
        }
        let noted = Noted { plan, log: &mut self.health_log, module: &mut self.module };
        let (fault, action) = noted.decide(ModuleError::ConfigError, detail, false, module_ns);
        // Where it is the end, whoever started the module says so.
        if action == ModuleAction::Reset {
            self.events.tell(&event_of(&fault));
        }
        action == ModuleAction::Reset
    }

    /// Everything is written that is to be.
    pub fn close_logs(&mut self, module_ns: u64) {
        if let Some(fault) = self.module.fault.take() {
            self.health_log.write(&fault);
        }
        self.health_log.finish();
        self.window_log.finish();
        for lost in self.health_log.take_trouble().chain(self.window_log.take_trouble()) {
            let time_s = seconds(module_ns);
            self.events.tell(&Event::LogLost { time_s, log: lost.log.into(), reason: lost.why });
        }
    }
}

/// Where an error of the module is noted.
struct Noted<'a> {
    plan: &'a bateleur_plan::Health,
    log: &'a mut HealthLog,
    module: &'a mut ModuleLevel,
}

impl Noted<'_> {
    fn decide(
        self,
        error: ModuleError,
        detail: &str,
        can_go_on: bool,
        module_ns: u64,
    ) -> (Fault, ModuleAction) {
        let Self { plan, log, module } = self;
        module.recent.retain(|at| module_ns.saturating_sub(*at) < plan.reset.within_ns);
        // A reset that is under way mends this error too: it does not use up the budget twice.
        let recent =
            module.recent.len() as u32 - u32::from(module.fault.is_some() && !module.recent.is_empty());
        let action = decide_module(error, &plan.module, &plan.reset, can_go_on, recent);
        let fault = Fault {
            time_ns: module_ns,
            level: Level::Module,
            partition: None,
            generation: module.resets,
            error: error.name().into(),
            action: action.name().into(),
            detail: detail.into(),
            recovered_ns: None,
        };
        log.note(&fault);
        if action == ModuleAction::Reset && module.fault.is_none() {
            module.resets += 1;
            module.recent.push(module_ns);
            module.fault = Some(fault.clone());
        } else {
            log.write(&fault); // also where one reset mends two
        }
        (fault, action)
    }
}

fn event_of(fault: &Fault) -> Event {
    Event::ModuleFault {
        time_s: seconds(fault.time_ns),
        error: fault.error.clone(),
        action: fault.action.clone(),
        detail: fault.detail.clone(),
    }
}
