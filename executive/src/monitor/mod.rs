//! The monitor: sees processes live and die, decides by the health tables, and brings successors up.
//!
//! It runs beside the dispatchers on the wall clock and between two minor frames on the virtual one; either way it is
//! a state machine that is stepped and never waits for a partition for longer than a step.
//!
//! ```text
//! Starting ──ready──▶ Running ──death──▶ Dead ──janitor──▶ Starting …
//!     └────time-out, death──────────────▲   └──janitor──▶ Gone (idle, stopped, no budget left)
//!              Dead ──janitor, the machine can not start it──▶ Unstarted ──a little later──▶ Starting …
//! ```
//!
//! What an operator asks for is in `acts`, what becomes of the dead in `burial`.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::process::ExitStatusExt;
use std::sync::Arc;
use std::sync::atomic::Ordering::Acquire;

use bateleur_contract::{Clock, ErrorCode, Mode, ReportKind, Reported, StartCondition, exit};

use crate::agenda::{Agenda, Requested};
use crate::event::{Event, Events};
use crate::health::decision::{Decision, Situation, decide, decide_restart, error_of};
use crate::health::log::{Fault, HealthLog, WindowLog, WindowRecord};
use crate::health::record::Level;
use crate::partition::{Cage, await_any_end, ended, is_readable};
use crate::plan::{Closed, ModuleAction, ModuleError, PartitionError, PartitionId, PartitionState, Plan};
use crate::seats::Seats;
use crate::system::kernel_log::KernelLog;
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;
pub use align::Alignment;
use burial::{Burials, Seat};
use module_level::ModuleLevel;
pub use module_level::{Kept, Stop};
use operator::Operator;
use renewal::{Means, Renewals};
use repeats::Untold;
use standby::TAKEOVER;
use watched::{Life, Then, Until, Watched};

mod acts;
mod align;
mod burial;
mod change;
mod figures;
mod module_level;
pub mod observers;
pub mod operator;
mod provoke;
pub mod renewal;
mod repeats;
mod standby;
mod watched;
mod windows;

/// Starts a janitor for a dead process of a partition.
pub type StartJanitor = Box<dyn Fn(PartitionId, i32) -> io::Result<Spawned>>;
/// Starts a janitor for a dead process that is no partition and was attached to channels.
pub type StartForStranger = Box<dyn Fn(i32, &[String]) -> io::Result<Spawned>>;
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

/// A schedule that the plan does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the plan has no schedule \"{name}\"; it has {known}")]
pub struct UnknownSchedule {
    /// What was asked for.
    pub name: String,
    /// What there is.
    pub known: String,
}

/// See the module's head.
pub struct Monitor {
    plan: Arc<Plan>,
    agenda: Arc<Agenda>,
    /// The schedule that was told last.
    told_schedule: usize,
    clock: Clock,
    watched: Vec<Watched>,
    /// From a partition's place in the plan to its place here.
    places: Vec<Option<usize>>,
    burials: Burials,
    renewals: Renewals,
    take_record: TakeRecord,
    window_log: WindowLog,
    health_log: HealthLog,
    events: Events,
    totals: Totals,
    module: ModuleLevel,
    stop: Option<Stop>,
    /// Of the last step.
    module_ns: u64,
    next_count_ns: u64,
    /// When the partitions' logs are looked at next, CLOCK_MONOTONIC, ns.
    next_bound_ns: u64,
    operator: Operator,
    /// Where the module follows another one's frames.
    alignment: Option<Alignment>,
    kernel_log: KernelLog,
}

/// Between two counts of the partitions' threads, ns. Until it is found out, a child runs as ordinary work: it can take
/// idle time, and nobody's window.
const COUNT_NS: u64 = 100_000_000;

/// What a monitor works with.
pub struct Equipment {
    /// The plan.
    pub plan: Arc<Plan>,
    /// Which schedule runs.
    pub agenda: Arc<Agenda>,
    /// The clock.
    pub clock: Clock,
    /// How a janitor is started.
    pub start_janitor: StartJanitor,
    /// How one is started for a process that is no partition.
    pub start_for_stranger: StartForStranger,
    /// How damaged channels are found and made anew.
    pub renewals: Means,
    /// Where dispatchers leave records.
    pub take_record: TakeRecord,
    /// What is there already where the module was reset.
    pub kept: Kept,
    /// Who gives orders.
    pub operator: Operator,
}

