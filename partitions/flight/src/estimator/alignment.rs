//! Finding the attitude from nothing: on the ground, and in flight in the middle of a turn.
//!
//! From the first sample on, gyroscope and accelerometer are integrated in the body frame of that moment
//! (`C` turns today's body vectors into it). Between two GPS fixes the velocity gained without gravity is known in
//! NED, and the integral of `C f` is the same vector in the first body frame: no assumption on bank, turn rate or
//! coordinated flight is needed, the centripetal part is in both. The magnetometer gives a second pair of vectors,
//! the direction of flight a weak third one, which has to do where no field is measured. Wahba's problem (G. Wahba, SIAM Review 7(3), 1965) joins them; its
//! information matrix gives the initial covariance.

use super::{GpsMeasurement, ImuSample};
use crate::GRAVITY_MPS2;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Integrated samples kept; a fix must not be older than this many frames (1.28 s at 50 Hz).
const CAPACITY: usize = 64;
/// Time between the fixes that a flying aircraft is aligned by, s; and where no magnetic field was measured in it.
const LEAST_S: f64 = 0.35;
const WITHOUT_FIELD_S: f64 = 1.0;

/// Where the integration stood at a time.
#[derive(Debug, Clone, Copy)]
struct Integral {
    time_s: f64,
    /// Body of now to body of the first sample.
    turn: UnitQuaternion<f64>,
    /// ∫ C f dt, first body frame, m/s.
    force: Vector3<f64>,
}

/// A fix together with the integral at its measurement time.
#[derive(Debug, Clone, Copy)]
struct Anchor {
    fix: GpsMeasurement,
    at: Integral,
}

/// What an alignment found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aligned {
    /// Body to NED now.
    pub(crate) attitude: UnitQuaternion<f64>,
    /// NED now, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// NED now, m.
    pub(crate) position: Vector3<f64>,
    /// Covariance of the attitude error, NED, rad².
    pub(crate) covariance: Matrix3<f64>,
    /// Mean rates over the alignment, rad/s (the gyroscope bias if the aircraft stood still).
    pub(crate) mean_rates: Vector3<f64>,
}

/// A pair of vectors that should be the same: body (first frame) and NED, with the angle error expected, rad.
struct Pair {
    body: Vector3<f64>,
    ned: Vector3<f64>,
    sigma_rad: f64,
}

/// Collects samples until an attitude can be given.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alignment {
    ring: [Integral; CAPACITY],
    count: usize,
    samples: f64,
    rates: Vector3<f64>,
    rate_spread: f64,
    mag: Vector3<f64>,
    mags: f64,
    first: Option<Anchor>,
    last: Option<Anchor>,
    started_s: f64,
}

impl Alignment {
    pub(crate) fn new() -> Self {
        let start = Integral { time_s: f64::NAN, turn: UnitQuaternion::identity(), force: Vector3::zeros() };
        Self {
            ring: [start; CAPACITY],
            count: 0,
            samples: 0.0,
            rates: Vector3::zeros(),
            rate_spread: 0.0,
            mag: Vector3::zeros(),
            mags: 0.0,
            first: None,
            last: None,
            started_s: f64::NAN,
        }
    }

    fn now(&self) -> &Integral {
        &self.ring[(self.count + CAPACITY - 1) % CAPACITY]
    }

