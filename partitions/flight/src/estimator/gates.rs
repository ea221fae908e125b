//! What happens to measurements that can not be: refused without a trace, and believed when they stay.

use super::world::{DT_S, World, config, static_pa};
use super::*;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// A world and its estimator after half a minute.
fn settled() -> (World, Estimator) {
    let mut world = World::new(7, config(true));
    let mut estimator = world.estimator();
    fly(&mut world, &mut estimator, 30.0);
    (world, estimator)
}

fn fly(world: &mut World, estimator: &mut Estimator, seconds: f64) {
    for _ in 0..(seconds / DT_S) as u32 {
        let sample = world.step();
        estimator.predict(&sample);
        world.measure(estimator, 0.12);
    }
}

/// One bad measurement by this much, whatever its unit.
fn spoil(world: &World, estimator: &mut Estimator, aid: Aid, by: f64) {
    let (now_s, real) = (world.time_s + 0.2, world.real.nominal);
    let fix =
        GpsMeasurement { time_s: world.time_s, position_ned: real.position, velocity_ned: real.velocity };
    let off = Vector3::new(by, 0.0, 0.0);
    match aid {
        Aid::GpsVelocity => {
            estimator.update_gps(&GpsMeasurement { velocity_ned: real.velocity + off, ..fix })
        }
        Aid::GpsPosition => {
            estimator.update_gps(&GpsMeasurement { position_ned: real.position + off, ..fix })
        }
        Aid::Barometer => estimator.update_baro(now_s, static_pa(-real.position.z + by)),
        Aid::Airspeed | Aid::Sideslip => {
            let air = (real.velocity - Vector3::new(real.wind.x, real.wind.y, 0.0)).norm() + by;
            let static_pa = static_pa(160.0);
            let density = crate::atmosphere::density_kgpm3(160.0);
            estimator.update_airspeed(now_s, 0.5 * density * air * air, static_pa);
        }
        Aid::Magnetometer => {
            let field = real.attitude.inverse() * world.config.field_ned_gauss + real.mag_bias + off;
            estimator.update_magnetometer(now_s, &field);
        }
    }
}

/// An error of each aid that lies beyond its gate, and one well within.
const ERRORS: [(Aid, f64, f64); 5] = [
    (Aid::GpsVelocity, 0.6, 0.1),
    (Aid::GpsPosition, 4.0, 1.0),
    (Aid::Barometer, 6.0, 1.5),
    (Aid::Airspeed, 40.0, 8.0),
    (Aid::Magnetometer, 0.015, 0.004),
];

#[test]
fn measurement_beyond_its_gate_leaves_no_trace_and_one_within_is_taken() {
    let (world, settled) = settled();
    for (aid, beyond, within) in ERRORS {
        let mut estimator = settled;
        spoil(&world, &mut estimator, aid, beyond);
        let taken = estimator.innovations(aid).count - settled.innovations(aid).count;
        assert_eq!((taken, estimator.counters().refused), (0, 1), "{aid:?}");
        let (now, before) = (&estimator.filter.nominal, &settled.filter.nominal);
        match aid {
            // The other half of the fix was good and is taken: it moves the state by little.
            Aid::GpsVelocity | Aid::GpsPosition => {
                assert!((now.velocity - before.velocity).norm() < 0.05, "{aid:?}");
                assert!((now.position - before.position).norm() < 0.5, "{aid:?}");
                assert!(now.attitude.angle_to(&before.attitude) < 0.002, "{aid:?}");
            }
            // That no air comes from the side is taken, and speaks of the wind alone.
            Aid::Airspeed => assert_eq!(Nominal { wind: before.wind, ..*now }, *before),
            _ => {
                assert_eq!(now, before, "{aid:?}");
                assert_eq!(estimator.filter.covariance, settled.filter.covariance, "{aid:?}");
            }
        }
        let mut estimator = settled;
        spoil(&world, &mut estimator, aid, within);
        assert!(estimator.innovations(aid).count > settled.innovations(aid).count, "{aid:?}");
        assert_eq!(estimator.counters().refused, 0, "{aid:?}");
    }
}

/// What the sensors say beside what they measure, and whether there are satellites.
#[derive(Clone, Copy, Default)]
struct Shift {
    rates_radps: Vector3<f64>,
    field_gauss: Vector3<f64>,
    /// Of the barometer; the receiver would see it, too.
    height_m: f64,
    without_fixes: bool,
}

