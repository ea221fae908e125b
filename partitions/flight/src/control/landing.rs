//! Landing on the runway's origin, or another place of its field, against the wind: a circle beside the final approach until height and place are right, a straight glide
//! slope, a flare, the touch-down, and the roll to a standstill.
//!
//! Responsible for where the aircraft is to be then, and for flying round once more where an approach goes wrong near the ground. Without
//! a range finder the height above ground is known to a metre or two only: it comes from a barometer that was set before take-off. So the flare ends in a
//! sink rate that wheels bear, and is flown with power until the ground holds the aircraft up, wherever that is.

use super::envelope::Envelope;
use super::inner::Signals;
use super::pitch_hold::Aim;
use super::power::PowerWatch;
use super::wheels;
use crate::airframe::Airframe;
use crate::attitude::{low_pass, wrap_angle};
use crate::estimator::{EstimatorStatus, NavigationState};
use crate::guidance::path::{Leg, Offset};
use crate::guidance::{Hold, course_acceleration, track_acceleration};
use crate::kept::kept;
use crate::servo::ActuatorCommand;
use crate::{GRAVITY_MPS2, STANDING_HEIGHT_M};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// Airspeed of the approach, of the one at which the wing just carries the weight; and what is added for each m/s of wind, m/s at most.
const APPROACH_SHARE: f64 = 1.45;
const WIND_SHARE: f64 = 0.5;
const MOST_FOR_WIND_MPS: f64 = 5.0;
/// A wind below this says nothing of where to land, m/s.
const CALM_MPS: f64 = 1.0;
/// Airspeed of the approach for a gust from ahead, m/s at most: what it gives is lost again when it ends.
const MOST_FOR_SHEAR_MPS: f64 = 5.0;
/// Level flight before the glide slope, in which the speed falls to that of the approach, m.
const LEVEL_M: f64 = 150.0;
/// The final approach is begun from the circle within this of the course, rad, of the height, m, and of the track as a share of the radius.
const ALIGNED_RAD: f64 = 0.3;
const ON_HEIGHT_M: f64 = 8.0;
const ON_TRACK_SHARE: f64 = 0.3;
/// After so long within so many radii of the circle's centre, s, these grow by themselves once in so long, s, to this many times at most:
/// with what is left of its sensors the aircraft holds it no better.
const NEAR_CIRCLE: f64 = 2.0;
const WAITS_S: f64 = 150.0;
const GROWS_S: f64 = 60.0;
const MOST_TIMES: f64 = 4.0;
/// Climb rate per height off the slope, 1/s; and how far it may differ from the slope's own, m/s.
const SLOPE_GAIN: f64 = 0.4;
const OFF_SLOPE_MPS: f64 = 1.5;
/// The flare begins below this height, m, and its sink rate, m/s, is reached below that one.
const FLARE_M: f64 = 6.0;
const FLARED_M: f64 = 1.5;
const TOUCH_SINK_MPS: f64 = 0.6;
/// The flare sinks so many times as fast at most where it would come down beyond its place.
const FASTER_FLARE: f64 = 1.5;
/// Vertical acceleration down at most there, m/s².
const FLARE_DOWN_MPS2: f64 = 1.5;
/// The same where the ground is seen to be near.
const NEAR_DOWN_MPS2: f64 = 0.7;
/// How much later than it is told to the aircraft sinks, s.
const SINKS_LATE_S: f64 = 0.4;
/// Banks near the ground, rad: in the final approach, and in the flare.
const FINAL_BANK_RAD: f64 = 0.44;
const FLARE_BANK_RAD: f64 = 0.09;
/// An approach goes wrong, below this height, m, where it is so far from its track, m, or from its slope, m; where, below the second height, it is
/// slower than this share of the airspeed that carries it, or sinks faster than this, m/s.
const DECISION_M: f64 = 25.0;
const ASIDE_M: f64 = 12.0;
const OFF_SLOPE_M: f64 = 10.0;
const FALLS_M: f64 = 12.0;
const SLOWEST_SHARE: f64 = 1.1;
const FASTEST_SINK_MPS: f64 = 6.0;
/// Flown round so often by itself, at most: then it lands as it comes.
const MOST_ROUNDS: f64 = 2.0;
/// The ground may hold the aircraft up where it sinks slower than this share of what it should, for so long, s: then it is to sink at this
/// rate, m/s, and where it does not for so long, s, it is the ground and no gust. Smoothing of the sink rate, s.
const HELD_SHARE: f64 = 0.35;
const DOUBT_S: f64 = 0.3;
const PRESSED_SINK_MPS: f64 = 1.0;
const HELD_S: f64 = 1.5;
/// The same without power, where nothing is lost if it was none, and below this height, m, where a range finder has found the ground.
const SURE_HELD_S: f64 = 0.4;
const TOUCH_M: f64 = 1.0;
/// It takes so long, s, where a range finder sees the ground so far below, m: that may be wrong.
const HIGH_M: f64 = 4.0;
const HIGH_HELD_S: f64 = 2.0;
/// More time at the beginning of the final approach, s.
const LEVEL_S: f64 = 2.0;
/// Above the flare it takes so long, too, where the aircraft is asked to sink faster than this, m/s; faster than the second counts as that.
const LEAST_ASKED_MPS: f64 = 0.8;
const MOST_ASKED_MPS: f64 = 1.5;
/// Normal specific acceleration by which a wheel has met the ground, where the ground is seen to be near, m/s².
const KNOCK_MPS2: f64 = 25.0;
/// A gust lifts what rises faster than this, m/s.
const LIFTED_MPS: f64 = 0.5;
const SINK_LAG_S: f64 = 0.3;
/// The same by the height alone, over bumps, and where the velocity strays from it.
const BUMPS_LAG_S: f64 = 0.8;
/// So far below the height at which it touched the ground, m, and sinking, it has not touched it; so far above it and rising it was thrown up, and
/// flies again. Slower than this, m/s, it is the height that drifts.
const FELL_M: f64 = 0.3;
const THROWN_UP_M: f64 = 2.5;
const FALLING_MPS: f64 = 0.25;
/// Attitude on the wheels below the incidence of the approach, rad: they are pressed on, and a hop sinks no faster than an approach does.
const WHEELS_RAD: f64 = 0.035;
/// Without a pitch rate, a nose wheel is kept off the ground by so much, rad.
const OFF_NOSE_WHEEL_RAD: f64 = 0.05;
/// Memory of that incidence, s.
const INCIDENCE_LAG_S: f64 = 4.0;
/// Below this share of the airspeed that carries it a wing carries nothing. Below the second one, or after so long, s, it rolls: till then a gust can
/// lift it.
const CARRIES_SHARE: f64 = 0.9;
const ROLLING_SHARE: f64 = 0.6;
const LONGEST_TOUCHED_S: f64 = 25.0;
/// No aircraft flies so slowly over ground, m/s, down here.
const SLOWLY_MPS: f64 = 2.0;
/// So slow in a wind of more than this share of the airspeed that carries it, it all but flies.
const WINDY_SHARE: f64 = 0.75;
/// High up those count after so long, s: it falls by then, if it was no ground.
const SURELY_DOWN_S: f64 = 4.0;
/// It stands slower than this over ground, m/s, for so long, s.
const STANDING_MPS: f64 = 0.7;
const STANDING_S: f64 = 1.5;

