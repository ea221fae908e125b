//! What an aircraft can be asked for at an airspeed: load factor, bank, and the airspeed below which nothing else counts.
//!
//! Responsible for the limits alone; the outer loops keep their references within them. They are of references: a gust may
//! carry the aircraft beyond one for a moment. The angle of attack is not measured; what stands for it is the lift
//! coefficient, which the normal specific acceleration and the airspeed tell.

use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use crate::atmosphere::SEA_LEVEL_DENSITY_KGPM3;
use std::f64::consts::FRAC_PI_2;

/// Share of the greatest lift coefficient that is asked for: what is left is for gusts from below, 2 m/s of them at 22 m/s.
const LIFT_SHARE: f64 = 0.85;
/// Share of the elevator's travel that a steady turn may take: what is left steers.
const ELEVATOR_SHARE: f64 = 0.95;
/// Load factor that no structure should see more of.
const STRUCTURE_LOAD_FACTOR: f64 = 3.5;
/// Least load factor asked for: an engine and a pilot's stomach like weight.
const LEAST_LOAD_FACTOR: f64 = 0.2;
/// Load factors below this are always granted, or a slow aircraft could not even be turned back.
const ALWAYS_LOAD_FACTOR: f64 = 1.05;
/// Least airspeed, of the one at which the wing just carries the weight.
const FLOOR_SHARE: f64 = 1.2;
/// Steepest climb and descent, as a share of the airspeed: 30°.
const STEEPEST: f64 = 0.5;
/// Airspeed that is flown where nobody asks for one, at least: of the same.
const CRUISE_SHARE: f64 = 1.3;
/// Airspeeds outside are taken as these, m/s, because gains go with 1/V²; and shares of stall and full-throttle airspeed, where an
/// aircraft flies slower or faster than that.
const MEASURED_MPS: (f64, f64) = (10.0, 60.0);
const MEASURED_SHARES: (f64, f64) = (0.7, 1.3);
/// Share of the roll rate at full aileron that a bank is turned to with: what is left steadies.
const ROLL_SHARE: f64 = 0.8;
/// Least airspeed of a glide, of the one at which the wing just carries the weight: there is no throttle to get it back with.
const GLIDE_SHARE: f64 = 1.4;
/// And beyond the one below which the elevator holds no turn, m/s.
const GLIDE_MORE_MPS: f64 = 2.0;
/// How hard it is kept, 1/s.
const STEEPEST_GAIN: f64 = 3.0;
/// Airspeed at which a wheel may leave the ground, of the same.
const ROTATION_SHARE: f64 = 1.25;

/// One bit for each limit that a reference ran into.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Protection(pub u32);

impl Protection {
    /// Bank.
    pub const BANK: u32 = 1;
    /// Load factor, by structure or elevator.
    pub const LOAD_FACTOR: u32 = 2;
    /// Angle of attack, through the lift coefficient.
    pub const LIFT: u32 = 4;
    /// Airspeed.
    pub const AIRSPEED: u32 = 8;
    /// Angle of climb or descent.
    pub const CLIMB: u32 = 16;
    /// No limit: the pitot is not believed, the airspeed is the one that lift tells.
    pub const PITOT: u32 = 32;
    /// No limit: the propeller drives nothing, the aircraft glides.
    pub const POWER: u32 = 64;
    /// No limit: the wing has stalled, the nose goes down.
    pub const STALL: u32 = 128;

    /// Notes a limit.
    pub fn note(&mut self, bit: u32, reached: bool) {
        self.0 |= if reached { bit } else { 0 };
    }

    /// Whether it was noted.
    pub fn has(self, bit: u32) -> bool {
        self.0 & bit != 0
    }
}

/// The limits at an airspeed and a density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Load factor of the lift coefficient that is asked for at most.
    pub by_lift: f64,
    /// Load factor that the elevator holds in a steady turn.
    pub by_elevator: f64,
    /// The least of these, and of what structures bear.
    pub load_factor: f64,
    /// Bank that can be held level with it, within what the laws ask for at most, rad.
    pub bank_rad: f64,
    /// Least airspeed, m/s.
    pub floor_mps: f64,
}

