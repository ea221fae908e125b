//! What a partition keeps in retained memory to come back from a restart.

use super::filter::{Covariance, ERROR_STATES, Filter, Nominal};
use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};

/// Length of the upper triangle of the covariance.
pub const TRIANGLE: usize = ERROR_STATES * (ERROR_STATES + 1) / 2;
/// Marks a snapshot as one of this layout; zeroed memory is none.
const LAYOUT: u64 = 0x4241_5445_0000_0001;

/// State and covariance as plain numbers: fixed size, no padding, no pointer.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Snapshot {
    /// Layout mark.
    pub layout: u64,
    /// Time of the state, s.
    pub time_s: f64,
    /// Body-to-NED quaternion, w x y z.
    pub quaternion: [f64; 4],
    /// NED, m/s.
    pub velocity: [f64; 3],
    /// NED, m.
    pub position: [f64; 3],
    /// rad/s.
    pub gyro_bias: [f64; 3],
    /// m/s².
    pub accel_bias: [f64; 3],
    /// gauss.
    pub mag_bias: [f64; 3],
    /// North and east, m/s.
    pub wind: [f64; 2],
    /// Pressure altitude of the runway, m; NaN while unknown.
    pub barometer_offset: f64,
    /// Upper triangle of the covariance, row by row.
    pub covariance: [f64; TRIANGLE],
}

impl Default for Snapshot {
    /// An empty one: `usable` is false.
    fn default() -> Self {
        Self {
            layout: 0,
            time_s: 0.0,
            quaternion: [0.0; 4],
            velocity: [0.0; 3],
            position: [0.0; 3],
            gyro_bias: [0.0; 3],
            accel_bias: [0.0; 3],
            mag_bias: [0.0; 3],
            wind: [0.0; 2],
            barometer_offset: f64::NAN,
            covariance: [0.0; TRIANGLE],
        }
    }
}

impl Snapshot {
    pub(crate) fn of(filter: &Filter, time_s: f64, barometer_offset: Option<f64>) -> Self {
        let n = &filter.nominal;
        let q = n.attitude.quaternion();
        let mut covariance = [0.0; TRIANGLE];
        for (value, (i, j)) in covariance.iter_mut().zip(upper()) {
            *value = filter.covariance[(i, j)];
        }
        Self {
            layout: LAYOUT,
            time_s,
            quaternion: [q.w, q.i, q.j, q.k],
            velocity: n.velocity.into(),
            position: n.position.into(),
            gyro_bias: n.gyro_bias.into(),
            accel_bias: n.accel_bias.into(),
            mag_bias: n.mag_bias.into(),
            wind: n.wind.into(),
            barometer_offset: barometer_offset.unwrap_or(f64::NAN),
            covariance,
        }
    }

    /// Whether it holds a whole, finite state. A partition killed while writing leaves one that does not pass, or
    /// one that mixes two frames, which the filter's gates then sort out.
    pub fn usable(&self) -> bool {
        self.layout == LAYOUT
            && self.time_s.is_finite()
            && self.filter().is_some_and(|filter| filter.healthy())
    }

    pub(crate) fn filter(&self) -> Option<Filter> {
        let [w, i, j, k] = self.quaternion;
        let attitude = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 0.5)?;
        let nominal = Nominal {
            attitude,
            velocity: Vector3::from(self.velocity),
            position: Vector3::from(self.position),
            gyro_bias: Vector3::from(self.gyro_bias),
            accel_bias: Vector3::from(self.accel_bias),
            mag_bias: Vector3::from(self.mag_bias),
            wind: Vector2::from(self.wind),
        };
        let mut filter = Filter::new(nominal, &super::filter::ErrorVector::zeros());
        let mut covariance = Covariance::zeros();
        for (value, (i, j)) in self.covariance.iter().zip(upper()) {
            covariance[(i, j)] = *value;
            covariance[(j, i)] = *value;
        }
        filter.covariance = covariance;
        Some(filter)
    }

    pub(crate) fn barometer_offset(&self) -> Option<f64> {
        self.barometer_offset.is_finite().then_some(self.barometer_offset)
    }
}

/// Indices of the upper triangle, row by row.
fn upper() -> impl Iterator<Item = (usize, usize)> {
    (0..ERROR_STATES).flat_map(|i| (i..ERROR_STATES).map(move |j| (i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::filter::ErrorVector;

    #[test]
    fn snapshot_brings_back_the_same_filter() {
        let nominal = Nominal { velocity: Vector3::new(1.0, 2.0, 3.0), ..Nominal::default() };
        let filter = Filter::new(nominal, &ErrorVector::from_fn(|i, _| 0.1 + i as f64));
        let snapshot = Snapshot::of(&filter, 4.0, Some(60.0));
        assert!(snapshot.usable());
        let back = snapshot.filter().unwrap();
        assert_eq!(back.nominal, filter.nominal);
        assert_eq!(back.covariance, filter.covariance);
    }

    #[test]
    fn empty_and_broken_snapshots_are_not_usable() {
        assert!(!Snapshot::default().usable());
        let filter = Filter::new(Nominal::default(), &ErrorVector::repeat(1.0));
        let mut broken = Snapshot::of(&filter, 0.0, None);
        broken.velocity[1] = f64::NAN;
        assert!(!broken.usable());
    }
}
