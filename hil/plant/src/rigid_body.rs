//! A rigid body with six degrees of freedom over flat ground, stepped by the classical Runge-Kutta scheme.

use crate::airframe::Mass;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Position and motion of a body. Axes: north, east, down; body forward, right, down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidState {
    /// Position, NED, m.
    pub position: Vector3<f64>,
    /// Velocity over ground, NED, m/s.
    pub velocity: Vector3<f64>,
    /// Rotation from body axes to NED.
    pub attitude: UnitQuaternion<f64>,
    /// Angular rates over ground, body axes, rad/s.
    pub rates: Vector3<f64>,
}

/// What acts on the body besides gravity, in body axes, about the centre of gravity.
#[derive(Clone, Copy, Debug, Default)]
pub struct Loads {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Moment, N m.
    pub moment: Vector3<f64>,
}

/// What an ideal inertial sensor would have averaged over one step, body axes.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepMean {
    /// Specific force, m/s².
    pub specific_force: Vector3<f64>,
    /// Angular rates, rad/s.
    pub rates: Vector3<f64>,
}

/// Mass and inertia, with the inverse at hand.
#[derive(Clone, Copy, Debug)]
pub struct RigidBody {
    /// Mass, kg.
    pub mass: f64,
    /// Inertia matrix, kg m².
    pub inertia: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

/// Time derivative of a [`RigidState`], and the specific force that went into it.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Velocity, NED, m/s.
    pub velocity: Vector3<f64>,
    /// Acceleration over ground, NED, m/s².
    pub acceleration: Vector3<f64>,
    /// Derivative of the attitude quaternion, 1/s.
    pub attitude: Quaternion<f64>,
    /// Angular acceleration, body axes, rad/s².
    pub angular: Vector3<f64>,
    /// Force per mass without gravity, body axes, m/s².
    pub specific_force: Vector3<f64>,
    /// Rates at which this derivative was taken, body axes, rad/s.
    pub rates: Vector3<f64>,
}

impl RigidState {
    /// The state after `h` seconds along a derivative.
    fn along(&self, rate: &Rate, h: f64) -> Self {
        Self {
            position: self.position + rate.velocity * h,
            velocity: self.velocity + rate.acceleration * h,
            attitude: UnitQuaternion::new_normalize(self.attitude.into_inner() + rate.attitude * h),
            rates: self.rates + rate.angular * h,
        }
    }
}

impl RigidBody {
    /// A body from its airframe section. The inertia of a checked airframe is positive definite; one that is not
    /// leaves the body without rotation.
    pub fn new(mass: &Mass) -> Self {
        let Mass {
            mass_kg,
            inertia_xx_kgm2: xx,
            inertia_yy_kgm2: yy,
            inertia_zz_kgm2: zz,
            inertia_xz_kgm2: xz,
        } = *mass;
        let inertia = Matrix3::new(xx, 0.0, -xz, 0.0, yy, 0.0, -xz, 0.0, zz);
        Self { mass: mass_kg, inertia, inverse: inertia.try_inverse().unwrap_or_else(Matrix3::zeros) }
    }

    /// Newton's and Euler's equations. `gravity` points down, m/s².
    pub fn rate(&self, state: &RigidState, loads: &Loads, gravity: f64) -> Rate {
        let specific_force = loads.force / self.mass;
        let momentum = self.inertia * state.rates;
        let half = Quaternion::from_imag(state.rates * 0.5);
        Rate {
            velocity: state.velocity,
            acceleration: state.attitude * specific_force + Vector3::new(0.0, 0.0, gravity),
            attitude: state.attitude.into_inner() * half,
            angular: self.inverse * (loads.moment - state.rates.cross(&momentum)),
            specific_force,
            rates: state.rates,
        }
    }

    /// One step of fourth order. `loads` is asked four times.
    pub fn step<F>(&self, state: &RigidState, h: f64, gravity: f64, mut loads: F) -> (RigidState, StepMean)
    where
        F: FnMut(&RigidState) -> Loads,
    {
        let mut slope = |s: &RigidState| {
            let acting = loads(s);
            self.rate(s, &acting, gravity)
        };
        let k1 = slope(state);
        let k2 = slope(&state.along(&k1, 0.5 * h));
        let k3 = slope(&state.along(&k2, 0.5 * h));
        let k4 = slope(&state.along(&k3, h));
        let mean = Rate {
            velocity: sixth(k1.velocity, k2.velocity, k3.velocity, k4.velocity),
            acceleration: sixth(k1.acceleration, k2.acceleration, k3.acceleration, k4.acceleration),
            attitude: (k1.attitude + (k2.attitude + k3.attitude) * 2.0 + k4.attitude) / 6.0,
            angular: sixth(k1.angular, k2.angular, k3.angular, k4.angular),
            specific_force: sixth(k1.specific_force, k2.specific_force, k3.specific_force, k4.specific_force),
            rates: sixth(k1.rates, k2.rates, k3.rates, k4.rates),
        };
        (state.along(&mean, h), StepMean { specific_force: mean.specific_force, rates: mean.rates })
    }

    /// Energy of rotation, J.
    pub fn rotational_energy(&self, state: &RigidState) -> f64 {
        0.5 * state.rates.dot(&(self.inertia * state.rates))
    }

    /// Angular momentum, NED, N m s.
    pub fn angular_momentum(&self, state: &RigidState) -> Vector3<f64> {
        state.attitude * (self.inertia * state.rates)
    }
}

/// Weights of the fourth-order scheme.
fn sixth(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, d: Vector3<f64>) -> Vector3<f64> {
    (a + (b + c) * 2.0 + d) / 6.0
}
