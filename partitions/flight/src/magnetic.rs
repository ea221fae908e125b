//! The earth's field at the site, from the World Magnetic Model (NOAA/BGS WMM2025).

use nalgebra::Vector3;
use thiserror::Error;
use world_magnetic_model::GeomagneticField;
use world_magnetic_model::time::Date;
use world_magnetic_model::uom::si::angle::degree;
use world_magnetic_model::uom::si::f32::{Angle, Length};
use world_magnetic_model::uom::si::length::meter;
use world_magnetic_model::uom::si::magnetic_flux_density::nanotesla;

/// Gauss per nanotesla.
const GAUSS_PER_NT: f64 = 1e-5;

/// Where the runway is; the origin of the NED frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Geodetic latitude, degrees, north positive (an edge value: degrees as on a chart).
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, m; only the field strength depends on it, 0.05 % per kilometre.
    pub height_m: f64,
    /// Year of the flight, for the model's secular variation.
    pub year: i32,
    /// Day of that year, 1–366.
    pub day_of_year: u16,
}

impl Default for Site {
    /// The seed's runway, 34°02'47.778" S, 18°44'25.072" E, at 2026.0.
    fn default() -> Self {
        Self {
            latitude_deg: -(34.0 + 2.0 / 60.0 + 47.778 / 3600.0),
            longitude_deg: 18.0 + 44.0 / 60.0 + 25.072 / 3600.0,
            height_m: 0.0,
            year: 2026,
            day_of_year: 1,
        }
    }
}

/// Why no field could be computed.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum MagneticError {
    /// The day does not exist in that year.
    #[error("day {day} of year {year} is not a date")]
    Date {
        /// Year asked for.
        year: i32,
        /// Day of year asked for.
        day: u16,
    },
    /// The model has no answer at that place and time.
    #[error("the World Magnetic Model gives no field there and then: {0}")]
    Model(String),
}

/// The field at a site: north, east, down, in gauss.
pub fn field_ned_gauss(site: &Site) -> Result<Vector3<f64>, MagneticError> {
    let date = Date::from_ordinal_date(site.year, site.day_of_year)
        .map_err(|_| MagneticError::Date { year: site.year, day: site.day_of_year })?;
    let field = GeomagneticField::new(
        Length::new::<meter>(site.height_m as f32),
        Angle::new::<degree>(site.latitude_deg as f32),
        Angle::new::<degree>(site.longitude_deg as f32),
        date,
    )
    .map_err(|error| MagneticError::Model(error.to_string()))?;
    let gauss = |value: f32| f64::from(value) * GAUSS_PER_NT;
    Ok(Vector3::new(
        gauss(field.x().get::<nanotesla>()),
        gauss(field.y().get::<nanotesla>()),
        gauss(field.z().get::<nanotesla>()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_at_the_runway_points_up_and_27_degrees_west_of_north() {
        let field = field_ned_gauss(&Site::default()).unwrap();
        assert!((field - Vector3::new(0.09584, -0.04861, -0.22624)).norm() < 1e-4, "{field}");
        let declination_deg = field.y.atan2(field.x).to_degrees();
        assert!((declination_deg + 26.90).abs() < 0.1, "{declination_deg}");
    }

    #[test]
    fn impossible_date_is_named() {
        let error = field_ned_gauss(&Site { day_of_year: 400, ..Site::default() }).unwrap_err();
        assert_eq!(error.to_string(), "day 400 of year 2026 is not a date");
    }
}
