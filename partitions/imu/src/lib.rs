//! The function that turns raw analogue values into inertial, magnetic and pressure measurements.
//!
//! Responsible for: taking off the bias that was found on the ground, turning pressures into altitude and airspeed,
//! and dropping what can not be true. It must never pass on a value that is not finite, and never take bias from an
//! aircraft that moves. One broken sensor costs its own measurement alone.

mod initialise;
mod parameters;
mod settings;

pub use initialise::{Initialise, Outcome};
pub use parameters::{Memory, parameters};
pub use settings::Settings;

use bateleur_flight::atmosphere::{airspeed_mps, density_kgpm3, pressure_altitude_m};
use bateleur_messages::telemetry::ImuTelemetry;
use bateleur_messages::{Acceleration, Magnetization, Pressure, Rates, RawAnalog};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Beyond any sensor that this computer carries (16 g), with room for bias, m/s².
const LARGEST_FORCE_MPS2: f64 = 300.0;
/// Beyond any gyroscope that this computer carries (2000°/s), rad/s.
const LARGEST_RATE_RADPS: f64 = 40.0;
/// The earth's field has 0.65 gauss at most; a magnet nearby may add to it.
const LARGEST_FIELD_GAUSS: f64 = 5.0;
/// What differential sensors of small aircraft measure, with room for bias, Pa; 10 kPa are 128 m/s.
const DIFFERENTIAL_PA: std::ops::Range<f64> = -2_000.0..10_000.0;
/// A sampling interval of a second or more is a broken time stamp, ns.
const LONGEST_INTERVAL_NS: u64 = 1_000_000_000;

/// What is taken off the raw values. Outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Biases {
    /// Specific force, m/s².
    pub specific_force_mps2: [f64; 3],
    /// Angular rate, rad/s.
    pub rates_radps: [f64; 3],
    /// Differential pressure at rest, Pa.
    pub differential_pressure_pa: f64,
    /// Pressure altitude of the place where the pressure sensor was initialised, m.
    pub reference_altitude_m: f64,
}

impl Biases {
    /// These biases if they can be used, none otherwise.
    pub fn sane(self) -> Self {
        let pressures = [self.differential_pressure_pa, self.reference_altitude_m];
        let finite = pressures.iter().all(|value| value.is_finite())
            && within(&self.specific_force_mps2, LARGEST_FORCE_MPS2)
            && within(&self.rates_radps, LARGEST_RATE_RADPS);
        if finite { self } else { Self::default() }
    }
}

/// One sensor set without bias; nothing where a sensor's values can not be true.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Measurements {
    /// From the accelerometer.
    pub acceleration: Option<Acceleration>,
    /// From the gyroscope.
    pub orientation: Option<Rates>,
    /// From the magnetometer.
    pub magnetization: Option<Magnetization>,
    /// From the pressure sensors.
    pub pressure: Option<Pressure>,
}

/// What became of the values so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Sensor sets taken.
    pub sets: u64,
    /// Values of a sensor that were dropped.
    pub dropped: u64,
}

/// The function.
#[derive(Debug)]
pub struct Imu {
    biases: Biases,
    last_ns: Option<u64>,
    shown: ImuTelemetry,
    counters: Counters,
}

impl Imu {
    /// A function that takes `biases` off.
    pub fn new(biases: Biases) -> Self {
        Self { biases, last_ns: None, shown: ImuTelemetry::default(), counters: Counters::default() }
    }

    /// What is taken off the raw values.
    pub fn biases(&self) -> &Biases {
        &self.biases
    }

    /// Takes other biases off from now on.
    pub fn set_biases(&mut self, biases: Biases) {
        self.biases = biases;
    }

    /// What became of the values so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The last measurements for the ground.
    pub fn telemetry(&self) -> ImuTelemetry {
        self.shown
    }