impl Monitor {
    /// Watches nobody yet.
    #[must_use]
    pub fn new(equipment: Equipment) -> Self {
        let Equipment {
            plan,
            agenda,
            clock,
            start_janitor,
            start_for_stranger,
            renewals,
            take_record,
            kept,
            operator,
        } = equipment;
        let Kept { window_log, mut health_log, events, totals, module } = kept;
        health_log.begin_frames();
        Self {
            told_schedule: agenda.current(),
            places: vec![None; plan.partitions.len()],
            plan,
            agenda,
            clock,
            watched: Vec::new(),
            burials: Burials::new(start_janitor, start_for_stranger),
            renewals: Renewals::new(renewals),
            take_record,
            window_log,
            health_log,
            events,
            totals,
            module,
            stop: None,
            module_ns: 0,
            next_count_ns: 0,
            next_bound_ns: 0,
            operator,
            alignment: None,
            kernel_log: KernelLog::open(),
        }
    }

    /// Starts every partition of the module.
    ///
    /// # Errors
    /// A program that could not be started, with its partition.
    pub fn launch(&mut self, cages: Vec<Cage>, condition: StartCondition) -> Result<(), String> {
        for cage in cages {
            let process =
                cage.launch(0, condition).map_err(|error| format!("partition {}: {error}", cage.name))?;
            self.places[cage.id.index()] = Some(self.watched.len());
            self.watched.push(Watched::new(cage, process));
        }
        self.launch_standbys()
    }

    /// Waits until every partition has initialised, before frame 0.
    ///
    /// # Errors
    /// The first partition that did not make it, with its last words.
    pub fn await_all_ready(&mut self) -> Result<(), String> {
        while !self.are_standbys_ready()?
            || self.watched.iter().any(|watched| matches!(watched.life, Life::Starting(..)))
        {
            for watched in &mut self.watched {
                watched.look_at_start(&self.plan, self.module_ns)?;
            }
            self.pause(1_000_000);
        }
        Ok(())
    }

