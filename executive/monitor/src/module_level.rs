//! The module level of health monitoring: errors of the module itself, and what goes on over a reset.
//!
//! Here it is only decided and noted that the module ends or starts again; whoever conducts it does so. It must never hold
//! up anybody: an error that comes again and again is told once a second, and counted always.

use crate::crashes::Crashes;
use crate::event::{Event, Events};
use crate::health::decision::decide_module;
use crate::health::log::{Fault, HealthLog, WindowLog};
use crate::health::record::Level;
use crate::why::Why;
use bateleur_plan::{Closed, ModuleAction, ModuleError, Plan};
use bateleur_time::window_record::{Missed, WindowRecord};

/// Totals over a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Totals {
    /// Windows granted.
    pub windows: u64,
    /// Windows whose start the dispatcher reached late.
    pub late: u64,
    /// Switches, starts and ends, that the dispatcher reached late.
    pub late_switches: u64,
    /// Windows that were lost because it came later than they last.
    pub lost: u64,
    /// Windows granted and not closed in time.
    pub overruns: u64,
    /// Switches that came later than `late_after`.
    pub too_late: u64,
}

impl Totals {
    /// As an executive leaves them to the next one.
    #[must_use]
    pub fn counts(&self) -> [u64; 6] {
        [self.windows, self.late, self.late_switches, self.lost, self.overruns, self.too_late]
    }

    fn of([windows, late, late_switches, lost, overruns, too_late]: [u64; 6]) -> Self {
        Self { windows, late, late_switches, lost, overruns, too_late }
    }

    fn add(&mut self, record: &WindowRecord) {
        self.windows += u64::from(record.granted_ns.is_some());
        self.late += u64::from(record.is_late());
        self.late_switches += record.late_switches();
        self.lost += u64::from(record.is_lost());
        self.overruns += u64::from(record.is_overrun());
    }
}

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
    /// Who answers why windows went as they did; nobody on the virtual clock, where nobody takes a processor from anybody.
    pub why: Option<Why>,
    /// What dead processes have written down.
    pub(crate) crashes: Crashes,
    totals: Totals,
    module: ModuleLevel,
}

impl Kept {
    /// Of a module that has not started yet.
    #[must_use]
    pub fn new(window_log: WindowLog, health_log: HealthLog, events: Events) -> Self {
        Self {
            window_log,
            health_log,
            events,
            why: None,
            crashes: Crashes::default(),
            totals: Totals::default(),
            module: ModuleLevel::default(),
        }
    }

