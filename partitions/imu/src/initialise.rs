//! Taking the bias of sensors anew, on an order of the ground, while the aircraft stands.
//!
//! Raw values of about a second are averaged. What a standing aircraft shows, and what is made of it:
//!
//! - gyroscope: the mean rate is the bias (the earth's own 15°/h are below the sensor's resolution);
//! - accelerometer: the attitude is not known, so only the error along the vertical can be told from gravity; the
//!   mean is brought to the length of gravity in its own direction, and level is not assumed;
//! - pressure: the mean pressure altitude becomes height zero. The mean differential pressure is the bias only where
//!   the caller says that the pitot tube is covered: 8 m/s of wind into it look like 38 Pa of bias, which would take
//!   1.5 m/s off the airspeed in flight.
//!
//! An aircraft that moves gives itself away: rates or forces that differ from their mean, a force that is not
//! gravity's, or a dynamic pressure. Straight and level flight shows in the last alone.

use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::atmosphere::pressure_altitude_m;
use bateleur_messages::RawAnalog;
use bateleur_messages::ground::{SENSOR_ACCELEROMETER, SENSOR_GYROSCOPE, SENSOR_PRESSURE};

use crate::{Biases, difference, within};

/// Largest change of the rate from one sample to the mean, rad/s: ten times a gyroscope's noise; a wing that rocks in
/// the wind is below it, a hand that lifts the aircraft is not.
const RATE_CHANGE_RADPS: f64 = 0.05;
/// Largest mean rate, rad/s: data sheets allow 20°/s of bias, more is a turn.
const MEAN_RATE_RADPS: f64 = 0.5;
/// Largest change of the specific force from one sample to the mean, m/s².
const FORCE_CHANGE_MPS2: f64 = 1.0;
/// Largest difference of the mean specific force from gravity, m/s²: bias of 80 mg and scale error of 3 %.
const FORCE_ERROR_MPS2: f64 = 1.5;
/// Largest mean dynamic pressure at rest, Pa: bias, and gusts up to 12 m/s into the tube; less than any flying speed
/// gives.
const DIFFERENTIAL_PA: f64 = 100.0;
/// Fewer samples are no mean; more are waited for.
const ENOUGH: u32 = 10;
/// After this many averaging times without [`ENOUGH`] samples the attempt ends: the sensors are gone.
const PATIENCE: u64 = 3;

/// What has come of an order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// The new biases.
    Found(Biases),
    /// The aircraft moves, or there are no sensors.
    Refused,
}

/// Averaging under way.
#[derive(Debug, Clone, Copy)]
pub struct Initialise {
    sensors: u8,
    pitot_covered: bool,
    began_ns: u64,
    length_ns: u64,
    first: Option<RawAnalog>,
    count: u32,
    force: [f64; 3],
    rates: [f64; 3],
    differential_pa: f64,
    altitude_m: f64,
}

impl Initialise {
    /// Begins at module time `now_ns` to average the sensors of the bits `sensors` for `length_ns`. With
    /// `pitot_covered`, what the differential pressure shows is bias.
    pub fn new(sensors: u8, pitot_covered: bool, now_ns: u64, length_ns: u64) -> Self {
        Self {
            sensors,
            pitot_covered,
            began_ns: now_ns,
            length_ns,
            first: None,
            count: 0,
            force: [0.0; 3],
            rates: [0.0; 3],
            differential_pa: 0.0,
            altitude_m: 0.0,
        }
    }

    /// Whether the sensors of the bits `sensors` are being averaged already: a repeated order changes nothing.
    pub fn covers(&self, sensors: u8) -> bool {
        self.sensors & sensors == sensors
    }

