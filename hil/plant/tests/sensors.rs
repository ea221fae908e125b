//! Statistics and timing of the sensors.
#![expect(clippy::unwrap_used, reason = "a panic in a test is a failed test")]

use bateleur_plant::atmosphere::GRAVITY_MPS2;
use bateleur_plant::sensors::MAGNETIC_FIELD_NED_GAUSS;
use bateleur_plant::{
    Airframe, Conditions, Controls, FlightStart, GpsErrors, RangeErrors, SensorErrors, Simulation,
};
use nalgebra::Vector3;

/// Mean and deviation of a series.
fn statistics(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt())
}

fn parked(seed: u64, sensors: SensorErrors) -> Simulation {
    let conditions = Conditions { seed, sensors, ..Conditions::default() };
    Simulation::new(&Airframe::aerosonde(), &conditions).unwrap()
}

fn flying(sensors: SensorErrors) -> (Simulation, Controls) {
    let conditions = Conditions { sensors, ..Conditions::default() };
    let airframe = Airframe::aerosonde();
    let controls = bateleur_plant::trim(&airframe, 22.0, 0.0, 160.0).unwrap().controls;
    (Simulation::in_flight(&airframe, &conditions, &FlightStart::default()).unwrap(), controls)
}

#[test]
fn noise_of_a_parked_aircraft_has_the_sizes_asked_for() {
    let errors = SensorErrors::default();
    let mut plant = parked(11, errors.clone());
    let mut series = vec![Vec::new(); 5];
    for _ in 0..5000 {
        plant.advance(Controls::default(), 0.02);
        let s = plant.sensors();
        let row = [
            s.accelerometer_mps2.x,
            s.gyroscope_radps.y,
            s.magnetometer_gauss.z,
            s.static_pressure_pa,
            s.differential_pressure_pa,
        ];
        row.into_iter().zip(&mut series).for_each(|(value, column)| column.push(value));
    }
    let wanted = [
        errors.accelerometer_noise_mps2,
        errors.gyroscope_noise_radps,
        errors.magnetometer_noise_gauss,
        errors.static_pressure_noise_pa,
        errors.differential_pressure_noise_pa,
    ];
    for (column, (values, sigma)) in series.iter().zip(wanted).enumerate() {
        let (_, measured) = statistics(values);
        // The barometer also drifts, by some pascals in 100 s.
        let room = if column == 3 { 0.4 } else { 0.05 };
        assert!((measured / sigma - 1.0).abs() < room, "column {column}: {measured} against {sigma}");
    }
    let truth = plant.truth();
    let (gyro, _) = statistics(&series[1]);
    assert!((gyro - truth.gyroscope_bias_radps.y).abs() < 2e-4, "gyroscope mean is its bias");
}

#[test]
fn noise_of_a_shorter_mean_is_louder_by_the_root() {
    let errors = SensorErrors::default();
    let mut plant = parked(11, errors.clone());
    let mut values = Vec::new();
    for _ in 0..4000 {
        plant.advance(Controls::default(), 0.005);
        values.push(plant.sensors().gyroscope_radps.x);
    }
    assert!((statistics(&values).1 / (2.0 * errors.gyroscope_noise_radps) - 1.0).abs() < 0.05);
}

#[test]
fn biases_spread_over_the_range_asked_for() {
    let errors = SensorErrors::default();
    let limit = errors.accelerometer_bias_max_mps2;
    let values: Vec<f64> =
        (0..300).map(|seed| parked(seed, errors.clone()).truth().accelerometer_bias_mps2.x).collect();
    let (mean, sigma) = statistics(&values);
    assert!(values.iter().all(|b| b.abs() <= limit));
    assert!(
        mean.abs() < 0.15 * limit && (sigma * 3.0_f64.sqrt() / limit - 1.0).abs() < 0.1,
        "{mean} {sigma}"
    );
}

