//! The stall: the elevator is not pulled beyond what the wing's greatest lift needs, and what the wing gave at most is learnt where it gave less
//! than its file says.
//!
//! An aircraft that is stable in pitch comes out of a stall by itself, unless its elevator holds it there. The elevator of a steady pull has
//! `C_L(δe, q̂) = C_L0 + C_Lα α + C_Lδ δe + C_Lq q̂` with `α = −(C_m0 + C_mδ δe + C_mq q̂) / C_mα`. It must never take a gust for a stall: the
//! elevator is at its limit, and the lift lacks, for longer than gusts last.

use super::inner::{Signals, turn_pitch_rate};
use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use crate::attitude::low_pass;
use crate::kept::kept;

/// Less than this share of the lift that is asked for, at the elevator's limit, for so long, s, is a stall.
const LACKING_SHARE: f64 = 0.8;
const LACKING_S: f64 = 0.4;
/// Smoothing of the lift coefficient, s; and how long what was reached is remembered, s.
const LIFT_LAG_S: f64 = 0.2;
const REACHED_S: f64 = 2.0;
/// Share of what was reached that is counted on from then on; of the file's, no less than the second one.
const SURE_SHARE: f64 = 0.95;
const LEAST_SHARE: f64 = 0.5;
/// The nose stays down for so long, s, with lift of this share of the greatest one at most.
const RECOVERY_S: f64 = 1.0;
const RECOVERY_SHARE: f64 = 0.6;

/// See the module's head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StallGuard {
    /// Greatest lift coefficient, of that of the airframe file.
    share: f64,
    lacking_s: f64,
    /// Lift coefficient, smoothed, and the greatest of the last seconds.
    coefficient: f64,
    reached: f64,
    /// How long the nose is to stay down yet, s.
    recovers_s: f64,
}

impl Default for StallGuard {
    fn default() -> Self {
        Self { share: 1.0, lacking_s: 0.0, coefficient: 0.0, reached: 0.0, recovers_s: 0.0 }
    }
}

impl StallGuard {
    /// Greatest lift coefficient that is counted on, of that of the airframe file.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// The wing has stalled, and the nose goes down.
    pub fn is_stalled(&self) -> bool {
        self.recovers_s > 0.0
    }

    /// The elevator that pulls most, rad. `greatest_lift`: of the airframe file. `factor`: how many times the lift that is there the elevator
    /// tells.
    pub fn least_elevator_rad(
        &self,
        airframe: &Airframe,
        greatest_lift: f64,
        factor: f64,
        s: &Signals,
    ) -> f64 {
        let a = &airframe.aerodynamics;
        let reduced = airframe.geometry.mean_chord_m / (2.0 * s.airspeed_mps.max(1.0));
        let rate = s.pitch_rate_radps.max(turn_pitch_rate(s)) * reduced;
        let per_moment = -a.lift_alpha / a.pitch_alpha;
        let at_rest =
            a.lift_0 + a.lift_pitch_rate * rate + per_moment * (a.pitch_0 + a.pitch_pitch_rate * rate);
        let slope = a.lift_elevator + per_moment * a.pitch_elevator;
        let share = if self.is_stalled() { RECOVERY_SHARE * self.share } else { 1.0 };
        let most = share * factor.max(1.0) * greatest_lift;
        let limit = airframe.servo.elevator_limit_rad;
        let elevator_rad = (most - at_rest) / slope;
        if slope < 0.0 && elevator_rad.is_finite() { elevator_rad.clamp(-limit, limit) } else { -limit }
    }

    /// Takes a frame in which nothing is judged.
    pub fn wait(&mut self, dt_s: f64) {
        self.recovers_s = (self.recovers_s - dt_s).max(0.0);
        self.lacking_s = (self.lacking_s - dt_s).max(0.0);
    }

