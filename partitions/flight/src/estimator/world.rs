//! A world for the filter's own tests: an aircraft that turns, climbs and changes its speed, with sensors whose noise is
//! exactly what the filter assumes. It moves by the filter's own equations, so that nothing but the estimate can be wrong.

use super::*;
use crate::GRAVITY_MPS2;
use nalgebra::Vector2;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::VecDeque;

/// A frame, s.
pub(super) const DT_S: f64 = 0.02;
/// Normal numbers.
pub(super) struct Chance(ChaCha8Rng);

impl Chance {
    pub(super) fn one(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
    pub(super) fn three(&mut self) -> Vector3<f64> {
        Vector3::new(self.one(), self.one(), self.one())
    }
}

/// What is really the case, moved by the filter's own equations.
#[derive(Clone, Copy)]
pub(super) struct Real {
    pub(super) nominal: Nominal,
    /// Of the middle of the last step.
    rates: Vector3<f64>,
    force: Vector3<f64>,
}

/// Bank, climb angle and speed of the flight: turns to both sides, climbs, changes of speed.
fn attitude_at(time_s: f64, heading_rad: f64) -> (UnitQuaternion<f64>, Vector3<f64>, f64) {
    let bank = 0.7 * (time_s * 0.25).sin();
    let climb = 0.12 * (time_s * 0.17).sin();
    let speed = 22.0 + 2.0 * (time_s * 0.11).sin();
    let attitude = attitude::from_euler(bank, climb + 0.07, heading_rad);
    let velocity = Vector3::new(
        speed * climb.cos() * heading_rad.cos(),
        speed * climb.cos() * heading_rad.sin(),
        -speed * climb.sin(),
    );
    (attitude, velocity, GRAVITY_MPS2 * bank.tan() / speed)
}

pub(super) struct World {
    pub(super) chance: Chance,
    pub(super) config: EstimatorConfig,
    pub(super) real: Real,
    heading_rad: f64,
    pub(super) time_s: f64,
    frame: u32,
    past: VecDeque<(f64, Vector3<f64>, Vector3<f64>)>,
}

impl World {
    pub(super) fn new(seed: u64, config: EstimatorConfig) -> Self {
        let (attitude, velocity, _) = attitude_at(0.0, 0.0);
        let nominal = Nominal {
            attitude,
            velocity,
            position: Vector3::new(0.0, 0.0, -160.0),
            wind: Vector2::new(3.0, -2.0),
            ..Nominal::default()
        };
        Self {
            chance: Chance(ChaCha8Rng::seed_from_u64(seed)),
            config,
            real: Real { nominal, rates: Vector3::zeros(), force: Vector3::zeros() },
            heading_rad: 0.0,
            time_s: 0.0,
            frame: 0,
            past: VecDeque::new(),
        }
    }

    /// An estimator that begins with an error drawn from the covariance it is told.
    pub(super) fn estimator(&mut self) -> Estimator {
        let mut sigmas = initial_sigmas(&self.config.initial);
        sigmas.rows_mut(ATT, 3).fill(0.03);
        sigmas.rows_mut(GYRO, 3).fill(1e-3);
        let mut filter = Filter::new(self.real.nominal, &sigmas);
        let error = ErrorVector::from_fn(|i, _| sigmas[i] * self.chance.one());
        filter.displace(&error);
        let mut snapshot = Snapshot::of(&filter, 0.0, Some(0.0));
        snapshot.time_s = 0.0;
        let mut estimator = Estimator::new(self.config);
        assert!(estimator.warm_start(&snapshot, 0.0));
        estimator
    }

