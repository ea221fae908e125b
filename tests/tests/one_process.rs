//! Flights in one process beside the same flights as partitions: every actuator word, and what a campaign makes of both.

use std::collections::BTreeMap;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use bateleur_tests::{
    among_others, await_some, bateleur, children_of, edited, flight_schedule, is_long, repository,
};
use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

/// Longer than a few flights take on a machine that is busy with other things.
const PATIENCE: Duration = Duration::from_secs(300);

/// A folder with a schedule of one lap.
fn place() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("lap.toml"), edited(&[("laps = 2", "laps = 1")])).unwrap();
    folder
}

/// Flies; the summary.
fn fly(place: &Path, engine: &str, name: &str, options: &[String]) -> Value {
    let (schedule, output) = (place.join("lap.toml"), place.join(name));
    let mut all = vec!["fly", "--fast", "--format", "json", "--engine", engine];
    all.extend(["--schedule", schedule.to_str().unwrap(), "--output", output.to_str().unwrap()]);
    all.extend(options.iter().map(String::as_str));
    let ended = bateleur(&all).end_within(PATIENCE);
    assert!(ended.stdout.starts_with('{'), "{engine} {options:?}: {}", ended.stderr);
    ended.summary()
}

/// A number from 0 to 1 that belongs to the seed and the name.
fn drawn(seed: u64, name: &str) -> f64 {
    let mut state = seed
        ^ name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
    for shift in [30, 27] {
        state = (state ^ (state >> shift)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    ((state ^ (state >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Wind, aircraft and something that breaks.
fn conditions(seed: u64) -> Vec<String> {
    let pick = |name: &str, list: &[&str]| list[(drawn(seed, name) * list.len() as f64) as usize].to_owned();
    let level = pick("turbulence", &["calm", "light", "moderate", "severe"]);
    let breaks = [
        "gps_lost@70..90",
        "pitot_blocked@60",
        "static_blocked@65",
        "magnetometer_lost@50",
        "frames_lost=20%",
        "gyroscope_shift=0.4@60",
        "gyroscope_stuck=z@70..75",
        "accelerometer_stuck=x@70..80",
        "gps_late=0.3",
        "frames_lost=99.9%@72..73",
    ];
    let mut all = vec![format!("--seed={seed}"), format!("--turbulence={level}")];
    all.push(format!("--wind={:.2}", drawn(seed, "wind") * 7.0));
    all.push(format!("--wind-from={:.0}", drawn(seed, "from") * 360.0));
    all.push("--vary=mass=10%,inertia=10%,derivatives=20%".into());
    all.push(format!("--airframe={}", pick("airframe", &["aerosonde", "rascal110"])));
    all.push(format!("--sensors={}", pick("sensors", &["calibrated", "data-sheet"])));
    all.push(format!("--fault={}", pick("breaks", &breaks)));
    all.extend((drawn(seed, "take-off") < 0.3).then(|| "--take-off=autopilot".to_owned()));
    all.extend((drawn(seed, "land") < 0.3).then(|| "--land".to_owned()));
    all.extend((drawn(seed, "protocol") < 0.3).then(|| "--protocol=mavlink".to_owned()));
    all
}

#[test]
fn every_word_is_that_of_the_partitions_over_seeds_winds_aircraft_and_faults() {
    let _turn = among_others();
    let place = place();
    for seed in 7001..if is_long() { 7017 } else { 7006 } {
        let options = conditions(seed);
        let here = fly(place.path(), "one-process", &format!("{seed}-here"), &options);
        let there = fly(place.path(), "partitions", &format!("{seed}-there"), &options);
        for what in ["digest", "completed", "failure", "module_time_s"] {
            assert_eq!(here[what], there[what], "{what} of {options:?}");
        }
        // A recorder in a process of its own may be ended by a busy machine, and says so.
        if there["notes"].as_array().is_none_or(Vec::is_empty) {
            assert_eq!((&here["messages"], &here["estimator"]), (&there["messages"], &there["estimator"]));
        }
        assert!(here["digest"].is_string(), "{here}");
    }
}

#[test]
fn what_one_process_has_not_is_refused_with_what_to_do() {
    let schedule = flight_schedule();
    let fly = ["fly", "--engine", "one-process", "--schedule", schedule.to_str().unwrap()];
    for wrong in [
        &["--kill=imu@60"][..],
        &["--inject=gps:hang@60"],
        &["--require=strict"],
        &["--protocol=mavlink-tcp"],
    ] {
        bateleur(&[&fly[..], &["--fast"], wrong].concat())
            .end()
            .expect_code(2)
            .expect_words(&["one process can not show", "--engine partitions"]);
    }
    bateleur(&fly).end().expect_code(2).expect_words(&["wall clock", "--fast"]);
}

#[test]
fn flight_that_comes_to_what_one_process_has_not_ends_and_says_so() {
    let _turn = among_others();
    let place = tempfile::tempdir().unwrap();
    let harsh = edited(&[
        ("laps = 2", "laps = 1"),
        ("application_error = \"ignore\"", "application_error = \"warm_restart\""),
    ]);
    std::fs::write(place.path().join("lap.toml"), harsh).unwrap();
    let options = ["--fault=gps_lost@60..70".to_owned()];
    let here = fly(place.path(), "one-process", "here", &options);
    let failure = here["failure"].as_str().unwrap();
    assert!(
        failure.contains("one process can not show what follows: estimator: application_error -> warm"),
        "{failure}"
    );
}

fn campaign(place: &TempDir, output: &str, options: &[&str]) -> bateleur_tests::Started {
    let (schedule, output) = (place.path().join("lap.toml"), place.path().join(output));
    let mut all = vec!["campaign", "--engine", "one-process", "--format", "json", "--jobs", "2"];
    all.extend(["--schedule", schedule.to_str().unwrap(), "--output", output.to_str().unwrap()]);
    all.extend(options);
    bateleur(&all)
}

/// The lines of a campaign by number.
fn lines(folder: &Path) -> BTreeMap<u64, Value> {
    let text = std::fs::read_to_string(folder.join("flights.jsonl")).unwrap_or_default();
    let flights = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    flights.map(|flight| (flight["number"].as_u64().unwrap(), flight)).collect()
}

fn same(folder: &Path) -> Vec<[Value; 5]> {
    let of = |flight: &Value| {
        ["digest", "completed", "failure", "engine", "compared"].map(|what| flight[what].clone())
    };
    lines(folder).values().map(of).collect()
}

/// One of its flights in one process, that of seed 7110, is flown again as partitions, and one has a kill.
const SIX: [&str; 6] = ["--flights", "6", "--seed", "7106", "--kills", "0..1"];

#[test]
fn shards_together_are_the_campaign_in_one_piece_and_a_killed_one_goes_on() {
    let _turn = among_others();
    let place = place();
    let first = campaign(&place, "whole", &SIX);
    let folder = place.path().join("whole");
    let two = || (lines(&folder).len() >= 2).then_some(());
    assert!(await_some(PATIENCE, two).is_some(), "no flight: {}", first.said());
    let children = children_of(first.pid());
    first.signal(Signal::KILL);
    first.end_within(PATIENCE);
    // Its flights are still ending, and write into their folders.
    let summary = campaign(&place, "whole", &SIX).end_within(PATIENCE).summary();
    let gone = || children.iter().all(|child| !child.is_alive()).then_some(());
    assert!(await_some(Duration::from_secs(30), gone).is_some(), "{children:?}");
    assert_eq!(summary["flown"], 6, "{summary}");
    for shard in ["0/2", "1/2"] {
        let mut options = SIX.to_vec();
        options.extend(["--shard", shard]);
        campaign(&place, "parts", &options).end_within(PATIENCE);
    }
    let parts = ["shard-0-of-2", "shard-1-of-2"].map(|name| place.path().join("parts").join(name));
    let merged = place.path().join("merged");
    let mut merge = vec!["campaign", "merge", "--format", "json", "--output", merged.to_str().unwrap()];
    merge.extend(parts.iter().map(|part| part.to_str().unwrap()));
    let joined = bateleur(&merge).end().summary();
    assert_eq!(same(&merged), same(&folder));
    assert_eq!((&joined["engines"], &joined["compared"]), (&summary["engines"], &summary["compared"]));
    assert!(summary["compared"].as_u64().unwrap() >= 1, "{summary}");
    for flight in lines(&folder).values() {
        let (kills, engine) = (flight["conditions"]["kills"].as_f64().unwrap(), &flight["engine"]);
        assert_eq!(*engine, if kills > 0.0 { "partitions" } else { "one-process" }, "{flight}");
        let here = flight["command"].as_str().unwrap().contains("--engine=one-process");
        assert_eq!(here, kills == 0.0, "{flight}");
    }
}

/// Programs as they are, but for the simulator, which flies in another wind than it is asked for: partitions alone start it.
fn programs_with_another_wind(folder: &Path) -> PathBuf {
    let built = repository().join("target/release");
    for entry in std::fs::read_dir(&built).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_file() && entry.file_name() != "bateleur" {
            symlink(entry.path(), folder.join(entry.file_name())).unwrap();
        }
    }
    let (simulator, own) = (folder.join("simulator"), folder.join("bateleur"));
    std::fs::remove_file(&simulator).unwrap();
    let script = format!(
        "#!/bin/bash\nfor word; do test \"$before\" = --wind && word=$word.125; words+=(\"$word\"); before=$word; done\n\
         exec {} \"${{words[@]}}\"\n",
        built.join("simulator").display()
    );
    std::fs::write(&simulator, script).unwrap();
    std::fs::set_permissions(&simulator, std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::copy(built.join("bateleur"), &own).unwrap();
    own
}

#[test]
fn campaign_fails_where_partitions_give_another_word_and_says_which_seed_and_which_word() {
    let _turn = among_others();
    let (place, programs) = (place(), tempfile::tempdir().unwrap());
    let program = programs_with_another_wind(programs.path());
    let schedule = place.path().join("lap.toml");
    let ended = Command::new(program)
        .args(["campaign", "--engine", "one-process", "--flights", "1", "--kills", "0", "--wind", "3"])
        .args(["--seed", "7110", "--format", "json"])
        .arg("--schedule")
        .arg(&schedule)
        .arg("--output")
        .arg(place.path().join("out"))
        .output()
        .unwrap();
    assert_eq!(ended.status.code(), Some(1), "{}", String::from_utf8_lossy(&ended.stderr));
    let flight = &lines(&place.path().join("out"))[&0];
    let failure = flight["failure"].as_str().unwrap();
    assert!(
        failure.starts_with("seed 7110: one process and partitions are not the same flight: at "),
        "{failure}"
    );
    assert!(failure.contains(" the word of ") && failure.ends_with(" as partitions"), "{failure}");
}
