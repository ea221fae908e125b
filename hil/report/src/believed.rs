//! The world as a faultless filter would see it: the truth, shifted by the errors that no filter can see.

use bateleur_simulator::truth::TruthRecord;
use nalgebra::Vector2;

/// Slower than this over ground, m/s, and touching it, the aircraft stands and the barometer is being zeroed.
const STANDING_SPEED_MPS: f64 = 3.0;

/// How the truth is shifted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Believed {
    /// Height comes from the receiver instead of the barometer.
    gps_height: bool,
    /// What of the barometer's bias its zeroing took away, m.
    zeroed_m: f64,
}

impl Believed {
    /// The shift of a flight. The barometer's zero is its mean bias while the aircraft stood before its take-off; a
    /// flight that begins in the air zeroes it against the receiver's height instead.
    pub fn of(truth: &[TruthRecord], pressure_aiding: bool) -> Self {
        let standing = truth.iter().take_while(|record| stands(record)).map(|record| record.barometer_bias_m);
        let (count, sum) = standing.fold((0_u32, 0.0), |(count, sum), bias| (count + 1, sum + bias));
        let in_air =
            || truth.first().map_or(0.0, |first| first.barometer_bias_m + first.gps_slow_error_ned_m[2]);
        let zeroed_m = if count > 0 { sum / f64::from(count) } else { in_air() };
        Self { gps_height: !pressure_aiding, zeroed_m }
    }

    /// North and east, m: true position plus the receiver's slow error.
    pub fn horizontal(&self, record: &TruthRecord) -> Vector2<f64> {
        let [north, east, _] = record.position_ned_m;
        let [slow_north, slow_east, _] = record.gps_slow_error_ned_m;
        Vector2::new(north + slow_north, east + slow_east)
    }

    /// Height above the runway, m: true height plus what the barometer's bias became since it was zeroed, or less the
    /// receiver's slow error where that carries the height.
    pub fn height_m(&self, record: &TruthRecord) -> f64 {
        let shift = if self.gps_height {
            -record.gps_slow_error_ned_m[2]
        } else {
            record.barometer_bias_m - self.zeroed_m
        };
        shift - record.position_ned_m[2]
    }
}

fn stands(record: &TruthRecord) -> bool {
    let [north, east, _] = record.velocity_ned_mps;
    record.on_ground != 0 && north.hypot(east) < STANDING_SPEED_MPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeroing_on_the_runway_takes_the_bias_away() {
        let standing = TruthRecord { on_ground: 1, barometer_bias_m: 2.0, ..Default::default() };
        let flying = TruthRecord {
            position_ned_m: [0.0, 0.0, -160.0],
            velocity_ned_mps: [22.0, 0.0, 0.0],
            gps_slow_error_ned_m: [3.0, -4.0, 5.0],
            barometer_bias_m: 2.5,
            ..Default::default()
        };
        let believed = Believed::of(&[standing, standing, flying], true);
        assert_eq!(believed.height_m(&flying), 160.5);
        assert_eq!(believed.horizontal(&flying), Vector2::new(3.0, -4.0));
        assert_eq!(Believed::of(&[standing, flying], false).height_m(&flying), 155.0);
        // Zeroed in the air against a receiver that reads 5 m too low.
        assert_eq!(Believed::of(&[flying], true).height_m(&flying), 155.0);
    }
}
