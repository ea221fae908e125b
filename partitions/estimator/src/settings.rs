//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};
use bateleur_flight::estimator::EstimatorConfig;
use bateleur_flight::magnetic::Site;

/// What the plan sets.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// The filter, for the place and the day of the flight.
    pub config: EstimatorConfig,
    /// Barometer and pitot are let in.
    pub pressure_aiding: bool,
    /// Where and when the flight takes place.
    pub site: Site,
}

impl Settings {
    /// Reads them.
    ///
    /// # Errors
    /// When an attribute has another type, or the earth's field is not known for the place and the day.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        let site = site(attributes)?;
        let config = EstimatorConfig::at_site(&site)
            .map_err(|error| StartError::Other(format!("attributes origin_…, year, day_of_year: {error}")))?;
        Ok(Self { config, pressure_aiding: attributes.get("pressure_aiding", true)?, site })
    }
}

/// Where and when the flight takes place, for the earth's magnetic field.
fn site(attributes: &mut Attributes) -> Result<Site, StartError> {
    let usual = Site::default();
    Ok(Site {
        latitude_deg: attributes.get("origin_latitude_deg", usual.latitude_deg)?,
        longitude_deg: attributes.get("origin_longitude_deg", usual.longitude_deg)?,
        height_m: attributes.get("origin_altitude_m", usual.height_m)?,
        year: attributes.get("year", usual.year)?,
        day_of_year: attributes.get("day_of_year", usual.day_of_year)?,
    })
}
