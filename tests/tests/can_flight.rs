//! Flights whose sensors and servos are on a CAN bus, behind one gateway or two.

use std::time::Duration;

use bateleur_tests::{
    Ended, ONE_PROCESS, TWO_LAPS, alone, among_others, bateleur, flight_schedule, is_long, repository,
    small_mission,
};
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

/// The same flight with sensors and servos at the simulator.
fn without_a_bus() -> Value {
    fly(&flight_schedule(), &ONE_PROCESS).summary()
}

/// Way-points as they should be, with scores within 1.2 times of those of a flight without a bus; some centimetres are nobody's fault.
fn assert_as_good(summary: &Value, direct: &Value, waypoints: &Value) {
    assert_eq!(summary["waypoints"], *waypoints);
    for score in ["altitude_rms_m", "straight_cross_track_rms_m"] {
        let (over_can, direct) = (summary[score].as_f64().unwrap(), direct[score].as_f64().unwrap());
        eprintln!("{score}: {over_can} over CAN, {direct} direct");
        assert!(over_can <= 1.2 * direct + 0.05, "{score}: {over_can} over CAN, {direct} direct");
    }
}

#[test]
fn two_laps_over_one_gateway_and_over_two_are_flown_as_well_as_without_and_the_same_for_a_seed() {
    let _turn = among_others();
    let direct = without_a_bus();
    let one = over_can(&[]).summary();
    let again = over_can(&[]).summary();
    let two = over_can(&["--set", "can_interface.bus=slcan"]);
    let waypoints = TWO_LAPS.to_vec().into();
    assert_as_good(&one, &direct, &waypoints);
    assert_as_good(&two.summary(), &direct, &waypoints);
    assert_eq!(one["digest"], again["digest"]);
    let log = std::fs::read_to_string(two.folder().join("can.log")).unwrap();
    assert!(log.lines().count() > 100_000, "every frame of the flight went over the second bus");
    for identifier in [" 2F0#", " 110#", " 133#", " 1F0#"] {
        assert!(log.contains(identifier), "{identifier}");
    }
}

/// A mission that is over sooner than two laps, unless there is time for these; when somebody is killed in it; its way-points.
fn mission() -> (Vec<String>, &'static str, Value) {
    if is_long() {
        return (Vec::new(), "100", TWO_LAPS.to_vec().into());
    }
    let options = ["--mission".to_owned(), small_mission().display().to_string()];
    (options.to_vec(), "40", vec!["WP0", "WP1", "WP2", "WP0"].into())
}

#[test]
fn partition_on_the_bus_that_is_killed_in_flight_is_restarted_and_finds_its_gateway_again() {
    let _turn = among_others();
    let (mission, at_s, waypoints) = mission();
    let kill = format!("can_interface@{at_s}");
    for bus in [&[][..], &["--set", "can_interface.bus=slcan"]] {
        let mut choices: Vec<&str> = mission.iter().map(String::as_str).collect();
        choices.extend(["--kill", &kill]);
        choices.extend(bus);
        let ended = over_can(&choices).expect_words(&["can_interface: back after"]);
        assert_eq!(ended.summary()["waypoints"], waypoints);
    }
}

#[test]
fn landing_over_can_flares_by_the_range_finder_on_the_bus() {
    let _turn = among_others();
    let mission = small_mission().display().to_string();
    let summary = over_can(&["--mission", &mission, "--land"]).summary();
    let ranges = summary["messages"]["/can_interface/range"].as_u64().unwrap();
    assert!(ranges > 1_000, "{ranges} distances to the ground");
    let touchdown = &summary["conditions"]["touchdown"];
    assert!(touchdown["sink_mps"].as_f64().unwrap() < 2.0, "{touchdown}");
    assert!(touchdown["along_m"].as_f64().unwrap().abs() < 15.0, "{touchdown}");
}

/// How often the gateway between said that it has found the board's.
fn discoveries(ended: &Ended) -> usize {
    ended.stderr.lines().filter(|line| line.starts_with("gateway flight: found ")).count()
}

/// A flight over CAN in which a gateway is killed, as good as one without a bus.
fn with_a_gateway_killed(gateway: &str, choices: &[&str]) -> (Ended, &'static str) {
    let (mission, at_s, waypoints) = mission();
    let mission: Vec<&str> = mission.iter().map(String::as_str).collect();
    let direct = fly(&flight_schedule(), &[&ONE_PROCESS[..], &mission].concat()).summary();
    let kill = format!("{gateway}@{at_s}");
    let ended = over_can(&[&mission, choices, &["--kill-can", &kill]].concat());
    assert_as_good(&ended.summary(), &direct, &waypoints);
    (ended, at_s)
}

#[test]
fn gateway_between_that_is_killed_in_flight_is_started_again_and_found_by_both_sides() {
    let _turn = among_others();
    let (ended, at_s) = with_a_gateway_killed("gateway", &["--set", "can_interface.bus=slcan"]);
    let words = [
        format!("{at_s}.000 s  can_gateway is killed"),
        format!("{at_s}.500 s  can_gateway is started again"),
    ];
    let ended = ended.expect_words(&[&words[0], &words[1], "it has ended", "is there again"]);
    assert_eq!(discoveries(&ended), 2, "{}", ended.stderr);
    let after = std::fs::read_to_string(ended.folder().join("can.start-1.log")).unwrap();
    assert!(after.lines().count() > 10_000, "the flight went on over the new gateway");
}

#[test]
fn gateway_of_the_board_that_is_killed_in_flight_is_started_again_and_found_by_the_module() {
    let _turn = among_others();
    let (ended, _) = with_a_gateway_killed("board", &[]);
    ended.expect_words(&["can_board is killed", "can_board is started again", "was started anew"]);
}

#[test]
fn kill_of_what_a_flight_does_not_have_is_refused_with_what_would_help() {
    let refused = |schedule: &std::path::Path, kill: &str| {
        let schedule = schedule.to_str().unwrap();
        bateleur(&["fly", "--fast", "--schedule", schedule, "--kill-can", kill]).end().expect_code(2)
    };
    let can = repository().join("schedules/can.toml");
    refused(&can, "gateway@100").expect_words(&["none is inserted", "can_interface.bus=slcan"]);
    refused(&flight_schedule(), "board@100").expect_words(&["no partition of", "runs can_interface"]);
    refused(&can, "wing@100").expect_words(&["gateway@100"]);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn short_flight_on_the_wall_clock_over_two_gateways_is_flown_and_one_that_is_killed_is_found_again() {
        let _turn = alone();
        let (mission, schedule) = (small_mission(), repository().join("schedules/can.toml"));
        let flight = ["fly", "--format", "json", "--schedule", schedule.to_str().unwrap(), "--mission"];
        let choices =
            [mission.to_str().unwrap(), "--set", "can_interface.bus=slcan", "--kill-can", "gateway@35"];
        let ended = bateleur(&[&flight[..], &choices[..]].concat()).end_within(Duration::from_secs(200));
        let summary = ended.summary();
        assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
        let words = ["can_gateway is killed", "can_gateway is started again", "is there again"];
        let ended = ended.expect_code(0).expect_words(&words);
        assert_eq!((&summary["clock"], discoveries(&ended)), (&Value::from("wall"), 2), "{}", ended.stderr);
        assert_eq!(summary["waypoints"], Value::from(vec!["WP0", "WP1", "WP2", "WP0"]));
    }
}