/// Flies with a pitot and gives the real attitude at the end.
fn fly_with(
    world: &mut World,
    estimator: &mut Estimator,
    seconds: f64,
    shift: Shift,
) -> nalgebra::UnitQuaternion<f64> {
    for _ in 0..(seconds / DT_S) as u32 {
        let sample = world.step();
        estimator.predict(&ImuSample { rates: sample.rates + shift.rates_radps, ..sample });
        // It is part of the field that the world measures.
        world.real.nominal.mag_bias += shift.field_gauss;
        world.real.nominal.position.z -= shift.height_m;
        match shift.without_fixes {
            true => world.measure_without_fixes(estimator),
            false => world.measure(estimator, 0.12),
        }
        world.real.nominal.mag_bias -= shift.field_gauss;
        world.real.nominal.position.z += shift.height_m;
        let speed = world.real.nominal.velocity.norm();
        let (pressure_pa, density) = (static_pa(160.0), crate::atmosphere::density_kgpm3(160.0));
        estimator.update_airspeed(world.time_s, 0.5 * density * speed * speed, pressure_pa);
    }
    world.real.nominal.attitude
}

/// The magnetic field tells a gyroscope that shifts, whose error grows while the field's size stays, from a magnetometer that does, whose error
/// is there at once or changes that size.
#[test]
fn without_satellites_the_field_tells_a_shifted_gyroscope_and_a_shifted_magnetometer_is_left() {
    let mut found = 0;
    for seed in 0..60 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut world = World::new(seed, config(true));
        world.real.nominal.wind = Vector2::zeros();
        let mut estimator = world.estimator();
        fly_with(&mut world, &mut estimator, 30.0, Shift::default());
        let direction = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0f64)).normalize();
        let size = random.random_range(0.0..1.0);
        let (rates_radps, field_gauss, rising_s) = match seed % 3 {
            0 => (direction * (0.01 + 0.07 * size), Vector3::zeros(), 0.0),
            1 => (Vector3::zeros(), direction * (0.04 + 0.3 * size), 0.0),
            _ => (Vector3::zeros(), direction * 0.04, random.random_range(0.5..5.0)),
        };
        let before_s = random.random_range(0.0..10.0);
        fly_with(&mut world, &mut estimator, before_s, Shift { without_fixes: true, ..Shift::default() });
        let shift = Shift { rates_radps, field_gauss, without_fixes: true, ..Shift::default() };
        for step in 0..(5.0 * rising_s) as u32 {
            let share = f64::from(step) / (5.0 * rising_s);
            fly_with(&mut world, &mut estimator, 0.2, Shift { field_gauss: share * field_gauss, ..shift });
        }
        let attitude = fly_with(&mut world, &mut estimator, 50.0 - before_s - rising_s, shift);
        let off_deg = estimator.filter.nominal.attitude.angle_to(&attitude).to_degrees();
        if seed % 3 == 0 {
            found += u32::from(off_deg < 5.0);
            continue;
        }
        let most_deg = if rising_s > 0.0 { 20.0 } else { 5.0 };
        assert!(off_deg < most_deg, "seed {seed}, {field_gauss} in {rising_s} s: {off_deg}°");
    }
    // Some shifts need more than the one time: a magnetometer that drifts must not have more. Without it 3 are found.
    assert!(found >= 17, "{found} of 20 gyroscopes");
}

/// The way through the air tells the heading, where nothing else does.
#[test]
fn gyroscope_that_shifts_without_a_magnetometer_is_learnt_in_flight() {
    for seed in 0..12 {
        let degps: f64 = [-5.0, -2.5, -1.0, 1.0, 2.5, 5.0][seed as usize % 6];
        let mut world = World::new(seed, config(true));
        world.real.nominal.wind = Vector2::zeros();
        let mut estimator = world.estimator();
        fly_with(&mut world, &mut estimator, 30.0, Shift::default());
        estimator.set_aiding(Aiding { magnetometer: false, ..estimator.aiding() });
        fly_with(&mut world, &mut estimator, 10.0, Shift::default());
        let rates_radps = Vector3::repeat(degps.to_radians());
        let attitude = fly_with(&mut world, &mut estimator, 40.0, Shift { rates_radps, ..Shift::default() });
        let off_rad = estimator.filter.nominal.attitude.angle_to(&attitude);
        let learnt = estimator.filter.nominal.gyro_bias.z.to_degrees();
        assert_eq!(estimator.status(), EstimatorStatus::Ready, "seed {seed}, {degps}°/s");
        assert!(off_rad < 0.15, "seed {seed}, {degps}°/s: {off_rad} rad, learnt {learnt}°/s");
        assert!((learnt - degps).abs() < 0.3 + 0.1 * degps.abs(), "seed {seed}, {degps}°/s: {learnt}°/s");
    }
}

