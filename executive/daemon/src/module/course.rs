//! A run over all its starts: what goes on when the module is reset.
//!
//! Module time is the run's and goes on; frames begin anew with frame 0, and so does everything else: control groups, shared
//! memory, channels, processes.

use std::io;
use std::sync::Arc;

use bateleur_contract::{Clock, Mapped, StartCondition};

use super::{Options, Outcome, RunError, machine};
use crate::world::{Surroundings, tell_lost};
use bateleur_host::guarantee::Guarantee;
use bateleur_host::logbooks::LogbookMemories;
use bateleur_monitor::Kept;
use bateleur_monitor::event::Event;
use bateleur_monitor::health::journal::Journal;
use bateleur_monitor::health::log::{HealthLog, WindowLog};
use bateleur_monitor::lines::Patience;
use bateleur_monitor::logbook_store::{Beginning, LogbookStores};
use bateleur_monitor::planned::PlannedActs;
use bateleur_monitor::why;
use bateleur_plan::{ModuleView, PartitionId, Plan};
use bateleur_system::service_manager::ServiceManager;
use bateleur_system::time::now_ns;
use bateleur_time::run_page::{Heartbeat, RunPage};
use bateleur_time::shared_clock::{Member, PATIENCE_NS};

/// Real time from "ready" to frame 0: long enough for every dispatcher thread to be in its sleep.
const LEAD_NS: u64 = 20_000_000;

/// See the module's head.
pub(super) struct Course {
    /// With the monitor while the module runs.
    pub(super) kept: Option<Kept>,
    pub(super) surroundings: Surroundings,
    /// The memories of the partitions' logbooks.
    pub(super) logbooks: Arc<LogbookMemories>,
    clock: Clock,
    /// Wall clock: when module time 0 was, CLOCK_MONOTONIC ns.
    origin_ns: Option<u64>,
    /// What the supervisor sees.
    pub(super) page: Option<Arc<Mapped<RunPage>>>,
    /// The next start is that after an executive's death: partitions find what they have retained.
    follows_dead: bool,
    /// Module time at which the last start ended, ns; before the first, that at which it begins.
    ended_ns: u64,
    startup_ns: u64,
    /// Virtual clock: the module among others on it.
    pub(super) member: Option<Member>,
    /// Of the initial schedule.
    major_frame_ns: u64,
    lost_records: u64,
    spun_ns: u64,
    left_behind: bool,
}

/// How one start of the module ended.
pub(super) struct Ended {
    /// Why.
    pub(super) reason: String,
    /// Module time, ns.
    pub(super) module_ns: u64,
    /// It shall start again.
    pub(super) reset: bool,
    /// An error of the module ended it.
    pub(super) faulty: bool,
    /// Something that it made could not be removed.
    pub(super) left_behind: bool,
    /// Window records that found no room on their way to the log.
    pub(super) lost_records: u64,
    /// What the dispatchers have spun in slack, ns.
    pub(super) spun_ns: u64,
}

/// The memories and files of the partitions' logbooks, which outlive resets of the module.
fn logbooks(
    view: &ModuleView<'_>,
    options: &Options,
    follows_dead: bool,
) -> io::Result<(LogbookMemories, LogbookStores)> {
    let kept = options.supervision.as_ref().map(|kept| kept.memory_blocks.clone()).unwrap_or_default();
    let memories = LogbookMemories::begin(view, &kept)?;
    let (clock, folder) = (options.order.clock(), &options.order.logbooks);
    let beginning = match clock {
        _ if follows_dead => Beginning::AfterDeath,
        Clock::Virtual => Beginning::Anew,
        Clock::Wall => Beginning::FromFiles,
    };
    let stores = LogbookStores::open(view, folder, &memories, clock, beginning)?;
    Ok((memories, stores))
}