    /// Takes a raw sensor set; nothing where it is the same as before.
    pub fn take(&mut self, raw: &RawAnalog) -> Option<Measurements> {
        if self.last_ns == Some(raw.measured_ns) {
            return None;
        }
        self.last_ns = Some(raw.measured_ns);
        self.counters.sets += 1;
        let timed = raw.interval_ns > 0 && raw.interval_ns < LONGEST_INTERVAL_NS;
        let measurements = Measurements {
            acceleration: self.acceleration(raw).filter(|_| timed),
            orientation: self.orientation(raw).filter(|_| timed),
            magnetization: magnetization(raw),
            pressure: self.pressure(raw),
        };
        self.note(raw.measured_ns, &measurements);
        Some(measurements)
    }

    fn acceleration(&self, raw: &RawAnalog) -> Option<Acceleration> {
        let specific_force_mps2 = difference(&raw.specific_force_mps2, &self.biases.specific_force_mps2);
        within(&specific_force_mps2, LARGEST_FORCE_MPS2).then_some(Acceleration {
            measured_ns: raw.measured_ns,
            interval_ns: raw.interval_ns,
            specific_force_mps2,
        })
    }

    fn orientation(&self, raw: &RawAnalog) -> Option<Rates> {
        let rates_radps = difference(&raw.rates_radps, &self.biases.rates_radps);
        within(&rates_radps, LARGEST_RATE_RADPS).then_some(Rates {
            measured_ns: raw.measured_ns,
            interval_ns: raw.interval_ns,
            rates_radps,
        })
    }

    fn pressure(&self, raw: &RawAnalog) -> Option<Pressure> {
        let differential_pressure_pa = raw.differential_pressure_pa - self.biases.differential_pressure_pa;
        if !DIFFERENTIAL_PA.contains(&differential_pressure_pa) {
            return None;
        }
        let altitude_m = pressure_altitude_m(raw.static_pressure_pa)?;
        let density = density_kgpm3(altitude_m);
        Some(Pressure {
            measured_ns: raw.measured_ns,
            static_pressure_pa: raw.static_pressure_pa,
            differential_pressure_pa,
            pressure_altitude_m: altitude_m,
            height_m: altitude_m - self.biases.reference_altitude_m,
            airspeed_mps: airspeed_mps(differential_pressure_pa, density),
            density_kgpm3: density,
        })
    }

    /// Counts what was dropped and keeps the rest for telemetry.
    fn note(&mut self, measured_ns: u64, measurements: &Measurements) {
        let Measurements { acceleration, orientation, magnetization, pressure } = measurements;
        let shown = &mut self.shown;
        shown.measured_ns = measured_ns;
        let mut dropped = 0;
        match acceleration {
            Some(acceleration) => shown.specific_force_mps2 = acceleration.specific_force_mps2,
            None => dropped += 1,
        }
        match orientation {
            Some(rates) => shown.rates_radps = rates.rates_radps,
            None => dropped += 1,
        }
        match magnetization {
            Some(field) => shown.field_gauss = field.field_gauss,
            None => dropped += 1,
        }
        match pressure {
            Some(pressure) => {
                shown.pressure_altitude_m = pressure.pressure_altitude_m;
                shown.airspeed_mps = pressure.airspeed_mps;
            }
            None => dropped += 1,
        }
        self.counters.dropped += dropped;
    }
}

fn magnetization(raw: &RawAnalog) -> Option<Magnetization> {
    within(&raw.field_gauss, LARGEST_FIELD_GAUSS)
        .then_some(Magnetization { measured_ns: raw.measured_ns, field_gauss: raw.field_gauss })
}

/// Whether each component is a number no larger than `limit`.
fn within(vector: &[f64; 3], limit: f64) -> bool {
    vector.iter().all(|value| value.abs() <= limit)
}

fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A sensor set of an aircraft that stands level on a runway at sea level.
    pub(crate) fn standing(measured_ns: u64) -> RawAnalog {
        RawAnalog {
            measured_ns,
            interval_ns: 20_000_000,
            specific_force_mps2: [0.0, 0.0, -9.80665],
            rates_radps: [0.0; 3],
            field_gauss: [0.096, -0.049, -0.226],
            static_pressure_pa: 101_325.0,
            differential_pressure_pa: 0.0,
            temperature_k: 288.15,
        }
    }

    #[test]
    fn pressures_become_altitude_and_airspeed() {
        let raw = RawAnalog {
            static_pressure_pa: 99_416.0, // 160 m in the standard atmosphere
            differential_pressure_pa: 290.0,
            ..standing(1)
        };
        let pressure = Imu::new(Biases::default()).take(&raw).unwrap().pressure.unwrap();
        assert!((pressure.pressure_altitude_m - 160.0).abs() < 0.5, "{pressure:?}");
        assert!((pressure.airspeed_mps - 21.93).abs() < 0.05, "{pressure:?}");
        assert!((pressure.density_kgpm3 - 1.2062).abs() < 0.001, "{pressure:?}");
    }

    #[test]
    fn biases_are_taken_off() {
        let biases = Biases {
            specific_force_mps2: [0.1, 0.2, 0.3],
            rates_radps: [0.01, 0.02, 0.03],
            differential_pressure_pa: 5.0,
            reference_altitude_m: 12.0,
        };
        let set = Imu::new(biases).take(&standing(1)).unwrap();
        assert_eq!(set.acceleration.unwrap().specific_force_mps2[0], -0.1);
        assert_eq!(set.orientation.unwrap().rates_radps, [-0.01, -0.02, -0.03]);
        let pressure = set.pressure.unwrap();
        assert_eq!(pressure.differential_pressure_pa, -5.0);
        assert_eq!((pressure.airspeed_mps, pressure.height_m), (0.0, -12.0));
    }

    #[test]
    fn one_broken_sensor_leaves_the_others_alone() {
        let mut imu = Imu::new(Biases::default());
        let set = imu.take(&RawAnalog { rates_radps: [0.0, f64::NAN, 0.0], ..standing(1) }).unwrap();
        assert_eq!(set.orientation, None);
        assert!(set.acceleration.is_some() && set.magnetization.is_some() && set.pressure.is_some());
        let set = imu.take(&RawAnalog { static_pressure_pa: 0.0, ..standing(2) }).unwrap();
        assert_eq!(set.pressure, None);
        assert!(set.orientation.is_some());
        assert_eq!(imu.counters(), Counters { sets: 2, dropped: 2 });
    }

    #[test]
    fn absurd_values_are_dropped() {
        let mut imu = Imu::new(Biases::default());
        let absurd = RawAnalog {
            specific_force_mps2: [1e9, 0.0, 0.0],
            rates_radps: [0.0, 0.0, -1e3],
            field_gauss: [f64::INFINITY, 0.0, 0.0],
            differential_pressure_pa: 1e6,
            ..standing(1)
        };
        assert_eq!(imu.take(&absurd), Some(Measurements::default()));
        let timeless = imu.take(&RawAnalog { interval_ns: 0, ..standing(2) }).unwrap();
        assert!(timeless.acceleration.is_none() && timeless.magnetization.is_some());
    }

    #[test]
    fn the_same_set_again_gives_nothing() {
        let mut imu = Imu::new(Biases::default());
        assert!(imu.take(&standing(7)).is_some());
        assert!(imu.take(&standing(7)).is_none());
        assert_eq!(imu.counters().sets, 1);
    }

    #[test]
    fn biases_that_make_no_sense_are_passed_over() {
        let broken = Biases { rates_radps: [0.0, f64::NAN, 0.0], ..Biases::default() };
        assert_eq!(broken.sane(), Biases::default());
        let good = Biases { differential_pressure_pa: 3.0, ..Biases::default() };
        assert_eq!(good.sane(), good);
    }
}
