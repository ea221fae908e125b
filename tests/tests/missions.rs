//! Missions of one's own: flown, judged by their own way-points, kept with the flight; and what is left of those that fail.

use std::path::Path;
use std::process::{Command, Stdio};

use bateleur_tests::{
    Ended, ONE_PROCESS, among_others, bateleur, edited, flight_schedule, program, repository,
};
use serde_json::{Value, json};

/// A triangle, once, at two heights; the autopilot takes off.
const TRIANGLE: &str = r#"
laps = 1
take_off = "autopilot"

[[waypoint]]
north_m = 600
east_m = 0
altitude_m = 120

[[waypoint]]
north_m = 500
east_m = 500
altitude_m = 140

[[waypoint]]
north_m = 0
east_m = 300
altitude_m = 120
"#;

fn fly(schedule: &Path, choices: &[&str]) -> Ended {
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(choices);
    bateleur(&arguments).end()
}

fn written(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn mission_of_another_shape_is_judged_by_its_own_way_points_and_replays_when_its_files_have_changed() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let mission = written(folder.path(), "triangle.toml", TRIANGLE);
    let schedule = folder.path().join("schedule.toml");
    std::fs::copy(flight_schedule(), &schedule).unwrap();
    let flown = fly(&schedule, &["--seed", "3", "--mission", &mission]).expect_code(0);
    let summary = flown.summary();
    assert_eq!((&summary["completed"], &summary["laps"]), (&json!(true), &json!(1)), "{summary:#}");
    assert_eq!(summary["waypoints"], json!(["WP0", "WP1", "WP2", "WP0"]));
    assert_eq!(summary["unverified_waypoints"], json!([]));
    let straight = summary["straight_cross_track_rms_m"].as_f64().unwrap();
    assert!(straight < 2.0, "{straight} m off a straight leg");
    assert_eq!(std::fs::read_to_string(flown.folder().join("inputs/mission.toml")).unwrap(), TRIANGLE);

    // Weeks later.
    std::fs::remove_file(&mission).unwrap();
    std::fs::write(&schedule, edited(&[(r#"path = "fillet""#, r#"path = "fly_through""#)])).unwrap();
    let flight = flown.folder();
    let replayed = bateleur(&["replay", flight.to_str().unwrap(), "--format", "json"]).end();
    let replayed = replayed.expect_code(0).expect_words(&["schedule.toml is not as it was flown"]);
    assert_eq!(replayed.summary()["replayed"]["words"]["different"], 0);
}

/// A square, once, with the autopilot's take-off.
fn square(side_m: f64, altitude_m: f64, airspeed_mps: f64) -> String {
    let corners = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)].map(|(north, east)| {
        let (north_m, east_m) = (north * side_m, east * side_m);
        format!(
            "[[waypoint]]\nnorth_m = {north_m}\neast_m = {east_m}\naltitude_m = {altitude_m}\nairspeed_mps = {airspeed_mps}\n"
        )
    });
    format!("laps = 1\ntake_off = \"autopilot\"\ntime_limit_s = 1500\n{}", corners.concat())
}

/// Aircraft far from the delivered ones: one that rolls at 16°/s and yaws to the wrong side (it swung with ±46° of bank), one whose
/// least take-off airspeed lies above the usual cruise (it never left the ground), airspeeds outside of 10 to 60 m/s (it fell), one
/// without a rudder, and an airspeed at which little bank can be held (7.8 m off the legs behind its corners).
#[test]
fn aircraft_of_another_size_fly_their_missions_with_nothing_but_their_file() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = folder.path().join("schedule.toml");
    std::fs::copy(flight_schedule(), &schedule).unwrap();
    for (airframe, side_m, airspeed_mps, altitude_m) in [
        ("tests/airframes/motor_glider", 1500.0, 30.0, 300.0),
        ("tests/airframes/cessna182", 3000.0, 50.0, 300.0),
        ("tests/airframes/cessna182", 3000.0, 65.0, 300.0),
        ("tests/airframes/small", 300.0, 9.5, 100.0),
        ("tests/airframes/flying_wing", 500.0, 18.0, 100.0),
        ("airframes/aerosonde", 500.0, 15.0, 160.0),
    ] {
        let path = repository().join(format!("{airframe}.toml"));
        let mission = written(folder.path(), "square.toml", &square(side_m, altitude_m, airspeed_mps));
        let choices = ["--seed", "11", "--airframe", path.to_str().unwrap(), "--mission", &mission];
        let summary = fly(&schedule, &[&ONE_PROCESS[..], &choices].concat()).expect_code(0).summary();
        let figure = |name: &str| summary[name].as_f64().unwrap();
        let figures = ["straight_cross_track_rms_m", "altitude_rms_m", "airspeed_rms_mps"].map(figure);
        println!("{airframe} at {airspeed_mps} m/s: {figures:.2?}");
        let [straight_m, height_m, airspeed_off_mps] = figures;
        assert!(straight_m < 2.0 && height_m < 2.0, "{airframe} at {airspeed_mps} m/s: {figures:?}");
        assert!(airspeed_off_mps < 2.0, "{airframe} at {airspeed_mps} m/s: {figures:?}");
    }
}

/// Twice round two places, a circle of two turns and one for a time, down in a circle, and a landing.
const WHOLE: &str = r#"
take_off = "autopilot"
landing = true
time_limit_s = 1500

[[waypoint]]
north_m = 500
east_m = 0
altitude_m = 120

[[waypoint]]
north_m = 500
east_m = 600
altitude_m = 150
airspeed_mps = 24
circle = { turns = 2, radius_m = -120 }
jump = { to = 0, times = 1 }

[[waypoint]]
north_m = -300
east_m = 600
altitude_m = 150
circle = { seconds = 45 }

[[waypoint]]
north_m = -300
east_m = 0
altitude_m = 70
circle = { until = "altitude" }
"#;

/// Judged by the truth: the way-points in their order, and the touch-down. With functions that die on circles and at jumps.
#[test]
fn missions_with_circles_jumps_and_a_landing_are_flown_to_their_end() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let mission = written(folder.path(), "whole.toml", WHOLE);
    let order = json!(["WP0", "WP1", "WP0", "WP1", "WP3", "WP4"]);
    let flights: [&[&str]; 4] = [
        &["--seed", "41"],
        &["--seed", "42", "--wind", "6", "--wind-from", "200", "--turbulence", "light"],
        &[
            "--seed",
            "43",
            "--wind",
            "4",
            "--wind-from",
            "80",
            "--airframe",
            "rascal110",
            "--take-off",
            "pilot",
        ],
        &[
            "--seed",
            "44",
            "--wind",
            "5",
            "--turbulence",
            "light",
            "--kill",
            "controller@90",
            "--kill",
            "command@91",
            "--kill",
            "controller@150",
            "--kill",
            "estimator@200",
            "--inject",
            "executive:sigkill@225",
            "--kill",
            "controller@250",
            "--kill",
            "controller@300",
        ],
    ];
    for choices in flights {
        let engine = if choices.contains(&"--kill") { &[] } else { &ONE_PROCESS[..] };
        let flown = fly(&flight_schedule(), &[engine, &["--mission", &mission], choices].concat());
        let flown = flown.expect_code(0);
        let summary = flown.summary();
        assert_eq!((&summary["completed"], &summary["waypoints"]), (&json!(true), &order), "{choices:?}");
        assert_eq!(summary["unverified_waypoints"], json!([]), "{choices:?}");
        assert!(summary["cross_track_rms_m"].is_null(), "no circuit, no figures of one");
        let touchdown = &summary["conditions"]["touchdown"];
        let sink_mps = touchdown["sink_mps"].as_f64().unwrap();
        assert!(sink_mps < 3.0 && touchdown["standing_s"].is_f64(), "{choices:?}: {touchdown}");
    }
}

