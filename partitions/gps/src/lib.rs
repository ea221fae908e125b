//! The function that turns a receiver's raw fixes into position and velocity.
//!
//! Responsible for: one [`GpsPosition`] and one [`GpsVelocity`] for each usable fix, with the position also as metres
//! north, east and down of the runway. It must never pass on what the receiver itself does not believe (no
//! three-dimensional fix), what is not a number, or the same fix twice. It does not know which receiver it is.

mod local;
mod settings;

pub use local::{LocalFrame, Origin};
pub use settings::{origin, parameters};

use bateleur_messages::telemetry::GpsTelemetry;
use bateleur_messages::{GpsPosition, GpsVelocity, RawGps};

/// The least [`RawGps::fix`] with a height in it.
const THREE_DIMENSIONS: u32 = 3;
/// Faster than any aircraft that this computer flies, m/s; a receiver that says so is broken.
const FASTEST_MPS: f64 = 500.0;
/// Highest and lowest believable height, m.
const HEIGHTS_M: std::ops::Range<f64> = -1_000.0..20_000.0;

/// What became of the fixes so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Passed on.
    pub accepted: u64,
    /// No three-dimensional fix, not a number, or out of range.
    pub refused: u64,
}

/// The function.
#[derive(Debug)]
pub struct Gps {
    frame: LocalFrame,
    latest: Option<(GpsPosition, GpsVelocity)>,
    counters: Counters,
}

impl Gps {
    /// A function that measures from `origin`.
    pub fn new(origin: &Origin) -> Self {
        Self { frame: LocalFrame::new(origin), latest: None, counters: Counters::default() }
    }

    /// Takes what the receiver said last; gives the two measurements when it is a new and usable fix.
    pub fn take(&mut self, raw: &RawGps) -> Option<(GpsPosition, GpsVelocity)> {
        if self.latest.is_some_and(|(position, _)| raw.measured_ns == position.measured_ns) {
            return None; // the same fix again
        }
        if !usable(raw) {
            self.counters.refused += 1;
            return None;
        }
        self.counters.accepted += 1;
        let fix = (self.position(raw), self.velocity(raw));
        self.latest = Some(fix);
        Some(fix)
    }

    /// What became of the fixes so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The last fix for the ground; nothing before the first.
    pub fn telemetry(&self) -> Option<GpsTelemetry> {
        let (position, velocity) = self.latest?;
        Some(GpsTelemetry {
            measured_ns: position.measured_ns,
            latitude_rad: position.latitude_rad,
            longitude_rad: position.longitude_rad,
            altitude_m: position.altitude_m,
            velocity_ned_mps: velocity.velocity_ned_mps,
            count: position.count,
        })
    }

    fn position(&self, raw: &RawGps) -> GpsPosition {
        GpsPosition {
            measured_ns: raw.measured_ns,
            latitude_rad: raw.latitude_rad,
            longitude_rad: raw.longitude_rad,
            altitude_m: raw.altitude_m,
            position_ned_m: self.frame.ned_m(raw.latitude_rad, raw.longitude_rad, raw.altitude_m),
            horizontal_accuracy_m: raw.horizontal_accuracy_m,
            vertical_accuracy_m: raw.vertical_accuracy_m,
            count: self.counters.accepted,
        }
    }

    fn velocity(&self, raw: &RawGps) -> GpsVelocity {
        GpsVelocity {
            measured_ns: raw.measured_ns,
            velocity_ned_mps: raw.velocity_ned_mps,
            speed_accuracy_mps: raw.speed_accuracy_mps,
            count: self.counters.accepted,
        }
    }
}

fn usable(raw: &RawGps) -> bool {
    let accuracies = [raw.horizontal_accuracy_m, raw.vertical_accuracy_m, raw.speed_accuracy_mps];
    raw.fix >= THREE_DIMENSIONS
        && raw.latitude_rad.abs() <= std::f64::consts::FRAC_PI_2
        && raw.longitude_rad.abs() <= std::f64::consts::PI
        && HEIGHTS_M.contains(&raw.altitude_m)
        && raw.velocity_ned_mps.iter().all(|speed| speed.abs() <= FASTEST_MPS)
        && accuracies.iter().all(|accuracy| accuracy.is_finite() && *accuracy >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(measured_ns: u64) -> RawGps {
        let origin = Origin::default();
        RawGps {
            measured_ns,
            latitude_rad: origin.latitude_deg.to_radians(),
            longitude_rad: origin.longitude_deg.to_radians(),
            altitude_m: 160.0,
            velocity_ned_mps: [22.0, 0.0, -1.0],
            satellites: 9,
            fix: 3,
            ..RawGps::default()
        }
    }

    #[test]
    fn a_fix_over_the_runway_is_straight_up() {
        let (position, velocity) = Gps::new(&Origin::default()).take(&fix(1)).unwrap();
        let [north, east, down] = position.position_ned_m;
        assert!(north.abs() < 1e-6 && east.abs() < 1e-6);
        assert_eq!(down, -160.0);
        assert_eq!((position.count, velocity.count), (1, 1));
        assert_eq!(velocity.velocity_ned_mps, [22.0, 0.0, -1.0]);
    }

    #[test]
    fn the_same_fix_again_gives_nothing_and_is_no_fault() {
        let mut gps = Gps::new(&Origin::default());
        assert!(gps.take(&fix(5)).is_some());
        assert!(gps.take(&fix(5)).is_none());
        assert_eq!(gps.counters(), Counters { accepted: 1, refused: 0 });
        assert_eq!(gps.take(&fix(6)).unwrap().0.count, 2);
    }

    #[test]
    fn no_fix_numbers_that_are_none_and_absurd_values_are_refused() {
        let mut gps = Gps::new(&Origin::default());
        let bad = [
            RawGps { fix: 2, ..fix(1) },
            RawGps { latitude_rad: f64::NAN, ..fix(2) },
            RawGps { longitude_rad: 4.0, ..fix(3) },
            RawGps { altitude_m: f64::INFINITY, ..fix(4) },
            RawGps { velocity_ned_mps: [0.0, f64::NAN, 0.0], ..fix(5) },
            RawGps { horizontal_accuracy_m: -1.0, ..fix(6) },
        ];
        for raw in &bad {
            assert!(gps.take(raw).is_none(), "{raw:?}");
        }
        assert_eq!(gps.counters(), Counters { accepted: 0, refused: 6 });
        assert_eq!(gps.telemetry(), None);
    }

    #[test]
    fn a_receiver_whose_clock_was_set_back_is_heard() {
        let mut gps = Gps::new(&Origin::default());
        assert!(gps.take(&fix(u64::MAX)).is_some());
        assert!(gps.take(&fix(20_000_000)).is_some());
    }

    #[test]
    fn a_bad_fix_does_not_hide_the_next_good_one() {
        let mut gps = Gps::new(&Origin::default());
        assert!(gps.take(&RawGps { altitude_m: f64::NAN, ..fix(u64::MAX) }).is_none());
        assert!(gps.take(&fix(20_000_000)).is_some());
        assert_eq!(gps.telemetry().unwrap().measured_ns, 20_000_000);
    }
}
