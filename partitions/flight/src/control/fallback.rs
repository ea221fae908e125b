//! What the controller flies on when the estimator is silent.
//!
//! First the last state, carried on with the raw inertial values less the last known biases: good for seconds. After
//! that only what a gyroscope can hold: wings level, the nose where level flight has it.

use crate::GRAVITY_MPS2;
use crate::attitude;
use crate::estimator::{EstimatorStatus, NavigationState, StateSigmas};
use crate::kept::kept;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// How long the propagated state is flown on as if it were fresh, s: 2 % of scale error in a 45° turn is 1° after
/// that, and the position a few metres.
pub const TRUSTED_S: f64 = 1.5;

/// On what the controller flew in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Basis {
    /// The estimator's state of this frame.
    #[default]
    Estimator,
    /// The last state, carried on with inertial values.
    Propagated,
    /// Wings level on rates alone; guidance waits.
    WingsLevel,
}

/// The state the controller carries itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fallback {
    state: NavigationState,
    age_s: f64,
}

impl Fallback {
    /// Nothing known: level flight at a trimmed angle of attack is assumed.
    pub fn new(alpha_rad: f64, airspeed_mps: f64) -> Self {
        let quaternion = attitude::from_euler(0.0, alpha_rad, 0.0);
        let zero = Vector3::zeros();
        let state = NavigationState {
            time_s: 0.0,
            position: zero,
            velocity: Vector3::new(airspeed_mps, 0.0, 0.0),
            quaternion,
            euler: Vector3::new(0.0, alpha_rad, 0.0),
            rates: zero,
            specific_force: Vector3::new(0.0, 0.0, -GRAVITY_MPS2),
            wind: Vector2::zeros(),
            gyro_bias: zero,
            accel_bias: zero,
            mag_bias: zero,
            sigmas: StateSigmas::UNKNOWN,
            status: EstimatorStatus::Stopped,
        };
        Self { state, age_s: f64::MAX }
    }

    /// Heading of the last frame, rad.
    pub fn yaw_rad(&self) -> f64 {
        self.state.euler.z
    }

    /// Takes this frame's state, or carries the last one on with raw rates (rad/s) and specific force (m/s²).
    pub fn update(
        &mut self,
        fresh: Option<&NavigationState>,
        rates: &Vector3<f64>,
        force: &Vector3<f64>,
        dt_s: f64,
    ) -> (NavigationState, Basis) {
        match fresh.filter(|state| usable(state)) {
            Some(state) => {
                // No law asks for them.
                let (mag_bias, sigmas) = (Vector3::zeros(), StateSigmas::UNKNOWN);
                *self = Self { state: NavigationState { mag_bias, sigmas, ..*state }, age_s: 0.0 };
                (*state, Basis::Estimator)
            }
            None => {
                self.age_s += dt_s;
                self.propagate(rates, force, dt_s);
                let basis =
                    if self.age_s <= TRUSTED_S + 1e-6 { Basis::Propagated } else { Basis::WingsLevel };
                (self.state, basis)
            }
        }
    }

    fn propagate(&mut self, rates: &Vector3<f64>, force: &Vector3<f64>, dt_s: f64) {
        let s = &mut self.state;
        s.rates = if attitude::finite(rates) { rates - s.gyro_bias } else { Vector3::zeros() };
        s.specific_force = if attitude::finite(force) { force - s.accel_bias } else { s.specific_force };
        let turn = UnitQuaternion::from_scaled_axis(s.rates * dt_s);
        s.quaternion *= turn;
        s.quaternion.renormalize();
        s.euler = attitude::euler(&s.quaternion);
        s.time_s += dt_s;
        if self.age_s > TRUSTED_S {
            return;
        }
        let acceleration = s.quaternion * s.specific_force + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        s.velocity += acceleration * dt_s;
        s.position += s.velocity * dt_s;
    }
}

fn usable(state: &NavigationState) -> bool {
    let finite = attitude::finite(&state.position)
        && attitude::finite(&state.velocity)
        && attitude::finite(&state.euler)
        && attitude::finite(&state.rates)
        && attitude::finite(&state.specific_force)
        && state.wind.iter().all(|x| x.is_finite());
    finite && !matches!(state.status, EstimatorStatus::Stopped | EstimatorStatus::Aligning)
}

kept!(Fallback { state: NavigationState, age_s: f64 } if |fallback| fallback.age_s >= 0.0);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_bridged_then_flown_wings_level_and_ends_at_once() {
        let mut fallback = Fallback::new(0.08, 22.0);
        let mut fresh = fallback.state;
        fresh.status = EstimatorStatus::Ready;
        let level = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
        let zero = Vector3::zeros();
        assert_eq!(fallback.update(Some(&fresh), &zero, &level, 0.02).1, Basis::Estimator);
        for frame in 1..=200 {
            let (_, basis) = fallback.update(None, &zero, &level, 0.02);
            let expected = if f64::from(frame) * 0.02 <= TRUSTED_S + 1e-6 {
                Basis::Propagated
            } else {
                Basis::WingsLevel
            };
            assert_eq!(basis, expected, "frame {frame}");
        }
        assert_eq!(fallback.update(Some(&fresh), &zero, &level, 0.02).1, Basis::Estimator);
    }

    #[test]
    fn rates_turn_the_propagated_attitude_and_nonsense_does_not() {
        let mut fallback = Fallback::new(0.0, 22.0);
        let rates = Vector3::new(0.5, 0.0, 0.0);
        for _ in 0..50 {
            fallback.update(None, &rates, &Vector3::zeros(), 0.02);
        }
        assert!((fallback.state.euler.x - 0.5).abs() < 1e-9);
        fallback.update(None, &Vector3::repeat(f64::NAN), &Vector3::repeat(f64::NAN), 0.02);
        assert!((fallback.state.euler.x - 0.5).abs() < 1e-9);
    }

    #[test]
    fn state_that_is_not_finite_counts_as_silence() {
        let mut fallback = Fallback::new(0.0, 22.0);
        let mut broken = fallback.state;
        broken.status = EstimatorStatus::Ready;
        broken.velocity.x = f64::NAN;
        assert_ne!(
            fallback.update(Some(&broken), &Vector3::zeros(), &Vector3::zeros(), 0.02).1,
            Basis::Estimator
        );
    }
}
