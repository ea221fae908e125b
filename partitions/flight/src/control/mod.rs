//! From a navigation state to actuator commands.
//!
//! Responsible for flying what is asked, by guidance or by a target for any single loop, and for flying something
//! sensible when there is no state. It must never jump: engagement, a returning estimator and changed targets all
//! pass through the references' slew limits, and the integrators start where the actuators are.
//!
//! Per channel the innermost target wins: roll rate over bank over track over navigation (ailerons), pitch rate over
//! normal acceleration over altitude over navigation (elevator), axial acceleration over airspeed over navigation
//! (throttle). A channel without target goes to the safety pilot; the rudder flies coordinated whenever the
//! autopilot is on.

pub mod airspeed;
mod climb_regulator;
pub mod envelope;
pub mod fallback;
pub mod gusts;
pub mod inner;
pub mod landing;
pub mod memory;
pub mod outer;
mod pitch_hold;
mod play;
pub mod power;
pub mod range_finder;
pub mod roll;
pub mod stall;
pub mod takeoff;
mod wheels;
mod wind;

use crate::GRAVITY_MPS2;
use crate::airframe::{Airframe, Trim};
use crate::attitude::{self, low_pass, wrap_angle};
use crate::estimator::{EstimatorStatus, NavigationState};
use crate::guidance::{Guidance, GuidanceOutput, Motion, course_acceleration};
use crate::kept::kept;
use crate::servo::ActuatorCommand;
use crate::stuck::{LATERAL_FORCE, PITCH_RATE, ROLL_RATE, YAW_RATE};
use envelope::{Envelope, Limits, Protection, steepness};
use fallback::Basis;
use inner::{InnerTuning, Signals};
use landing::{Approach, Flown, Glide, Landing, LandingConfig};
use memory::{ControllerSnapshot, Memory};
use nalgebra::{Vector2, Vector3};
use outer::{OuterTuning, normal_for, slew};
use pitch_hold::Aim;
use power::PowerWatch;
use takeoff::{Method, Phase, TakeOff};
use wind::WindWatch;

/// Which loops are on, each with its target; `None` is off.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LoopCommands {
    /// The autopilot as a whole; off, everything is the safety pilot's.
    pub autopilot: bool,
    /// Way-point navigation feeds track, altitude and airspeed.
    pub navigation: bool,
    /// Altitude above the runway, m.
    pub altitude_m: Option<f64>,
    /// Airspeed, m/s.
    pub airspeed_mps: Option<f64>,
    /// Direction of the ground track, rad from north.
    pub track_rad: Option<f64>,
    /// Bank angle, rad.
    pub bank_rad: Option<f64>,
    /// Roll rate about the direction of flight, rad/s.
    pub roll_rate_radps: Option<f64>,
    /// Pitch rate about the wind's y axis, rad/s.
    pub pitch_rate_radps: Option<f64>,
    /// Normal specific acceleration, m/s²; −9.8 in level flight.
    pub normal_mps2: Option<f64>,
    /// Lateral specific acceleration, m/s²; without target 0 is flown.
    pub lateral_mps2: Option<f64>,
    /// Axial specific acceleration, m/s²; g sin γ keeps the speed.
    pub axial_mps2: Option<f64>,
}

impl LoopCommands {
    /// Autopilot and way-point navigation on.
    pub const MISSION: Self = Self {
        autopilot: true,
        navigation: true,
        altitude_m: None,
        airspeed_mps: None,
        track_rad: None,
        bank_rad: None,
        roll_rate_radps: None,
        pitch_rate_radps: None,
        normal_mps2: None,
        lateral_mps2: None,
        axial_mps2: None,
    };

    /// Every target that is not a finite number counts as off.
    fn finite(mut self) -> Self {
        let targets = [
            &mut self.altitude_m,
            &mut self.airspeed_mps,
            &mut self.track_rad,
            &mut self.bank_rad,
            &mut self.roll_rate_radps,
            &mut self.pitch_rate_radps,
            &mut self.normal_mps2,
            &mut self.lateral_mps2,
            &mut self.axial_mps2,
        ];
        for target in targets {
            *target = target.filter(|value| value.is_finite());
        }
        self
    }
}

/// What a frame brings to the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerInputs<'a> {
    /// The estimator's state of this frame; `None` when it has none or it is stale.
    pub navigation: Option<&'a NavigationState>,
    /// Raw rates of the IMU, body, rad/s; flown on when the estimator is silent.
    pub rates: Vector3<f64>,
    /// Raw specific force of the IMU, body, m/s².
    pub specific_force: Vector3<f64>,
    /// Airspeed from the pitot, m/s, if there is one.
    pub airspeed_mps: Option<f64>,
    /// Air density, kg/m³, if known.
    pub density_kgpm3: Option<f64>,
    /// Distance to the ground along the body's axis down, m, if a range finder has a new one.
    pub range_m: Option<f64>,
    /// The safety pilot's sticks: flown on channels that are off, and where engagement starts.
    pub pilot: ActuatorCommand,
    /// Time since the last step, s.
    pub dt_s: f64,
}

/// Which channels the autopilot has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Channels {
    /// Ailerons.
    pub roll: bool,
    /// Elevator.
    pub pitch: bool,
    /// Rudder.
    pub yaw: bool,
    /// Throttle.
    pub thrust: bool,
}

kept!(Channels { roll: bool, pitch: bool, yaw: bool, thrust: bool });

/// What the inner loops are asked for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct References {
    /// rad/s.
    pub roll_rate_radps: f64,
    /// m/s².
    pub normal_mps2: f64,
    /// m/s².
    pub axial_mps2: f64,
    /// rad; what the bank loop works towards.
    pub bank_rad: f64,
}

kept!(References { roll_rate_radps: f64, normal_mps2: f64, axial_mps2: f64, bank_rad: f64 });

/// What a frame gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerOutput {
    /// To the servos.
    pub command: ActuatorCommand,
    /// Where guidance stands, when navigation is on.
    pub guidance: Option<GuidanceOutput>,
    /// On what this frame was flown.
    pub basis: Basis,
    /// What the inner loops were asked for.
    pub references: References,
    /// What they measured.
    pub signals: Signals,
    /// Who flies what.
    pub channels: Channels,
    /// Limits that references ran into.
    pub protection: Protection,
}

/// Gains and limits, and the airspeed flown when nothing is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerConfig {
    /// Poles of the inner loops.
    pub inner: InnerTuning,
    /// Gains of the outer loops.
    pub outer: OuterTuning,
    /// Airspeed for trim and fall-back, m/s.
    pub cruise_mps: f64,
    /// Height at which a take-off is over, m above the runway.
    pub take_off_m: f64,
    /// How it lands.
    pub landing: LandingConfig,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        let (inner, outer) = (InnerTuning::default(), OuterTuning::default());
        Self { inner, outer, cruise_mps: 22.0, take_off_m: 60.0, landing: LandingConfig::default() }
    }
}

