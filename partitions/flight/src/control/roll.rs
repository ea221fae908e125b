//! The roll rate by the ailerons, where no gyroscope tells it: a first-order lag behind `p = −2 V C_lδ δa / (b C_lp)`.

use super::inner::{Signals, roll_damping_per_s};
use crate::airframe::Airframe;
use crate::attitude::low_pass;
use crate::kept::kept;

/// Share of the bank loop's gain that is left: the bank is known half a second late.
pub const BANK_SHARE: f64 = 0.4;
/// Greatest bank, rad.
pub const BANK_RAD: f64 = 0.6;

/// See the module's head.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RollModel {
    rate_radps: f64,
}

impl RollModel {
    /// Takes a frame with the ailerons (rad) that were flown; gives the roll rate, rad/s.
    pub fn step(&mut self, airframe: &Airframe, s: &Signals, aileron_rad: f64, dt_s: f64) -> f64 {
        let steady =
            airframe.roll_per_airspeed() * s.airspeed_mps * aileron_rad / airframe.servo.aileron_limit_rad;
        let lag_s = 1.0 / roll_damping_per_s(airframe, s).max(1.0) + airframe.servo.delay_s;
        self.rate_radps = low_pass(self.rate_radps, steady, lag_s, dt_s);
        self.rate_radps
    }
}

kept!(RollModel { rate_radps: f64 });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::tests::aerosonde;

    #[test]
    fn rate_follows_the_ailerons_and_goes_with_the_airspeed() {
        let airframe = aerosonde();
        let rate = |airspeed_mps: f64, aileron_rad: f64, frames: u32| {
            let s = Signals { airspeed_mps, density_kgpm3: 1.2, ..Signals::default() };
            let mut model = RollModel::default();
            (0..frames).map(|_| model.step(&airframe, &s, aileron_rad, 0.02)).last().unwrap()
        };
        let steady = airframe.roll_per_airspeed() * 22.0 * 0.1 / airframe.servo.aileron_limit_rad;
        assert!((rate(22.0, 0.1, 100) / steady - 1.0).abs() < 1e-3);
        assert!((rate(11.0, 0.1, 200) / steady - 0.5).abs() < 1e-3);
        assert!(rate(22.0, -0.1, 2) < 0.0 && rate(22.0, -0.1, 2) > -0.8 * steady);
    }
}
