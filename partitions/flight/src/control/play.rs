//! Play in the elevator's linkage: the command leads by the gap, so that the surface moves when the law does.
//!
//! The surface lies at one side of the gap and stays there until the servo has crossed it. In the height loop, which integrates
//! three times, that makes a limit cycle. The inverse adds half the gap to the side the law moves to.

use super::outer::slew;
use crate::kept::kept;

/// Share of the file's gap that is made up for: too much would cycle by itself.
const SHARE: f64 = 0.8;
/// The law must turn back by this much before the command changes sides, rad: noise does not.
const REVERSAL_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;
/// Fastest change of sides, rad/s.
const CROSSING_RADPS: f64 = 0.5;

/// Where the linkage stands in its gap. Begins in the middle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct PlayInverse {
    furthest_rad: f64,
    side: f64,
    lead_rad: f64,
}

impl PlayInverse {
    /// The command (rad) that puts the surface at `wanted_rad` through a gap of `play_rad` full width.
    pub(crate) fn step(&mut self, wanted_rad: f64, play_rad: f64, dt_s: f64) -> f64 {
        if !play_rad.is_finite() || play_rad <= 0.0 {
            return wanted_rad;
        }
        let moved = wanted_rad - self.furthest_rad;
        if moved * self.side > 0.0 {
            self.furthest_rad = wanted_rad;
        } else if moved.abs() > REVERSAL_RAD {
            (self.side, self.furthest_rad) = (moved.signum(), wanted_rad);
        }
        self.lead_rad = slew(self.lead_rad, 0.5 * SHARE * play_rad * self.side, CROSSING_RADPS, dt_s);
        wanted_rad + self.lead_rad
    }
}

kept!(PlayInverse { furthest_rad: f64, side: f64, lead_rad: f64 }
    if |play| [-1.0, 0.0, 1.0].contains(&play.side));

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kept::tests::again;

    #[test]
    fn without_play_the_command_is_the_laws_to_the_bit() {
        let mut inverse = PlayInverse::default();
        for k in 0..1000 {
            let wanted = (f64::from(k) * 0.1).sin();
            assert_eq!(inverse.step(wanted, 0.0, 0.02).to_bits(), wanted.to_bits());
        }
    }

    #[test]
    fn side_of_the_gap_outlives_a_restart_and_nonsense_does_not() {
        let mut inverse = PlayInverse::default();
        for k in 0..200 {
            assert_eq!(again(&inverse), Some(inverse));
            inverse.step(0.03 * (f64::from(k) * 0.1).sin(), 0.05, 0.02);
        }
        for (furthest_rad, side) in [(f64::NAN, 1.0), (0.0, 0.5), (0.0, -2.0)] {
            assert_eq!(again(&PlayInverse { furthest_rad, side, lead_rad: 0.0 }), None);
        }
    }

    #[test]
    fn a_surface_behind_the_gap_follows_a_slow_law_closer_than_without() {
        let (play, mut inverse) = (0.05, PlayInverse::default());
        let (mut with, mut without, mut errors) = (0.0f64, 0.0f64, [0.0f64; 2]);
        for k in 0..5000 {
            let wanted = 0.03 * (f64::from(k) * 0.02).sin();
            let servo = inverse.step(wanted, play, 0.02);
            with = with.clamp(servo - 0.5 * play, servo + 0.5 * play);
            without = without.clamp(wanted - 0.5 * play, wanted + 0.5 * play);
            errors[0] += (with - wanted).powi(2);
            errors[1] += (without - wanted).powi(2);
        }
        assert!(errors[0] < 0.2 * errors[1], "{errors:?}");
    }
}
