//! Carries out what the life cycles of partitions command.
//!
//! It decides nothing itself. It must never wait for a process for longer than a step, but where no time passes: before frame 0, at the
//! end, and on the virtual clock.

use std::io;

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{Clock, StartCondition};

use crate::cleanup::CleanupOrder;
use crate::health::decision::Decision;
use crate::lifecycle::{
    Cause, Command, Event, Instant, Next, PairMember, Phase, StandbyEvent, StandbyState, noun,
};
use crate::monitor::Monitor;
use crate::rebuild::Suspicion;
use bateleur_host::partition::shared_channels;
use bateleur_plan::ModuleError;
use bateleur_system::time::now_ns;

/// What the log calls a successor that the machine could not start.
const NOT_STARTED: &str = "not_started";
/// How long a process may take from the call until it has taken over, real time, ns: it attaches its queues and loads what was
/// retained, well below a millisecond each. The monitor waits so long, so that the next window is the successor's.
const CALL_PATIENCE_NS: u64 = 20_000_000;
/// As above on the virtual clock, where nobody's time passes meanwhile.
const VIRTUAL_CALL_PATIENCE_NS: u64 = 2_000_000_000;

impl Monitor {
    /// Brings `event` to the life cycle of the partition at `place`, and carries out what that commands.
    pub(crate) fn feed(&mut self, place: usize, event: Event, module_ns: u64) {
        let now = Instant { module_ns, real_ns: now_ns() };
        for command in self.partitions[place].life.handle(event, now) {
            self.carry_out(place, command, module_ns);
        }
    }

    /// A replica starts with what another one has retained, or it would differ from then on: a cold start becomes a warm one.
    fn as_replica(&self, place: usize, command: Command) -> Command {
        let starts =
            matches!(command, Command::Launch { .. } | Command::TakeOver { .. } | Command::BeginSpare { .. });
        // What it took up may be what its start failed of.
        if !starts || self.partitions[place].life.start_failed() || !self.has_memory_of_another(place) {
            return command;
        }
        let condition = StartCondition::HmPartitionWarmRestart;
        match command {
            Command::Launch { generation, .. } => Command::Launch { generation, condition },
            Command::TakeOver { .. } => Command::TakeOver { warm: true },
            Command::BeginSpare { .. } => Command::BeginSpare { condition },
            other => other,
        }
    }

    /// Copies what another replica of the partition at `place` retains; false: it has none that runs here, or it retains nothing.
    fn has_memory_of_another(&self, place: usize) -> bool {
        let own = &self.partitions[place].active.sandbox;
        let Some(voter) = self.plan.voter_of(own.id) else { return false };
        let other = |one: &&crate::partition::Partition| {
            let id = one.active.sandbox.id;
            id != own.id && self.plan[voter].replicas.contains(&id) && one.runs()
        };
        // What was retained is not all that a partition knows: the one that was started again least often knows most.
        let mut others: Vec<_> = self.partitions.iter().filter(other).collect();
        others.sort_by_key(|other| other.life.generation());
        others.iter().any(|other| own.take_up(&other.active.sandbox).unwrap_or(false))
    }

    fn carry_out(&mut self, place: usize, command: Command, module_ns: u64) {
        let command = self.as_replica(place, command);
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
            Command::BeginSpare { condition } => self.begin_spare(place, condition, module_ns),
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
        // A spare that has never begun has left nothing.
        let pid = dead.remains.filter(|_| !dead.waits);
        let Some(pid) = pid else {
            dead.remains = None;
            return self.feed(place, cleaned(member, false), module_ns);
        };
        dead.sandbox.detach();
        let order = CleanupOrder {
            pid,
            user: dead.sandbox.own_user(),
            channels: shared_channels(&self.plan, dead.sandbox.id),
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
        self.decided(place, NOT_STARTED, (decision, Cause::Health), detail, false, module_ns);
        if !matches!(decision, Decision::Restart { .. }) {
            self.module_fault(ModuleError::ConfigError, &text, true, module_ns);
        }
    }

    fn launch_standby(&mut self, place: usize, generation: u32, module_ns: u64) {
        let kind = self.plan[self.partitions[place].active.sandbox.id].standby;
        let Some((standby, kind)) = self.partitions[place].standby.as_mut().zip(kind) else { return };
        let event = match standby.launch_standby(generation, kind) {
            Ok(()) => StandbyEvent::Launched,
            Err(error) => {
                self.say(place, format!("its {} can not be started: {error}", noun(kind)), module_ns);
                StandbyEvent::NotLaunched
            }
        };
        self.feed(place, Event::Standby(event), module_ns);
    }

    fn begin_spare(&mut self, place: usize, condition: StartCondition, module_ns: u64) {
        let told = self.no_window(module_ns);
        let partition = &mut self.partitions[place];
        let event = match partition.begin_spare(condition, &told) {
            true => {
                partition.figures.restarts += 1;
                Event::Begun
            }
            false => Event::NotBegun,
        };
        self.feed(place, event, module_ns);
    }

    /// What is told outside of windows.
    fn no_window(&self, module_ns: u64) -> WindowGrant {
        let schedule = self.schedule_switch.current();
        WindowGrant {
            start_ns: module_ns,
            minor_frame_ns: self.plan.schedules[schedule].minor_frame_ns,
            schedule: schedule as u32,
            schedule_since_ns: self.schedule_switch.changed_ns(),
            next_schedule: self.schedule_switch.next() as u32,
            ..WindowGrant::default()
        }
    }

    /// Puts the process that stands by in the place of the dead one, if it can.
    fn take_over(&mut self, place: usize, warm: bool, module_ns: u64) {
        let grant = self.no_window(module_ns);
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

/// Nothing is left of a dead process.
pub(crate) fn cleaned(member: PairMember, damaged: bool) -> Event {
    match member {
        PairMember::Active => Event::CleanedUp { damaged },
        PairMember::Standby => Event::Standby(StandbyEvent::CleanedUp),
    }
}
