//! The motion after a kick against the modes that follow from the derivatives on paper.
#![expect(clippy::unwrap_used, reason = "a panic in a test is a failed test")]

use bateleur_plant::{
    Airframe, Conditions, Controls, FlightStart, STEP_S, SensorErrors, Simulation, Truth, trim,
};
use nalgebra::{Complex, DMatrix, Matrix4, Vector4};

const AIRSPEED_MPS: f64 = 22.0;

/// Flies a kick of 60 ms, waits until the surfaces are back, and records a part of the truth at every step.
fn after_kick<const N: usize>(
    airframe: &Airframe,
    kick: Controls,
    steps: usize,
    record: impl Fn(&Truth) -> [f64; N],
) -> (Vec<[f64; N]>, Truth) {
    let conditions = Conditions { sensors: SensorErrors::none(), ..Conditions::default() };
    let trimmed = trim(airframe, AIRSPEED_MPS, 0.0, 160.0).unwrap().controls;
    let mut plant = Simulation::in_flight(airframe, &conditions, &FlightStart::default()).unwrap();
    let start = plant.truth();
    let kicked = Controls {
        aileron_rad: trimmed.aileron_rad + kick.aileron_rad,
        elevator_rad: trimmed.elevator_rad + kick.elevator_rad,
        rudder_rad: trimmed.rudder_rad + kick.rudder_rad,
        ..trimmed
    };
    plant.advance(kicked, 0.06);
    plant.advance(trimmed, 0.14);
    let series = (0..steps).map(|_| {
        plant.advance(trimmed, STEP_S);
        record(&plant.truth())
    });
    (series.collect(), start)
}

/// Roots (1/s) of the linear motion x' = A x + c that fits a series best.
fn fitted_roots<const N: usize>(series: &[[f64; N]]) -> Vec<Complex<f64>> {
    let n = series.len() - 1;
    let now = DMatrix::from_fn(n, N + 1, |i, j| if j < N { series[i][j] } else { 1.0 });
    let next = DMatrix::from_fn(n, N, |i, j| series[i + 1][j]);
    let fit = now.svd(true, true).solve(&next, 1e-14).unwrap();
    let map = fit.rows(0, N).transpose();
    map.complex_eigenvalues().iter().map(|z| z.ln() / STEP_S).collect()
}

#[test]
fn short_period_has_the_frequency_of_its_derivatives() {
    // The Rascal's is damped so heavily (both roots nearly equal) that its frequency is read less sharply.
    for (airframe, room) in [(Airframe::aerosonde(), 0.01), (Airframe::rascal110(), 0.03)] {
        let kick = Controls { elevator_rad: -0.005, ..Controls::default() };
        let (series, start) = after_kick(&airframe, kick, 120, |t| [t.alpha_rad, t.rates_radps.y]);
        let roots = fitted_roots(&series);
        let measured = (roots[0] * roots[1]).norm().sqrt();
        let expected = short_period(&airframe, &start);
        println!("{}: short period {measured:.3} rad/s, on paper {expected:.3} rad/s", airframe.name);
        assert!((measured / expected - 1.0).abs() < room, "{measured} rad/s against {expected} rad/s");
    }
}

/// Natural frequency of the two-state approximation, rad/s.
fn short_period(airframe: &Airframe, at: &Truth) -> f64 {
    let (a, g, m) = (&airframe.aerodynamics, &airframe.geometry, &airframe.mass);
    let v = AIRSPEED_MPS;
    let area = 0.5 * at.density_kgpm3 * v * v * g.wing_area_m2;
    let chord = g.mean_chord_m / (2.0 * v);
    let pitch = area * g.mean_chord_m / m.inertia_yy_kgm2;
    // d alpha/dt = -lift_slope alpha + turn q; dq/dt = pitch (C_ma alpha + (C_mq q + C_mad d alpha/dt) c / 2V)
    let lift_slope = (area * a.lift_alpha + at.thrust_n) / (m.mass_kg * v);
    let turn = 1.0 - area * a.lift_pitch_rate * chord / (m.mass_kg * v);
    let stiffness = pitch * (a.pitch_alpha - a.pitch_alpha_rate * chord * lift_slope);
    let damping = pitch * chord * (a.pitch_pitch_rate + a.pitch_alpha_rate * turn);
    (-stiffness * turn - lift_slope * damping).sqrt()
}

