//! The function that flies: specific-acceleration loops, roll-rate loop and guidance.
//!
//! Responsible for: what the ground has asked for (autopilot, navigation, single loops, way-points) and for flying it
//! with the laws of `bateleur-flight`. It must never claim the actuators (`engaged`) without having been told to, and
//! never forget over a warm restart what it was told.
//!
//! The safety pilot's sticks do not reach this function, so it flies the whole aircraft or nothing: what neither
//! navigation nor a loop asks for is held as it is flown by default, wings level, at the altitude of the moment and at
//! cruise airspeed.

mod areas;
mod convert;
mod fence;
mod kept;
mod manoeuvre;
mod orders;
mod parameters;
mod settings;
mod voted;
mod waypoints;

pub use convert::{Sensors, navigation_state};
pub use fence::{Fence, FenceAction};
pub use kept::Kept;
pub use orders::{Answer, Orders};
pub use parameters::{Memory, parameters};
pub use settings::{Settings, planned_waypoints};
pub use waypoints::{Change, List, Waypoints};

use areas::Areas;
use bateleur_flight::control::fallback::Basis;
use bateleur_flight::control::outer::normal_for;
use bateleur_flight::control::{Channels, Controller, ControllerInputs, ControllerOutput, LoopCommands};
use bateleur_flight::estimator::NavigationState;
use bateleur_flight::guidance::{
    Guidance, GuidanceConfig, GuidanceError, GuidanceOutput, Waypoint, seed_waypoints,
};
use bateleur_flight::servo;
use bateleur_messages::control::{
    TASK_ABORTED, TASK_CLIMBING, TASK_LANDED, TASK_LANDING, TASK_LOITER, TASK_RETURN, TASK_WAITING,
};
use bateleur_messages::ground::{LoopId, Order};
use bateleur_messages::telemetry::{
    Loops, NAVIGATION_ABORTED, NAVIGATION_AUTOPILOT, NAVIGATION_FINISHED, NAVIGATION_LANDED,
    NAVIGATION_LANDING, NAVIGATION_LINK_LOST, NAVIGATION_LOITER, NAVIGATION_ON, NAVIGATION_OUTSIDE,
    NAVIGATION_PROTECTION_SHIFT, NAVIGATION_RETURN, NAVIGATION_TAKE_OFF, Navigation, Refusal,
};
use bateleur_messages::{ActuatorCommand, FunctionStatus};
use manoeuvre::{Task, Tasks};
use voted::OwnCommands;

/// The function.
#[derive(Debug)]
pub struct Function {
    settings: Settings,
    controller: Box<Controller>,
    orders: Orders,
    tasks: Tasks,
    areas: Areas,
    /// The aircraft stands on the runway, as far as the last state says.
    standing: bool,
    /// Limits that references ran into since the ground was told last.
    protected: u32,
    waypoints: Waypoints,
    /// Altitude held where nobody asks for another, m above the runway.
    hold_altitude_m: Option<f64>,
    last_ns: Option<u64>,
    command: ActuatorCommand,
    commands: OwnCommands,
    basis: Basis,
    channels: Channels,
    accepted: u64,
    missing: u64,
}

impl Function {
    /// A function with everything off and the plan's way-points, or as `kept` stood.
    pub fn new(settings: Settings, planned: &[Waypoint], kept: Option<&Kept>) -> Result<Self, GuidanceError> {
        let mut waypoints = Waypoints::default();
        if !planned.is_empty() {
            waypoints.set(planned)?;
        }
        let kept = kept.filter(|kept| kept.is_sane());
        if let Some(kept) = kept {
            waypoints = kept.waypoints();
        }
        let guidance = guidance(&settings.guidance, &waypoints)?;
        let mut function = Self {
            settings,
            controller: Box::new(Controller::new(settings.airframe, settings.control, guidance)),
            orders: kept.map(Kept::orders).unwrap_or_default(),
            tasks: kept.map(Kept::tasks).unwrap_or_default(),
            areas: kept.map(|kept| kept.areas).unwrap_or_default(),
            standing: false,
            protected: 0,
            waypoints,
            hold_altitude_m: kept.and_then(Kept::hold_altitude_m),
            last_ns: kept.and_then(Kept::last_ns),
            command: ActuatorCommand::default(),
            commands: OwnCommands::default(),
            basis: Basis::WingsLevel,
            channels: Channels::default(),
            accepted: 0,
            missing: 0,
        };
        let laws = kept.and_then(Kept::laws);
        // Without them a circle, a return, a landing is begun anew.
        function.tasks.begins |= laws.is_none() && function.tasks.task != Task::Ordered;
        if let Some(laws) = laws {
            function.controller.guidance_mut().resume(&laws.guidance);
            function.controller.assume_actuators(laws.command());
            function.controller.resume(&laws); // not engaged yet: then there is no more to go on from
        }
        Ok(function)
    }

