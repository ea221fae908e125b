//! Motor or engine and propeller in balance: the shaft speed is where the two torques are equal.
//!
//! Both drives deliver a torque that falls linearly with speed (to first order), and the propeller's torque is a
//! parabola in speed, so the balance is a quadratic equation with one root that makes sense.

use crate::airframe::{Propeller, Propulsion};
use std::f64::consts::TAU;

/// What the propeller does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Thrust {
    /// Along the forward axis, N.
    pub thrust_n: f64,
    /// Torque of the shaft on the propeller, N m; the airframe feels its opposite.
    pub torque_nm: f64,
    /// Shaft speed, rad/s.
    pub speed_radps: f64,
}

/// Torque of the drive at standstill (N m), and its loss per rad/s (N m s).
fn drive_torque(propulsion: &Propulsion, throttle: f64) -> (f64, f64) {
    match propulsion {
        Propulsion::Electric {
            motor_kv_rpm_per_v,
            battery_voltage_v,
            winding_resistance_ohm,
            no_load_current_a,
            ..
        } => {
            let constant = 60.0 / (TAU * motor_kv_rpm_per_v);
            let stalled =
                constant * (battery_voltage_v * throttle / winding_resistance_ohm - no_load_current_a);
            (stalled, constant * constant / winding_resistance_ohm)
        }
        Propulsion::Piston { power_w, rated_speed_radps, friction_torque_nm, .. } => {
            (throttle * (power_w / rated_speed_radps + friction_torque_nm) - friction_torque_nm, 0.0)
        }
    }
}

/// Thrust and torque at a throttle (0 to 1), an inflow along the shaft (m/s) and a density (kg/m³).
pub fn thrust(propulsion: &Propulsion, throttle: f64, inflow_mps: f64, density: f64) -> Thrust {
    let p = propulsion.propeller();
    let inflow = inflow_mps.max(0.0);
    let (stalled, loss) = drive_torque(propulsion, throttle);
    let d2 = p.diameter_m * p.diameter_m;
    let d3 = d2 * p.diameter_m;
    // a Ω² + b Ω + c = 0
    let a = density * d3 * d2 * p.torque_0 / (TAU * TAU);
    let b = density * d2 * d2 * p.torque_1 * inflow / TAU + loss;
    let c = density * d3 * p.torque_2 * inflow * inflow - stalled;
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let speed_radps = ((root - b) / (2.0 * a)).max(0.0);
    at_speed(p, speed_radps, inflow, density)
}

fn at_speed(p: &Propeller, speed_radps: f64, inflow: f64, density: f64) -> Thrust {
    let tip = speed_radps * p.diameter_m / TAU;
    let d2 = p.diameter_m * p.diameter_m;
    let parabola = |c0: f64, c1: f64, c2: f64| c0 * tip * tip + c1 * tip * inflow + c2 * inflow * inflow;
    Thrust {
        thrust_n: density * d2 * parabola(p.thrust_0, p.thrust_1, p.thrust_2),
        torque_nm: density * d2 * p.diameter_m * parabola(p.torque_0, p.torque_1, p.torque_2),
        speed_radps,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Airframe;

    #[test]
    fn drive_and_propeller_are_in_balance() {
        for frame in [Airframe::aerosonde(), Airframe::rascal110()] {
            let out = thrust(&frame.propulsion, 0.7, 22.0, 1.225);
            let (stalled, loss) = drive_torque(&frame.propulsion, 0.7);
            assert!(
                (stalled - loss * out.speed_radps - out.torque_nm).abs() < 1e-9,
                "{}: {out:?}",
                frame.name
            );
            assert!(out.thrust_n > 0.0);
        }
    }

    #[test]
    fn standing_without_throttle_does_nothing() {
        for frame in [Airframe::aerosonde(), Airframe::rascal110()] {
            assert_eq!(thrust(&frame.propulsion, 0.0, 0.0, 1.225), Thrust::default());
        }
    }

    #[test]
    fn windmilling_brakes() {
        let out = thrust(&Airframe::aerosonde().propulsion, 0.0, 22.0, 1.225);
        assert!(out.thrust_n < 0.0 && out.speed_radps > 0.0, "{out:?}");
    }
}
