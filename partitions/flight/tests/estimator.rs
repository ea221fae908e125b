//! The estimator alone on the sensors of the plant, which flies on the real controller.

mod common;

use bateleur_flight::estimator::{Aiding, Estimator, EstimatorStatus, GpsMeasurement, ImuSample, Start};
use bateleur_plant::Turbulence;
use common::{EstimateErrors, Flight, FlightStart, Options, feed};
use nalgebra::Vector3;

fn errors(options: Options) -> EstimateErrors {
    let mut flight = Flight::new(options);
    flight.run(150.0);
    assert!(!flight.plant.truth().crashed, "{}", flight.describe());
    flight.estimate_errors(40.0)
}

#[test]
fn rms_errors_are_excellent_in_calm_to_moderate_air() {
    for (seed, turbulence) in
        (1..=6).zip([Turbulence::Calm, Turbulence::Light, Turbulence::Moderate].iter().cycle())
    {
        let e = errors(Options::new(seed, 5.0, 60.0 * seed as f64, *turbulence));
        let good = e.roll_deg < 0.25
            && e.pitch_deg < 0.25
            && e.yaw_deg < 0.5
            && e.velocity_mps < 0.05
            && e.horizontal_m < 0.8
            && e.height_m < 0.8;
        assert!(good, "seed {seed}: {e:?}");
    }
}

#[test]
fn uncalibrated_sensors_stay_within_the_pass_bounds() {
    for seed in 1..=3 {
        let mut options = Options::new(seed, 5.0, 60.0, Turbulence::Light);
        options.conditions.sensors = bateleur_plant::SensorErrors::uncalibrated();
        let e = errors(options);
        let good = e.roll_deg < 1.0
            && e.pitch_deg < 1.0
            && e.yaw_deg < 2.0
            && e.velocity_mps < 0.15
            && e.horizontal_m < 1.5
            && e.height_m < 1.5;
        assert!(good, "seed {seed}: {e:?}");
    }
}

#[test]
fn latency_of_gps_that_is_not_compensated_is_seen_at_once() {
    let compensated = errors(Options::new(1, 5.0, 60.0, Turbulence::Light));
    let mut options = Options::new(1, 5.0, 60.0, Turbulence::Light);
    // The stamp says "now": the fix is taken for 120 ms younger than it is.
    options.spoil_fix = |fix| GpsMeasurement { time_s: fix.time_s + 0.12, ..fix };
    let spoilt = errors(options);
    assert!(spoilt.pitch_deg > 4.0 * compensated.pitch_deg, "{spoilt:?} against {compensated:?}");
    assert!(spoilt.horizontal_m > 3.0 * compensated.horizontal_m, "{spoilt:?} against {compensated:?}");
}

#[test]
fn constant_hidden_latency_can_be_told() {
    let mut options = Options::new(1, 5.0, 60.0, Turbulence::Light);
    options.spoil_fix = |fix| GpsMeasurement { time_s: fix.time_s + 0.12, ..fix };
    options.estimator.gps_extra_latency_s = 0.12;
    let e = errors(options);
    assert!(e.pitch_deg < 0.25 && e.horizontal_m < 0.8, "{e:?}");
}

#[test]
fn heading_without_magnetometer_comes_from_the_turns() {
    let mut options = Options::new(2, 5.0, 60.0, Turbulence::Light);
    options.start = Some(FlightStart::default());
    let mut flight = Flight::new(options);
    flight.run(20.0);
    flight.estimator.set_aiding(Aiding { magnetometer: false, ..Aiding::default() });
    flight.run(120.0);
    let e = flight.estimate_errors(40.0);
    assert!(e.yaw_deg < 1.0, "{e:?}");
}

#[test]
fn missed_declination_would_be_27_degrees() {
    let mut options = Options::new(1, 0.0, 0.0, Turbulence::Calm);
    let f = options.estimator.field_ned_gauss;
    options.estimator.field_ned_gauss = Vector3::new(f.xy().norm(), 0.0, f.z);
    let mut flight = Flight::new(options);
    flight.run(6.0);
    let yaw = flight.estimator.state().unwrap().euler.z - flight.plant.truth().yaw_rad;
    assert!((yaw.to_degrees() - 26.9).abs() < 8.0, "{}", yaw.to_degrees());
    let mut right = Flight::new(Options::new(1, 0.0, 0.0, Turbulence::Calm));
    right.run(6.0);
    let yaw = right.estimator.state().unwrap().euler.z - right.plant.truth().yaw_rad;
    assert!(yaw.to_degrees().abs() < 8.0, "{}", yaw.to_degrees());
}