/// Without power: straight ahead before the flare, and from its beginning to the touch-down, s; the way out beyond the circle at most, m.
const GLIDE_FINAL_S: f64 = 12.0;
const GLIDE_FLOAT_S: f64 = 6.0;
/// Share of the height that the way is laid out for: turns cost more than a straight glide.
const GLIDE_SHARE: f64 = 0.85;
/// Height that is kept beyond, s of gliding: a final glide that is too long is flown faster.
const GLIDE_SPARE_S: f64 = 3.0;
/// Airspeed of the final glide beyond that of an approach with power, m/s; and beyond the one below which the elevator holds no flare, m/s.
const GLIDE_APPROACH_MPS: f64 = 1.5;
const GLIDE_MORE_MPS: f64 = 3.0;
const FARTHEST_M: f64 = 3_000.0;
/// The final glide is faster by this for each second that it would come too far, m/s, at most by so much, m/s.
const LONG_GAIN_MPS: f64 = 0.5;
const FASTER_MPS: f64 = 6.0;
/// Above this height, m, and in full so much higher, m.
const FASTER_M: f64 = 25.0;
/// Height above that where the flare ends, for each m/s that it sinks faster than it should there, s.
const GLIDE_FLARE_S: f64 = 2.2;
const HIGHEST_FLARE_M: f64 = 12.0;
/// Further off its way than this, rad, a way from where it is is laid out.
const TURNED_RAD: f64 = 0.5;
/// Height kept for the turn into the wind where the runway can not be reached, m.
const TURN_SPARE_M: f64 = 8.0;

/// What one may set on landings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandingConfig {
    /// Height at which the final approach begins, m above the runway.
    pub height_m: f64,
    /// Angle of the glide slope, rad.
    pub slope_rad: f64,
    /// Direction of the runway, rad from north; `None`: against the wind.
    pub course_rad: Option<f64>,
}

impl Default for LandingConfig {
    fn default() -> Self {
        Self { height_m: 50.0, slope_rad: 4f64.to_radians(), course_rad: None }
    }
}

/// Where a landing stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// On the circle beside the beginning of the final approach, or on the way there.
    Pattern,
    /// On the glide slope.
    Final,
    /// Near the ground.
    Flare,
    /// The ground holds it up; it is fast enough to fly yet.
    Touched,
    /// On its wheels.
    Rolling,
    /// It stands.
    Standing,
    /// Up again, straight on.
    Round,
}

