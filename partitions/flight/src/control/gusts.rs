//! How gusty the air is: what the airspeed does that the aircraft's own acceleration does not tell.
//!
//! Responsible for one number. It must never count a change of speed that the aircraft makes by itself.

use crate::attitude::low_pass;
use crate::kept::kept;

/// Changes of wind slower than this are none, s; and memory of their size, s.
const SLOW_S: f64 = 5.0;
const MEMORY_S: f64 = 20.0;
/// What noise of the pitot and errors of the accelerometer leave, m/s.
const NOISE_MPS: f64 = 0.3;

/// See the module's head.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GustWatch {
    /// Airspeed without gusts, m/s; 0: not known.
    smooth_mps: f64,
    /// Mean of what is beyond it, m/s: an error of the accelerometer is no gust; and mean square about that, m²/s².
    mean_mps: f64,
    square: f64,
}

impl GustWatch {
    /// Standard deviation of the gusts along the way, m/s.
    pub fn deviation_mps(&self) -> f64 {
        (self.square - NOISE_MPS * NOISE_MPS).max(0.0).sqrt()
    }

    /// How far the pitot has moved away from the airspeed that the inertial values tell of the last seconds, m/s.
    pub fn apart_mps(&self, pitot_mps: f64) -> f64 {
        if self.smooth_mps > 0.0 { pitot_mps - self.smooth_mps - self.mean_mps } else { 0.0 }
    }

    /// Takes a frame: of the pitot, m/s, and the change of airspeed in steady air, m/s².
    pub fn step(&mut self, pitot_mps: f64, change_mps2: f64, dt_s: f64) {
        if !(pitot_mps.is_finite() && change_mps2.is_finite()) {
            return;
        }
        if self.smooth_mps <= 0.0 {
            self.smooth_mps = pitot_mps;
        }
        let gust_mps = pitot_mps - self.smooth_mps;
        self.smooth_mps += (change_mps2 + gust_mps / SLOW_S) * dt_s;
        self.mean_mps = low_pass(self.mean_mps, gust_mps, MEMORY_S, dt_s);
        let off_mps = gust_mps - self.mean_mps;
        self.square = low_pass(self.square, off_mps * off_mps, MEMORY_S, dt_s);
    }

    /// There is no airspeed to be judged by: what it was last may have been a fault, and is forgotten.
    pub fn pause(&mut self, dt_s: f64) {
        (self.smooth_mps, self.mean_mps) = (0.0, 0.0);
        self.square = low_pass(self.square, 0.0, MEMORY_S, dt_s);
    }
}

kept!(GustWatch { smooth_mps: f64, mean_mps: f64, square: f64 });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kept::tests::again;

    #[test]
    fn gusts_are_counted_and_a_change_of_speed_is_not() {
        let mut watch = GustWatch::default();
        let mut airspeed_mps = 20.0;
        for frame in 0..3_000 {
            let change_mps2 = if frame % 1_000 < 500 { 1.0 } else { -1.0 };
            airspeed_mps += 0.02 * change_mps2;
            watch.step(airspeed_mps, change_mps2, 0.02);
        }
        assert!(watch.deviation_mps() < 0.1, "{watch:?}");
        for frame in 0..3_000 {
            let gust_mps = 2.0 * (f64::from(frame) * 0.02 * 3.0).sin();
            watch.step(airspeed_mps + gust_mps, 0.0, 0.02);
        }
        assert!((1.2..1.6).contains(&watch.deviation_mps()), "{watch:?}");
        assert_eq!(again(&watch), Some(watch));
        assert_eq!(again(&GustWatch { smooth_mps: f64::NAN, ..watch }), None);
    }

    #[test]
    fn error_of_the_accelerometer_is_no_gust_and_a_fault_of_the_pitot_is_forgotten() {
        let mut watch = GustWatch::default();
        (0..6_000).for_each(|_| watch.step(20.0, 0.4, 0.02));
        assert!(watch.deviation_mps() < 0.2, "{watch:?}");
        (0..100).for_each(|_| watch.step(0.0, 0.0, 0.02));
        assert!(watch.deviation_mps() > 2.0);
        (0..8_000).for_each(|_| watch.pause(0.02));
        assert!(watch.deviation_mps() < 0.5, "{watch:?}");
    }
}
