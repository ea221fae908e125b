//! What stands in for an axis of an inertial sensor that measures nothing any more.
//!
//! Of the six equations of motion each holds one force and the rates: with accelerations relative to the air left out, a missing force or
//! rate follows from the others (body axes, velocity relative to the air (u, v, w), `a × b` the turning of the axes):
//! `f = ω × V − Rᵀ g`, and along the nose what the pitot's airspeed gains. Gusts are what it does not know. The roll rate has no place in it while the aircraft flies straight along its
//! nose: there the bank is told by the yaw rate and the lateral force, `g cos θ sin φ = r u − f_y`, and the rate turns the state towards it.

use super::filter::ProcessNoise;
use super::{Estimator, ImuSample};
use crate::GRAVITY_MPS2;
use crate::attitude::low_pass;
use nalgebra::Vector3;

/// Bits of axes: accelerometer forward, right, down, then the gyroscope's.
const FORCE_AXES: u32 = 0b111;
const GYROSCOPE_SHIFT: u32 = 3;
/// Those for which something stands in: without the accelerometer's second axis the filter flies on as it is, and better.
const REPLACED: u32 = 0b11_1101;

/// Time over which pitch and yaw rates are averaged, s: gusts are shorter.
const RATE_S: f64 = 0.1;
/// The same for what the airspeed gains, s.
const GAIN_S: f64 = 0.5;
/// How fast the bank follows that which is told, 1/s; and the steepest one that is told.
const BANK_GAIN: f64 = 2.0;
const MOST_SINE: f64 = 0.9;
/// Below this airspeed nothing is told by the air, m/s.
const LEAST_MPS: f64 = 8.0;
/// No manoeuvre is quicker, rad/s.
const MOST_RADPS: f64 = 1.0;
/// What it leaves out, as noise: velocity, m/s/√s, and attitude, about that axis alone, rad/√s. The roll rate's lets the magnetometer tell the bank.
const FORCE_NOISE: f64 = 0.5;
const RATE_NOISE: [f64; 3] = [0.3, 0.15, 0.15];

/// Axes that are not believed, and what stands in for them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Doubtful {
    axes: u32,
    rates: Vector3<f64>,
    /// Airspeed of the last moments, m/s; 0: none yet.
    airspeed_mps: f64,
}

impl Doubtful {
    /// The gyroscope does not tell the rate about an axis.
    fn lacks_rate(&self, axis: usize) -> bool {
        self.axes >> (GYROSCOPE_SHIFT + axis as u32) & 1 != 0
    }

    /// The accelerometer does not tell the force along an axis.
    fn lacks_force(&self, axis: usize) -> bool {
        self.axes >> axis & 1 != 0
    }

    /// What the airspeed gains, m/s²; zero where nothing tells it.
    fn gained_mps2(&mut self, airspeed_mps: Option<f64>, dt_s: f64) -> f64 {
        let Some(airspeed_mps) = airspeed_mps else {
            self.airspeed_mps = 0.0;
            return 0.0;
        };
        if self.airspeed_mps <= 0.0 {
            self.airspeed_mps = airspeed_mps;
        }
        let gained_mps2 = (airspeed_mps - self.airspeed_mps) / GAIN_S;
        self.airspeed_mps = low_pass(self.airspeed_mps, airspeed_mps, GAIN_S, dt_s);
        gained_mps2
    }
}

impl Estimator {
    /// Axes of the inertial sensors that are not to be believed from now on, one bit each: accelerometer 1, 2, 4, gyroscope 8, 16, 32.
    pub fn doubt(&mut self, axes: u32) {
        let axes = axes & REPLACED;
        if axes != self.doubtful.axes {
            self.doubtful = Doubtful { axes, ..Doubtful::default() };
        }
    }

