//! Finds an axis of an inertial sensor that repeats its value: a sensor that measures is never twice the same to the last bit.

use crate::kept::kept;
use nalgebra::Vector3;

/// So many times in a row, while another axis moves: a tenth of a second at 50 Hz.
const REPEATS: u8 = 5;

/// Accelerometer and gyroscope, forward, right, down.
pub const AXES: usize = 6;

/// [`Stuck::axes`]: the lateral force.
pub const LATERAL_FORCE: u32 = 2;
/// [`Stuck::axes`]: the pitch rate.
pub const PITCH_RATE: u32 = 16;
/// [`Stuck::axes`]: the roll rate.
pub const ROLL_RATE: u32 = 8;
/// [`Stuck::axes`]: the yaw rate.
pub const YAW_RATE: u32 = 32;

/// What each axis said last, and how often in a row.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stuck {
    last: [f64; AXES],
    repeats: [u8; AXES],
}

impl Stuck {
    /// Takes a sample: specific force (m/s²) and rates (rad/s).
    pub fn look(&mut self, force: &Vector3<f64>, rates: &Vector3<f64>) {
        let now = [force.x, force.y, force.z, rates.x, rates.y, rates.z];
        let now = now.map(|value| if value.is_finite() { value } else { 0.0 });
        for (axis, value) in now.into_iter().enumerate() {
            let same = value.to_bits() == self.last[axis].to_bits();
            self.repeats[axis] = if same { self.repeats[axis].saturating_add(1) } else { 0 };
        }
        self.last = now;
        if self.repeats.iter().all(|repeats| *repeats > 0) {
            self.repeats = [0; AXES]; // nothing moves at all: an ideal sensor that stands
        }
    }

    /// The axes that are stuck, one bit each: accelerometer 1, 2, 4, gyroscope 8, 16, 32.
    pub fn axes(&self) -> u32 {
        let bits = self.repeats.iter().enumerate().filter(|(_, repeats)| **repeats >= REPEATS);
        bits.fold(0, |all, (axis, _)| all | 1 << axis)
    }
}

kept!(Stuck { last: [f64; AXES], repeats: [u8; AXES] });

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_that_repeats_is_found_in_a_tenth_of_a_second_and_forgotten_when_it_moves() {
        for axis in 0..AXES {
            let mut stuck = Stuck::default();
            for sample in 0..6 {
                assert_eq!(stuck.axes(), 0, "axis {axis}, sample {sample}");
                let mut values = [0; AXES].map(|_: u32| 0.1 * f64::from(sample + 1));
                values[axis] = -9.8;
                stuck.look(&Vector3::from_row_slice(&values[..3]), &Vector3::from_row_slice(&values[3..]));
            }
            assert_eq!(stuck.axes(), 1 << axis);
            stuck.look(&Vector3::repeat(5.0), &Vector3::repeat(6.0));
            assert_eq!(stuck.axes(), 0);
        }
    }

    #[test]
    fn ideal_sensor_that_stands_is_not_stuck() {
        let mut stuck = Stuck::default();
        (0..100).for_each(|_| stuck.look(&Vector3::new(0.0, 0.0, -9.8), &Vector3::zeros()));
        assert_eq!(stuck.axes(), 0);
    }
}