/// A landing under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landing {
    /// Where it stands.
    pub phase: Phase,
    /// Direction of the final approach over ground, rad from north.
    pub course_rad: f64,
    /// Height at which that begins, m.
    height_m: f64,
    /// Side of the circle: +1 turns right.
    side: f64,
    /// How long this phase's end has been in sight, s.
    since_s: f64,
    /// Sink rate without its noise, m/s.
    sink_mps: f64,
    /// Height by the last seconds, m.
    mean_m: f64,
    /// Incidence of the approach: pitch above the climb through the air, rad.
    incidence_rad: f64,
    /// Height at which it touched the ground, m.
    touched_m: f64,
    /// Turned off its direction on the ground, rad.
    turned_rad: f64,
    /// Approaches that went wrong.
    rounds: f64,
    /// Where the touch-down is to be, m north and east of the runway's origin.
    place: Vector2<f64>,
    /// The height does not last to there: it lands where it comes down.
    short: bool,
}

/// Sink rate of the flare at a height, m/s, from that of the slope on.
fn flare_sink_mps(height_m: f64, slope_mps: f64) -> f64 {
    let share = ((height_m - FLARED_M) / (FLARE_M - FLARED_M)).clamp(0.0, 1.0);
    TOUCH_SINK_MPS + share * (slope_mps - TOUCH_SINK_MPS).max(0.0)
}

/// Time from a height in the flare that is not below [`FLARED_M`], m, to the touch-down, s; Simpson's rule over the height.
fn float_s(height_m: f64, slope_mps: f64) -> f64 {
    let (from_mps, to_mps) = (flare_sink_mps(height_m, slope_mps), TOUCH_SINK_MPS);
    let flaring_s = (height_m - FLARED_M) / 6.0 * (1.0 / from_mps + 8.0 / (from_mps + to_mps) + 1.0 / to_mps);
    // What it has sunk too far meanwhile.
    let late_m = SINKS_LATE_S * (from_mps - to_mps);
    flaring_s + (FLARED_M - STANDING_HEIGHT_M - late_m) / to_mps
}

/// That sink rate where the place of the touch-down is so far ahead, s, if that is known. Near the ground the contact counts alone. Where
/// the ground is not `measured`, it may be nearer than it seems.
fn flare_to_mps(height_m: f64, slope_mps: f64, left_s: Option<f64>, measured: bool) -> f64 {
    let sink_mps = flare_sink_mps(height_m, slope_mps);
    let most = if measured { FASTER_FLARE } else { 1.0 };
    match left_s.filter(|left_s| height_m > FLARED_M && *left_s > 0.0) {
        Some(left_s) => (sink_mps * (float_s(height_m, slope_mps) / left_s).min(most)).max(TOUCH_SINK_MPS),
        None => sink_mps,
    }
}

/// How it comes down without power.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Glide {
    /// As far as it goes, m/s.
    pub airspeed_mps: f64,
    /// What drag takes of the airspeed in level flight, m/s².
    pub slows_mps2: f64,
    /// Radius of a turn in the air, m.
    pub turn_m: f64,
    /// What is known of the motor.
    pub power: PowerWatch,
}

impl Glide {
    /// How long it is until the flare at an airspeed, m/s; s.
    fn lasts_s(&self, airspeed_mps: f64, state: &NavigationState) -> f64 {
        (state.altitude_m() - FLARE_M) / self.sink_mps(airspeed_mps)
    }

    /// At an airspeed, m/s.
    fn sink_mps(&self, airspeed_mps: f64) -> f64 {
        airspeed_mps * self.slows_mps2 / GRAVITY_MPS2
    }
}

/// What the loops are asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Approach {
    /// Climb rate, m/s.
    pub climb_mps: f64,
    /// Acceleration to the right, m/s²; `None`: wings level.
    pub sideways_mps2: Option<f64>,
    /// Greatest bank, rad.
    pub bank_rad: f64,
    /// m/s; `None`: the throttle closes.
    pub airspeed_mps: Option<f64>,
    /// Vertical acceleration up at least without an aim, m/s²: the nose is not to meet the ground first.
    pub least_mps2: f64,
    /// What the elevator is for; `None`: the normal loop has it.
    pub aim: Option<Aim>,
}

/// What one frame of a landing asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Flown {
    /// A circle, by guidance; `true`: on the way that leads there from here, whatever it was before.
    Circle(Hold, bool),
    /// Up and straight on: the height, m.
    Up(f64),
    /// By the outer loops.
    Loops(Approach),
    /// On the wheels.
    Wheels(ActuatorCommand),
}

/// Against the wind, rad from north; `None`: there is none.
fn against_rad(state: &NavigationState) -> Option<f64> {
    let wind = state.wind;
    (wind.norm() > CALM_MPS).then(|| (-wind.y).atan2(-wind.x))
}

/// Time of a turn from the track of the moment, s.
fn turn_s(glide: &Glide, state: &NavigationState, to_rad: f64) -> f64 {
    let course = state.velocity.y.atan2(state.velocity.x);
    wrap_angle(course - to_rad).abs() * glide.turn_m / glide.airspeed_mps
}

/// Where to come down short of the runway: against the wind if the height lasts for the turn, else straight ahead; rad from north.
fn down_rad(glide: &Glide, state: &NavigationState) -> f64 {
    let lasts =
        |against_rad: &f64| turn_s(glide, state, *against_rad) < glide.lasts_s(glide.airspeed_mps, state);
    against_rad(state).filter(lasts).unwrap_or_else(|| state.velocity.y.atan2(state.velocity.x))
}

