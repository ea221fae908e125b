//! Flat ground around the runway, tied to the WGS 84 ellipsoid by its two radii of curvature at the runway.

use nalgebra::Vector3;

/// Latitude of the runway, 34°02'47.778" S, rad.
pub const RUNWAY_LATITUDE_RAD: f64 = -(34.0 + 2.0 / 60.0 + 47.778 / 3600.0) * std::f64::consts::PI / 180.0;
/// Longitude of the runway, 18°44'25.072" E, rad.
pub const RUNWAY_LONGITUDE_RAD: f64 = (18.0 + 44.0 / 60.0 + 25.072 / 3600.0) * std::f64::consts::PI / 180.0;

const SEMI_MAJOR_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// A place on the ellipsoid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Geodetic {
    /// Latitude, rad.
    pub latitude_rad: f64,
    /// Longitude, rad.
    pub longitude_rad: f64,
    /// Height above mean sea level, m (the geoid is taken for the ellipsoid).
    pub altitude_m: f64,
}

/// North, east, down axes with their origin on the runway.
#[derive(Clone, Copy, Debug)]
pub struct LocalFrame {
    north_radius_m: f64,
    east_radius_m: f64,
    elevation_m: f64,
}

impl LocalFrame {
    /// The frame of a runway at a height above mean sea level, m.
    pub fn new(elevation_m: f64) -> Self {
        let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
        let (sin, cos) = RUNWAY_LATITUDE_RAD.sin_cos();
        let w2 = 1.0 - eccentricity2 * sin * sin;
        let prime_vertical = SEMI_MAJOR_M / w2.sqrt();
        let meridian = prime_vertical * (1.0 - eccentricity2) / w2;
        Self {
            north_radius_m: meridian + elevation_m,
            east_radius_m: (prime_vertical + elevation_m) * cos,
            elevation_m,
        }
    }

    /// From NED (m) to latitude, longitude, height.
    pub fn to_geodetic(&self, position: &Vector3<f64>) -> Geodetic {
        Geodetic {
            latitude_rad: RUNWAY_LATITUDE_RAD + position.x / self.north_radius_m,
            longitude_rad: RUNWAY_LONGITUDE_RAD + position.y / self.east_radius_m,
            altitude_m: self.elevation_m - position.z,
        }
    }

    /// From latitude, longitude, height to NED (m).
    pub fn to_ned(&self, place: &Geodetic) -> Vector3<f64> {
        Vector3::new(
            (place.latitude_rad - RUNWAY_LATITUDE_RAD) * self.north_radius_m,
            (place.longitude_rad - RUNWAY_LONGITUDE_RAD) * self.east_radius_m,
            self.elevation_m - place.altitude_m,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_is_the_same_place() {
        let frame = LocalFrame::new(75.0);
        let position = Vector3::new(500.0, -321.0, -160.0);
        assert!((frame.to_ned(&frame.to_geodetic(&position)) - position).norm() < 1e-7);
    }

    #[test]
    fn one_minute_of_latitude_is_a_nautical_mile_or_so() {
        let place = LocalFrame::new(0.0).to_geodetic(&Vector3::new(1852.0, 0.0, 0.0));
        let minutes = (place.latitude_rad - RUNWAY_LATITUDE_RAD).to_degrees() * 60.0;
        assert!((minutes - 1.0).abs() < 0.003, "{minutes}");
    }
}
