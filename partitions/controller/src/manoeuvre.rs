//! What is flown in place of what was ordered before: a circle, the way back to the runway, a take-off, a landing.
//!
//! Responsible for who may begin and end it: the ground, Command where the ground is silent, the fence, a motor that gives nothing. Outside of the fence nothing else is
//! flown, and what the fence or a silent ground has begun goes on until the ground says otherwise.

use bateleur_flight::control::takeoff::Phase;
use bateleur_flight::control::{LoopCommands, landing};
use bateleur_flight::estimator::NavigationState;
use bateleur_flight::guidance::{Finish, Motion, Step, Waypoint};
use bateleur_messages::control::{
    TASK_ABORTED, TASK_CLIMBING, TASK_LANDED, TASK_LANDING, TASK_LOITER, TASK_LOOPS, TASK_MISSION,
    TASK_RETURN, TASK_ROLLING, TASK_WAITING,
};
use bateleur_messages::ground::{Manoeuvre, Reason};
use bateleur_messages::telemetry::Refusal;
use nalgebra::Vector2;

use crate::Function;
use crate::fence::{FenceAction, FenceWatch};
use crate::orders::Answer;

/// Slower than this over ground, m/s, and lower than this above the runway, m, the aircraft stands on it.
const STANDING_MPS: f64 = 3.0;
const STANDING_M: f64 = 15.0;

/// What is flown in place of what was ordered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Task {
    /// Nothing.
    #[default]
    Ordered,
    /// A circle.
    Loiter,
    /// A circle above the runway.
    Return,
    /// A landing on it.
    Land,
}

/// The task, and what belongs to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Tasks {
    pub(crate) task: Task,
    /// It waits for a state to begin with.
    pub(crate) begins: bool,
    /// The ground is silent: that is why.
    pub(crate) link_lost: bool,
    pub(crate) fence: FenceWatch,
}

/// Bits of [`Tasks::to_bits`].
const LOITER: u32 = 1;
const RETURN: u32 = 2;
const BEGINS: u32 = 4;
const LINK_LOST: u32 = 8;
const OUTSIDE: u32 = 16;
const ABOVE_FLOOR: u32 = 32;
const LAND: u32 = 64;

impl Tasks {
    /// As one number, to be kept.
    pub(crate) fn to_bits(self) -> u32 {
        let on = |on: bool, bit: u32| if on { bit } else { 0 };
        on(self.task == Task::Loiter, LOITER)
            | on(self.task == Task::Return, RETURN)
            | on(self.task == Task::Land, LAND)
            | on(self.begins, BEGINS)
            | on(self.link_lost, LINK_LOST)
            | on(self.fence.outside, OUTSIDE)
            | on(self.fence.above_floor, ABOVE_FLOOR)
    }

    /// The tasks again.
    pub(crate) fn from_bits(bits: u32) -> Self {
        let is = |bit: u32| bits & bit != 0;
        let task = match (is(LOITER), is(RETURN), is(LAND)) {
            (true, false, false) => Task::Loiter,
            (false, true, false) => Task::Return,
            (false, false, true) => Task::Land,
            _ => Task::Ordered,
        };
        let fence = FenceWatch { outside: is(OUTSIDE), above_floor: is(ABOVE_FLOOR) };
        Self { task, begins: is(BEGINS), link_lost: is(LINK_LOST), fence }
    }

    fn begin(&mut self, task: Task, link_lost: bool) {
        (self.task, self.begins, self.link_lost) = (task, true, link_lost);
    }

    /// What was ordered is flown again.
    pub(crate) fn end(&mut self) {
        (self.task, self.begins, self.link_lost) = (Task::Ordered, false, false);
    }
}

