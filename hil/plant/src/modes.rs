//! Small motions about trimmed flight: the plant, linearised by differences, and its natural modes.

use crate::airframe::Airframe;
use crate::dynamics::Model;
use crate::rigid_body::RigidState;
use crate::trim::{self, CLEAR_M, Trim};
use nalgebra::{Complex, Matrix4, SMatrix, SVector, UnitQuaternion, Vector3};

/// u, w, q, θ, v, p, r, φ: what the aircraft does lengthwise first.
pub type SmallState = SVector<f64, 8>;
/// The derivative of each of them by each of them.
pub type SmallMotion = SMatrix<f64, 8, 8>;

/// Step of the differences, m/s and rad/s and rad: far above rounding, far below any curvature of the coefficients.
const STEP: f64 = 1e-5;

/// A natural mode of two roots, or of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Its roots, 1/s; the same twice for a mode of one root.
    pub roots: [Complex<f64>; 2],
}

impl Mode {
    fn pair(a: Complex<f64>, b: Complex<f64>) -> Self {
        Self { roots: [a, b] }
    }

    fn single(root: Complex<f64>) -> Self {
        Self { roots: [root, root] }
    }

    /// Whether it swings.
    pub fn swings(&self) -> bool {
        self.roots[0].im != 0.0
    }

    /// Natural frequency of a pair, √(λ₁ λ₂), rad/s; of one root its size, 1/s.
    pub fn frequency_radps(&self) -> f64 {
        (self.roots[0].norm() * self.roots[1].norm()).sqrt()
    }

    /// Damping ratio; above 1 for two real roots, negative for a mode that grows.
    pub fn damping(&self) -> f64 {
        -(self.roots[0].re + self.roots[1].re) / (2.0 * self.frequency_radps())
    }

    /// Time in which it dies away to 1/e, s; negative: in which it grows by e. Of two real roots the slower one.
    pub fn time_constant_s(&self) -> f64 {
        let slowest = self.roots[0].re.max(self.roots[1].re);
        -1.0 / slowest
    }
}

/// All modes of an aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modes {
    /// Fast swing of the angle of attack.
    pub short_period: Mode,
    /// Slow exchange of height and speed.
    pub phugoid: Mode,
    /// Swing of sideslip, roll and yaw.
    pub dutch_roll: Mode,
    /// Roll rate dying away; with `spiral` one pair where the two have joined.
    pub roll: Mode,
    /// Bank dying away or growing slowly.
    pub spiral: Mode,
}

/// Motion lengthwise: u, w, q, θ.
pub fn longitudinal(motion: &SmallMotion) -> Matrix4<f64> {
    motion.fixed_view::<4, 4>(0, 0).into_owned()
}

/// Motion sideways: v, p, r, φ.
pub fn lateral(motion: &SmallMotion) -> Matrix4<f64> {
    motion.fixed_view::<4, 4>(4, 4).into_owned()
}

impl Modes {
    /// The modes of a linear motion. The small coupling between lengthwise and sideways, which comes from the propeller's
    /// torque, is left out.
    pub fn of(motion: &SmallMotion) -> Self {
        Self::of_blocks(&longitudinal(motion), &lateral(motion))
    }

    /// The modes of the two motions, in any coordinates.
    pub fn of_blocks(longitudinal: &Matrix4<f64>, lateral: &Matrix4<f64>) -> Self {
        let lengthwise = sorted(longitudinal);
        let sideways = sorted(lateral);
        let (short_period, phugoid) =
            (Mode::pair(lengthwise[3], lengthwise[2]), Mode::pair(lengthwise[1], lengthwise[0]));
        let (dutch_roll, rest) = split_dutch_roll(sideways);
        let (roll, spiral) = if rest[0].im == 0.0 {
            (Mode::single(rest[1]), Mode::single(rest[0]))
        } else {
            (Mode::pair(rest[1], rest[0]), Mode::pair(rest[1], rest[0]))
        };
        Self { short_period, phugoid, dutch_roll, roll, spiral }
    }

