//! Inertial, magnetic and pressure measurements.

use crate::field::message;

message! {
    /// Raw analogue values of one sensor set, as any driver gives them. Body axes: x forward, y right, z down.
    pub struct RawAnalog {
        /// Module time of the end of the sampling interval, ns.
        pub measured_ns: u64,
        /// Length of the interval over which accelerometer and gyroscope were averaged, ns.
        pub interval_ns: u64,
        /// Mean specific force, m/s².
        pub specific_force_mps2: [f64; 3],
        /// Mean angular rate, rad/s.
        pub rates_radps: [f64; 3],
        /// Magnetic field, gauss.
        pub field_gauss: [f64; 3],
        /// Static pressure, Pa.
        pub static_pressure_pa: f64,
        /// Pitot minus static pressure, Pa.
        pub differential_pressure_pa: f64,
        /// Outside air temperature, K.
        pub temperature_k: f64,
    }
}

message! {
    /// The specific force, in body axes.
    pub struct Acceleration {
        /// Module time of the end of the sampling interval, ns.
        pub measured_ns: u64,
        /// Length of the interval, ns.
        pub interval_ns: u64,
        /// Mean specific force, m/s².
        pub specific_force_mps2: [f64; 3],
    }
}

message! {
    /// The angular rate, in body axes (the seed calls it orientation).
    pub struct Rates {
        /// Module time of the end of the sampling interval, ns.
        pub measured_ns: u64,
        /// Length of the interval, ns.
        pub interval_ns: u64,
        /// Mean angular rate, rad/s.
        pub rates_radps: [f64; 3],
    }
}

message! {
    /// The magnetic field, in body axes.
    pub struct Magnetization {
        /// Module time of the sample, ns.
        pub measured_ns: u64,
        /// Magnetic field, gauss.
        pub field_gauss: [f64; 3],
    }
}

message! {
    /// What the pressure sensors say.
    pub struct Pressure {
        /// Module time of the sample, ns.
        pub measured_ns: u64,
        /// Static pressure, Pa.
        pub static_pressure_pa: f64,
        /// Pitot minus static pressure, Pa.
        pub differential_pressure_pa: f64,
        /// Pressure altitude in the standard atmosphere, m.
        pub pressure_altitude_m: f64,
        /// Height above the place where the pressure sensor was last initialised, m.
        pub height_m: f64,
        /// Airspeed √(2Δp/ρ), m/s.
        pub airspeed_mps: f64,
        /// Air density, kg/m³.
        pub density_kgpm3: f64,
    }
}
