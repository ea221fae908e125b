//! Whether the propeller drives the aircraft, and how it glides where it does not.
//!
//! The axial specific force tells the thrust, `T = m A + D`: the drag is the airframe's at the lift that the normal specific force tells.
//! What the throttle stands for is beside it. Responsible for the verdict alone: a throttle that is nearly closed says nothing.

use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use crate::attitude::low_pass;
use crate::kept::kept;

/// Averaging of what is compared, s; of the deceleration that a glide is flown with, and planned with, s.
const AVERAGE_S: f64 = 2.0;
const RECENT_S: f64 = 1.0;
const GLIDE_S: f64 = 5.0;
/// Thrust over mass that the throttle must stand for before anything is said, m/s².
const LEAST_MPS2: f64 = 0.5;
/// Less than this share of it, and so much less, m/s², for so long, s, is none; more than that share for so long, s, is some again.
const LEAST_LACK_MPS2: f64 = 1.0;
const LOST_SHARE: f64 = 0.25;
const LOST_S: f64 = 3.0;
const BACK_SHARE: f64 = 0.6;
const BACK_S: f64 = 3.0;
/// The same for an aircraft that is to sink: that it loses height says nothing then, and gusts near the ground are taken for drag.
const SINKING_LACK_MPS2: f64 = 2.0;
const SINKING_LOST_S: f64 = 4.0;
/// Averaging of how rough the air is, s, and what counts of a frame, m/s², at most.
const ROUGH_S: f64 = 10.0;
const ROUGHEST_MPS2: f64 = 5.0;
/// An aircraft that has not sunk for so long, s, has power, whatever the forces say: its drag is not that of its file.
const KEPT_UP_S: f64 = 12.0;
/// Averaging of height and airspeed, s; and how fast they are used up, of what a glide does, where there is no power.
const ENERGY_S: f64 = 3.0;
const SINK_SHARE: f64 = 0.4;
/// Change of airspeed per airspeed error in a glide, 1/s, and at most, m/s².
const AIRSPEED_GAIN: f64 = 0.4;
const AIRSPEED_MPS2: f64 = 1.5;

/// What a frame brings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Ordered, 0 to 1.
    pub throttle: f64,
    /// m/s.
    pub airspeed_mps: f64,
    /// m.
    pub altitude_m: f64,
    /// kg/m³.
    pub density_kgpm3: f64,
    /// Axial specific acceleration, m/s².
    pub axial_mps2: f64,
    /// Normal specific acceleration, m/s²; −9.8 in level flight.
    pub normal_mps2: f64,
    /// Wings carry the weight, and no wheel touches anything.
    pub flying: bool,
    /// It is to lose height: on the approach of a landing.
    pub may_sink: bool,
    /// s.
    pub dt_s: f64,
}

/// The judge of the motor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PowerWatch {
    /// Thrust over mass that the throttle stands for, behind it as the motor is, and its average, m/s².
    lagged_mps2: f64,
    expected_mps2: f64,
    /// Average of that which the forces tell, and how far they are from it, m/s².
    felt_mps2: f64,
    rough_mps2: f64,
    /// Axial specific acceleration, averaged for a second and for longer, m/s².
    axial_mps2: f64,
    glide_mps2: f64,
    /// Height and what the airspeed is worth of it, averaged, m.
    energy_m: Option<f64>,
    against_s: f64,
    for_s: f64,
    kept_up_s: f64,
    lost: bool,
}

