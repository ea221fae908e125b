//! Flights whose sensors and servos are on a CAN bus, behind one gateway or two.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use bateleur_tests::{Ended, TWO_LAPS, among_others, bateleur, flight_schedule, repository};
use serde_json::Value;

const GUSTY: [&str; 8] = ["--seed", "5", "--wind", "5", "--wind-from", "200", "--turbulence", "light"];

fn fly(schedule: &std::path::Path, choices: &[&str]) -> Ended {
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(GUSTY);
    arguments.extend(choices);
    bateleur(&arguments).end().expect_code(0)
}

fn over_can(choices: &[&str]) -> Ended {
    fly(&repository().join("schedules/can.toml"), choices)
}

/// Two laps, with scores within 1.2 times of those of a flight without a bus; some centimetres are nobody's fault.
fn assert_as_good(summary: &Value, direct: &Value) {
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
    for score in ["altitude_rms_m", "straight_cross_track_rms_m"] {
        let (over_can, direct) = (summary[score].as_f64().unwrap(), direct[score].as_f64().unwrap());
        eprintln!("{score}: {over_can} over CAN, {direct} direct");
        assert!(over_can <= 1.2 * direct + 0.05, "{score}: {over_can} over CAN, {direct} direct");
    }
}

#[test]
fn two_laps_over_one_gateway_and_over_two_are_flown_as_well_as_without_and_the_same_for_a_seed() {
    let _turn = among_others();
    let direct = fly(&flight_schedule(), &[]).summary();
    let one = over_can(&[]).summary();
    let again = over_can(&[]).summary();
    let two = over_can(&["--set", "can_interface.bus=slcan"]);
    assert_as_good(&one, &direct);
    assert_as_good(&two.summary(), &direct);
    assert_eq!(one["digest"], again["digest"]);
    let log = std::fs::read_to_string(two.folder().join("can.log")).unwrap();
    assert!(log.lines().count() > 100_000, "every frame of the flight went over the second bus");
    for identifier in [" 2F0#", " 110#", " 133#", " 1F0#"] {
        assert!(log.contains(identifier), "{identifier}");
    }
}

#[test]
fn gateway_that_is_killed_in_flight_is_restarted_and_found_again() {
    let _turn = among_others();
    let ended = over_can(&["--kill", "can_interface@100"]);
    assert_eq!(ended.summary()["waypoints"], Value::from(TWO_LAPS.to_vec()));
    assert!(ended.stderr.contains("can_interface: back after"), "{}", ended.stderr);
    let lost = over_can(&["--kill", "can_interface@100", "--set", "can_interface.bus=slcan"]);
    assert_eq!(lost.summary()["waypoints"], Value::from(TWO_LAPS.to_vec()));
}
