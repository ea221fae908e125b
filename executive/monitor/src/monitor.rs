//! What the monitor consists of, and what whoever runs a module may ask of it at any time.

use std::os::fd::BorrowedFd;
use std::sync::Arc;

use bateleur_contract::Clock;

use crate::align::Alignment;
use crate::cleanup::{Cleanups, EndedHelpers, StartChannelCleaner};
use crate::crashes::CrashReporter;
use crate::event::{Event, Events};
use crate::health::log::{Fault, HealthLog};
use crate::health::record::Level;
use crate::inject::OwnFault;
use crate::lifecycle::Phase;
use crate::module_level::{Kept, Stop, Totals};
use crate::neighbours::Neighbours;
use crate::operator::Operator;
use crate::partition::Partition;
use crate::rebuild::{RebuildHooks, Rebuilds};
use crate::why::{Answer, Kind, Why};
use bateleur_host::error_log::ErrorReader;
use bateleur_plan::{Closed, ModuleError, Plan};
use bateleur_system::kernel_log::KernelLog;
use bateleur_system::wait::await_any_end;
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::schedule_switch::ScheduleSwitch;
use bateleur_time::window_record::WindowRecord;

/// What the health log calls an order in place of an error.
const ORDER: &str = "order";

/// Takes the next window records that dispatchers have left.
pub type TakeRecord = Box<dyn FnMut() -> Option<WindowRecord>>;

