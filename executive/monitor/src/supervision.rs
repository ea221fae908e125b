//! Carries out what the life cycles of partitions command, and brings them what happens: processes that become ready or end, faults,
//! channels that are cleaned up or made anew.
//!
//! It decides nothing itself: what an error means is said by the health tables, and what follows by the life cycle. It must never wait for
//! a process for longer than a step, but where no time passes: before frame 0, at the end, and on the virtual clock.

use std::io;
use std::os::unix::process::ExitStatusExt;

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{Clock, Mode};

use crate::cleanup::{Cleaned, CleanupOrder};
use crate::event::Event as Told;
use crate::health::decision::{Decision, Situation, decide, decide_restart, error_of, handler_code};
use crate::health::log::Fault;
use crate::lifecycle::{Command, Event, Instant, Next, PairMember, Phase, StandbyEvent, StandbyState};
use crate::module_level::seconds;
use crate::monitor::Monitor;
use crate::partition::Start;
use crate::rebuild::Suspicion;
use crate::repeats::{Repeats, Untold, goes_on_after};
use bateleur_host::partition::attached_channels;
use bateleur_plan::{Closed, ModuleAction, ModuleError, PartitionError, PartitionState, StartMode};
use bateleur_system::time::now_ns;

/// A filter has ended the process.
const SIGSYS: i32 = 31;
/// What the log calls a restart that a partition asked for; no error of a table.
const OWN_REQUEST: &str = "own_request";
/// What it calls a successor that the machine could not start.
const NOT_STARTED: &str = "not_started";
/// What it says was done where a standby has taken over.
const TAKEOVER: &str = "takeover";
/// What it says about a process that stood by and is gone.
const NEW_STANDBY: &str = "new_standby";
/// How long a process may take from the call until it has taken over, real time, ns: it attaches its queues and loads what was
/// retained, well below a millisecond each. The monitor waits so long, so that the next window is the successor's.
const CALL_PATIENCE_NS: u64 = 20_000_000;
/// As above on the virtual clock, where nobody's time passes meanwhile.
const VIRTUAL_CALL_PATIENCE_NS: u64 = 2_000_000_000;

/// Events of life cycles, and their commands.
impl Monitor {
    /// Brings `event` to the life cycle of the partition at `place`, and carries out what that commands.
    pub(crate) fn feed(&mut self, place: usize, event: Event, module_ns: u64) {
        let now = Instant { module_ns, real_ns: now_ns() };
        for command in self.partitions[place].life.handle(event, now) {
            self.carry_out(place, command, module_ns);
        }
    }

    fn carry_out(&mut self, place: usize, command: Command, module_ns: u64) {
        let partition = &mut self.partitions[place];
        let control = &partition.active.sandbox.control;
        match command {
            Command::Admit { held } => partition.admit(held, module_ns),
            Command::EndProcess => partition.end_process(),
            Command::EndRemains => partition.end_remains(),
            Command::Windows(readiness) => control.set_readiness(readiness),
            Command::NotBefore(instant_ns) => control.set_not_before_ns(instant_ns),
            Command::Hold => control.hold(),
            Command::Release => control.release(),
            Command::AskToStop => control.ask_to_stop(),
            Command::CleanUp(member) => self.clean_up(place, member, module_ns),
            Command::AwaitCleanUp(member) => self.await_clean_up(place, member),
            Command::Launch { generation, condition } => {
                match partition.active.launch(generation, condition) {
                    Ok(()) => {
                        partition.figures.restarts += 1;
                        self.feed(place, Event::Launched, module_ns);
                    }
                    Err(error) => self.not_launched(place, &error, module_ns),
                }
            }
            Command::Examine => self.rebuilds.add(Suspicion {
                place,
                id: partition.active.sandbox.id,
                bad: std::mem::take(&mut partition.damaged),
                examine: partition.life.start_failed(),
            }),
            Command::ForgetExamination => self.rebuilds.forget(place),
            Command::CloseFault => {
                if let Some(fault) = partition.fault.take() {
                    self.kept.health_log.write(&fault);
                }
            }
            Command::TakeOver { warm } => self.take_over(place, warm, module_ns),
            Command::LaunchStandby { generation } => self.launch_standby(place, generation, module_ns),
            Command::AdmitStandby | Command::EndStandby | Command::EndStandbyRemains => {
                let Some(standby) = &mut partition.standby else { return };
                match (command, &standby.process) {
                    (Command::AdmitStandby, Some(process)) => standby.sandbox.stand_by(process),
                    (Command::EndStandby, _) => standby.kill(),
                    _ => standby.sandbox.kill(None),
                }
            }
        }
    }

