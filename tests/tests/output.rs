//! What a flight writes: one JSON document, a page that needs nothing else, a log of every port.

#[path = "../../hil/report/tests/trace_check/mod.rs"]
mod trace_check;

use std::collections::BTreeSet;

use bateleur_recording::{Ending, read};
use bateleur_tests::{Ended, among_others, bateleur, flight_schedule};

fn fly(format: &str) -> Ended {
    let schedule = flight_schedule();
    let run = ["fly", "--fast", "--format", format, "--schedule", schedule.to_str().unwrap()];
    let kill = ["--kill", "imu@90"];
    bateleur(&[&run[..], &kill[..]].concat()).end().expect_code(0)
}

/// Keys of a summary that are numbers.
const NUMBERS: [&str; 15] = [
    "laps",
    "module_time_s",
    "wall_time_s",
    "seed",
    "cross_track_rms_m",
    "cross_track_true_rms_m",
    "straight_cross_track_rms_m",
    "straight_cross_track_true_rms_m",
    "altitude_rms_m",
    "altitude_true_rms_m",
    "airspeed_rms_mps",
    "windows",
    "late_windows",
    "window_overruns",
    "restarts",
];

#[test]
fn summary_is_one_json_document_with_every_key() {
    let _turn = among_others();
    let ended = fly("json");
    let summary = ended.summary();
    for key in NUMBERS {
        assert!(summary[key].is_number(), "{key}: {}", summary[key]);
    }
    assert_eq!(summary["completed"], true);
    assert_eq!(summary["clock"], "virtual");
    assert_eq!(summary["seed"], 1);
    assert!(summary["waypoints"].is_array() && summary["faults"].is_array());
    assert!(
        summary.as_object().unwrap().contains_key("window_start_lateness_us"),
        "null in virtual time, but there"
    );
    for part in ["p50", "p99", "p999", "max"] {
        assert!(summary["chain_execution_us"][part].is_number(), "{part}: {}", summary["chain_execution_us"]);
    }
    let guarantees = summary["guarantees"].as_array().unwrap();
    assert!(
        guarantees.len() > 5
            && guarantees.iter().all(|one| one["promise"].is_string() && one["held"].is_boolean())
    );
    assert!(summary["digest"].as_str().unwrap().bytes().all(|byte| byte.is_ascii_hexdigit()));
    let written = std::fs::read_to_string(ended.folder().join("summary.json")).unwrap();
    let written: serde_json::Value = serde_json::from_str(&written).unwrap();
    assert_eq!(written, summary, "summary.json is what was printed");
    assert_page_is_whole(&ended);
    assert_log_is_whole(&ended);
    assert_windows_add_up(&ended);
    assert_exports_are_whole(&ended);
}

/// What other people's tools are given holds all windows, faults and messages, in forms that they can read.
fn assert_exports_are_whole(ended: &Ended) {
    let folder = ended.folder();
    let (trace, viewer) = (folder.join("trace.json"), folder.join("viewer.mcap"));
    let (folder, trace_path, viewer_path) =
        (folder.to_str().unwrap(), trace.to_str().unwrap(), viewer.to_str().unwrap());
    bateleur(&["export", folder, "--chrome", trace_path, "--mcap", viewer_path]).end().expect_code(0);
    let phases = trace_check::assert_trace(&std::fs::read_to_string(&trace).unwrap());
    assert!(phases["X"] >= ended.windows().len(), "{phases:?}");
    let bytes = std::fs::read(&viewer).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    let counted = summary.stats.expect("statistics").message_count;
    let read = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap());
    assert_eq!(counted, read.count() as u64);
    let back = ended.faults().iter().filter(|fault| fault.recovered_ns.is_some()).count() as u64;
    assert_eq!(phases["i"] as u64, counted + back + 1, "each that is back, and the schedule");
}

/// The page shows the flight without anything from elsewhere.
fn assert_page_is_whole(ended: &Ended) {
    let page = std::fs::read_to_string(ended.folder().join("report.html")).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") || page.starts_with("<!doctype html>"));
    assert!(page.trim_end().ends_with("</html>"));
    assert!(page.contains("<svg"));
    // Names of namespaces are never fetched, and `#` leads to a part of the page.
    let elsewhere = page.replace("http://www.w3.org/", "").replace("url(#", "");
    assert!(!elsewhere.contains("http"), "the page refers to something on the net");
    for loading in ["src=\"", "@import", "url(", "<link"] {
        assert!(!elsewhere.contains(loading), "the page loads something: {loading}");
    }
}

/// Every channel of the schedule that carried something is in the log, by its source.
fn assert_log_is_whole(ended: &Ended) {
    let log = read(ended.folder().join("ports.mcap"), |_| false).unwrap();
    assert_eq!(log.ending, Ending::Complete);
    let schedule = std::fs::read_to_string(flight_schedule()).unwrap();
    let sources = schedule.lines().filter_map(|line| line.strip_prefix("source")?.split('"').nth(1));
    let expected: BTreeSet<String> = sources.map(|port| format!("/{}", port.replace('.', "/"))).collect();
    let found: BTreeSet<String> = log.counts.keys().cloned().collect();
    assert!(found.is_subset(&expected), "{:?}", found.difference(&expected));
    // These carry nothing in a flight on which nothing was asked of them.
    let silent = [
        "/command/to_gps",
        "/command/to_onboard_computer",
        "/command/to_rate_generator",
        "/rate_generator/telemetry",
    ];
    let missing: Vec<_> =
        expected.difference(&found).filter(|topic| !silent.contains(&topic.as_str())).collect();
    assert!(missing.is_empty(), "channels without a message in the log: {missing:?}");
    let minor_frames =
        ended.windows().iter().filter(|window| window.partition == "rate_generator").count() as u64;
    let beats = log.counts["/rate_generator/rate"];
    assert!(beats.abs_diff(minor_frames) <= 1, "{beats} beats in {minor_frames} windows");
    let samples = read(ended.folder().join("ports.mcap"), |message| message == "State").unwrap();
    let states = &samples.tracks["/estimator/state"].samples;
    assert!(states.windows(2).all(|pair| pair[0].0 < pair[1].0), "in the order of time");
}

fn assert_windows_add_up(ended: &Ended) {
    let windows = ended.windows();
    let granted = windows.iter().filter(|window| window.granted_ns.is_some()).count() as u64;
    let summary = ended.summary();
    assert_eq!(summary["windows"].as_u64(), Some(granted));
    assert_eq!(summary["window_overruns"], 0);
    assert_eq!(summary["late_windows"], 0);
    assert!(
        windows.iter().all(|window| window
            .closed_ns
            .is_none_or(|closed| closed <= window.planned_end_ns + 1_000_000_000))
    );
}

#[test]
fn summary_as_a_table_names_the_flight_its_faults_and_its_report() {
    let _turn = among_others();
    let ended = fly("text");
    for word in ["completed", "WP0", "cross-track", "altitude", "airspeed", "digest", "report.html", "imu"] {
        assert!(ended.stdout.contains(word), "{word:?} is missing in:\n{}", ended.stdout);
    }
}
