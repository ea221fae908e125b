//! The life cycle of one partition: a state machine that turns events into commands.
//!
//! It does no input or output and reads no clock: the time comes with each event, and whoever drives it carries the commands out, in
//! their order, before it brings the next event of its own. It must never have two processes started for the same place, and never
//! leave a dead one without what was decided about its death.
//!
//! ```text
//! Starting ──Ready──▶ Running ──Died──▶ Dead ──Decided──▶ CleaningUp ──CleanedUp──▶ Launching ──Launched──▶ Starting
//!     └──Died, Overdue──────────────────▲ │                  │    └──a channel is damaged──▶ Examining ──▶ Launching
//!                                         │                  └──nothing is to follow──▶ Resting
//!                                         └──a standby is ready──▶ TakingOver ──TookOver──▶ Running
//!                                         └──a spare is ready──▶ Beginning ──Begun──▶ Starting
//! Launching ──NotLaunched──▶ Retrying ──Look, when it is time──▶ Launching
//! ```
//!
//! A spare begins at once where an error has ended the one before, whose remains are removed when it is ready: on the wall clock. On the virtual one,
//! where peers can notice an instant only, and where something else than an error ends a process, it begins in the place of a launch.

mod protocol;
mod standby;
#[cfg(test)]
mod tests;

use bateleur_contract::{Clock, StartCondition};
use bateleur_plan::{ChangeAction, PartitionState, Restart, Standby as Kind, StartMode};
use bateleur_time::partition_control::Readiness;

use crate::health::decision::{Decision, decide_restart};
use protocol::clean_up;
pub use protocol::{Cause, Command, Event, Instant, PairMember, StandbyEvent};
use standby::Standby;
pub use standby::{StandbyState, noun};

/// The first wait before a launch that failed is tried again, ns; each later one is twice as long.
const FIRST_RETRY_NS: u64 = 50_000_000;
/// How often that wait doubles, most.
const DOUBLINGS: u32 = 6;

/// Until when a partition without a process rests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// A change of schedule made it idle, and another one may bring it back.
    Change,
    /// An operator, its tables, its budget or itself stopped it: only an operator starts it again.
    Started,
}

/// What follows when nothing is left of a dead process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// A successor.
    Successor,
    /// Nothing.
    Rest(Until),
}

/// Where a partition is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Its process initialises.
    Starting,
    /// Its process takes windows.
    Running,
    /// Its process has ended, and it is not decided yet what follows.
    Dead,
    /// Its standby was called.
    TakingOver,
    /// Its spare is being let begin. `true`: nothing is left of the one before.
    Beginning(bool),
    /// What its dead process left in shared memory is being removed.
    CleaningUp(Next),
    /// Its channels are being examined, before it is launched.
    Examining,
    /// A process is being started.
    Launching,
    /// The machine could not start a process, and is asked again at this instant of CLOCK_MONOTONIC, ns.
    Retrying(u64),
    /// It has no process, and gets none by itself.
    Resting(Until),
    /// The module ends. `true`: it still has a process.
    Ending(bool),
}

/// See the module's head.
#[derive(Debug, Clone)]
pub struct Lifecycle {
    restart: Restart,
    clock: Clock,
    phase: Phase,
    standby: Option<Standby>,
    generation: u32,
    next_start: StartCondition,
    /// The last process failed before it was ready.
    start_failed: bool,
    /// This process had a window.
    had_window: bool,
    /// An operator holds it, also a successor that becomes ready meanwhile.
    held: bool,
    /// Module time of the restarts that count in its budget, ns.
    restarts: Vec<u64>,
    /// Of those that it has asked for itself.
    own_restarts: Vec<u64>,
}

/// How often within [`OWN_WITHIN_NS`] a partition may start itself anew before that counts in its budget.
const MOST_OWN: usize = 20;
/// Module time, ns.
const OWN_WITHIN_NS: u64 = 10_000_000_000;

impl Lifecycle {
    /// Of a partition whose first process has been launched.
    #[must_use]
    pub fn new(restart: Restart, clock: Clock, standby: Option<Kind>) -> Self {
        Self {
            restart,
            clock,
            phase: Phase::Starting,
            standby: standby.map(Standby::new),
            generation: 0,
            next_start: StartCondition::NormalStart,
            start_failed: false,
            had_window: false,
            held: false,
            restarts: Vec::new(),
            own_restarts: Vec::new(),
        }
    }