    /// The executive before this one has died or hung, at the module time `module_ns`: noted as a reset, which is the `resets`th. `counts`: its
    /// [`Totals::counts`].
    pub fn follow(
        &mut self,
        plan: &bateleur_plan::Health,
        (error, detail): (ModuleError, &str),
        (resets, counts): (u32, [u64; 6]),
        module_ns: u64,
    ) {
        self.totals = Totals::of(counts);
        self.module.resets = resets.saturating_sub(1);
        let noted = Noted { plan, log: &mut self.health_log, module: &mut self.module };
        let (fault, _) = noted.decide(error, detail, true, module_ns);
        self.events.tell(&event_of(&fault));
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
struct ModuleLevel {
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

impl Kept {
    /// An error of the module: decided, noted, told. `can_go_on`: the module can do its work in spite of it. Why it shall stop, if it
    /// shall.
    pub(crate) fn module_fault(
        &mut self,
        plan: &bateleur_plan::Health,
        error: ModuleError,
        detail: &str,
        can_go_on: bool,
        module_ns: u64,
    ) -> Option<Stop> {
        let noted = Noted { plan, log: &mut self.health_log, module: &mut self.module };
        let (fault, action) = noted.decide(error, detail, can_go_on, module_ns);
        self.events.tell(&event_of(&fault));
        let reset = action == ModuleAction::Reset;
        let reason = match error {
            ModuleError::PartitionStopped => detail.to_owned(),
            _ => format!("{error}: {detail}"),
        };
        (action != ModuleAction::Ignore).then_some(Stop { reason, reset })
    }

    /// Takes notice of how late the dispatcher came to the switches of a window, and of one that was lost otherwise; an error in
    /// words, where it is time for one. `partition`: the window's.
    pub(crate) fn judge_lateness(
        &mut self,
        late_after_ns: u64,
        partition: &str,
        record: &WindowRecord,
        module_ns: u64,
    ) -> Option<String> {
        let late_ns = record.latest_ns();
        let core = record.occurrence.core;
        let why = match record.missed {
            Some(Missed::OtherCore) => {
                format!("{partition}'s window on core {core} was lost: the one on another core had not ended")
            }
            Some(Missed::StillFrozen) => format!(
                "{partition}'s window on core {core} was lost: the kernel had not thawed the partition at its end"
            ),
            _ if late_ns <= late_after_ns => return None,
            _ => format!("the dispatcher of core {core} came {:.1} ms late", late_ns as f64 / 1e6),
        };
        self.totals.too_late += 1;
        if self.module.late_told_ns.is_some_and(|told| module_ns < told + LATE_SILENCE_NS) {
            return None;
        }
        self.module.late_told_ns = Some(module_ns);
        let frame = record.occurrence.minor_frames;
        Some(format!("{why} in frame {frame}, number {} of such switches", self.totals.too_late))
    }

    /// Writes down and counts a window of `partition`.
    pub(crate) fn record(&mut self, plan: &Plan, partition: &str, record: &WindowRecord) {
        let schedule = &plan.schedules[record.occurrence.epoch.schedule].name;
        self.window_log.write(record, partition, schedule);
        self.health_log.set_frame(record.occurrence.minor_frames);
        self.totals.add(record);
    }

    /// Frame 0 begins at `begin_ns` of module time: where the module was reset, that is over.
    pub(crate) fn begin(&mut self, begin_ns: u64) {
        let Some(mut fault) = self.module.fault.take() else { return };
        fault.recovered_ns = Some(begin_ns);
        let after_ms = begin_ns.saturating_sub(fault.time_ns) as f64 / 1e6;
        self.health_log.write(&fault);
        self.health_log.note_recovery(&fault, self.module.resets, begin_ns);
        self.events.tell(&Event::ModuleRestarted { time_s: seconds(begin_ns), after_ms });
    }

    /// Tells what a partition, or the module under `partition`, has to say.
    pub(crate) fn say(&mut self, partition: &str, text: impl Into<String>, module_ns: u64) {
        let partition = partition.to_owned();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text: text.into() });
    }

    /// Makes an entry of what is complete.
    pub(crate) fn enter(&mut self, fault: &Fault) {
        self.health_log.note(fault);
        self.health_log.write(fault);
    }

    /// Tells of logs that can not be written, each once. A full disk must not stop the aircraft.
    pub(crate) fn tell_lost(&mut self, module_ns: u64) {
        for lost in self.health_log.take_trouble().chain(self.window_log.take_trouble()) {
            let time_s = seconds(module_ns);
            self.events.tell(&Event::LogLost { time_s, log: lost.log.into(), reason: lost.why });
        }
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
        self.why = None;
        self.tell_lost(module_ns);
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

pub(crate) fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::tests::record;
    use crate::lines::Patience;
    use bateleur_plan::{HealthLog as RingOf, LogPolicy};

    #[test]
    fn window_that_a_partition_lost_without_its_fault_is_told_as_a_late_dispatcher_with_the_cause() {
        let folder = tempfile::tempdir().unwrap();
        let ring = RingOf { bytes: 4096, policy: LogPolicy::Overwrite };
        let mut kept = Kept::new(
            WindowLog::create(folder.path(), Patience::Wait).unwrap(),
            HealthLog::create(
                folder.path(),
                ring,
                Patience::Wait,
                bateleur_time::run_page::Heartbeat::of_health_log(None),
            )
            .unwrap(),
            Events::new(None),
        );
        let lost = |missed| WindowRecord { missed, ..record(None, None) };
        let causes = [(Missed::OtherCore, "another core had not ended"), (Missed::StillFrozen, "not thawed")];
        for (second, (missed, words)) in causes.into_iter().enumerate() {
            let module_ns = second as u64 * LATE_SILENCE_NS;
            let told = kept.judge_lateness(u64::MAX, "imu", &lost(Some(missed)), module_ns).unwrap();
            assert!(told.contains("imu's window on core 0 was lost") && told.contains(words), "{told}");
            assert_eq!(
                kept.judge_lateness(u64::MAX, "imu", &lost(Some(missed)), module_ns + 1),
                None,
                "counted only"
            );
        }
        assert_eq!(kept.totals().too_late, 4);
        for nobodys in [None, Some(Missed::NoPartition)] {
            assert_eq!(kept.judge_lateness(u64::MAX, "imu", &lost(nobodys), u64::MAX), None);
        }
        assert_eq!(kept.totals().too_late, 4);
    }
}