    /// Sleeps until a process ends, at most `nanoseconds`.
    pub fn pause(&self, nanoseconds: u64) {
        let processes = self.watched.iter().filter_map(|watched| match &watched.life {
            Life::Starting(process, _) | Life::Running(process) => Some(process.pidfd.as_fd()),
            Life::Dead(..) | Life::Unstarted(_) | Life::Gone => None,
        });
        let standbys = self.watched.iter().filter_map(|watched| watched.standby.as_ref()?.process());
        let standbys = standbys.map(|process| process.pidfd.as_fd());
        let janitor = self.burials.janitor().into_iter().chain(self.renewals.examiner());
        let observers = self.operator.observers.processes();
        let all: Vec<BorrowedFd<'_>> = processes.chain(standbys).chain(janitor).chain(observers).collect();
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
            self.pay(place, module_ns); // whose window's record found no room
            // On the virtual clock a successor is looked at when its first window comes, whenever it was ready.
            let awaited = self.clock == Clock::Virtual && self.watched[place].is_coming();
            if !all_run && !awaited {
                self.look_at_process(place, module_ns);
            }
            self.tend_standby(place, module_ns);
        }
        self.look_at_janitor();
        if self.clock == Clock::Wall {
            self.look_at_examiner(module_ns);
        }
        self.obey(module_ns);
        self.tell_partitions();
        if module_ns >= self.next_count_ns {
            self.next_count_ns = module_ns + COUNT_NS;
            self.bound_logs();
            self.tell_lost(module_ns);
            if self.clock == Clock::Wall {
                self.count_threads(module_ns);
                for place in 0..self.watched.len() {
                    self.judge_fence(place, module_ns);
                }
            }
        }
    }

    /// Whether every partition has a process that runs: one question to the kernel instead of one for each.
    pub(crate) fn do_all_run(&self) -> bool {
        let processes = self.watched.iter().map(|watched| match &watched.life {
            Life::Running(process) => Some(process.pidfd.as_fd()),
            Life::Starting(..) | Life::Dead(..) | Life::Unstarted(_) | Life::Gone => None,
        });
        processes.collect::<Option<Vec<_>>>().is_some_and(|processes| !await_any_end(&processes, 0))
    }

    /// Keeps the partitions' logs short. They grow in real time, whatever the module's clock does.
    fn bound_logs(&mut self) {
        let now_ns = now_ns();
        if now_ns >= self.next_bound_ns {
            self.next_bound_ns = now_ns + COUNT_NS;
            self.watched.iter().for_each(|watched| watched.cage.bound_log());
        }
    }

    /// Tells of logs that can not be written, each once. A full disk must not stop the aircraft.
    fn tell_lost(&mut self, module_ns: u64) {
        for lost in self.health_log.take_trouble().chain(self.window_log.take_trouble()) {
            let time_s = seconds(module_ns);
            self.events.tell(&Event::LogLost { time_s, log: lost.log.into(), reason: lost.why });
        }
        for watched in &self.watched {
            let cages =
                std::iter::once(&watched.cage).chain(watched.standby.iter().map(|standby| &standby.cage));
            for reason in cages.filter_map(Cage::take_log_trouble) {
                let log = format!("partitions/{}.log", watched.cage.name);
                self.events.tell(&Event::LogLost { time_s: seconds(module_ns), log, reason });
            }
        }
    }

    /// The persistent health log and the others.
    pub fn health_log(&mut self) -> &mut HealthLog {
        &mut self.health_log
    }

    /// A partition that declared one thread is not frozen when it closes its window: the thread sleeps. One that has
    /// more after all is found here.
    fn count_threads(&mut self, module_ns: u64) {
        let found = self.watched.iter().filter(|watched| watched.finds_company());
        for name in found.map(|watched| watched.cage.name.clone()).collect::<Vec<_>>() {
            let text =
                "it has more threads or processes than it declared: held between its windows from now on"
                    .into();
            self.events.tell(&Event::Message { time_s: seconds(module_ns), partition: name, text });
        }
    }

    /// Asks for the schedule of that name, from the next major frame on. The last request wins.
    ///
    /// # Errors
    /// The plan has no such schedule.
    pub fn request_schedule(&mut self, name: &str, module_ns: u64) -> Result<Requested, UnknownSchedule> {
        let Some(schedule) = self.plan.schedule(name) else {
            let known = self.plan.schedules.iter().map(|schedule| schedule.name.as_str());
            return Err(UnknownSchedule { name: name.into(), known: known.collect::<Vec<_>>().join(", ") });
        };
        let requested = self.agenda.request(schedule.index());
        if requested == Requested::Pending {
            self.events.tell(&Event::ScheduleRequested {
                time_s: seconds(module_ns),
                schedule: name.into(),
                by: "operator".into(),
            });
        }
        Ok(requested)
    }

    /// Tells those partitions of the health log's new entries that the plan lets know: also a process that stands by, so that it
    /// goes on with the same count.
    fn tell_partitions(&mut self) {
        let notices = self.health_log.take_notices();
        if notices.is_empty() {
            return;
        }
        let told = self.watched.iter().filter(|watched| self.plan[watched.cage.id].health_texts);
        for page in told.flat_map(Watched::pages) {
            notices.iter().for_each(|notice| page.notify(notice.severity, &notice.text));
        }
    }

    /// Tells about a change of schedule that has taken effect.
    fn tell_schedule(&mut self) {
        let current = self.agenda.current();
        if current == self.told_schedule {
            return;
        }
        let before = std::mem::replace(&mut self.told_schedule, current);
        self.events.tell(&Event::ScheduleChanged {
            time_s: seconds(self.agenda.changed_ns()),
            schedule: self.plan.schedules[current].name.clone(),
            before: self.plan.schedules[before].name.clone(),
        });
    }

    /// Waits until the partition runs again or is given up (the virtual clock, at its first window after a restart).
    pub fn await_successor(&mut self, partition: usize, module_ns: u64) {
        let Some(place) = self.places[partition] else { return };
        self.module_ns = module_ns;
        // One that fails now is started again later, as on the wall clock, and not at the same instant.
        while self.watched[place].is_coming() && module_ns >= self.watched[place].cage.slot.not_before_ns() {
            self.look_at_process(place, module_ns);
            self.look_at_janitor();
            self.look_at_examiner(module_ns);
            if self.watched[place].is_coming() {
                self.pause(200_000);
            }
        }
    }

    /// Buries a process that is no partition and was attached to `channels`.
    pub fn bury_stranger(&mut self, pid: i32, channels: Vec<String>) {
        self.burials.add_stranger(pid, channels);
    }

    /// Whether it still waits for that.
    #[must_use]
    pub fn awaits_burial(&self, pid: i32) -> bool {
        self.burials.awaits(pid)
    }

    /// Waits for it, as nobody's time passes (the virtual clock).
    pub fn await_burial(&mut self, pid: i32) {
        while self.awaits_burial(pid) {
            self.look_at_janitor();
            if self.awaits_burial(pid) {
                self.pause(200_000);
            }
        }
    }

    /// Whether the partition's process has ended.
    pub fn has_ended(&self, partition: usize) -> bool {
        let place = self.places[partition].map(|place| &self.watched[place].life);
        match place {
            Some(Life::Running(process)) => is_readable(process.pidfd.as_fd()),
            _ => true,
        }
    }

    /// Why the module shall stop, if it shall.
    #[must_use]
    pub fn stop_asked(&self) -> Option<&Stop> {
        self.stop.as_ref()
    }

    /// The partitions' slots, for the dispatcher.
    #[must_use]
    pub fn seats(&self) -> Vec<Option<Arc<Seats>>> {
        self.places.iter().map(|place| place.map(|place| self.watched[place].seats.clone())).collect()
    }

    /// Who watches.
    pub fn events(&mut self) -> &mut Events {
        &mut self.events
    }

    /// Ends every partition: politely, then not.
    pub fn finish(&mut self, module_ns: u64) {
        self.take_records(module_ns);
        (0..self.watched.len()).for_each(|place| self.tell_repeats(place, module_ns, true));
        self.watched.iter_mut().filter_map(|watched| watched.standby.as_mut()).for_each(|standby| {
            let _ = standby.put_an_end(); // it has nothing to finish
        });
        self.watched.iter().for_each(|watched| watched.cage.slot.ask_to_stop());
        await_ends(&mut self.watched, Watched::not_gone, STOP_PATIENCE_NS);
        for watched in &mut self.watched {
            watched.put_an_end();
            if let Some(fault) = watched.fault.take() {
                self.health_log.write(&fault);
            }
        }
        // A short run on the virtual clock may end before they were looked at.
        self.watched.iter().for_each(|watched| watched.cage.bound_log());
        self.burials.give_up();
        self.renewals.give_up();
        self.window_log.flush();
        if let Some(stop) = self.stop.as_ref().filter(|stop| !stop.reset) {
            self.health_log.note_module("module_stop", stop.reason.clone(), module_ns);
        }
        self.tell_lost(module_ns);
    }

    fn take_reports(&mut self, place: usize, module_ns: u64) {
        let watched = &mut self.watched[place];
        if watched.cage.slot.page.report_count.load(Acquire) == watched.reports_seen {
            return;
        }
        let reports = watched.cage.slot.page.reports_since(&mut watched.reports_seen);
        for Reported { kind, in_handler, text } in reports {
            // The word about the state is of the report's time: by now the handler may have come back.
            let state = in_handler.then_some(PartitionState::Handler);
            // One burst of errors is one fault where it ends the process: the rest must not use up its budget.
            if !self.watched[place].is_alive() && kind != ReportKind::Message {
                continue;
            }
            match kind {
                ReportKind::Message => self.take_message(place, text, module_ns),
                ReportKind::ApplicationError => {
                    self.fault_in(place, PartitionError::ApplicationError, state, text, module_ns);
                }
                ReportKind::PortError => {
                    self.fault_in(place, PartitionError::PortError, state, text, module_ns);
                }
            }
        }
    }

    /// REPORT_APPLICATION_MESSAGE: recorded and passed on, within bounds.
    fn take_message(&mut self, place: usize, text: String, module_ns: u64) {
        let watched = &mut self.watched[place];
        if let Some(text) = watched.messages.record(&text, module_ns) {
            self.health_log.note_message(&watched.cage.name, watched.generation, text, module_ns);
        }
        if watched.may_speak(module_ns) {
            let partition = watched.cage.name.clone();
            self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
        }
    }

    /// Makes an entry of the errors that had none of their own, where it is time to, or where `all` says so.
    fn tell_repeats(&mut self, place: usize, module_ns: u64, all: bool) {
        while let Some(untold) = self.watched[place].repeats.take_untold(module_ns, all) {
            let Untold { error, decision, detail } = untold;
            let fault = self.entry(place, error.name(), decision, detail, module_ns);
            self.tell_fault(place, &fault);
            self.health_log.write(&fault);
        }
        let watched = &mut self.watched[place];
        if all && let more @ 1.. = watched.messages.take_unrecorded() {
            let text = format!("{more} more are not recorded");
            self.health_log.note_message(&watched.cage.name, watched.generation, text, module_ns);
        }
    }

    fn look_at_process(&mut self, place: usize, module_ns: u64) {
        if matches!(self.watched[place].life, Life::Unstarted(retry_ns) if now_ns() >= retry_ns) {
            self.start_successor(place);
        }
        let watched = &mut self.watched[place];
        if let Err(detail) = watched.look_at_start(&self.plan, module_ns) {
            // Whether it died or hangs: what it finds of its predecessor may be the cause.
            watched.start_failed = true;
            return self.fault(place, PartitionError::StartupTimeout, detail, module_ns);
        }
        let watched = &mut self.watched[place];
        let Life::Running(process) = &watched.life else { return };
        if !is_readable(process.pidfd.as_fd()) {
            return;
        }
        // Before its number may be given to another process.
        watched.cage.slot.lose_process();
        let (pid, status) = (process.pid, ended(process));
        watched.died(pid);
        let words = watched.cage.last_words();
        let found = status.and_then(|status| error_of(status, words.as_deref()));
        match status.and_then(|status| status.code()) {
            Some(exit::IDLE) => return self.do_as_asked(place, Mode::Idle, module_ns),
            Some(exit::WARM_START) => return self.do_as_asked(place, Mode::WarmStart, module_ns),
            Some(exit::COLD_START) => return self.do_as_asked(place, Mode::ColdStart, module_ns),
            _ => {}
        }
        let (error, mut detail) = found.unwrap_or((PartitionError::Exit, "ended by itself".into()));
        if error == PartitionError::Killed && watched.has_starved() {
            detail = "ended by the kernel: the partition had no memory left".into();
            return self.fault(place, PartitionError::MemoryLimit, detail, module_ns);
        }
        if status.and_then(|status| status.signal()) == Some(SIGSYS)
            && let Some(call) = self.kernel_log.call_that_ended(pid)
        {
            detail = format!("{detail}: {call}");
        } else if error != PartitionError::Killed
            && let Some(words) = words
        {
            detail = format!("{detail}: {words}");
        }
        self.fault(place, error, detail, module_ns);
    }

    fn fault(&mut self, place: usize, error: PartitionError, detail: String, module_ns: u64) {
        self.fault_in(place, error, None, detail, module_ns);
    }

    /// `state`: what the partition was at; none: what it is at now.
    fn fault_in(
        &mut self,
        place: usize,
        error: PartitionError,
        state: Option<PartitionState>,
        detail: String,
        module_ns: u64,
    ) {
        let recent = self.recent_restarts(place, module_ns);
        let watched = &self.watched[place];
        let partition = &self.plan[watched.cage.id];
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

    /// Whether a partition may raise this again and again, because nothing is done that ends it.
    fn goes_on_after(&self, error: PartitionError, decision: Decision) -> bool {
        let ignored = || self.plan.health.module.action(ModuleError::PartitionError) == ModuleAction::Ignore;
        matches!(error, PartitionError::ApplicationError | PartitionError::PortError)
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
            self.watched[place].cage.slot.page.raise(code, detail);
        }
    }

    /// A partition has ended itself to be started again or to be idle (SET_PARTITION_MODE). Its budget counts the starts.
    fn do_as_asked(&mut self, place: usize, mode: Mode, module_ns: u64) {
        let recent = self.recent_restarts(place, module_ns);
        let restart = &self.plan[self.watched[place].cage.id].restart;
        let decision = match mode {
            Mode::Idle => Decision::Idle,
            mode => decide_restart(restart, mode == Mode::WarmStart, recent),
        };
        self.decided(place, OWN_REQUEST, decision, "its error handler asked for it".into(), false, module_ns);
    }

    fn recent_restarts(&mut self, place: usize, module_ns: u64) -> u32 {
        let watched = &mut self.watched[place];
        let within_ns = self.plan[watched.cage.id].restart.within_ns;
        watched.restarts.retain(|at| module_ns.saturating_sub(*at) < within_ns);
        watched.restarts.len() as u32
    }

    /// Notes, tells and does what was decided.
    fn decided(
        &mut self,
        place: usize,
        error: &str,
        decision: Decision,
        detail: String,
        alive: bool,
        module_ns: u64,
    ) {
        let mut fault = self.entry(place, error, decision, detail, module_ns);
        if matches!(decision, Decision::Restart { .. }) && self.can_take_over(place, module_ns) {
            fault.action = TAKEOVER.into();
        }
        self.tell_fault(place, &fault);
        self.act(place, decision, fault, alive, module_ns);
    }

    /// What the log says of an error of the partition at `place`.
    fn entry(&self, place: usize, error: &str, decision: Decision, detail: String, module_ns: u64) -> Fault {
        let watched = &self.watched[place];
        let level = match decision {
            Decision::Handler => Level::Process,
            Decision::Module => Level::Module,
            _ => Level::Partition,
        };
        Fault {
            time_ns: module_ns,
            level,
            partition: Some(watched.cage.name.clone()),
            generation: watched.generation,
            error: error.into(),
            action: decision.name().into(),
            detail,
            recovered_ns: None,
        }
    }

    /// Makes known what has been decided about a fault of the partition at `place`.
    fn tell_fault(&mut self, place: usize, fault: &Fault) {
        let watched = &mut self.watched[place];
        watched.figures.fault(fault);
        self.health_log.note(fault);
        self.events.tell(&Event::Fault {
            time_s: seconds(fault.time_ns),
            partition: watched.cage.name.clone(),
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
                let name = &self.watched[place].cage.name;
                let detail = format!("{} of partition {name} ({})", fault.error, fault.detail);
                self.module_fault(ModuleError::PartitionError, &detail, true, module_ns);
            }
            Decision::Idle | Decision::Stop => {
                self.lay_to_rest(place, Until::Started, module_ns);
                self.health_log.write(&fault);
                if decision == Decision::Stop {
                    let partition = self.watched[place].cage.name.clone();
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
                self.bury(place, Then::Successor, module_ns);
            }
        }
    }

    fn look_at_janitor(&mut self) {
        while let Some((place, seat)) = self.burials.next_buried(&self.watched) {
            if seat == Seat::Behind {
                if let Some(standby) = &mut self.watched[place].standby {
                    standby.buried();
                }
                continue;
            }
            match self.watched[place].life {
                Life::Dead(_, Then::Successor) if self.watched[place].start_failed => self.examine(place),
                Life::Dead(_, Then::Successor) => self.start_successor(place),
                Life::Dead(_, Then::Rest) => self.watched[place].life = Life::Gone,
                _ => {}
            }
        }
    }

    fn start_successor(&mut self, place: usize) {
        let watched = &mut self.watched[place];
        watched.had_window = false;
        match watched.cage.launch(watched.generation + 1, watched.next_start) {
            Ok(process) => {
                watched.generation += 1;
                watched.figures.restarts += 1;
                watched.reports_seen = watched.cage.slot.page.report_count.load(Acquire);
                watched.life = Life::Starting(process, now_ns());
            }
            Err(error) => self.not_started(place, &error),
        }
    }

    /// The machine could not start the partition's successor. That may pass, so it is tried again: as a restart like any
    /// other, within the budget, and a little later each time. Nothing of the partition has run: warm stays warm.
    fn not_started(&mut self, place: usize, error: &io::Error) {
        let module_ns = self.module_ns;
        let recent = self.recent_restarts(place, module_ns);
        let watched = &mut self.watched[place];
        watched.life = Life::Unstarted(now_ns() + retry_after_ns(recent));
        let restart = &self.plan[watched.cage.id].restart;
        let decision = decide_restart(restart, watched.next_start.is_warm(), recent);
        let detail = format!("its successor can not be started: {error}");
        let text = format!("partition {} can not be started again: {error}", watched.cage.name);
        self.decided(place, NOT_STARTED, decision, detail, false, module_ns);
        if !matches!(decision, Decision::Restart { .. }) {
            self.module_fault(ModuleError::ConfigError, &text, true, module_ns);
        }
    }
}

