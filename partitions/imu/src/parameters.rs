//! What the ground can read of this function, and set. Settable ones come first, new ones behind the last of them.

use bateleur_messages::parameter::{Changed, Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_IMU;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::{Biases, Settings};

/// Everything that outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Memory {
    /// What is taken off the raw values.
    pub biases: Biases,
    /// What the ground has set.
    pub parameters: Changed,
}

/// The table.
pub fn parameters() -> Parameters<Settings> {
    Parameters::new(FROM_IMU, ROWS)
}

static ROWS: &[Row<Settings>] = &[
    Row::settable(
        "IMU_INIT_TIME",
        Kind::Real,
        (0.1, 10.0),
        |s| Some(s.initialise_ns as f64 * 1e-9),
        |s, value| {
            s.initialise_ns = (value * 1e9).round() as u64; // in range
            true
        },
    ),
    Row::settable(
        "IMU_GYRO_BIAS",
        Kind::Choice,
        (0.0, 1.0),
        |s| Some(f64::from(s.gyro_bias)),
        |s, value| {
            s.gyro_bias = value == 1.0;
            true
        },
    ),
    Row::settable(
        "IMU_PITOT_COVER",
        Kind::Choice,
        (0.0, 1.0),
        |s| Some(f64::from(s.pitot_covered)),
        |s, value| {
            s.pitot_covered = value == 1.0;
            true
        },
    ),
];