/// Greatest bank in the climb of a take-off, rad.
const TAKE_OFF_BANK_RAD: f64 = 0.26;
/// Slower than this share of the airspeed that carries it, an aircraft does not fly.
const STALLS_SHARE: f64 = 0.6;
/// Above this the wing carries a take-off, m above the runway.
const CARRIED_BY_WING_M: f64 = 15.0;
/// Airspeed that is asked for beyond that of a glide, m/s.
const OPEN_THROTTLE_MPS: f64 = 3.0;
/// Airspeed on the way to way-points at least, of the one at which the wing just carries the weight.
const TURNS_SHARE: f64 = 1.3;
/// Share of the airspeed that is kept in hand while the pitot is not believed; and on an approach, which is flown at another lift than that at
/// which the airspeed by lift was learnt, of the airspeed that just carries the weight.
const DOUBTED_SHARE: f64 = 0.05;
const DOUBTED_APPROACH_SHARE: f64 = 0.25;
/// Airspeed of an approach for each m/s of the gusts' standard deviation, m/s at most.
const GUST_SHARE: f64 = 2.0;
const MOST_FOR_GUSTS_MPS: f64 = 5.0;
/// How much of the angle of climb that is lacking in a flare, or too much, the motor makes up for.
const LACKING_SHARE: f64 = 2.0;
/// Share of the airspeed's gain on the straight way to the ground: gusts that are answered in full spread the touch-down along.
const FINAL_SPEED_SHARE: f64 = 0.7;
/// How far ahead the airspeed is looked at where its floor is kept, s.
const FLOOR_LEAD_S: f64 = 1.0;
/// Slew limits of the references: invisible in normal flight, they take the edge off a change of basis.
const ROLL_RATE_SLEW_RADPS2: f64 = 16.0;
const NORMAL_SLEW_MPS3: f64 = 60.0;
const AXIAL_SLEW_MPS3: f64 = 8.0;
/// Share of the rudder's travel that coordinates, at most: what is left damps.
const COORDINATING_SHARE: f64 = 0.8;
/// How far the airspeed of lift may be below that of satellites and wind, and above it, in deviations of gusts and at most, m/s: gusts, and what
/// the wind has become since. It is better too fast. The way to the ground has the most, because the wind changes there.
const BELOW_BY_WIND: (f64, f64) = (1.5, 5.0);
const ABOVE_BY_WIND: (f64, f64) = (1.0, 2.5);
/// An attitude that is surer than this, rad, is told by a magnetic field, too.
const LATE_RAD: f64 = 0.03;
/// Smoothing of the pitot's noise, s.
const AIRSPEED_LAG_S: f64 = 0.15;
/// How fast the integrators of a controller that is not listened to come to those of the one that is, s.
const EQUALISED_S: f64 = 0.25;
/// Longest step taken as one, s; after a longer pause the rest is not made up.
const LONGEST_STEP_S: f64 = 0.2;

/// Share of the elevator's travel from which more airspeed is asked for: at one lift the elevator needed falls with V².
const ELEVATOR_COMFORT: f64 = 0.75;
/// Airspeed added per share of travel beyond it, m/s, and beyond the second share, where the elevator is about to hold no level flight any
/// more; its limit, and how slowly it comes and goes, s.
const AUTHORITY_GAIN_MPS: f64 = 12.0;
const ELEVATOR_END: f64 = 0.9;
const END_GAIN_MPS: f64 = 60.0;
const AUTHORITY_LIMIT_MPS: f64 = 9.0;
const AUTHORITY_LAG_S: f64 = 4.0;

/// The controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    airframe: Airframe,
    config: ControllerConfig,
    trim: Trim,
    envelope: Envelope,
    guidance: Guidance,
    memory: Memory,
}

impl Controller {
    /// A controller with everything off. Should it be engaged in flight at once, it starts from trimmed flight.
    pub fn new(airframe: Airframe, config: ControllerConfig, guidance: Guidance) -> Self {
        let envelope = Envelope::new(&airframe);
        let cruise_mps = envelope.cruise_mps(&airframe, config.cruise_mps);
        let config = ControllerConfig { cruise_mps, ..config };
        let trim = airframe.trim(config.cruise_mps, 1.2);
        Self { airframe, config, trim, envelope, guidance, memory: Memory::new(&trim, config.cruise_mps) }
    }

    /// Begins a take-off from standstill; it is flown as soon as the autopilot is on.
    pub fn take_off(&mut self, method: Method) {
        self.take_off_to(method, None);
    }

    /// The same, over at this height, m above the runway, in place of that of the settings.
    pub fn take_off_to(&mut self, method: Method, height_m: Option<f64>) {
        self.memory.take_off = Some(TakeOff::new(method, height_m));
        (self.memory.landing, self.memory.power) = (None, PowerWatch::default());
        self.memory.stall.wait(f64::INFINITY);
        self.memory.last = ActuatorCommand::default();
    }

    /// The propeller drives nothing.
    pub fn has_lost_power(&self) -> bool {
        self.memory.power.is_lost()
    }

    /// Begins a landing from `state` on, or begins it anew; its final approach from `height_m` above the runway, at most, to a place, m
    /// north and east of the runway's origin.
    pub fn land(&mut self, state: &NavigationState, height_m: f64, place: Vector2<f64>) {
        self.memory.landing = Some(Landing::new(&self.config.landing, state, height_m, place));
    }

    /// Gives a landing up for whatever else was ordered; false: it is on the ground already.
    pub fn end_landing(&mut self) -> bool {
        let ends = self.memory.landing.is_none_or(|landing| !landing.is_on_ground());
        if ends {
            self.memory.landing = None;
        }
        ends
    }

    /// Flies round once more; false: there is no landing, or the aircraft is on the ground.
    pub fn go_round(&mut self) -> bool {
        self.memory.landing.as_mut().is_some_and(Landing::go_round)
    }

    /// Where the landing stands that is under way.
    pub fn landing_phase(&self) -> Option<landing::Phase> {
        self.memory.landing.map(|landing| landing.phase)
    }

    /// Gives a take-off up; false: there is none, or the aircraft flies already.
    pub fn abort_take_off(&mut self) -> bool {
        self.memory.take_off.as_mut().is_some_and(TakeOff::abort)
    }

    /// Where the take-off stands that is under way.
    pub fn take_off_phase(&self) -> Option<Phase> {
        self.memory.take_off.map(|take_off| take_off.phase)
    }

