//! The monitor: sees processes live and die, decides by the health tables, and brings successors up.
//!
//! It runs beside the dispatchers on the wall clock and between two minor frames on the virtual one; either way it is
//! a state machine that is stepped and never waits for a partition for longer than a step.
//!
//! ```text
//! Starting ──ready──▶ Running ──death──▶ Dead ──channel cleaner──▶ Starting …
//!     └────time-out, death──────────────▲   └──channel cleaner──▶ Gone (idle, stopped, no budget left)
//!              Dead ──channel cleaner, the machine can not start it──▶ Unstarted ──a little later──▶ Starting …
//! ```
//!
//! - `processes`: they are started, found ready, found dead, followed, ended; `watched`: one partition and the life in it;
//! - `cleanup`: what a dead one left; `rebuild`: channels that it damaged; `standby`: who takes its place at once;
//! - `windows`: what windows tell; `reports`: what partitions say, and are told; `repeats`: how often that is logged;
//! - `faults`: what is done about a fault of a partition; `module_level`: and about one of the module;
//! - `operator`: orders; `acts`: what they, or a plan of faults, do to a partition; `provoke`: faults that are ordered;
//! - `change`: another schedule; `align`: another module's frames;
//! - `neighbours`: other modules on the same processors;
//! - `figures`: what a status tells; `observers`: who shows channels to operators; `upkeep`: the rest.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use bateleur_contract::Clock;

use crate::event::Events;
use crate::health::log::{HealthLog, WindowLog};
pub use align::Alignment;
use bateleur_host::error_log::ErrorReader;
use bateleur_plan::Plan;
use bateleur_system::kernel_log::KernelLog;
use bateleur_system::spawn::Spawned;
use bateleur_system::wait::await_any_end;
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::schedule_switch::ScheduleSwitch;
use bateleur_time::window_record::WindowRecord;
pub use change::UnknownSchedule;
use cleanup::Cleanups;
use module_level::ModuleLevel;
pub use module_level::{Kept, Stop};
use neighbours::Neighbours;
use operator::Operator;
use rebuild::{RebuildHooks, Rebuilds};
use watched::{Life, Watched};

mod acts;
mod align;
mod change;
pub mod cleanup;
pub mod event;
pub mod event_text;
mod faults;
mod figures;
pub mod health;
pub mod inject;
mod module_level;
mod neighbours;
pub mod observers;
pub mod operator;
pub mod planned;
mod processes;
mod provoke;
pub mod rebuild;
mod repeats;
mod reports;
pub mod run_order;
mod standby;
mod upkeep;
mod watched;
mod windows;

/// Starts a channel cleaner for a dead process that was attached to channels, some of which are damaged. It writes the name of each
/// into the file before it looks at its memory.
pub type StartChannelCleaner = Box<dyn Fn(&cleanup::CleanupOrder) -> io::Result<(Spawned, File)>>;
/// Takes the next window records that dispatchers have left.
pub type TakeRecord = Box<dyn FnMut() -> Option<WindowRecord>>;

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

/// See the module's head.
pub struct Monitor {
    plan: Arc<Plan>,
    schedule_switch: Arc<ScheduleSwitch>,
    /// The schedule that was told last.
    told_schedule: usize,
    clock: Clock,
    watched: Vec<Watched>,
    /// From a partition's place in the plan to its place here.
    places: Vec<Option<usize>>,
    cleanups: Cleanups,
    rebuilds: Rebuilds,
    take_record: TakeRecord,
    window_log: WindowLog,
    health_log: HealthLog,
    events: Events,
    totals: Totals,
    module: ModuleLevel,
    stop: Option<Stop>,
    /// Of the last step.
    module_ns: u64,
    next_upkeep_ns: u64,
    error_reader: ErrorReader,
    operator: Operator,
    /// Where the module follows another one's frames.
    alignment: Option<Alignment>,
    kernel_log: KernelLog,
    neighbours: Neighbours,
}

/// What a monitor works with.
pub struct MonitorConfig {
    /// The plan.
    pub plan: Arc<Plan>,
    /// Which schedule runs.
    pub schedule_switch: Arc<ScheduleSwitch>,
    /// The clock.
    pub clock: Clock,
    /// How a channel cleaner is started.
    pub start_channel_cleaner: StartChannelCleaner,
    /// Channel holders that have ended, and the channels that they held; `None` if they are not cleaned up after.
    pub ended_helpers: Option<(cleanup::EndedHelpers, Vec<String>)>,
    /// How damaged channels are found and rebuilt.
    pub rebuilds: RebuildHooks,
    /// Where dispatchers leave records.
    pub take_record: TakeRecord,
    /// What is there already where the module was reset.
    pub kept: Kept,
    /// Who gives orders.
    pub operator: Operator,
    /// Who reads the partitions' standard error.
    pub error_reader: ErrorReader,
}