#[test]
fn ground_start_levels_and_finds_the_gyroscope_bias() {
    let mut flight = Flight::new(Options::new(3, 0.0, 0.0, Turbulence::Calm));
    flight.run(5.0);
    let (truth, state) = (flight.plant.truth(), flight.estimator.state().unwrap());
    assert!((state.gyro_bias - truth.gyroscope_bias_radps).norm() < 0.002);
    // 50 mg of accelerometer bias hide 3° while the aircraft stands.
    assert!((state.euler.x - truth.roll_rad).to_degrees().abs() < 4.0);
    assert!(state.velocity.norm() < 0.1);
}

#[test]
fn cold_start_in_a_steep_turn_converges() {
    for seed in 1..=10 {
        let mut options = Options::new(seed, 6.0, 40.0 * seed as f64, Turbulence::Light);
        options.start = Some(FlightStart::default());
        let mut flight = Flight::new(options);
        flight.run(15.0);
        flight.commands.navigation = false;
        flight.commands.bank_rad = Some(45f64.to_radians());
        flight.commands.altitude_m = Some(160.0);
        flight.commands.airspeed_mps = Some(22.0);
        flight.run(6.0 + seed as f64);
        let mut cold = Estimator::new(flight.options.estimator);
        let began = flight.plant.time_s();
        let mut first = None;
        for _ in 0..500 {
            // The sensors are drawn by the flight itself; a copy of the plant gives the same values once more.
            let sensors = flight.plant.clone().sensors();
            feed(&mut cold, &sensors, |fix| fix);
            let truth = flight.plant.truth();
            if let (None, Some(state)) = (first, cold.state()) {
                let tilt = state.quaternion.angle_to(&truth.attitude).to_degrees();
                first = Some((truth.time_s - began, tilt));
            }
            flight.step();
        }
        let (after_s, error_deg) = first.unwrap();
        assert!(after_s < 1.0, "seed {seed}: first state after {after_s} s");
        assert!(error_deg < 15.0, "seed {seed}: first state {error_deg}° off");
        let (truth, state) = (flight.last().truth, cold.state().unwrap());
        let late = state.quaternion.angle_to(&truth.attitude).to_degrees();
        assert!(late < 2.0, "seed {seed}: after 10 s still {late}° off");
    }
}

/// The ground gives order `E` a moment before the take-off: what the barometer said while the attitude was found must count,
/// or the height would be the receiver's, many metres off.
#[test]
fn height_is_zeroed_on_the_runway_however_short_the_aircraft_stands_after_the_order() {
    for seed in 1..=12 {
        for standing_s in [1.4, 1.7, 2.5] {
            let mut flight = Flight::new(Options::new(seed, 0.0, 0.0, Turbulence::Calm));
            flight.run(8.0 - standing_s);
            flight.estimator.initialise(Start::Auto);
            flight.run(32.0);
            let (truth, state) = (flight.last().truth, flight.last().navigation.unwrap());
            let drift = truth.barometer_bias_m - flight.barometer_at_start_m;
            let off = state.altitude_m() + truth.position_ned_m.z - drift;
            assert!(off.abs() < 0.6, "seed {seed}, {standing_s} s: {off} m");
        }
    }
}

#[test]
fn receiver_that_jumps_for_good_is_believed_after_a_while() {
    let mut options = Options::new(1, 0.0, 0.0, Turbulence::Calm);
    options.start = Some(FlightStart::default());
    options.spoil_fix = |fix| {
        let jump = if fix.time_s > 30.0 { 80.0 } else { 0.0 };
        GpsMeasurement { position_ned: fix.position_ned + Vector3::new(0.0, jump, 0.0), ..fix }
    };
    let mut flight = Flight::new(options);
    flight.run(31.0);
    assert!(flight.estimator.counters().refused > 0);
    flight.run(20.0);
    let (truth, state) = (flight.plant.truth(), flight.estimator.state().unwrap());
    let east = state.position.y - truth.position_ned_m.y - truth.gps_slow_error_ned_m.y;
    assert!((east - 80.0).abs() < 2.0, "{east}");
    assert_eq!(flight.estimator.counters().resets, 1);
    assert!(state.quaternion.angle_to(&truth.attitude).to_degrees() < 1.0);
}

#[test]
fn single_wild_fix_is_refused_without_a_trace() {
    let mut options = Options::new(1, 0.0, 0.0, Turbulence::Calm);
    options.start = Some(FlightStart::default());
    options.spoil_fix = |fix| {
        let wild = (20.0..20.15).contains(&fix.time_s);
        let off = if wild { 300.0 } else { 0.0 };
        GpsMeasurement { position_ned: fix.position_ned + Vector3::repeat(off), ..fix }
    };
    let mut flight = Flight::new(options);
    flight.run(25.0);
    let (truth, state) = (flight.plant.truth(), flight.estimator.state().unwrap());
    let seen = truth.position_ned_m + truth.gps_slow_error_ned_m;
    assert!((state.position - seen).xy().norm() < 5.0 + 22.0 * 0.05);
    assert_eq!(flight.estimator.counters().resets, 0);
    assert!(flight.estimator.counters().refused >= 1);
}