    /// The mission, to replace or restart it.
    pub fn guidance_mut(&mut self) -> &mut Guidance {
        &mut self.guidance
    }

    /// The mission.
    pub fn guidance(&self) -> &Guidance {
        &self.guidance
    }

    /// Flies with other gains and limits from now on.
    pub fn configure(&mut self, config: ControllerConfig) {
        let cruise_mps = self.envelope.cruise_mps(&self.airframe, config.cruise_mps);
        if cruise_mps != self.config.cruise_mps {
            self.trim = self.airframe.trim(cruise_mps, 1.2);
        }
        self.config = ControllerConfig { cruise_mps, ..config };
    }

    /// Airspeed (m/s) that is flown where `asked_mps` is asked for, by whomever.
    pub fn flown_mps(&self, asked_mps: f64) -> f64 {
        self.envelope.flown_mps(asked_mps)
    }

    /// Level flight at cruise airspeed.
    pub fn trim(&self) -> &Trim {
        &self.trim
    }

    /// What to keep over a restart.
    pub fn snapshot(&self) -> ControllerSnapshot {
        let mut memory = self.memory;
        memory.pitch_hold.aim = None; // that of a frame
        ControllerSnapshot { memory, path: self.guidance.path(), guidance: self.guidance.snapshot() }
    }

    /// Goes on where a snapshot stood; false: nothing has flown there yet.
    pub fn resume(&mut self, snapshot: &ControllerSnapshot) -> bool {
        if snapshot.memory.airspeed_mps <= 0.0 {
            return false;
        }
        self.memory = snapshot.memory;
        self.learn_lift();
        self.guidance.resume(&snapshot.guidance);
        self.guidance.resume_path(&snapshot.path);
        true
    }

    /// Tells a controller that was started in flight where the actuators stand, so that it takes over from there.
    pub fn assume_actuators(&mut self, command: &ActuatorCommand) {
        self.memory.last = *command;
    }

    /// Takes notice of what flies instead of its own last command, where several controllers fly and one of them, or none, is listened to:
    /// `off` is that less its own. Integrators that nobody listens to would drift away from those that fly.
    pub fn equalise(&mut self, off: &ActuatorCommand, dt_s: f64) {
        let share = (dt_s / EQUALISED_S).clamp(0.0, 1.0);
        let Memory { loops, channels, pitch_hold, .. } = &mut self.memory;
        loops.shift(&self.airframe, channels, off, share);
        pitch_hold.shift(share * off.elevator_rad);
    }

    /// One frame.
    pub fn step(&mut self, inputs: &ControllerInputs<'_>, commands: &LoopCommands) -> ControllerOutput {
        let dt_s = if inputs.dt_s.is_finite() { inputs.dt_s.clamp(1e-4, LONGEST_STEP_S) } else { 0.02 };
        let commands = commands.finite();
        let yaw_before_rad = self.memory.fallback.yaw_rad();
        let (state, basis) =
            self.memory.fallback.update(inputs.navigation, &inputs.rates, &inputs.specific_force, dt_s);
        let mut signals = self.measure(&state, inputs, basis, dt_s);
        self.memory.stuck.look(&inputs.specific_force, &inputs.rates);
        let stuck = self.memory.stuck.axes();
        signals.pitches_blind = stuck & PITCH_RATE != 0;
        if signals.pitches_blind != std::mem::replace(&mut self.memory.pitches_blind, signals.pitches_blind) {
            self.memory.channels.pitch = false; // engaged anew with the other gains, the elevator goes on from where it is
        }
        signals.yaws_blind = stuck & YAW_RATE != 0;
        if signals.yaws_blind && self.is_on_wheels() {
            signals.yaw_rate_radps = wrap_angle(state.euler.z - yaw_before_rad) / dt_s; // it steers by that
        }
        if stuck & LATERAL_FORCE != 0 {
            signals.lateral_mps2 = 0.0; // the rudder's trim stays: it would run to its end
        }
        let by_ailerons = self.memory.roll.step(&self.airframe, &signals, self.memory.last.aileron_rad, dt_s);
        if self.rolls_blind() {
            signals.roll_rate_radps = by_ailerons;
        }
        self.watch_ground(&state, inputs.range_m, basis, dt_s);
        if !commands.autopilot {
            return self.hand_over(inputs, basis, signals);
        }
        self.memory.pitch_hold.aim = None;
        let ordered = self
            .leave_ground(&state, &signals, basis, dt_s, &commands)
            .and_then(|commands| self.come_down(&state, &signals, basis, dt_s, &commands));
        // Whether a motor drives it is seen from the throttle that was flown.
        self.watch_power(&state, &signals, basis, dt_s);
        if self.memory.power.is_lost() && self.memory.landing.is_some() {
            self.memory.take_off = None; // a climb that nothing drives is over
        }
        let (commands, closes) = match ordered {
            Ok(ordered) => ordered,
            Err(command) => {
                (self.memory.last, self.memory.channels) = (command, Channels::default());
                self.guidance.disengage();
                return self.on_ground(command, basis, signals);
            }
        };
        if basis != Basis::Estimator && !attitude::finite(&inputs.rates) {
            return self.blind(basis, signals);
        }
        self.guidance.observe(dt_s, state.altitude_m());
        let guidance = self.navigate(&state, &signals, &commands, basis);
        let wanted = self.outer(&state, &signals, &commands, guidance.as_ref(), basis);
        let (wanted, mut protection) = self.protect(&state, &signals, &wanted, basis);
        protection.note(Protection::PITOT, !self.memory.airspeed_watch.is_believed());
        protection.note(Protection::POWER, self.memory.power.is_lost());
        let mut command = self.inner(&signals, &wanted, &commands, inputs, dt_s);
        self.watch_wing(&signals, &command, basis, dt_s);
        protection.note(Protection::STALL, self.memory.stall.is_stalled());
        if let Some(rudder_rad) =
            self.memory.landing.and_then(|landing| landing.rudder_rad(&self.airframe, &signals))
        {
            command.rudder_rad = rudder_rad; // on its wheels, though the wings carry yet
        }
        if closes {
            command.throttle = 0.0;
        }
        self.memory.last = command;
        if basis == Basis::Estimator {
            self.memory.steady.follow(&command, dt_s);
        }
        // The loops remember where the surface is wanted, not where the servo stands for it.
        if self.memory.channels.pitch {
            let servo = &self.airframe.servo;
            let led = self.memory.play.step(command.elevator_rad, servo.backlash_rad, dt_s);
            command.elevator_rad = led.clamp(-servo.elevator_limit_rad, servo.elevator_limit_rad);
        }
        ControllerOutput {
            command,
            guidance,
            basis,
            references: self.memory.references,
            signals,
            channels: self.memory.channels,
            protection,
        }
    }