    fn clean_up(&mut self, place: usize, member: PairMember, module_ns: u64) {
        let Some(dead) = self.partitions[place].member(member) else { return };
        let Some(pid) = dead.remains else { return self.feed(place, cleaned(member, false), module_ns) };
        let order = CleanupOrder {
            pid,
            user: dead.sandbox.own_user(),
            channels: attached_channels(&self.plan, dead.sandbox.id),
            damaged: Vec::new(),
        };
        self.cleanups.add(place, member, order);
    }

    /// On the virtual clock everything that peers can notice happens at an instant of module time: a queue that the dead one had is full
    /// until then.
    fn await_clean_up(&mut self, place: usize, member: PairMember) {
        let waits = |monitor: &Self| {
            let life = &monitor.partitions[place].life;
            match member {
                PairMember::Active => matches!(life.phase(), Phase::CleaningUp(Next::Rest(_))),
                PairMember::Standby => life.standby() == Some(StandbyState::CleaningUp),
            }
        };
        while waits(self) {
            self.look_at_channel_cleaner();
            self.pause(200_000);
        }
    }

    /// The machine could not start the partition's successor. That may pass, so it is tried again: as a restart like any
    /// other, within the budget, and a little later each time.
    fn not_launched(&mut self, place: usize, error: &io::Error, module_ns: u64) {
        self.feed(place, Event::NotLaunched, module_ns);
        let partition = &self.partitions[place];
        let decision = partition.life.decide_relaunch(module_ns);
        let detail = format!("its successor can not be started: {error}");
        let text = format!("partition {} can not be started again: {error}", partition.name());
        self.decided(place, NOT_STARTED, decision, detail, false, module_ns);
        if !matches!(decision, Decision::Restart { .. }) {
            self.module_fault(ModuleError::ConfigError, &text, true, module_ns);
        }
    }

    fn launch_standby(&mut self, place: usize, generation: u32, module_ns: u64) {
        let Some(standby) = &mut self.partitions[place].standby else { return };
        let event = match standby.launch_standby(generation) {
            Ok(()) => StandbyEvent::Launched,
            Err(error) => {
                self.say(place, format!("its standby can not be started: {error}"), module_ns);
                StandbyEvent::NotLaunched
            }
        };
        self.feed(place, Event::Standby(event), module_ns);
    }

    /// Puts the process that stands by in the place of the dead one, if it can.
    fn take_over(&mut self, place: usize, warm: bool, module_ns: u64) {
        let schedule = self.schedule_switch.current();
        let grant = WindowGrant {
            start_ns: module_ns,
            minor_frame_ns: self.plan.schedules[schedule].minor_frame_ns,
            schedule: schedule as u32,
            schedule_since_ns: self.schedule_switch.changed_ns(),
            next_schedule: self.schedule_switch.next() as u32,
            ..WindowGrant::default()
        };
        let patience_ns = match self.clock {
            Clock::Wall => CALL_PATIENCE_NS,
            Clock::Virtual => VIRTUAL_CALL_PATIENCE_NS,
        };
        let can_be_called = self.partitions[place].can_take_over(module_ns);
        let has_taken_over = can_be_called && self.partitions[place].call_standby(warm, &grant, patience_ns);
        let partition = &mut self.partitions[place];
        if has_taken_over {
            partition.exchange(partition.life.is_held(), module_ns);
            partition.figures.restarts += 1;
            return self.feed(place, Event::TookOver, module_ns);
        }
        if let Some(fault) = &mut partition.fault {
            fault.action = Decision::Restart { warm }.name().into();
        }
        if can_be_called {
            self.say(place, "its standby did not take over: it is started anew", module_ns);
        }
        self.feed(place, Event::NotTakenOver, module_ns);
    }
}

/// What becomes of processes.
impl Monitor {
    pub(crate) fn look_at_process(&mut self, place: usize, module_ns: u64) {
        if matches!(self.partitions[place].life.phase(), Phase::Retrying(_)) {
            self.feed(place, Event::Look, module_ns);
        }
        let limit_ns = self.plan[self.partitions[place].active.sandbox.id].startup_timeout_ns;
        let (event, detail) = match self.partitions[place].look_at_start(limit_ns) {
            Start::UnderWay => return self.look_for_death(place, module_ns),
            Start::Ready => {
                self.feed(place, Event::Ready, module_ns);
                return self.look_for_death(place, module_ns);
            }
            Start::Ended(detail) => (Event::Died, detail),
            Start::Overdue(detail) => (Event::Overdue, detail),
        };
        self.feed(place, event, module_ns);
        self.fault(place, PartitionError::StartupTimeout, detail, module_ns);
    }

