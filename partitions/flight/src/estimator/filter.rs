//! The nominal state, its error covariance, and the two things one can do to them: propagate and correct.
//!
//! Error-state formulation with the attitude error in NED: `R = (1 + [θ]×) R̂` (for the equations see J. Solà,
//! "Quaternion kinematics for the error-state Kalman filter", section 7, global angular errors). The transition
//! differs from the identity in four 3×3 blocks only, so the covariance is propagated block by block.

use crate::GRAVITY_MPS2;
use crate::attitude::skew;
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

/// Number of error states: 18 and the wind, north and east.
pub const ERROR_STATES: usize = 20;
/// Offsets of the blocks in the error vector.
pub(crate) const ATT: usize = 0;
pub(crate) const VEL: usize = 3;
pub(crate) const POS: usize = 6;
pub(crate) const GYRO: usize = 9;
pub(crate) const ACCEL: usize = 12;
pub(crate) const MAG: usize = 15;
pub(crate) const WIND: usize = 18;

pub(crate) type Covariance = SMatrix<f64, ERROR_STATES, ERROR_STATES>;
pub(crate) type ErrorVector = SVector<f64, ERROR_STATES>;

/// The full state of which the filter estimates the error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Nominal {
    /// Body to NED.
    pub(crate) attitude: UnitQuaternion<f64>,
    /// NED, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// NED from the runway, m.
    pub(crate) position: Vector3<f64>,
    /// Body, rad/s.
    pub(crate) gyro_bias: Vector3<f64>,
    /// Body, m/s².
    pub(crate) accel_bias: Vector3<f64>,
    /// Body, gauss.
    pub(crate) mag_bias: Vector3<f64>,
    /// Air velocity over ground, north and east, m/s.
    pub(crate) wind: Vector2<f64>,
}

impl Default for Nominal {
    fn default() -> Self {
        Self {
            attitude: UnitQuaternion::identity(),
            velocity: Vector3::zeros(),
            position: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            mag_bias: Vector3::zeros(),
            wind: Vector2::zeros(),
        }
    }
}

/// Spectral densities (square roots, per √s) of what drives the error states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessNoise {
    /// Gyroscope white noise, rad/√s.
    pub gyro: f64,
    /// Further attitude noise per unit of rate, √s: stands for scale and cross-axis errors, which no state models.
    pub gyro_per_rate: f64,
    /// Further attitude noise about each body axis, rad/√s: a gyroscope that does not measure it.
    pub turning: Vector3<f64>,
    /// Accelerometer white noise, m/s/√s.
    pub accel: f64,
    /// Further velocity noise per unit of specific force beyond 1 g, √s.
    pub accel_per_force: f64,
    /// Horizontal position, m/√s: follows the receiver's slow walk, 0.2 m each second (0.21 for a usual receiver).
    pub position: f64,
    /// Vertical position, m/√s: follows the weather in the barometer.
    pub height: f64,
    /// Gyroscope bias, rad/s/√s.
    pub gyro_bias: f64,
    /// Accelerometer bias, m/s²/√s.
    pub accel_bias: f64,
    /// Magnetometer bias, gauss/√s.
    pub mag_bias: f64,
    /// Wind, m/s/√s.
    pub wind: f64,
}

impl Default for ProcessNoise {
    /// Roughly twice the datasheet densities named in the plant's sensor page, for vibration and what is not modelled.
    fn default() -> Self {
        Self {
            gyro: 6e-4,
            gyro_per_rate: 3e-3,
            turning: Vector3::zeros(),
            accel: 1.2e-2,
            accel_per_force: 3e-3,
            position: 0.2,
            height: 0.06,
            gyro_bias: 2e-5,
            accel_bias: 5e-4,
            mag_bias: 2e-5,
            wind: 0.15,
        }
    }
}

/// State, covariance and the correction collected by the running measurement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filter {
    pub(crate) nominal: Nominal,
    pub(crate) covariance: Covariance,
    pending: ErrorVector,
    /// Variance that noise has added to each axis of the velocity since the filter began, m²/s².
    pub(crate) velocity_noise: f64,
}