    /// Takes an order. `ready`: there is a state to fly on.
    pub fn order(&mut self, order: &Order, ready: bool) -> Answer {
        let answer = match order {
            Order::Waypoint(point) => return self.take_waypoint(point),
            Order::Fence(mark) | Order::Rally(mark) => return self.areas.take(mark),
            Order::GoOnWith { index } => self.go_on_with(usize::from(*index)),
            Order::Navigation { on: true } if self.waypoints.flown().is_empty() => {
                Answer::Refused(Refusal::NoWaypoints)
            }
            Order::Autopilot { on: true } if !ready && !self.orders.autopilot => {
                Answer::Refused(Refusal::NoState)
            }
            Order::Manoeuvre { what, reason } => self.manoeuvre(*what, *reason),
            Order::Navigation { on: true }
                if self.tasks.fence.outside && self.tasks.task != Task::Ordered =>
            {
                Answer::Refused(Refusal::OutsideFence)
            }
            order => {
                // A mission that is over has nothing to go on with: it begins again.
                let over = self.controller.guidance().is_finished();
                let begins =
                    matches!(order, Order::Navigation { on: true }) && (!self.orders.navigation || over);
                let answer = self.orders.take(order);
                match order {
                    Order::Navigation { on: true } => self.go_on(),
                    Order::Autopilot { on: false } => self.tasks.end(),
                    _ => {}
                }
                if begins {
                    self.controller.guidance_mut().restart();
                }
                answer
            }
        };
        if !self.orders.autopilot || self.orders.navigation {
            self.hold_altitude_m = None; // taken anew when it is needed
        }
        answer
    }

    /// Flies with other settings from now on; the aircraft stays the same.
    pub fn configure(&mut self, settings: &Settings) {
        self.settings = Settings { airframe: self.settings.airframe, ..*settings };
        self.controller.configure(settings.control);
        self.controller.guidance_mut().configure(settings.guidance);
    }

    /// Takes notice of what the voter of its replicas handed on at `voted_ns`.
    pub fn equalise(&mut self, voted: &ActuatorCommand, voted_ns: u64, cycle_ns: u64) {
        if let Some(off) = self.commands.off(voted, voted_ns, cycle_ns) {
            self.controller.equalise(&off, cycle_ns as f64 * 1e-9);
        }
    }

    /// Flies one cycle of `cycle_ns` at `now_ns`.
    pub fn step(
        &mut self,
        now_ns: u64,
        cycle_ns: u64,
        state: Option<&NavigationState>,
        sensors: &Sensors,
    ) -> ActuatorCommand {
        *(if state.is_some() { &mut self.accepted } else { &mut self.missing }) += 1;
        let elapsed_ns = self.last_ns.map_or(cycle_ns, |last_ns| now_ns.saturating_sub(last_ns));
        self.last_ns = Some(now_ns);
        self.watch(state);
        let commands = self.task_commands().unwrap_or_else(|| self.commands(state));
        let inputs = ControllerInputs {
            navigation: state,
            rates: sensors.rates_radps,
            specific_force: sensors.specific_force_mps2,
            airspeed_mps: sensors.airspeed_mps,
            density_kgpm3: sensors.density_kgpm3,
            range_m: sensors.range_m,
            pilot: self.trimmed(),
            dt_s: elapsed_ns as f64 * 1e-9,
        };
        let output = self.controller.step(&inputs, &commands);
        (self.basis, self.channels) = (output.basis, output.channels);
        self.command = self.message(&commands, &output);
        self.commands.remember(now_ns, &self.command);
        self.protected |= self.command.protection;
        self.command
    }

    /// What the OnBoardComputer is told; `starts` is how often the function was started.
    pub fn status(&self, starts: u64) -> FunctionStatus {
        FunctionStatus {
            enabled: u32::from(self.orders.autopilot),
            ready: u32::from(self.basis == Basis::Estimator),
            accepted: self.accepted,
            refused: self.missing,
            starts,
        }
    }

    /// What to keep over a warm restart.
    pub fn kept(&self) -> Kept {
        let laws = self.controller.snapshot();
        let (hold_altitude_m, last_ns) = (self.hold_altitude_m, self.last_ns);
        Kept::new(&self.orders, self.tasks, (&self.waypoints, self.areas), &laws, hold_altitude_m, last_ns)
    }