impl Course {
    /// A run that has not begun. Takes what it needs of `options`.
    pub(super) fn new(plan: &Plan, view: &ModuleView<'_>, options: &mut Options) -> Result<Self, RunError> {
        // Before anything of a run that shares its clock by mistake is written over.
        let together = options.order.together.take().filter(|_| options.order.clock() == Clock::Virtual);
        let back_ns = together.as_ref().and_then(|together| together.back_ns);
        let join = |together| Member::join(together, &options.order.module, options.stop.clone());
        let member = together.map(join).transpose().map_err(RunError::SharedClock)?;
        let patience = match options.order.clock() {
            Clock::Wall => Patience::Lose,
            Clock::Virtual => Patience::Wait,
        };
        let (folder, ring) = (&options.order.output, plan.health.log);
        let after = options.supervision.as_mut().and_then(|supervision| supervision.after.take());
        // They can be refused: before anything of the last run is written over.
        let (logbooks, stores) = logbooks(view, options, after.is_some())
            .map_err(machine("cannot keep the partitions' logbooks"))?;
        if after.is_none() {
            let _ = std::fs::remove_file(folder.join(why::FILE)); // most often there is none
            bateleur_host::helper::crash::remove_earlier(folder);
        }
        let beat =
            Heartbeat::of_health_log(options.supervision.as_ref().map(|supervision| &supervision.page));
        let (window_log, health_log) = match after {
            None => (WindowLog::create(folder, patience), HealthLog::create(folder, ring, patience, beat)),
            Some(_) => (WindowLog::go_on(folder, patience), HealthLog::go_on(folder, ring, patience, beat)),
        };
        let window_log = window_log.map_err(machine("cannot write windows.csv"))?;
        let window_log =
            if options.supervision.is_some() { window_log.in_small_pieces() } else { window_log };
        let mut health_log = health_log.map_err(machine("cannot write health.jsonl"))?;
        // A module on the virtual clock is a trial; thousands of them would hide what really happened on this machine.
        if options.order.clock() == Clock::Wall {
            health_log.tell_journal(Journal::of(&options.order.module));
        }
        let events = std::mem::replace(&mut options.events, bateleur_monitor::event::Events::new(None));
        let candidates = view.partitions().map(PartitionId::index).collect();
        let mut surroundings = Surroundings::new(
            &options.order,
            PlannedActs::of(plan, &options.order.acts, options.order.killings, candidates),
            options.stop.clone(),
            options.power_fail.clone(),
            options.companion.take(),
        );
        if options.supervision.is_none() {
            surroundings.service_manager = ServiceManager::from_environment();
        }
        let mut kept = Kept::new(window_log, health_log, events);
        let page = options.supervision.as_ref().map(|supervision| supervision.page.clone());
        if let Some(dead) = &after {
            let counts = page.as_ref().map_or_else(Default::default, |page| page.counts());
            kept.follow(&plan.health, (dead.error, &dead.detail), (dead.resets, counts), dead.at_ns);
            surroundings.go_on_from(dead.at_ns);
        }
        let clock = options.order.clock();
        if clock == Clock::Virtual {
            surroundings.page = page.clone();
        }
        surroundings.logbooks = Some(stores);
        let dead_ns = after.as_ref().map(|dead| dead.at_ns);
        Ok(Self {
            kept: Some(kept),
            surroundings,
            clock,
            origin_ns: page.as_ref().and_then(|page| page.origin_ns()),
            page,
            logbooks: Arc::new(logbooks),
            follows_dead: after.is_some(),
            ended_ns: back_ns.or(dead_ns).unwrap_or(0),
            startup_ns: plan.health.reset.startup_ns,
            member,
            major_frame_ns: plan[plan.initial_schedule()].major_frame_ns,
            lost_records: 0,
            spun_ns: 0,
            left_behind: false,
        })
    }

    /// Resets so far.
    pub(super) fn resets(&self) -> u32 {
        self.kept.as_ref().map_or(0, Kept::resets)
    }

    /// The next start is that after an executive's death.
    pub(super) fn follows_dead(&self) -> bool {
        self.follows_dead
    }

    /// What partitions find at the next start.
    pub(super) fn take_condition(&mut self, resets: u32) -> StartCondition {
        match (std::mem::take(&mut self.follows_dead), resets) {
            (true, _) => StartCondition::HmPartitionWarmRestart,
            (false, 0) => StartCondition::NormalStart,
            (false, _) => StartCondition::HmModuleRestart,
        }
    }