/// How long after a failed try the machine is asked again to start a process, ns, where there were `recent` restarts.
fn retry_after_ns(recent: u32) -> u64 {
    50_000_000 << recent.min(6)
}

/// Sleeps until all of `list` have ended, at most `patience_ns`. `look`: what tells the end of one; none: it has ended.
fn await_ends<T>(list: &mut [T], look: impl Fn(&mut T) -> Option<BorrowedFd<'_>>, patience_ns: u64) {
    let end_ns = now_ns() + patience_ns;
    loop {
        // Those alone that still live: one that has ended would end each sleep at once.
        let left: Vec<BorrowedFd<'_>> = list.iter_mut().filter_map(&look).collect();
        let left_ns = end_ns.saturating_sub(now_ns());
        if left.is_empty() || left_ns == 0 {
            return;
        }
        await_any_end(&left, left_ns);
    }
}

/// A filter has ended the process.
const SIGSYS: i32 = 31;

/// What the log calls a restart that a partition asked for; no error of a table.
const OWN_REQUEST: &str = "own_request";
/// What it calls a successor that the machine could not start; no error of a table either.
const NOT_STARTED: &str = "not_started";

/// What a partition's handler is told that an error is; none: it is told of no such error.
fn handler_code(error: PartitionError) -> Option<ErrorCode> {
    match error {
        PartitionError::DeadlineMissed => Some(ErrorCode::DeadlineMissed),
        PartitionError::ApplicationError => Some(ErrorCode::ApplicationError),
        PartitionError::PortError => Some(ErrorCode::PortError),
        PartitionError::WindowOverrun => Some(ErrorCode::WindowOverrun),
        _ => None,
    }
}

