//! What `bateleur compare` prints, and how it ends.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use std::path::Path;

use bateleur_messages::{Message, Pressure, State, find};
use bateleur_recording::{PortLog, topic};
use support::{assert_golden, bateleur_in};
use zerocopy::IntoBytes;

/// A flight's folder with fifty frames, in which the yaw is `extra` larger from frame 30 on.
fn write(folder: &Path, extra: f64, frames: u64) {
    std::fs::create_dir_all(folder).unwrap();
    let mut log = PortLog::create(folder.join("ports.mcap")).unwrap();
    let state = log.add_channel(&topic("estimator", "state"), find(State::NAME).unwrap()).unwrap();
    let pressure = log.add_channel(&topic("imu", "pressure"), find(Pressure::NAME).unwrap()).unwrap();
    for n in 0..frames {
        let time_ns = n * 20_000_000;
        let yaw = n as f64 * 0.125 + if n < 30 { 0.0 } else { extra };
        let value = State { valid_ns: time_ns, euler_rad: [0.0, 0.25, yaw], ..State::default() };
        log.write(pressure, n, time_ns + 3_800_000, Pressure::default().as_bytes()).unwrap();
        log.write(state, n, time_ns + 4_400_000, value.as_bytes()).unwrap();
    }
    log.finish().unwrap();
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("old"), 0.0, 50);
    write(&folder.path().join("same"), 0.0, 50);
    write(&folder.path().join("new"), 0.5, 50);
    write(&folder.path().join("short"), 0.0, 20);
    let whole = std::fs::read(folder.path().join("old/ports.mcap")).unwrap();
    std::fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    folder
}

#[test]
fn equal_different_and_shorter_flights_are_told_apart() {
    let folder = folder();
    let mut all = String::new();
    for (others, code) in [
        (&["old", "same"][..], 0),
        (&["old", "new"], 1),
        (&["old", "new", "--tolerance", "estimator.state.euler_rad=0.5"], 0),
        (&["old", "short/ports.mcap"], 1),
        (&["old", "cut.mcap"], 1),
        (&["old", "new", "--only", "imu", "--only", "estimater"], 2),
    ] {
        let ended = bateleur_in(folder.path(), &[&["compare"], others].concat());
        assert_eq!((ended.code, ended.stderr.as_str()), (code, ""), "{others:?}: {}", ended.stdout);
        all += &format!("$ bateleur compare {}\n{}\n", others.join(" "), ended.stdout);
    }
    assert_golden("compare.txt", &all);
}

#[test]
fn comparison_for_a_program_has_the_same_facts() {
    let folder = folder();
    let ended = bateleur_in(folder.path(), &["compare", "old", "new", "--format", "json"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (1, ""));
    let facts: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(facts["equal"], false);
    assert_eq!(facts["first"]["port"], "estimator.state");
    assert_eq!(facts["first"]["time_ns"], 604_400_000_u64);
    assert_eq!(facts["first"]["fields"][0]["field"], "euler_rad[2]");
    assert_eq!(facts["first"]["fields"][0]["b"], 4.25);
}

#[test]
fn log_that_was_changed_after_it_was_written_is_said_to_be_damaged() {
    let folder = folder();
    let path = folder.path().join("same/ports.mcap");
    let mut bytes = std::fs::read(&path).unwrap();
    // The last of the first message's four header bytes, which are followed by the value.
    let header = bytes.windows(4).position(|window| window == [0, 1, 0, 0]).unwrap();
    bytes[header + 8] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let ended = bateleur_in(folder.path(), &["compare", "old", "same"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (1, ""));
    let ends: Vec<_> =
        ended.stdout.lines().take(2).map(|end| end.contains("damaged: the checksum of 1")).collect();
    assert_eq!(ends, [false, true], "{}", ended.stdout);
}

#[test]
fn damaged_log_in_which_nothing_differs_ends_neither_as_equal_nor_as_different() {
    let folder = folder();
    let path = folder.path().join("same/ports.mcap");
    let mut bytes = std::fs::read(&path).unwrap();
    let header = bytes.windows(4).position(|window| window == [0, 1, 0, 0]).unwrap();
    bytes[header - 1] ^= 1; // the publish time, which is not compared
    std::fs::write(&path, bytes).unwrap();
    let ended = bateleur_in(folder.path(), &["compare", "old", "same"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (2, ""));
    for words in [
        "damaged: the checksum of 1",
        "not compared: what was in B before it was damaged",
        "what could be compared is equal",
    ] {
        assert!(ended.stdout.contains(words), "{words}: {}", ended.stdout);
    }
}

#[test]
fn page_of_two_flights_is_written_but_never_over_something_else() {
    let folder = folder();
    let ended = bateleur_in(folder.path(), &["compare", "old", "new", "--html", "both.html"]);
    assert_eq!((ended.code, ended.stderr.lines().last()), (1, Some("page: both.html")), "{}", ended.stdout);
    let page = std::fs::read_to_string(folder.path().join("both.html")).unwrap();
    assert!(page.contains("estimator.state at 0.604400 s; 1 of 2 ports differ."), "{page:.2000}");
    let again = bateleur_in(folder.path(), &["compare", "old", "same", "--html", "both.html"]);
    assert_eq!(again.code, 0, "an earlier page is replaced: {}", again.stderr);
    let refused = bateleur_in(folder.path(), &["compare", "old", "new", "--html", "old/ports.mcap"]);
    assert_eq!((refused.code, refused.stdout.as_str()), (2, ""));
    assert!(refused.stderr.contains("name another file"), "{}", refused.stderr);
}

#[test]
fn files_that_are_no_logs_are_refused() {
    let folder = folder();
    std::fs::write(folder.path().join("notes.txt"), "nothing of the kind, and long enough to be read")
        .unwrap();
    for (other, words) in [("nowhere", "No such file"), ("notes.txt", "notes.txt")] {
        let ended = bateleur_in(folder.path(), &["compare", "old", other]);
        assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
        assert!(
            ended.stderr.contains("can not be compared") && ended.stderr.contains(words),
            "{}",
            ended.stderr
        );
    }
    let ended = bateleur_in(folder.path(), &["compare", "old", "new", "--tolerance", "yaw=wide"]);
    assert_eq!(ended.code, 2);
    assert!(ended.stderr.contains("\"wide\" is no tolerance"), "{}", ended.stderr);
}