#[test]
fn fence_that_is_left_is_told_and_is_the_reason_why_the_mission_failed() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let mission = written(folder.path(), "short.toml", &format!("time_limit_s = 100\n{TRIANGLE}"));
    let fenced = ["--set", "controller.fence_radius_m=450", "--mission", &mission];
    let ended = fly(&flight_schedule(), &fenced).expect_code(1);
    let words = "the aircraft has left its fence and acts on that";
    let ended = ended.expect_words(&[words]);
    let failure = ended.summary()["failure"].as_str().unwrap().to_owned();
    assert!(failure.contains("time limit of 100 s") && failure.contains("back to the runway"), "{failure}");
}

#[test]
fn flight_that_can_not_begin_leaves_no_folder_and_the_same_command_flies_when_its_mistake_is_mended() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("flight");
    let mission = written(folder.path(), "short.toml", &format!("time_limit_s = 5\n{TRIANGLE}"));
    let output_text = output.to_str().unwrap();
    let attempt = |airframe: &str| {
        let choices = ["--output", output_text, "--mission", &mission, "--airframe", airframe];
        fly(&flight_schedule(), &choices)
    };
    attempt("cessna").expect_code(2).expect_words(&["cessna"]);
    assert!(!output.exists(), "a folder of a flight that never was");
    attempt("aerosonde").expect_code(1).expect_words(&["time limit of 5 s"]);
    assert!(output.join("summary.json").exists());
}