impl PowerWatch {
    /// The propeller drives nothing.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Takes a frame.
    pub fn step(&mut self, airframe: &Airframe, frame: &Frame) {
        let judged = frame.flying && frame.axial_mps2.is_finite() && frame.normal_mps2.is_finite();
        if !judged {
            (self.against_s, self.for_s, self.kept_up_s, self.energy_m) = (0.0, 0.0, 0.0, None);
            return;
        }
        let (mass_kg, dt_s) = (airframe.mass.mass_kg, frame.dt_s);
        let thrust_n = airframe.thrust_n(frame.throttle, frame.airspeed_mps, frame.density_kgpm3);
        self.lagged_mps2 = low_pass(self.lagged_mps2, thrust_n / mass_kg, airframe.thrust_lag_s(), dt_s);
        let drag_n = airframe.trimmed_drag_n(frame.airspeed_mps, frame.density_kgpm3, frame.normal_mps2);
        let felt_mps2 = frame.axial_mps2 + drag_n / mass_kg;
        self.expected_mps2 = low_pass(self.expected_mps2, self.lagged_mps2, AVERAGE_S, dt_s);
        self.felt_mps2 = low_pass(self.felt_mps2, felt_mps2, AVERAGE_S, dt_s);
        let off_mps2 = (felt_mps2 - self.felt_mps2).abs().min(ROUGHEST_MPS2);
        self.rough_mps2 = low_pass(self.rough_mps2, off_mps2, ROUGH_S, dt_s);
        self.axial_mps2 = low_pass(self.axial_mps2, frame.axial_mps2, RECENT_S, dt_s);
        self.glide_mps2 = low_pass(self.glide_mps2, frame.axial_mps2, GLIDE_S, dt_s);
        // In gusts lift seems drag; an aircraft that keeps height and airspeed is driven by something.
        let energy_m = frame.altitude_m + frame.airspeed_mps * frame.airspeed_mps / (2.0 * GRAVITY_MPS2);
        let average_m = low_pass(self.energy_m.unwrap_or(energy_m), energy_m, ENERGY_S, dt_s);
        self.energy_m = Some(average_m);
        let glide_mps = frame.airspeed_mps * drag_n / (mass_kg * GRAVITY_MPS2);
        let sinks = (average_m - energy_m) / ENERGY_S > SINK_SHARE * glide_mps;
        let says = self.expected_mps2 > LEAST_MPS2;
        let (lack_mps2, lost_s) = match frame.may_sink {
            true => (SINKING_LACK_MPS2, SINKING_LOST_S),
            false => (LEAST_LACK_MPS2, LOST_S),
        };
        let lacks = self.expected_mps2 - self.felt_mps2 > lack_mps2 + self.rough_mps2;
        let none = says && sinks && lacks && self.felt_mps2 < LOST_SHARE * self.expected_mps2;
        let some = says && self.felt_mps2 > BACK_SHARE * self.expected_mps2;
        self.against_s = if none { self.against_s + dt_s } else { 0.0 };
        self.for_s = if some { self.for_s + dt_s } else { 0.0 };
        self.kept_up_s = if sinks { 0.0 } else { self.kept_up_s + dt_s };
        if self.against_s > lost_s {
            // The longer average has seen the motor yet.
            self.glide_mps2 = if self.lost { self.glide_mps2 } else { self.axial_mps2 };
            self.lost = true;
        } else if self.for_s > BACK_S || self.kept_up_s > KEPT_UP_S {
            self.lost = false;
        }
    }

    /// Climb rate (m/s, below zero) that brings a glide to an airspeed (m/s) from the one that it has.
    pub fn climb_mps(&self, wanted_mps: f64, airspeed_mps: f64) -> f64 {
        let faster = (AIRSPEED_GAIN * (wanted_mps - airspeed_mps)).clamp(-AIRSPEED_MPS2, AIRSPEED_MPS2);
        airspeed_mps * ((self.axial_mps2 - faster) / GRAVITY_MPS2).clamp(-0.5, 0.0)
    }

    /// What drag takes of the airspeed of a level glide, m/s²: no less than the airframe file says, and more where more was seen.
    pub fn slows_mps2(&self, airframe: &Airframe, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        let drag_n = airframe.drag_n(airspeed_mps, density_kgpm3, -GRAVITY_MPS2);
        let idle_n = airframe.thrust_n(0.0, airspeed_mps, density_kgpm3).min(0.0);
        ((drag_n - idle_n) / airframe.mass.mass_kg).max(-self.glide_mps2)
    }
}

