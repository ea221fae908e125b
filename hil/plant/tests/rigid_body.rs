//! The integrator against motions whose invariants are known.

use bateleur_plant::airframe::Mass;
use bateleur_plant::rigid_body::{Loads, RigidBody, RigidState};
use nalgebra::{UnitQuaternion, Vector3};

/// The brick of NASA TM-2015-218675, check cases 2 and 3: 0.155404754 slug, in SI.
fn brick() -> RigidBody {
    const SLUG: f64 = 14.593_903;
    const SLUG_FT2: f64 = 1.355_817_9;
    RigidBody::new(&Mass {
        mass_kg: 0.155_404_754 * SLUG,
        inertia_xx_kgm2: 0.001_894_220 * SLUG_FT2,
        inertia_yy_kgm2: 0.006_211_019 * SLUG_FT2,
        inertia_zz_kgm2: 0.007_194_665 * SLUG_FT2,
        inertia_xz_kgm2: 0.0,
    })
}

fn tumbling() -> RigidState {
    RigidState {
        position: Vector3::zeros(),
        velocity: Vector3::zeros(),
        attitude: UnitQuaternion::identity(),
        rates: Vector3::new(10.0, 20.0, 30.0).map(f64::to_radians),
    }
}

#[test]
fn tumbling_brick_keeps_energy_and_angular_momentum() {
    let (body, mut state) = (brick(), tumbling());
    let (energy, momentum) = (body.rotational_energy(&state), body.angular_momentum(&state));
    for _ in 0..(30.0 / 0.0025) as usize {
        state = body.step(&state, 0.0025, 9.80665, |_| Loads::default()).0;
    }
    let drift = body.rotational_energy(&state) / energy - 1.0;
    let turn = (body.angular_momentum(&state) - momentum).norm() / momentum.norm();
    assert!(drift.abs() < 1e-10, "energy drifted by {drift}");
    assert!(turn < 1e-8, "angular momentum moved by {turn}");
    // It falls freely meanwhile.
    assert!((state.position.z - 0.5 * 9.80665 * 900.0).abs() < 1e-6, "{}", state.position.z);
}

#[test]
fn step_of_half_the_length_has_a_sixteenth_of_the_error() {
    let body = brick();
    let end = |h: f64| {
        let mut state = RigidState { rates: Vector3::new(3.0, 5.0, 4.0), ..tumbling() };
        for _ in 0..(2.0 / h).round() as usize {
            state = body.step(&state, h, 0.0, |_| Loads::default()).0;
        }
        state.rates
    };
    let exact = end(0.000_5);
    let ratio = (end(0.04) - exact).norm() / (end(0.02) - exact).norm();
    assert!((12.0..22.0).contains(&ratio), "error fell by {ratio}");
}

/// Jacobi's elliptic functions sn, cn, dn of `u` for the parameter `m`, by the arithmetic-geometric mean.
fn jacobi(u: f64, m: f64) -> (f64, f64, f64) {
    let (mut a, mut b, mut steps) = (1.0, (1.0 - m).sqrt(), Vec::new());
    while steps.last().is_none_or(|(_, c): &(f64, f64)| c.abs() > 1e-15) {
        steps.push((0.5 * (a + b), 0.5 * (a - b)));
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    let mut phase = 2.0_f64.powi(steps.len() as i32) * a * u;
    for (a, c) in steps.iter().rev() {
        phase = 0.5 * (phase + (c / a * phase.sin()).asin());
    }
    (phase.sin(), phase.cos(), (1.0 - m * phase.sin().powi(2)).sqrt())
}

/// Euler's solution of the torque-free top: rates (rad/s) of a body that begins with no rate about its middle axis, and
/// turns mostly about the one of greatest inertia.
fn free_rates(inertia: [f64; 3], start: Vector3<f64>, t: f64) -> Vector3<f64> {
    let [i1, i2, i3] = inertia;
    let energy2 = i1 * start.x * start.x + i3 * start.z * start.z;
    let momentum2 = (i1 * start.x).powi(2) + (i3 * start.z).powi(2);
    assert!(start.y == 0.0 && momentum2 > energy2 * i2);
    let pace = ((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3)).sqrt();
    let m = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1));
    let second = ((energy2 * i3 - momentum2) / (i2 * (i3 - i2))).sqrt();
    let (sn, cn, dn) = jacobi(pace * t, m);
    Vector3::new(start.x * cn, second * sn, start.z * dn)
}