/// One scalar measurement, linearised: `innovation = h · error + noise`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scalar {
    pub(crate) h: ErrorVector,
    pub(crate) innovation: f64,
    pub(crate) variance: f64,
    /// An error state that has gathered noise since the measurement was taken, and that noise's variance: the present
    /// error has it, a late measurement knows nothing of it. Row `h` is 1 there.
    pub(crate) since: Option<(usize, f64)>,
}

impl Scalar {
    /// Covariance of the error with the innovation, and the innovation's variance.
    fn expected(&self, covariance: &Covariance) -> (ErrorVector, f64) {
        let mut column = covariance * self.h;
        let mut variance = self.h.dot(&column) + self.variance;
        if let Some((at, gathered)) = self.since {
            let gathered = gathered.min(own_variance(covariance, at));
            column[at] -= gathered;
            variance = (variance - gathered).max(self.variance);
        }
        (column, variance)
    }
}

/// Variance of an error state that no other state and no measurement tells of, so much of its noise is still in it: more taken off would leave a
/// covariance that is none.
fn own_variance(covariance: &Covariance, at: usize) -> f64 {
    let unit = ErrorVector::from_fn(|i, _| if i == at { 1.0 } else { 0.0 });
    covariance.cholesky().map_or(0.0, |root| 1.0 / root.solve(&unit)[at])
}

impl Filter {
    pub(crate) fn new(nominal: Nominal, sigmas: &ErrorVector) -> Self {
        let covariance = Covariance::from_diagonal(&sigmas.component_mul(sigmas));
        Self { nominal, covariance, pending: ErrorVector::zeros(), velocity_noise: 0.0 }
    }

    /// Strapdown step over `dt_s` with the mean rates and specific force (body) of that interval, then the covariance.
    pub(crate) fn propagate(
        &mut self,
        rates: &Vector3<f64>,
        force: &Vector3<f64>,
        dt_s: f64,
        noise: &ProcessNoise,
    ) {
        let state = &mut self.nominal;
        let rates = rates - state.gyro_bias;
        let force = force - state.accel_bias;
        let half_turn = UnitQuaternion::from_scaled_axis(rates * (0.5 * dt_s));
        let middle = state.attitude * half_turn;
        let rotation = middle.to_rotation_matrix().into_inner();
        let force_ned = rotation * force;
        let acceleration = force_ned + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        state.position += state.velocity * dt_s + acceleration * (0.5 * dt_s * dt_s);
        state.velocity += acceleration * dt_s;
        state.attitude = middle * half_turn;
        state.attitude.renormalize();
        self.propagate_covariance(&rotation, &force_ned, dt_s);
        self.add_noise(&rotation, rates.norm(), (force.norm() - GRAVITY_MPS2).abs(), dt_s, noise);
    }

    /// `P ← F P Fᵀ` with F = 1 except θ←gyro bias (−R dt), v←θ (−[Δv]×), v←accel bias (−R dt), p←v (dt).
    fn propagate_covariance(&mut self, rotation: &Matrix3<f64>, force_ned: &Vector3<f64>, dt_s: f64) {
        let turn = rotation * (-dt_s);
        let tilt = skew(&(force_ned * -dt_s));
        let p = &mut self.covariance;
        for column in 0..ERROR_STATES {
            let block = |at: usize, p: &Covariance| {
                Vector3::new(p[(at, column)], p[(at + 1, column)], p[(at + 2, column)])
            };
            let (att, vel) = (block(ATT, p), block(VEL, p));
            let d_att = turn * block(GYRO, p);
            let d_vel = tilt * att + turn * block(ACCEL, p);
            let d_pos = vel * dt_s;
            for i in 0..3 {
                p[(ATT + i, column)] += d_att[i];
                p[(VEL + i, column)] += d_vel[i];
                p[(POS + i, column)] += d_pos[i];
            }
        }
        for row in 0..ERROR_STATES {
            let block =
                |at: usize, p: &Covariance| Vector3::new(p[(row, at)], p[(row, at + 1)], p[(row, at + 2)]);
            let (att, vel) = (block(ATT, p), block(VEL, p));
            let d_att = turn * block(GYRO, p);
            let d_vel = tilt * att + turn * block(ACCEL, p);
            let d_pos = vel * dt_s;
            for i in 0..3 {
                p[(row, ATT + i)] += d_att[i];
                p[(row, VEL + i)] += d_vel[i];
                p[(row, POS + i)] += d_pos[i];
            }
        }
    }

