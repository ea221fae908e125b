//! On the ground: straight on by the rudder and the steered wheel, wings level.

use super::envelope::Envelope;
use super::inner::Signals;
use crate::airframe::{Airframe, Gear};
use crate::servo::ActuatorCommand;

/// Rudder per heading lost, and per yaw rate, s.
const STEER_GAIN: f64 = 1.5;
const STEER_DAMPING_S: f64 = 0.35;
/// Share of both where the gyroscope does not tell the yaw rate: the heading comes too late to steer by.
const BLIND_SHARE: f64 = 0.1;
/// Ailerons move more while the air flows slowly over them, up to so many times.
const SLOWEST_SHARE: f64 = 5.0;
/// Aileron per bank, and per roll rate, s: wheels carry, the wings are only kept from dropping.
const LEVEL_GAIN: f64 = 0.5;
const LEVEL_DAMPING_S: f64 = 0.05;

/// No aircraft stands steeper, rad; files are not checked for that.
const STANCE_RAD: f64 = 0.3;
/// Share of the elevator's travel up with which a tail wheel is held on the ground.
const TAIL_DOWN_SHARE: f64 = 0.5;

/// The elevator (rad) that holds a tail wheel on the ground.
pub(super) fn tail_down_rad(airframe: &Airframe) -> f64 {
    -TAIL_DOWN_SHARE * airframe.servo.elevator_limit_rad
}

/// Whether the aircraft's third wheel is behind its main ones.
pub(super) fn has_tail_wheel(airframe: &Airframe) -> bool {
    airframe.gear.is_some_and(|gear| gear.third_wheel_m[0] < 0.0)
}

/// Pitch (rad) with which it stands on all its wheels.
pub(super) fn stance_rad(airframe: &Airframe) -> f64 {
    let stance_rad = |gear: Gear| {
        let (third, main) = (gear.third_wheel_m, gear.main_wheel_m?);
        Some(((third[2] - main[2]) / (third[0] - main[0])).atan().clamp(-STANCE_RAD, STANCE_RAD))
    };
    airframe.gear.and_then(stance_rad).unwrap_or(0.0)
}

/// The rudder (rad) that brings it back to the direction from which it has turned by `turned_rad`.
pub(super) fn rudder_rad(airframe: &Airframe, s: &Signals, turned_rad: f64) -> f64 {
    // The third wheel is steered with the rudder, whose sign is that of its yawing moment, or the usual one without it.
    let left = if airframe.aerodynamics.yaw_rudder > 0.0 { -1.0 } else { 1.0 };
    let limit = airframe.servo.rudder_limit_rad;
    let share = if s.yaws_blind { BLIND_SHARE } else { 1.0 };
    (left * share * (STEER_GAIN * turned_rad + STEER_DAMPING_S * s.yaw_rate_radps)).clamp(-limit, limit)
}

/// Actuators that keep it straight on, with a throttle and an elevator (rad).
pub(super) fn straight_on(
    airframe: &Airframe,
    envelope: &Envelope,
    s: &Signals,
    turned_rad: f64,
    (throttle, elevator_rad): (f64, f64),
) -> ActuatorCommand {
    let limit = &airframe.servo;
    let speed = s.airspeed_mps / envelope.rotation_mps(airframe, s.density_kgpm3);
    let level = -LEVEL_GAIN * s.bank_rad - LEVEL_DAMPING_S * s.roll_rate_radps;
    let level = level * (1.0 / speed.max(0.1)).powi(2).clamp(1.0, SLOWEST_SHARE);
    let held = |x: f64, limit: f64| x.clamp(-limit, limit);
    ActuatorCommand {
        throttle,
        aileron_rad: held(level, limit.aileron_limit_rad),
        elevator_rad: held(elevator_rad, limit.elevator_limit_rad),
        rudder_rad: rudder_rad(airframe, s, turned_rad),
    }
}
