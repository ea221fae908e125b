//! Taking off by itself: a roll along the direction in which the aircraft stands, or a launch by hand or catapult; then a climb
//! straight ahead.
//!
//! Responsible for what is special about it, up to a height; then whatever was ordered goes on. On the ground the estimate of the
//! heading moves as the filter finds its biases, so the direction is kept by what the gyroscope integrates. It must never leave the
//! ground after it has been told to stop, and it stops by itself when it does not go straight or does not get fast.

use super::envelope::Envelope;
use super::inner::Signals;
use super::wheels;
use crate::airframe::Airframe;
use crate::kept::kept;
use crate::servo::ActuatorCommand;

/// Throttle opens by this each second: a propeller's torque must not turn the aircraft off its wheels.
const THROTTLE_RATE: f64 = 2.0;
/// A tail wheel is held down up to this share of the speed of leaving the ground: it steers only then, and a tail left low longer makes the wing
/// lift too early.
const TAIL_UP_SHARE: f64 = 0.45;
/// Then it is raised to this pitch, rad, by so much elevator per pitch, and per pitch rate, s.
const TAIL_UP_PITCH_RAD: f64 = 0.05;
const TAIL_UP_GAIN: f64 = 0.8;
const TAIL_UP_DAMPING_S: f64 = 0.12;
/// A roll that has lost this much of its direction is given up, rad.
const ASTRAY_RAD: f64 = 0.45;
/// So is one that is not fast enough after this, s.
const LONGEST_ROLL_S: f64 = 40.0;
/// So is one that is much faster over ground than by the pitot, and would fly long since: shares of the airspeed at which it leaves
/// the ground, and of the ground speed.
const OVERDUE_SHARE: f64 = 1.3;
const BELIEVABLE_SHARE: f64 = 0.6;
/// A launch is an axial specific acceleration beyond this, m/s², for so long, s: gusts and hands do less.
const LAUNCH_MPS2: f64 = 6.0;
const LAUNCH_S: f64 = 0.1;
/// Airspeed of the climb, of the one at which it leaves the ground.
const CLIMB_SHARE: f64 = 1.15;

/// How an aircraft leaves the ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Rolls on its wheels.
    #[default]
    Roll,
    /// Is thrown: the motor starts when it is.
    Launch,
}

/// Where a take-off stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Throttle closed, in the hands of who launches it.
    Waiting,
    /// On its wheels.
    Rolling,
    /// In the air, below the height asked for.
    Climbing,
    /// Given up: throttle closed, straight on, until the autopilot is switched off.
    Aborted,
}

/// A take-off under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TakeOff {
    /// Where it stands.
    pub phase: Phase,
    /// Time in this phase, s; of a launch that is awaited, how long it has been pushed.
    since_s: f64,
    /// Turned off its direction so far, rad.
    turned_rad: f64,
    /// Direction of the climb over ground, rad from north.
    pub course_rad: f64,
    /// Height at which it is over, m above the runway, where it is not that of the settings.
    pub(super) height_m: Option<f64>,
}

impl TakeOff {
    pub(super) fn new(method: Method, height_m: Option<f64>) -> Self {
        let phase = match method {
            Method::Roll => Phase::Rolling,
            Method::Launch => Phase::Waiting,
        };
        Self { phase, since_s: 0.0, turned_rad: 0.0, course_rad: 0.0, height_m }
    }

    /// Whether nothing has moved yet.
    pub(super) fn is_fresh(&self) -> bool {
        self.since_s == 0.0 && matches!(self.phase, Phase::Waiting | Phase::Rolling)
    }

    /// Gives it up, if it is on the ground still; false: too late.
    pub(super) fn abort(&mut self) -> bool {
        let stops = self.phase != Phase::Climbing;
        if stops {
            (self.phase, self.since_s) = (Phase::Aborted, 0.0);
        }
        stops
    }

    /// One frame on the ground or in somebody's hands. The ground track is its direction (rad from north) and the speed along it
    /// (m/s), `known` whether there is a state.
    pub(super) fn advance(
        &mut self,
        airframe: &Airframe,
        envelope: &Envelope,
        s: &Signals,
        (course_rad, ground_mps): (f64, f64),
        known: bool,
        dt_s: f64,
    ) {
        let fast = envelope.rotation_mps(airframe, s.density_kgpm3).max(10.5);
        match self.phase {
            Phase::Waiting => {
                let pushed = s.axial_mps2 > LAUNCH_MPS2;
                self.since_s = if pushed { self.since_s + dt_s } else { 0.0 };
                if self.since_s >= LAUNCH_S || (known && s.airspeed_mps > fast) {
                    (self.phase, self.course_rad) = (Phase::Climbing, course_rad);
                }
            }
            Phase::Rolling => {
                self.since_s += dt_s;
                self.turned_rad += s.yaw_rate_radps * dt_s;
                let unbelievable =
                    ground_mps > OVERDUE_SHARE * fast && s.airspeed_mps < BELIEVABLE_SHARE * ground_mps;
                let lost = self.turned_rad.abs() > ASTRAY_RAD
                    || self.since_s > LONGEST_ROLL_S
                    || unbelievable
                    || !known;
                if lost {
                    self.abort();
                } else if s.airspeed_mps >= fast {
                    (self.phase, self.course_rad) = (Phase::Climbing, course_rad);
                }
            }
            Phase::Climbing => {}
            Phase::Aborted => self.turned_rad += s.yaw_rate_radps * dt_s,
        }
    }

    /// Actuators on the ground, where it moves at `ground_mps`; `None` in the air, where the loops fly.
    pub(super) fn actuators(
        &self,
        airframe: &Airframe,
        envelope: &Envelope,
        s: &Signals,
        ground_mps: f64,
        last: &ActuatorCommand,
        dt_s: f64,
    ) -> Option<ActuatorCommand> {
        let throttle = match self.phase {
            Phase::Climbing => return None,
            Phase::Rolling => (last.throttle + THROTTLE_RATE * dt_s).min(1.0),
            Phase::Waiting | Phase::Aborted => 0.0,
        };
        let tail_wheel = wheels::has_tail_wheel(airframe);
        let rotation = envelope.rotation_mps(airframe, s.density_kgpm3);
        let elevator_rad = match self.phase {
            // Wind from the side is airspeed too, and the tail wheel is needed all the more then.
            Phase::Rolling if tail_wheel && ground_mps < TAIL_UP_SHARE * rotation => {
                wheels::tail_down_rad(airframe)
            }
            Phase::Rolling if tail_wheel => {
                -TAIL_UP_GAIN * (TAIL_UP_PITCH_RAD - s.pitch_rad) + TAIL_UP_DAMPING_S * s.pitch_rate_radps
            }
            _ => 0.0,
        };
        Some(wheels::straight_on(airframe, envelope, s, self.turned_rad, (throttle, elevator_rad)))
    }

    /// The airspeed (m/s) below which it does not climb.
    pub(super) fn climb_mps(&self, airframe: &Airframe, envelope: &Envelope, density_kgpm3: f64) -> f64 {
        CLIMB_SHARE * envelope.rotation_mps(airframe, density_kgpm3).max(10.5)
    }
}

kept!(Phase = Waiting | Rolling | Climbing | Aborted);
kept!(TakeOff { phase: Phase, since_s: f64, turned_rad: f64, course_rad: f64, height_m: Option<f64> });