    /// What the ground is told of navigation; limits that were reached are told once.
    pub fn navigation(&mut self, time_ns: u64) -> Navigation {
        let protected = std::mem::take(&mut self.protected) << NAVIGATION_PROTECTION_SHIFT;
        let task = self.command.task;
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        Navigation {
            time_ns,
            next_waypoint: self.command.next_waypoint,
            waypoints_reached: self.command.waypoints_reached,
            waypoint_count: self.waypoints.flown().len() as u32,
            flags: flag(self.orders.autopilot, NAVIGATION_AUTOPILOT)
                | flag(self.orders.navigation, NAVIGATION_ON)
                | flag(self.command.finished == 1, NAVIGATION_FINISHED)
                | flag(task == TASK_LOITER, NAVIGATION_LOITER)
                | flag(task == TASK_RETURN, NAVIGATION_RETURN)
                | flag((TASK_WAITING..=TASK_CLIMBING).contains(&task), NAVIGATION_TAKE_OFF)
                | flag(task == TASK_ABORTED, NAVIGATION_ABORTED)
                | flag(task == TASK_LANDING, NAVIGATION_LANDING)
                | flag(task == TASK_LANDED, NAVIGATION_LANDED)
                | flag(self.tasks.fence.outside, NAVIGATION_OUTSIDE)
                | flag(self.tasks.link_lost, NAVIGATION_LINK_LOST)
                | protected,
            cross_track_m: self.command.cross_track_m,
            altitude_reference_m: self.command.altitude_reference_m,
            airspeed_reference_mps: self.command.airspeed_reference_mps,
            bank_reference_rad: self.command.bank_reference_rad,
        }
    }

    /// What the ground is told of the loops.
    pub fn loops(&self, time_ns: u64) -> Loops {
        let c = &self.command;
        Loops {
            time_ns,
            command: [c.throttle, c.aileron_rad, c.elevator_rad, c.rudder_rad],
            horizontal_acceleration_mps2: c.horizontal_acceleration_mps2,
            bank_reference_rad: c.bank_reference_rad,
            engaged: if c.engaged == 1 { self.closed_loops() } else { 0 },
        }
    }

    /// What the inner loops were asked for is flown from trimmed flight, where the pilot has it when he hands over.
    fn trimmed(&self) -> servo::ActuatorCommand {
        let trim = self.controller.trim();
        servo::ActuatorCommand {
            throttle: trim.throttle,
            elevator_rad: trim.elevator_rad,
            ..servo::ActuatorCommand::default()
        }
    }

    fn take_waypoint(&mut self, point: &bateleur_messages::ground::Waypoint) -> Answer {
        let change = match self.waypoints.take(point) {
            Ok(change) => change,
            Err(answer) => return answer,
        };
        if change != Change::None {
            // Every point was checked when it was taken; a list that fits is a mission.
            let Ok(mut next) = guidance(&self.settings.guidance, &self.waypoints) else {
                return Answer::Refused(Refusal::NoWaypoints);
            };
            if change == Change::Moved {
                next.carry_on(self.controller.guidance()); // the mission goes on; another one begins at its first point
            }
            *self.controller.guidance_mut() = next;
            // The circle that was flown in place of the mission is begun anew.
            self.tasks.begins |= matches!(self.tasks.task, Task::Loiter | Task::Return);
        }
        Answer::Accepted
    }

    /// Flies to an entry of the list next, in place of the one that it flies to.
    fn go_on_with(&mut self, index: usize) -> Answer {
        let over = self.controller.guidance().is_finished();
        if self.waypoints.flown().is_empty() || !self.controller.guidance_mut().go_on_with(index) {
            return Answer::Refused(Refusal::NoSuchEntry);
        }
        // What a mission that was over ended with ends, too; what the fence has begun does not.
        if over && !self.tasks.fence.outside {
            self.go_on();
        }
        Answer::Accepted
    }