    /// A sample with what stands in for doubtful axes; the same where all are believed, or nothing is known of the motion.
    pub(super) fn replaced(&mut self, sample: &ImuSample, dt_s: f64) -> ImuSample {
        let mut sample = *sample;
        if self.doubtful.axes == 0 {
            return sample;
        }
        let nominal = &self.filter.nominal;
        let air = nominal.attitude.inverse_transform_vector(&self.air());
        let down = nominal.attitude.inverse_transform_vector(&Vector3::new(0.0, 0.0, GRAVITY_MPS2));
        if air.x < LEAST_MPS {
            return self.unturned(&sample); // it stands or rolls, and hardly turns
        }
        let mut rates = sample.rates - nominal.gyro_bias;
        let force = sample.specific_force - nominal.accel_bias;
        let mut told = self.doubtful.rates;
        if self.doubtful.lacks_rate(1) {
            told.y = low_pass(told.y, (rates.x * air.y - force.z - down.z) / air.x, RATE_S, dt_s);
            rates.y = told.y;
        }
        if self.doubtful.lacks_rate(2) {
            told.z = low_pass(told.z, (force.y + down.y + rates.x * air.z) / air.x, RATE_S, dt_s);
            rates.z = told.z;
        }
        if self.doubtful.lacks_rate(0) {
            let (bank, pitch, _) = nominal.attitude.euler_angles();
            let sine = (rates.z * air.x - force.y) / (GRAVITY_MPS2 * pitch.cos().max(0.3));
            rates.x = BANK_GAIN * (sine.clamp(-MOST_SINE, MOST_SINE).asin() - bank);
        }
        self.doubtful.rates = told;
        let gained_mps2 = self.doubtful.gained_mps2(
            self.last_airspeed_mps.filter(|_| self.pitot_believed && self.config.aiding.pressure),
            dt_s,
        );
        let turned = rates.cross(&air) - down + Vector3::new(gained_mps2, 0.0, 0.0);
        for axis in 0..3 {
            if self.doubtful.lacks_rate(axis) {
                let rate = rates[axis].clamp(-MOST_RADPS, MOST_RADPS);
                sample.rates[axis] = rate + nominal.gyro_bias[axis];
            }
            if self.doubtful.lacks_force(axis) {
                sample.specific_force[axis] = turned[axis] + nominal.accel_bias[axis];
            }
        }
        sample
    }

    /// A sample with no turn about doubtful axes: nothing is known of the motion.
    pub(super) fn unturned(&self, sample: &ImuSample) -> ImuSample {
        let rates = Vector3::from_fn(|axis, _| {
            if self.doubtful.lacks_rate(axis) {
                self.filter.nominal.gyro_bias[axis]
            } else {
                sample.rates[axis]
            }
        });
        ImuSample { rates, ..*sample }
    }