impl Limits {
    /// C (m/s²) within what can be asked for; notes what it ran into.
    pub fn normal(&self, wanted_mps2: f64, protection: &mut Protection) -> f64 {
        let most = self.load_factor * GRAVITY_MPS2;
        let reached = wanted_mps2 < -most;
        let lift = self.by_lift <= self.load_factor;
        protection.note(Protection::LIFT, reached && lift);
        protection.note(Protection::LOAD_FACTOR, reached && !lift);
        wanted_mps2.clamp(-most, -LEAST_LOAD_FACTOR * GRAVITY_MPS2)
    }

    /// Bank (rad) within what can be asked for; notes what it ran into.
    pub fn bank(&self, wanted_rad: f64, protection: &mut Protection) -> f64 {
        protection.note(Protection::BANK, wanted_rad.abs() > self.bank_rad);
        wanted_rad.clamp(-self.bank_rad, self.bank_rad)
    }
}

/// Vertical accelerations up (m/s²) within which a path stays that is no steeper than 30°: pulling on and on would fly a loop.
pub fn steepness(airspeed_mps: f64, climb_mps: f64) -> (f64, f64) {
    let most = STEEPEST * airspeed_mps;
    (STEEPEST_GAIN * (-most - climb_mps), STEEPEST_GAIN * (most - climb_mps))
}

/// Airspeeds of a [`Banks`].
const BANKS: usize = 64;

/// The tangent of the bank that can be held level, by airspeed: for who knows no airframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Banks {
    least_mps: f64,
    step_mps: f64,
    tangents: [f64; BANKS],
}

impl Banks {
    /// Any bank at any airspeed.
    pub const ANY: Self = Self { least_mps: 0.0, step_mps: 1.0, tangents: [1e3; BANKS] };

    /// At an airspeed (m/s); outside of what the aircraft flies, that of the nearest one.
    pub fn tangent(&self, airspeed_mps: f64) -> f64 {
        let place = ((airspeed_mps - self.least_mps) / self.step_mps).clamp(0.0, (BANKS - 1) as f64);
        let below = (place as usize).min(BANKS - 2);
        let share = place - below as f64;
        (1.0 - share) * self.tangents[below] + share * self.tangents[below + 1]
    }
}

/// What follows from the airframe once and for all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    greatest_lift: f64,
    /// That of the airframe file.
    pub file_lift: f64,
    /// Airspeeds outside are taken as these, m/s.
    pub measured_mps: (f64, f64),
    /// See [`Airframe::roll_per_airspeed`].
    roll_per_airspeed: f64,
    /// Airspeed below which none is asked for, m/s: it is too near to the stall, or the elevator at its stop holds none less.
    pub slowest_mps: f64,
    /// Airspeed above which none is asked for, m/s: what would be lacking for ever would keep the aircraft from climbing.
    pub fastest_mps: f64,
}

impl Envelope {
    /// Of an airframe.
    pub fn new(airframe: &Airframe) -> Self {
        Self::with_lift(airframe, 1.0)
    }

    /// The same for a wing that gives this share of the greatest lift of the airframe file.
    pub fn with_lift(airframe: &Airframe, share: f64) -> Self {
        let file_lift = airframe.greatest_lift();
        let envelope = Self {
            greatest_lift: share * file_lift,
            file_lift,
            measured_mps: MEASURED_MPS,
            roll_per_airspeed: airframe.roll_per_airspeed(),
            slowest_mps: 0.0,
            fastest_mps: airframe.fastest_mps(),
        };
        let stall_mps = envelope.stall_mps(airframe, SEA_LEVEL_DENSITY_KGPM3);
        let least_mps = MEASURED_MPS.0.min(MEASURED_SHARES.0 * stall_mps);
        let most_mps = MEASURED_MPS.1.max(MEASURED_SHARES.1 * envelope.fastest_mps);
        let slowest_mps = slowest_mps(airframe, FLOOR_SHARE * stall_mps, envelope.fastest_mps);
        Self { measured_mps: (least_mps, most_mps), slowest_mps, ..envelope }
    }

    /// An airspeed (m/s) within what is flown at sea level.
    pub fn flown_mps(&self, asked_mps: f64) -> f64 {
        asked_mps.min(self.fastest_mps).max(self.slowest_mps)
    }

