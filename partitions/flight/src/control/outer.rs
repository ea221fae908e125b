//! The outer loops: altitude, airspeed and bank, the same for every aircraft.
//!
//! Outside of the inner loops the aircraft is a point mass whose specific acceleration can be chosen:
//! `V̇ = A − g sin γ`, and the part of C turned sideways by bank bends the track.

use crate::GRAVITY_MPS2;

/// Gains and limits of the outer loops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OuterTuning {
    /// Climb rate per altitude error, 1/s.
    pub altitude_gain: f64,
    /// Fastest descent asked for, m/s.
    pub descent_mps: f64,
    /// Fastest descent to get airspeed back, m/s.
    pub floor_descent_mps: f64,
    /// Fastest climb asked for, m/s.
    pub climb_mps: f64,
    /// Vertical acceleration per climb-rate error, 1/s.
    pub climb_gain: f64,
    /// Acceleration per airspeed error, 1/s.
    pub airspeed_gain: f64,
    /// Slow correction per airspeed error, 1/s², for what the accelerometer cannot tell.
    pub airspeed_integral: f64,
    /// Roll rate per bank error, 1/s.
    pub bank_gain: f64,
    /// Greatest roll rate asked for, rad/s.
    pub roll_rate_radps: f64,
    /// Greatest bank, rad.
    pub bank_limit_rad: f64,
}

impl Default for OuterTuning {
    fn default() -> Self {
        Self {
            altitude_gain: 0.4,
            descent_mps: 3.0,
            floor_descent_mps: 6.0,
            climb_mps: 4.0,
            climb_gain: 1.2,
            airspeed_gain: 0.7,
            airspeed_integral: 0.0,
            bank_gain: 2.2,
            roll_rate_radps: 1.6,
            bank_limit_rad: 60f64.to_radians(),
        }
    }
}

/// Least share of the reference airspeed at which a climb is still asked for in full, m/s below the reference.
const CLIMB_SPEED_MARGIN_MPS: f64 = 2.0;
/// Descent for each m/s below the least airspeed, 1.
const FLOOR_GAIN: f64 = 2.0;
/// Vertical acceleration per climb-rate error there, 1/s.
const FLOOR_CLIMB_GAIN: f64 = 2.0;
/// A climb is given up altogether this far below the reference airspeed, m/s.
const NO_CLIMB_MARGIN_MPS: f64 = 5.0;

impl OuterTuning {
    /// Vertical acceleration up (m/s²) from altitude error (m) and climb rate (m/s). `lack_mps` is how much the
    /// airspeed lies below its reference: a climb must not eat the speed that carries it.
    pub fn altitude(&self, error_m: f64, climb_mps: f64, lack_mps: f64) -> f64 {
        let span = NO_CLIMB_MARGIN_MPS - CLIMB_SPEED_MARGIN_MPS;
        let share = ((NO_CLIMB_MARGIN_MPS - lack_mps) / span).clamp(0.0, 1.0);
        let wanted = (self.altitude_gain * error_m).clamp(-self.descent_mps, self.climb_mps * share);
        self.climb_rate(wanted, climb_mps)
    }

    /// Vertical acceleration up (m/s²) that brings the climb rate to a wanted one (m/s).
    pub fn climb_rate(&self, wanted_mps: f64, climb_mps: f64) -> f64 {
        (self.climb_gain * (wanted_mps - climb_mps)).clamp(-4.0, 5.0)
    }

    /// Vertical acceleration up (m/s²) at most, `lack_mps` below the least airspeed: the nose goes down for it.
    pub fn floor(&self, lack_mps: f64, climb_mps: f64) -> f64 {
        // Not as gently as a climb rate is kept otherwise: a steep climb without thrust costs 5 m/s in a second.
        FLOOR_CLIMB_GAIN * ((-FLOOR_GAIN * lack_mps).max(-self.floor_descent_mps) - climb_mps)
    }

    /// A_ref (m/s²) from airspeed error (m/s) and climb angle (rad): the weight's share is fed forward.
    pub fn airspeed(&self, error_mps: f64, climb_rad: f64) -> f64 {
        (self.airspeed_gain * error_mps).clamp(-2.0, 3.0) + GRAVITY_MPS2 * climb_rad.sin()
    }

    /// P_ref (rad/s) from bank wanted and bank, rad.
    pub fn bank(&self, wanted_rad: f64, bank_rad: f64) -> f64 {
        (self.bank_gain * (wanted_rad - bank_rad)).clamp(-self.roll_rate_radps, self.roll_rate_radps)
    }

    /// Bank (rad) that gives a horizontal acceleration to the right at a vertical one (up), m/s².
    pub fn bank_for(&self, horizontal_mps2: f64, vertical_mps2: f64, climb_rad: f64) -> f64 {
        let lift = (GRAVITY_MPS2 * climb_rad.cos() + vertical_mps2).max(1.0);
        horizontal_mps2.atan2(lift)
    }
}

/// C_ref (m/s², negative) that carries a vertical acceleration up at the bank the aircraft has. With the bank it has rather than
/// the one it should have, altitude does not suffer while it rolls.
pub fn normal_for(vertical_mps2: f64, bank_rad: f64, climb_rad: f64) -> f64 {
    let lift = GRAVITY_MPS2 * climb_rad.cos() + vertical_mps2;
    -lift / bank_rad.cos().max(0.4)
}

/// Moves a reference towards its target at no more than `rate` per second.
pub fn slew(value: f64, target: f64, rate: f64, dt_s: f64) -> f64 {
    value + (target - value).clamp(-rate * dt_s, rate * dt_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: fn() -> OuterTuning = OuterTuning::default;

    #[test]
    fn altitude_error_becomes_a_limited_climb() {
        assert_eq!(T().altitude(1000.0, 4.0, 0.0), 0.0);
        assert_eq!(T().altitude(-1000.0, -3.0, 0.0), 0.0);
        assert!(T().altitude(1.0, 0.0, 0.0) > 0.0);
        assert_eq!(T().altitude(1000.0, 0.0, 6.0), 0.0, "no climb without speed");
    }

    #[test]
    fn bank_and_normal_acceleration_carry_the_weight_in_a_turn() {
        let bank = T().bank_for(GRAVITY_MPS2, 0.0, 0.0);
        assert!((bank - 45f64.to_radians()).abs() < 1e-12);
        assert!((normal_for(0.0, bank, 0.0) + 2f64.sqrt() * GRAVITY_MPS2).abs() < 1e-9);
    }

    #[test]
    fn airspeed_loop_feeds_the_climb_forward() {
        assert!((T().airspeed(0.0, 0.1) - GRAVITY_MPS2 * 0.1f64.sin()).abs() < 1e-12);
        assert_eq!(T().airspeed(100.0, 0.0), 3.0);
    }

    #[test]
    fn bank_loop_rolls_the_short_way_and_no_faster_than_allowed() {
        assert_eq!(T().bank(2.0, -1.0), 1.6);
        assert!(T().bank(0.1, 0.2) < 0.0);
    }
}
