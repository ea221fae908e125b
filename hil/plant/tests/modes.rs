//! The modes of the linearised plant, and the motion after a kick, against what follows from the derivatives on paper.
#![expect(clippy::unwrap_used, reason = "a panic in a test is a failed test")]

use bateleur_plant::airframe::{Propeller, Propulsion};
use bateleur_plant::modes::{Modes, linearise};
use bateleur_plant::{
    Airframe, Conditions, Controls, FlightStart, Mode, STEP_S, SensorErrors, Simulation, Trim, Truth, trim,
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
    lateral_matrix_at(airframe, at, AIRSPEED_MPS)
}

fn lateral_matrix_at(airframe: &Airframe, at: &Truth, v: f64) -> Matrix4<f64> {
    let (a, g, m) = (&airframe.aerodynamics, &airframe.geometry, &airframe.mass);
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

/// Density at a height above mean sea level, kg/m³, from the standard's own formula.
fn density(altitude_m: f64) -> f64 {
    1.225 * (1.0 - 2.255_77e-5 * altitude_m).powf(4.255_88)
}

/// Thrust (N) and its change with airspeed (N s/m), by differentiating the balance of the two torques.
fn thrust(frame: &Airframe, throttle: f64, inflow: f64, rho: f64) -> (f64, f64) {
    let turn = std::f64::consts::TAU;
    let (stalled, loss) = match &frame.propulsion {
        Propulsion::Electric {
            motor_kv_rpm_per_v: kv,
            battery_voltage_v: volts,
            winding_resistance_ohm: ohms,
            no_load_current_a: idle,
            ..
        } => {
            let constant = 60.0 / (turn * kv);
            (constant * (volts * throttle / ohms - idle), constant * constant / ohms)
        }
        Propulsion::Piston { power_w, rated_speed_radps, friction_torque_nm, .. } => {
            (throttle * (power_w / rated_speed_radps + friction_torque_nm) - friction_torque_nm, 0.0)
        }
    };
    let p: &Propeller = frame.propulsion.propeller();
    let d = p.diameter_m;
    // Torque of the propeller at a tip speed t = n D, and its slopes.
    let torque = |t: f64| {
        rho * d.powi(3) * (p.torque_0 * t * t + p.torque_1 * t * inflow + p.torque_2 * inflow * inflow)
    };
    let (mut low, mut high) = (0.0, 5000.0);
    for _ in 0..200 {
        let speed = 0.5 * (low + high);
        if stalled - loss * speed > torque(speed * d / turn) { low = speed } else { high = speed }
    }
    let t = low * d / turn;
    let by_speed = rho * d.powi(3) * (2.0 * p.torque_0 * t + p.torque_1 * inflow) * d / turn;
    let by_inflow = rho * d.powi(3) * (p.torque_1 * t + 2.0 * p.torque_2 * inflow);
    let spin = -by_inflow / (loss + by_speed) * d / turn;
    let force = rho * d * d * (p.thrust_0 * t * t + p.thrust_1 * t * inflow + p.thrust_2 * inflow * inflow);
    let slope = rho
        * d
        * d
        * ((2.0 * p.thrust_0 * t + p.thrust_1 * inflow) * spin + p.thrust_1 * t + 2.0 * p.thrust_2 * inflow);
    (force, slope)
}

/// Motion lengthwise on paper: V, α, q, θ in wind axes.
fn longitudinal_matrix(frame: &Airframe, at: &Trim, altitude_m: f64) -> Matrix4<f64> {
    let (a, g, m) = (&frame.aerodynamics, &frame.geometry, &frame.mass);
    let (v, alpha, rho) = (at.airspeed_mps, at.alpha_rad, density(altitude_m));
    let (sin, cos) = alpha.sin_cos();
    let (mass, weight) = (m.mass_kg, 9.80665);
    let area = 0.5 * rho * v * v * g.wing_area_m2;
    let chord = g.mean_chord_m / (2.0 * v);
    let lift = a.lift_0 + a.lift_alpha * alpha + a.lift_elevator * at.controls.elevator_rad;
    let drag = a.drag_0
        + a.drag_induced * lift * lift
        + a.drag_alpha * alpha.abs()
        + a.drag_elevator * at.controls.elevator_rad.abs();
    let drag_alpha = 2.0 * a.drag_induced * lift * a.lift_alpha + a.drag_alpha * alpha.signum();
    let drag_q = 2.0 * a.drag_induced * lift * a.lift_pitch_rate * chord;
    let (force, slope) = thrust(frame, at.controls.throttle, v * cos, rho);
    // The propeller feels the wind along its shaft: V cos α.
    let (force_v, force_alpha) = (slope * cos, -slope * v * sin);
    let speed = [
        (force_v * cos - 2.0 * area * drag / v) / mass,
        (force_alpha * cos - force * sin - area * drag_alpha) / mass + weight,
        -area * drag_q / mass,
        -weight,
    ];
    // α̇ = q − (L + T sin α) / (m V) + g cos γ / V; in trim the last two are equal.
    let incidence = [
        -(2.0 * area * lift / v + force_v * sin) / (mass * v) + (area * lift + force * sin) / (mass * v * v)
            - weight / (v * v),
        -(area * a.lift_alpha + force_alpha * sin + force * cos) / (mass * v),
        1.0 - area * a.lift_pitch_rate * chord / (mass * v),
        0.0,
    ];
    let moment = area * g.mean_chord_m / m.inertia_yy_kgm2;
    let lag = moment * a.pitch_alpha_rate * chord;
    let pitch = [0.0, moment * a.pitch_alpha, moment * a.pitch_pitch_rate * chord, 0.0];
    #[rustfmt::skip]
    let matrix = Matrix4::new(
        speed[0], speed[1], speed[2], speed[3],
        incidence[0], incidence[1], incidence[2], incidence[3],
        pitch[0] + lag * incidence[0], pitch[1] + lag * incidence[1], pitch[2] + lag * incidence[2], 0.0,
        0.0, 0.0, 1.0, 0.0,
    );
    matrix
}

/// Greatest difference of the roots, as a share of their size.
fn off(is: &Mode, should: &Mode) -> f64 {
    let part = |a: Complex<f64>, b: Complex<f64>| (a - b).norm() / b.norm();
    let straight = part(is.roots[0], should.roots[0]).max(part(is.roots[1], should.roots[1]));
    let crossed = part(is.roots[0], should.roots[1]).max(part(is.roots[1], should.roots[0]));
    straight.min(crossed)
}

#[test]
fn all_five_modes_of_the_linearised_plant_are_those_of_the_derivatives_within_one_percent() {
    let third = Airframe::from_toml(include_str!("../../../airframes/ultrastick25e.toml")).unwrap();
    for airframe in [Airframe::aerosonde(), Airframe::rascal110(), third] {
        for speed in [18.0, 22.0, 26.0] {
            let at = trim(&airframe, speed, 0.0, 160.0).unwrap();
            let plant = Modes::of(&linearise(&airframe, &at, 160.0));
            let truth = lateral_truth(&airframe, &at);
            let paper = Modes::of_blocks(
                &longitudinal_matrix(&airframe, &at, 160.0),
                &lateral_matrix_at(&airframe, &truth, speed),
            );
            for ((name, is), (_, should)) in plant.named().iter().zip(paper.named()) {
                println!(
                    "{} {speed} m/s, {name}: {:.4} {:.4}, paper {:.4} {:.4}: off by {:.3} %",
                    airframe.name,
                    is.roots[0],
                    is.roots[1],
                    should.roots[0],
                    should.roots[1],
                    100.0 * off(is, &should)
                );
                assert!(off(is, &should) < 0.01, "{} {name} at {speed} m/s", airframe.name);
            }
        }
    }
}

#[test]
fn coupling_between_lengthwise_and_sideways_moves_no_mode_by_one_percent() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        let at = trim(&airframe, 22.0, 0.0, 160.0).unwrap();
        let motion = linearise(&airframe, &at, 160.0);
        let whole = motion.complex_eigenvalues();
        for (name, mode) in Modes::of(&motion).named() {
            for root in mode.roots {
                let nearest = whole.iter().map(|other| (other - root).norm()).fold(f64::INFINITY, f64::min);
                assert!(nearest < 0.01 * root.norm(), "{} {name}: {root} is off by {nearest}", airframe.name);
            }
        }
    }
}

/// What the lateral matrix asks of a flight, for a trim.
fn lateral_truth(airframe: &Airframe, at: &Trim) -> Truth {
    let start = FlightStart { airspeed_mps: at.airspeed_mps, ..FlightStart::default() };
    let conditions = Conditions { sensors: SensorErrors::none(), ..Conditions::default() };
    Simulation::in_flight(airframe, &conditions, &start).unwrap().truth()
}
