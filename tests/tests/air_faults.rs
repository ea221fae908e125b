//! Faults outside of the flight computer: sensors, actuators, air and the simulator's time. The aircraft flies its two laps.

use bateleur_tests::{Ended, ONE_PROCESS, TWO_LAPS, among_others, bateleur, flight_schedule};
use serde_json::Value;

fn fly(choices: &[&str]) -> Ended {
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(["--seed", "2", "--wind", "5", "--wind-from", "200", "--turbulence", "light"]);
    arguments.extend(choices);
    bateleur(&arguments).end()
}

fn number(summary: &Value, name: &str) -> f64 {
    summary[name].as_f64().unwrap_or(f64::INFINITY)
}

/// Flies with a fault: all way-points in order, and never further off the path than `cross_track_m`.
fn assert_flown_with(fault: &str, cross_track_m: f64) -> Value {
    let _turn = among_others();
    let summary = fly(&[&ONE_PROCESS[..], &["--fault", fault]].concat()).expect_code(0).summary();
    let (straight, most) =
        (number(&summary, "straight_cross_track_rms_m"), number(&summary, "cross_track_max_m"));
    eprintln!("{fault}: straight track {straight:.2} m, at most {most:.1} m off");
    assert_eq!(summary["completed"], true, "{fault}: {}", summary["failure"]);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()), "{fault}");
    assert!(most < cross_track_m, "{fault}: {most} m off");
    assert_eq!(
        summary["conditions"]["faults"].as_array().map(Vec::len),
        Some(1),
        "{}",
        summary["conditions"]
    );
    summary
}

#[test]
fn satellites_lost_for_30_seconds_are_bridged() {
    assert_flown_with("gps_lost@100..130", 30.0);
}

#[test]
fn lost_magnetometer_is_flown_without() {
    assert_flown_with("magnetometer_lost@60", 15.0);
}

#[test]
fn blocked_pitot_keeps_the_path() {
    assert_flown_with("pitot_blocked@60", 15.0);
}

/// Moderate air from 45°, in which an aircraft that believes its pitot is lost or flies 100 m too low.
fn assert_wrong_pitot_is_found(fault: &str) {
    let _turn = among_others();
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(["--seed", "1", "--wind", "5", "--wind-from", "45", "--turbulence", "moderate"]);
    arguments.extend(ONE_PROCESS);
    arguments.extend(["--fault", fault]);
    let summary = bateleur(&arguments).end().expect_code(0).summary();
    let conditions = &summary["conditions"];
    let airspeeds = (number(conditions, "airspeed_min_mps"), number(conditions, "airspeed_max_mps"));
    eprintln!("{fault}: altitude {:.2} m RMS, airspeed {airspeeds:?}", number(&summary, "altitude_rms_m"));
    assert_eq!(summary["completed"], true, "{fault}: {}", summary["failure"]);
    assert!(number(&summary, "altitude_rms_m") < 2.0, "{fault}: {}", summary["altitude_rms_m"]);
    assert!(airspeeds.1 < 34.0, "{fault}: {airspeeds:?}");
    let told = summary["ignored_errors"]["application_error"].as_u64();
    assert!(told.is_some_and(|told| told >= 1), "{fault}: nothing in the health log");
}

#[test]
fn pitot_that_is_blocked_is_found_and_the_flight_goes_on_by_lift() {
    assert_wrong_pitot_is_found("pitot_blocked@60");
}

#[test]
fn pitot_that_ices_is_found_and_the_flight_goes_on_by_lift() {
    assert_wrong_pitot_is_found("pitot_icing=-0.3@60");
}

#[test]
fn pitot_that_tells_nothing_but_zero_is_found_and_the_flight_goes_on_by_lift() {
    assert_wrong_pitot_is_found("pitot_scale=0@60");
}

#[test]
fn second_without_inertial_values_is_flown_with_still_surfaces() {
    let summary = assert_flown_with("inertial_lost@72..73", 60.0);
    assert!(summary["ignored_errors"]["application_error"].as_u64() >= Some(1), "it is told");
}

#[test]
fn one_sensor_set_in_fifty_lost_is_hardly_seen() {
    let summary = assert_flown_with("frames_lost=1/50", 15.0);
    assert!(
        number(&summary, "straight_cross_track_rms_m") < 1.5,
        "{}",
        summary["straight_cross_track_rms_m"]
    );
}

#[test]
fn sixty_milliseconds_more_delay_are_tolerated() {
    assert_flown_with("delay=0.06", 15.0);
}

#[test]
fn aileron_stuck_at_30_percent_is_held_against_by_the_other() {
    assert_flown_with("left_aileron_stuck=30%@60", 15.0);
}

#[test]
fn simulator_that_pauses_is_flown_on_with() {
    assert_flown_with("pause@60..60.5", 30.0);
}

#[test]
fn faults_repeat_with_their_seed_and_change_the_flight() {
    let _turn = among_others();
    let digest = |choices: &[&str]| fly(choices).expect_code(0).summary()["digest"].clone();
    let lost = ["--fault", "frames_lost=1/50", "--fault", "gps_lost@100..110"];
    let first = digest(&lost);
    assert_eq!(digest(&lost), first);
    assert_ne!(digest(&[]), first);
}

#[test]
fn varied_aircraft_with_play_and_bare_sensors_flies_and_says_what_it_was() {
    let _turn = among_others();
    let aircraft = ["--vary", "mass=10%,inertia=10%,derivatives=20%", "--plant", "servo.backlash_rad=0.01"];
    let summary =
        fly(&[&ONE_PROCESS[..], &aircraft, &["--sensors", "data-sheet"]].concat()).expect_code(0).summary();
    assert_eq!(summary["completed"], true, "{}", summary["failure"]);
    let variation = summary["conditions"]["variation"].to_string();
    assert!(variation.contains("derivatives=0.2") && variation.contains("backlash"), "{variation}");
    assert!(variation.contains("sensors data-sheet"), "{variation}");
}

#[test]
fn fault_that_there_is_not_is_answered_with_the_one_that_was_meant() {
    let ended = fly(&["--fault", "gps_last@100"]).expect_code(2);
    assert!(ended.stderr.contains("did you mean `gps_lost`"), "{}", ended.stderr);
}

#[test]
fn faults_for_somebody_elses_simulator_are_refused() {
    let ended = fly(&["--fault", "gps_lost@100", "--no-simulator"]).expect_code(2);
    assert!(ended.stderr.contains("--no-simulator"), "{}", ended.stderr);
}