    /// A take-off that is under way: what the loops are asked for, or the actuators while there is nothing for loops to fly.
    fn leave_ground(
        &mut self,
        state: &NavigationState,
        s: &Signals,
        basis: Basis,
        dt_s: f64,
        commands: &LoopCommands,
    ) -> Result<LoopCommands, ActuatorCommand> {
        let Some(mut take_off) = self.memory.take_off else { return Ok(*commands) };
        let (airframe, envelope) = (&self.airframe, &self.envelope);
        let course = state.velocity.y.atan2(state.velocity.x);
        let ground = state.velocity.xy().norm();
        take_off.advance(airframe, envelope, s, (course, ground), basis != Basis::WingsLevel, dt_s);
        self.memory.take_off = Some(take_off);
        if let Some(command) = take_off.actuators(airframe, envelope, s, ground, &self.memory.last, dt_s) {
            return Err(command);
        }
        let height_m = take_off.height_m.unwrap_or(self.config.take_off_m);
        if state.altitude_m() >= height_m && basis != Basis::WingsLevel {
            self.memory.take_off = None;
            return Ok(*commands);
        }
        Ok(LoopCommands {
            autopilot: true,
            // A little above, so that it does not level off before it is there.
            altitude_m: Some(height_m + 10.0),
            // No less than it climbs at, or it would wait for that for ever.
            airspeed_mps: Some(self.config.cruise_mps.max(self.climb_out_mps(&take_off, s))),
            track_rad: Some(take_off.course_rad),
            ..LoopCommands::default()
        })
    }

    /// A landing that is under way: as above, and whether the throttle is closed whatever the loops say. Without a state to be trusted it waits, wings level.
    fn come_down(
        &mut self,
        state: &NavigationState,
        s: &Signals,
        basis: Basis,
        dt_s: f64,
        commands: &LoopCommands,
    ) -> Result<(LoopCommands, bool), ActuatorCommand> {
        let Some(mut landing) = self.memory.landing.filter(|_| self.memory.take_off.is_none()) else {
            return Ok((*commands, false));
        };
        if basis == Basis::WingsLevel && !landing.is_on_ground() {
            return Ok((LoopCommands::MISSION, false));
        }
        let glide = self.memory.power.is_lost().then(|| {
            let airspeed_mps = self.envelope.glide_mps(&self.airframe, s.density_kgpm3);
            let slows_mps2 = self.memory.power.slows_mps2(&self.airframe, airspeed_mps, s.density_kgpm3);
            let turn_m = self.guidance.radius_at_m(airspeed_mps, &Vector2::zeros());
            Glide { airspeed_mps, slows_mps2, turn_m, power: self.memory.power }
        });
        let aircraft = (&self.airframe, &self.envelope, &self.config.landing);
        let motion = motion_of(state);
        let radius_m = match &glide {
            Some(glide) => self.guidance.radius_at_m(glide.airspeed_mps, &state.wind),
            None => self.guidance.corner_radius_m(&motion),
        };
        // Without power the throttle stays open: so it is seen that it is back.
        let least_mps = glide.as_ref().map_or(0.0, |glide| glide.airspeed_mps + OPEN_THROTTLE_MPS);
        let circle = (radius_m, self.config.cruise_mps.max(least_mps));
        let over = (self.memory.ground.over_ground(state), self.memory.ground.is_known());
        let doubted = if self.memory.airspeed_watch.is_believed() { 0.0 } else { DOUBTED_APPROACH_SHARE };
        let gusts_mps = (GUST_SHARE * self.memory.gusts.deviation_mps()).min(MOST_FOR_GUSTS_MPS);
        let air = (s, gusts_mps + doubted * self.envelope.stall_mps(&self.airframe, s.density_kgpm3));
        let flown = landing.step(aircraft, (&over.0, over.1), air, circle, glide.as_ref(), dt_s);
        self.memory.landing = Some(landing);
        let closes = matches!(flown, Flown::Loops(Approach { airspeed_mps: None, .. }));
        let commands = match flown {
            Flown::Wheels(command) => return Err(command),
            Flown::Circle(hold, anew) => {
                if anew {
                    self.guidance.release();
                }
                self.guidance.hold(hold);
                LoopCommands::MISSION
            }
            Flown::Up(height_m) => LoopCommands {
                autopilot: true,
                altitude_m: Some(height_m),
                airspeed_mps: Some(self.config.cruise_mps),
                track_rad: Some(landing.course_rad),
                ..LoopCommands::default()
            },
            Flown::Loops(Approach { climb_mps, sideways_mps2, bank_rad, airspeed_mps, least_mps2, aim }) => {
                self.memory.pitch_hold.aim = aim;
                let outer = &self.config.outer;
                let up = outer.climb_rate(climb_mps, -state.velocity.z).max(least_mps2);
                let bank = sideways_mps2.map_or(0.0, |right| outer.bank_for(right, up, s.climb_rad));
                LoopCommands {
                    autopilot: true,
                    airspeed_mps,
                    bank_rad: Some(bank.clamp(-bank_rad, bank_rad)),
                    normal_mps2: Some(normal_for(up, s.bank_rad, s.climb_rad)),
                    ..LoopCommands::default()
                }
            }
        };
        Ok((commands, closes))
    }

    /// A circle may lead over a ditch: the ground is looked for on the way down alone.
    fn watch_ground(&mut self, state: &NavigationState, range_m: Option<f64>, basis: Basis, dt_s: f64) {
        let range_m = range_m.filter(|_| basis == Basis::Estimator);
        if self.comes_down() {
            return self.memory.ground.step(range_m, state, dt_s);
        }
        self.memory.ground.forget();
        // In the hands of who launches it nothing is learnt.
        if self.memory.take_off.is_none_or(|take_off| take_off.phase == Phase::Rolling) {
            self.memory.ground.stand(range_m, state, dt_s);
        }
    }

