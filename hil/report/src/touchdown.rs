//! The touch-down of a landing, by the simulator's truth.

use bateleur_simulator::truth::TruthRecord;
use serde::{Deserialize, Serialize};

use crate::believed::Believed;
use crate::flight::seconds;

/// In the air for so long, ns, before it touched the ground: a bounce is none.
const FLIGHT_NS: u64 = 20_000_000_000;
/// It stands slower than this over ground, m/s.
const STANDING_MPS: f64 = 1.5;

/// How the aircraft met the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Touchdown {
    /// When, s.
    pub time_s: f64,
    /// Sink rate, m/s.
    pub sink_mps: f64,
    /// Speed over ground, m/s.
    pub speed_mps: f64,
    /// Bank, °.
    pub bank_deg: f64,
    /// Distance from the runway's origin along the ground track, m; negative: too short. Without the receiver's slow error.
    pub along_m: f64,
    /// The same across, m, right positive.
    pub across_m: f64,
    /// When it stood, s; `None`: not within the record.
    pub standing_s: Option<f64>,
}

impl Touchdown {
    /// The first contact after a flight, of a record that ends on the ground.
    pub(crate) fn of(truth: &[TruthRecord], believed: &Believed) -> Option<Self> {
        if truth.last()?.on_ground == 0 {
            return None;
        }
        let mut left_ns = None;
        let mut place = None;
        for (index, pair) in truth.windows(2).enumerate() {
            match (pair[0].on_ground != 0, pair[1].on_ground != 0) {
                (true, false) if left_ns.is_none() => left_ns = Some(pair[1].time_ns),
                (false, true) if left_ns.is_some_and(|left_ns| pair[1].time_ns > left_ns + FLIGHT_NS) => {
                    place.get_or_insert(index);
                }
                _ => {}
            }
        }
        let before = &truth[place?];
        let [north_mps, east_mps, down_mps] = before.velocity_ned_mps;
        let speed_mps = north_mps.hypot(east_mps);
        let at = believed.horizontal(before);
        let (north, east) = (north_mps / speed_mps.max(0.1), east_mps / speed_mps.max(0.1));
        let stands = |record: &&TruthRecord| {
            record.on_ground != 0
                && record.velocity_ned_mps[0].hypot(record.velocity_ned_mps[1]) < STANDING_MPS
        };
        Some(Self {
            time_s: seconds(before.time_ns),
            sink_mps: down_mps,
            speed_mps,
            bank_deg: before.euler_rad[0].to_degrees(),
            along_m: at.x * north + at.y * east,
            across_m: at.y * north - at.x * east,
            standing_s: truth[place?..].iter().find(stands).map(|record| seconds(record.time_ns)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(time_s: u64, on_ground: u8, north_m: f64, velocity: [f64; 3]) -> TruthRecord {
        TruthRecord {
            time_ns: time_s * 1_000_000_000,
            on_ground: on_ground.into(),
            position_ned_m: [north_m, 3.0, 0.0],
            velocity_ned_mps: velocity,
            ..TruthRecord::default()
        }
    }

    #[test]
    fn first_contact_of_a_landing_counts_and_a_flight_that_ends_in_the_air_has_none() {
        let flown = [
            record(0, 1, 0.0, [0.0; 3]),
            record(5, 0, 50.0, [20.0, 0.0, -2.0]),
            record(60, 0, -12.0, [16.0, 0.0, 0.7]),
            record(61, 1, 4.0, [15.0, 0.0, 0.1]),
            record(62, 0, 20.0, [15.0, 0.0, -0.1]),
            record(63, 1, 30.0, [14.0, 0.0, 0.3]),
            record(80, 1, 100.0, [0.0; 3]),
        ];
        let touchdown = Touchdown::of(&flown, &Believed::default()).unwrap();
        let found = (touchdown.sink_mps, touchdown.along_m, touchdown.across_m, touchdown.standing_s);
        assert_eq!(found, (0.7, -12.0, 3.0, Some(80.0)));
        assert!(Touchdown::of(&flown[..3], &Believed::default()).is_none());
    }
}