impl Function {
    /// Takes order `F`.
    pub(crate) fn manoeuvre(&mut self, what: Manoeuvre, reason: Reason) -> Answer {
        let by_itself = reason != Reason::Ordered;
        let link_lost = reason == Reason::LostLink || (by_itself && self.tasks.link_lost);
        let on_ground = self.is_on_ground();
        match what {
            Manoeuvre::TakeOff if self.standing => {
                self.controller.take_off(self.settings.take_off);
                self.tasks.end();
            }
            Manoeuvre::TakeOff => return Answer::Refused(Refusal::NotStanding),
            Manoeuvre::Abort if self.controller.abort_take_off() || self.controller.go_round() => {}
            Manoeuvre::Abort => return Answer::Refused(Refusal::NoTakeOff),
            // Again, or too late to fly.
            Manoeuvre::Land if self.tasks.task == Task::Land => {}
            Manoeuvre::Loiter | Manoeuvre::Return | Manoeuvre::Land | Manoeuvre::GoOn
                if self.has_landed() =>
            {
                return Answer::Refused(Refusal::NotFlying);
            }
            Manoeuvre::Loiter | Manoeuvre::Return | Manoeuvre::Land
                if !self.orders.autopilot || on_ground =>
            {
                return Answer::Refused(Refusal::NotFlying);
            }
            // Nothing that is lost waits for the way back into the fence.
            Manoeuvre::Land if by_itself => self.begin(Task::Land, link_lost),
            // The fence has the last word, and nothing that is lost calls an aircraft back that returns already.
            _ if self.tasks.fence.outside => return Answer::Refused(Refusal::OutsideFence),
            Manoeuvre::Loiter if by_itself && matches!(self.tasks.task, Task::Return | Task::Land) => {}
            Manoeuvre::Return if by_itself && self.tasks.task == Task::Land => {}
            Manoeuvre::Loiter => self.begin(Task::Loiter, link_lost),
            Manoeuvre::Return => self.begin(Task::Return, link_lost),
            Manoeuvre::Land => self.begin(Task::Land, link_lost),
            Manoeuvre::GoOn => self.go_on(),
        }
        Answer::Accepted
    }

    /// Before the take-off or after a landing.
    fn is_on_ground(&self) -> bool {
        let waits = |phase| matches!(phase, Phase::Waiting | Phase::Rolling | Phase::Aborted);
        self.controller.take_off_phase().is_some_and(waits) || self.has_landed()
    }

    fn begin(&mut self, task: Task, link_lost: bool) {
        self.controller.end_landing();
        self.tasks.begin(task, link_lost);
    }

    /// The ground holds the aircraft up after a landing.
    fn has_landed(&self) -> bool {
        self.controller.landing_phase().is_some_and(|phase| {
            matches!(phase, landing::Phase::Touched | landing::Phase::Rolling | landing::Phase::Standing)
        })
    }

    /// Back to what was ordered.
    pub(crate) fn go_on(&mut self) {
        if !self.controller.end_landing() {
            return; // on the ground there is nothing to go on with
        }
        if self.tasks.task != Task::Ordered {
            self.controller.guidance_mut().release();
            self.hold_altitude_m = None;
        }
        self.tasks.end();
    }

    /// Looks after fence and circles, before a cycle is flown.
    pub(crate) fn watch(&mut self, state: Option<&NavigationState>) {
        let Some(state) = state else { return };
        let speed = state.velocity.xy().norm();
        self.standing = speed < STANDING_MPS && state.altitude_m() < STANDING_M;
        if !self.orders.autopilot {
            self.tasks.fence = FenceWatch::default();
            return;
        }
        let fence = self.settings.fence;
        let left = self.tasks.fence.look(&fence, &self.areas, state);
        // A landing ends below any floor, and is not broken off.
        if left && self.tasks.task != Task::Land {
            match fence.action {
                FenceAction::None => {}
                FenceAction::Loiter => self.begin(Task::Loiter, false),
                FenceAction::Return => self.begin(Task::Return, false),
            }
        }
        // Nothing else can be flown for long.
        if self.controller.has_lost_power() && self.tasks.task != Task::Land && !self.is_on_ground() {
            self.begin(Task::Land, false);
        }
        if std::mem::take(&mut self.tasks.begins) {
            self.begin_circle(state);
        }
        // What the ground has ordered ends with the mission; the fence and a silent ground go on with theirs.
        let free = self.tasks.task == Task::Ordered && self.controller.take_off_phase().is_none();
        if free && self.orders.navigation {
            self.follow_mission();
        }
    }