    /// Takes a raw sensor set, or none, at `now_ns`; gives the outcome when there is one. `present` is kept where a
    /// sensor is not asked for.
    pub fn step(&mut self, now_ns: u64, raw: Option<&RawAnalog>, present: &Biases) -> Option<Outcome> {
        let age_ns = now_ns.saturating_sub(self.began_ns);
        if raw.is_some_and(|raw| !self.add(raw)) {
            return Some(Outcome::Refused);
        }
        if age_ns < self.length_ns {
            return None;
        }
        if self.count >= ENOUGH {
            return Some(Outcome::Found(self.biases(present)));
        }
        (age_ns > PATIENCE * self.length_ns).then_some(Outcome::Refused)
    }

    /// Adds a sample to the means; false: the aircraft moves, or the sample is broken.
    fn add(&mut self, raw: &RawAnalog) -> bool {
        let Some(altitude_m) = pressure_altitude_m(raw.static_pressure_pa) else { return false };
        let first = *self.first.get_or_insert(*raw);
        self.count += 1;
        let share = 1.0 / f64::from(self.count);
        move_towards(&mut self.force, &raw.specific_force_mps2, share);
        move_towards(&mut self.rates, &raw.rates_radps, share);
        self.differential_pa += share * (raw.differential_pressure_pa - self.differential_pa);
        self.altitude_m += share * (altitude_m - self.altitude_m);
        let steady = |a: &[f64; 3], b: &[f64; 3], limit| within(&difference(a, b), limit);
        steady(&raw.rates_radps, &self.rates, RATE_CHANGE_RADPS)
            && steady(&raw.specific_force_mps2, &self.force, FORCE_CHANGE_MPS2)
            && steady(&first.specific_force_mps2, &self.force, FORCE_CHANGE_MPS2)
            && within(&self.rates, MEAN_RATE_RADPS)
            && (length(&self.force) - GRAVITY_MPS2).abs() < FORCE_ERROR_MPS2
            && self.differential_pa.abs() < DIFFERENTIAL_PA
    }

    fn biases(&self, present: &Biases) -> Biases {
        let mut biases = *present;
        if self.covers(SENSOR_ACCELEROMETER) {
            let excess = 1.0 - GRAVITY_MPS2 / length(&self.force);
            biases.specific_force_mps2 = self.force.map(|force| force * excess);
        }
        if self.covers(SENSOR_GYROSCOPE) {
            biases.rates_radps = self.rates;
        }
        if self.covers(SENSOR_PRESSURE) {
            biases.reference_altitude_m = self.altitude_m;
        }
        if self.covers(SENSOR_PRESSURE) && self.pitot_covered {
            biases.differential_pressure_pa = self.differential_pa;
        }
        biases
    }
}

fn move_towards(mean: &mut [f64; 3], sample: &[f64; 3], share: f64) {
    for (mean, sample) in mean.iter_mut().zip(sample) {
        *mean += share * (sample - *mean);
    }
}