    /// Takes notice of `event`. What is given must be carried out in its order; an event that does not fit changes nothing.
    #[must_use]
    pub fn handle(&mut self, event: Event, now: Instant) -> Vec<Command> {
        let mut commands = Vec::new();
        if let Phase::Ending(alive) = self.phase {
            self.handle_at_end(event, alive, &mut commands);
            return commands;
        }
        match event {
            Event::Stop | Event::Start | Event::Freeze | Event::Thaw | Event::Schedule(_) => {
                self.obey(event, now, &mut commands);
            }
            Event::Detach | Event::Reattach | Event::ChannelsRenewed => {
                self.change_channels(event, now, &mut commands);
            }
            Event::Decided { decision, survives, cause } => {
                self.apply(decision, survives, cause, now, &mut commands);
            }
            Event::Begin | Event::Standby(_) => {
                let generation = self.generation + 1;
                if let Some(standby) = &mut self.standby {
                    standby.handle(event, generation, &self.restart, self.clock, now, &mut commands);
                }
            }
            Event::End | Event::EndNow => self.end(&mut commands),
            _ => self.handle_process(event, now, &mut commands),
        }
        commands
    }

    fn handle_process(&mut self, event: Event, now: Instant, commands: &mut Vec<Command>) {
        match (event, self.phase) {
            (Event::Ready, Phase::Starting) => {
                self.start_failed = false;
                self.phase = Phase::Running;
                commands.push(Command::Admit { held: self.held });
            }
            (Event::Overdue, Phase::Starting) => self.start_failed = true,
            (Event::Died, Phase::Starting | Phase::Running) => {
                self.start_failed |= self.phase == Phase::Starting;
                self.phase = Phase::Dead;
                commands.push(Command::EndRemains);
            }
            (Event::WindowUsed, Phase::Running) => self.had_window = true,
            (Event::CleanedUp { damaged }, Phase::CleaningUp(Next::Successor))
                if damaged || self.start_failed =>
            {
                self.phase = Phase::Examining;
                commands.push(Command::Examine);
            }
            (Event::CleanedUp { .. }, Phase::CleaningUp(Next::Successor))
            | (Event::Examined, Phase::Examining) => self.launch(commands),
            (Event::CleanedUp { .. }, Phase::CleaningUp(Next::Rest(until))) => {
                self.phase = Phase::Resting(until);
            }
            (Event::Launched, Phase::Launching) => {
                self.generation += 1;
                self.phase = Phase::Starting;
            }
            (Event::NotLaunched, Phase::Launching) => {
                let doublings = self.recent_restarts(now.module_ns).min(DOUBLINGS);
                self.phase = Phase::Retrying(now.real_ns + (FIRST_RETRY_NS << doublings));
            }
            (Event::TookOver, Phase::TakingOver) => {
                self.generation += 1;
                self.had_window = false;
                self.phase = Phase::Running;
                if let Some(standby) = &mut self.standby {
                    standby.has_followed();
                }
                clean_up(PairMember::Standby, self.clock, commands);
            }
            (Event::NotTakenOver, Phase::TakingOver) => {
                self.phase = Phase::Dead;
                self.follow(now, commands);
            }
            (Event::Begun, Phase::Beginning(buried)) => self.has_begun(buried, commands),
            (Event::NotBegun, Phase::Beginning(true)) => self.launch_anew(commands),
            (Event::NotBegun, Phase::Beginning(false)) => {
                self.phase = Phase::Dead;
                self.end_standby(commands);
                self.follow(now, commands);
            }
            (Event::Look, Phase::Retrying(at_ns)) if now.real_ns >= at_ns => self.launch(commands),
            (Event::Look, Phase::Running) if self.had_window => {
                let generation = self.generation + 1;
                if let Some(standby) = &mut self.standby {
                    standby.launch(generation, now.module_ns + self.restart.startup_ns, commands);
                }
            }
            _ => {}
        }
    }

