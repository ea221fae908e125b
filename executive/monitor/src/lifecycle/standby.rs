//! The process that stands by for a partition: started with the module and held. A hot one has initialised, and is active at the
//! partition's next window when the one before it is gone. A spare has not begun: it is the partition's next process, and initialises when
//! that is wanted.
//!
//! It is launched behind a process that has had a window, once nothing is left of what was there before: never while the partition itself
//! is being brought back. A restart that does without it ends it, because its incarnation would be counted wrong.
//!
//! ```text
//! Absent ──first window──▶ Launching ──▶ Starting ──Ready──▶ Ready ──the other one dies──▶ active, or begins
//!    ▲                                       └──Died, Overdue──┴──▶ CleaningUp ──CleanedUp──┐
//!    └──────────────────────────────────────────────────────────────────────────────────────┘
//! ```

use bateleur_contract::Clock;
use bateleur_plan::{Restart, Standby as Kind};

use super::protocol::{Command, Event, Instant, PairMember, StandbyEvent, clean_up};

/// Where a standby is in its life.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum StandbyState {
    /// There is none.
    #[default]
    Absent,
    /// It is being started.
    Launching,
    /// It initialises.
    Starting,
    /// It sleeps, and can be called, or let begin.
    Ready,
    /// What it left in shared memory, or the one that it followed, is being removed.
    CleaningUp,
}

/// See the module's head.
#[derive(Debug, Clone)]
pub(super) struct Standby {
    kind: Kind,
    state: StandbyState,
    /// Module time of its losses, ns.
    losses: Vec<u64>,
    /// It was lost too often, or can not be started: the partition goes on without.
    given_up: bool,
    /// Virtual clock: it can be called from this instant of module time on, ns.
    ready_from_ns: u64,
}

impl Standby {
    pub(super) fn new(kind: Kind) -> Self {
        Self { kind, state: StandbyState::Absent, losses: Vec::new(), given_up: false, ready_from_ns: 0 }
    }

    /// `generation`: of the incarnation that it is to become. `restart`: what the plan says of the partition's.
    pub(super) fn handle(
        &mut self,
        event: Event,
        generation: u32,
        restart: &Restart,
        clock: Clock,
        now: Instant,
        commands: &mut Vec<Command>,
    ) {
        match (event, self.state) {
            (Event::Begin, StandbyState::Absent) => self.launch(generation, 0, commands),
            (Event::Standby(StandbyEvent::Launched), StandbyState::Launching) => {
                self.state = StandbyState::Starting;
            }
            (Event::Standby(StandbyEvent::NotLaunched), StandbyState::Launching) => {
                self.state = StandbyState::Absent;
                self.given_up = true;
            }
            (Event::Standby(StandbyEvent::Ready), StandbyState::Starting) => {
                self.state = StandbyState::Ready;
                commands.push(Command::AdmitStandby);
            }
            (Event::Standby(StandbyEvent::Died), StandbyState::Starting | StandbyState::Ready) => {
                commands.push(Command::EndStandbyRemains);
                self.lose(now.module_ns, restart);
                clean_up(PairMember::Standby, clock, commands);
            }
            (Event::Standby(StandbyEvent::Overdue), StandbyState::Starting) => {
                commands.push(Command::EndStandby);
                self.lose(now.module_ns, restart);
                clean_up(PairMember::Standby, clock, commands);
            }
            (Event::Standby(StandbyEvent::CleanedUp), StandbyState::CleaningUp) => {
                self.state = StandbyState::Absent;
            }
            _ => {}
        }
    }

    /// It is gone. That is no health error of the partition, which goes on.
    fn lose(&mut self, module_ns: u64, restart: &Restart) {
        self.state = StandbyState::CleaningUp;
        self.given_up = self.is_last_loss(module_ns, restart);
        self.losses.retain(|at| module_ns.saturating_sub(*at) < restart.within_ns);
        self.losses.push(module_ns);
    }

    /// Whether it is given up if it is lost at `module_ns`: it is, by the partition's budget, where it is lost again and again.
    pub(super) fn is_last_loss(&self, module_ns: u64, restart: &Restart) -> bool {
        let is_recent = |at: &&u64| module_ns.saturating_sub(**at) < restart.within_ns;
        self.losses.iter().filter(is_recent).count() as u32 >= restart.budget
    }

    /// Launches one that can be called from `ready_from_ns` on, where there is none and one is wanted.
    pub(super) fn launch(&mut self, generation: u32, ready_from_ns: u64, commands: &mut Vec<Command>) {
        if self.state != StandbyState::Absent || self.given_up {
            return;
        }
        self.state = StandbyState::Launching;
        self.ready_from_ns = ready_from_ns;
        commands.push(Command::LaunchStandby { generation });
    }

    /// It has taken over, and the one that it followed is cleaned up after in its place.
    pub(super) fn has_followed(&mut self) {
        self.state = StandbyState::CleaningUp;
    }

    /// It has begun in the place of one of whom nothing is left.
    pub(super) fn has_left(&mut self) {
        self.state = StandbyState::Absent;
    }

    pub(super) fn is_spare(&self) -> bool {
        self.kind == Kind::Spare
    }

    /// Whether it can be called at `module_ns`.
    pub(super) fn can_take_over(&self, module_ns: u64) -> bool {
        !self.is_spare() && self.state == StandbyState::Ready && module_ns >= self.ready_from_ns
    }

    /// Whether it is a spare that can begin.
    pub(super) fn can_begin(&self) -> bool {
        self.is_spare() && self.state == StandbyState::Ready
    }

    pub(super) fn state(&self) -> StandbyState {
        self.state
    }

    fn has_process(&self) -> bool {
        matches!(self.state, StandbyState::Starting | StandbyState::Ready)
    }

    /// Its process is ended; false: it has none.
    pub(super) fn end(&mut self) -> bool {
        let has_process = self.has_process();
        if has_process {
            self.state = StandbyState::CleaningUp;
        }
        has_process
    }

    /// The partition begins anew, with a new budget: so does what stands by for it.
    pub(super) fn forget_losses(&mut self) {
        self.losses.clear();
        self.given_up = false;
    }
}

/// What stands by, in words.
#[must_use]
pub fn noun(kind: Kind) -> &'static str {
    match kind {
        Kind::Hot => "standby",
        Kind::Spare => "spare",
    }
}
