//! How the filter's tuning fits the plant's sensors: normalised innovations of each aid, normalised errors of each block of
//! states, and errors against the truth and against the truth as the receiver sees it, over seeds that nothing was tuned on.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

mod common;

use bateleur_flight::estimator::{Aid, Aiding, ERROR_STATES, Snapshot};
use bateleur_plant::{Truth, Turbulence};
use common::{Flight, Options};
use nalgebra::{DMatrix, DVector, Quaternion, UnitQuaternion, Vector3};

const FIRST: u64 = 710_000;

/// Blocks of the error state: name, first state, length.
const BLOCKS: [(&str, usize, usize); 6] = [
    ("attitude", 0, 3),
    ("velocity", 3, 3),
    ("position", 6, 3),
    ("gyroscope bias", 9, 3),
    ("accelerometer bias", 12, 3),
    ("magnetometer bias", 15, 3),
];

fn covariance(snapshot: &Snapshot) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(ERROR_STATES, ERROR_STATES);
    let mut values = snapshot.covariance.iter();
    for i in 0..ERROR_STATES {
        for j in i..ERROR_STATES {
            let value = values.next().unwrap();
            matrix[(i, j)] = *value;
            matrix[(j, i)] = *value;
        }
    }
    matrix
}

/// Real less estimated, as the filter defines its error; the position against the receiver's and the barometer's truth.
fn error(flight: &Flight, snapshot: &Snapshot, truth: &Truth) -> DVector<f64> {
    let [w, i, j, k] = snapshot.quaternion;
    let attitude = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    let mut seen = truth.position_ned_m + truth.gps_slow_error_ned_m;
    seen.z = truth.position_ned_m.z - (truth.barometer_bias_m - flight.barometer_at_start_m);
    let blocks: [Vector3<f64>; 6] = [
        (truth.attitude * attitude.inverse()).scaled_axis(),
        truth.velocity_ned_mps - Vector3::from(snapshot.velocity),
        seen - Vector3::from(snapshot.position),
        truth.gyroscope_bias_radps - Vector3::from(snapshot.gyro_bias),
        truth.accelerometer_bias_mps2 - Vector3::from(snapshot.accel_bias),
        truth.magnetometer_bias_gauss - Vector3::from(snapshot.mag_bias),
    ];
    DVector::from_iterator(18, blocks.iter().flat_map(|block| block.iter().copied()))
}

/// What a set of flights gave: sums of squares and counts.
struct Survey {
    innovations: [(f64, f64); Aid::ALL.len()],
    errors: [f64; BLOCKS.len()],
    samples: f64,
}

/// Twenty flights of two and a half minutes; every five seconds the errors are taken.
fn survey(turbulence: Turbulence, scale_errors: bool) -> Survey {
    let mut survey = Survey { innovations: Default::default(), errors: Default::default(), samples: 0.0 };
    for seed in FIRST..FIRST + 20 {
        let mut options = Options::new(seed, 5.0, 36.0 * (seed % 10) as f64, turbulence);
        if !scale_errors {
            let sensors = &mut options.conditions.sensors;
            (sensors.accelerometer_scale_max, sensors.gyroscope_scale_max) = (0.0, 0.0);
            sensors.cross_axis_max = 0.0;
        }
        let mut flight = Flight::new(options);
        flight.run(45.0);
        let before = Aid::ALL.map(|aid| *flight.estimator.innovations(aid));
        for _ in 0..30 {
            flight.run(5.0);
            // The plant is one frame ahead of the last state by now.
            let (truth, snapshot) = (flight.last().truth, flight.estimator.snapshot().unwrap());
            let (e, p) = (error(&flight, &snapshot, &truth), covariance(&snapshot));
            for (sum, (_, at, count)) in survey.errors.iter_mut().zip(BLOCKS) {
                let p = p.view((at, at), (count, count)).into_owned().cholesky().unwrap();
                let e = e.rows(at, count).into_owned();
                *sum += e.dot(&p.solve(&e));
            }
            survey.samples += 1.0;
        }
        for ((sum, aid), before) in survey.innovations.iter_mut().zip(Aid::ALL).zip(before) {
            let of = flight.estimator.innovations(aid);
            *sum = (sum.0 + of.squares - before.squares, sum.1 + (of.count - before.count) as f64);
        }
    }
    survey
}

const LEVELS: [Turbulence; 3] = [Turbulence::Calm, Turbulence::Light, Turbulence::Moderate];

/// Mean normalised innovation squared of each aid that the filter may show in this plant: never more than 1, or it would be too
/// sure of itself, and how much less is a choice that stands with each noise in its configuration.
const INNOVATIONS: [(Aid, f64); Aid::ALL.len()] = [
    (Aid::GpsVelocity, 0.4),
    (Aid::GpsPosition, 0.08),
    (Aid::Barometer, 0.5),
    (Aid::Airspeed, 0.0),
    (Aid::Sideslip, 0.0),
    (Aid::Magnetometer, 0.002),
];

