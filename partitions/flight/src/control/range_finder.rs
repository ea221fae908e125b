//! Where the ground is in the Estimator's heights, by a range finder that looks down.
//!
//! The barometer was zeroed before take-off and is a metre or two off by the landing; a range finder sees the ground to a decimetre. It may
//! also see grass, something that hangs below the aircraft, or nothing new for ever. So the ground that it tells is believed while it stands
//! still, and as near to where the barometer has it as a barometer can be wrong. What was believed last stands when it is not.

use std::ops::Range;

use crate::STANDING_HEIGHT_M;
use crate::attitude::low_pass;
use crate::estimator::NavigationState;
use crate::kept::kept;

/// Further from the runway's height than this and so many standard deviations of the aircraft's height, m, no ground is believed.
const NEAR_M: f64 = 8.0;
const SIGMAS: f64 = 3.0;
const MOST_M: f64 = 30.0;
/// Tilted further than this, cosine, it does not look down.
const LEAST_DOWN: f64 = 0.8;
/// Averaging of the ground's height, s.
const AVERAGE_S: f64 = 0.2;
/// The ground stands still where that average differs from one over this time, s, by less than this, m. A sensor that is stuck carries the ground
/// down with the aircraft, which sinks by a metre each second.
const STILL_S: f64 = 2.0;
const STILL_M: f64 = 0.8;
/// It is believed when it has stood still for so long, s.
const BELIEVED_S: f64 = 3.0;
/// What was seen before is forgotten after so long without an echo, s.
const FORGOTTEN_S: f64 = 1.0;
/// So many equal distances in a row are one that is stuck: they have noise.
const EQUAL: u32 = 25;

/// Slower than this, m/s, before its take-off it stands on its wheels.
const STANDING_MPS: f64 = 0.7;
/// Its sensors are so high there, m. The highest of the delivered aircraft has them at 0.6 m.
const STAND_M: Range<f64> = 0.05..1.5;
/// Averaging of that height, s.
const STAND_S: f64 = 1.0;

/// The judge of the range finder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundWatch {
    /// Height of the ground by the last second, and by the last seconds, m above the runway.
    now_m: f64,
    mean_m: f64,
    /// How long it has stood still, and how long there was no echo, s.
    still_s: f64,
    silent_s: f64,
    /// The last distance, m, and how often it has come.
    last_m: f64,
    equal: u32,
    /// What is believed, m above the runway.
    known_m: Option<f64>,
    /// How high its sensors are where it stands, m.
    stand_m: f64,
}

impl Default for GroundWatch {
    fn default() -> Self {
        Self {
            now_m: 0.0,
            mean_m: 0.0,
            still_s: 0.0,
            silent_s: 0.0,
            last_m: 0.0,
            equal: 0,
            known_m: None,
            stand_m: STANDING_HEIGHT_M,
        }
    }
}

impl GroundWatch {
    /// Forgets the ground: the aircraft does not come down, and it is not known where it will.
    pub(super) fn forget(&mut self) {
        *self = Self { stand_m: self.stand_m, ..Self::default() };
    }

    /// One frame on wheels: learns how high the sensors stand.
    pub(super) fn stand(&mut self, range_m: Option<f64>, state: &NavigationState, dt_s: f64) {
        let down = state.euler.x.cos() * state.euler.y.cos();
        let stand_m = range_m.map(|range_m| range_m * down).filter(|stand_m| STAND_M.contains(stand_m));
        if let Some(stand_m) = stand_m.filter(|_| state.velocity.norm() < STANDING_MPS) {
            self.stand_m = low_pass(self.stand_m, stand_m, STAND_S, dt_s);
        }
    }

