//! Places on the earth as metres from the runway, and back: ground stations think in degrees.
//!
//! The same tangent plane as that of the function GPS, so that both speak of the same metre.

use std::f64::consts::{PI, TAU};

/// WGS 84: equatorial radius, m, and flattening.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Degrees in one unit of the messages.
const UNIT_DEG: f64 = 1e-7;

/// The runway, and the axes north, east, down from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Runway {
    /// Latitude, degrees.
    pub latitude_deg: f64,
    /// Longitude, degrees.
    pub longitude_deg: f64,
    /// Height above mean sea level, m.
    pub altitude_m: f64,
}

impl Default for Runway {
    /// That of the function GPS.
    fn default() -> Self {
        Self {
            latitude_deg: -(34.0 + 2.0 / 60.0 + 47.778 / 3600.0),
            longitude_deg: 18.0 + 44.0 / 60.0 + 25.072 / 3600.0,
            altitude_m: 0.0,
        }
    }
}

impl Runway {
    /// Metres in a radian of latitude and of longitude.
    fn metres_per_rad(&self) -> (f64, f64) {
        let latitude_rad = self.latitude_deg.to_radians();
        let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
        let shrink = 1.0 - eccentricity2 * latitude_rad.sin().powi(2);
        let east_west_m = SEMI_MAJOR_M / shrink.sqrt();
        let north_south_m = east_west_m * (1.0 - eccentricity2) / shrink;
        (north_south_m + self.altitude_m, (east_west_m + self.altitude_m) * latitude_rad.cos())
    }

    /// Latitude and longitude, 10⁻⁷ degrees, of a place in metres north and east.
    pub fn units(&self, north_m: f64, east_m: f64) -> (i32, i32) {
        let (north_per_rad, east_per_rad) = self.metres_per_rad();
        let latitude = self.latitude_deg + (north_m / north_per_rad).to_degrees();
        let longitude = self.longitude_deg + (east_m / east_per_rad).to_degrees();
        // The casts saturate.
        ((latitude / UNIT_DEG).round() as i32, (longitude / UNIT_DEG).round() as i32)
    }

    /// Metres north and east of a place in degrees.
    pub fn metres(&self, latitude_deg: f64, longitude_deg: f64) -> (f64, f64) {
        let (north_per_rad, east_per_rad) = self.metres_per_rad();
        let north_rad = (latitude_deg - self.latitude_deg).to_radians();
        let turn = (longitude_deg - self.longitude_deg).to_radians();
        let east_rad = (turn + PI).rem_euclid(TAU) - PI;
        (north_rad * north_per_rad, east_rad * east_per_rad)
    }

    /// The same of a place in 10⁻⁷ degrees.
    pub fn metres_of_units(&self, latitude: i32, longitude: i32) -> (f64, f64) {
        self.metres(f64::from(latitude) * UNIT_DEG, f64::from(longitude) * UNIT_DEG)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_comes_back_within_a_centimetre() {
        let runway = Runway::default();
        for (north_m, east_m) in [(0.0, 0.0), (500.0, 0.0), (0.0, -500.0), (1_234.5, 987.6)] {
            let (latitude, longitude) = runway.units(north_m, east_m);
            let (north, east) = runway.metres_of_units(latitude, longitude);
            assert!((north - north_m).abs() < 0.01 && (east - east_m).abs() < 0.01, "{north} {east}");
        }
    }

    #[test]
    fn half_a_kilometre_north_is_as_many_degrees_as_surveyors_say() {
        // A minute of latitude at 34° is 1849 m.
        let (latitude, _) = Runway::default().units(1_848.8, 0.0);
        let minutes = (f64::from(latitude) * UNIT_DEG - Runway::default().latitude_deg) * 60.0;
        assert!((minutes - 1.0).abs() < 0.001, "{minutes}");
    }
}
