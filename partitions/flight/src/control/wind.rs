//! The airspeed by satellites: velocity over ground, less the wind as it was before.
//!
//! Responsible for how far the pitot has come away from that, measured by what gusts do. The wind that it remembers follows the
//! Estimator's so slowly that a pitot that drifts by 0.25 m/s each second is seen before the wind has followed it.

use super::NavigationState;
use crate::kept::kept;
use nalgebra::Vector2;

/// Memory of the wind, s, and of the gusts' size, s. Nothing is said before half of the former.
const WIND_S: f32 = 40.0;
const GUSTS_S: f32 = 60.0;
/// Gusts before their size is known, and the least size, m/s. One that is more than so many times as large as it was counts as that.
const UNKNOWN_MPS: f32 = 1.5;
const LEAST_MPS: f64 = 0.5;
const LARGEST: f64 = 2.0;
/// A pitot that has come away by so many deviations of the gusts, and by so much, m/s, is told with 1.
const DEVIATIONS: f64 = 3.0;
const AWAY_MPS: f64 = 3.0;

/// See the module's head.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct WindWatch {
    /// North and east, m/s.
    wind_mps: [f32; 2],
    /// Mean square of what the pitot tells beyond velocity and wind, m²/s².
    square: f32,
    /// Up to [`GUSTS_S`].
    seen_s: f32,
}

impl WindWatch {
    /// A pitot that was believed has told the wind for long enough.
    pub(super) fn is_known(&self) -> bool {
        self.seen_s >= 0.5 * WIND_S
    }

    /// What gusts do to that, m/s.
    pub(super) fn deviation_mps(&self) -> f64 {
        let known = self.seen_s / GUSTS_S;
        f64::from((known * self.square + (1.0 - known) * UNKNOWN_MPS * UNKNOWN_MPS).sqrt()).max(LEAST_MPS)
    }

    /// Takes a frame in which satellites and a pitot (m/s) that is believed are there. Gives how far the pitot has come away: 1 where gusts
    /// do not explain it, negative where it tells too little, 0 where nothing is known.
    pub(super) fn step(&mut self, state: &NavigationState, pitot_mps: f64, dt_s: f64) -> f64 {
        if !pitot_mps.is_finite() {
            return 0.0;
        }
        if self.seen_s <= 0.0 {
            self.wind_mps = [state.wind.x as f32, state.wind.y as f32];
        }
        let dt_s = dt_s as f32;
        self.seen_s = (self.seen_s + dt_s).min(GUSTS_S);
        let follow = |value: &mut f32, target: f64, memory_s: f32| {
            *value += (target as f32 - *value) * (dt_s / memory_s.max(dt_s));
        };
        for (axis, wind_mps) in self.wind_mps.iter_mut().enumerate() {
            follow(wind_mps, state.wind[axis], WIND_S.min(self.seen_s));
        }
        let air = state.velocity.xy() - Vector2::from(self.wind_mps.map(f64::from));
        let off_mps = pitot_mps - (air.norm_squared() + state.velocity.z * state.velocity.z).sqrt();
        let deviation_mps = self.deviation_mps();
        let gust_mps = off_mps.clamp(-LARGEST * deviation_mps, LARGEST * deviation_mps);
        follow(&mut self.square, gust_mps * gust_mps, self.seen_s);
        if self.is_known() { off_mps / (DEVIATIONS * deviation_mps).max(AWAY_MPS) } else { 0.0 }
    }

    /// There are no satellites: what was known ages.
    pub(super) fn pause(&mut self, dt_s: f64) {
        self.seen_s = (self.seen_s - dt_s as f32).max(0.0);
    }
}

kept!(WindWatch { wind_mps: [f32; 2], square: f32, seen_s: f32 }
    if |watch| watch.square >= 0.0 && (0.0..=GUSTS_S).contains(&watch.seen_s));

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tests::level_state;
    use crate::kept::tests::again;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Flies round and round in gusts (m/s) with a pitot that is sound for five minutes and then drifts (m/s each second), until it is told to be
    /// away by so much; how much it then tells too much, m/s. The Estimator's wind follows the pitot within 15 s.
    fn told_at_mps(seed: u64, gusts_mps: f64, drift_mps2: f64, least: f64) -> Option<f64> {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let (mut watch, mut gust_mps) = (WindWatch::default(), 0.0);
        let (mut state, wind, dt_s) = (level_state(), Vector2::new(4.0, -3.0), 0.02);
        state.wind = wind;
        for frame in 0..24_000 {
            let time_s = f64::from(frame) * dt_s;
            let noise: f64 = StandardNormal.sample(&mut chance);
            gust_mps += -gust_mps * dt_s / 15.0 + gusts_mps * (2.0 * dt_s / 15.0f64).sqrt() * noise;
            let nose = Vector2::new((time_s / 12.0).cos(), (time_s / 12.0).sin());
            let off_mps = drift_mps2 * (time_s - 300.0).max(0.0);
            let pitot_mps = 22.0 + gust_mps + off_mps;
            let ground = nose * 22.0 + wind;
            state.velocity = nalgebra::Vector3::new(ground.x, ground.y, 0.0);
            let told = ground - nose * pitot_mps;
            state.wind += (told - state.wind) * (dt_s / 15.0);
            if watch.step(&state, pitot_mps, dt_s).abs() > least {
                return Some(off_mps);
            }
        }
        None
    }

    #[test]
    fn pitot_that_drifts_is_told_in_calm_and_rough_air_and_one_that_does_not_is_not() {
        for seed in 0..30 {
            let gusts_mps = [0.0, 0.9, 1.9][seed as usize % 3];
            let drift_mps2 = [-1.0, -0.5, -0.25, 0.25, 0.5, 1.0][seed as usize / 5];
            let off_mps = told_at_mps(seed, gusts_mps, drift_mps2, 1.0).unwrap();
            let most_mps = 6.0 + 4.0 * gusts_mps;
            assert!((0.0..most_mps).contains(&(off_mps * drift_mps2.signum())), "seed {seed}: {off_mps} m/s");
            // Three deviations come by themselves now and then, and lift has to agree; five do not.
            assert_eq!(told_at_mps(seed, gusts_mps, 0.0, 1.6), None, "seed {seed}");
        }
    }

    #[test]
    fn nothing_is_away_before_the_wind_is_known() {
        let (mut watch, state) = (WindWatch::default(), level_state());
        let mut away = |frames: u32| (0..frames).map(|_| watch.step(&state, 40.0, 0.02)).last().unwrap();
        assert_eq!(away(900), 0.0);
        assert!(away(900) > 1.0);
        assert_eq!(watch.step(&state, f64::NAN, 0.02), 0.0);
        assert!(watch.is_known() && again(&watch) == Some(watch));
        assert_eq!(again(&WindWatch { square: -1.0, ..watch }), None);
        assert_eq!(again(&WindWatch { seen_s: 2.0 * GUSTS_S, ..watch }), None);
        (0..3_000).for_each(|_| watch.pause(0.02));
        assert!(!watch.is_known(), "a minute without satellites");
    }
}