impl Monitor {
    /// Watches nobody yet.
    #[must_use]
    pub fn new(config: MonitorConfig) -> Self {
        let MonitorConfig {
            plan,
            schedule_switch,
            clock,
            start_channel_cleaner,
            ended_helpers,
            rebuilds,
            take_record,
            kept,
            operator,
            error_reader,
        } = config;
        let Kept { window_log, mut health_log, events, totals, module } = kept;
        health_log.begin_frames();
        Self {
            told_schedule: schedule_switch.current(),
            places: vec![None; plan.partitions.len()],
            plan,
            schedule_switch,
            clock,
            watched: Vec::new(),
            cleanups: Cleanups::new(start_channel_cleaner, ended_helpers),
            rebuilds: Rebuilds::new(rebuilds),
            take_record,
            window_log,
            health_log,
            events,
            totals,
            module,
            stop: None,
            module_ns: 0,
            next_upkeep_ns: 0,
            error_reader,
            operator,
            alignment: None,
            kernel_log: KernelLog::open(),
            neighbours: Neighbours::default(),
        }
    }

    /// Sleeps until a process ends, at most `nanoseconds`.
    pub fn pause(&self, nanoseconds: u64) {
        let processes = self.watched.iter().filter_map(|watched| match &watched.life {
            Life::Starting(process, _) | Life::Running(process) => Some(process.pidfd.as_fd()),
            Life::Dead(..) | Life::Unstarted(_) | Life::Gone => None,
        });
        let standbys = self.watched.iter().filter_map(|watched| watched.standby.as_ref()?.process());
        let standbys = standbys.map(|process| process.pidfd.as_fd());
        let channel_cleaner = self.cleanups.channel_cleaners().chain(self.rebuilds.channel_probe());
        let observers = self.operator.observers.processes();
        let all: Vec<BorrowedFd<'_>> =
            processes.chain(standbys).chain(channel_cleaner).chain(observers).collect();
        await_any_end(&all, nanoseconds);
    }

    /// Looks at everything once. `module_ns`: the time of what is found.
    pub fn step(&mut self, module_ns: u64) {
        self.module_ns = module_ns;
        self.take_records(module_ns);
        self.tell_schedule();
        self.align(module_ns);
        let all_run = self.do_all_run();
        for place in 0..self.watched.len() {
            self.tell_repeats(place, module_ns, false);
            self.take_reports(place, module_ns);
            self.take_pending_action(place, module_ns); // whose window's record found no room
            // On the virtual clock a successor is looked at when its first window comes, whenever it was ready.
            let awaited = self.clock == Clock::Virtual && self.watched[place].is_coming();
            if !all_run && !awaited {
                self.look_at_process(place, module_ns);
            }
            self.tend_standby(place, module_ns);
        }
        self.look_at_channel_cleaner();
        if self.clock == Clock::Wall {
            self.look_at_channel_probe(module_ns);
        }
        self.serve_requests(module_ns);
        self.tell_partitions();
        self.keep_up(module_ns);
    }

    /// Whether every partition has a process that runs: one question to the kernel instead of one for each.
    #[must_use]
    pub fn do_all_run(&self) -> bool {
        let processes = self.watched.iter().map(|watched| match &watched.life {
            Life::Running(process) => Some(process.pidfd.as_fd()),
            Life::Starting(..) | Life::Dead(..) | Life::Unstarted(_) | Life::Gone => None,
        });
        processes.collect::<Option<Vec<_>>>().is_some_and(|processes| !await_any_end(&processes, 0))
    }

    /// The persistent health log and the others.
    pub fn health_log(&mut self) -> &mut HealthLog {
        &mut self.health_log
    }

    /// Why the module shall stop, if it shall.
    #[must_use]
    pub fn stop_asked(&self) -> Option<&Stop> {
        self.stop.as_ref()
    }

    /// The partitions' controls, for the dispatcher.
    #[must_use]
    pub fn pair(&self) -> Vec<Option<Arc<RedundantPair>>> {
        self.places.iter().map(|place| place.map(|place| self.watched[place].pair.clone())).collect()
    }

    /// Who watches.
    pub fn events(&mut self) -> &mut Events {
        &mut self.events
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

#[cfg(test)]
#[path = "../../test_support.rs"]
mod test_support;