#[test]
fn barometer_that_jumps_for_good_is_zeroed_anew_and_the_height_stays() {
    let (mut world, mut estimator) = settled();
    let before = estimator.barometer_offset_m().unwrap();
    for frame in 0..500 {
        let sample = world.step();
        estimator.predict(&sample);
        if frame % 2 == 0 {
            estimator.update_baro(world.time_s, static_pa(-world.real.nominal.position.z + 30.0));
        }
        if frame % 10 == 0 {
            let n = world.real.nominal;
            estimator.update_gps(&GpsMeasurement {
                time_s: world.time_s,
                position_ned: n.position,
                velocity_ned: n.velocity,
            });
        }
    }
    assert_eq!(estimator.counters().resets, 1);
    assert!((estimator.barometer_offset_m().unwrap() - before - 30.0).abs() < 1.0);
    assert!((estimator.filter.nominal.position.z - world.real.nominal.position.z).abs() < 1.0);
}

/// A port that is blocked, or follows slowly: zeroed anew, it would carry the height with it once more.
#[test]
fn barometer_that_does_not_climb_with_the_aircraft_is_left_and_not_zeroed_anew() {
    // How slowly the port follows, s, and how much faster the aircraft sinks than that of the world for 15 s, m/s.
    for (follows_s, faster_mps) in [
        (f64::INFINITY, 0.0),
        (3.0, 0.0),
        (10.0, 0.0),
        (20.0, 0.0),
        (20.0, 4.0),
        (f64::INFINITY, 3.0),
        (f64::INFINITY, 6.0),
    ] {
        let (mut world, mut estimator) = settled();
        let (mut told_m, mut worst_m) = (-world.real.nominal.position.z, 0f64);
        for frame in 0..6_000 {
            let sample = world.step();
            estimator.predict(&sample);
            let n = world.real.nominal;
            told_m += (-n.position.z - told_m) * DT_S / follows_s;
            let sunk_m = faster_mps * (f64::from(frame) * DT_S).min(15.0);
            if frame % 2 == 0 {
                estimator.update_baro(world.time_s, static_pa(told_m + sunk_m));
            }
            if frame % 10 == 0 {
                let fix = GpsMeasurement {
                    time_s: world.time_s,
                    position_ned: n.position,
                    velocity_ned: n.velocity,
                };
                estimator.update_gps(&fix);
            }
            worst_m = worst_m.max((estimator.filter.nominal.position.z - n.position.z).abs());
        }
        let about = format!("follows in {follows_s} s, sinks {faster_mps} m/s faster");
        assert!(worst_m < 20.0, "{about}: {worst_m} m");
        let off_m = (estimator.filter.nominal.position.z - world.real.nominal.position.z).abs();
        assert!(off_m < 2.0, "{about}: {off_m} m at the end");
    }
}

/// One height or all from then on: what leaps is the gate's matter, and no climb.
#[test]
fn barometer_that_leaps_without_satellites_is_no_port_that_is_wrong_and_the_height_stays() {
    for seed in 0..40 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut world = World::new(seed, config(true));
        world.real.nominal.wind = Vector2::zeros();
        let mut estimator = world.estimator();
        fly_with(&mut world, &mut estimator, 30.0, Shift::default());
        let out = Shift { without_fixes: true, ..Shift::default() };
        fly_with(&mut world, &mut estimator, random.random_range(2.0..10.0), out);
        let leap =
            Shift { height_m: random.random_range(12.0..60.0) * [1.0, -1.0][seed as usize % 2], ..out };
        let seconds = if seed % 4 < 2 { DT_S * 2.0 } else { 12.0 };
        fly_with(&mut world, &mut estimator, seconds, leap);
        let off_m = (estimator.filter.nominal.position.z - world.real.nominal.position.z).abs();
        assert!(off_m < 5.0, "seed {seed}, {} m for {seconds} s: {off_m} m", leap.height_m);
        assert!(estimator.static_watch.is_believed(), "seed {seed}, {} m for {seconds} s", leap.height_m);
    }
}

#[test]
fn accelerometers_that_jump_without_satellites_do_not_carry_the_height_away_from_the_barometer() {
    for seed in 0..40 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let shift = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        let (mut world, mut estimator) = settled();
        let mut worst_m = 0f64;
        for frame in 0..3_000 {
            let mut sample = world.step();
            if frame > 500 {
                sample.specific_force += shift;
            }
            estimator.predict(&sample);
            world.measure_without_fixes(&mut estimator);
            worst_m =
                worst_m.max((estimator.filter.nominal.position.z - world.real.nominal.position.z).abs());
        }
        assert!(worst_m < 30.0, "{shift:?}: {worst_m} m");
        let off_m = (estimator.filter.nominal.position.z - world.real.nominal.position.z).abs();
        assert!(off_m < 5.0, "{shift:?}: {off_m} m at the end");
    }
}