    /// Tells whoever watches.
    pub(super) fn tell(&mut self, event: &Event) {
        if let Some(kept) = &mut self.kept {
            kept.events.tell(event);
        }
    }

    /// Module time that has been reached so far, ns.
    pub(super) fn reached_ns(&self) -> u64 {
        match (self.clock, self.origin_ns) {
            (Clock::Wall, Some(origin_ns)) => now_ns().saturating_sub(origin_ns),
            _ => self.ended_ns,
        }
    }

    /// Module time of frame 0 of a start whose partitions are ready, ns, and on the wall clock the CLOCK_MONOTONIC instant of
    /// module time 0.
    ///
    /// # Errors
    /// A module that shares the virtual clock did not come.
    pub(super) fn begin(&mut self, resets: u32) -> Result<(u64, u64), RunError> {
        if let Some(member) = &self.member {
            member.await_all(PATIENCE_NS).map_err(RunError::SharedClock)?;
        }
        let ready_ns = now_ns() + LEAD_NS;
        let origin_ns = *self.origin_ns.get_or_insert(ready_ns);
        if let Some(page) = &self.page {
            page.begin(origin_ns, resets);
        }
        let begin_ns = match (self.clock, resets) {
            (Clock::Wall, 0) => 0,
            (Clock::Virtual, 0) => self.ended_ns,
            (Clock::Wall, _) => ready_ns.saturating_sub(origin_ns),
            // Its frames lie as the others' again.
            (Clock::Virtual, _) if self.member.is_some() => {
                (self.ended_ns + self.startup_ns).next_multiple_of(self.major_frame_ns)
            }
            (Clock::Virtual, _) => self.ended_ns + self.startup_ns,
        };
        Ok((begin_ns, origin_ns))
    }

    /// One start has ended.
    pub(super) fn note(&mut self, ended: &Ended) {
        self.ended_ns = ended.module_ns;
        self.lost_records += ended.lost_records;
        self.spun_ns += ended.spun_ns;
        self.left_behind |= ended.left_behind;
    }

    /// The module could not be started. True: it is tried again.
    pub(super) fn tries_again(&mut self, plan: &Plan, error: &RunError) -> bool {
        let at_ns = self.reached_ns();
        let text = error.to_string();
        self.kept.as_mut().is_some_and(|kept| kept.cannot_start(&plan.health, &text, at_ns))
    }

    /// The run is over before it could be told how.
    pub(super) fn give_up(mut self) {
        if let Some(kept) = &mut self.kept {
            kept.close_logs(self.ended_ns);
            kept.events.finish();
        }
    }

    /// The run is over.
    pub(super) fn finish(mut self, ended: Ended, guarantees: Vec<Guarantee>) -> Outcome {
        let mut logs_lost = false;
        let lost = self.surroundings.logbooks.take().map(|mut logbooks| logbooks.finish());
        if let Some(kept) = &mut self.kept {
            lost.into_iter().flatten().for_each(|lost| tell_lost(&mut kept.events, lost, ended.module_ns));
            kept.close_logs(ended.module_ns);
            logs_lost = kept.events.has_told_lost_log();
            let (totals, resets, unwritten_records) = (kept.totals(), kept.resets(), kept.unwritten());
            kept.events.tell(&Event::Stopped {
                reason: ended.reason.clone(),
                module_time_s: ended.module_ns as f64 / 1e9,
                windows: totals.windows,
                late_windows: totals.late,
                late_switches: totals.late_switches,
                lost_windows: totals.lost,
                too_late_switches: totals.too_late,
                resets,
                window_overruns: totals.overruns,
                spun_s: self.spun_ns as f64 / 1e9,
                lost_records: self.lost_records,
                unwritten_records,
            });
            kept.events.finish();
        }
        let Ended { reason, module_ns, faulty, .. } = ended;
        Outcome { reason, module_ns, faulty, logs_lost, left_behind: self.left_behind, guarantees }
    }
}