/// Airspeed by velocity and wind, which may be wrong, by a pitot that is: no less than the speed over ground, m/s.
pub(super) fn fastest_mps(state: &NavigationState) -> f64 {
    let ground = state.velocity.xy();
    (ground - state.wind).norm().max(ground.norm())
}

impl Landing {
    /// A landing at a place (m north and east of the runway's origin) that begins where the aircraft is.
    pub fn new(config: &LandingConfig, state: &NavigationState, height_m: f64, place: Vector2<f64>) -> Self {
        let mut landing = Self {
            phase: Phase::Pattern,
            course_rad: 0.0,
            height_m: height_m.min(config.height_m),
            side: 1.0,
            since_s: 0.0,
            sink_mps: 0.0,
            mean_m: state.altitude_m(),
            incidence_rad: 0.0,
            touched_m: 0.0,
            turned_rad: 0.0,
            rounds: 0.0,
            place,
            short: false,
        };
        landing.lay_out(config, state);
        landing
    }

    /// Course by the wind, and the circle on the side where the aircraft is.
    fn lay_out(&mut self, config: &LandingConfig, state: &NavigationState) {
        let position = state.position.xy() - self.place;
        let straight = (-position.y).atan2(-position.x);
        self.course_rad = config.course_rad.or(against_rad(state)).unwrap_or(straight);
        let right_m = position.dot(&self.right());
        (self.phase, self.since_s, self.side) = (Phase::Pattern, 0.0, 1f64.copysign(right_m));
        self.short = false;
    }

    fn forward(&self) -> Vector2<f64> {
        Vector2::new(self.course_rad.cos(), self.course_rad.sin())
    }

    fn right(&self) -> Vector2<f64> {
        let forward = self.forward();
        Vector2::new(-forward.y, forward.x)
    }

    /// Where the straight way begins, so far before the runway's origin, m.
    fn final_m(&self, config: &LandingConfig, ground_mps: f64) -> f64 {
        let slope = config.slope_rad.tan();
        (self.height_m - FLARE_M) / slope + float_s(FLARE_M, ground_mps * slope) * ground_mps + LEVEL_M
    }

    fn offset(&self, length_m: f64, state: &NavigationState) -> Offset {
        Leg { from: self.place - length_m * self.forward(), to: self.place }.offset(&state.position.xy())
    }

    /// Flies round once more; false: it is on the ground.
    pub fn go_round(&mut self) -> bool {
        let flies = !self.is_on_ground();
        if flies {
            (self.phase, self.since_s) = (Phase::Round, 0.0);
        }
        flies
    }

    /// On its straight way to the ground, or there.
    pub(super) fn comes_down(&self) -> bool {
        !matches!(self.phase, Phase::Pattern | Phase::Round)
    }

    /// At the end of the flare, or held up by the ground.
    pub(super) fn is_low(&self, state: &NavigationState) -> bool {
        self.is_on_ground() || (self.phase == Phase::Flare && state.altitude_m() < FLARE_M)
    }

    /// Whether the ground holds it up.
    pub fn is_on_ground(&self) -> bool {
        matches!(self.phase, Phase::Touched | Phase::Rolling | Phase::Standing)
    }