    /// Airspeed (m/s) that is flown where `asked_mps` is meant for whatever aircraft it is.
    pub fn cruise_mps(&self, airframe: &Airframe, asked_mps: f64) -> f64 {
        let least_mps =
            (CRUISE_SHARE * self.stall_mps(airframe, SEA_LEVEL_DENSITY_KGPM3)).max(self.slowest_mps);
        asked_mps.max(least_mps).min(self.fastest_mps.max(least_mps))
    }

    /// Banks that can be held level, at sea level.
    pub fn banks(&self, airframe: &Airframe) -> Banks {
        let least_mps = self.slowest_mps;
        let step_mps = (self.fastest_mps - least_mps).max(1.0) / (BANKS - 1) as f64;
        let tangents = std::array::from_fn(|index| {
            let airspeed_mps = least_mps + step_mps * index as f64;
            let limits = self.limits(airframe, airspeed_mps, SEA_LEVEL_DENSITY_KGPM3, FRAC_PI_2);
            limits.bank_rad.tan()
        });
        Banks { least_mps, step_mps, tangents }
    }

    /// Roll rate (rad/s) to turn to a bank with, at most.
    pub fn roll_rate_radps(&self, airspeed_mps: f64) -> f64 {
        ROLL_SHARE * self.roll_per_airspeed * airspeed_mps
    }

    /// Airspeed (m/s) at which the wing just carries the weight.
    pub fn stall_mps(&self, airframe: &Airframe, density_kgpm3: f64) -> f64 {
        airframe.stall_mps(self.greatest_lift, density_kgpm3)
    }

    /// Airspeed (m/s) of a glide.
    pub fn glide_mps(&self, airframe: &Airframe, density_kgpm3: f64) -> f64 {
        let by_lift_mps = GLIDE_SHARE * self.stall_mps(airframe, density_kgpm3);
        let least_mps = by_lift_mps.max(self.slowest_mps + GLIDE_MORE_MPS);
        airframe.farthest_glide_mps().min(self.fastest_mps).max(least_mps)
    }

    /// Airspeed (m/s) at which it may leave the ground.
    pub fn rotation_mps(&self, airframe: &Airframe, density_kgpm3: f64) -> f64 {
        ROTATION_SHARE * self.stall_mps(airframe, density_kgpm3)
    }

    /// The limits at an airspeed (m/s), with a bank (rad) that the laws end at.
    pub fn limits(
        &self,
        airframe: &Airframe,
        airspeed_mps: f64,
        density_kgpm3: f64,
        bank_rad: f64,
    ) -> Limits {
        let stall_mps = self.stall_mps(airframe, density_kgpm3);
        let by_lift = LIFT_SHARE * (airspeed_mps / stall_mps).powi(2);
        let by_elevator = turn_load_factor(airframe, airspeed_mps, density_kgpm3, ELEVATOR_SHARE);
        let load_factor = by_lift.min(by_elevator).clamp(ALWAYS_LOAD_FACTOR, STRUCTURE_LOAD_FACTOR);
        Limits {
            by_lift,
            by_elevator,
            load_factor,
            bank_rad: (1.0 / load_factor).acos().min(bank_rad),
            floor_mps: FLOOR_SHARE * stall_mps,
        }
    }
}

/// The least airspeed (m/s) from `floor_mps` on at which the elevator holds level flight within the share of its travel.
fn slowest_mps(airframe: &Airframe, floor_mps: f64, fastest_mps: f64) -> f64 {
    let travel = ELEVATOR_SHARE * airframe.servo.elevator_limit_rad;
    let airspeeds = (0..).map(|step| floor_mps + 0.1 * f64::from(step));
    let mut airspeeds = airspeeds.take_while(|airspeed_mps| *airspeed_mps < fastest_mps);
    let holds = |airspeed_mps: &f64| {
        airframe.trim(*airspeed_mps, SEA_LEVEL_DENSITY_KGPM3).elevator_rad.abs() < travel
    };
    airspeeds.find(holds).unwrap_or(floor_mps)
}

