//! Flights in virtual time: every seed, with and without wind; and that the same seed is the same flight. The first seed of each group flies as
//! partitions; the others in one process, which is over sooner and the same to the bit.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bateleur_tests::{Ended, ONE_PROCESS, TWO_LAPS, among_others, bateleur, flight_schedule, repository};
use serde_json::Value;

/// Bounds of a flight's scores, root mean square against what the aircraft was asked to fly.
struct Bounds {
    altitude_m: f64,
    airspeed_mps: f64,
    straight_cross_track_m: f64,
}

const CALM: Bounds = Bounds { altitude_m: 1.5, airspeed_mps: 0.5, straight_cross_track_m: 2.0 };
const LIGHT_TURBULENCE: Bounds = Bounds { altitude_m: 1.5, airspeed_mps: 1.0, straight_cross_track_m: 2.0 };

fn fly(choices: &[&str]) -> Ended {
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(choices);
    bateleur(&arguments).end()
}

fn assert_flown(summary: &Value, bounds: &Bounds, which: &str) {
    assert_eq!(summary["completed"], true, "{which}: {}", summary["failure"]);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()), "{which}");
    assert_eq!(summary["laps"], 2, "{which}");
    assert_eq!(summary["conditions"]["crashed"], false, "{which}");
    assert_eq!(summary["conditions"]["air_as_asked"], true, "{which}: {}", summary["conditions"]);
    let scores = [
        ("altitude_rms_m", bounds.altitude_m),
        ("airspeed_rms_mps", bounds.airspeed_mps),
        ("straight_cross_track_rms_m", bounds.straight_cross_track_m),
    ];
    for (name, bound) in scores {
        let score = summary[name].as_f64().unwrap_or(f64::INFINITY);
        assert!(score <= bound, "{which}: {name} = {score}, which is more than {bound}");
    }
}

fn assert_seeds_fly(
    seeds: std::ops::RangeInclusive<u64>,
    choices: impl Fn(u64) -> Vec<String>,
    bounds: &Bounds,
) {
    let _turn = among_others();
    let first = *seeds.start();
    for number in seeds {
        let choices = choices(number);
        let seed = number.to_string();
        let mut arguments = vec!["--seed", &seed];
        arguments.extend(choices.iter().map(String::as_str));
        let summary = fly(&[&arguments[..], &ONE_PROCESS].concat()).expect_code(0).summary();
        if number == first {
            let partitions = fly(&arguments).expect_code(0).summary();
            assert_eq!(partitions["digest"], summary["digest"], "seed {seed}");
        }
        eprintln!(
            "seed {seed}: altitude {} m, airspeed {} m/s, straight track {} m",
            summary["altitude_rms_m"], summary["airspeed_rms_mps"], summary["straight_cross_track_rms_m"]
        );
        assert_flown(&summary, bounds, &format!("seed {seed} {choices:?}"));
    }
}

fn no_choices(_: u64) -> Vec<String> {
    Vec::new()
}

fn gusts(seed: u64) -> Vec<String> {
    let from = (seed * 36 % 360).to_string();
    ["--turbulence", "light", "--wind", "5", "--wind-from", &from].map(str::to_owned).to_vec()
}

#[test]
fn calm_air_seeds_1_to_5_fly_two_laps_in_order() {
    assert_seeds_fly(1..=5, no_choices, &CALM);
}

#[test]
fn calm_air_seeds_6_to_10_fly_two_laps_in_order() {
    assert_seeds_fly(6..=10, no_choices, &CALM);
}

#[test]
fn gusts_and_wind_seeds_1_to_5_fly_two_laps_in_order() {
    assert_seeds_fly(1..=5, gusts, &LIGHT_TURBULENCE);
}

#[test]
fn gusts_and_wind_seeds_6_to_10_fly_two_laps_in_order() {
    assert_seeds_fly(6..=10, gusts, &LIGHT_TURBULENCE);
}

/// Airframes by name and by file; no code knows the last one.
fn assert_airframe_flies(airframe: &str) {
    let with = |choices: Vec<String>| {
        let named = ["--airframe".to_owned(), airframe.to_owned()];
        choices.into_iter().chain(named).collect()
    };
    assert_seeds_fly(1..=1, |_| with(no_choices(1)), &CALM);
    assert_seeds_fly(2..=2, |seed| with(gusts(seed)), &LIGHT_TURBULENCE);
}

#[test]
fn second_airframe_flies_two_laps_in_calm_air_and_in_gusts() {
    assert_airframe_flies("rascal110");
}

#[test]
fn third_airframe_flies_two_laps_with_only_its_file_added() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../airframes/ultrastick25e.toml");
    assert_airframe_flies(file);
}

#[test]
fn flying_wing_and_an_aircraft_of_sixty_kilograms_fly_in_wind_and_land() {
    let _turn = among_others();
    for file in ["zagi", "vtail60"] {
        let file = repository().join(format!("airframes/{file}.toml"));
        for air in [["8", "--turbulence", "moderate"], ["5", "--turbulence", "light"]] {
            let choices = ["--land", "--seed", "1", "--airframe", file.to_str().unwrap()];
            let wind = ["--wind-from", "45", "--wind"];
            let ended = fly(&[&choices[..], &wind, &air, &ONE_PROCESS].concat()).expect_code(0);
            assert!(!ended.stderr.contains("no power"), "{}", ended.stderr);
        }
    }
}

fn digest(seed: &str) -> String {
    let gusty = ["--seed", seed, "--turbulence", "light", "--wind", "5", "--wind-from", "200"];
    let summary = fly(&gusty).expect_code(0).summary();
    summary["digest"].as_str().expect("a digest").to_owned()
}

#[test]
fn same_seed_is_the_same_flight_on_a_free_and_on_a_busy_machine_and_another_seed_is_another() {
    let _turn = among_others();
    let free = digest("7");
    assert!(free.len() >= 16, "{free}");
    assert_eq!(digest("7"), free, "the same seed again");
    let over = Arc::new(AtomicBool::new(false));
    let cores = std::thread::available_parallelism().map_or(2, usize::from);
    let spin = |over: Arc<AtomicBool>| move || while !over.load(Ordering::Relaxed) {};
    let busy: Vec<_> = (0..cores).map(|_| std::thread::spawn(spin(over.clone()))).collect();
    let loaded = digest("7");
    over.store(true, Ordering::Relaxed);
    busy.into_iter().for_each(|thread| thread.join().unwrap());
    assert_eq!(loaded, free, "the same seed while every processor is busy");
    assert_ne!(digest("8"), free, "another seed");
}