    /// Each with its name.
    pub fn named(&self) -> [(&'static str, Mode); 5] {
        [
            ("short period", self.short_period),
            ("phugoid", self.phugoid),
            ("Dutch roll", self.dutch_roll),
            ("roll", self.roll),
            ("spiral", self.spiral),
        ]
    }
}

/// Roots by size, the smallest first.
fn sorted(matrix: &Matrix4<f64>) -> [Complex<f64>; 4] {
    let mut roots: [Complex<f64>; 4] = matrix.complex_eigenvalues().into();
    // Rounding leaves real roots a trace of an imaginary part.
    for root in &mut roots {
        if root.im.abs() < 1e-9 * (1.0 + root.norm()) {
            root.im = 0.0;
        }
    }
    roots.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
    roots
}

/// The pair that swings fastest (without one: the two middle roots), and the rest by size.
fn split_dutch_roll(roots: [Complex<f64>; 4]) -> (Mode, [Complex<f64>; 2]) {
    let fastest = (0..4).max_by(|a, b| roots[*a].im.abs().total_cmp(&roots[*b].im.abs())).unwrap_or(0);
    let of_pair = |index: usize| (roots[index].im.abs() - roots[fastest].im.abs()).abs() < 1e-9;
    let swinging = roots[fastest].im != 0.0;
    let (mut pair, mut rest) = (Vec::new(), Vec::new());
    for (index, root) in roots.into_iter().enumerate() {
        let belongs = if swinging { of_pair(index) } else { index == 1 || index == 2 };
        if belongs { pair.push(root) } else { rest.push(root) }
    }
    match (pair.as_slice(), rest.as_slice()) {
        ([a, b], [c, d]) => (Mode::pair(*a, *b), [*c, *d]),
        _ => (Mode::pair(roots[1], roots[2]), [roots[0], roots[3]]),
    }
}

/// The plant's motion about a trim at a height above mean sea level, m: central differences of the whole model, with the
/// controls held and the air as it is there.
pub fn linearise(airframe: &Airframe, trim: &Trim, altitude_m: f64) -> SmallMotion {
    let model = Model::new(airframe, altitude_m - CLEAR_M);
    let position = Vector3::new(0.0, 0.0, -CLEAR_M);
    let state = trim::flight_state(trim, 0.0, position);
    let velocity = state.attitude.inverse() * state.velocity;
    let (roll, pitch, yaw) = state.attitude.euler_angles();
    let middle = SmallState::from([velocity.x, velocity.z, 0.0, pitch, velocity.y, 0.0, 0.0, roll]);
    let derivative = |x: &SmallState| derivative(&model, trim, &position, yaw, x);
    let mut motion = SmallMotion::zeros();
    for column in 0..8 {
        let mut step = SmallState::zeros();
        step[column] = STEP;
        let slope = (derivative(&(middle + step)) - derivative(&(middle - step))) / (2.0 * STEP);
        motion.set_column(column, &slope);
    }
    motion
}

fn derivative(model: &Model, trim: &Trim, position: &Vector3<f64>, yaw: f64, x: &SmallState) -> SmallState {
    let [u, w, q, pitch, v, p, r, roll]: [f64; 8] = (*x).into();
    let (velocity, rates) = (Vector3::new(u, v, w), Vector3::new(p, q, r));
    let attitude = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    let state = RigidState { position: *position, velocity: attitude * velocity, attitude, rates };
    let rate = trim::steady_rate(model, &state, &trim.controls);
    let change = attitude.inverse() * rate.acceleration - rates.cross(&velocity);
    let (sin, cos) = roll.sin_cos();
    let pitch_rate = q * cos - r * sin;
    let roll_rate = p + (q * sin + r * cos) * pitch.tan();
    let turn = rate.angular;
    SmallState::from([change.x, change.z, turn.y, pitch_rate, change.y, turn.x, turn.z, roll_rate])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_of_a_known_pair_has_its_frequency_and_damping() {
        let mode = Mode::pair(Complex::new(-3.0, 4.0), Complex::new(-3.0, -4.0));
        assert!((mode.frequency_radps() - 5.0).abs() < 1e-12 && (mode.damping() - 0.6).abs() < 1e-12);
        assert!((mode.time_constant_s() - 1.0 / 3.0).abs() < 1e-12 && mode.swings());
        let growing = Mode::single(Complex::new(0.05, 0.0));
        assert!((growing.time_constant_s() + 20.0).abs() < 1e-9 && growing.damping() < 0.0);
    }

    #[test]
    fn modes_are_told_apart_whatever_the_order_of_the_roots() {
        let block = |real: f64, slow: f64, re: f64, im: f64| {
            Matrix4::new(
                real, 0.0, 0.0, 0.0, //
                0.0, re, im, 0.0, //
                0.0, -im, re, 0.0, //
                0.0, 0.0, 0.0, slow,
            )
        };
        let modes = Modes::of_blocks(&block(-9.0, -8.0, -0.02, 0.4), &block(-12.0, 0.03, -1.0, 5.0));
        assert!((modes.short_period.frequency_radps() - 72.0_f64.sqrt()).abs() < 1e-9);
        assert!((modes.phugoid.damping() - 0.02 / (0.4_f64 * 0.4 + 0.02 * 0.02).sqrt()).abs() < 1e-9);
        assert!((modes.dutch_roll.frequency_radps() - 26.0_f64.sqrt()).abs() < 1e-9);
        assert!((modes.roll.time_constant_s() - 1.0 / 12.0).abs() < 1e-9);
        assert!((modes.spiral.time_constant_s() + 1.0 / 0.03).abs() < 1e-6);
    }
}