    /// One frame: the distance along the body's axis down, m, where there is a new one.
    pub(super) fn step(&mut self, range_m: Option<f64>, state: &NavigationState, dt_s: f64) {
        let (roll, pitch) = (state.euler.x, state.euler.y);
        let down = roll.cos() * pitch.cos();
        let Some(range_m) = range_m.filter(|range_m| range_m.is_finite() && down > LEAST_DOWN) else {
            self.silent_s += dt_s;
            return;
        };
        self.equal = if range_m == self.last_m { self.equal.saturating_add(1) } else { 0 };
        self.last_m = range_m;
        let ground_m = state.altitude_m() - range_m * down;
        let most_m = (NEAR_M + SIGMAS * state.sigmas.position.z).min(MOST_M);
        let (is_new, can_be) = (self.silent_s > FORGOTTEN_S || self.still_s == 0.0, ground_m.abs() < most_m);
        let since_s = std::mem::take(&mut self.silent_s) + dt_s;
        if !can_be || self.equal >= EQUAL {
            self.still_s = 0.0;
            return;
        }
        if is_new {
            (self.now_m, self.mean_m) = (ground_m, ground_m);
        }
        self.now_m = low_pass(self.now_m, ground_m, AVERAGE_S, since_s);
        self.mean_m = low_pass(self.mean_m, ground_m, STILL_S, since_s);
        let stands = (self.now_m - self.mean_m).abs() < STILL_M;
        self.still_s = if stands { if is_new { dt_s } else { self.still_s + since_s } } else { 0.0 };
        if self.still_s > BELIEVED_S {
            self.known_m = Some(self.now_m);
        }
    }

    /// The state with its height above the ground where that is known, as if it stood as high as the Estimator takes it to.
    pub(super) fn over_ground(&self, state: &NavigationState) -> NavigationState {
        let mut over = *state;
        over.position.z += self.known_m.map_or(0.0, |ground_m| ground_m + self.stand_m - STANDING_HEIGHT_M);
        over
    }

    /// Whether the ground is known.
    pub(super) fn is_known(&self) -> bool {
        self.known_m.is_some()
    }
}