    /// A wing that stalls where its file has lift yet is flown with the lift that it gave, from then on.
    fn watch_wing(&mut self, s: &Signals, command: &ActuatorCommand, basis: Basis, dt_s: f64) {
        let on_ground = self.memory.landing.is_some_and(|landing| landing.is_on_ground())
            || s.airspeed_mps < STALLS_SHARE * self.envelope.stall_mps(&self.airframe, s.density_kgpm3);
        // The elevator follows no normal acceleration then, and the nose is not to go down for gusts near the ground.
        let held = on_ground || self.memory.pitch_hold.is_on();
        if !self.memory.channels.pitch || self.memory.take_off.is_some() || held || basis == Basis::WingsLevel
        {
            return self.memory.stall.wait(dt_s);
        }
        // An elevator that is at its own stop can not hold a stall.
        let least_rad = self.least_elevator_rad(s);
        let at_limit =
            least_rad > -self.airframe.servo.elevator_limit_rad && command.elevator_rad <= least_rad + 1e-3;
        let asked = (self.memory.references.normal_mps2, at_limit, self.memory.airspeed_watch.is_sure());
        if self.memory.stall.step(&self.airframe, self.envelope.file_lift, s, asked, dt_s) {
            self.learn_lift();
        }
    }

    fn least_elevator_rad(&self, s: &Signals) -> f64 {
        let (lift, factor) = (self.envelope.file_lift, self.memory.airspeed_watch.elevator_factor());
        self.memory.stall.least_elevator_rad(&self.airframe, lift, factor, s)
    }

    fn learn_lift(&mut self) {
        if self.memory.stall.share() < 1.0 {
            self.envelope = Envelope::with_lift(&self.airframe, self.memory.stall.share());
            let banks = self.envelope.banks(&self.airframe);
            self.guidance.fly_within(self.envelope.slowest_mps, Some(banks));
            self.configure(self.config);
        }
    }

    fn watch_power(&mut self, state: &NavigationState, s: &Signals, basis: Basis, dt_s: f64) {
        let frame = power::Frame {
            throttle: self.memory.last.throttle,
            airspeed_mps: s.airspeed_mps,
            altitude_m: state.altitude_m(),
            density_kgpm3: s.density_kgpm3,
            axial_mps2: s.axial_mps2,
            normal_mps2: s.normal_mps2,
            flying: self.memory.channels.pitch && !self.is_on_wheels() && basis != Basis::WingsLevel,
            may_sink: self.memory.landing.is_some_and(|landing| landing.phase != landing::Phase::Round),
            dt_s,
        };
        if !self.memory.stall.is_stalled() {
            self.memory.power.step(&self.airframe, &frame);
        }
    }

    /// Airspeed below which a take-off does not climb, m/s.
    fn climb_out_mps(&self, take_off: &TakeOff, s: &Signals) -> f64 {
        take_off.climb_mps(&self.airframe, &self.envelope, s.density_kgpm3) + 2.0
    }

    fn on_ground(&self, command: ActuatorCommand, basis: Basis, signals: Signals) -> ControllerOutput {
        let mut protection = Protection::default();
        protection.note(Protection::POWER, self.memory.power.is_lost());
        ControllerOutput {
            command,
            guidance: None,
            basis,
            references: self.memory.references,
            signals,
            channels: self.memory.channels,
            protection,
        }
    }

    /// There is no state, and no gyroscope to fly on without one: the surfaces stay where they stood on average, and the loops wait.
    fn blind(&mut self, basis: Basis, signals: Signals) -> ControllerOutput {
        self.memory.last = self.memory.steady.mean.unwrap_or_else(|| trimmed(&self.trim));
        self.on_ground(self.memory.last, basis, signals)
    }

    /// The safety pilot flies; loops forget, so that engagement starts from the pilot's actuators.
    fn hand_over(
        &mut self,
        inputs: &ControllerInputs<'_>,
        basis: Basis,
        signals: Signals,
    ) -> ControllerOutput {
        self.memory.channels = Channels::default();
        self.guidance.disengage();
        self.memory.authority_mps = 0.0;
        self.memory.last = inputs.pilot;
        // A take-off that was ordered on the ground waits for the autopilot; one that had begun is the pilot's.
        if self.memory.take_off.is_some_and(|take_off| !take_off.is_fresh()) {
            self.memory.take_off = None;
        }
        // Whether there is power is judged by the throttle that the loops ask for.
        (self.memory.landing, self.memory.power) = (None, PowerWatch::default());
        self.memory.stall.wait(f64::INFINITY);
        self.on_ground(inputs.pilot, basis, signals)
    }

    fn is_on_wheels(&self) -> bool {
        self.memory.take_off.is_some_and(|take_off| take_off.phase != Phase::Climbing)
            || self.memory.landing.is_some_and(|landing| landing.is_on_ground())
    }

    /// The gyroscope does not tell the roll rate.
    fn rolls_blind(&self) -> bool {
        self.memory.stuck.axes() & ROLL_RATE != 0
    }

    /// What can be asked for at the airspeed of the moment.
    fn limits(&self, s: &Signals) -> Limits {
        let most_rad = if self.rolls_blind() { roll::BANK_RAD } else { f64::INFINITY };
        let bank_rad = self.config.outer.bank_limit_rad.min(most_rad);
        let sure = if self.memory.airspeed_watch.is_believed() { 1.0 } else { 1.0 - DOUBTED_SHARE };
        self.envelope.limits(&self.airframe, sure * s.airspeed_mps, s.density_kgpm3, bank_rad)
    }

    /// Keeps what the loops are asked for within what the aircraft can do, whoever asks. A target of an inner loop is held within
    /// its own limit; below the least airspeed the nose goes down and the throttle opens, whatever was asked for.
    fn protect(
        &self,
        state: &NavigationState,
        s: &Signals,
        wanted: &Wanted,
        basis: Basis,
    ) -> (Wanted, Protection) {
        let (limits, outer) = (self.limits(s), &self.config.outer);
        let mut protection = Protection::default();
        let mut wanted = *wanted;
        // What the airspeed will be in a moment: below the floor it is too late.
        let change = s.axial_mps2 - GRAVITY_MPS2 * s.climb_rad.sin();
        let lack = limits.floor_mps - s.airspeed_mps - FLOOR_LEAD_S * change.min(0.0);
        // What a glide has left is used up above the ground.
        let flares = self.memory.power.is_lost() && {
            let over = self.memory.ground.over_ground(state);
            self.memory.landing.is_some_and(|landing| landing.is_low(&over))
        };
        let slow = lack > 0.0 && basis != Basis::WingsLevel && !flares;
        let held = wanted.normal.is_some() || wanted.axial.is_some();
        protection.note(Protection::AIRSPEED, slow && held);
        if let Some(bank) = wanted.bank {
            let bank = limits.bank(bank, &mut protection);
            wanted.bank = Some(bank);
            let most = self.envelope.roll_rate_radps(s.airspeed_mps);
            let share = if self.rolls_blind() { roll::BANK_SHARE } else { 1.0 };
            wanted.roll_rate = Some((share * outer.bank(bank, s.bank_rad)).clamp(-most, most));
        } else if let Some(rate) = wanted.roll_rate {
            // A roll rate by itself would roll on and on: beyond the limit only back.
            let (high, low) =
                (outer.bank(limits.bank_rad, s.bank_rad), outer.bank(-limits.bank_rad, s.bank_rad));
            protection.note(Protection::BANK, rate > high || rate < low);
            wanted.roll_rate = Some(rate.clamp(low, high));
        }
        if let Some(normal) = wanted.normal {
            let climb = -state.velocity.z;
            let of = |up: f64| normal_for(up, s.bank_rad, s.climb_rad);
            // Without a state to be trusted there is no climb rate either.
            let known = basis != Basis::WingsLevel;
            let (down, up) = steepness(s.airspeed_mps, climb);
            let (most, least) = if known { (of(down), of(up)) } else { (0.0, f64::NEG_INFINITY) };
            protection.note(Protection::CLIMB, known && (normal < least || normal > most.max(-GRAVITY_MPS2)));
            let least = if slow { least.max(of(outer.floor(lack, climb))) } else { least };
            wanted.normal = Some(limits.normal(normal.min(most).max(least), &mut protection));
        }
        if let Some(axial) = wanted.axial {
            let least = if slow { outer.airspeed(lack + 1.0, s.climb_rad) } else { f64::NEG_INFINITY };
            wanted.axial = Some(axial.max(least));
        }
        (wanted, protection)
    }