    fn look_for_death(&mut self, place: usize, module_ns: u64) {
        let partition = &mut self.partitions[place];
        if partition.life.phase() != Phase::Running || !partition.active.has_ended() {
            return;
        }
        let (pid, status) = partition.reap();
        self.feed(place, Event::Died, module_ns);
        let partition = &mut self.partitions[place];
        let words = partition.active.sandbox.last_words();
        let code = status.and_then(|status| status.code());
        let code = code.filter(|_| self.plan[partition.active.sandbox.id].error_handler);
        if let Some(mode) = partition.asked_for(code) {
            return self.do_as_asked(place, mode, module_ns);
        }
        let found = status.and_then(|status| error_of(status, words.as_deref()));
        let (error, mut detail) = found.unwrap_or((PartitionError::Exit, "ended by itself".into()));
        if error == PartitionError::Killed && self.partitions[place].has_lacked_memory() {
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

    /// A partition has ended itself to be started again or to be idle (SET_PARTITION_MODE). Its budget counts the starts.
    fn do_as_asked(&mut self, place: usize, mode: Mode, module_ns: u64) {
        let partition = &self.partitions[place];
        let restart = &self.plan[partition.active.sandbox.id].restart;
        let decision = match mode {
            Mode::Idle => Decision::Idle,
            mode => {
                decide_restart(restart, mode == Mode::WarmStart, partition.life.recent_restarts(module_ns))
            }
        };
        self.decided(place, OWN_REQUEST, decision, "its error handler asked for it".into(), false, module_ns);
    }

    /// Looks at the process that stands by, and has one started where it is time to.
    pub(crate) fn tend_standby(&mut self, place: usize, module_ns: u64) {
        if self.partitions[place].standby.is_none() {
            return;
        }
        self.look_at_standby(place, module_ns);
        if self.partitions[place].life.phase() == Phase::Running {
            self.feed(place, Event::Look, module_ns);
        }
        // On the virtual clock everything that peers can notice happens at an instant of module time.
        while self.clock == Clock::Virtual
            && self.partitions[place].life.standby() == Some(StandbyState::Starting)
        {
            self.look_at_standby(place, module_ns);
            self.pause(200_000);
        }
    }

    pub(crate) fn look_at_standby(&mut self, place: usize, module_ns: u64) {
        let partition = &mut self.partitions[place];
        let limit_ns = self.plan[partition.active.sandbox.id].startup_timeout_ns;
        let Some((event, found)) = partition.look_at_standby(limit_ns) else { return };
        if let Some((error, detail)) = found {
            self.record_standby_loss(place, error, &detail, module_ns);
        }
        self.feed(place, Event::Standby(event), module_ns);
    }

    /// The process that stood by is lost, which is no health error of the partition.
    fn record_standby_loss(&mut self, place: usize, error: PartitionError, detail: &str, module_ns: u64) {
        let partition = &self.partitions[place];
        let standby = partition.standby.as_ref().filter(|_| error != PartitionError::Killed);
        let words = standby.and_then(|standby| standby.sandbox.last_words());
        let detail = words.map_or_else(|| detail.to_owned(), |words| format!("{detail}: {words}"));
        let (action, next) = match partition.life.gives_standby_up(module_ns) {
            true => ("ignore", "and is given up"),
            false => (NEW_STANDBY, "and is replaced"),
        };
        let entry = Fault {
            generation: partition.life.generation() + 1,
            action: action.into(),
            ..partition.entry(error.name(), Decision::Ignore, format!("the standby {detail}"), module_ns)
        };
        self.kept.enter(&entry);
        self.say(place, format!("its standby {detail}, {next}"), module_ns);
    }
}

/// Faults: decided by the tables, told, carried out.
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
        let partition = &mut self.partitions[place];
        let module_ignores = health.module.action(ModuleError::PartitionError) == ModuleAction::Ignore;
        if goes_on_after(error, decision, module_ignores)
            && !partition.repeats.is_told(error, decision, &detail, module_ns)
        {
            return;
        }
        self.decided(place, error.name(), decision, detail, situation.alive, module_ns);
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
    fn decided(
        &mut self,
        place: usize,
        error: &str,
        decision: Decision,
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
        let event = Event::Decided { decision, survives, asked: error == OWN_REQUEST };
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
    fn open_fault(&mut self, place: usize, fault: Fault) {
        if let Some(before) = self.partitions[place].fault.replace(fault) {
            self.kept.health_log.write(&before);
        }
    }

    /// Makes known what has been decided about a fault of the partition at `place`.
    fn tell_fault(&mut self, place: usize, fault: &Fault) {
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

/// Channels.
impl Monitor {
    pub(crate) fn look_at_channel_cleaner(&mut self) {
        self.tend_channels();
        let module_ns = self.module_ns;
        while let Some(Cleaned { place, member, pid, bad }) = self.cleanups.next_cleaned() {
            let Some(dead) = self.partitions[place].member(member) else { continue };
            // Another one may have died there meanwhile, and waits for a clean-up of its own.
            if dead.remains.take_if(|remains| *remains == pid).is_none() {
                continue;
            }
            let event = cleaned(member, !bad.is_empty());
            if member == PairMember::Active {
                self.partitions[place].damaged = bad;
            }
            self.feed(place, event, module_ns);
        }
    }

    /// Sees that every channel is held before somebody is cleaned up after: a clean-up takes away a channel that only the dead one holds.
    fn tend_channels(&mut self) {
        if self.cleanups.are_waiting() {
            let bad = self.rebuilds.tend();
            if !bad.is_empty() {
                self.rebuild(None, &bad, self.module_ns);
            }
        }
    }

    /// Looks at the examination under way, and does what follows from it.
    pub(crate) fn look_at_channel_probe(&mut self, module_ns: u64) {
        while let Some((place, damaged)) = self.rebuilds.next_examined() {
            if self.partitions[place].life.phase() != Phase::Examining {
                continue; // somebody has seen to it meanwhile
            }
            if !damaged.is_empty() {
                self.rebuild(Some(place), &damaged, module_ns);
            }
            return self.feed(place, Event::Examined, module_ns);
        }
    }

    /// Makes `damaged` anew; everybody who was attached is restarted, but the partition at `place`, who waits for them.
    fn rebuild(&mut self, place: Option<usize>, damaged: &[String], module_ns: u64) {
        self.cleanups.set_back(damaged);
        let attached: Vec<usize> =
            (0..self.partitions.len()).filter(|other| self.is_attached(*other, damaged)).collect();
        let alive = |other: &usize| self.partitions[*other].life.has_process();
        let ended: Vec<usize> = attached.iter().copied().filter(alive).collect();
        // Nobody may be left who maps the old ones.
        attached.iter().for_each(|other| self.feed(*other, Event::Detach, module_ns));
        let made = self.rebuilds.rebuild(damaged);
        let names = damaged.join(", ");
        let text = match &made {
            Ok(()) => format!("channels made anew: {names}"),
            Err(error) => format!("channels can not be made anew: {names}: {error}"),
        };
        if let Some(teller) = place.or_else(|| ended.first().copied()) {
            self.say(teller, text, module_ns);
        }
        for other in attached.into_iter().filter(|other| Some(*other) != place) {
            if ended.contains(&other) {
                self.restart_for_channels(other, &names, module_ns);
            } else if made.is_ok() {
                self.feed(other, Event::ChannelsRenewed, module_ns);
            }
        }
    }

    fn is_attached(&self, place: usize, channels: &[String]) -> bool {
        let own = attached_channels(&self.plan, self.partitions[place].active.sandbox.id);
        own.iter().any(|channel| channels.contains(channel))
    }

    /// The partition has been ended because of its channels, and is no less for it.
    fn restart_for_channels(&mut self, place: usize, names: &str, module_ns: u64) {
        let warm = self.plan[self.partitions[place].active.sandbox.id].restart.start == StartMode::Warm;
        let detail = format!("its channel was damaged and is made anew ({names})");
        let decision = Decision::Restart { warm };
        let fault =
            self.partitions[place].entry(PartitionError::PortError.name(), decision, detail, module_ns);
        self.tell_fault(place, &fault);
        self.open_fault(place, fault);
        self.partitions[place].active.skip_reports();
        self.feed(place, Event::Reattach, module_ns);
    }
}

fn cleaned(member: PairMember, damaged: bool) -> Event {
    match member {
        PairMember::Active => Event::CleanedUp { damaged },
        PairMember::Standby => Event::Standby(StandbyEvent::CleanedUp),
    }
}