/// A brick that turns about no axis of its own, by the formula above.
fn wobbling() -> (RigidBody, [f64; 3], RigidState) {
    let body = brick();
    let inertia = [body.inertia[(0, 0)], body.inertia[(1, 1)], body.inertia[(2, 2)]];
    (body, inertia, RigidState { rates: Vector3::new(1.2, 0.0, 2.5), ..tumbling() })
}

#[test]
fn tumbling_brick_turns_as_euler_solved_it() {
    let (body, inertia, mut state) = wobbling();
    let (start, mut worst) = (state.rates, 0.0_f64);
    for step in 1..=12_000 {
        state = body.step(&state, 0.0025, 0.0, |_| Loads::default()).0;
        let exact = free_rates(inertia, start, f64::from(step) * 0.0025);
        worst = worst.max((state.rates - exact).amax());
    }
    println!("largest difference from Euler's solution in 30 s: {worst:.1e} rad/s");
    assert!(worst < 1e-6, "{worst} rad/s");
    assert!(state.rates.y.abs() > 0.1, "it does tumble: {}", state.rates);
}

/// A moment against the angular momentum, M = −c L, takes nothing of its direction: L = L₀ exp(−c t). The rates are those of the
/// free brick, slowed by exp(−c t) and read at the time (1 − exp(−c t)) / c.
#[test]
fn damped_brick_slows_down_as_solved_on_paper() {
    let (body, inertia, mut state) = wobbling();
    let (start, momentum, c) = (state.rates, body.angular_momentum(&state), 0.1);
    let mut worst = 0.0_f64;
    for step in 1..=8_000 {
        let damping = |s: &RigidState| Loads { moment: body.inertia * s.rates * -c, ..Loads::default() };
        state = body.step(&state, 0.0025, 0.0, damping).0;
        let time = f64::from(step) * 0.0025;
        let left = (-c * time).exp();
        let exact = free_rates(inertia, start, (1.0 - left) / c) * left;
        worst = worst.max((state.rates - exact).amax());
        let off = (body.angular_momentum(&state) - momentum * left).norm() / momentum.norm();
        assert!(off < 1e-8, "angular momentum is off by {off} after {time} s");
    }
    println!("largest difference from the solution in 20 s: {worst:.1e} rad/s");
    assert!(worst < 1e-6, "{worst} rad/s");
}

#[test]
fn spinning_top_without_torque_precesses_as_solved_on_paper() {
    let mass = Mass {
        mass_kg: 1.0,
        inertia_xx_kgm2: 0.02,
        inertia_yy_kgm2: 0.02,
        inertia_zz_kgm2: 0.035,
        inertia_xz_kgm2: 0.0,
    };
    let body = RigidBody::new(&mass);
    let first = RigidState {
        attitude: UnitQuaternion::from_euler_angles(0.3, -0.4, 1.0),
        rates: Vector3::new(0.8, 0.0, 4.0),
        ..tumbling()
    };
    let momentum = body.angular_momentum(&first);
    let own = (1.0 - 0.035 / 0.02) * first.rates.z;
    let mut state = first;
    for step in 1..=8_000 {
        state = body.step(&state, 0.0025, 0.0, |_| Loads::default()).0;
        let time = f64::from(step) * 0.0025;
        let about_momentum = UnitQuaternion::from_scaled_axis(momentum / 0.02 * time);
        let about_own = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, own * time));
        let exact = about_momentum * first.attitude * about_own;
        assert!(
            state.attitude.angle_to(&exact) < 1e-6,
            "{} rad after {time} s",
            state.attitude.angle_to(&exact)
        );
    }
}

#[test]
fn mean_rates_add_up_to_the_turn_made() {
    let body = brick();
    let mut state = RigidState { rates: Vector3::new(0.0, 0.0, 1.0), ..tumbling() };
    let mut turn = 0.0;
    for _ in 0..400 {
        let (next, mean) = body.step(&state, 0.0025, 0.0, |_| Loads {
            force: Vector3::zeros(),
            moment: Vector3::new(0.0, 0.0, 0.01),
        });
        state = next;
        turn += mean.rates.z * 0.0025;
    }
    assert!((turn - state.attitude.euler_angles().2).abs() < 1e-9);
}
