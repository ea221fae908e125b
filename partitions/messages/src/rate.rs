//! The module's beat.

use crate::field::message;

message! {
    /// RateGenerator's events as counters: a receiver acts when a counter differs from the one it last saw, so
    /// that an event is neither lost by a late reader nor acted on twice.
    pub struct Rate {
        /// Synchronize events so far: sensors sample, the last cycle's actuators go out.
        pub synchronize: u64,
        /// Execute events so far: the sensor cut-off has passed, the chain runs.
        pub execute: u64,
        /// First telemetry time-out (Controller's navigation, GPS, OnBoardComputer's primary).
        pub timeout_1: u64,
        /// Second telemetry time-out (Servo).
        pub timeout_2: u64,
        /// Third telemetry time-out (Estimator, IMU, Controller, OnBoardComputer's secondary).
        pub timeout_3: u64,
        /// Module time of the last synchronize event, ns.
        pub synchronize_ns: u64,
        /// The instant after which this cycle's sensors are no longer taken, module time, ns.
        pub sensor_cutoff_ns: u64,
    }
}
