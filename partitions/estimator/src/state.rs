//! The filter's state as the port messages have it.

use bateleur_flight::estimator::{EstimatorStatus, Health, NavigationState};
use bateleur_messages::State;
use bateleur_messages::state::{STATUS_COARSE, STATUS_DISABLED, STATUS_INITIALISING, STATUS_RUNNING};
use bateleur_messages::telemetry::StateTelemetry;
use nalgebra::Vector2;

/// The message for a state; without one, a level attitude at the origin that says it is being initialised. `rejected`
/// measurements were refused so far.
pub fn message(navigation: Option<&NavigationState>, rejected: u32, health: Health) -> State {
    let Some(n) = navigation else {
        let quaternion = [1.0, 0.0, 0.0, 0.0];
        return State { quaternion, status: STATUS_INITIALISING, rejected, ..State::default() };
    };
    let q = n.quaternion.quaternion();
    State {
        valid_ns: (n.time_s * 1e9).round() as u64,
        position_ned_m: n.position.into(),
        velocity_ned_mps: n.velocity.into(),
        quaternion: [q.w, q.i, q.j, q.k],
        euler_rad: n.euler.into(),
        rates_radps: n.rates.into(),
        specific_force_mps2: n.specific_force.into(),
        wind_ne_mps: n.wind.into(),
        gyro_bias_radps: n.gyro_bias.into(),
        accel_bias_mps2: n.accel_bias.into(),
        attitude_sigma_rad: attitude_sigma(n),
        velocity_sigma_mps: n.sigmas.velocity.into(),
        position_sigma_m: n.sigmas.position.into(),
        status: status(n.status),
        rejected,
        health: u64::from(health.0),
    }
}

/// The telemetry for a state.
pub fn telemetry(state: &State) -> StateTelemetry {
    StateTelemetry {
        valid_ns: state.valid_ns,
        position_ned_m: state.position_ned_m,
        velocity_ned_mps: state.velocity_ned_mps,
        euler_rad: state.euler_rad,
        wind_ne_mps: state.wind_ne_mps,
        status: state.status,
        rejected: state.rejected,
    }
}

/// Of roll, pitch and yaw from those about north, east and down. Right for a level aircraft; what it leaves out (tilt,
/// and what the errors have in common) does not matter to a reader who wants to know how good the attitude is.
fn attitude_sigma(n: &NavigationState) -> [f64; 3] {
    let (sin, cos) = n.euler.z.sin_cos();
    let (north, east, down) = (n.sigmas.attitude.x, n.sigmas.attitude.y, n.sigmas.attitude.z);
    [Vector2::new(cos * north, sin * east).norm(), Vector2::new(sin * north, cos * east).norm(), down]
}

fn status(status: EstimatorStatus) -> u32 {
    match status {
        EstimatorStatus::Stopped => STATUS_DISABLED,
        EstimatorStatus::Aligning => STATUS_INITIALISING,
        // Without GPS, position and velocity drift, but the wings stay level.
        EstimatorStatus::Converging | EstimatorStatus::Inertial => STATUS_COARSE,
        EstimatorStatus::Ready => STATUS_RUNNING,
    }
}