#[test]
fn flight_goes_on_when_nobody_reads_its_progress_any_more() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let mission = written(folder.path(), "short.toml", &format!("time_limit_s = 5\n{TRIANGLE}"));
    let output = folder.path().join("flight");
    let mut flight = Command::new(program("bateleur"))
        .args(["fly", "--fast", "--schedule", flight_schedule().to_str().unwrap(), "--mission", &mission])
        .args(["--output", output.to_str().unwrap()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop((flight.stdout.take(), flight.stderr.take()));
    assert_eq!(flight.wait().unwrap().code(), Some(1), "the time limit, and no panic");
    let summary: Value =
        serde_json::from_slice(&std::fs::read(output.join("summary.json")).unwrap()).unwrap();
    assert!(summary["failure"].as_str().unwrap().contains("time limit of 5 s"), "{}", summary["failure"]);
}

#[test]
fn mistakes_in_a_mission_file_are_told_with_their_place_before_anything_is_started() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        (
            TRIANGLE.replace("north_m = 600", "nort_m = 600"),
            "line 6, column 1: there is no key `nort_m`: did you mean `north_m`?",
        ),
        (TRIANGLE.replace("east_m = 300", "east_m = \"300\""), "expected a number"),
        (TRIANGLE.replace("autopilot", "catapult"), "there is no value `catapult`"),
        (
            TRIANGLE.to_owned() + &"[[waypoint]]\nnorth_m = 1\neast_m = 2\naltitude_m = 100\n".repeat(30),
            "33 way-points; it must have 1 to 32",
        ),
    ];
    for (text, words) in cases {
        let mission = written(folder.path(), "mission.toml", &text);
        fly(&flight_schedule(), &["--mission", &mission]).expect_code(2).expect_words(&[words]);
    }
}

/// Said at once, and not when the time for the climb is over.
#[test]
fn take_off_that_the_controller_gives_up_ends_the_flight_and_is_told_as_that() {
    let _turn = among_others();
    let schedule = flight_schedule();
    for fault in ["rudder_stuck=100%@0", "pitot_blocked@0"] {
        let flown = fly(&schedule, &["--take-off", "autopilot", "--fault", fault]).expect_code(1);
        let summary = flown.summary();
        let failure = summary["failure"].as_str().unwrap();
        assert!(failure.starts_with("the Controller has given the take-off up"), "{fault}: {failure}");
        let lasted_s = summary["module_time_s"].as_f64().unwrap();
        assert!(lasted_s < 20.0, "{fault}: {lasted_s} s");
    }
    let flown = fly(&schedule, &["--take-off", "autopilot"]).expect_code(0);
    assert_eq!(flown.summary()["completed"], json!(true));
}
