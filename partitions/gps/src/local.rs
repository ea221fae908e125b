//! Metres from the runway.
//!
//! The ground around the runway is taken as flat, with the two radii of curvature of the WGS-84 ellipsoid at the
//! runway. Against the exact tangent plane that is 0.3 m wrong at 2 km, by the earth's curvature, in height alone
//! (where the height above the ground is what an aircraft wants).

/// Semi-major axis of WGS-84, m.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Flattening of WGS-84.
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// The runway: where north, east and down are counted from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Origin {
    /// Latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Height above mean sea level, m.
    pub altitude_m: f64,
}

impl Default for Origin {
    /// The seed's runway, 34°02'47.778" S, 18°44'25.072" E, at sea level.
    fn default() -> Self {
        Self {
            latitude_deg: -(34.0 + 2.0 / 60.0 + 47.778 / 3600.0),
            longitude_deg: 18.0 + 44.0 / 60.0 + 25.072 / 3600.0,
            altitude_m: 0.0,
        }
    }
}

impl Origin {
    /// On the earth, away from the poles, where east has no meaning, and no higher than runways are.
    pub fn is_sane(&self) -> bool {
        self.latitude_deg.abs() < 85.0
            && self.longitude_deg.abs() <= 180.0
            && (-500.0..6_000.0).contains(&self.altitude_m)
    }
}

/// North, east and down axes from a runway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFrame {
    latitude_rad: f64,
    longitude_rad: f64,
    altitude_m: f64,
    metres_north_per_rad: f64,
    metres_east_per_rad: f64,
}

impl LocalFrame {
    /// The axes of a runway.
    pub fn new(origin: &Origin) -> Self {
        let latitude_rad = origin.latitude_deg.to_radians();
        let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
        let shrink = 1.0 - eccentricity2 * latitude_rad.sin().powi(2);
        let east_west_m = SEMI_MAJOR_M / shrink.sqrt();
        let north_south_m = east_west_m * (1.0 - eccentricity2) / shrink;
        Self {
            latitude_rad,
            longitude_rad: origin.longitude_deg.to_radians(),
            altitude_m: origin.altitude_m,
            metres_north_per_rad: north_south_m + origin.altitude_m,
            metres_east_per_rad: (east_west_m + origin.altitude_m) * latitude_rad.cos(),
        }
    }

    /// A place (rad, rad, m above mean sea level) as metres north, east and down.
    pub fn ned_m(&self, latitude_rad: f64, longitude_rad: f64, altitude_m: f64) -> [f64; 3] {
        [
            (latitude_rad - self.latitude_rad) * self.metres_north_per_rad,
            half_turn(longitude_rad - self.longitude_rad) * self.metres_east_per_rad,
            self.altitude_m - altitude_m,
        ]
    }
}

/// An angle (rad) the short way round, so that a flight may cross the date line.
fn half_turn(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle_rad > PI {
        angle_rad - TAU
    } else if angle_rad < -PI {
        angle_rad + TAU
    } else {
        angle_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Earth-centred coordinates, m.
    fn earth(latitude: f64, longitude: f64, height: f64) -> [f64; 3] {
        let e2 = FLATTENING * (2.0 - FLATTENING);
        let n = SEMI_MAJOR_M / (1.0 - e2 * latitude.sin().powi(2)).sqrt();
        [
            (n + height) * latitude.cos() * longitude.cos(),
            (n + height) * latitude.cos() * longitude.sin(),
            (n * (1.0 - e2) + height) * latitude.sin(),
        ]
    }

    /// Exact tangent plane: north and east, m.
    fn tangent(origin: &Origin, latitude: f64, longitude: f64, height: f64) -> [f64; 2] {
        let (lat, lon) = (origin.latitude_deg.to_radians(), origin.longitude_deg.to_radians());
        let (from, to) = (earth(lat, lon, origin.altitude_m), earth(latitude, longitude, height));
        let d: Vec<f64> = to.iter().zip(from).map(|(to, from)| to - from).collect();
        let north = -lat.sin() * lon.cos() * d[0] - lat.sin() * lon.sin() * d[1] + lat.cos() * d[2];
        [north, -lon.sin() * d[0] + lon.cos() * d[1]]
    }

    #[test]
    fn flat_ground_is_right_within_half_a_metre_over_two_kilometres() {
        let origin = Origin { altitude_m: 90.0, ..Origin::default() };
        let frame = LocalFrame::new(&origin);
        for (north_s, east_s) in [(64.8, 0.0), (0.0, 78.0), (45.0, -55.0), (-45.0, 55.0), (-64.8, -20.0)] {
            let latitude = (origin.latitude_deg + north_s / 3600.0).to_radians();
            let longitude = (origin.longitude_deg + east_s / 3600.0).to_radians();
            let [north, east, down] = frame.ned_m(latitude, longitude, 250.0);
            let exact = tangent(&origin, latitude, longitude, 250.0);
            assert!(north.hypot(east) > 1_000.0);
            assert!((north - exact[0]).abs() < 0.5, "north {north} {exact:?}");
            assert!((east - exact[1]).abs() < 0.5, "east {east} {exact:?}");
            assert_eq!(down, -160.0);
        }
    }

    #[test]
    fn the_date_line_is_no_wall() {
        let frame = LocalFrame::new(&Origin { longitude_deg: 179.999, latitude_deg: 0.0, altitude_m: 0.0 });
        let [_, east, _] = frame.ned_m(0.0, (-179.999_f64).to_radians(), 0.0);
        assert!((east - 222.6).abs() < 0.1, "{east}");
    }

    #[test]
    fn a_pole_is_no_runway() {
        assert!(Origin::default().is_sane());
        assert!(!Origin { latitude_deg: 90.0, ..Origin::default() }.is_sane());
        assert!(!Origin { longitude_deg: f64::NAN, ..Origin::default() }.is_sane());
    }
}