#[test]
fn attitude_turned_upside_down_in_memory_is_found_again() {
    let mut flight = Flight::new(Options::new(2, 3.0, 0.0, Turbulence::Light));
    flight.run(60.0);
    let mut snapshot = flight.estimator.snapshot().unwrap();
    // A quarter turn of yaw and a roll, as a flipped bit might leave it; still a unit quaternion.
    let [w, x, y, z] = snapshot.quaternion;
    snapshot.quaternion = [-x, w, z, -y];
    assert!(flight.estimator.warm_start(&snapshot, flight.plant.time_s()));
    flight.run(15.0);
    let (truth, state) = (flight.last().truth, flight.last().navigation);
    let off = state.map(|s| s.quaternion.angle_to(&truth.attitude).to_degrees());
    assert!(off.is_some_and(|x| x < 3.0) && !truth.crashed, "{off:?} {}", flight.describe());
}

#[test]
fn loss_of_gps_is_told_and_attitude_stays() {
    let mut options = Options::new(2, 3.0, 0.0, Turbulence::Light);
    options.start = Some(FlightStart::default());
    let mut flight = Flight::new(options);
    flight.run(20.0);
    flight.estimator.set_aiding(Aiding { gps: false, ..Aiding::default() });
    flight.run(10.0);
    assert_eq!(flight.estimator.status(), EstimatorStatus::Inertial);
    let (truth, state) = (flight.last().truth, flight.last().navigation.unwrap());
    let off = state.quaternion.angle_to(&truth.attitude).to_degrees();
    assert!(off < 3.0, "{off} {:?} {:?}", state.velocity - truth.velocity_ned_mps, state.sigmas);
}

#[test]
fn nonsense_samples_are_counted_and_ignored() {
    let mut options = Options::new(2, 0.0, 0.0, Turbulence::Calm);
    options.start = Some(FlightStart::default());
    let mut flight = Flight::new(options);
    flight.run(10.0);
    let before = flight.estimator.state().unwrap();
    let bad = ImuSample {
        time_s: before.time_s + 0.01,
        interval_s: 0.01,
        specific_force: Vector3::repeat(f64::NAN),
        rates: Vector3::zeros(),
    };
    flight.estimator.predict(&bad);
    flight.estimator.predict(&ImuSample { specific_force: Vector3::zeros(), time_s: before.time_s, ..bad });
    flight.estimator.update_baro(before.time_s, f64::NAN);
    flight.estimator.update_airspeed(before.time_s, f64::NAN, 1e5);
    flight.estimator.update_magnetometer(before.time_s, &Vector3::repeat(f64::NAN));
    flight.estimator.update_gps(&GpsMeasurement {
        time_s: before.time_s,
        position_ned: Vector3::repeat(f64::NAN),
        velocity_ned: Vector3::zeros(),
    });
    assert_eq!(flight.estimator.counters().bad_samples, 2);
    assert_eq!(flight.estimator.state().unwrap(), before);
}

#[test]
fn initialise_on_the_ground_starts_over_and_stop_stops() {
    let mut flight = Flight::new(Options::new(2, 0.0, 0.0, Turbulence::Calm));
    flight.run(4.0);
    flight.estimator.initialise(Start::Ground);
    assert_eq!(flight.estimator.status(), EstimatorStatus::Aligning);
    flight.run(2.0);
    assert!(flight.estimator.state().is_some());
    flight.estimator.stop();
    flight.run(2.0);
    assert_eq!(flight.estimator.status(), EstimatorStatus::Stopped);
    assert!(flight.estimator.state().is_none());
}

/// Not a benchmark, only a bound far above what it takes, so that a lost optimisation is noticed in release.
#[test]
fn frame_of_the_estimator_takes_microseconds() {
    let mut options = Options::new(1, 0.0, 0.0, Turbulence::Calm);
    options.start = Some(FlightStart::default());
    let mut flight = Flight::new(options);
    flight.run(5.0);
    let mut estimator = flight.estimator;
    let mut sets = Vec::new();
    for _ in 0..2000 {
        sets.push(flight.plant.clone().sensors());
        flight.step();
    }
    let began = std::time::Instant::now();
    for set in &sets {
        feed(&mut estimator, set, |fix| fix);
    }
    assert_eq!(estimator.counters().alignments, 1);
    assert_eq!(estimator.status(), EstimatorStatus::Ready);
    let each = began.elapsed().as_secs_f64() / sets.len() as f64;
    println!("{:.1} µs a frame", each * 1e6);
    if !cfg!(debug_assertions) {
        assert!(each < 100e-6, "{each}");
    }
}
