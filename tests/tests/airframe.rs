//! `bateleur airframe`: what is wrong with a file, and what follows from it.

use bateleur_tests::{bateleur, flight_schedule, line_of, repository};
use serde_json::Value;

fn file(name: &str) -> String {
    repository().join("airframes").join(name).display().to_string()
}

#[test]
fn every_airframe_that_is_delivered_can_be_flown() {
    for entry in std::fs::read_dir(repository().join("airframes")).unwrap() {
        let path = entry.unwrap().path();
        let ended = bateleur(&["airframe", path.to_str().unwrap(), "--format", "json"]).end().expect_code(0);
        let facts: Value = serde_json::from_str(&ended.stdout).unwrap();
        assert_eq!(facts["modes"].as_array().map(Vec::len), Some(5), "{}", path.display());
        assert!(facts["gains"]["normal"]["k_q"].as_f64().unwrap() < 0.0, "{}", path.display());
    }
}

#[test]
fn report_for_people_has_all_four_parts() {
    let ended = bateleur(&["airframe", "aerosonde"]).end().expect_code(0);
    for part in
        ["level flight: stalls at 11.5 m/s", "modes at 22 m/s", "gains of the Controller", "limits at 22 m/s"]
    {
        assert!(ended.stdout.contains(part), "{part} is missing:\n{}", ended.stdout);
    }
}

#[test]
fn airspeed_beyond_the_aircraft_ends_with_code_1() {
    let ended = bateleur(&["airframe", "aerosonde", "--airspeed", "60"]).end().expect_code(1);
    assert!(ended.stdout.contains("needs the throttle"), "{}", ended.stdout);
}

#[test]
fn all_faults_of_a_file_are_told_with_place_and_mend() {
    let text = std::fs::read_to_string(file("aerosonde.toml")).unwrap();
    let text = text.replace("lift_alpha =", "lift_alfa =").replace("mass_kg = 11.0", "mass_kg = \"heavy\"");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, &text).unwrap();
    let places = [("lift_alfa", "did you mean `lift_alpha`?"), ("mass_kg", "write it as `mass_kg = 11.0`")];
    let ended = bateleur(&["airframe", path.to_str().unwrap()]).end().expect_code(2);
    for (key, mend) in places {
        let place = format!("mine.toml:{}:", line_of(&text, key));
        assert!(
            ended.stdout.contains(&place) && ended.stdout.contains(mend),
            "{place} {mend}\n{}",
            ended.stdout
        );
    }
    let schedule = flight_schedule();
    let fly =
        ["fly", "--fast", "--schedule", schedule.to_str().unwrap(), "--airframe", path.to_str().unwrap()];
    let flown = bateleur(&fly).end().expect_code(2);
    let place =
        format!("mine.toml:{}:1: `[aerodynamics]` has no key `lift_alfa`", line_of(&text, "lift_alfa"));
    assert!(flown.stderr.contains(&place), "{}", flown.stderr);
}