    /// Moves on by a frame and gives what the inertial sensors say of it.
    pub(super) fn step(&mut self) -> ImuSample {
        let p = self.config.process;
        let (from, v0, turn) = attitude_at(self.time_s, self.heading_rad);
        self.time_s += DT_S;
        self.frame += 1;
        self.heading_rad += turn * DT_S;
        let (to, v1, _) = attitude_at(self.time_s, self.heading_rad);
        let rates = (from.inverse() * to).scaled_axis() / DT_S;
        let middle = from * UnitQuaternion::from_scaled_axis(rates * (0.5 * DT_S));
        let acceleration = (v1 - v0) / DT_S;
        let force = middle.inverse() * (acceleration - Vector3::new(0.0, 0.0, GRAVITY_MPS2));
        self.real.rates = rates;
        self.real.force = force;
        let root = DT_S.sqrt();
        let n = &mut self.real.nominal;
        n.position += n.velocity * DT_S + acceleration * (0.5 * DT_S * DT_S);
        n.velocity = v1;
        n.attitude = to;
        let walk = self.chance.three();
        n.position += Vector3::new(p.position * walk.x, p.position * walk.y, p.height * walk.z) * root;
        // The sensors of this frame carry the biases of its beginning; those walk on afterwards.
        let attitude = Vector2::new(p.gyro, p.gyro_per_rate * rates.norm()).norm();
        let velocity = Vector2::new(p.accel, p.accel_per_force * (force.norm() - GRAVITY_MPS2)).norm();
        let sample = ImuSample {
            time_s: self.time_s,
            interval_s: DT_S,
            specific_force: force + n.accel_bias + self.chance.three() * (velocity / root),
            rates: rates + n.gyro_bias + self.chance.three() * (attitude / root),
        };
        n.gyro_bias += self.chance.three() * (p.gyro_bias * root);
        n.accel_bias += self.chance.three() * (p.accel_bias * root);
        n.mag_bias += self.chance.three() * (p.mag_bias * root);
        n.wind += Vector2::new(self.chance.one(), self.chance.one()) * (p.wind * root);
        self.past.push_back((self.time_s, n.position, n.velocity));
        if self.past.len() > 16 {
            self.past.pop_front();
        }
        sample
    }

    /// Gives the measurements of this frame; fixes are `latency_s` old.
    pub(super) fn measure(&mut self, estimator: &mut Estimator, latency_s: f64) {
        self.measure_without_fixes(estimator);
        self.fix(estimator, latency_s);
    }

    pub(super) fn measure_without_fixes(&mut self, estimator: &mut Estimator) {
        let m = self.config.measurement;
        let n = self.real.nominal;
        if self.frame.is_multiple_of(5) {
            let noise = self.chance.three() * m.magnetometer_gauss;
            let field = n.attitude.inverse() * self.config.field_ned_gauss + n.mag_bias + noise;
            estimator.update_magnetometer(self.time_s, &field);
        }
        if self.frame.is_multiple_of(2) {
            let height = -n.position.z + m.barometer_m * self.chance.one();
            estimator.update_baro(self.time_s, static_pa(height));
        }
    }

    fn fix(&mut self, estimator: &mut Estimator, latency_s: f64) {
        let m = self.config.measurement;
        if self.frame.is_multiple_of(10) {
            let then = self.time_s - latency_s;
            let Some(&(time_s, position, velocity)) = self.past.iter().find(|x| (x.0 - then).abs() < 1e-6)
            else {
                return;
            };
            let by_barometer = self.config.aiding.pressure;
            let vertical = if by_barometer { m.gps_vertical_with_barometer_m } else { m.gps_vertical_m };
            let noise = self.chance.three();
            let off =
                Vector3::new(m.gps_horizontal_m * noise.x, m.gps_horizontal_m * noise.y, vertical * noise.z);
            estimator.update_gps(&GpsMeasurement {
                time_s,
                position_ned: position + off,
                velocity_ned: velocity + self.chance.three() * m.gps_velocity_mps,
            });
        }
    }
}

/// Static pressure at a pressure altitude, Pa: the inverse of the estimator's formula.
pub(super) fn static_pa(height_m: f64) -> f64 {
    101_325.0 * (1.0 - height_m / 44_330.77).powf(1.0 / 0.190_263_2)
}

/// A filter's settings, with or without pressures.
pub(super) fn config(pressure: bool) -> EstimatorConfig {
    let mut config = EstimatorConfig::with_field(Vector3::new(0.096, -0.049, -0.226));
    config.aiding.pressure = pressure;
    config
}