    /// What the laws are asked for, with a default for everything that nobody asks for.
    fn commands(&mut self, state: Option<&NavigationState>) -> LoopCommands {
        let target = |id: LoopId| self.orders.target(id);
        let free = !self.orders.navigation;
        if free && self.orders.autopilot && self.hold_altitude_m.is_none() {
            self.hold_altitude_m = state.map(NavigationState::altitude_m);
        }
        let (bank, track, roll_rate) =
            (target(LoopId::RollAngle), target(LoopId::Heading), target(LoopId::RollRate));
        let level = (free && track.is_none() && roll_rate.is_none()).then_some(0.0);
        let hold = self.hold_altitude_m.filter(|_| free);
        let cruise = free.then_some(self.settings.control.cruise_mps);
        LoopCommands {
            autopilot: self.orders.autopilot,
            navigation: self.orders.navigation,
            altitude_m: target(LoopId::Altitude).or(hold),
            airspeed_mps: target(LoopId::Airspeed).or(cruise),
            track_rad: track,
            bank_rad: bank.or(level),
            roll_rate_radps: roll_rate,
            pitch_rate_radps: target(LoopId::PitchRate),
            normal_mps2: target(LoopId::Normal).or_else(|| self.climb(state)),
            lateral_mps2: target(LoopId::Lateral),
            axial_mps2: target(LoopId::Axial),
        }
    }

    /// The normal specific acceleration (m/s²) that brings about the climb rate asked for.
    fn climb(&self, state: Option<&NavigationState>) -> Option<f64> {
        let (wanted_mps, state) = (self.orders.target(LoopId::ClimbRate)?, state?);
        let climb_mps = -state.velocity.z;
        let air = state.air_velocity();
        let climb_rad = (-air.z / air.norm().max(1.0)).clamp(-1.0, 1.0).asin();
        let up = self.settings.control.outer.climb_rate(wanted_mps, climb_mps);
        Some(normal_for(up, state.euler.x, climb_rad))
    }

    fn message(&self, commands: &LoopCommands, output: &ControllerOutput) -> ActuatorCommand {
        let c = &output.command;
        let finite = [c.throttle, c.aileron_rad, c.elevator_rad, c.rudder_rad].iter().all(|x| x.is_finite());
        let progress = self.controller.guidance().snapshot();
        let guidance = output.guidance.as_ref();
        let of = |value: fn(&GuidanceOutput) -> f64| guidance.map(value);
        ActuatorCommand {
            throttle: c.throttle,
            aileron_rad: c.aileron_rad,
            elevator_rad: c.elevator_rad,
            rudder_rad: c.rudder_rad,
            bank_reference_rad: output.references.bank_rad,
            horizontal_acceleration_mps2: of(|g| g.horizontal_mps2).unwrap_or(0.0),
            cross_track_m: of(|g| g.cross_track_m).unwrap_or(0.0),
            altitude_reference_m: commands.altitude_m.or(of(|g| g.altitude_m)).unwrap_or(0.0),
            airspeed_reference_mps: commands
                .airspeed_mps
                .or(of(|g| g.airspeed_mps))
                .map_or(0.0, |airspeed_mps| self.controller.flown_mps(airspeed_mps)),
            engaged: u32::from(commands.autopilot && finite),
            next_waypoint: progress.next,
            waypoints_reached: progress.reached,
            finished: u32::from(self.controller.guidance().is_finished()),
            task: self.task_number(commands, guidance.is_some_and(|g| g.holding)),
            protection: output.protection.0,
        }
    }

    /// The loops that are closed now, one bit each.
    fn closed_loops(&self) -> u64 {
        let asked = |id: LoopId| self.orders.target(id).is_some();
        let (rate, angle) = (asked(LoopId::RollRate), asked(LoopId::Heading));
        let free = !self.orders.navigation;
        let inner_pitch = asked(LoopId::PitchRate) || asked(LoopId::Normal) || asked(LoopId::ClimbRate);
        let closed = |id: LoopId| match id {
            LoopId::RollRate => self.channels.roll,
            LoopId::Normal => self.channels.pitch,
            LoopId::Lateral => self.channels.yaw,
            LoopId::Axial => self.channels.thrust,
            LoopId::RollAngle => self.channels.roll && !rate,
            LoopId::Heading => angle && !rate && !asked(LoopId::RollAngle),
            LoopId::Altitude => !inner_pitch && (asked(id) || !free || self.hold_altitude_m.is_some()),
            LoopId::Airspeed => self.channels.thrust && !asked(LoopId::Axial),
            LoopId::PitchRate => asked(id),
            LoopId::ClimbRate => asked(id) && !asked(LoopId::PitchRate) && !asked(LoopId::Normal),
        };
        LoopId::ALL.into_iter().filter(|id| closed(*id)).map(|id| 1 << (id as u64)).sum()
    }
}

/// Guidance over the way-points; before there are any, over the seed's, which nobody can switch on.
fn guidance(config: &GuidanceConfig, waypoints: &Waypoints) -> Result<Guidance, GuidanceError> {
    match waypoints.flown() {
        [] => Guidance::new(*config, &seed_waypoints()),
        points => Guidance::new(*config, points),
    }
}

#[cfg(test)]
mod tests;