    /// Does what was decided about an error.
    fn apply(
        &mut self,
        decision: Decision,
        survives: bool,
        cause: Cause,
        now: Instant,
        commands: &mut Vec<Command>,
    ) {
        if !self.has_process() && !matches!(self.phase, Phase::Dead | Phase::Retrying(_)) {
            return;
        }
        match decision {
            Decision::Ignore | Decision::Handler | Decision::Module if survives && self.has_process() => {}
            // Whatever the module makes of it, nothing starts it again.
            Decision::Ignore | Decision::Handler | Decision::Module | Decision::Idle | Decision::Stop => {
                self.rest(Until::Started, commands);
            }
            Decision::Restart { warm } => {
                self.restarts.retain(|at| now.module_ns.saturating_sub(*at) < self.restart.within_ns);
                self.own_restarts.retain(|at| now.module_ns.saturating_sub(*at) < OWN_WITHIN_NS);
                match cause {
                    Cause::Partition => self.own_restarts.push(now.module_ns),
                    _ => self.restarts.push(now.module_ns),
                }
                self.next_start = match (warm, cause) {
                    (true, Cause::Health) => StartCondition::HmPartitionWarmRestart,
                    (false, Cause::Health) => StartCondition::HmPartitionColdRestart,
                    (true, _) => StartCondition::PartitionWarmRestart,
                    (false, _) => StartCondition::PartitionRestart,
                };
                self.end_process(commands);
                if self.phase == Phase::Dead && self.can_take_over(now.module_ns) {
                    self.phase = Phase::TakingOver;
                    return commands.push(Command::TakeOver { warm });
                }
                if self.phase == Phase::Dead && self.clock == Clock::Wall && self.can_begin_spare() {
                    return self.begin_spare(false, commands);
                }
                self.follow(now, commands);
            }
        }
    }

    /// Orders of operators, and changes of schedule.
    fn obey(&mut self, event: Event, now: Instant, commands: &mut Vec<Command>) {
        match event {
            Event::Stop if self.can_stop() => {
                self.held = false;
                self.start_failed = false; // it is the operator who keeps it from running
                self.rest(Until::Started, commands);
            }
            Event::Start if self.can_start() => {
                self.restarts.clear();
                self.own_restarts.clear();
                if let Some(standby) = &mut self.standby {
                    standby.forget_losses();
                }
                self.next_start = StartCondition::PartitionRestart;
                self.follow(now, commands);
            }
            Event::Freeze if !self.held => {
                self.held = true;
                commands.extend((self.phase == Phase::Running).then_some(Command::Hold));
            }
            Event::Thaw if self.held => {
                self.held = false;
                commands.extend((self.phase == Phase::Running).then_some(Command::Release));
            }
            Event::Schedule(action) if self.can_change(action) => {
                self.start_failed = false;
                if action == ChangeAction::Idle {
                    return self.rest(Until::Change, commands);
                }
                self.next_start = match action {
                    ChangeAction::WarmRestart => StartCondition::HmPartitionWarmRestart,
                    _ => StartCondition::HmPartitionColdRestart,
                };
                self.end_process(commands);
                self.follow(now, commands);
            }
            _ => {}
        }
    }

    /// Channels that are made anew: who was attached is started again, which is no fault of its own and costs it nothing.
    fn change_channels(&mut self, event: Event, now: Instant, commands: &mut Vec<Command>) {
        match (event, self.phase) {
            (Event::Detach, _) => {
                self.end_process(commands);
                if self.standby.as_mut().is_some_and(Standby::end) {
                    // Not waited for: the channels are to be made anew first.
                    commands.extend([Command::EndStandby, Command::CleanUp(PairMember::Standby)]);
                }
            }
            (Event::Reattach, Phase::Dead) => {
                self.next_start = match self.restart.start {
                    StartMode::Warm => StartCondition::HmPartitionWarmRestart,
                    StartMode::Cold => StartCondition::HmPartitionColdRestart,
                };
                self.follow(now, commands);
            }
            // It could not start because of them: one more start. Its budget is what it is, or two that damage what they share
            // would bring each other back for ever.
            (Event::ChannelsRenewed, Phase::Resting(_) | Phase::CleaningUp(Next::Rest(_)))
                if self.start_failed =>
            {
                self.follow(now, commands);
            }
            _ => {}
        }
    }