    /// Specific acceleration in wind axes and the angles the loops need.
    fn measure(
        &mut self,
        state: &NavigationState,
        inputs: &ControllerInputs<'_>,
        basis: Basis,
        dt_s: f64,
    ) -> Signals {
        let air = state.air_velocity();
        // Direction of flight in body axes; below flying speed, or turned away from the nose, the trimmed one.
        let nose = Vector3::new(self.trim.alpha_rad.cos(), 0.0, self.trim.alpha_rad.sin());
        let flown = state.quaternion.inverse() * air;
        let forward = flown.try_normalize(8.0).filter(|x| x.x > 0.8).unwrap_or(nose);
        let right = Vector3::z().cross(&forward).try_normalize(1e-6).unwrap_or(Vector3::y());
        let down = forward.cross(&right);
        let force = state.specific_force;
        let mut signals = Signals {
            airspeed_mps: self.memory.airspeed_mps,
            density_kgpm3: inputs.density_kgpm3.filter(|x| (0.5..1.5).contains(x)).unwrap_or(1.2),
            axial_mps2: force.dot(&forward),
            lateral_mps2: force.y,
            normal_mps2: force.dot(&down),
            roll_rate_radps: state.rates.dot(&forward),
            pitch_rate_radps: state.rates.y,
            pitches_blind: false,
            pitches_late: basis == Basis::Estimator && state.sigmas.attitude.y > LATE_RAD,
            yaws_blind: false,
            yaw_rate_radps: state.rates.z,
            bank_rad: state.euler.x,
            pitch_rad: state.euler.y,
            climb_rad: (-(state.quaternion * forward).z).clamp(-1.0, 1.0).asin(),
        };
        let airspeed = self.airspeed(state, inputs, &signals, basis, dt_s).unwrap_or(air.norm());
        let airspeed = airspeed.clamp(self.envelope.measured_mps.0, self.envelope.measured_mps.1);
        self.memory.airspeed_mps = if self.memory.airspeed_mps > 0.0 {
            low_pass(self.memory.airspeed_mps, airspeed, AIRSPEED_LAG_S, dt_s)
        } else {
            airspeed
        };
        signals.airspeed_mps = self.memory.airspeed_mps;
        signals
    }

    /// The airspeed to fly on, m/s: the pitot's as long as it is believed.
    fn airspeed(
        &mut self,
        state: &NavigationState,
        inputs: &ControllerInputs<'_>,
        s: &Signals,
        basis: Basis,
        dt_s: f64,
    ) -> Option<f64> {
        // The ground carries the aircraft too while it takes off or lands.
        let near_ground = self.memory.take_off.is_some() || self.memory.landing.is_some();
        let in_air = !near_ground || state.altitude_m() > CARRIED_BY_WING_M;
        // An approach may need the airspeed of lift, down to the ground.
        let lands = self.memory.landing.is_some_and(|landing| !landing.is_on_ground());
        let was_believed = self.memory.airspeed_watch.is_believed();
        let pitot_mps = inputs.airspeed_mps.filter(|_| in_air && was_believed);
        let has_fixes = basis == Basis::Estimator && state.status == EstimatorStatus::Ready;
        let flying = self.memory.channels.pitch && (in_air || lands) && basis != Basis::WingsLevel;
        let comes_down = self.comes_down();
        // There is no wind without a pitot that told it.
        let by_wind_mps = (has_fixes && self.memory.wind.is_known()).then(|| state.air_velocity().norm());
        let frame = airspeed::Frame {
            pitot_mps: inputs.airspeed_mps,
            apart_mps: inputs.airspeed_mps.map_or(0.0, |pitot_mps| self.memory.gusts.apart_mps(pitot_mps)),
            away: self.away(state, pitot_mps.filter(|_| flying), has_fixes, dt_s),
            learnt_mps: by_wind_mps.filter(|_| !comes_down),
            density_kgpm3: s.density_kgpm3,
            elevator_rad: self.memory.last.elevator_rad,
            pitch_rate_radps: s.pitch_rate_radps,
            normal_mps2: s.normal_mps2,
            change_mps2: s.axial_mps2 - GRAVITY_MPS2 * s.climb_rad.sin(),
            flying,
            judged: in_air,
            dt_s,
        };
        match pitot_mps {
            Some(pitot_mps) => self.memory.gusts.step(pitot_mps, frame.change_mps2, dt_s),
            None => self.memory.gusts.pause(dt_s),
        }
        // What a stalled wing does says nothing of the pitot.
        let told_mps = match self.memory.stall.is_stalled() {
            true => self.memory.airspeed_watch.flown_mps(frame.pitot_mps, 0.0),
            false => self.memory.airspeed_watch.step(&self.airframe, &frame),
        };
        let believed = self.memory.airspeed_watch.is_believed();
        if believed && !(was_believed && flying) {
            self.memory.wind = WindWatch::default();
        }
        if believed || !has_fixes {
            return told_mps;
        }
        // Lift told it last in the air: with that on the wheels, the elevator would answer too little.
        if self.memory.landing.is_some_and(|landing| landing.is_on_ground()) {
            return told_mps.map(|mps| mps.min(landing::fastest_mps(state)));
        }
        // Lift is told badly by some elevators; satellites and the wind of before know about where the airspeed is.
        let Some(by_wind_mps) = by_wind_mps else { return told_mps };
        let gusts_mps = self.memory.wind.deviation_mps();
        let room_mps = |(deviations, most_mps): (f64, f64)| {
            if comes_down { most_mps } else { (deviations * gusts_mps).min(most_mps) }
        };
        let (below_mps, above_mps) = (room_mps(BELOW_BY_WIND), room_mps(ABOVE_BY_WIND));
        told_mps.map(|mps| mps.clamp(by_wind_mps - below_mps, by_wind_mps + above_mps))
    }

