//! The partitioned flight and the plain loop, exactly: the same sensors, sticks and orders, every actuator word compared.

use bateleur_tests::{Ended, among_others, bateleur, flight_schedule};
use serde_json::Value;

/// Two laps with wind and gusts on the virtual clock.
fn fly(choices: &[&str]) -> Ended {
    let schedule = flight_schedule();
    let gusty = ["--seed", "7", "--wind", "6", "--wind-from", "250", "--turbulence", "moderate"];
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(gusty);
    arguments.extend(choices);
    let flown = bateleur(&arguments).end().expect_code(0);
    assert_eq!(flown.summary()["laps"], 2);
    flown
}

fn replay(flown: &Ended, code: i32) -> Value {
    let folder = flown.folder();
    bateleur(&["replay", folder.to_str().unwrap(), "--format", "json"]).end().expect_code(code).summary()
}

fn first_s(words: &Value) -> f64 {
    words["first_ns"].as_f64().unwrap() / 1e9
}

#[test]
fn plain_loop_gives_every_actuator_word_of_two_laps_in_gusts() {
    let _turn = among_others();
    let result = replay(&fly(&[]), 0);
    let words = &result["replayed"]["words"];
    assert!(words["compared"].as_u64().unwrap() > 6 * 50 * 200, "{words}");
    assert_eq!((&words["different"], &words["absent_cycles"]), (&0.into(), &0.into()), "{words}");
    // Not the words alone: every bit of what the functions hand each other.
    assert_eq!(result["comparison"]["equal"], true, "{}", result["comparison"]["first"]);
    assert_eq!(result["comparison"]["ports"].as_array().unwrap().len(), 9);
}

#[test]
fn function_that_lives_on_its_sensors_alone_costs_no_word_when_it_is_killed() {
    let _turn = among_others();
    // The loop is fed what came in after the kill too, so a lost sensor set is lost for both.
    let words = &replay(&fly(&["--kill", "hil_interface@100", "--kill", "gps@120"]), 0)["replayed"]["words"];
    assert_eq!((&words["different"], &words["absent_cycles"]), (&0.into(), &0.into()), "{words}");
}

#[test]
fn killed_servo_goes_on_with_the_very_words_after_its_first_cycle() {
    let _turn = among_others();
    let words = &replay(&fly(&["--kill", "servo@100"]), 1)["replayed"]["words"];
    assert_eq!(words["absent_cycles"], 1, "{words}");
    let (first_s, last_s) = (first_s(words), words["last_ns"].as_f64().unwrap() / 1e9);
    assert!(first_s > 100.0 && last_s < 100.1, "{words}");
}

#[test]
fn killed_controller_gives_the_words_of_the_loop_until_then_and_nearly_those_afterwards() {
    let _turn = among_others();
    let words = &replay(&fly(&["--kill", "controller@100"]), 1)["replayed"]["words"];
    assert!((100.0..100.1).contains(&first_s(words)), "none before: {words}");
    // A warm start goes on from what was retained, which is less than the whole function: pulses of 1000 to 2000.
    let greatest = words["greatest"].as_object().unwrap().values().filter_map(Value::as_u64).max();
    assert!(greatest.is_some_and(|greatest| greatest < 100), "{words}");
}