    fn add_noise(
        &mut self,
        rotation: &Matrix3<f64>,
        rate: f64,
        excess_force: f64,
        dt_s: f64,
        noise: &ProcessNoise,
    ) {
        let square = |x: f64| x * x;
        let attitude = square(noise.gyro) + square(noise.gyro_per_rate * rate);
        let velocity = square(noise.accel) + square(noise.accel_per_force * excess_force);
        self.velocity_noise += velocity * dt_s;
        let blocks = [
            (ATT, attitude),
            (VEL, velocity),
            (GYRO, square(noise.gyro_bias)),
            (ACCEL, square(noise.accel_bias)),
            (MAG, square(noise.mag_bias)),
        ];
        let p = &mut self.covariance;
        for (at, density) in blocks {
            for i in at..at + 3 {
                p[(i, i)] += density * dt_s;
            }
        }
        if noise.turning != Vector3::zeros() {
            let turning =
                rotation * Matrix3::from_diagonal(&noise.turning.map(square)) * rotation.transpose();
            let mut block = p.fixed_view_mut::<3, 3>(ATT, ATT);
            block += turning * dt_s;
        }
        for i in 0..2 {
            p[(POS + i, POS + i)] += square(noise.position) * dt_s;
            p[(WIND + i, WIND + i)] += square(noise.wind) * dt_s;
        }
        p[(POS + 2, POS + 2)] += square(noise.height) * dt_s;
    }

    /// Innovation over its standard deviation, without touching the state.
    pub(crate) fn normalised(&self, scalar: &Scalar) -> f64 {
        let (_, variance) = scalar.expected(&self.covariance);
        (scalar.innovation - scalar.h.dot(&self.pending)) / variance.sqrt()
    }

    /// Takes one scalar into covariance and pending correction (Joseph form, expanded for a scalar). Only error
    /// states from `first` on are corrected; the others are considered as they are (S. F. Schmidt's filter), which
    /// the Joseph form allows, as it holds for any gain. Gives the innovation over its standard deviation, what the
    /// scalars before it have told already taken off.
    pub(crate) fn correct_from(&mut self, scalar: &Scalar, first: usize) -> f64 {
        let (column, variance) = scalar.expected(&self.covariance);
        let mut gain = column / variance;
        gain.rows_mut(0, first).fill(0.0);
        let innovation = scalar.innovation - scalar.h.dot(&self.pending);
        self.pending += gain * innovation;
        let p = &mut self.covariance;
        for j in 0..ERROR_STATES {
            for i in j..ERROR_STATES {
                let value =
                    p[(i, j)] - gain[i] * column[j] - column[i] * gain[j] + variance * gain[i] * gain[j];
                p[(i, j)] = value;
                p[(j, i)] = value;
            }
        }
        innovation / variance.sqrt()
    }

    /// Moves the collected correction into the nominal state and returns it.
    pub(crate) fn inject(&mut self) -> ErrorVector {
        let error = std::mem::replace(&mut self.pending, ErrorVector::zeros());
        self.displace(&error);
        error
    }

    /// Moves the nominal state by an error vector.
    pub(crate) fn displace(&mut self, error: &ErrorVector) {
        let block = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
        let state = &mut self.nominal;
        state.attitude = UnitQuaternion::from_scaled_axis(block(ATT)) * state.attitude;
        state.velocity += block(VEL);
        state.position += block(POS);
        state.gyro_bias += block(GYRO);
        state.accel_bias += block(ACCEL);
        state.mag_bias += block(MAG);
        state.wind += Vector2::new(error[WIND], error[WIND + 1]);
    }