/// See the crate's head.
pub struct Monitor {
    pub(crate) plan: Arc<Plan>,
    pub(crate) schedule_switch: Arc<ScheduleSwitch>,
    /// The schedule that was told last.
    pub(crate) told_schedule: usize,
    pub(crate) clock: Clock,
    pub(crate) partitions: Vec<Partition>,
    /// From a partition's place in the plan to its place here.
    pub(crate) places: Vec<Option<usize>>,
    pub(crate) cleanups: Cleanups,
    pub(crate) rebuilds: Rebuilds,
    pub(crate) take_record: TakeRecord,
    /// The logs, the counts, and the errors of the module.
    pub(crate) kept: Kept,
    pub(crate) stop: Option<Stop>,
    /// Of the last step.
    pub(crate) module_ns: u64,
    pub(crate) next_upkeep_ns: u64,
    pub(crate) error_reader: ErrorReader,
    pub(crate) operator: Operator,
    /// Where the module follows another one's frames.
    pub(crate) alignment: Option<Alignment>,
    pub(crate) kernel_log: KernelLog,
    pub(crate) neighbours: Neighbours,
    /// What was provoked in the executive itself, and is about to happen.
    pub(crate) own_fault: Option<OwnFault>,
    /// In the pause that the next step follows at once (the wall clock).
    nobody_ended: bool,
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
    /// How a helper is started for what a dead process has written down.
    pub crash_reporter: CrashReporter,
    /// Channel holders that have ended, and the channels that they held; `None` if they are not cleaned up after.
    pub ended_helpers: Option<(EndedHelpers, Vec<String>)>,
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
        let MonitorConfig { plan, schedule_switch, clock, take_record, operator, error_reader, .. } = config;
        let mut kept = config.kept;
        kept.health_log.begin_frames();
        kept.crashes.start_by(config.crash_reporter);
        Self {
            told_schedule: schedule_switch.current(),
            places: vec![None; plan.partitions.len()],
            plan,
            schedule_switch,
            clock,
            partitions: Vec::new(),
            cleanups: Cleanups::new(config.start_channel_cleaner, config.ended_helpers),
            rebuilds: Rebuilds::new(config.rebuilds),
            take_record,
            kept,
            stop: None,
            module_ns: 0,
            next_upkeep_ns: 0,
            error_reader,
            operator,
            alignment: None,
            kernel_log: KernelLog::open(),
            neighbours: Neighbours::default(),
            own_fault: None,
            nobody_ended: false,
        }
    }

    /// Sleeps until a process ends, at most `nanoseconds`.
    pub fn pause(&mut self, nanoseconds: u64) {
        let helpers = self.cleanups.channel_cleaners().chain(self.rebuilds.channel_probe());
        let ends = self.partitions.iter().flat_map(Partition::ends);
        let all: Vec<BorrowedFd<'_>> =
            ends.chain(helpers).chain(self.operator.observers.processes()).collect();
        // On the virtual clock windows lie between a pause and the next step.
        self.nobody_ended = !await_any_end(&all, nanoseconds) && self.clock == Clock::Wall;
    }

    /// As [`Monitor::do_all_run`], in the step that follows a pause: who ends in between ends the next pause at once.
    pub(crate) fn did_all_run(&mut self) -> bool {
        let all_run = |one: &Partition| one.life.phase() == Phase::Running && one.active.process.is_some();
        std::mem::take(&mut self.nobody_ended) && self.partitions.iter().all(all_run) || self.do_all_run()
    }

    /// Whether every partition has a process that runs: one question to the kernel instead of one for each.
    #[must_use]
    pub fn do_all_run(&self) -> bool {
        let ends = self.partitions.iter().map(|partition| match partition.life.phase() {
            Phase::Running => partition.active.end(),
            _ => None,
        });
        ends.collect::<Option<Vec<_>>>().is_some_and(|ends| !await_any_end(&ends, 0))
    }

    /// Whether a process that was launched a moment ago may be ready soon.
    #[must_use]
    pub fn awaits_start(&self) -> bool {
        self.partitions.iter().any(Partition::is_ready_soon)
    }

    /// Whether the partition's process has ended.
    pub fn has_ended(&self, partition: usize) -> bool {
        self.places[partition].is_none_or(|place| !self.partitions[place].runs())
    }

    /// An error of the module. `can_go_on`: the module can do its work in spite of it.
    pub fn module_fault(&mut self, error: ModuleError, detail: &str, can_go_on: bool, module_ns: u64) {
        let asked = self.kept.module_fault(&self.plan.health, error, detail, can_go_on, module_ns);
        // The first that ends the module is the reason for its end; a shutdown is the end of a reset too.
        if let Some(asked) = asked
            && self.stop.as_ref().is_none_or(|stop| stop.reset && !asked.reset)
        {
            self.stop = Some(asked);
        }
    }

    /// Frame 0 begins at `begin_ns` of module time: where the module was reset, that is over. On the wall clock, module time 0 was at
    /// `origin_ns` of CLOCK_MONOTONIC.
    pub fn begin(&mut self, begin_ns: u64, origin_ns: u64) {
        if let Some(why) = &mut self.kept.why {
            why.set_origin_ns(origin_ns);
        }
        self.kept.begin(begin_ns);
    }

    /// From now on the module's frames follow somebody's.
    pub fn follow(&mut self, alignment: Alignment) {
        self.alignment = Some(alignment);
    }

    /// Totals over all starts.
    #[must_use]
    pub fn totals(&self) -> Totals {
        self.kept.totals()
    }

    /// What goes on when the module starts again.
    #[must_use]
    pub fn hand_on(self) -> Kept {
        self.kept
    }

    /// The persistent health log and the others.
    pub fn health_log(&mut self) -> &mut HealthLog {
        &mut self.kept.health_log
    }

    /// Why the module shall stop, if it shall.
    #[must_use]
    pub fn stop_asked(&self) -> Option<&Stop> {
        self.stop.as_ref()
    }

    /// The partitions' controls, for the dispatcher.
    #[must_use]
    pub fn pair(&self) -> Vec<Option<Arc<RedundantPair>>> {
        self.places.iter().map(|place| place.map(|place| self.partitions[place].pair.clone())).collect()
    }

    /// Who watches.
    pub fn events(&mut self) -> &mut Events {
        &mut self.kept.events
    }

    /// Channels that were rebuilt since the last question.
    #[must_use]
    pub fn take_rebuilt(&mut self) -> Vec<String> {
        self.rebuilds.take_rebuilt()
    }

    /// Cleans up after a process that is no partition and was attached to `channels`.
    pub fn clean_up_after_helper(&mut self, pid: i32, channels: Vec<String>) {
        self.cleanups.add_helper(pid, channels);
    }

    /// Whether it still waits for that.
    #[must_use]
    pub fn awaits_cleanup(&self, pid: i32) -> bool {
        self.cleanups.awaits(pid)
    }

    /// Tells what the partition at `place` has to say.
    pub(crate) fn say(&mut self, place: usize, text: impl Into<String>, module_ns: u64) {
        self.kept.say(self.partitions[place].name(), text, module_ns);
    }

    /// Tells of a log, or of something else that happened to the module.
    pub(crate) fn tell(&mut self, event: &Event) {
        self.kept.events.tell(event);
    }

    /// An order is an entry in the health log: whoever reads what followed from it must not take it for a fault.
    pub(crate) fn note_order(&mut self, place: Option<usize>, text: &str, module_ns: u64) {
        let generation = place.map_or(0, |place| self.partitions[place].life.generation());
        self.note_order_of(place, generation, text, module_ns);
    }

    /// As [`Monitor::note_order`], about an incarnation that may be over.
    pub(crate) fn note_order_of(
        &mut self,
        place: Option<usize>,
        generation: u32,
        text: &str,
        module_ns: u64,
    ) {
        let partition = place.map(|place| &self.partitions[place]);
        let entry = Fault {
            time_ns: module_ns,
            level: if place.is_some() { Level::Partition } else { Level::Module },
            partition: partition.map(|partition| partition.name().to_owned()),
            generation,
            error: ORDER.into(),
            action: "ignore".into(),
            detail: text.into(),
            recovered_ns: None,
        };
        self.kept.enter(&entry);
    }

    pub(crate) fn tell_of_neighbour(&mut self, text: String, module_ns: u64) {
        self.kept.health_log.note_module(ModuleError::ProcessorTaken.name(), text.clone(), module_ns);
        self.kept.say(&self.operator.about.module, text, module_ns);
    }

    /// Asks why a window of the partition at `place` went as it did.
    pub(crate) fn ask(&mut self, kind: Kind, place: usize, record: &WindowRecord) {
        let Some(why) = &mut self.kept.why else { return };
        let (partitions, name) = (&self.partitions, self.partitions[place].name());
        why.ask(kind, name, record, || {
            let processes = partitions.iter().filter_map(|partition| {
                let process = partition.active.process.as_ref()?;
                Some((process.pid, partition.name().to_owned()))
            });
            processes.collect()
        });
    }

    /// Tells the module of what was taken from its partitions, as far as somebody knows by now who took it.
    pub(crate) fn tell_taken(&mut self, module_ns: u64) {
        while let Some(answer) = self.kept.why.as_ref().and_then(Why::taken) {
            let Answer { partition, taker, .. } = &answer;
            let place = self.partitions.iter().position(|one| one.name() == partition);
            let Some(place) = place else { continue };
            let cores = self.partitions[place].active.sandbox.cores();
            if let Some(detail) = self.neighbours.judge_taker(partition, cores, &taker.words(), module_ns) {
                self.module_fault(ModuleError::ProcessorTaken, &detail, true, module_ns);
            }
        }
    }
}