    /// One frame. `measured`: the height of `state` is that above the ground. `more_mps`: airspeed that is kept in hand beside that for
    /// wind. `radius_m`: of circles in this wind; `cruise_mps`: airspeed on them. `glide`: there is no power.
    pub(super) fn step(
        &mut self,
        (airframe, envelope, config): (&Airframe, &Envelope, &LandingConfig),
        (state, measured): (&NavigationState, bool),
        (s, more_mps): (&Signals, f64),
        (radius_m, cruise_mps): (f64, f64),
        glide: Option<&Glide>,
        dt_s: f64,
    ) -> Flown {
        let wind_mps = state.wind.norm();
        let stall_mps = envelope.stall_mps(airframe, s.density_kgpm3);
        let more_mps =
            (WIND_SHARE * wind_mps).min(MOST_FOR_WIND_MPS) + if glide.is_none() { more_mps } else { 0.0 };
        let by_lift_mps = APPROACH_SHARE * stall_mps;
        let approach_mps = match glide {
            Some(_) => (by_lift_mps + GLIDE_APPROACH_MPS).max(envelope.slowest_mps + GLIDE_MORE_MPS),
            None => by_lift_mps.max(envelope.slowest_mps),
        } + more_mps;
        let ground_mps = (approach_mps - wind_mps).max(0.4 * approach_mps);
        let length_m = match glide {
            Some(glide) => self.glide_final_m(glide, radius_m, ground_mps, state),
            None => self.final_m(config, ground_mps),
        };
        let offset = self.offset(length_m, state);
        let has_fixes = state.status == EstimatorStatus::Ready;
        let gust_mps = if has_fixes { s.airspeed_mps - state.air_velocity().norm() } else { 0.0 };
        let asked_mps = approach_mps + gust_mps.clamp(0.0, MOST_FOR_SHEAR_MPS);
        // Nothing but the ground holds it up so low.
        let is_near = measured && state.altitude_m() < TOUCH_M;
        let is_high = measured && state.altitude_m() > HIGH_M;
        let flown_mps = state.velocity.xy().norm();
        // On the ground no lift tells the airspeed that a pitot does not.
        let rolling_mps = s.airspeed_mps.min(fastest_mps(state));
        let climb_mps = -state.velocity.z;
        self.sink_mps = low_pass(self.sink_mps, -climb_mps, SINK_LAG_S, dt_s);
        self.mean_m = low_pass(self.mean_m, state.altitude_m(), BUMPS_LAG_S, dt_s);
        // On the way to the circle it has not begun.
        let away_m = (self.centre(radius_m, length_m) - state.position.xy()).norm();
        let is_away = self.phase == Phase::Pattern && away_m > NEAR_CIRCLE * radius_m;
        self.since_s = if is_away { 0.0 } else { self.since_s + dt_s };
        if self.phase == Phase::Final && self.since_s < DOUBT_S {
            let now_rad = s.pitch_rad - s.climb_rad;
            // Zero is none yet: a glide's way may be too short to learn it from there.
            let before_rad = if self.incidence_rad == 0.0 { now_rad } else { self.incidence_rad };
            self.incidence_rad = low_pass(before_rad, now_rad, INCIDENCE_LAG_S, dt_s);
        }
        let slope = config.slope_rad.tan();
        let on_slope_m =
            FLARE_M + (offset.left_m - float_s(FLARE_M, ground_mps * slope) * ground_mps) * slope;
        let wanted_m = on_slope_m.min(self.height_m);
        let on_slope_mps = if on_slope_m < self.height_m { -flown_mps * slope } else { 0.0 }
            + (SLOPE_GAIN * (wanted_m - state.altitude_m())).clamp(-OFF_SLOPE_MPS, OFF_SLOPE_MPS);
        // A glide turns once more where its height lasts for it.
        let right_height = match glide {
            Some(glide) => {
                let straight_s = length_m / ground_mps - GLIDE_FLOAT_S;
                GLIDE_SHARE * glide.lasts_s(glide.airspeed_mps, state)
                    < straight_s + TAU * radius_m / glide.airspeed_mps
            }
            None => (state.altitude_m() - self.height_m).abs() < self.wider(glide) * ON_HEIGHT_M,
        };
        let flare_m = match glide {
            Some(_) => (GLIDE_FLARE_S * self.sink_mps).clamp(FLARE_M, HIGHEST_FLARE_M),
            None => FLARE_M,
        };
        match self.phase {
            Phase::Pattern | Phase::Round
                if glide
                    .is_some_and(|glide| self.falls_short(glide, radius_m, length_m, ground_mps, state)) =>
            {
                self.short = true;
                if let Some(glide) = glide {
                    self.course_rad = down_rad(glide, state);
                }
                self.enter(Phase::Final);
            }
            Phase::Pattern
                if right_height && self.is_before(&offset, length_m, radius_m, self.wider(glide), state) =>
            {
                self.enter(Phase::Final);
            }
            Phase::Final | Phase::Flare
                if glide.is_none()
                    && (self.goes_wrong(&offset, wanted_m, state) || self.falls(stall_mps, state, s)) =>
            {
                self.rounds += 1.0;
                self.enter(Phase::Round);
            }
            Phase::Final if state.altitude_m() < flare_m => self.enter(Phase::Flare),
            // A wheel has met the ground: flown on with power it would be thrown up again.
            Phase::Flare if is_near && s.normal_mps2 < -KNOCK_MPS2 => self.touch(state),
            Phase::Flare => {
                // As long as it sinks there is no ground, nor where it is lifted.
                let held = self.is_held(TOUCH_SINK_MPS, state, glide);
                self.since_s = if held { self.since_s } else { 0.0 };
                let held_s = match (glide.is_some() || is_near, is_high) {
                    (true, _) => SURE_HELD_S,
                    (_, true) => HIGH_HELD_S,
                    _ => HELD_S,
                };
                if self.since_s > held_s {
                    self.touch(state);
                }
            }
            Phase::Touched if self.flies_again(state) => {
                let high = state.altitude_m() > HIGHEST_FLARE_M;
                self.enter(if high { Phase::Final } else { Phase::Flare });
            }
            Phase::Touched
                if self.since_s > LONGEST_TOUCHED_S
                    || ((flown_mps < SLOWLY_MPS || rolling_mps < ROLLING_SHARE * stall_mps)
                        && (self.since_s > SURELY_DOWN_S || state.altitude_m() < HIGHEST_FLARE_M)) =>
            {
                self.enter(Phase::Rolling);
            }
            Phase::Rolling => {
                self.since_s = if flown_mps < STANDING_MPS { self.since_s } else { 0.0 };
                if self.since_s > STANDING_S {
                    self.enter(Phase::Standing);
                }
            }
            Phase::Round if glide.is_some() || state.altitude_m() > self.height_m - ON_HEIGHT_M => {
                self.lay_out(config, state);
            }
            // The ground is not where the heights have it, if they are wrong.
            Phase::Final | Phase::Round => {
                let held = match (self.phase, glide) {
                    (Phase::Round, _) => self.stands(stall_mps, state),
                    (_, Some(_)) => false, // a glide may be held up by rising air
                    (_, None) => {
                        let asked_mps = -on_slope_mps;
                        asked_mps > LEAST_ASKED_MPS
                            && self.is_held(asked_mps.min(MOST_ASKED_MPS), state, glide)
                    }
                };
                self.since_s = if held { self.since_s } else { 0.0 };
                if self.since_s > HIGH_HELD_S {
                    self.touch(state);
                }
            }
            _ => {}
        }
        if self.is_on_ground() {
            self.turned_rad += s.yaw_rate_radps * dt_s;
        }
        let sideways = match self.short {
            true => course_acceleration(self.course_rad, &state.velocity.xy()),
            false => track_acceleration(&offset, &state.velocity.xy(), 0.0, 1.0),
        };
        let is_doubtful = glide.is_none() && self.since_s > HELD_S;
        // With the elevator let go it would lift off again, or go onto its nose.
        let is_carried = wheels::has_tail_wheel(airframe)
            && flown_mps < SLOWLY_MPS
            && s.airspeed_mps.max(fastest_mps(state)) > WINDY_SHARE * stall_mps;
        match self.phase {
            Phase::Pattern => {
                let centre = self.centre(radius_m, length_m);
                let anew = glide.is_some() && self.turn_rad(&centre, radius_m, state) > TURNED_RAD;
                let hold = Hold {
                    north_m: centre.x,
                    east_m: centre.y,
                    radius_m,
                    side: self.side,
                    altitude_m: self.height_m,
                    airspeed_mps: cruise_mps,
                };
                Flown::Circle(hold, anew)
            }
            Phase::Round => Flown::Up(self.height_m),
            Phase::Final => Flown::Loops(Approach {
                climb_mps: match glide {
                    Some(glide) => {
                        let faster_mps = self.faster_mps(glide, &offset, flown_mps, approach_mps, state);
                        glide.power.climb_mps(approach_mps + faster_mps, s.airspeed_mps)
                    }
                    None => on_slope_mps,
                },
                sideways_mps2: Some(sideways),
                bank_rad: if is_doubtful { FLARE_BANK_RAD } else { FINAL_BANK_RAD },
                airspeed_mps: glide.is_none().then_some(asked_mps),
                least_mps2: f64::NEG_INFINITY,
                // If it is the ground, the normal loop would push it onto its nose.
                aim: is_doubtful.then(|| self.attitude(on_slope_mps, s)),
            }),
            Phase::Flare => {
                let left_s = has_fixes.then_some(offset.left_m / flown_mps.max(1.0));
                let sink_mps = match glide {
                    _ if self.may_be_ground(is_near) => PRESSED_SINK_MPS,
                    Some(_) => TOUCH_SINK_MPS + (state.altitude_m() - FLARED_M).max(0.0) / GLIDE_FLARE_S,
                    None => flare_to_mps(state.altitude_m(), ground_mps * slope, left_s, measured),
                };
                let climb_mps = -sink_mps;
                Flown::Loops(Approach {
                    climb_mps,
                    sideways_mps2: Some(sideways),
                    bank_rad: FLARE_BANK_RAD,
                    airspeed_mps: glide.is_none().then_some(asked_mps),
                    least_mps2: -if is_near { NEAR_DOWN_MPS2 } else { FLARE_DOWN_MPS2 },
                    aim: glide.is_none().then(|| match self.may_be_ground(is_near) {
                        true => self.attitude(climb_mps, s),
                        false => self.sinking(climb_mps, state, s),
                    }),
                })
            }
            Phase::Rolling | Phase::Standing if !is_carried => {
                let elevator_rad =
                    if wheels::has_tail_wheel(airframe) { wheels::tail_down_rad(airframe) } else { 0.0 };
                Flown::Wheels(wheels::straight_on(
                    airframe,
                    envelope,
                    s,
                    self.turned_rad,
                    (0.0, elevator_rad),
                ))
            }
            Phase::Touched | Phase::Rolling | Phase::Standing => Flown::Loops(Approach {
                climb_mps: -TOUCH_SINK_MPS,
                sideways_mps2: None,
                bank_rad: 0.0,
                airspeed_mps: None,
                least_mps2: -FLARE_DOWN_MPS2,
                aim: Some(self.on_wheels(airframe, s, rolling_mps < stall_mps)),
            }),
        }
    }