    fn end(&mut self, commands: &mut Vec<Command>) {
        if self.standby.as_mut().is_some_and(Standby::end) {
            commands.push(Command::EndStandby); // it has nothing to finish
        }
        commands.push(Command::AskToStop);
        self.phase = Phase::Ending(self.has_process());
    }

    fn handle_at_end(&mut self, event: Event, alive: bool, commands: &mut Vec<Command>) {
        match event {
            Event::Died => self.phase = Phase::Ending(false),
            Event::EndNow => {
                commands.extend(alive.then_some(Command::EndProcess));
                self.phase = Phase::Ending(false);
            }
            _ => {}
        }
    }

    /// Makes sure that it has no process.
    fn end_process(&mut self, commands: &mut Vec<Command>) {
        if self.has_process() {
            commands.push(Command::EndProcess);
            self.phase = Phase::Dead;
        }
    }

    /// No process follows by itself.
    fn rest(&mut self, until: Until, commands: &mut Vec<Command>) {
        self.end_process(commands);
        if self.phase == Phase::Examining {
            commands.push(Command::ForgetExamination);
        }
        let readiness = match until {
            Until::Change => Readiness::Idle,
            Until::Started => Readiness::Stopped,
        };
        commands.extend([Command::CloseFault, Command::Windows(readiness)]);
        self.end_standby(commands);
        self.phase = match self.phase {
            Phase::Dead | Phase::TakingOver | Phase::Beginning(_) | Phase::CleaningUp(_) => {
                clean_up(PairMember::Active, self.clock, commands);
                Phase::CleaningUp(Next::Rest(until))
            }
            _ => Phase::Resting(until),
        };
    }

    /// A successor follows when nothing is left of the dead one.
    fn follow(&mut self, now: Instant, commands: &mut Vec<Command>) {
        self.had_window = false;
        if !self.standby.as_ref().is_some_and(Standby::is_spare) {
            self.end_standby(commands);
        }
        commands.push(Command::Windows(Readiness::Absent));
        if self.clock == Clock::Virtual {
            commands.push(Command::NotBefore(now.module_ns + self.restart.startup_ns));
        }
        match self.phase {
            Phase::Dead | Phase::CleaningUp(_) => {
                self.phase = Phase::CleaningUp(Next::Successor);
                commands.push(Command::CleanUp(PairMember::Active));
            }
            Phase::Resting(_) => self.launch(commands),
            _ => {} // it is on its way already
        }
    }

    fn launch(&mut self, commands: &mut Vec<Command>) {
        if self.can_begin_spare() {
            return self.begin_spare(true, commands);
        }
        self.launch_anew(commands);
    }

    /// `buried`: nothing is left of the one before.
    fn begin_spare(&mut self, buried: bool, commands: &mut Vec<Command>) {
        self.had_window = false;
        self.phase = Phase::Beginning(buried);
        commands.push(Command::BeginSpare { condition: self.next_start });
    }

    fn has_begun(&mut self, buried: bool, commands: &mut Vec<Command>) {
        self.generation += 1;
        self.phase = Phase::Starting;
        let Some(standby) = &mut self.standby else { return };
        if buried {
            return standby.has_left();
        }
        standby.has_followed();
        clean_up(PairMember::Standby, self.clock, commands);
    }

    /// Without a spare, which is not ready or does not begin.
    fn launch_anew(&mut self, commands: &mut Vec<Command>) {
        self.end_standby(commands);
        self.phase = Phase::Launching;
        commands.push(Command::Launch { generation: self.generation + 1, condition: self.next_start });
    }

    /// An ordinary restart, or none at all, follows: nobody stands by meanwhile.
    fn end_standby(&mut self, commands: &mut Vec<Command>) {
        self.had_window = false;
        if self.standby.as_mut().is_some_and(Standby::end) {
            commands.push(Command::EndStandby);
            clean_up(PairMember::Standby, self.clock, commands);
        }
    }

    /// Whether the partition's next window can be that of the standby, as far as it is known.
    #[must_use]
    pub fn can_take_over(&self, module_ns: u64) -> bool {
        let at_ns = if self.clock == Clock::Wall { u64::MAX } else { module_ns };
        self.standby.as_ref().is_some_and(|standby| standby.can_take_over(at_ns))
    }