    /// How far the pitot (m/s, where it is believed) has come away from satellites and wind, see [`WindWatch::step`]. Not in a landing: the wind
    /// changes towards the ground.
    fn away(&mut self, state: &NavigationState, pitot_mps: Option<f64>, has_fixes: bool, dt_s: f64) -> f64 {
        let wind = &mut self.memory.wind;
        match pitot_mps.filter(|_| self.memory.landing.is_none()) {
            Some(pitot_mps) if has_fixes => return wind.step(state, pitot_mps, dt_s),
            Some(_) => wind.pause(dt_s),
            None => {}
        }
        0.0
    }

    /// On the straight way to the ground, or there.
    fn comes_down(&self) -> bool {
        self.memory.landing.is_some_and(|landing| landing.comes_down())
    }

    /// Where the path leads, at no airspeed that leaves too little lift for turns in these gusts.
    fn navigate(
        &mut self,
        state: &NavigationState,
        s: &Signals,
        commands: &LoopCommands,
        basis: Basis,
    ) -> Option<GuidanceOutput> {
        if !commands.navigation {
            self.guidance.disengage();
            return None;
        }
        let motion = motion_of(state);
        let stall_mps = self.envelope.stall_mps(&self.airframe, s.density_kgpm3);
        let least_mps = TURNS_SHARE * stall_mps + self.memory.gusts.deviation_mps();
        self.guidance.fly_within(least_mps.max(self.envelope.slowest_mps), None);
        if self.rolls_blind() {
            self.guidance.turn_no_steeper(roll::BANK_RAD);
        }
        // Without a position worth the name the path waits where it is.
        (basis != Basis::WingsLevel).then(|| self.guidance.step(&motion))
    }

    /// References of the inner loops; `None` for channels that are off.
    fn outer(
        &self,
        state: &NavigationState,
        s: &Signals,
        commands: &LoopCommands,
        guidance: Option<&GuidanceOutput>,
        basis: Basis,
    ) -> Wanted {
        let vertical = self.vertical(state, s, commands, guidance, basis);
        let bank = self.bank(state, s, commands, guidance, basis, vertical.unwrap_or(0.0));
        Wanted {
            bank: bank.filter(|_| commands.roll_rate_radps.is_none()),
            roll_rate: commands.roll_rate_radps,
            normal: self.normal(s, commands, vertical),
            axial: self.axial(s, commands, guidance, basis),
        }
    }

    /// Airspeed wanted, m/s: no more than the aircraft reaches, or it would give up its climb for what it never gets, and no less than
    /// it flies.
    fn airspeed_wanted(&self, commands: &LoopCommands, guidance: Option<&GuidanceOutput>) -> Option<f64> {
        let wanted = commands.airspeed_mps.or(guidance.map(|g| g.airspeed_mps));
        wanted.map(|airspeed_mps| self.envelope.flown_mps(airspeed_mps))
    }

    /// Vertical acceleration wanted, up, m/s².
    fn vertical(
        &self,
        state: &NavigationState,
        s: &Signals,
        commands: &LoopCommands,
        guidance: Option<&GuidanceOutput>,
        basis: Basis,
    ) -> Option<f64> {
        let outer = &self.config.outer;
        let target = commands.altitude_m.or(guidance.map(|g| g.altitude_m));
        if self.memory.power.is_lost() && target.is_some() {
            let glide_mps = self.envelope.glide_mps(&self.airframe, s.density_kgpm3);
            let climb = s.airspeed_mps * s.climb_rad.sin();
            return Some(outer.climb_rate(self.memory.power.climb_mps(glide_mps, s.airspeed_mps), climb));
        }
        if basis == Basis::WingsLevel {
            // No height to be trusted: keep the nose where level flight has it.
            let climb = s.airspeed_mps * (s.pitch_rad - self.trim.alpha_rad).sin();
            return (commands.navigation || target.is_some()).then(|| outer.climb_rate(0.0, climb));
        }
        let reference = self.airspeed_wanted(commands, guidance);
        let taking_off = self.memory.take_off.map(|take_off| self.climb_out_mps(&take_off, s));
        let reference = taking_off.or(reference);
        let lack = reference.map_or(0.0, |v| v - s.airspeed_mps);
        target.map(|altitude| outer.altitude(altitude - state.altitude_m(), -state.velocity.z, lack))
    }

    fn bank(
        &self,
        state: &NavigationState,
        s: &Signals,
        commands: &LoopCommands,
        guidance: Option<&GuidanceOutput>,
        basis: Basis,
        vertical: f64,
    ) -> Option<f64> {
        if commands.bank_rad.is_some() {
            return commands.bank_rad;
        }
        if basis == Basis::WingsLevel {
            return (commands.navigation || commands.track_rad.is_some()).then_some(0.0);
        }
        let velocity = Vector2::new(state.velocity.x, state.velocity.y);
        let sideways = commands.track_rad.map(|track| course_acceleration(track, &velocity));
        let sideways = sideways.or(guidance.map(|g| g.horizontal_mps2))?;
        let bank = self.config.outer.bank_for(sideways, vertical, s.climb_rad);
        // Wheels and wing tips are near the ground yet.
        let most = if self.memory.take_off.is_some() { TAKE_OFF_BANK_RAD } else { f64::INFINITY };
        Some(bank.clamp(-most, most))
    }

    fn normal(&self, s: &Signals, commands: &LoopCommands, vertical: Option<f64>) -> Option<f64> {
        let by_rate = commands.pitch_rate_radps.map(|rate| {
            // Q_w = −(C + g cos γ cos φ)/V, solved for C.
            -s.airspeed_mps * rate - GRAVITY_MPS2 * s.climb_rad.cos() * s.bank_rad.cos()
        });
        by_rate.or(commands.normal_mps2).or(vertical.map(|up| normal_for(up, s.bank_rad, s.climb_rad)))
    }

