//! What outlives a warm restart: the filter's snapshot, as bytes that any pattern may fill.

use bateleur_flight::estimator::{Snapshot, TRIANGLE};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The ground has disabled the function.
const DISABLED: u64 = 1;

/// A snapshot and whether the function is on.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    mode: u64,
    layout: u64,
    time_s: f64,
    quaternion: [f64; 4],
    velocity: [f64; 3],
    position: [f64; 3],
    gyro_bias: [f64; 3],
    accel_bias: [f64; 3],
    mag_bias: [f64; 3],
    wind: [f64; 2],
    barometer_offset: f64,
    covariance: [f64; TRIANGLE],
}

impl Kept {
    /// What to keep; without a snapshot, only whether the function is disabled.
    pub fn new(snapshot: Option<&Snapshot>, disabled: bool) -> Self {
        let s = snapshot.copied().unwrap_or_default();
        Self {
            mode: if disabled { DISABLED } else { 0 },
            layout: s.layout,
            time_s: s.time_s,
            quaternion: s.quaternion,
            velocity: s.velocity,
            position: s.position,
            gyro_bias: s.gyro_bias,
            accel_bias: s.accel_bias,
            mag_bias: s.mag_bias,
            wind: s.wind,
            barometer_offset: s.barometer_offset,
            covariance: s.covariance,
        }
    }

    /// The same, disabled.
    pub fn disabled(&self) -> Self {
        Self { mode: DISABLED, ..*self }
    }

    /// Whether the function was disabled.
    pub fn is_disabled(&self) -> bool {
        self.mode == DISABLED
    }

    /// The snapshot, which may hold anything: the filter checks it.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            layout: self.layout,
            time_s: self.time_s,
            quaternion: self.quaternion,
            velocity: self.velocity,
            position: self.position,
            gyro_bias: self.gyro_bias,
            accel_bias: self.accel_bias,
            mag_bias: self.mag_bias,
            wind: self.wind,
            barometer_offset: self.barometer_offset,
            covariance: self.covariance,
        }
    }
}
