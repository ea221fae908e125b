//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};

use bateleur_messages::parameter::{Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_GPS;

use crate::Origin;

/// What the ground can read. Nothing can be set: a runway that moved in flight would move the aircraft.
pub fn parameters() -> Parameters<Origin> {
    Parameters::new(FROM_GPS, ROWS)
}

static ROWS: &[Row<Origin>] = &[
    Row::fixed("GPS_ORIGIN_LAT", Kind::Real, |o| Some(o.latitude_deg)),
    Row::fixed("GPS_ORIGIN_LON", Kind::Real, |o| Some(o.longitude_deg)),
    Row::fixed("GPS_ORIGIN_ALT", Kind::Real, |o| Some(o.altitude_m)),
];

/// The runway.
///
/// # Errors
/// When an attribute has another type, or the place is none on earth.
pub fn origin(attributes: &mut Attributes) -> Result<Origin, StartError> {
    let usual = Origin::default();
    let origin = Origin {
        latitude_deg: attributes.get("origin_latitude_deg", usual.latitude_deg)?,
        longitude_deg: attributes.get("origin_longitude_deg", usual.longitude_deg)?,
        altitude_m: attributes.get("origin_altitude_m", usual.altitude_m)?,
    };
    if origin.is_sane() {
        return Ok(origin);
    }
    Err(StartError::Other(format!(
        "attributes origin_…: {origin:?} is no runway; give degrees within ±85 and ±180 and metres above sea level"
    )))
}
