//! What the ground can read of this function, and set. Settable ones come first, new ones behind the last of them.

use bateleur_messages::parameter::{Changed, Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_SERVO;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::{Kept, Settings};

/// Everything that outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Memory {
    /// The function.
    pub function: Kept,
    /// What the ground has set.
    pub parameters: Changed,
}

/// The table.
pub fn parameters() -> Parameters<Settings> {
    Parameters::new(FROM_SERVO, ROWS)
}

static ROWS: &[Row<Settings>] = &[
    Row::settable(
        "SRV_HOLD",
        Kind::Real,
        (0.0, 5.0),
        |s| Some(s.hold_ns as f64 * 1e-9),
        |s, value| {
            s.hold_ns = (value * 1e9).round() as u64; // in range
            true
        },
    ),
    Row::fixed("SRV_AIL_MAX", Kind::Real, |s| Some(s.map.aileron_limit_rad)),
    Row::fixed("SRV_ELEV_MAX", Kind::Real, |s| Some(s.map.elevator_limit_rad)),
    Row::fixed("SRV_RUD_MAX", Kind::Real, |s| Some(s.map.rudder_limit_rad)),
];