/// Lateral motion on paper: the derivative of sideslip, roll rate, yaw rate and roll by themselves, 1/s.
fn lateral_matrix(airframe: &Airframe, at: &Truth) -> Matrix4<f64> {
    let (a, g, m) = (&airframe.aerodynamics, &airframe.geometry, &airframe.mass);
    let v = AIRSPEED_MPS;
    let area = 0.5 * at.density_kgpm3 * v * v * g.wing_area_m2;
    let (moment, reduced) = (area * g.wing_span_m, g.wing_span_m / (2.0 * v));
    let roll = [a.roll_beta, a.roll_roll_rate * reduced, a.roll_yaw_rate * reduced].map(|c| c * moment);
    let yaw = [a.yaw_beta, a.yaw_roll_rate * reduced, a.yaw_yaw_rate * reduced].map(|c| c * moment);
    let (xx, zz, xz) = (m.inertia_xx_kgm2, m.inertia_zz_kgm2, m.inertia_xz_kgm2);
    let det = xx * zz - xz * xz;
    let p = |i: usize| (zz * roll[i] + xz * yaw[i]) / det;
    let r = |i: usize| (xz * roll[i] + xx * yaw[i]) / det;
    let (sin, cos) = at.alpha_rad.sin_cos();
    #[rustfmt::skip]
    let matrix = Matrix4::new(
        area * a.side_beta / (m.mass_kg * v), sin, -cos, 9.80665 * at.pitch_rad.cos() / v,
        p(0), p(1), p(2), 0.0,
        r(0), r(1), r(2), 0.0,
        0.0, 1.0, at.pitch_rad.tan(), 0.0,
    );
    matrix
}

/// Natural frequency of the pair that oscillates fastest, rad/s.
fn dutch_roll(roots: &[Complex<f64>]) -> f64 {
    roots.iter().max_by(|a, b| a.im.total_cmp(&b.im)).unwrap().norm()
}

fn lateral(t: &Truth) -> [f64; 4] {
    [t.beta_rad, t.rates_radps.x, t.rates_radps.z, t.roll_rad]
}

#[test]
fn dutch_roll_has_the_frequency_of_its_derivatives() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        let rudder = Controls { rudder_rad: 0.01, ..Controls::default() };
        let (series, start) = after_kick(&airframe, rudder, 800, lateral);
        let measured = dutch_roll(&fitted_roots(&series));
        let roots = lateral_matrix(&airframe, &start).complex_eigenvalues();
        let expected = dutch_roll(roots.as_slice());
        println!("{}: Dutch roll {measured:.3} rad/s, on paper {expected:.3} rad/s", airframe.name);
        assert!((measured / expected - 1.0).abs() < 0.01, "{measured} rad/s against {expected} rad/s");
    }
}

#[test]
fn roll_after_a_kick_of_the_aileron_dies_as_the_derivatives_say() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        let aileron = Controls { aileron_rad: 0.005, ..Controls::default() };
        let (kicked, start) = after_kick(&airframe, aileron, 200, lateral);
        let (calm, _) = after_kick(&airframe, Controls::default(), 200, lateral);
        let change = |i: usize| Vector4::from_fn(|row, _| kicked[i][row] - calm[i][row]);
        let step = (lateral_matrix(&airframe, &start) * STEP_S).exp();
        let (mut paper, mut worst) = (change(0), 0.0_f64);
        for i in 1..200 {
            paper = step * paper;
            worst = worst.max((change(i) - paper).amax());
        }
        let part = worst / change(0).amax();
        println!("{}: the roll differs from paper by {:.2} %", airframe.name, 100.0 * part);
        assert!(part < 0.02, "{}: {part}", airframe.name);
    }
}