    /// Takes a frame of flight: what is asked for, whether the elevator is at its limit, and whether the airspeed is sure. True: the wing has
    /// stalled in it, and what it gave is known.
    pub fn step(
        &mut self,
        airframe: &Airframe,
        greatest_lift: f64,
        s: &Signals,
        (wanted_mps2, at_limit, is_sure): (f64, bool, bool),
        dt_s: f64,
    ) -> bool {
        let force = 0.5 * s.density_kgpm3 * s.airspeed_mps * s.airspeed_mps * airframe.geometry.wing_area_m2;
        let coefficient = -airframe.mass.mass_kg * s.normal_mps2 / force.max(1e-3);
        self.coefficient = low_pass(self.coefficient, coefficient, LIFT_LAG_S, dt_s);
        self.reached = self.coefficient.max(low_pass(self.reached, self.coefficient, REACHED_S, dt_s));
        let lacks = s.normal_mps2 > LACKING_SHARE * wanted_mps2.min(-0.5 * GRAVITY_MPS2);
        let lacking_s = self.lacking_s;
        self.wait(dt_s);
        if at_limit && lacks && !self.is_stalled() {
            self.lacking_s = lacking_s + dt_s;
        }
        let stalls = self.lacking_s > LACKING_S;
        if stalls {
            (self.lacking_s, self.recovers_s) = (0.0, RECOVERY_S);
            if is_sure {
                let reached = SURE_SHARE * self.reached / greatest_lift;
                self.share = reached.clamp(LEAST_SHARE, self.share);
            }
        }
        stalls && is_sure
    }
}

kept!(StallGuard { share: f64, lacking_s: f64, coefficient: f64, reached: f64, recovers_s: f64 }
    if |guard| (LEAST_SHARE..=1.0).contains(&guard.share));

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::built_in;
    use crate::kept::tests::again;

    fn vtail() -> Airframe {
        Airframe::from_toml(built_in("vtail60").unwrap()).unwrap()
    }

    fn signals(airspeed_mps: f64, load: f64) -> Signals {
        let normal_mps2 = -load * GRAVITY_MPS2;
        Signals { airspeed_mps, density_kgpm3: 1.225, normal_mps2, ..Signals::default() }
    }

    #[test]
    fn elevator_of_the_slowest_level_flight_is_granted_and_its_stop_is_not() {
        let airframe = vtail();
        let (lift, guard) = (airframe.greatest_lift(), StallGuard::default());
        let least = guard.least_elevator_rad(&airframe, lift, 1.0, &signals(18.5, 1.0));
        let trim = airframe.trim(18.5, 1.225).elevator_rad;
        assert!(least < trim && least > -airframe.servo.elevator_limit_rad, "{least} {trim}");
        // Where the elevator has less effect than the file says, more of it is granted.
        assert!(guard.least_elevator_rad(&airframe, lift, 1.4, &signals(18.5, 1.0)) < least);
        // A pull needs more than level flight does.
        let pulling = Signals { pitch_rate_radps: 0.5, ..signals(18.5, 1.0) };
        assert!(guard.least_elevator_rad(&airframe, lift, 1.0, &pulling) < least);
    }

    #[test]
    fn wing_that_gives_less_than_asked_for_at_the_limit_has_stalled_and_its_lift_is_remembered() {
        let airframe = vtail();
        let lift = airframe.greatest_lift();
        let mut guard = StallGuard::default();
        let fly = |guard: &mut StallGuard, load: f64, at_limit: bool, seconds: f64| {
            (0..(seconds / 0.02) as u32)
                .map(|_| {
                    guard.step(
                        &airframe,
                        lift,
                        &signals(22.0, load),
                        (-1.3 * GRAVITY_MPS2, at_limit, true),
                        0.02,
                    )
                })
                .filter(|stalls| *stalls)
                .count()
        };
        // 22 m/s hold 1.5 times the weight by the file.
        assert_eq!(fly(&mut guard, 1.1, false, 3.0), 0);
        assert_eq!(fly(&mut guard, 0.7, false, 1.0), 0, "a gust from above: the elevator pulls on");
        assert_eq!(fly(&mut guard, 1.1, false, 3.0), 0);
        assert_eq!(fly(&mut guard, 0.7, true, 0.3), 0, "too short");
        assert_eq!(fly(&mut guard, 0.7, true, 0.3), 1);
        assert!(guard.is_stalled() && (0.6..0.75).contains(&guard.share()), "{guard:?}");
        let down = guard.least_elevator_rad(&airframe, lift, 1.0, &signals(22.0, 0.7));
        assert_eq!(fly(&mut guard, 1.1, false, 1.2), 0);
        assert!(!guard.is_stalled());
        assert!(guard.least_elevator_rad(&airframe, lift, 1.0, &signals(22.0, 0.7)) < down);
        assert_eq!(again(&guard), Some(guard));
        assert_eq!(again(&StallGuard { share: 0.1, ..guard }), None);
    }
}