    /// Noise with what stands in for doubtful axes.
    pub(super) fn doubting(&self, noise: ProcessNoise) -> ProcessNoise {
        let force = self.doubtful.axes & FORCE_AXES != 0;
        let turning =
            Vector3::from_fn(|axis, _| if self.doubtful.lacks_rate(axis) { RATE_NOISE[axis] } else { 0.0 });
        ProcessNoise { accel: if force { FORCE_NOISE } else { noise.accel }, turning, ..noise }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::from_euler;
    use crate::estimator::{EstimatorConfig, Phase};

    /// A coordinated turn in still air: what the sensors say.
    fn turn(bank_rad: f64, pitch_rad: f64) -> (Estimator, ImuSample) {
        let mut estimator = Estimator::new(EstimatorConfig::with_field(Vector3::new(0.1, -0.05, -0.2)));
        let airspeed_mps = 22.0;
        estimator.phase = Phase::Running;
        estimator.filter.nominal.attitude = from_euler(bank_rad, pitch_rad, 0.7);
        let along = Vector3::new(airspeed_mps * pitch_rad.cos(), 0.0, airspeed_mps * pitch_rad.sin());
        estimator.filter.nominal.velocity = estimator.filter.nominal.attitude * along;
        let turn = GRAVITY_MPS2 * bank_rad.tan() / airspeed_mps;
        let down = estimator.filter.nominal.attitude.inverse_transform_vector(&Vector3::z());
        let rates = down * turn;
        let specific_force = rates.cross(&along) - down * GRAVITY_MPS2;
        (estimator, ImuSample { time_s: 1.0, interval_s: 0.02, specific_force, rates })
    }

    #[test]
    fn each_missing_axis_follows_from_the_others_in_a_turn() {
        for trial in 0..40 {
            let bank_rad = -0.6 + 0.03 * f64::from(trial);
            for axis in [0, 2, 3, 4, 5] {
                let (mut estimator, truth) = turn(bank_rad, 0.08);
                estimator.doubt(1 << axis);
                let mut broken = truth;
                if axis < 3 {
                    broken.specific_force[axis] = 99.0
                } else {
                    broken.rates[axis - 3] = 9.0
                }
                let replaced = (0..200).map(|_| estimator.replaced(&broken, 0.02)).last().unwrap();
                let force = (replaced.specific_force - truth.specific_force).norm();
                let rate = (replaced.rates - truth.rates).norm();
                assert!(force < 0.05 && rate < 0.05, "axis {axis}, bank {bank_rad}: {force} {rate}");
            }
        }
    }

    #[test]
    fn missing_force_along_the_nose_follows_the_airspeed_that_a_believed_pitot_gains() {
        for gains_mps2 in [-1.5, -0.4, 0.4, 1.5] {
            for believed in [true, false] {
                let (mut estimator, truth) = turn(0.3, 0.08);
                estimator.doubt(1);
                estimator.pitot_believed = believed;
                let replaced = (0..200).map(|frame| {
                    estimator.last_airspeed_mps = Some(22.0 + gains_mps2 * 0.02 * f64::from(frame));
                    estimator.replaced(&truth, 0.02).specific_force.x
                });
                let gained_mps2 = replaced.last().unwrap() - truth.specific_force.x;
                let expected_mps2 = if believed { gains_mps2 } else { 0.0 };
                assert!((gained_mps2 - expected_mps2).abs() < 0.1, "{gains_mps2}, {believed}: {gained_mps2}");
            }
        }
    }

    #[test]
    fn aircraft_that_is_too_slow_to_fly_is_not_turned_by_an_axis_that_is_stuck() {
        let (mut estimator, truth) = turn(0.0, 0.0);
        estimator.doubt(0b11_1000);
        estimator.filter.nominal.velocity *= 0.2;
        let rates = estimator.replaced(&ImuSample { rates: Vector3::repeat(0.5), ..truth }, 0.02).rates;
        assert_eq!(rates, estimator.filter.nominal.gyro_bias);
    }

    #[test]
    fn bank_that_is_off_goes_back_without_a_roll_rate() {
        for (bank_rad, off_rad) in [(0.0, 0.2), (0.0, -0.2), (0.4, -0.2), (-0.5, 0.15)] {
            let (mut estimator, truth) = turn(bank_rad, 0.08);
            estimator.doubt(1 << 3);
            let mut broken = truth;
            broken.rates.x = 9.0;
            estimator.filter.nominal.attitude = from_euler(bank_rad + off_rad, 0.08, 0.7);
            let rate = estimator.replaced(&broken, 0.02).rates.x;
            let wanted = truth.rates.x - BANK_GAIN * off_rad;
            assert!((rate - wanted).abs() < 0.2 * BANK_GAIN * off_rad.abs(), "{bank_rad}: {rate} {wanted}");
        }
    }

    #[test]
    fn sample_whose_axes_are_believed_is_the_same_to_the_bit() {
        let (mut estimator, sample) = turn(0.3, 0.1);
        assert_eq!(estimator.replaced(&sample, 0.02), sample);
        estimator.doubt(4);
        assert_ne!(
            estimator.replaced(&ImuSample { specific_force: Vector3::zeros(), ..sample }, 0.02),
            sample
        );
        estimator.doubt(0);
        assert_eq!(estimator.replaced(&sample, 0.02), sample);
    }
}