    /// What a mission asks for that guidance does not fly: the take-off that it begins with, and what it ends with.
    fn follow_mission(&mut self) {
        let guidance = self.controller.guidance();
        if let Some(height_m) = guidance.take_off_m().filter(|_| self.standing && !self.has_landed()) {
            return self.controller.take_off_to(self.settings.take_off, Some(height_m));
        }
        let lands = self.settings.guidance.finish == Finish::Land && !guidance.ends_in_circle();
        match guidance.ending().map(|last| last.step) {
            Some(Step::Return) => self.begin(Task::Return, false),
            Some(_) => self.begin(Task::Land, false),
            None if lands && guidance.is_finished() => self.begin(Task::Land, false),
            None => {}
        }
    }

    fn begin_circle(&mut self, state: &NavigationState) {
        let (fence, cruise_mps) = (self.settings.fence, self.settings.control.cruise_mps);
        let outside = self.tasks.fence.outside;
        let position = state.position.xy();
        let motion = Motion { position, velocity: state.velocity.xy(), wind: state.wind };
        let guidance = self.controller.guidance_mut();
        let radius_m = guidance.corner_radius_m(&motion);
        match self.tasks.task {
            Task::Ordered => {}
            Task::Land => {
                let place =
                    guidance.ending().filter(|last| last.step == Step::Land).map(Waypoint::horizontal);
                let height_m = fence.approach_m(&self.settings.control.landing, radius_m);
                self.controller.land(state, height_m, place.unwrap_or_default());
            }
            Task::Loiter if !outside => {
                guidance.hold_here(&motion, fence.height_m(state.altitude_m()), cruise_mps);
            }
            Task::Loiter => {
                let centre = fence.centre(&self.areas.centre(&position, 2.0 * radius_m), radius_m);
                guidance.hold_at(&centre, &motion, fence.height_m(state.altitude_m()), cruise_mps);
            }
            Task::Return => {
                let (place, height_m) = self
                    .areas
                    .refuge(&position)
                    .unwrap_or((Vector2::zeros(), state.altitude_m().max(self.settings.return_m)));
                guidance.hold_at(&place, &motion, fence.height_m(height_m), cruise_mps);
            }
        }
    }

    /// What a task asks of the laws; `None`: what was ordered.
    pub(crate) fn task_commands(&self) -> Option<LoopCommands> {
        let flown = self.tasks.task != Task::Ordered && self.orders.autopilot;
        flown.then_some(LoopCommands::MISSION)
    }

    /// What is flown, as the Controller's command says it.
    pub(crate) fn task_number(&self, commands: &LoopCommands, holding: bool) -> u32 {
        if !commands.autopilot {
            return 0;
        }
        match (self.controller.take_off_phase(), self.tasks.task) {
            (Some(Phase::Waiting), _) => TASK_WAITING,
            (Some(Phase::Rolling), _) => TASK_ROLLING,
            (Some(Phase::Climbing), _) => TASK_CLIMBING,
            (Some(Phase::Aborted), _) => TASK_ABORTED,
            (None, Task::Land) if self.has_landed() => TASK_LANDED,
            (None, Task::Land) => TASK_LANDING,
            (None, Task::Return) => TASK_RETURN,
            (None, Task::Loiter) => TASK_LOITER,
            (None, Task::Ordered) if holding => TASK_LOITER,
            (None, Task::Ordered) if commands.navigation => TASK_MISSION,
            (None, Task::Ordered) => TASK_LOOPS,
        }
    }
}
