//! A ring of past states, so that a late measurement meets the state of its own time.

use super::filter::{ACCEL, ATT, ErrorVector, GYRO, POS, Scalar, VEL};
use crate::GRAVITY_MPS2;
use crate::attitude::skew;
use nalgebra::{Matrix3, Vector3};

/// Frames kept: 1.28 s at 50 Hz and 2.56 s at 25 Hz, against receiver latencies of 50 to 250 ms.
const CAPACITY: usize = 64;

/// Velocity and position at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Past {
    pub(crate) time_s: f64,
    pub(crate) velocity: Vector3<f64>,
    pub(crate) position: Vector3<f64>,
    /// [`Filter::velocity_noise`](super::filter::Filter::velocity_noise) then, m²/s².
    pub(crate) velocity_noise: f64,
}

const NOTHING: Past = Past {
    time_s: f64::NEG_INFINITY,
    velocity: Vector3::new(0.0, 0.0, 0.0),
    position: Vector3::new(0.0, 0.0, 0.0),
    velocity_noise: 0.0,
};

/// Past states, newest last.
#[derive(Debug, Clone, Copy)]
pub(crate) struct History {
    ring: [Past; CAPACITY],
    next: usize,
    count: usize,
}

impl History {
    pub(crate) fn new() -> Self {
        Self { ring: [NOTHING; CAPACITY], next: 0, count: 0 }
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::new();
    }

    pub(crate) fn push(&mut self, past: Past) {
        self.ring[self.next] = past;
        self.next = (self.next + 1) % CAPACITY;
        self.count = (self.count + 1).min(CAPACITY);
    }

    /// The entry `age` steps before the newest.
    fn back(&self, age: usize) -> &Past {
        &self.ring[(self.next + CAPACITY - 1 - age) % CAPACITY]
    }

    /// Velocity and position at a time, interpolated; `None` when the ring does not reach there.
    /// A time up to one frame after the newest entry counts as the newest.
    pub(crate) fn at(&self, time_s: f64) -> Option<Past> {
        if self.count == 0 {
            return None;
        }
        let newest = self.back(0);
        if time_s >= newest.time_s {
            return (time_s - newest.time_s < 0.05).then_some(*newest);
        }
        (1..self.count).find(|&age| self.back(age).time_s <= time_s).map(|age| {
            let (older, newer) = (self.back(age), self.back(age - 1));
            let share = (time_s - older.time_s) / (newer.time_s - older.time_s).max(1e-9);
            Past {
                time_s,
                velocity: older.velocity.lerp(&newer.velocity, share),
                position: older.position.lerp(&newer.position, share),
                velocity_noise: older.velocity_noise + share * (newer.velocity_noise - older.velocity_noise),
            }
        })
    }

    /// Carries a correction made now back to the past states, so that the next late fix does not count it as error.
    pub(crate) fn correct(&mut self, now: &Past, error: &ErrorVector, rotation: &Matrix3<f64>) {
        let block = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
        let (tilt, velocity, position, bias) = (block(ATT), block(VEL), block(POS), rotation * block(ACCEL));
        for past in self.ring.iter_mut().take(self.count.max(self.next)) {
            let lag = now.time_s - past.time_s;
            if !(0.0..=1.0).contains(&lag) {
                continue;
            }
            let gained = force_integral(now, past);
            let swing = gained.cross(&tilt);
            past.velocity += velocity + swing + bias * lag;
            past.position += position - velocity * lag - swing * (0.5 * lag);
        }
    }
}

/// ∫ f dt in NED between a past state and now: the velocity gained without gravity. `now` must be uncorrected.
fn force_integral(now: &Past, past: &Past) -> Vector3<f64> {
    now.velocity - past.velocity - Vector3::new(0.0, 0.0, GRAVITY_MPS2 * (now.time_s - past.time_s))
}

/// How a past velocity depends on the present error: δv_past = δv + [Δv]× θ + R lag δb_a, with the gyro bias in θ.
pub(crate) fn velocity_row(axis: usize, now: &Past, past: &Past, rotation: &Matrix3<f64>) -> ErrorVector {
    let lag = now.time_s - past.time_s;
    let swing = skew(&force_integral(now, past));
    let mut h = ErrorVector::zeros();
    h[VEL + axis] = 1.0;
    let gyro = swing * rotation * (0.5 * lag);
    for i in 0..3 {
        h[ATT + i] = swing[(axis, i)];
        h[ACCEL + i] = rotation[(axis, i)] * lag;
        h[GYRO + i] = gyro[(axis, i)];
    }
    h
}

/// How a past position depends on the present error: δp_past = δp − lag δv − (lag/2) [Δv]× θ.
pub(crate) fn position_row(axis: usize, now: &Past, past: &Past) -> ErrorVector {
    let lag = now.time_s - past.time_s;
    let swing = skew(&force_integral(now, past)) * (-0.5 * lag);
    let mut h = ErrorVector::zeros();
    h[POS + axis] = 1.0;
    h[VEL + axis] = -lag;
    for i in 0..3 {
        h[ATT + i] = swing[(axis, i)];
    }
    h
}

/// Shorthand for a scalar measurement.
pub(crate) fn scalar(h: ErrorVector, innovation: f64, sigma: f64) -> Scalar {
    Scalar { h, innovation, variance: sigma * sigma, since: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_s: f64) -> Past {
        Past {
            time_s,
            velocity: Vector3::new(time_s, 0.0, 0.0),
            position: Vector3::new(0.0, 2.0 * time_s, 0.0),
            velocity_noise: 0.0,
        }
    }

    #[test]
    fn past_state_is_interpolated_and_too_old_is_refused() {
        let mut history = History::new();
        assert!(history.at(0.0).is_none());
        for k in 0..100 {
            history.push(at(f64::from(k) * 0.02));
        }
        let past = history.at(1.87).unwrap();
        assert!((past.velocity.x - 1.87).abs() < 1e-9 && (past.position.y - 3.74).abs() < 1e-9);
        assert!(history.at(0.3).is_none(), "older than the ring");
        assert!(history.at(2.1).is_none(), "from the future");
        assert!(history.at(1.985).is_some());
    }

    #[test]
    fn correction_reaches_the_past() {
        let mut history = History::new();
        for k in 0..10 {
            history.push(at(f64::from(k) * 0.02));
        }
        let now = at(0.18);
        let mut error = ErrorVector::zeros();
        error[VEL] = 1.0;
        error[POS] = 3.0;
        history.correct(&now, &error, &Matrix3::identity());
        let past = history.at(0.08).unwrap();
        assert!((past.velocity.x - 1.08).abs() < 1e-9);
        assert!((past.position.x - 2.9).abs() < 1e-9);
    }
}
