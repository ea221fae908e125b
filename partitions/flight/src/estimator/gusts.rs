//! What air data tell of the velocity while there are no satellites.
//!
//! The air passes at the airspeed, but it moves: by the mean wind, which the filter carries on, and by gusts. A gust lasts for
//! [`GUST_S`] and not for a sample, so a sample tells of the mean motion what a white noise of `σ √(2 T / Δt)` would leave, with the
//! gusts' deviation σ as it was while satellites told the velocity. Inertial values are better than that for a minute, unless one of
//! them is wrong: then velocity and air come apart by more than gusts do, and the air is believed.

use crate::attitude::low_pass;

/// Correlation time of a gust, s: some 260 m (MIL-F-8785C, low altitude) at 20 m/s.
const GUST_S: f64 = 13.0;
/// Time over which gusts are learnt, and over which velocity and air are compared, s.
const LEARN_S: f64 = 30.0;
const COMPARE_S: f64 = 3.0;
/// The innovation holds no more than two thirds of a gust: the filter's wind follows the rest.
const FOLLOWED: f64 = 1.5;
/// Further apart than so many deviations it is no gust; the least deviation for this, m/s.
const APART: f64 = 4.0;
const LEAST_MPS: f64 = 0.3;
/// No air is so rough, m/s; nor is a gust, m/s.
const MOST_MPS: f64 = 60.0;
const MOST_GUST_MPS: f64 = 15.0;

/// Along the airspeed and across it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    Along,
    Across,
}

/// Mean squares of the innovations of air data, m²/s².
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gusts {
    learnt: f64,
    apart: [f64; 2],
}

impl Gusts {
    /// Notes an innovation, m/s, that was taken while satellites told the velocity, of samples that come each `interval_s`.
    pub(super) fn learn(&mut self, innovation: f64, interval_s: f64) {
        self.learnt = low_pass(self.learnt, square(innovation), LEARN_S, interval_s);
    }

    /// Notes one, taken or not; without satellites it tells whether velocity and air come apart.
    pub(super) fn compare(&mut self, part: Part, innovation: f64, interval_s: f64, inertial: bool) {
        let apart = &mut self.apart[part as usize];
        *apart = if inertial { low_pass(*apart, square(innovation), COMPARE_S, interval_s) } else { 0.0 };
    }

    /// Takes what was learnt for `learnt`, m²/s²: since then a pitot was wrong.
    pub(super) fn go_back(&mut self, learnt: f64) {
        *self = Self { learnt, ..Self::default() };
    }

    /// Mean square of the gusts' part that was learnt, m²/s².
    pub(super) fn learnt(&self) -> f64 {
        self.learnt
    }

    /// Noise of such a sample beside inertial values, m/s, no less than `least_mps`.
    pub(super) fn noise_mps(&self, least_mps: f64, interval_s: f64) -> f64 {
        let gust = self.learnt.sqrt();
        let limit = APART * gust.max(LEAST_MPS);
        if self.apart.iter().any(|apart| *apart > limit * limit) {
            return least_mps;
        }
        (FOLLOWED * gust * (2.0 * GUST_S / interval_s).sqrt()).clamp(least_mps, MOST_MPS)
    }
}

fn square(innovation: f64) -> f64 {
    innovation.clamp(-MOST_GUST_MPS, MOST_GUST_MPS).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after_gusts_of(gust_mps: f64) -> Gusts {
        let mut gusts = Gusts::default();
        (0..1200).for_each(|_| gusts.learn(gust_mps, 0.1));
        gusts
    }

    #[test]
    fn air_is_believed_less_in_gusts_and_more_where_inertial_values_come_away_from_it() {
        assert!((after_gusts_of(0.0).noise_mps(6.0, 0.1) - 6.0).abs() < 1e-9);
        for part in [Part::Along, Part::Across] {
            let mut gusts = after_gusts_of(1.5);
            let noise = gusts.noise_mps(6.0, 0.1);
            assert!((30.0..45.0).contains(&noise), "{noise}");
            (0..100).for_each(|_| gusts.compare(part, 4.0, 0.1, true));
            assert!((gusts.noise_mps(6.0, 0.1) - noise).abs() < 1e-9, "a gust of 4 m/s");
            (0..100).for_each(|_| gusts.compare(part, -9.0, 0.1, true));
            assert!((gusts.noise_mps(6.0, 0.1) - 6.0).abs() < 1e-9, "9 m/s are no gust");
            gusts.compare(part, 0.0, 0.1, false);
            assert!(gusts.noise_mps(6.0, 0.1) > 20.0, "satellites are back");
        }
    }
}
