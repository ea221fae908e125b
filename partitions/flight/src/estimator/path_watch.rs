//! Whether the barometer climbs as the attitude says, while no receiver is there to compare it with.
//!
//! The air meets an aircraft within a few degrees of where it met it before: one that points far below the horizon and flies does not keep its
//! height, unless the attitude is wrong. Then the pitot knows: what thrust less drag does, less what the speed takes, lifts the aircraft.
//! Where both contradict the barometer it is wrong. Only what no error of incidence, turn or gust explains counts, so a slow descent is not found,
//! and a dive is within a few seconds.

use crate::GRAVITY_MPS2;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// How slowly the incidence follows, and how long it is looked at before it is used, s.
const INCIDENCE_S: f64 = 10.0;
const LEARNT_S: f64 = 15.0;
/// Climb rates may differ by this, m/s, and by so many deviations of the gusts: incidence in turns.
const FREE_MPS: f64 = 1.0;
const FREE_GUSTS: f64 = 2.0;
/// Beyond it they may add up to this, m: the noise of heights, short manoeuvres.
const MOST_M: f64 = 6.0;
/// No speed is believed that is less than this share of the usual one: it comes from inertial values that may have followed the barometer.
const LEAST_SHARE: f64 = 0.8;
/// Heights further apart do not tell the climb between them, s.
const LONGEST_GAP_S: f64 = 0.5;

/// The judge of the static port without satellites.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PathWatch {
    incidence_rad: f64,
    usual_mps: f64,
    learnt_s: f64,
    /// Of the accelerometers while satellites told it, m/s²: what a wrong barometer or attitude costs goes into it.
    bias_mps2: Vector3<f64>,
    last: Option<Heights>,
    by_attitude: Sums,
    by_energy: Sums,
}

/// What is compared with the barometer's height, at one moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heights {
    /// When, s.
    pub(super) time_s: f64,
    /// Height by barometer, m.
    pub(super) barometer_m: f64,
    /// Climb rate by attitude, m/s.
    pub(super) climb_mps: f64,
    /// Airspeed by pitot, m/s, if that is believed.
    pub(super) airspeed_mps: Option<f64>,
    /// By the accelerometers, body axes, m/s².
    pub(super) specific_force: Vector3<f64>,
}

/// How much more the barometer has climbed than the aircraft, and how much less, m.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    more: Sum,
    less: Sum,
}

/// What is beyond what is free, m, and the whole.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    beyond_m: f64,
    whole_m: f64,
}

impl Sums {
    fn add(&mut self, off_m: f64, free_m: f64) {
        self.more.add(off_m, free_m);
        self.less.add(-off_m, free_m);
    }
}

impl Sum {
    fn add(&mut self, off_m: f64, free_m: f64) {
        self.beyond_m += off_m - free_m;
        self.whole_m += off_m;
        if self.beyond_m <= 0.0 {
            *self = Self::default();
        }
    }
}

impl PathWatch {
    /// Takes the velocity through the air that a receiver and the wind tell, and the accelerometers' bias, body axes, m/s, m/s².
    pub(super) fn learn(&mut self, interval_s: f64, air: &Vector3<f64>, bias_mps2: &Vector3<f64>) {
        let incidence_rad = air.z.atan2(air.x);
        self.learnt_s = (self.learnt_s + interval_s).min(LEARNT_S);
        let share = (interval_s / INCIDENCE_S).max(interval_s / self.learnt_s);
        self.incidence_rad += share * (incidence_rad - self.incidence_rad);
        self.usual_mps += share * (air.norm() - self.usual_mps);
        self.bias_mps2 += share * (bias_mps2 - self.bias_mps2);
    }

    /// Airspeed while satellites told it, m/s.
    pub(super) fn usual_mps(&self) -> f64 {
        self.usual_mps
    }

    /// How the air comes, and an axis across which it does not: body axes; `None` until they are known.
    pub(super) fn axes(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let turned = Rotation3::from_axis_angle(&Vector3::y_axis(), -self.incidence_rad);
        (self.learnt_s >= LEARNT_S).then(|| (turned * Vector3::x(), turned * Vector3::z()))
    }

    /// The velocity through the air, NED, of an aircraft with this attitude, whose inertial values say this velocity, m/s.
    pub(super) fn air_mps(&self, attitude: &UnitQuaternion<f64>, air: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (along, _) = self.axes()?;
        Some(attitude * along * air.norm().max(LEAST_SHARE * self.usual_mps))
    }

    /// A receiver is there: it judges.
    pub(super) fn restart(&mut self) {
        *self = Self { last: None, by_attitude: Sums::default(), by_energy: Sums::default(), ..*self };
    }