fn length(vector: &[f64; 3]) -> f64 {
    vector.iter().map(|value| value * value).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::standing;

    const SECOND: u64 = 1_000_000_000;
    const CYCLE: u64 = 20_000_000;
    const ALL: u8 = SENSOR_ACCELEROMETER | SENSOR_GYROSCOPE | SENSOR_PRESSURE;

    /// Runs an order to its outcome over sensor sets by number.
    fn run(sensors: u8, set: impl Fn(u64) -> Option<RawAnalog>) -> (Outcome, u64) {
        let mut initialise = Initialise::new(sensors, true, 0, SECOND);
        for number in 1..1_000 {
            let raw = set(number);
            if let Some(outcome) = initialise.step(number * CYCLE, raw.as_ref(), &Biases::default()) {
                return (outcome, number * CYCLE);
            }
        }
        panic!("no outcome");
    }

    fn biased(number: u64) -> RawAnalog {
        RawAnalog {
            rates_radps: [0.1, -0.2, 0.05],
            specific_force_mps2: [0.0, 0.0, -10.2],
            differential_pressure_pa: 4.0,
            static_pressure_pa: 100_129.4, // 100 m
            ..standing(number * CYCLE)
        }
    }

    #[test]
    fn biases_of_a_standing_aircraft_are_found_within_a_second() {
        let (outcome, after_ns) = run(ALL, |number| Some(biased(number)));
        let Outcome::Found(biases) = outcome else { panic!("{outcome:?}") };
        assert_eq!(after_ns, SECOND);
        assert!((biases.rates_radps[1] + 0.2).abs() < 1e-9);
        assert!((biases.specific_force_mps2[2] + 10.2 - GRAVITY_MPS2).abs() < 1e-9);
        assert!((biases.differential_pressure_pa - 4.0).abs() < 1e-9);
        assert!((biases.reference_altitude_m - 100.0).abs() < 0.1);
    }

    #[test]
    fn only_the_sensors_asked_for_change() {
        let (outcome, _) = run(SENSOR_GYROSCOPE, |number| Some(biased(number)));
        let Outcome::Found(biases) = outcome else { panic!("{outcome:?}") };
        assert_eq!(biases.specific_force_mps2, [0.0; 3]);
        assert_eq!(biases.reference_altitude_m, 0.0);
        assert!(biases.rates_radps[0] > 0.09);
    }

    #[test]
    fn an_aircraft_that_stands_with_its_nose_up_is_not_called_level() {
        let (sin, cos) = 0.2_f64.sin_cos();
        let tilted = [GRAVITY_MPS2 * sin, 0.0, -GRAVITY_MPS2 * cos];
        let set = |number| Some(RawAnalog { specific_force_mps2: tilted, ..standing(number * CYCLE) });
        let Outcome::Found(biases) = run(SENSOR_ACCELEROMETER, set).0 else { panic!() };
        assert!(biases.specific_force_mps2.iter().all(|bias| bias.abs() < 1e-9), "{biases:?}");
    }

    #[test]
    fn wind_into_an_open_pitot_tube_is_no_bias() {
        let mut initialise = Initialise::new(SENSOR_PRESSURE, false, 0, SECOND);
        let present = Biases { differential_pressure_pa: 1.0, ..Biases::default() };
        let outcome = (1..=50).find_map(|number| {
            let windy = RawAnalog { differential_pressure_pa: 38.0, ..biased(number) };
            initialise.step(number * CYCLE, Some(&windy), &present)
        });
        let Some(Outcome::Found(biases)) = outcome else { panic!("{outcome:?}") };
        assert_eq!(biases.differential_pressure_pa, 1.0);
        assert!((biases.reference_altitude_m - 100.0).abs() < 0.1);
    }

    #[test]
    fn an_aircraft_that_turns_or_rocks_is_refused() {
        let turning = |number| Some(RawAnalog { rates_radps: [0.0, 0.0, 0.6], ..standing(number * CYCLE) });
        assert_eq!(run(ALL, turning).0, Outcome::Refused);
        let rocking = |number| {
            let rate = 0.2 * (number as f64 * 0.3).sin();
            Some(RawAnalog { rates_radps: [rate, 0.0, 0.0], ..standing(number * CYCLE) })
        };
        assert_eq!(run(ALL, rocking).0, Outcome::Refused);
    }

    #[test]
    fn straight_and_level_flight_is_refused_by_its_airspeed() {
        let flying = |number| Some(RawAnalog { differential_pressure_pa: 290.0, ..standing(number * CYCLE) });
        assert_eq!(run(SENSOR_GYROSCOPE, flying).0, Outcome::Refused);
    }

    #[test]
    fn sensors_that_are_gone_or_broken_are_refused() {
        let (outcome, after_ns) = run(ALL, |_| None);
        assert_eq!(outcome, Outcome::Refused);
        assert!(after_ns > 3 * SECOND && after_ns < 4 * SECOND);
        let broken = |number| Some(RawAnalog { rates_radps: [f64::NAN; 3], ..standing(number * CYCLE) });
        assert_eq!(run(ALL, broken).0, Outcome::Refused);
    }
}
