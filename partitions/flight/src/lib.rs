//! The flight laws: estimator, inner loops, guidance, servo mapping.
//!
//! Responsible for turning sensor values into a navigation state, and a navigation state with way-points into
//! actuator commands. It must never read a clock, do I/O or allocate inside a frame: time comes in with the
//! values, so that the same inputs give the same outputs, bit for bit, wherever a partition is placed.
//!
//! Published airframe data, the seed's architecture: the gains are derived here from the airframe file and the
//! dynamic pressure; they are not those of the earlier system.
//!
//! Frames: NED with its origin on the runway; body x forward, y right, z down. SI units and radians throughout,
//! magnetic field in gauss. Quaternions turn body vectors into NED vectors.
#![forbid(unsafe_code)]

pub mod airframe;
pub mod atmosphere;
pub mod attitude;
pub mod control;
pub mod estimator;
pub mod guidance;
mod kept;
pub mod magnetic;
pub mod servo;
pub mod stuck;

/// Standard gravity, m/s² (ISO 80000-3); the plant uses the same value, a difference would look like accelerometer bias.
pub const GRAVITY_MPS2: f64 = 9.80665;
/// How high the inertial sensors are taken to stand above the runway, m: the Aerosonde's height on its wheels.
pub const STANDING_HEIGHT_M: f64 = 0.3;
