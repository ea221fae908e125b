//! Small helpers on angles, rotations and vectors.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// The angle brought into (−π, π].
pub fn wrap_angle(angle_rad: f64) -> f64 {
    let wrapped = (angle_rad + PI).rem_euclid(2.0 * PI) - PI;
    if wrapped == -PI { PI } else { wrapped }
}

/// The matrix `[v]×` with `[v]× w = v × w`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Roll, pitch, yaw (rad, 3-2-1 sequence) of a body-to-NED quaternion.
pub fn euler(quaternion: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (roll, pitch, yaw) = quaternion.euler_angles();
    Vector3::new(roll, pitch, yaw)
}

/// The body-to-NED quaternion of roll, pitch, yaw (rad).
pub fn from_euler(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(roll_rad, pitch_rad, yaw_rad)
}

/// One first-order low-pass step: `value` moves towards `target` with time constant `tau_s` over `dt_s`.
pub fn low_pass(value: f64, target: f64, tau_s: f64, dt_s: f64) -> f64 {
    value + (target - value) * (1.0 - (-dt_s / tau_s).exp())
}

/// Whether all three components are finite numbers.
pub(crate) fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapped_angles_stay_within_half_a_turn() {
        assert!((wrap_angle(1.5 * PI) + 0.5 * PI).abs() < 1e-12);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-12);
        assert!((wrap_angle(0.3 + 6.0 * PI) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn skew_is_the_cross_product() {
        let (a, b) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 4.0, -1.0));
        assert!((skew(&a) * b - a.cross(&b)).norm() < 1e-12);
    }

    #[test]
    fn euler_angles_go_there_and_back() {
        let angles = euler(&from_euler(0.4, -0.2, 2.9));
        assert!((angles - Vector3::new(0.4, -0.2, 2.9)).norm() < 1e-12);
    }
}