#[test]
fn perfect_sensors_in_trimmed_flight_tell_the_truth() {
    let (mut plant, controls) = flying(SensorErrors::none());
    plant.advance(controls, 1.0);
    let (s, t) = (plant.sensors(), plant.truth());
    assert!((s.accelerometer_mps2.norm() - GRAVITY_MPS2).abs() < 0.01, "{}", s.accelerometer_mps2);
    assert!(s.gyroscope_radps.norm() < 1e-3);
    let field = t.attitude * s.magnetometer_gauss;
    assert!((field - Vector3::from(MAGNETIC_FIELD_NED_GAUSS)).norm() < 1e-12);
    let altitude = 44_330.77 * (1.0 - (s.static_pressure_pa / 101_325.0).powf(0.190_263_2));
    assert!((altitude - 160.0).abs() < 0.5, "pressure altitude {altitude}");
    let airspeed = (2.0 * s.differential_pressure_pa / t.density_kgpm3).sqrt();
    assert!((airspeed - 22.0).abs() < 0.01, "pitot {airspeed}");
    assert!((s.differential_pressure_pa - 290.0).abs() < 6.0, "{}", s.differential_pressure_pa);
}

#[test]
fn range_finder_looks_along_the_bodys_axis_as_far_as_it_can_and_misses_some() {
    let far = RangeErrors { most_m: 300.0, ..SensorErrors::none().range };
    let (mut plant, controls) = flying(SensorErrors { range: far.clone(), ..SensorErrors::none() });
    for aileron_rad in [0.0, 0.1, -0.05] {
        plant.advance(Controls { aileron_rad, ..controls }, 0.6);
        let (s, t) = (plant.sensors(), plant.truth());
        let down = (t.attitude * Vector3::z()).z;
        assert!((s.range_m.unwrap() * down + t.position_ned_m.z).abs() < 1e-9, "{down}");
    }
    let (mut plant, controls) = flying(SensorErrors::none());
    plant.advance(controls, 0.1);
    assert_eq!(plant.sensors().range_m, None, "160 m are too far for it");
    let none = RangeErrors { fitted: false, ..far };
    let (mut plant, controls) = flying(SensorErrors { range: none, ..SensorErrors::none() });
    plant.advance(controls, 0.1);
    assert_eq!(plant.sensors().range_m, None);
    let mut seen = Vec::new();
    for seed in 0..40 {
        let mut plant = parked(seed, SensorErrors::default());
        for _ in 0..100 {
            plant.advance(Controls::default(), 0.02);
            seen.extend(plant.sensors().range_m);
        }
    }
    let (mean_m, deviation_m) = statistics(&seen);
    let stands_m = -parked(1, SensorErrors::none()).truth().position_ned_m.z;
    assert!((mean_m - stands_m).abs() < 0.03, "{mean_m} {stands_m}");
    assert!((0.05..0.07).contains(&deviation_m), "{deviation_m}: noise and offset");
    assert!((3_880..3_960).contains(&seen.len()), "{} of 4000", seen.len());
}

#[test]
fn inertial_means_add_up_to_the_change_of_velocity_and_heading() {
    let (mut plant, controls) = flying(SensorErrors::none());
    let mut velocity = plant.truth().velocity_ned_mps;
    let mut attitude = plant.truth().attitude;
    for _ in 0..800 {
        plant.advance(Controls { aileron_rad: controls.aileron_rad + 0.01, ..controls }, 0.0025);
        let s = plant.sensors();
        let half = nalgebra::UnitQuaternion::from_scaled_axis(s.gyroscope_radps * 0.5 * s.interval_s);
        let middle = attitude * half;
        attitude = middle * half;
        velocity += (middle * s.accelerometer_mps2 + Vector3::new(0.0, 0.0, GRAVITY_MPS2)) * s.interval_s;
    }
    let truth = plant.truth();
    assert!(truth.roll_rad > 0.1, "the test aircraft turns");
    assert!((velocity - truth.velocity_ned_mps).norm() < 1e-3, "{velocity} {}", truth.velocity_ned_mps);
    assert!(attitude.angle_to(&truth.attitude) < 1e-4);
}

#[test]
fn a_fix_comes_five_times_a_second_120_ms_late_and_once() {
    let (mut plant, controls) = flying(SensorErrors {
        gps: GpsErrors { latency_s: 0.12, ..SensorErrors::none().gps },
        ..SensorErrors::none()
    });
    let (mut fixes, mut places) = (Vec::new(), vec![plant.truth().position_ned_m]);
    for _ in 0..500 {
        plant.advance(controls, 0.02);
        places.push(plant.truth().position_ned_m);
        let sample = plant.sensors();
        assert_eq!(plant.sensors().gps, None, "a fix was given twice");
        fixes.extend(sample.gps.map(|fix| (sample.time_s, fix)));
    }
    assert_eq!(fixes.len(), 49);
    for (time_s, fix) in fixes {
        assert!((time_s - fix.measured_at_s - 0.12).abs() < 1e-9, "{time_s} {}", fix.measured_at_s);
        let then = places[(fix.measured_at_s / 0.02).round() as usize];
        assert!((fix.position_ned_m - then).norm() < 1e-9, "the fix is not where the aircraft was");
    }
}

