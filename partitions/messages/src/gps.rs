//! Satellite fixes.

use crate::field::message;

message! {
    /// One fix as a receiver gives it.
    pub struct RawGps {
        /// Module time at which the fix was true, ns: its latency has already been taken off.
        pub measured_ns: u64,
        /// Latitude, rad, north positive.
        pub latitude_rad: f64,
        /// Longitude, rad, east positive.
        pub longitude_rad: f64,
        /// Height above mean sea level, m.
        pub altitude_m: f64,
        /// Velocity north, east, down, m/s.
        pub velocity_ned_mps: [f64; 3],
        /// Expected horizontal error, m.
        pub horizontal_accuracy_m: f64,
        /// Expected vertical error, m.
        pub vertical_accuracy_m: f64,
        /// Expected error of the velocity, m/s.
        pub speed_accuracy_mps: f64,
        /// Satellites used.
        pub satellites: u32,
        /// 0 no fix, 2 two dimensions, 3 three dimensions.
        pub fix: u32,
    }
}

message! {
    /// Where the receiver's antenna was.
    pub struct GpsPosition {
        /// Module time at which it was true, ns.
        pub measured_ns: u64,
        /// Latitude, rad, north positive.
        pub latitude_rad: f64,
        /// Longitude, rad, east positive.
        pub longitude_rad: f64,
        /// Height above mean sea level, m.
        pub altitude_m: f64,
        /// Position from the runway: north, east, down, m.
        pub position_ned_m: [f64; 3],
        /// Expected horizontal error, m.
        pub horizontal_accuracy_m: f64,
        /// Expected vertical error, m.
        pub vertical_accuracy_m: f64,
        /// Fixes so far; a reader acts on a change.
        pub count: u64,
    }
}

message! {
    /// How fast the receiver's antenna moved.
    pub struct GpsVelocity {
        /// Module time at which it was true, ns.
        pub measured_ns: u64,
        /// Velocity north, east, down, m/s.
        pub velocity_ned_mps: [f64; 3],
        /// Expected error, m/s.
        pub speed_accuracy_mps: f64,
        /// Fixes so far; a reader acts on a change.
        pub count: u64,
    }
}