/// How long partitions may take to end when they are asked to.
const STOP_PATIENCE_NS: u64 = 500_000_000;
fn end_helper(process: &Spawned) {
    let _ = rustix::process::pidfd_send_signal(&process.pidfd, rustix::process::Signal::KILL); // ended already
    await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
    let _ = ended(process);
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use std::io::{PipeReader, PipeWriter};

    use super::*;

    /// A pipe stands for a process: closed, it can be read from, as the descriptor of one that has ended.
    struct Process {
        descriptor: PipeReader,
        life: Option<PipeWriter>,
        looks: u32,
    }

    impl Process {
        fn look(&mut self) -> Option<BorrowedFd<'_>> {
            self.looks += 1;
            self.life.is_some().then(|| self.descriptor.as_fd())
        }
    }

    #[test]
    fn process_that_has_ended_before_the_first_in_the_list_does_not_keep_the_end_of_a_run_busy() {
        let mut list: Vec<Process> = (0..3)
            .map(|_| {
                let (descriptor, life) = std::io::pipe().unwrap();
                Process { descriptor, life: Some(life), looks: 0 }
            })
            .collect();
        list[1].life = None;
        await_ends(&mut list, Process::look, 20_000_000);
        let looks: Vec<u32> = list.iter().map(|process| process.looks).collect();
        assert_eq!(looks, [2, 2, 2], "before the sleep and after it");
    }

    #[test]
    fn machine_that_can_not_start_a_process_is_asked_again_later_each_time() {
        let delays: Vec<u64> = (0..8).map(|recent| retry_after_ns(recent) / 1_000_000).collect();
        assert_eq!(delays, [50, 100, 200, 400, 800, 1600, 3200, 3200]);
    }
}