    /// Airspeed beyond that of the approach, m/s, where a final glide would come too far.
    fn faster_mps(
        &self,
        glide: &Glide,
        offset: &Offset,
        flown_mps: f64,
        approach_mps: f64,
        state: &NavigationState,
    ) -> f64 {
        let long_s = glide.lasts_s(approach_mps, state) + GLIDE_FLOAT_S - offset.left_m / flown_mps.max(1.0);
        let high = ((state.altitude_m() - FASTER_M) / FASTER_M).clamp(0.0, 1.0);
        let most_mps = if self.short { 0.0 } else { FASTER_MPS * high };
        (LONG_GAIN_MPS * long_s).clamp(0.0, most_mps)
    }

    /// Something holds the flare up. `is_near`: the ground is seen.
    fn may_be_ground(&self, is_near: bool) -> bool {
        self.since_s > DOUBT_S && !is_near
    }

    /// The attitude in which the approach's incidence gives a climb rate, m/s, rad.
    fn pitch_rad(&self, climb_mps: f64, s: &Signals) -> f64 {
        self.incidence_rad + climb_mps / s.airspeed_mps.max(1.0)
    }

    /// That attitude held: on the ground a sink rate that does not come would be sought until the nose is there.
    fn attitude(&self, climb_mps: f64, s: &Signals) -> Aim {
        Aim::Attitude { pitch_rad: self.pitch_rad(climb_mps, s), is_slow: false }
    }

