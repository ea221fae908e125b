//! Port messages as the laws have them.

use bateleur_flight::estimator::{EstimatorStatus, NavigationState, StateSigmas};
use bateleur_messages::state::{STATUS_COARSE, STATUS_RUNNING};
use bateleur_messages::{Acceleration, Pressure, Rates, State};
use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};

/// Raw measurements beside the state. What is missing is not a number: the laws then hold what they had.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// Angular rates, body, rad/s.
    pub rates_radps: Vector3<f64>,
    /// Specific force, body, m/s².
    pub specific_force_mps2: Vector3<f64>,
    /// Airspeed, m/s.
    pub airspeed_mps: Option<f64>,
    /// Air density, kg/m³.
    pub density_kgpm3: Option<f64>,
    /// Distance to the ground, m, where there is a new one.
    pub range_m: Option<f64>,
}

/// No airspeed of an aircraft of this kind, m/s: a word that was changed on its way.
const FASTEST_MPS: f64 = 200.0;

impl Sensors {
    /// From the measurements that are valid.
    pub fn of(
        acceleration: Option<&Acceleration>,
        orientation: Option<&Rates>,
        pressure: Option<&Pressure>,
        range_m: Option<f64>,
    ) -> Self {
        let missing = Vector3::repeat(f64::NAN);
        Self {
            rates_radps: orientation.map_or(missing, |rates| Vector3::from(rates.rates_radps)),
            specific_force_mps2: acceleration
                .map_or(missing, |force| Vector3::from(force.specific_force_mps2)),
            airspeed_mps: pressure
                .map(|pressure| pressure.airspeed_mps)
                .filter(|mps| mps.abs() < FASTEST_MPS),
            density_kgpm3: pressure.map(|pressure| pressure.density_kgpm3),
            range_m,
        }
    }
}

/// The state to fly on; nothing while the Estimator has none.
pub fn navigation_state(state: &State) -> Option<NavigationState> {
    let status = match state.status {
        STATUS_RUNNING => EstimatorStatus::Ready,
        STATUS_COARSE => EstimatorStatus::Converging,
        _ => return None,
    };
    let [w, i, j, k] = state.quaternion;
    Some(NavigationState {
        time_s: state.valid_ns as f64 * 1e-9,
        position: Vector3::from(state.position_ned_m),
        velocity: Vector3::from(state.velocity_ned_mps),
        quaternion: UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 0.5)?,
        euler: Vector3::from(state.euler_rad),
        rates: Vector3::from(state.rates_radps),
        specific_force: Vector3::from(state.specific_force_mps2),
        wind: Vector2::from(state.wind_ne_mps),
        gyro_bias: Vector3::from(state.gyro_bias_radps),
        accel_bias: Vector3::from(state.accel_bias_mps2),
        mag_bias: Vector3::zeros(),
        sigmas: StateSigmas {
            attitude: Vector3::from(state.attitude_sigma_rad),
            velocity: Vector3::from(state.velocity_sigma_mps),
            position: Vector3::from(state.position_sigma_m),
        },
        status,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::state::STATUS_INITIALISING;

    #[test]
    fn only_a_state_that_can_be_flown_on_is_taken() {
        let level = State { quaternion: [1.0, 0.0, 0.0, 0.0], status: STATUS_RUNNING, ..State::default() };
        assert!(navigation_state(&level).is_some());
        assert!(navigation_state(&State { status: STATUS_INITIALISING, ..level }).is_none());
        assert!(navigation_state(&State { quaternion: [0.0; 4], ..level }).is_none());
        assert!(navigation_state(&State { quaternion: [f64::NAN; 4], ..level }).is_none());
    }

    #[test]
    fn what_is_missing_is_not_a_number() {
        let sensors = Sensors::of(None, None, None, None);
        assert!(sensors.rates_radps.x.is_nan() && sensors.specific_force_mps2.z.is_nan());
        assert_eq!(sensors.airspeed_mps, None);
    }
}