    fn axial(
        &self,
        s: &Signals,
        commands: &LoopCommands,
        guidance: Option<&GuidanceOutput>,
        basis: Basis,
    ) -> Option<f64> {
        let waiting = (basis == Basis::WingsLevel && commands.navigation).then_some(self.config.cruise_mps);
        let target = self.airspeed_wanted(commands, guidance).or(waiting);
        let floor = self.limits(s).floor_mps;
        let wanted = target.map(|v| v.max(floor) + self.memory.authority_mps);
        // Near the ground gusts take height and airspeed at once: a sink that was not asked for gives no airspeed back.
        let lacking_rad = match self.memory.pitch_hold.aim {
            Some(Aim::Climb { lacking_mps, .. }) if !s.pitches_blind => lacking_mps / s.airspeed_mps.max(1.0),
            _ => 0.0,
        };
        let climb_rad = s.climb_rad + LACKING_SHARE * lacking_rad;
        let share = if self.comes_down() { FINAL_SPEED_SHARE } else { 1.0 };
        let by_speed = wanted.map(|v| self.config.outer.airspeed(share * (v - s.airspeed_mps), climb_rad));
        commands.axial_mps2.or(by_speed)
    }

    /// Runs the loops that are on; channels that come on start where the actuators are.
    fn inner(
        &mut self,
        s: &Signals,
        wanted: &Wanted,
        commands: &LoopCommands,
        inputs: &ControllerInputs<'_>,
        dt_s: f64,
    ) -> ActuatorCommand {
        let lateral = commands.lateral_mps2.unwrap_or(0.0);
        let aim =
            self.memory.pitch_hold.aim.filter(|aim| !s.pitches_blind || matches!(aim, Aim::Attitude { .. }));
        // The normal loop begins where the elevator was held.
        self.memory.channels.pitch &= aim.is_some() || !self.memory.pitch_hold.is_on();
        if !self.memory.channels.pitch {
            self.memory.pitch_hold.release();
        }
        self.engage(s, wanted, lateral);
        self.slew_references(wanted, dt_s);
        let least_rad = self.least_elevator_rad(s);
        let (airframe, tuning, r) = (&self.airframe, &self.config.inner, &self.memory.references);
        let loops = &mut self.memory.loops;
        let mut command = inputs.pilot;
        if wanted.roll_rate.is_some() {
            command.aileron_rad = loops.roll(airframe, tuning, s, r.roll_rate_radps, dt_s);
        }
        if wanted.normal.is_some() {
            command.elevator_rad = match &aim {
                Some(aim) => {
                    self.memory.pitch_hold.step(airframe, s, aim, self.memory.last.elevator_rad, dt_s)
                }
                None => loops.normal(airframe, tuning, s, (r.normal_mps2, least_rad), dt_s),
            };
        }
        // What answers gusts near the ground is no trim.
        let trim_rad = if aim.is_some() { 0.0 } else { command.elevator_rad };
        let used = -trim_rad / airframe.servo.elevator_limit_rad;
        let more = AUTHORITY_GAIN_MPS * (used - ELEVATOR_COMFORT).max(0.0)
            + END_GAIN_MPS * (used - ELEVATOR_END).clamp(0.0, 1.0 - ELEVATOR_END);
        self.memory.authority_mps = low_pass(self.memory.authority_mps, more, AUTHORITY_LAG_S, dt_s);
        if wanted.axial.is_some() {
            command.throttle = loops.axial(airframe, tuning, s, r.axial_mps2, dt_s);
        }
        let limit = airframe.servo.rudder_limit_rad;
        let most = COORDINATING_SHARE * limit;
        let forward = airframe.coordinating_rudder(command.aileron_rad, s.roll_rate_radps, s.airspeed_mps);
        let rudder = loops.lateral(airframe, tuning, s, lateral, dt_s) + forward.clamp(-most, most);
        command.rudder_rad = rudder.clamp(-limit, limit);
        command
    }

    fn engage(&mut self, s: &Signals, wanted: &Wanted, lateral: f64) {
        let (airframe, tuning, last) = (&self.airframe, &self.config.inner, &self.memory.last);
        let loops = &mut self.memory.loops;
        if wanted.roll_rate.is_some() && !self.memory.channels.roll {
            self.memory.references.roll_rate_radps = s.roll_rate_radps.clamp(-1.6, 1.6);
            loops.engage_roll(airframe, tuning, s, self.memory.references.roll_rate_radps, last.aileron_rad);
        }
        if wanted.normal.is_some() && !self.memory.channels.pitch {
            let limits = self.envelope.limits(airframe, s.airspeed_mps, s.density_kgpm3, 0.0);
            self.memory.references.normal_mps2 = limits.normal(s.normal_mps2, &mut Protection::default());
            loops.engage_normal(airframe, tuning, s, self.memory.references.normal_mps2, last.elevator_rad);
        }
        if wanted.axial.is_some() && !self.memory.channels.thrust {
            self.memory.references.axial_mps2 = s.axial_mps2.clamp(-3.0, 4.0);
            loops.engage_axial(airframe, tuning, s, self.memory.references.axial_mps2, last.throttle);
        }
        if !self.memory.channels.yaw {
            loops.engage_lateral(airframe, tuning, s, lateral, last.rudder_rad);
        }
        self.memory.channels = Channels {
            roll: wanted.roll_rate.is_some(),
            pitch: wanted.normal.is_some(),
            yaw: true,
            thrust: wanted.axial.is_some(),
        };
    }

    fn slew_references(&mut self, wanted: &Wanted, dt_s: f64) {
        let r = &mut self.memory.references;
        let limit = self.config.outer.roll_rate_radps;
        if let Some(target) = wanted.roll_rate {
            r.roll_rate_radps =
                slew(r.roll_rate_radps, target.clamp(-limit, limit), ROLL_RATE_SLEW_RADPS2, dt_s);
        }
        if let Some(target) = wanted.normal {
            r.normal_mps2 = slew(r.normal_mps2, target, NORMAL_SLEW_MPS3, dt_s);
        }
        if let Some(target) = wanted.axial {
            r.axial_mps2 = slew(r.axial_mps2, target, AXIAL_SLEW_MPS3, dt_s);
        }
        r.bank_rad = wanted.bank.unwrap_or(r.bank_rad);
    }
}

/// What the outer loops ask of the inner ones: a bank, or a roll rate where nobody asks for a bank.
#[derive(Debug, Clone, Copy)]
struct Wanted {
    bank: Option<f64>,
    roll_rate: Option<f64>,
    normal: Option<f64>,
    axial: Option<f64>,
}

fn motion_of(state: &NavigationState) -> Motion {
    Motion { position: state.position.xy(), velocity: state.velocity.xy(), wind: state.wind }
}

fn trimmed(trim: &Trim) -> ActuatorCommand {
    ActuatorCommand { throttle: trim.throttle, elevator_rad: trim.elevator_rad, ..ActuatorCommand::default() }
}

#[cfg(test)]
mod tests;
