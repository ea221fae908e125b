//! The schedule is data: what is edited in `schedule.toml` is what happens, with the same programs.

use bateleur_tests::{Ended, among_others, bateleur, edited};

fn fly(schedule: &str) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edited.toml");
    std::fs::write(&path, schedule).unwrap();
    bateleur(&["fly", "--fast", "--format", "json", "--schedule", path.to_str().unwrap()]).end()
}

/// Planned starts of a partition's windows, ns.
fn starts(ended: &Ended, partition: &str) -> Vec<u64> {
    let windows = ended.windows().into_iter().filter(|window| window.partition == partition);
    windows.map(|window| window.planned_start_ns).collect()
}

#[test]
fn moved_window_starts_where_the_file_says_and_the_flight_completes() {
    let _turn = among_others();
    let schedule = edited(&[(
        "partition = \"onboard_computer\", offset = \"12ms\"",
        "partition = \"onboard_computer\", offset = \"17.25ms\"",
    )]);
    let ended = fly(&schedule).expect_code(0);
    let starts = starts(&ended, "onboard_computer");
    assert!(starts.len() > 5000);
    assert!(starts.iter().all(|start| start % 20_000_000 == 17_250_000));
}

#[test]
fn longer_major_frame_changes_the_frame_count_and_the_flight_completes() {
    let _turn = among_others();
    let schedule = edited(&[("major_frame = \"100ms\"", "major_frame = \"400ms\"")]);
    let ended = fly(&schedule).expect_code(0);
    let text = std::fs::read_to_string(ended.folder().join("windows.csv")).unwrap();
    let last = text.lines().last().unwrap();
    let frame: u64 = last.split(',').next().unwrap().parse().unwrap();
    let seconds = *starts(&ended, "imu").last().unwrap() as f64 / 1e9;
    assert!((frame as f64 - seconds / 0.4).abs() < 2.0, "frame {frame} after {seconds} s");
    let minors: std::collections::BTreeSet<&str> =
        text.lines().skip(1).filter_map(|line| line.split(',').nth(1)).collect();
    assert_eq!(minors.len(), 20, "{minors:?}");
}

#[test]
fn twice_the_minor_frame_halves_the_windows_of_a_second_and_the_flight_completes() {
    let _turn = among_others();
    let schedule = edited(&[
        ("major_frame = \"100ms\"", "major_frame = \"200ms\""),
        ("minor_frame = \"20ms\"", "minor_frame = \"40ms\""),
        ("sync_period = \"20ms\"", "sync_period = \"40ms\""),
        ("timeout_3 = \"500ms\"", "timeout_3 = \"480ms\""),
        ("\"40ms\" }", "\"80ms\" }"),
        ("max_age = \"25ms\"", "max_age = \"45ms\""),
    ]);
    let ended = fly(&schedule).expect_code(0);
    let starts = starts(&ended, "controller");
    let rate = starts.len() as f64 / (*starts.last().unwrap() as f64 / 1e9);
    assert!((24.0..26.0).contains(&rate), "{rate} windows a second");
    assert_eq!(ended.summary()["completed"], true);
}

#[test]
fn attribute_in_the_file_changes_what_a_partition_does() {
    let _turn = among_others();
    let schedule = edited(&[("laps = 2", "laps = 1")]);
    let summary = fly(&schedule).expect_code(0).summary();
    assert_eq!(summary["waypoints"], serde_json::json!(["WP0", "WP1", "WP2", "WP3", "WP0"]));
    assert_eq!(summary["laps"], 1);
}