#[test]
fn latency_longer_than_the_interval_loses_no_fix() {
    let gps = GpsErrors { latency_s: 0.25, ..SensorErrors::none().gps };
    let (mut plant, controls) = flying(SensorErrors { gps, ..SensorErrors::none() });
    let count = (0..500).filter(|_| {
        plant.advance(controls, 0.02);
        plant.sensors().gps.is_some()
    });
    assert_eq!(count.count(), 48);
}

#[test]
fn fix_is_the_truth_shifted_by_the_readable_slow_error() {
    let mut plant = parked(5, SensorErrors::default());
    let mut velocities = Vec::new();
    for _ in 0..5000 {
        plant.advance(Controls::default(), 0.02);
        if let Some(fix) = plant.sensors().gps {
            let truth = plant.truth();
            let shifted = truth.position_ned_m + truth.gps_slow_error_ned_m;
            assert!((fix.position_ned_m - shifted).norm() < 1.0, "{} {shifted}", fix.position_ned_m);
            assert!(
                (bateleur_plant::LocalFrame::new(0.0).to_ned(&fix.geodetic) - fix.position_ned_m).norm()
                    < 1e-6
            );
            velocities.push(fix.velocity_ned_mps.x);
        }
    }
    assert!((statistics(&velocities).1 / 0.05 - 1.0).abs() < 0.15);
}

#[test]
fn slow_errors_spread_as_configured_over_the_seeds() {
    let start = |seed| parked(seed, SensorErrors::default()).truth();
    let truths: Vec<_> = (0..400).map(start).collect();
    let spread =
        |f: &dyn Fn(&bateleur_plant::Truth) -> f64| statistics(&truths.iter().map(f).collect::<Vec<_>>()).1;
    let (north, down) = (spread(&|t| t.gps_slow_error_ned_m.x), spread(&|t| t.gps_slow_error_ned_m.z));
    let barometer = spread(&|t| t.barometer_bias_m);
    assert!((north - 4.93).abs() < 0.5 && (down - 9.39).abs() < 1.0, "{north} {down}");
    assert!((barometer - 1.5).abs() < 0.15, "{barometer}");
}

#[test]
fn slow_error_grows_by_its_step_in_a_second() {
    let gps = GpsErrors { slow_starts_spread: false, ..GpsErrors::default() };
    let errors = SensorErrors { gps, ..SensorErrors::default() };
    let grown: Vec<f64> = (0..300)
        .map(|seed| {
            let mut plant = parked(seed, errors.clone());
            plant.advance(Controls::default(), 1.0);
            plant.truth().gps_slow_error_ned_m.y
        })
        .collect();
    assert!((statistics(&grown).1 / 0.21 - 1.0).abs() < 0.12, "{}", statistics(&grown).1);
}

#[test]
fn fixes_are_missed_and_outages_come_as_often_as_asked_for() {
    let fixes = |gps: GpsErrors, seconds: usize| {
        let mut plant = parked(21, SensorErrors { gps, ..SensorErrors::none() });
        let mut times = Vec::new();
        for _ in 0..seconds * 5 {
            plant.advance(Controls::default(), 0.2);
            times.extend(plant.sensors().gps.map(|fix| fix.measured_at_s));
        }
        times
    };
    let some = GpsErrors { missed: 0.1, ..SensorErrors::none().gps };
    let share = 1.0 - fixes(some, 1000).len() as f64 / 5000.0;
    assert!((share - 0.1).abs() < 0.015, "{share} of the fixes are missed");
    let outages = GpsErrors { outage_every_s: 50.0, outage_s: 4.0, ..SensorErrors::none().gps };
    let times = fixes(outages, 5000);
    let gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > 0.3).collect();
    // One begins every 50 s of fixes, each lasts 2 to 6 s, and the next fix comes up to 0.2 s later.
    let (mean, _) = statistics(&gaps);
    assert!((75..115).contains(&gaps.len()), "{} outages", gaps.len());
    assert!((mean - 4.1).abs() < 0.4 && gaps.iter().all(|gap| (2.0..6.3).contains(gap)), "{mean}");
}
