//! A flight in which chance kills a partition every five seconds: it is hardly to be told from the one without.

use bateleur_tests::{TWO_LAPS, among_others, bateleur, flight_schedule, is_long};
use serde_json::Value;

/// How much worse the disturbed flight may be, as a factor of an RMS error.
const FACTOR: f64 = 1.2;

fn fly(seed: &str, kills: &[&str]) -> Value {
    let schedule = flight_schedule();
    let wind = ["--wind", "5", "--wind-from", "250", "--turbulence", "light", "--seed", seed];
    let flight = ["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    let ended = bateleur(&[&flight[..], &wind, kills].concat()).end().expect_code(0);
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
    summary
}

#[test]
fn partition_killed_at_random_every_five_seconds_is_not_seen_in_the_track() {
    let _turn = among_others();
    let choices = [("3", "1"), ("7", "2"), ("12", "3"), ("13", "4")];
    for (seed, kill_seed) in &choices[..if is_long() { choices.len() } else { 1 }] {
        let undisturbed = fly(seed, &[]);
        let disturbed = fly(seed, &["--kill-every", "5s", "--kill-seed", kill_seed]);
        let kills = disturbed["faults"].as_array().unwrap().len();
        assert!(kills >= 30, "only {kills} partitions were killed");
        for error in ["cross_track_rms_m", "altitude_rms_m"] {
            let of = |summary: &Value| summary[error].as_f64().expect(error);
            let (usual, now) = (of(&undisturbed), of(&disturbed));
            assert!(now <= FACTOR * usual, "{error} is {now} m with kills, {usual} m without");
        }
    }
}
