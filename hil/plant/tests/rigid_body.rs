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

#[test]
fn damped_brick_comes_to_rest() {
    let (body, mut state) = (brick(), tumbling());
    let energy = body.rotational_energy(&state);
    let mut last = energy;
    for _ in 0..4000 {
        state =
            body.step(&state, 0.0025, 0.0, |s| Loads { force: Vector3::zeros(), moment: s.rates * -0.002 }).0;
        let now = body.rotational_energy(&state);
        assert!(now < last);
        last = now;
    }
    assert!(last < 0.05 * energy);
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
