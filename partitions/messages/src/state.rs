//! The estimated state of the aircraft.

use crate::field::message;

message! {
    /// Position, velocity and attitude as the Estimator sees them. North-east-down from the runway.
    pub struct State {
        /// Module time for which the state holds, ns.
        pub valid_ns: u64,
        /// Position north, east, down, m.
        pub position_ned_m: [f64; 3],
        /// Velocity north, east, down, m/s.
        pub velocity_ned_mps: [f64; 3],
        /// Attitude, body to north-east-down: w, x, y, z.
        pub quaternion: [f64; 4],
        /// Roll, pitch, yaw, rad.
        pub euler_rad: [f64; 3],
        /// Angular rate without bias, rad/s.
        pub rates_radps: [f64; 3],
        /// Specific force without bias, m/s².
        pub specific_force_mps2: [f64; 3],
        /// Wind, the air's motion north and east, m/s.
        pub wind_ne_mps: [f64; 2],
        /// Gyroscope bias, rad/s.
        pub gyro_bias_radps: [f64; 3],
        /// Accelerometer bias, m/s².
        pub accel_bias_mps2: [f64; 3],
        /// Standard deviation of roll, pitch, yaw, rad.
        pub attitude_sigma_rad: [f64; 3],
        /// Standard deviation of the velocity, m/s.
        pub velocity_sigma_mps: [f64; 3],
        /// Standard deviation of the position, m.
        pub position_sigma_m: [f64; 3],
        /// 0 disabled, 1 initialising, 2 coarse (good enough to keep the wings level), 3 running.
        pub status: u32,
        /// Measurements rejected by a gate so far.
        pub rejected: u32,
        /// What is healthy now, one bit each: 1 GPS, 2 barometer, 4 pitot, 8 magnetometer are being taken; 16 attitude,
        /// 32 velocity, 64 position are as good as they should be.
        pub health: u64,
    }
}

/// The Estimator does nothing: the ground has disabled it.
pub const STATUS_DISABLED: u32 = 0;
/// The Estimator collects what it needs for a first attitude.
pub const STATUS_INITIALISING: u32 = 1;
/// Attitude roughly known; position and biases still settle.
pub const STATUS_COARSE: u32 = 2;
/// Every state within its expected error.
pub const STATUS_RUNNING: u32 = 3;
