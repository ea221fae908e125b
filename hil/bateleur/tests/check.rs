//! What `bateleur check` prints, and how it ends.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use support::{assert_golden, bateleur, bateleur_in, repository};

const WARNED: &str = "tests/schedule/window_too_short.toml";
const BROKEN: &str = "tests/schedule/window_overlap.toml";

#[test]
fn the_flight_schedule_is_fine_by_position_by_option_and_by_default() {
    for arguments in [&["check"][..], &["check", "schedule.toml"], &["check", "--schedule", "schedule.toml"]]
    {
        let ended = bateleur(&[arguments, &["--deny", "warnings"]].concat());
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
        assert_golden("check.txt", &ended.stdout);
    }
    assert_eq!(bateleur(&["check", "schedule.toml", "--schedule", "schedule.toml"]).code, 2);
}

#[test]
fn exit_codes_tell_fine_denied_and_broken_apart() {
    assert_eq!(bateleur(&["check", WARNED]).code, 0);
    assert_eq!(bateleur(&["check", WARNED, "--deny", "warnings"]).code, 1);
    assert_eq!(bateleur(&["check", BROKEN]).code, 2);
    assert_eq!(bateleur(&["check", BROKEN, "--deny", "warnings"]).code, 2);
    let nowhere = bateleur(&["check", "nowhere.toml"]);
    assert_eq!(nowhere.code, 2);
    assert!(nowhere.stderr.contains("nowhere.toml"), "{}", nowhere.stderr);
}

#[test]
fn verbose_says_what_follows_from_the_file() {
    let ended = bateleur(&["check", "--verbose"]);
    assert_eq!(ended.code, 0);
    // The memory of the machine at hand is not the same everywhere.
    let (text, memory) = ended.stdout.rsplit_once("memory of `fcu`: 288 MiB").unwrap();
    assert!(memory.contains("this machine"), "{memory}");
    assert_golden("check_verbose.txt", text);
}

#[test]
fn formats_for_programs_are_whole_documents() {
    let parse = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
    let json = parse(&bateleur(&["check", BROKEN, "--format", "json"]).stdout);
    assert_eq!((&json["errors"], &json["facts"]), (&1.into(), &serde_json::Value::Null));
    let json = parse(&bateleur(&["check", "--format", "json"]).stdout);
    assert_eq!(json["facts"]["schedules"][0]["chains"][0]["age_ns"], 7_700_000);
    let sarif = parse(&bateleur(&["check", BROKEN, "--format", "sarif"]).stdout);
    assert_eq!(sarif["runs"][0]["results"][0]["ruleId"], "T03-window-overlap");
}

#[test]
fn a_rule_is_explained_by_its_number_its_name_or_both() {
    for id in ["T03-window-overlap", "t03", "window-overlap"] {
        let ended = bateleur(&["check", "--explain", id]);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        assert_golden("explain.txt", &ended.stdout);
    }
}

#[test]
fn an_unknown_rule_is_answered_with_the_nearest() {
    let ended = bateleur(&["check", "--explain", "T03-window-overlapp"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert_eq!(
        ended.stderr,
        "bateleur: there is no rule T03-window-overlapp: did you mean T03-window-overlap?\n"
    );
    let ended = bateleur(&["check", "--explain", "zzzzzzzz"]);
    assert_eq!(ended.stderr.lines().count(), 1, "not the whole list:\n{}", ended.stderr);
}

#[test]
fn every_rule_can_be_explained() {
    use bateleur_checker::RULES;
    for rule in RULES {
        let ended = bateleur(&["check", "--explain", rule.id]);
        assert!(ended.code == 0 && ended.stdout.contains(rule.reason), "{}: {}", rule.id, ended.stderr);
        assert!(ended.stdout.contains("help:"), "{}:\n{}", rule.id, ended.stdout);
    }
}

#[test]
fn programs_are_looked_for_where_a_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let ended = bateleur(&["check", "--programs", folder.path().to_str().unwrap(), "--deny", "warnings"]);
    assert_eq!(ended.code, 1);
    assert_eq!(ended.stdout.matches("warning[R06-program-missing]").count(), 9, "{}", ended.stdout);
    let ended = bateleur(&["check", "--programs", "nowhere"]);
    assert!(ended.code == 2 && ended.stderr.contains("nowhere is no folder"), "{}", ended.stderr);
}

#[test]
fn run_says_how_many_warnings_there_are() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(repository().join("tests/schedule/window_too_short.toml")).unwrap();
    std::fs::write(folder.path().join("short.toml"), text).unwrap();
    // Its programs are not in this folder, so it ends at once.
    let ended = bateleur_in(folder.path(), &["run", "--schedule", "short.toml", "--fast", "--until", "0.1"]);
    assert!(ended.stderr.starts_with("1 warning: see `bateleur check short.toml`\n"), "{}", ended.stderr);
}