    /// Time since the first sample, s.
    pub(crate) fn age_s(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.now().time_s - self.started_s }
    }

    /// Adds one sample, biases (as far as known) already taken off.
    pub(crate) fn add_imu(&mut self, sample: &ImuSample, dt_s: f64) {
        if self.count == 0 {
            self.started_s = sample.time_s - dt_s;
            self.ring[0].time_s = self.started_s;
            self.count = 1;
        }
        let before = *self.now();
        let half = UnitQuaternion::from_scaled_axis(sample.rates * (0.5 * dt_s));
        let middle = before.turn * half;
        let force = before.force + middle * sample.specific_force * dt_s;
        self.ring[self.count % CAPACITY] = Integral { time_s: sample.time_s, turn: middle * half, force };
        self.count += 1;
        self.samples += 1.0;
        self.rates += sample.rates;
        self.rate_spread = self.rate_spread.max((sample.rates - self.mean_rates()).norm());
    }

    /// Adds a magnetometer value, gauss, bias taken off.
    pub(crate) fn add_magnetometer(&mut self, field: &Vector3<f64>) {
        if self.count > 0 {
            self.mag += self.now().turn * field;
            self.mags += 1.0;
        }
    }

    /// Adds a fix if its measurement time lies within what was integrated.
    pub(crate) fn add_gps(&mut self, fix: &GpsMeasurement) {
        if let Some(at) = self.integral_at(fix.time_s) {
            let anchor = Anchor { fix: *fix, at };
            self.first.get_or_insert(anchor);
            self.last = Some(anchor);
        }
    }

    fn integral_at(&self, time_s: f64) -> Option<Integral> {
        let held = self.count.min(CAPACITY);
        let back = |age: usize| &self.ring[(self.count + CAPACITY - 1 - age) % CAPACITY];
        if held < 2 || time_s > self.now().time_s + 0.05 {
            return None;
        }
        if time_s >= self.now().time_s {
            return Some(*self.now());
        }
        (1..held).find(|&age| back(age).time_s <= time_s).map(|age| {
            let (older, newer) = (back(age), back(age - 1));
            let share = (time_s - older.time_s) / (newer.time_s - older.time_s).max(1e-9);
            Integral {
                time_s,
                turn: older.turn.nlerp(&newer.turn, share),
                force: older.force.lerp(&newer.force, share),
            }
        })
    }

    fn mean_rates(&self) -> Vector3<f64> {
        self.rates / self.samples.max(1.0)
    }

    /// The last fix's velocity, NED, m/s, if there was one.
    pub(crate) fn last_fix(&self) -> Option<&GpsMeasurement> {
        self.last.as_ref().map(|anchor| &anchor.fix)
    }

    /// Whether nothing turned during the collection: rates constant (a bias may be large) and force near 1 g.
    pub(crate) fn still(&self) -> bool {
        let force = self.now().force.norm() / self.age_s().max(1e-6);
        self.rate_spread < 0.05 && (force - GRAVITY_MPS2).abs() < 1.0 && self.mean_rates().norm() < 0.4
    }

    /// Levels with the accelerometer and takes the heading from the magnetometer, for an aircraft that stands.
    pub(crate) fn on_ground(&self, field_ned: &Vector3<f64>) -> Option<Aligned> {
        if self.mags < 1.0 || self.samples < 10.0 {
            return None;
        }
        // Standing still the frame does not turn: what the gyroscope integrated is bias, so the mean is taken back.
        let unturn = UnitQuaternion::from_scaled_axis(self.mean_rates() * (-0.5 * self.age_s()));
        let pairs = [
            Pair { body: unturn * self.now().force, ned: Vector3::new(0.0, 0.0, -1.0), sigma_rad: 0.05 },
            Pair { body: unturn * (self.mag / self.mags), ned: *field_ned, sigma_rad: 0.06 },
        ];
        let (attitude, covariance) = wahba(&pairs)?;
        let position = self.last_fix().map_or(Vector3::zeros(), |fix| fix.position_ned);
        let mean_rates = self.mean_rates();
        Some(Aligned { attitude, velocity: Vector3::zeros(), position, covariance, mean_rates })
    }

    /// Joins specific force against GPS velocity, magnetometer and direction of flight.
    ///
    /// `wind` is the best guess with its error `wind_sigma_mps`; `incidence_rad` the usual angle of attack.
    pub(crate) fn in_flight(
        &self,
        field_ned: &Vector3<f64>,
        wind: &Vector3<f64>,
        wind_sigma_mps: f64,
        incidence_rad: f64,
    ) -> Option<Aligned> {
        let (first, last) = (self.first?, self.last?);
        let span = last.at.time_s - first.at.time_s;
        let least_s = if self.mags < 1.0 { WITHOUT_FIELD_S } else { LEAST_S };
        if span < least_s {
            return None;
        }
        let gravity = Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        let ned = last.fix.velocity_ned - first.fix.velocity_ned - gravity * span;
        let body = last.at.force - first.at.force;
        if ned.norm() < 0.3 * GRAVITY_MPS2 * span || body.norm() < 0.3 * GRAVITY_MPS2 * span {
            return None;
        }
        let air = last.fix.velocity_ned - wind;
        let nose = last.at.turn * Vector3::new(incidence_rad.cos(), 0.0, incidence_rad.sin());
        let pairs = [
            Pair { body, ned, sigma_rad: 0.03 + 0.1 / ned.norm() },
            Pair { body: nose, ned: air, sigma_rad: 0.1 + wind_sigma_mps / air.norm().max(5.0) },
            Pair { body: self.mag / self.mags.max(1.0), ned: *field_ned, sigma_rad: 0.06 },
        ];
        let (start, covariance) = wahba(if self.mags < 1.0 { &pairs[..2] } else { &pairs })?;
        let now = self.now();
        let lag = now.time_s - last.at.time_s;
        let gained = start * (now.force - last.at.force) + gravity * lag;
        Some(Aligned {
            attitude: start * now.turn,
            velocity: last.fix.velocity_ned + gained,
            position: last.fix.position_ned + last.fix.velocity_ned * lag + gained * (0.5 * lag),
            covariance,
            mean_rates: self.mean_rates(),
        })
    }
}