#[test]
fn innovations_are_no_larger_than_the_filter_expects() {
    for turbulence in LEVELS {
        let survey = survey(turbulence, true);
        for ((aid, least), (squares, count)) in INNOVATIONS.into_iter().zip(survey.innovations) {
            let mean = squares / count;
            println!("{turbulence:?} {aid:?} {mean:.3}");
            assert!(count > 10_000.0 && (least..1.0).contains(&mean), "{turbulence:?} {aid:?}: {mean}");
        }
    }
}

/// χ² of `n` degrees of freedom is below this in 999 of 1000 cases (Wilson and Hilferty).
fn chi_square_999(n: f64) -> f64 {
    n * (1.0 - 2.0 / (9.0 * n) + 3.09 * (2.0 / (9.0 * n)).sqrt()).powi(3)
}

#[test]
fn errors_are_no_larger_than_the_filter_says() {
    for (turbulence, scale_errors) in LEVELS.into_iter().flat_map(|level| [(level, false), (level, true)]) {
        let survey = survey(turbulence, scale_errors);
        for ((name, _, states), sum) in BLOCKS.into_iter().zip(survey.errors) {
            let mean = sum / survey.samples;
            println!("{turbulence:?} scale errors {scale_errors} {name} {mean:.2} of {states}");
            // A scale error cannot be told from a bias in level flight: there the state holds both.
            if scale_errors && name == "accelerometer bias" {
                continue;
            }
            // Errors of one flight hang together, so that each flight counts once.
            let bound = chi_square_999((states * 20) as f64) / 20.0;
            assert!(mean < bound && mean > 0.02 * states as f64, "{turbulence:?} {name}: {mean} of {states}");
        }
    }
}

#[test]
fn errors_over_unseen_seeds_are_excellent_against_the_truth_that_can_be_seen() {
    for turbulence in LEVELS {
        for seed in FIRST + 100..FIRST + 124 {
            let (speed, from) = ((seed % 9) as f64, (seed * 47 % 360) as f64);
            let mut flight = Flight::new(Options::new(seed, speed, from, turbulence));
            flight.run(150.0);
            let e = flight.estimate_errors(40.0);
            let good = e.roll_deg < 0.25
                && e.pitch_deg < 0.25
                && e.yaw_deg < 0.5
                && e.velocity_mps < 0.05
                && nalgebra::Vector2::new(e.horizontal_m, e.height_m).norm() < 0.8;
            assert!(good, "{turbulence:?} seed {seed}: {e:?}");
            // Against the truth as it is there is the receiver's and the barometer's slow error more, and nothing else.
            let (off, slow) = flight.true_position_errors(40.0);
            assert!(
                (off - slow).abs() < 0.8,
                "{turbulence:?} seed {seed}: {off} m, of which {slow} m can not be seen"
            );
        }
    }
}

#[test]
fn the_seeds_filter_without_pressures_flies_two_laps_with_these_errors() {
    let mut worst = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
    for seed in FIRST + 200..FIRST + 206 {
        for turbulence in LEVELS {
            let mut options = Options::new(seed, 4.0, 60.0 * (seed % 6) as f64, turbulence);
            options.estimator.aiding = Aiding { pressure: false, ..Aiding::default() };
            let mut flight = Flight::new(options);
            flight.run_mission(400.0);
            assert_eq!(flight.order()[..8], [0, 1, 2, 3, 0, 1, 2, 3]);
            let e = flight.estimate_errors(40.0);
            let heights = flight.frames.iter().filter(|f| f.truth.time_s >= 40.0).filter_map(|f| {
                let n = f.navigation?;
                Some(n.altitude_m() + f.truth.position_ned_m.z + f.truth.gps_slow_error_ned_m.z)
            });
            let (sum, count) = heights.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
            let height = (sum / count).sqrt();
            worst = (
                worst.0.max(e.roll_deg.max(e.pitch_deg)),
                worst.1.max(e.yaw_deg),
                worst.2.max(e.velocity_mps),
                worst.3.max(e.horizontal_m),
                worst.4.max(height),
            );
        }
    }
    println!(
        "roll, pitch {:.2}° yaw {:.2}° velocity {:.3} m/s horizontal {:.2} m height {:.2} m",
        worst.0, worst.1, worst.2, worst.3, worst.4
    );
    assert!(worst.0 < 0.25 && worst.1 < 0.5 && worst.2 < 0.05 && worst.3 < 0.8 && worst.4 < 1.0, "{worst:?}");
}