kept!(PowerWatch {
    lagged_mps2: f64,
    expected_mps2: f64,
    felt_mps2: f64,
    rough_mps2: f64,
    axial_mps2: f64,
    glide_mps2: f64,
    energy_m: Option<f64>,
    against_s: f64,
    for_s: f64,
    kept_up_s: f64,
    lost: bool,
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::tests::aerosonde;
    use crate::kept::tests::again;

    /// Flight at 22 m/s for so long, with so much of the thrust of its throttle.
    fn fly(watch: (&mut PowerWatch, &mut f64), throttle: f64, share: f64, seconds: f64) {
        fly_with(watch, throttle, share, 0.0, seconds);
    }

    /// The same with drag beyond that of the airframe file, m/s².
    fn fly_with(
        (watch, altitude_m): (&mut PowerWatch, &mut f64),
        throttle: f64,
        share: f64,
        more_mps2: f64,
        seconds: f64,
    ) {
        let airframe = aerosonde();
        let (airspeed_mps, density_kgpm3) = (22.0, 1.2);
        let drag_n = airframe.drag_n(airspeed_mps, density_kgpm3, -GRAVITY_MPS2);
        let thrust_n = share * airframe.thrust_n(throttle, airspeed_mps, density_kgpm3);
        let axial_mps2 = (thrust_n - drag_n) / airframe.mass.mass_kg - more_mps2;
        let frame = Frame {
            throttle,
            airspeed_mps,
            altitude_m: *altitude_m,
            density_kgpm3,
            axial_mps2,
            normal_mps2: -GRAVITY_MPS2,
            flying: true,
            may_sink: false,
            dt_s: 0.02,
        };
        for _ in 0..(seconds / frame.dt_s) as u32 {
            *altitude_m += frame.dt_s * axial_mps2.min(0.0) / GRAVITY_MPS2 * airspeed_mps;
            watch.step(&airframe, &Frame { altitude_m: *altitude_m, ..frame });
        }
    }

    #[test]
    fn motor_that_gives_nothing_is_told_and_one_that_gives_less_is_not() {
        for (share, lost) in [(1.0, false), (0.6, false), (0.1, true), (0.0, true), (-0.2, true)] {
            let (mut watch, mut altitude_m) = (PowerWatch::default(), 100.0);
            fly((&mut watch, &mut altitude_m), 0.8, 1.0, 10.0);
            assert!(!watch.is_lost());
            fly((&mut watch, &mut altitude_m), 0.8, share, 8.0);
            assert_eq!(watch.is_lost(), lost, "{share}");
            fly((&mut watch, &mut altitude_m), 0.8, 1.0, 8.0);
            assert!(!watch.is_lost(), "it is back");
        }
    }

    #[test]
    fn aircraft_that_keeps_its_height_has_power_though_it_drags_more_than_its_file_says() {
        let (mut watch, mut altitude_m) = (PowerWatch::default(), 100.0);
        fly_with((&mut watch, &mut altitude_m), 0.8, 0.9, 6.0, 10.0);
        assert!(watch.is_lost(), "it sinks, as if nothing drove it");
        let airframe = aerosonde();
        let frame = Frame {
            throttle: 0.8,
            airspeed_mps: 22.0,
            altitude_m,
            density_kgpm3: 1.2,
            axial_mps2: -airframe.drag_n(22.0, 1.2, -GRAVITY_MPS2) / airframe.mass.mass_kg,
            normal_mps2: -GRAVITY_MPS2,
            flying: true,
            may_sink: false,
            dt_s: 0.02,
        };
        (0..2000).for_each(|_| watch.step(&airframe, &frame));
        assert!(!watch.is_lost());
    }

    #[test]
    fn closed_throttle_says_nothing_of_the_motor() {
        let (mut watch, mut altitude_m) = (PowerWatch::default(), 100.0);
        fly((&mut watch, &mut altitude_m), 0.8, 1.0, 10.0);
        fly_with((&mut watch, &mut altitude_m), 0.0, 1.0, 2.5, 60.0);
        assert!(!watch.is_lost());
    }

    #[test]
    fn restart_knows_that_there_is_no_power_and_nonsense_is_forgotten() {
        let (mut watch, mut altitude_m) = (PowerWatch::default(), 100.0);
        fly((&mut watch, &mut altitude_m), 0.8, 0.0, 10.0);
        assert!(watch.is_lost());
        assert_eq!(again(&watch), Some(watch));
        assert_eq!(again(&PowerWatch { axial_mps2: f64::NAN, ..watch }), None);
    }

    #[test]
    fn glide_gives_height_for_airspeed() {
        let (mut watch, mut altitude_m) = (PowerWatch::default(), 100.0);
        fly((&mut watch, &mut altitude_m), 0.0, 0.0, 60.0);
        let steady = watch.climb_mps(20.0, 20.0);
        assert!((-4.0..-1.0).contains(&steady), "{steady}");
        assert!(watch.climb_mps(22.0, 20.0) < steady && watch.climb_mps(18.0, 20.0) > steady);
    }
}