/// Solves Wahba's problem by singular values; returns body-to-NED and the covariance of the NED attitude error.
/// `None` when all vectors point the same way.
fn wahba(pairs: &[Pair]) -> Option<(UnitQuaternion<f64>, Matrix3<f64>)> {
    let mut profile = Matrix3::zeros();
    let mut information = Matrix3::zeros();
    for pair in pairs {
        let (body, ned) = (pair.body.try_normalize(1e-9)?, pair.ned.try_normalize(1e-9)?);
        let weight = 1.0 / (pair.sigma_rad * pair.sigma_rad);
        profile += ned * body.transpose() * weight;
        information += (Matrix3::identity() - ned * ned.transpose()) * weight;
    }
    let svd = profile.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let handed = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * handed * v_t);
    let covariance = information.try_inverse()?;
    let usable = covariance.iter().all(|x| x.is_finite()) && covariance.trace() < 1.0;
    usable.then(|| (UnitQuaternion::from_rotation_matrix(&rotation), covariance))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wahba_finds_the_rotation_from_two_pairs() {
        let truth = UnitQuaternion::from_euler_angles(0.8, -0.3, 2.0);
        let ned = [Vector3::new(0.0, 0.0, -9.8), Vector3::new(0.096, -0.049, -0.226)];
        let pairs = ned.map(|n| Pair { body: truth.inverse() * n, ned: n, sigma_rad: 0.03 });
        let (found, covariance) = wahba(&pairs).unwrap();
        assert!(found.angle_to(&truth) < 1e-9);
        assert!(covariance[(2, 2)] > covariance[(0, 0)], "heading is the weak axis");
    }

    #[test]
    fn parallel_vectors_are_refused() {
        let v = Vector3::new(0.0, 0.0, -1.0);
        let pairs = [v, v * 0.2].map(|n| Pair { body: n, ned: n, sigma_rad: 0.03 });
        assert!(wahba(&pairs).is_none());
    }

    #[test]
    fn turning_aircraft_is_aligned_without_assuming_level_flight() {
        assert!(error_after_turning(30, true).unwrap() < 0.02);
    }

    #[test]
    fn aircraft_without_a_magnetometer_is_aligned_by_its_way_through_the_air_and_takes_longer() {
        assert_eq!(error_after_turning(30, false), None);
        assert!(error_after_turning(75, false).unwrap() < 0.05);
    }

    /// Error of the attitude after so many frames of a turn, rad.
    fn error_after_turning(frames: u32, has_field: bool) -> Option<f64> {
        let (speed, yaw_rate, bank): (f64, f64, f64) = (22.0, 0.446, 45f64.to_radians());
        let field = Vector3::new(0.09584, -0.04861, -0.22624);
        let attitude = |t: f64| UnitQuaternion::from_euler_angles(bank, 0.0, 1.0 + yaw_rate * t);
        let mut alignment = Alignment::new();
        for k in 1..=frames {
            let time_s = f64::from(k) * 0.02;
            let rates = Vector3::new(0.0, yaw_rate * bank.sin(), yaw_rate * bank.cos());
            let specific_force = Vector3::new(0.0, 0.0, -GRAVITY_MPS2 / bank.cos());
            alignment.add_imu(&ImuSample { time_s, interval_s: 0.02, specific_force, rates }, 0.02);
            if has_field {
                alignment.add_magnetometer(&(attitude(time_s).inverse() * field));
            }
            if k % 10 == 6 {
                let measured = time_s - 0.1;
                let velocity_ned =
                    Vector3::new((1.0 + yaw_rate * measured).cos(), (1.0 + yaw_rate * measured).sin(), 0.0)
                        * speed;
                alignment.add_gps(&GpsMeasurement {
                    time_s: measured,
                    position_ned: Vector3::zeros(),
                    velocity_ned,
                });
            }
        }
        let found = alignment.in_flight(&field, &Vector3::zeros(), 5.0, 0.0)?;
        assert!((found.velocity.norm() - speed).abs() < 0.3);
        Some(found.attitude.angle_to(&attitude(f64::from(frames) * 0.02)))
    }
}