    /// Forgets what was known of `count` error states from `at` on: their variance becomes σ², correlations vanish.
    pub(crate) fn forget(&mut self, at: usize, count: usize, sigma: f64) {
        for i in at..at + count {
            for j in 0..ERROR_STATES {
                self.covariance[(i, j)] = 0.0;
                self.covariance[(j, i)] = 0.0;
            }
            self.covariance[(i, i)] = sigma * sigma;
        }
    }

    /// Raises variances to at least σ², keeping correlations.
    pub(crate) fn widen(&mut self, at: usize, count: usize, sigma: f64) {
        for i in at..at + count {
            self.covariance[(i, i)] = self.covariance[(i, i)].max(sigma * sigma);
        }
    }

    /// Standard deviation of one error state.
    pub(crate) fn sigma(&self, at: usize) -> f64 {
        self.covariance[(at, at)].max(0.0).sqrt()
    }

    /// Finite state and covariance with positive variances.
    pub(crate) fn healthy(&self) -> bool {
        let n = &self.nominal;
        let vectors = [n.velocity, n.position, n.gyro_bias, n.accel_bias, n.mag_bias];
        n.attitude.coords.iter().all(|x| x.is_finite())
            && vectors.iter().all(crate::attitude::finite)
            && n.wind.iter().all(|x| x.is_finite())
            && (0..ERROR_STATES).all(|i| self.covariance[(i, i)].is_finite() && self.covariance[(i, i)] > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense_transition(rotation: &Matrix3<f64>, force_ned: &Vector3<f64>, dt_s: f64) -> Covariance {
        let mut f = Covariance::identity();
        f.fixed_view_mut::<3, 3>(ATT, GYRO).copy_from(&(rotation * -dt_s));
        f.fixed_view_mut::<3, 3>(VEL, ATT).copy_from(&skew(&(force_ned * -dt_s)));
        f.fixed_view_mut::<3, 3>(VEL, ACCEL).copy_from(&(rotation * -dt_s));
        f.fixed_view_mut::<3, 3>(POS, VEL).copy_from(&(Matrix3::identity() * dt_s));
        f
    }

    fn some_covariance() -> Covariance {
        let root = Covariance::from_fn(|i, j| ((i * 7 + j * 13) % 11) as f64 / 11.0 - 0.4);
        root * root.transpose() + Covariance::identity()
    }

    #[test]
    fn noise_of_a_missing_rate_is_about_its_body_axis_alone() {
        // Nose to the east: its roll is about that axis.
        let attitude = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let nominal = Nominal { attitude, ..Nominal::default() };
        let widened = |turning: Vector3<f64>| {
            let mut filter = Filter::new(nominal, &ErrorVector::repeat(0.01));
            let noise = ProcessNoise { turning, ..ProcessNoise::default() };
            let force = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
            filter.propagate(&Vector3::zeros(), &force, 0.02, &noise);
            filter.covariance.fixed_view::<3, 3>(ATT, ATT).into_owned()
        };
        let more = widened(Vector3::new(0.3, 0.0, 0.0)) - widened(Vector3::zeros());
        let expected = Matrix3::from_diagonal(&Vector3::new(0.0, 0.3 * 0.3 * 0.02, 0.0));
        assert!((more - expected).norm() < 1e-12, "{more}");
    }

    #[test]
    fn block_propagation_equals_the_dense_product() {
        let rotation = UnitQuaternion::from_euler_angles(0.3, 0.2, 1.0).to_rotation_matrix().into_inner();
        let force = Vector3::new(1.0, -2.0, -11.0);
        let mut filter = Filter::new(Nominal::default(), &ErrorVector::repeat(1.0));
        filter.covariance = some_covariance();
        let f = dense_transition(&rotation, &force, 0.02);
        let expected = f * filter.covariance * f.transpose();
        filter.propagate_covariance(&rotation, &force, 0.02);
        assert!((filter.covariance - expected).norm() < 1e-9);
    }

    #[test]
    fn sequential_scalars_equal_the_joint_update() {
        let mut filter = Filter::new(Nominal::default(), &ErrorVector::repeat(1.0));
        filter.covariance = some_covariance();
        let before = filter;
        let rows =
            [ErrorVector::from_fn(|i, _| (i % 3) as f64), ErrorVector::from_fn(|i, _| (i % 5) as f64 - 1.0)];
        for (row, innovation) in rows.iter().zip([0.4, -0.7]) {
            filter.correct_from(&Scalar { h: *row, innovation, variance: 0.5, since: None }, 0);
        }
        let h = SMatrix::<f64, 2, ERROR_STATES>::from_rows(&[rows[0].transpose(), rows[1].transpose()]);
        let s = h * before.covariance * h.transpose() + SMatrix::<f64, 2, 2>::identity() * 0.5;
        let gain = before.covariance * h.transpose() * s.try_inverse().unwrap();
        let expected = gain * Vector2::new(0.4, -0.7);
        assert!((filter.pending - expected).norm() < 1e-9);
        assert!((filter.covariance - (Covariance::identity() - gain * h) * before.covariance).norm() < 1e-8);
    }

    #[test]
    fn joseph_form_holds_for_a_gain_that_leaves_states_alone() {
        let mut filter = Filter::new(Nominal::default(), &ErrorVector::repeat(1.0));
        filter.covariance = some_covariance();
        let before = filter.covariance;
        let h = ErrorVector::from_fn(|i, _| (i % 4) as f64 - 1.5);
        filter.correct_from(&Scalar { h, innovation: 0.8, variance: 0.3, since: None }, WIND);
        let mut gain = before * h / (h.dot(&(before * h)) + 0.3);
        gain.rows_mut(0, WIND).fill(0.0);
        let rest = Covariance::identity() - gain * h.transpose();
        let expected = rest * before * rest.transpose() + gain * gain.transpose() * 0.3;
        assert!((filter.covariance - expected).norm() < 1e-9);
        assert!(filter.pending.rows(0, WIND).norm() == 0.0 && filter.pending.rows(WIND, 2).norm() > 0.0);
        assert!(filter.covariance.cholesky().is_some());
    }

    #[test]
    fn covariance_stays_symmetric_and_positive_through_sharp_measurements() {
        let mut filter = Filter::new(Nominal::default(), &ErrorVector::repeat(1.0));
        // A thousand times sharper than any sensor, of sums that hardly differ, for an hour: rounding is all that is left.
        for k in 0..20_000 {
            let of = |i: usize| if (i + k).is_multiple_of(3) { 1.0 } else { 1.0 + 1e-6 * (k % 7) as f64 };
            let h = ErrorVector::from_fn(|i, _| of(i));
            filter.correct_from(&Scalar { h, innovation: 0.0, variance: 1e-12, since: None }, 0);
            assert_eq!(filter.covariance, filter.covariance.transpose());
            assert!(filter.covariance.diagonal().min() > 0.0, "after {k}");
        }
    }

    #[test]
    fn coordinated_turn_is_integrated_without_drift() {
        let mut filter = Filter::new(Nominal::default(), &ErrorVector::repeat(0.1));
        let (speed, yaw_rate): (f64, f64) = (22.0, 0.3);
        let bank = (speed * yaw_rate / GRAVITY_MPS2).atan();
        filter.nominal.attitude = UnitQuaternion::from_euler_angles(bank, 0.0, 0.0);
        filter.nominal.velocity = Vector3::new(speed, 0.0, 0.0);
        let rates = Vector3::new(0.0, yaw_rate * bank.sin(), yaw_rate * bank.cos());
        let force = Vector3::new(0.0, 0.0, -GRAVITY_MPS2 / bank.cos());
        let steps = 1000;
        for _ in 0..steps {
            filter.propagate(&rates, &force, 0.02, &ProcessNoise::default());
        }
        let heading = yaw_rate * 0.02 * f64::from(steps);
        let expected = Vector3::new(speed * heading.cos(), speed * heading.sin(), 0.0);
        assert!((filter.nominal.velocity - expected).norm() < 1e-3, "{}", filter.nominal.velocity);
        assert!(filter.healthy());
    }
}
