//! What is printed and written: that it arrives, and that nothing else is lost for it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use std::fs::OpenOptions;
use std::path::Path;
use std::process::{Command, Stdio};

use support::{bateleur, bateleur_in, repository};

const SCHEDULE: &str = "schedule.toml";
const NEEDS: &str = "hil/bateleur/tests/needs/flight.toml";

/// The code and the errors of a command whose output goes to `stdout`.
fn printed_to(stdout: impl Into<Stdio>, arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bateleur"));
    let ended = command.current_dir(repository()).args(arguments).stdout(stdout).output().unwrap();
    (ended.status.code().unwrap(), String::from_utf8(ended.stderr).unwrap())
}

/// Every way of printing: whole texts, lines, and the help.
const PRINTING: [&[&str]; 8] = [
    &["schema"],
    &["show", SCHEDULE],
    &["check", SCHEDULE, "--format", "sarif"],
    &["check", "--explain", "T03"],
    &["completions", "bash"],
    &["man"],
    &["airframe", "aerosonde"],
    &["--help"],
];

#[test]
fn output_that_a_full_disk_does_not_take_is_said_and_ends_with_an_error() {
    for arguments in PRINTING {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let (code, said) = printed_to(full, arguments);
        assert_eq!(code, 2, "{arguments:?}: {said}");
        assert!(said.contains("could not be written to the standard output: No space left"), "{said}");
    }
}

#[test]
fn output_that_nobody_reads_any_more_is_no_error() {
    for arguments in PRINTING {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        assert_eq!(printed_to(writer, arguments), (0, String::new()), "{arguments:?}");
    }
}

/// A folder with copies of a schedule and of needs, which must be the same afterwards.
fn copies() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (from, to) in [(SCHEDULE, "s.toml"), (NEEDS, "needs.toml")] {
        std::fs::copy(repository().join(from), folder.path().join(to)).unwrap();
    }
    folder
}

#[track_caller]
fn assert_refused(folder: &Path, arguments: &[&str], words: &str) {
    let before = ["s.toml", "needs.toml"].map(|name| std::fs::read(folder.join(name)).unwrap());
    let ended = bateleur_in(folder, arguments);
    assert_eq!(ended.code, 2, "{arguments:?}: {}", ended.stderr);
    assert!(ended.stderr.contains(words), "{arguments:?}: {}", ended.stderr);
    let after = ["s.toml", "needs.toml"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert!(before == after, "{arguments:?} has written over a file");
}

#[test]
fn output_that_is_an_input_is_refused_and_the_input_stays() {
    let folder = copies();
    std::os::unix::fs::symlink("s.toml", folder.path().join("link.toml")).unwrap();
    let read = "is read by this command";
    let plan = ["plan", "needs.toml", "--schedule", "s.toml", "--output"];
    assert_refused(folder.path(), &[&plan[..], &["s.toml"]].concat(), read);
    assert_refused(folder.path(), &[&plan[..], &["needs.toml"]].concat(), read);
    assert_refused(folder.path(), &[&plan[..], &["./link.toml"]].concat(), read);
    for picture in ["--svg", "--graph", "--dot"] {
        assert_refused(folder.path(), &["show", "s.toml", picture, "s.toml"], read);
    }
    let replay = ["replay", ".", "--schedule", "s.toml", "--output", "s.toml"];
    assert_refused(folder.path(), &replay, read);
}

#[test]
fn exported_log_over_one_of_the_flights_own_is_refused_whichever_hosts_and_part_it_is() {
    let folder = copies();
    let host = folder.path().join("hosts/nav");
    std::fs::create_dir_all(&host).unwrap();
    std::fs::write(folder.path().join("hosts.json"), r#"[{"module":"nav","start":1,"shift_ns":0}]"#).unwrap();
    let logs = ["ports.mcap", "ports.part-1.mcap", "hosts/nav/ports.mcap", "hosts/nav/ports.part-1.mcap"];
    for log in logs {
        std::fs::write(folder.path().join(log), b"\x89MCAP0\r\n").unwrap();
    }
    for log in logs {
        assert_refused(folder.path(), &["export", ".", "--mcap", log], "is read by this command");
    }
}

#[test]
fn output_over_a_file_of_another_kind_is_refused_and_over_an_older_one_of_its_own_is_not() {
    let folder = copies();
    let other = "holds something else";
    assert_refused(folder.path(), &["show", "s.toml", "--svg", "needs.toml"], other);
    assert_refused(folder.path(), &["replay", ".", "--output", "needs.toml"], other);
    assert_refused(folder.path(), &["export", ".", "--chrome", "needs.toml"], other);
    assert_refused(folder.path(), &["export", ".", "--mcap", "needs.toml"], other);
    assert_refused(folder.path(), &["export", ".", "--csv", "."], "is the folder that is read");
    for _ in 0..2 {
        let pictures = ["--svg", "a.svg", "--graph", "b.svg", "--dot", "c.dot"];
        let ended = bateleur_in(folder.path(), &[&["show", "s.toml"], &pictures[..]].concat());
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        let plan = ["plan", "needs.toml", "--schedule", "s.toml", "--output", "planned.toml"];
        let ended = bateleur_in(folder.path(), &plan);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
    }
}

#[test]
fn replay_of_what_is_not_there_leaves_an_earlier_log_as_it_was_and_says_each_thing_once() {
    let folder = copies();
    let earlier = folder.path().join("loop.mcap");
    std::fs::write(&earlier, b"\x89MCAP0\r\nof yesterday").unwrap();
    let ended = bateleur_in(folder.path(), &["replay", ".", "--schedule", "s.toml", "--output", "loop.mcap"]);
    assert_eq!(ended.code, 2, "{}", ended.stderr);
    assert_eq!(std::fs::read(&earlier).unwrap(), b"\x89MCAP0\r\nof yesterday");
    assert_eq!(ended.stderr.matches("No such file").count(), 1, "{}", ended.stderr);
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 3, "a folder for the loop's log is left");
}

#[test]
fn run_in_a_folder_that_another_run_writes_into_is_refused() {
    let folder = copies();
    let output = folder.path().join("target/runs/latest");
    std::fs::create_dir_all(&output).unwrap();
    let other = std::fs::File::open(&output).unwrap();
    other.lock().unwrap();
    let ended = bateleur_in(folder.path(), &["run", "--schedule", "s.toml", "--fast", "--until", "0.1"]);
    assert_eq!(ended.code, 2, "{}", ended.stderr);
    assert!(ended.stderr.contains("another run writes into"), "{}", ended.stderr);
}

#[test]
fn help_is_printed_with_its_own_code() {
    assert_eq!(bateleur(&["--help"]).code, 0);
    assert_eq!(bateleur(&["--no-such-option"]).code, 2);
}