kept!(GroundWatch {
    now_m: f64,
    mean_m: f64,
    still_s: f64,
    silent_s: f64,
    last_m: f64,
    equal: u32,
    known_m: Option<f64>,
    stand_m: f64,
} if |watch| watch.known_m.is_none_or(|ground_m| ground_m.abs() < MOST_M) && STAND_M.contains(&watch.stand_m));

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::{EstimatorStatus, StateSigmas};
    use crate::kept::tests::again;
    use nalgebra::{UnitQuaternion, Vector2, Vector3};

    const DT_S: f64 = 0.02;

    fn state(altitude_m: f64, roll_rad: f64) -> NavigationState {
        let none = Vector3::zeros();
        NavigationState {
            time_s: 0.0,
            position: Vector3::new(0.0, 0.0, -altitude_m),
            velocity: Vector3::new(20.0, 0.0, 1.4),
            quaternion: UnitQuaternion::from_euler_angles(roll_rad, 0.0, 0.0),
            euler: Vector3::new(roll_rad, 0.0, 0.0),
            rates: none,
            specific_force: none,
            wind: Vector2::zeros(),
            gyro_bias: none,
            accel_bias: none,
            mag_bias: none,
            sigmas: StateSigmas { attitude: none, velocity: none, position: none },
            status: EstimatorStatus::Ready,
        }
    }

    /// A descent of 1.4 m/s from 40 m, over ground that is at `ground_m` in the Estimator's heights. `told`: what is told of the true distance, m,
    /// at a time, s. Gives the error of the height above ground at the end, m, if that is known.
    fn descent(ground_m: f64, seconds: f64, told: impl Fn(f64, f64) -> Option<f64>) -> Option<f64> {
        descent_with(ground_m, 0.1, seconds, told)
    }

    /// The same with this standard deviation of the height, m.
    fn descent_with(
        ground_m: f64,
        sigma_m: f64,
        seconds: f64,
        told: impl Fn(f64, f64) -> Option<f64>,
    ) -> Option<f64> {
        let mut watch = GroundWatch::default();
        let mut error_m = None;
        for frame in 0..(seconds / DT_S) as u32 {
            let time_s = f64::from(frame) * DT_S;
            let over_m = 40.0 - 1.4 * time_s;
            let roll_rad = 0.3 * (0.7 * time_s).sin();
            // Noise that never comes twice.
            let noise_m = 0.05 * (f64::from(frame) * 12.9898).sin();
            let mut now = state(over_m + ground_m, roll_rad);
            now.sigmas.position.z = sigma_m;
            watch.step(told(over_m / roll_rad.cos() + noise_m, time_s), &now, DT_S);
            error_m = watch.is_known().then(|| watch.over_ground(&now).altitude_m() - over_m);
        }
        error_m
    }

    #[test]
    fn ground_is_found_wherever_the_barometer_has_it_and_also_with_gaps() {
        for ground_m in [-5.0, -1.5, 0.0, 2.5, 5.0] {
            for gaps in [1, 2, 7] {
                let told = |range_m: f64, time_s: f64| {
                    ((time_s / DT_S) as u32).is_multiple_of(gaps).then_some(range_m)
                };
                let error_m = descent(ground_m, 20.0, told).unwrap();
                assert!(error_m.abs() < 0.15, "{ground_m} {gaps}: {error_m}");
            }
        }
    }

    #[test]
    fn ground_is_found_far_from_a_height_that_nobody_knows_better() {
        for ground_m in [-20.0, -12.0, 12.0, 20.0] {
            let told = |range_m: f64, _| Some(range_m);
            assert_eq!(
                descent_with(ground_m, 0.1, 20.0, told),
                None,
                "{ground_m}: the barometer knows better"
            );
            let error_m = descent_with(ground_m, 5.0, 20.0, told).unwrap();
            assert!(error_m.abs() < 0.15, "{ground_m}: {error_m}");
        }
    }

    #[test]
    fn what_can_not_be_the_ground_is_not_believed() {
        assert_eq!(descent(0.0, 20.0, |_, _| None), None, "no echo");
        assert_eq!(descent(0.0, 20.0, |_, _| Some(31.0)), None, "stuck to the bit");
        let stuck = |_: f64, time_s: f64| Some(31.0 + 0.02 * (time_s * 700.0).sin());
        assert_eq!(descent(0.0, 8.0, stuck), None, "stuck, with noise");
        assert_eq!(
            descent(0.0, 20.0, |range_m, _| Some(range_m - 9.0)),
            None,
            "higher than a barometer is wrong"
        );
        assert_eq!(descent(0.0, 20.0, |_, _| Some(f64::NAN)), None, "no number");
        assert_eq!(descent(0.0, 1.0, |range_m, _| Some(range_m)), None, "too short a look");
        let jumps = |range_m: f64, time_s: f64| Some(range_m - 4.0 * f64::from(u8::from(time_s % 2.0 > 1.0)));
        assert_eq!(descent(0.0, 20.0, jumps), None, "another ground each second");
    }

    #[test]
    fn what_was_believed_stands_when_the_sensor_is_lost_or_stuck() {
        let lost = |range_m: f64, time_s: f64| (time_s < 10.0).then_some(range_m);
        assert!(descent(2.0, 25.0, lost).unwrap().abs() < 0.15);
        let stuck = |range_m: f64, time_s: f64| Some(if time_s < 10.0 { range_m } else { 26.0 });
        let error_m = descent(2.0, 25.0, stuck).unwrap();
        assert!(error_m.abs() < 1.0, "{error_m}: what it takes to see that it is stuck");
    }

    #[test]
    fn aircraft_whose_sensors_stand_higher_is_as_high_over_the_ground_when_it_stands_again() {
        let mut watch = GroundWatch::default();
        let standing = NavigationState { velocity: Vector3::zeros(), ..state(0.3, 0.0) };
        (0..200).for_each(|_| watch.stand(Some(1.1), &standing, DT_S));
        (0..200).for_each(|_| watch.stand(Some(1.4), &state(2.0, 0.0), DT_S)); // rolling: not where it stands
        for none in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e300, -0.3, 0.0, 1.6, 1e300] {
            watch.stand(Some(none), &standing, DT_S);
        }
        watch.forget();
        (0..400)
            .for_each(|frame| watch.step(Some(3.1 + 0.01 * f64::from(frame % 3)), &state(1.0, 0.0), DT_S));
        let height_m = watch.over_ground(&state(1.0, 0.0)).altitude_m();
        assert!((height_m - 2.3).abs() < 0.05, "{height_m}: two metres above where it stands");
    }

    #[test]
    fn memory_that_something_wrote_into_knows_no_ground() {
        let known = GroundWatch { known_m: Some(1.5), stand_m: 0.8, ..GroundWatch::default() };
        assert_eq!(again(&known), Some(known));
        for (ground_m, stand_m) in
            [(31.0, 0.8), (f64::NAN, 0.8), (1.5, 0.0), (1.5, -1.0), (1.5, 7.0), (1.5, f64::NAN)]
        {
            let wrong = GroundWatch { known_m: Some(ground_m), stand_m, ..known };
            assert_eq!(again(&wrong), None, "{ground_m} {stand_m}");
        }
    }
}
