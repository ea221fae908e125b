//! Forces and moments of the air: linear derivatives, with lift and drag blended into a flat plate beyond the stall.

use crate::airframe::{Aerodynamics, Geometry};
use nalgebra::Vector3;

/// Motion relative to the air, body axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AirData {
    /// Velocity relative to the air, m/s.
    pub velocity: Vector3<f64>,
    /// Rates relative to the air, rad/s.
    pub rates: Vector3<f64>,
    /// Airspeed, m/s.
    pub airspeed: f64,
    /// Angle of attack, rad.
    pub alpha: f64,
    /// Sideslip, rad; positive when the air comes from the right.
    pub beta: f64,
    /// Density, kg/m³.
    pub density: f64,
}

/// Deflections of the surfaces, rad; signs as in the crate's head.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surfaces {
    /// Aileron, rad, positive rolls right.
    pub aileron_rad: f64,
    /// Elevator, rad, positive pitches down.
    pub elevator_rad: f64,
    /// Rudder, rad, positive turns the nose left.
    pub rudder_rad: f64,
}

/// Below this airspeed reduced rates are formed with it instead, so that they stay finite on the ground, m/s.
const SLOWEST_MPS: f64 = 1.0;
/// Beyond this angle of attack moments stay as they are, rad: the linear slopes end somewhere.
const LARGEST_ALPHA: f64 = 0.6;
/// Beyond this sideslip side force and moments stay as they are, rad. Without it a side wind of 8 m/s, at 90° of
/// sideslip on a standing aircraft, would spin it on its wheels.
const LARGEST_BETA: f64 = 0.5;

impl AirData {
    /// Angles and airspeed from the relative velocity.
    pub fn new(velocity: Vector3<f64>, rates: Vector3<f64>, density: f64) -> Self {
        let airspeed = velocity.norm();
        let alpha = if airspeed > 1e-6 { velocity.z.atan2(velocity.x) } else { 0.0 };
        let beta = if airspeed > 1e-6 { (velocity.y / airspeed).clamp(-1.0, 1.0).asin() } else { 0.0 };
        Self { velocity, rates, airspeed, alpha, beta, density }
    }

    /// ρ V² / 2, Pa.
    pub fn dynamic_pressure(&self) -> f64 {
        0.5 * self.density * self.airspeed * self.airspeed
    }

    /// Sideslip as far as the slopes reach, rad.
    fn sloped_beta(&self) -> f64 {
        self.beta.clamp(-LARGEST_BETA, LARGEST_BETA)
    }

    /// Length over twice the airspeed, s.
    fn reduced(&self, length: f64) -> f64 {
        length / (2.0 * self.airspeed.max(SLOWEST_MPS))
    }
}

/// Weight of the flat plate: 0 in attached flow, 1 well beyond the stall.
fn stalled(a: &Aerodynamics, alpha: f64) -> f64 {
    let above = (-a.stall_sharpness * (alpha - a.stall_alpha_rad)).exp();
    let below = (a.stall_sharpness * (alpha + a.stall_alpha_rad)).exp();
    (1.0 + above + below) / ((1.0 + above) * (1.0 + below))
}

/// Lift and drag coefficients.
fn lift_and_drag(a: &Aerodynamics, air: &AirData, elevator: f64, pitch: f64) -> (f64, f64) {
    let weight = stalled(a, air.alpha);
    let (sin, cos) = air.alpha.sin_cos();
    let control = a.lift_pitch_rate * pitch + a.lift_elevator * elevator;
    let attached = a.lift_0 + a.lift_alpha * air.alpha;
    let plate = 2.0 * sin * sin.abs() * cos;
    let lift = (1.0 - weight) * attached + weight * plate + control;
    let attached_drag = a.drag_induced * lift * lift + a.drag_alpha * air.alpha.abs();
    let drag = a.drag_0
        + (1.0 - weight) * attached_drag
        + weight * 2.0 * sin * sin
        + a.drag_elevator * elevator.abs();
    (lift, drag)
}

/// Lift coefficient of the aircraft at an angle of attack, rad, with its controls and rates at zero.
pub fn lift_coefficient(a: &Aerodynamics, alpha: f64) -> f64 {
    lift_and_drag(a, &AirData { alpha, ..AirData::default() }, 0.0, 0.0).0
}