/// Load factor of the steady turn in which the elevator stands at a share of its travel: lift and moment in balance at the turn's
/// pitch rate (g/V)(n − 1/n). At most 100, where the elevator is not what ends it.
fn turn_load_factor(airframe: &Airframe, airspeed_mps: f64, density_kgpm3: f64, share: f64) -> f64 {
    let (a, chord) = (&airframe.aerodynamics, airframe.geometry.mean_chord_m);
    let force = 0.5 * density_kgpm3 * airspeed_mps * airspeed_mps * airframe.geometry.wing_area_m2;
    let weight = airframe.mass.mass_kg * GRAVITY_MPS2;
    let determinant = a.lift_alpha * a.pitch_elevator - a.lift_elevator * a.pitch_alpha;
    let travel = share * airframe.servo.elevator_limit_rad;
    let reaches = |factor: f64| {
        let turn = GRAVITY_MPS2 / airspeed_mps * (factor - 1.0 / factor);
        let rate = turn * chord / (2.0 * airspeed_mps);
        let lift = factor * weight / force - a.lift_0 - a.lift_pitch_rate * rate;
        let moment = -a.pitch_0 - a.pitch_pitch_rate * rate;
        ((a.lift_alpha * moment - a.pitch_alpha * lift) / determinant).abs() < travel
    };
    let (mut low, mut high) = (1.0, 100.0);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        if reaches(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::built_in;
    use crate::airframe::tests::aerosonde;

    fn limits(airframe: &Airframe, airspeed_mps: f64) -> Limits {
        Envelope::new(airframe).limits(airframe, airspeed_mps, 1.225, 60f64.to_radians())
    }

    #[test]
    fn elevator_ends_the_aerosondes_turns_and_the_wing_those_of_one_with_more_of_it() {
        let fast = limits(&aerosonde(), 22.0);
        assert!((1.5..1.75).contains(&fast.by_elevator), "{fast:?}");
        assert_eq!(fast.load_factor, fast.by_elevator);
        assert!((fast.bank_rad.cos() * fast.load_factor - 1.0).abs() < 1e-9);
        let mut strong = aerosonde();
        strong.servo.elevator_limit_rad *= 4.0;
        let slow = limits(&strong, 15.0);
        assert!(slow.load_factor == slow.by_lift && slow.by_lift < slow.by_elevator, "{slow:?}");
        let rascal = Airframe::from_toml(built_in("rascal110").unwrap()).unwrap();
        assert!((Envelope::new(&rascal).stall_mps(&rascal, 1.225) - 8.8).abs() < 0.2);
    }

    #[test]
    fn elevator_at_its_stop_ends_what_is_flown_slowly_and_little_bank_is_held_there() {
        let envelope = Envelope::new(&aerosonde());
        assert!((16.0..16.6).contains(&envelope.slowest_mps), "{}", envelope.slowest_mps);
        assert_eq!(
            [10.0, 22.0, 90.0].map(|asked| envelope.flown_mps(asked)),
            [envelope.slowest_mps, 22.0, envelope.fastest_mps]
        );
        let banks = envelope.banks(&aerosonde());
        let held = |airspeed_mps: f64| {
            envelope.limits(&aerosonde(), airspeed_mps, SEA_LEVEL_DENSITY_KGPM3, FRAC_PI_2).bank_rad.tan()
        };
        for airspeed_mps in [18.0, 19.0, 22.0, 26.0] {
            let (table, exact) = (banks.tangent(airspeed_mps), held(airspeed_mps));
            assert!((table / exact - 1.0).abs() < 0.05, "{airspeed_mps}: {table} {exact}");
        }
        assert!(banks.tangent(16.3) < 0.5 && banks.tangent(5.0) == banks.tangent(envelope.slowest_mps));
        assert_eq!(Banks::ANY.tangent(7.0), Banks::ANY.tangent(90.0));
    }

    #[test]
    fn references_are_held_within_and_what_held_them_is_noted() {
        let limits = limits(&aerosonde(), 22.0);
        let mut protection = Protection::default();
        assert_eq!(limits.bank(0.2, &mut protection), 0.2);
        assert_eq!(limits.normal(-9.8, &mut protection), -9.8);
        assert_eq!(protection, Protection::default());
        assert_eq!(limits.bank(-1.5, &mut protection), -limits.bank_rad);
        assert_eq!(limits.normal(-60.0, &mut protection), -limits.load_factor * GRAVITY_MPS2);
        assert_eq!(protection, Protection(Protection::BANK | Protection::LOAD_FACTOR));
        assert_eq!(limits.normal(5.0, &mut protection), -0.2 * GRAVITY_MPS2);
    }
}
