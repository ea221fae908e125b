//! Straight steady flight: the angles and controls at which nothing accelerates. An aircraft with a rudder flies it with wings
//! level, one without with a little bank.

use crate::Controls;
use crate::aerodynamics::Surfaces;
use crate::airframe::Airframe;
use crate::atmosphere::GRAVITY_MPS2;
use crate::dynamics::{Held, Model};
use crate::rigid_body::{Rate, RigidState};
use crate::wind::AirMotion;
use nalgebra::{Matrix6, UnitQuaternion, Vector2, Vector3, Vector6};
use thiserror::Error;

/// Heading north, no wind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trim {
    /// Airspeed, m/s.
    pub airspeed_mps: f64,
    /// Flight path above the horizon, rad.
    pub climb_angle_rad: f64,
    /// Angle of attack, rad.
    pub alpha_rad: f64,
    /// Sideslip, rad: small, it balances the propeller's torque.
    pub beta_rad: f64,
    /// Bank, rad: zero with a rudder.
    pub bank_rad: f64,
    /// Surfaces and throttle.
    pub controls: Controls,
}

/// No trim exists, or the search did not find it.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TrimError {
    /// Newton's method did not come to rest.
    #[error("no trim found at {airspeed_mps} m/s: an acceleration of {residual:.3e} (m/s², rad/s²) remains")]
    NotFound {
        /// Airspeed asked for, m/s.
        airspeed_mps: f64,
        /// Largest acceleration left.
        residual: f64,
    },
    /// A control would have to go beyond its stop.
    #[error("trim at {airspeed_mps} m/s needs {control} at {}, beyond its limit of {}", reach(control, *value), reach(control, *limit))]
    OutOfReach {
        /// Airspeed asked for, m/s.
        airspeed_mps: f64,
        /// Which control.
        control: &'static str,
        /// The value it would need, rad or 1.
        value: f64,
        /// The stop that it would have to go beyond, rad or 1.
        limit: f64,
    },
}

/// High above a ground that is equally far below, so that no wheel touches, m.
pub(crate) const CLEAR_M: f64 = 1000.0;

/// Bank of straight flight, at most, rad: with more an aircraft without a rudder is not trimmed but slips.
const STEEPEST_RAD: f64 = 0.17;

/// Unknowns: α, β, aileron, elevator, rudder or, without one, bank, throttle.
type Unknowns = Vector6<f64>;

/// State and held inputs that belong to a set of unknowns.
pub(crate) fn flight_state(trim: &Trim, heading_rad: f64, position: Vector3<f64>) -> RigidState {
    let (alpha, beta) = (trim.alpha_rad, trim.beta_rad);
    let along =
        Vector3::new(alpha.cos() * beta.cos(), beta.sin(), alpha.sin() * beta.cos()) * trim.airspeed_mps;
    let pitched = UnitQuaternion::from_euler_angles(trim.bank_rad, pitch(trim), 0.0);
    // The nose stands off the track by what sideslip turns the velocity away from it.
    let drift = (pitched * along).y.atan2((pitched * along).x);
    let attitude = UnitQuaternion::from_euler_angles(trim.bank_rad, pitch(trim), heading_rad - drift);
    RigidState { position, velocity: attitude * along, attitude, rates: Vector3::zeros() }
}

/// Pitch angle at which the velocity climbs as asked: sin γ = sin θ cos α cos β − cos θ (sin φ sin β + cos φ sin α cos β).
fn pitch(trim: &Trim) -> f64 {
    let (alpha, beta, bank) = (trim.alpha_rad, trim.beta_rad, trim.bank_rad);
    if bank == 0.0 {
        let slope = (trim.climb_angle_rad.sin() / beta.cos()).clamp(-1.0, 1.0);
        return alpha + slope.asin();
    }
    let along = alpha.cos() * beta.cos();
    let below = bank.sin() * beta.sin() + bank.cos() * alpha.sin() * beta.cos();
    below.atan2(along)
        + (trim.climb_angle_rad.sin() / Vector2::new(along, below).norm()).clamp(-1.0, 1.0).asin()
}

struct Problem<'a> {
    model: &'a Model,
    airspeed_mps: f64,
    climb_angle_rad: f64,
    position: Vector3<f64>,
}

