//! The estimated state of the aircraft.

use crate::State;

/// The Estimator does nothing: the ground has disabled it.
pub const STATUS_DISABLED: u32 = State::STATUS_DISABLED;
/// The Estimator collects what it needs for a first attitude.
pub const STATUS_INITIALISING: u32 = State::STATUS_INITIALISING;
/// Attitude roughly known; position and biases still settle.
pub const STATUS_COARSE: u32 = State::STATUS_COARSE;
/// Every state within its expected error.
pub const STATUS_RUNNING: u32 = State::STATUS_RUNNING;