    /// A climb rate, m/s.
    fn sinking(&self, climb_mps: f64, state: &NavigationState, s: &Signals) -> Aim {
        Aim::Climb {
            about_rad: self.pitch_rad(climb_mps, s),
            lacking_mps: climb_mps + state.velocity.z,
            gust_mps: s.airspeed_mps - state.air_velocity().norm(),
        }
    }

    /// The attitude that keeps it on its wheels: a nose wheel is not to come down first. Where the pitch rate is not known, nothing damps what
    /// one that did would do.
    fn on_wheels(&self, airframe: &Airframe, s: &Signals, is_slow: bool) -> Aim {
        let least_rad = match (wheels::has_tail_wheel(airframe), s.pitches_blind) {
            (true, _) => f64::NEG_INFINITY,
            (_, true) => wheels::stance_rad(airframe) + OFF_NOSE_WHEEL_RAD,
            _ => 0.0,
        };
        Aim::Attitude { pitch_rad: (self.incidence_rad - WHEELS_RAD).max(least_rad), is_slow }
    }

    /// Rudder in place of the coordinated one, rad.
    pub(super) fn rudder_rad(&self, airframe: &Airframe, s: &Signals) -> Option<f64> {
        self.is_on_ground().then(|| wheels::rudder_rad(airframe, s, self.turned_rad))
    }

    /// It fell on after it had touched the ground, or was thrown up.
    fn flies_again(&self, state: &NavigationState) -> bool {
        let above_m = state.altitude_m() - self.touched_m;
        let fell = above_m < -FELL_M && self.sink_mps > FALLING_MPS;
        fell || (above_m > THROWN_UP_M && self.sink_mps < -FALLING_MPS)
    }

    /// The ground holds it up.
    fn touch(&mut self, state: &NavigationState) {
        (self.turned_rad, self.touched_m) = (0.0, state.altitude_m());
        if state.altitude_m() < FALLS_M {
            self.rounds = MOST_ROUNDS; // no full power after a hop
        }
        self.enter(Phase::Touched);
    }

    fn enter(&mut self, phase: Phase) {
        // The final approach begins in level flight.
        (self.phase, self.since_s) = (phase, if phase == Phase::Final { -LEVEL_S } else { 0.0 });
    }

    /// How far before the runway's origin the straight way of a glide begins, m: as near as it may where the height does not last for
    /// more, and where it does, as far out as uses it up, if it does not last for another turn.
    fn glide_final_m(&self, glide: &Glide, radius_m: f64, ground_mps: f64, state: &NavigationState) -> f64 {
        let nearest_m = (GLIDE_FINAL_S + GLIDE_FLOAT_S) * ground_mps;
        let spare_s = |length_m: f64| {
            let straight_s = length_m / ground_mps - GLIDE_FLOAT_S;
            GLIDE_SHARE * glide.lasts_s(glide.airspeed_mps, state)
                - GLIDE_SPARE_S
                - self.way_s(glide, radius_m, length_m, state)
                - straight_s
        };
        let turn_s = TAU * radius_m / glide.airspeed_mps;
        if !(0.0..turn_s).contains(&spare_s(nearest_m)) {
            return nearest_m;
        }
        let (mut near_m, mut far_m) = (nearest_m, nearest_m + FARTHEST_M);
        for _ in 0..12 {
            let middle_m = 0.5 * (near_m + far_m);
            if spare_s(middle_m) > 0.0 {
                near_m = middle_m;
            } else {
                far_m = middle_m;
            }
        }
        near_m
    }

    /// Centre of the circle whose tangent the straight way is.
    fn centre(&self, radius_m: f64, length_m: f64) -> Vector2<f64> {
        self.place - length_m * self.forward() + self.side * radius_m * self.right()
    }

    /// Turn to where the way to a circle leads, or round it, rad.
    fn turn_rad(&self, centre: &Vector2<f64>, radius_m: f64, state: &NavigationState) -> f64 {
        let inwards = centre - state.position.xy();
        let aside_rad = (radius_m / inwards.norm().max(radius_m)).asin();
        let course = state.velocity.y.atan2(state.velocity.x);
        wrap_angle(inwards.y.atan2(inwards.x) - self.side * aside_rad - course).abs()
    }