impl Problem<'_> {
    fn trim(&self, x: &Unknowns) -> Trim {
        let has_rudder = self.model.airframe.aerodynamics.yaw_rudder != 0.0;
        let (rudder_rad, bank_rad) = if has_rudder { (x[4], 0.0) } else { (0.0, x[4]) };
        let controls = Controls { aileron_rad: x[2], elevator_rad: x[3], rudder_rad, throttle: x[5] };
        Trim {
            airspeed_mps: self.airspeed_mps,
            climb_angle_rad: self.climb_angle_rad,
            alpha_rad: x[0],
            beta_rad: x[1],
            bank_rad,
            controls,
        }
    }

    /// Accelerations that remain, body axes for rotation, NED for translation.
    fn residual(&self, x: &Unknowns) -> Vector6<f64> {
        let trim = self.trim(x);
        let state = flight_state(&trim, 0.0, self.position);
        let rate = steady_rate(self.model, &state, &trim.controls);
        let (a, w) = (rate.acceleration, rate.angular);
        Vector6::new(a.x, a.y, a.z, w.x, w.y, w.z)
    }

    fn jacobian(&self, x: &Unknowns) -> Matrix6<f64> {
        const STEP: f64 = 1e-5;
        let mut jacobian = Matrix6::zeros();
        for column in 0..6 {
            let mut shift = Unknowns::zeros();
            shift[column] = STEP;
            let slope = (self.residual(&(x + shift)) - self.residual(&(x - shift))) / (2.0 * STEP);
            jacobian.set_column(column, &slope);
        }
        jacobian
    }

    fn solve(&self) -> Result<Trim, TrimError> {
        let mut x = Unknowns::new(0.05, 0.0, 0.0, 0.0, 0.0, 0.6);
        let mut residual = self.residual(&x);
        for _ in 0..60 {
            if residual.amax() < 1e-9 {
                return self.within_reach(self.trim(&x));
            }
            let Some(full) = self.jacobian(&x).lu().solve(&-residual) else { break };
            // Small steps far from the answer: lift bends over at the stall.
            let step = full * (0.2 / full.amax()).min(1.0);
            x += step;
            residual = self.residual(&x);
        }
        Err(TrimError::NotFound { airspeed_mps: self.airspeed_mps, residual: residual.amax() })
    }

    fn within_reach(&self, trim: Trim) -> Result<Trim, TrimError> {
        let servo = &self.model.airframe.servo;
        let c = &trim.controls;
        let reach = [
            ("the aileron", c.aileron_rad, -servo.aileron_limit_rad, servo.aileron_limit_rad),
            ("the elevator", c.elevator_rad, -servo.elevator_limit_rad, servo.elevator_limit_rad),
            ("the rudder", c.rudder_rad, -servo.rudder_limit_rad, servo.rudder_limit_rad),
            ("the throttle", c.throttle, 0.0, 1.0),
            ("a bank", trim.bank_rad, -STEEPEST_RAD, STEEPEST_RAD),
        ];
        match reach.into_iter().find(|(_, value, low, high)| !(*low..=*high).contains(value)) {
            Some((control, value, low, high)) => {
                let limit = if value < low { low } else { high };
                Err(TrimError::OutOfReach { airspeed_mps: self.airspeed_mps, control, value, limit })
            }
            None => Ok(trim),
        }
    }
}

/// A control for people: surfaces in degrees, the throttle in per cent.
fn reach(control: &str, value: f64) -> String {
    match control {
        "the throttle" => format!("{:.0} %", 100.0 * value),
        _ => format!("{:.1}°", value.to_degrees()),
    }
}

/// Derivative of the state in still air with the controls at rest.
pub(crate) fn steady_rate(model: &Model, state: &RigidState, controls: &Controls) -> Rate {
    let held = Held {
        surfaces: Surfaces {
            aileron_rad: controls.aileron_rad,
            elevator_rad: controls.elevator_rad,
            rudder_rad: controls.rudder_rad,
        },
        throttle: controls.throttle,
        air: AirMotion::default(),
        density: model.density(&state.position),
    };
    model.body.rate(state, &model.loads(state, &held), GRAVITY_MPS2)
}

/// Trim for an airspeed (m/s), a climb angle (rad) and a height above mean sea level (m).
///
/// # Errors
/// When the airframe cannot fly so.
pub fn trim(
    airframe: &Airframe,
    airspeed_mps: f64,
    climb_angle_rad: f64,
    altitude_m: f64,
) -> Result<Trim, TrimError> {
    let model = Model::new(airframe, altitude_m - CLEAR_M);
    Problem { model: &model, airspeed_mps, climb_angle_rad, position: Vector3::new(0.0, 0.0, -CLEAR_M) }
        .solve()
}
