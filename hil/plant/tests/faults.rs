//! Faults as the flight computer sees them.
#![expect(clippy::unwrap_used, reason = "a panic in a test is a failed test")]

use bateleur_plant::{
    Airframe, Conditions, FlightStart, SensorErrors, SensorSet, Simulation, Truth, Turbulence, trim,
};
use nalgebra::Vector3;

/// Flies in trim with faults; one row for each 20 ms.
fn flown(conditions: Conditions, faults: &[&str], seconds: f64) -> Vec<(SensorSet, Truth)> {
    let faults = faults.iter().map(|text| text.parse().unwrap()).collect();
    let conditions = Conditions { faults, ..conditions };
    let airframe = Airframe::aerosonde();
    let controls = trim(&airframe, 22.0, 0.0, 160.0).unwrap().controls;
    let mut plant = Simulation::in_flight(&airframe, &conditions, &FlightStart::default()).unwrap();
    let step = |_| {
        plant.advance(controls, 0.02);
        (plant.sensors(), plant.truth())
    };
    (0..(seconds / 0.02) as usize).map(step).collect()
}

fn quiet() -> Conditions {
    Conditions { sensors: SensorErrors::none(), ..Conditions::default() }
}

#[test]
fn receiver_lost_late_and_shifted_is_all_of_that_for_its_time() {
    let fixes = |faults: &[&str]| {
        let rows = flown(quiet(), faults, 10.0);
        rows.into_iter().filter_map(|(set, _)| set.gps.map(|fix| (set.time_s, fix))).collect::<Vec<_>>()
    };
    let usual = fixes(&[]);
    let lost = fixes(&["gps_lost@3..6"]);
    assert_eq!(lost.len(), usual.len() - 15);
    assert!(lost.iter().all(|(_, fix)| !(3.0..5.99).contains(&fix.measured_at_s)), "{lost:?}");
    for (time_s, fix) in fixes(&["gps_late=0.25@3..6"]) {
        let late = if (3.0..6.0).contains(&fix.measured_at_s) { 0.25 } else { 0.0 };
        // Sampled every 20 ms; without its latency a fix of perfect sensors comes at once.
        assert!((time_s - fix.measured_at_s - late).abs() < 0.021, "{time_s} {}", fix.measured_at_s);
    }
    for ((_, plain), (_, shifted)) in usual.iter().zip(fixes(&["gps_shift=30@3..6"])) {
        let north = if (3.0..6.0).contains(&plain.measured_at_s) { 30.0 } else { 0.0 };
        let off = shifted.position_ned_m - plain.position_ned_m;
        assert!((off - Vector3::new(north, 0.0, 0.0)).norm() < 1e-9, "{off}");
        assert_eq!(shifted.velocity_ned_mps, plain.velocity_ned_mps);
    }
}

#[test]
fn range_finder_lost_stuck_and_shifted_is_that_for_its_time() {
    let mut conditions = quiet();
    conditions.sensors.range.most_m = 300.0;
    let sunk = "updraft=-6@1..21";
    let ranges = |fault: &str| -> Vec<(f64, Option<f64>)> {
        let rows = flown(conditions.clone(), &[sunk, fault], 6.0);
        rows.into_iter().map(|(set, _)| (set.time_s, set.range_m)).collect()
    };
    let usual = ranges("gps_lost@0..0.1");
    for (fault, during) in [
        ("range_lost@3..5", (|_, _| None) as fn(f64, f64) -> Option<f64>),
        ("range_shift=-1.5@3..5", |now, _| Some(now - 1.5)),
        ("range_stuck@3..5", |_, then| Some(then)),
    ] {
        let mut before = None;
        for ((time_s, plain), (_, told)) in usual.iter().zip(ranges(fault)) {
            let acts = (3.0..5.0).contains(time_s);
            let expected = if acts { during(plain.unwrap(), before.unwrap()) } else { *plain };
            before = if acts { before } else { *plain };
            assert_eq!(told, expected, "{fault} at {time_s} s");
        }
    }
}