    fn can_begin_spare(&self) -> bool {
        self.standby.as_ref().is_some_and(Standby::can_begin)
    }

    /// Whether its standby is a spare.
    #[must_use]
    pub fn has_spare(&self) -> bool {
        self.standby.as_ref().is_some_and(Standby::is_spare)
    }

    /// Whether the standby is not replaced if it is lost at `module_ns`.
    #[must_use]
    pub fn gives_standby_up(&self, module_ns: u64) -> bool {
        self.standby.as_ref().is_some_and(|standby| standby.is_last_loss(module_ns, &self.restart))
    }

    /// Where the standby is in its life; `None` if the partition has none.
    #[must_use]
    pub fn standby(&self) -> Option<StandbyState> {
        self.standby.as_ref().map(Standby::state)
    }

    /// Restarts that count in its budget at `module_ns`.
    #[must_use]
    pub fn recent_restarts(&self, module_ns: u64) -> u32 {
        let is_recent = |at: &&u64| module_ns.saturating_sub(**at) < self.restart.within_ns;
        self.restarts.iter().filter(is_recent).count() as u32
    }

    /// It has started itself anew so often lately that once more counts in its budget: each start costs the processors that partitions leave.
    #[must_use]
    pub fn restarts_itself_too_often(&self, module_ns: u64) -> bool {
        let is_recent = |at: &&u64| module_ns.saturating_sub(**at) < OWN_WITHIN_NS;
        self.own_restarts.iter().filter(is_recent).count() >= MOST_OWN
    }

    /// What is done about a launch that the machine could not do: a restart like any other, as warm as the last one, because nothing of
    /// the partition has run.
    #[must_use]
    pub fn decide_relaunch(&self, module_ns: u64) -> Decision {
        decide_restart(&self.restart, self.next_start.is_warm(), self.recent_restarts(module_ns))
    }

    /// What it is at, or was when it died. `in_handler`: its control page says that its error handler runs.
    #[must_use]
    pub fn state(&self, in_handler: bool) -> PartitionState {
        match self.phase {
            _ if self.start_failed => PartitionState::Start,
            Phase::Starting => PartitionState::Start,
            _ if in_handler => PartitionState::Handler,
            _ => PartitionState::Normal,
        }
    }

    /// Whether its last process failed before it was ready.
    #[must_use]
    pub fn start_failed(&self) -> bool {
        self.start_failed
    }

    /// Where it is in its life.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Which incarnation it has, or had last.
    #[must_use]
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// Whether an operator holds it.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held
    }

    /// Whether it has a process.
    #[must_use]
    pub fn has_process(&self) -> bool {
        matches!(self.phase, Phase::Starting | Phase::Running | Phase::Ending(true))
    }

    /// Whether a successor is on its way.
    #[must_use]
    pub fn is_coming(&self) -> bool {
        matches!(
            self.phase,
            Phase::Starting
                | Phase::CleaningUp(Next::Successor)
                | Phase::Examining
                | Phase::Launching
                | Phase::Retrying(_)
        )
    }

    /// Whether an operator can stop it.
    #[must_use]
    pub fn can_stop(&self) -> bool {
        let idle = matches!(
            self.phase,
            // A change of schedule might bring it back.
            Phase::Resting(Until::Change) | Phase::CleaningUp(Next::Rest(Until::Change))
        );
        self.has_process() || self.is_coming() || idle
    }

    /// Whether an operator can start it.
    #[must_use]
    pub fn can_start(&self) -> bool {
        matches!(self.phase, Phase::Resting(_) | Phase::CleaningUp(Next::Rest(_)))
    }

    /// Whether a change of schedule that wants `action` changes anything.
    #[must_use]
    pub fn can_change(&self, action: ChangeAction) -> bool {
        let is_stopped = matches!(
            self.phase,
            Phase::Resting(Until::Started) | Phase::CleaningUp(Next::Rest(Until::Started))
        );
        match action {
            ChangeAction::Ignore => false,
            // A process that is starting has no state to keep.
            ChangeAction::WarmRestart if self.phase == Phase::Starting => false,
            _ => !self.held && !is_stopped,
        }
    }
}