    /// Time of a glide to the circle and round it to the beginning of the straight way, s.
    fn way_s(&self, glide: &Glide, radius_m: f64, length_m: f64, state: &NavigationState) -> f64 {
        let bearing = |way: &Vector2<f64>| way.y.atan2(way.x);
        let out = state.position.xy() - self.centre(radius_m, length_m);
        let distance_m = out.norm().max(1.0);
        let share = (radius_m / distance_m).min(1.0);
        let straight_m = (distance_m * distance_m - radius_m * radius_m).max(0.0).sqrt();
        let tangent = -self.side * self.right();
        let round_rad = (self.side * (bearing(&tangent) - bearing(&out)) - share.acos()).rem_euclid(TAU);
        // First it turns to where the way leads.
        let turn_rad = self.turn_rad(&self.centre(radius_m, length_m), radius_m, state);
        let straight_mps =
            (glide.airspeed_mps - state.wind.dot(&out) / distance_m).max(0.3 * glide.airspeed_mps);
        // The wind takes from one side of a circle more than it gives on the other.
        let wind_share = (state.wind.norm() / glide.airspeed_mps).min(0.7);
        let round_mps = glide.airspeed_mps * (1.0 - wind_share * wind_share).sqrt();
        straight_m / straight_mps + (turn_rad + round_rad) * radius_m / round_mps
    }

    /// The height does not last to the runway, and no longer than the turn into the wind takes.
    fn falls_short(
        &self,
        glide: &Glide,
        radius_m: f64,
        length_m: f64,
        ground_mps: f64,
        state: &NavigationState,
    ) -> bool {
        let turn_s = against_rad(state).map_or(0.0, |against_rad| turn_s(glide, state, against_rad));
        let spare_s =
            glide.lasts_s(glide.airspeed_mps, state) - TURN_SPARE_M / glide.sink_mps(glide.airspeed_mps);
        let way_s = self.way_s(glide, radius_m, length_m, state) + length_m / ground_mps - GLIDE_FLOAT_S;
        spare_s < turn_s.min(way_s)
    }

    /// Whether the straight way begins here, in its direction.
    fn is_before(
        &self,
        offset: &Offset,
        length_m: f64,
        radius_m: f64,
        wider: f64,
        state: &NavigationState,
    ) -> bool {
        let course = state.velocity.y.atan2(state.velocity.x);
        let aside_m = offset.right_m.abs();
        let aligned = wrap_angle(course - self.course_rad).abs() < wider * ALIGNED_RAD;
        let there = aside_m < wider * ON_TRACK_SHARE * radius_m
            && (offset.left_m - length_m).abs() < wider * 0.5 * radius_m;
        aligned && there
    }

    /// How many times what a circle is usually left with is enough. The way of a glide is laid out for its height.
    fn wider(&self, glide: Option<&Glide>) -> f64 {
        match glide {
            Some(_) => 1.0,
            None => (1.0 + (self.since_s - WAITS_S) / GROWS_S).clamp(1.0, MOST_TIMES),
        }
    }

    /// It does not sink where it is asked to, m/s: by its vertical speed, or with power, where there is time, by its height. That leaps where the
    /// ground becomes known.
    fn is_held(&self, asked_mps: f64, state: &NavigationState, glide: Option<&Glide>) -> bool {
        let most_mps = HELD_SHARE * asked_mps;
        let mean_mps = (self.mean_m - state.altitude_m()) / BUMPS_LAG_S;
        (-LIFTED_MPS..most_mps).contains(&self.sink_mps) || (glide.is_none() && mean_mps.abs() < most_mps)
    }

    /// It is too slow to fly, and neither climbs nor sinks.
    fn stands(&self, stall_mps: f64, state: &NavigationState) -> bool {
        fastest_mps(state) < CARRIES_SHARE * stall_mps && self.sink_mps.abs() < LIFTED_MPS
    }

    fn goes_wrong(&self, offset: &Offset, wanted_m: f64, state: &NavigationState) -> bool {
        let low = state.altitude_m() < DECISION_M;
        let off = state.altitude_m() - wanted_m;
        let off_slope = self.phase == Phase::Final && off.abs() > OFF_SLOPE_M;
        low && self.rounds < MOST_ROUNDS && (offset.right_m.abs() > ASIDE_M || off_slope)
    }

    fn falls(&self, stall_mps: f64, state: &NavigationState, s: &Signals) -> bool {
        let low = state.altitude_m() < FALLS_M && self.rounds < MOST_ROUNDS;
        low && (s.airspeed_mps < SLOWEST_SHARE * stall_mps || self.sink_mps > FASTEST_SINK_MPS)
    }
}

kept!(Phase = Pattern | Final | Flare | Touched | Rolling | Standing | Round);
kept!(Landing {
    phase: Phase,
    course_rad: f64,
    height_m: f64,
    side: f64,
    since_s: f64,
    sink_mps: f64,
    mean_m: f64,
    incidence_rad: f64,
    touched_m: f64,
    turned_rad: f64,
    rounds: f64,
    place: Vector2<f64>,
    short: bool,
} if |landing| landing.side.abs() == 1.0);

#[cfg(test)]
#[path = "landing_tests.rs"]
mod tests;