/// The greatest lift coefficient, and the angle of attack where it is reached, rad.
pub fn greatest_lift(a: &Aerodynamics) -> (f64, f64) {
    let at = |step: i32| 1e-3 * f64::from(step);
    let best = (0..1500).max_by(|x, y| lift_coefficient(a, at(*x)).total_cmp(&lift_coefficient(a, at(*y))));
    let alpha = at(best.unwrap_or(0));
    (lift_coefficient(a, alpha), alpha)
}

/// Force of the air in body axes, N.
pub fn force(a: &Aerodynamics, g: &Geometry, air: &AirData, surfaces: &Surfaces) -> Vector3<f64> {
    let (lift, drag) =
        lift_and_drag(a, air, surfaces.elevator_rad, air.rates.y * air.reduced(g.mean_chord_m));
    let side = a.side_beta * air.sloped_beta()
        + a.side_aileron * surfaces.aileron_rad
        + a.side_rudder * surfaces.rudder_rad;
    let (sin, cos) = air.alpha.sin_cos();
    let scale = air.dynamic_pressure() * g.wing_area_m2;
    Vector3::new(lift * sin - drag * cos, side, -lift * cos - drag * sin) * scale
}

/// Moment of the air in body axes, N m. `alpha_rate` in rad/s.
pub fn moment(
    a: &Aerodynamics,
    g: &Geometry,
    air: &AirData,
    surfaces: &Surfaces,
    alpha_rate: f64,
) -> Vector3<f64> {
    let Surfaces { aileron_rad, elevator_rad, rudder_rad } = *surfaces;
    let (span, chord) = (air.reduced(g.wing_span_m), air.reduced(g.mean_chord_m));
    let (p, q, r) = (air.rates.x * span, air.rates.y * chord, air.rates.z * span);
    let (alpha, beta) = (air.alpha.clamp(-LARGEST_ALPHA, LARGEST_ALPHA), air.sloped_beta());
    let roll = a.roll_beta * beta
        + a.roll_roll_rate * p
        + a.roll_yaw_rate * r
        + a.roll_aileron * aileron_rad
        + a.roll_rudder * rudder_rad;
    let pitch = a.pitch_0
        + a.pitch_alpha * alpha
        + a.pitch_pitch_rate * q
        + a.pitch_alpha_rate * alpha_rate * chord
        + a.pitch_elevator * elevator_rad;
    let yaw = a.yaw_beta * beta
        + a.yaw_roll_rate * p
        + a.yaw_yaw_rate * r
        + a.yaw_aileron * aileron_rad
        + a.yaw_rudder * rudder_rad;
    let scale = air.dynamic_pressure() * g.wing_area_m2;
    Vector3::new(roll * g.wing_span_m, pitch * g.mean_chord_m, yaw * g.wing_span_m) * scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Airframe;

    fn lift(alpha: f64) -> f64 {
        let frame = Airframe::rascal110();
        let air =
            AirData::new(Vector3::new(20.0 * alpha.cos(), 0.0, 20.0 * alpha.sin()), Vector3::zeros(), 1.225);
        lift_and_drag(&frame.aerodynamics, &air, 0.0, 0.0).0
    }

    #[test]
    fn rascal_lift_peaks_where_its_table_does() {
        let peak = (0..60).map(|i| 0.01 * f64::from(i)).max_by(|a, b| lift(*a).total_cmp(&lift(*b))).unwrap();
        assert!((0.22..0.28).contains(&peak), "lift peaks at {peak} rad");
        assert!((lift(peak) - 1.40).abs() < 0.05, "peak lift {}", lift(peak));
        assert!(lift(0.6) < 0.8 * lift(peak));
    }

    #[test]
    fn flow_from_behind_stays_finite() {
        let frame = Airframe::aerosonde();
        let air = AirData::new(Vector3::new(-8.0, 1.0, 0.1), Vector3::new(1.0, 1.0, 1.0), 1.225);
        let surfaces = Surfaces::default();
        let force = force(&frame.aerodynamics, &frame.geometry, &air, &surfaces);
        let moment = moment(&frame.aerodynamics, &frame.geometry, &air, &surfaces, 0.0);
        assert!(force.norm() < 50.0 && moment.norm() < 50.0, "{force} {moment}");
        assert!(force.x > 0.0, "air from behind pushes forward");
    }
}