#[test]
fn field_that_jumps_for_good_becomes_bias_and_the_attitude_stays() {
    let (mut world, mut estimator) = settled();
    let shift = Vector3::new(0.03, -0.02, 0.01);
    for frame in 0..1500 {
        let sample = world.step();
        estimator.predict(&sample);
        let n = world.real.nominal;
        if frame % 5 == 0 {
            let field = n.attitude.inverse() * world.config.field_ned_gauss + n.mag_bias + shift;
            estimator.update_magnetometer(world.time_s, &field);
        }
        if frame % 10 == 0 {
            let fix =
                GpsMeasurement { time_s: world.time_s, position_ned: n.position, velocity_ned: n.velocity };
            estimator.update_gps(&fix);
        }
    }
    let n = world.real.nominal;
    assert_eq!(estimator.counters().resets, 1);
    let learnt = estimator.filter.nominal.mag_bias - n.mag_bias - shift;
    assert!(learnt.norm() < 0.005, "{learnt}");
    assert!(estimator.filter.nominal.attitude.angle_to(&n.attitude).to_degrees() < 1.5);
}

#[test]
fn what_is_not_taken_is_not_healthy() {
    let (mut world, mut estimator) = settled();
    let known = Health::GPS | Health::BAROMETER | Health::MAGNETOMETER;
    let settled = Health::ATTITUDE | Health::VELOCITY | Health::POSITION;
    assert!(estimator.health().has(known | settled), "{:?}", estimator.health());
    assert!(!estimator.health().has(Health::PITOT), "it has measured nothing");
    estimator.set_aiding(Aiding { magnetometer: false, pressure: false, ..Aiding::default() });
    fly(&mut world, &mut estimator, 3.0);
    assert_eq!(estimator.health(), Health(Health::GPS | settled));
    estimator.set_aiding(Aiding { gps: false, ..Aiding::default() });
    fly(&mut world, &mut estimator, 3.0);
    assert!(!estimator.health().has(Health::GPS) && estimator.health().has(known & !Health::GPS));
    fly(&mut world, &mut estimator, 60.0);
    assert!(!estimator.health().has(Health::VELOCITY), "a minute without fixes");
    estimator.initialise(Start::Flight);
    assert_eq!(estimator.health(), Health::default(), "no state, nothing to trust");
}

#[test]
fn late_fixes_of_any_latency_give_the_same_errors() {
    let mut errors = Vec::new();
    for latency_s in [0.0, 0.06, 0.12, 0.2, 0.26] {
        let mut sum = 0.0;
        for seed in 0..20 {
            let mut world = World::new(seed, config(true));
            let mut estimator = world.estimator();
            for _ in 0..2000 {
                let sample = world.step();
                estimator.predict(&sample);
                world.measure(&mut estimator, latency_s);
            }
            sum += (estimator.filter.nominal.velocity - world.real.nominal.velocity).norm_squared();
        }
        errors.push((sum / 60.0f64).sqrt());
    }
    assert!(errors.iter().all(|error| *error < 0.04), "{errors:?}");
    assert!(errors[4] < 1.6 * errors[0], "{errors:?}");
}

/// A wheel that meets the ground: for two frames the force is ten times the weight and more. Fixes that come then are older than that.
#[test]
fn knock_of_any_strength_and_time_costs_neither_state_nor_covariance() {
    for number in 0..60 {
        let mut world = World::new(number, config(true));
        let mut estimator = world.estimator();
        let latency_s = [0.06, 0.12, 0.2, 0.26][number as usize % 4];
        let mut back = Vector3::zeros();
        for frame in 0..1_000 {
            let mut sample = world.step();
            let knocks = frame > 500 && back == Vector3::zeros() && world.chance.one() > 1.2;
            let force = world.chance.three() * 10f64.powf(1.5 + 0.3 * world.chance.one());
            let force = if knocks { force } else { Vector3::zeros() };
            sample.specific_force += force - back;
            back = force;
            estimator.predict(&sample);
            world.measure(&mut estimator, latency_s);
            assert!(estimator.filter.healthy() && estimator.state().is_some(), "{number}, frame {frame}");
        }
    }
}