#[test]
fn blocked_pitot_reads_height_and_blocked_static_ports_the_opposite() {
    // A descent in an updraft turned down.
    let sinking = "updraft=-6@1..21";
    let ends = |fault: &str| *flown(quiet(), &[sinking, fault], 12.0).last().unwrap();
    let (pitot, truth) = ends("pitot_blocked@0.5");
    let sunk = -160.0 - truth.position_ned_m.z;
    assert!(sunk < -15.0, "it sinks by {sunk} m");
    let true_pa = 0.5 * truth.density_kgpm3 * truth.airspeed_mps.powi(2);
    let weight_pa = truth.density_kgpm3 * 9.80665 * -sunk;
    let at_first_pa = 0.5 * truth.density_kgpm3 * 22.0 * 22.0;
    // What was shut in at 22 m/s, less the pressure that has come up outside.
    let off = pitot.differential_pressure_pa - (at_first_pa - weight_pa);
    assert!(off.abs() < 8.0, "{} {true_pa} {weight_pa}", pitot.differential_pressure_pa);
    let (ports, _) = ends("static_blocked@0.5");
    assert!(
        (ports.differential_pressure_pa - true_pa - weight_pa).abs() < 8.0,
        "{ports:?} {true_pa} {weight_pa}"
    );
    let rows = flown(quiet(), &[sinking, "static_blocked@0.5"], 12.0);
    assert_eq!(rows[100].0.static_pressure_pa, rows[500].0.static_pressure_pa);
}

#[test]
fn faults_shift_no_other_chance() {
    let conditions = Conditions { seed: 5, turbulence: Turbulence::Light, ..Conditions::default() };
    let usual = flown(conditions.clone(), &[], 8.0);
    let faults = [
        "gps_lost@1..3",
        "magnetometer_lost@1..3",
        "pitot_blocked@1..3",
        "frames_lost=10%@1..3",
        "pitot_lost@2..3",
    ];
    let troubled = flown(conditions, &faults, 8.0);
    for ((set, truth), (other, same)) in usual.iter().zip(&troubled) {
        assert_eq!(truth.position_ned_m, same.position_ned_m);
        if truth.time_s > 3.3 {
            assert_eq!(set, other, "at {} s", truth.time_s);
        }
    }
}

#[test]
fn shifted_bias_is_added_on_each_axis_while_the_fault_lasts() {
    let usual = flown(quiet(), &[], 3.0);
    let faults = ["gyroscope_shift=2@1..2", "accelerometer_shift=0.5@1..2", "magnetometer_shift=0.05@1..2"];
    for ((set, _), (shifted, truth)) in usual.iter().zip(flown(quiet(), &faults, 3.0)) {
        let on = if (1.0..1.999).contains(&truth.time_s) { 1.0 } else { 0.0 };
        let near = |off: Vector3<f64>, by: f64| (off - Vector3::repeat(by * on)).norm() < 1e-9;
        assert!(
            near(shifted.gyroscope_radps - set.gyroscope_radps, 2.0_f64.to_radians()),
            "{}",
            truth.time_s
        );
        assert!(near(shifted.accelerometer_mps2 - set.accelerometer_mps2, 0.5));
        assert!(near(shifted.magnetometer_gauss - set.magnetometer_gauss, 0.05));
    }
}

#[test]
fn elevator_that_is_stuck_up_pitches_the_aircraft_up() {
    let rows = flown(quiet(), &["elevator_stuck=-60%@1"], 2.0);
    let (_, before) = rows[49];
    let (_, after) = rows[60];
    assert!((after.surfaces.elevator_rad + 0.6 * 0.52).abs() < 1e-3, "{:?}", after.surfaces);
    assert!(after.rates_radps.y > before.rates_radps.y + 0.2, "{} {}", before.rates_radps, after.rates_radps);
}
