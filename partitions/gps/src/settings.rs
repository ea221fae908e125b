//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};

use crate::Origin;

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