    /// Takes heights in gusts of so many m/s; gives how much more the barometer has climbed than the aircraft when that is found to be wrong.
    pub(super) fn compare(&mut self, now: Heights, gusts_mps: f64) -> Option<f64> {
        let (along, _) = self.axes()?;
        let last = self.last.replace(now)?;
        let interval_s = now.time_s - last.time_s;
        if !(0.0..=LONGEST_GAP_S).contains(&interval_s) {
            self.restart();
            return None;
        }
        let climbed_m = now.barometer_m - last.barometer_m;
        let free_m = (FREE_MPS + FREE_GUSTS * gusts_mps) * interval_s;
        let by_attitude_m = climbed_m - now.climb_mps * interval_s;
        self.by_attitude.add(by_attitude_m, free_m);
        if now.airspeed_mps.is_some() != last.airspeed_mps.is_some() {
            self.by_energy = Sums::default();
        }
        match (now.airspeed_mps, last.airspeed_mps) {
            (Some(now_mps), Some(last_mps)) => {
                let along_mps2 = (now.specific_force - self.bias_mps2).dot(&along);
                let lifted_m = along_mps2 / GRAVITY_MPS2 * now_mps * interval_s;
                let speed_takes_m = (now_mps.powi(2) - last_mps.powi(2)) / (2.0 * GRAVITY_MPS2);
                self.by_energy.add(climbed_m - (lifted_m - speed_takes_m), free_m);
            }
            // A static port that is wrong makes the pitot wrong.
            _ => self.by_energy.add(by_attitude_m, free_m),
        }
        // A gust is energy that the aircraft has not gained.
        let gust_m = FREE_GUSTS * gusts_mps * now.airspeed_mps.unwrap_or(0.0) / GRAVITY_MPS2;
        let (attitude, energy) = (&self.by_attitude, &self.by_energy);
        [(attitude.more, energy.more, 1.0), (attitude.less, energy.less, -1.0)]
            .into_iter()
            .find(|(attitude, energy, _)| attitude.beyond_m > MOST_M && energy.beyond_m > MOST_M + gust_m)
            .map(|(attitude, _, sign)| sign * attitude.whole_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const GUSTS_MPS: f64 = 0.8;

    /// What an aircraft is told of its climb.
    struct Told {
        /// Lag of the static port, s.
        lag_s: f64,
        blocked: bool,
        /// How much more the attitude climbs, m/s.
        tilted_mps: f64,
        pitot: bool,
    }

    const SOUND: Told = Told { lag_s: 0.0, blocked: false, tilted_mps: 0.0, pitot: true };

    /// Flies for 60 s at 22 m/s; when the barometer was found to be wrong, s, and how much more it had climbed, m.
    fn fly(seed: u64, climb_mps: impl Fn(f64) -> f64, told: &Told) -> Option<(f64, f64)> {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = || -> f64 { StandardNormal.sample(&mut chance) };
        let mut watch = PathWatch::default();
        for _ in 0..200 {
            watch.learn(0.1, &Vector3::new(22.0, 0.0, 1.5), &Vector3::zeros());
        }
        let (along, _) = watch.axes().unwrap();
        let (mut height_m, mut followed_m) = (0.0, 0.0);
        (0..1500).find_map(|step| {
            let time_s = f64::from(step) * 0.04;
            let climb = climb_mps(time_s);
            height_m += 0.04 * climb;
            followed_m += (height_m - followed_m) * (0.04 / (0.04 + told.lag_s));
            let barometer_m = if told.blocked { 0.0 } else { followed_m } + 0.5 * noise();
            let now = Heights {
                time_s,
                barometer_m,
                climb_mps: climb + told.tilted_mps + GUSTS_MPS * noise(),
                airspeed_mps: told.pitot.then(|| 22.0 + 0.5 * noise()),
                specific_force: GRAVITY_MPS2 * climb / 22.0 * along,
            };
            watch.compare(now, GUSTS_MPS).map(|off_m| (time_s, off_m))
        })
    }

    #[test]
    fn port_that_is_blocked_or_slow_is_found_within_seconds_of_a_dive_or_climb() {
        for seed in 0..40 {
            for (climb, pitot) in [(-6.0, true), (6.0, true), (-6.0, false)] {
                for (lag_s, blocked) in [(0.0, true), (15.0, false)] {
                    let told = Told { lag_s, blocked, pitot, ..SOUND };
                    let found = fly(seed, |time_s| if time_s < 10.0 { 0.0 } else { climb }, &told);
                    let case = format!("seed {seed}, {climb} m/s, pitot {pitot}, lag {lag_s} s: {found:?}");
                    let (time_s, off_m) = found.expect(&case);
                    assert!((10.0..16.0).contains(&time_s), "{case}");
                    assert!(-climb.signum() * off_m > MOST_M, "{case}");
                }
            }
        }
    }

    #[test]
    fn sound_port_is_believed_in_climbs_and_dives_and_beside_a_tilted_attitude() {
        for seed in 0..40 {
            let climb_mps = |time_s: f64| 8.0 * (time_s * (0.2 + 0.02 * seed as f64)).sin();
            assert_eq!(fly(seed, climb_mps, &SOUND), None, "seed {seed}");
            for tilted_mps in [-6.0, 6.0] {
                let told = Told { tilted_mps, ..SOUND };
                assert_eq!(fly(seed, climb_mps, &told), None, "seed {seed}, {tilted_mps} m/s");
            }
        }
    }
}
