//! Campaigns that really fly: few flights of a small mission, in virtual time.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use bateleur_tests::{
    Process, Sketch, Started, among_others, await_some, bateleur, children_of, edited, laps_of_small_mission,
    small_mission,
};
use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

/// Longer than a few flights take on a machine that is busy with other things.
const PATIENCE: Duration = Duration::from_secs(200);

/// A folder with the schedule.
fn place() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("schedule.toml"), edited(&[])).unwrap();
    folder
}

fn campaign(place: &TempDir, output: &str, options: &[&str]) -> Started {
    let (schedule, output) = (place.path().join("schedule.toml"), place.path().join(output));
    let mut all =
        vec!["campaign", "--schedule", schedule.to_str().unwrap(), "--output", output.to_str().unwrap()];
    all.extend(["--format", "json"]);
    if !options.contains(&"--jobs") {
        all.extend(["--jobs", "2"]);
    }
    all.extend(options);
    // Over sooner than the laps of the schedule.
    let mission = format!("--mission={}", small_mission().display());
    if !options.contains(&"--") {
        all.extend(["--", &mission]);
    }
    bateleur(&all)
}

/// The lines of a campaign by number; every one is whole.
fn lines(folder: &Path) -> BTreeMap<u64, Value> {
    let text = std::fs::read_to_string(folder.join("flights.jsonl")).unwrap_or_default();
    let mut all = BTreeMap::new();
    for line in text.split_inclusive('\n') {
        assert!(line.ends_with('\n'), "the last line has no end: {line}");
        let flight: Value = serde_json::from_str(line).unwrap();
        let other = all.insert(flight["number"].as_u64().unwrap(), flight);
        assert!(other.is_none(), "flown twice: {line}");
    }
    all
}

fn digests(folder: &Path) -> BTreeMap<u64, String> {
    lines(folder)
        .into_iter()
        .map(|(number, flight)| (number, flight["digest"].as_str().unwrap().to_owned()))
        .collect()
}

#[test]
fn plan_of_several_hosts_is_flown_with_all_of_them_and_the_same_again() {
    let _turn = among_others();
    let place = tempfile::tempdir().unwrap();
    let schedule = bateleur_tests::repository().join("schedules/two-hosts.toml");
    let fly = |output: &str| {
        let folder = place.path().join(output);
        let all = ["campaign", "--flights", "2", "--jobs", "2", "--format", "json", "--schedule"];
        let mut all = all.map(str::to_owned).to_vec();
        all.extend([schedule.display().to_string(), "--output".into(), folder.display().to_string()]);
        all.extend(["--".into(), format!("--mission={}", small_mission().display())]);
        let ended = bateleur(&all).end_within(PATIENCE);
        assert_eq!(ended.summary()["flown"], 2, "{}", ended.stderr);
        assert!(!ended.stderr.contains("choose one with --module"), "{}", ended.stderr);
        folder
    };
    let (once, again) = (fly("once"), fly("again"));
    for flight in lines(&once).values() {
        let command = flight["command"].as_str().unwrap();
        assert!(command.contains(" --hosts ") && !command.contains("--kill=relay_"), "{command}");
    }
    assert_eq!(digests(&once), digests(&again));
}

#[test]
fn executives_are_killed_at_drawn_instants_and_their_flights_go_on() {
    let _turn = among_others();
    let place = place();
    let mission = laps_of_small_mission(place.path(), 5);
    let mission = format!("--mission={}", mission.display());
    let kills = ["--flights", "2", "--kills", "2", "--kill-only", "executive", "--keep", "--", &mission];
    campaign(&place, "out", &kills).end_within(PATIENCE).expect_code(0);
    let folder = place.path().join("out");
    let mut died = 0;
    for (number, flight) in lines(&folder) {
        let command = flight["command"].as_str().unwrap();
        assert_eq!(command.matches(" --kill=executive@").count(), 2, "{command}");
        let health = folder.join(format!("flights/{number}/health.jsonl"));
        died += std::fs::read_to_string(health).unwrap().matches("\"executive_died\"").count();
    }
    assert!(died > 0, "no instant was before the end of its flight");
    campaign(&place, "none", &["--flights", "1", "--kill-only", "executiv"])
        .end()
        .expect_code(2)
        .expect_words(&["did you mean `executive`?"]);
    let stays_dead = edited(&[("executive_died    = \"reset\"", "executive_died    = \"shutdown\"")]);
    std::fs::write(place.path().join("schedule.toml"), stays_dead).unwrap();
    let refused = campaign(&place, "none", &["--flights", "1", "--kill-only", "executive"]).end();
    refused.expect_code(2).expect_words(&["executive_died = \"reset\""]);
}

#[test]
fn shards_fly_the_flights_of_the_campaign_in_one_piece_and_no_logs_stay() {
    let _turn = among_others();
    let place = place();
    let whole = campaign(&place, "whole", &["--flights", "4"]).end_within(PATIENCE);
    let summary = whole.summary();
    assert_eq!((&summary["asked"], &summary["flown"]), (&4.into(), &4.into()), "{}", whole.stderr);
    let folder = place.path().join("whole");
    assert_eq!(
        std::fs::read_dir(folder.join("flights")).unwrap().count() as u64,
        4 - summary["completed"].as_u64().unwrap()
    );
    assert!(folder.join("report.html").exists() && folder.join("result.json").exists());
    for shard in ["0/2", "1/2"] {
        campaign(&place, "parts", &["--flights", "4", "--shard", shard]).end_within(PATIENCE);
    }
    let parts = ["shard-0-of-2", "shard-1-of-2"].map(|name| place.path().join("parts").join(name));
    let merged = place.path().join("merged");
    let mut merge = vec!["campaign", "merge", "--format", "json", "--output", merged.to_str().unwrap()];
    merge.extend(parts.iter().map(|part| part.to_str().unwrap()));
    let merged_summary = bateleur(&merge).end().summary();
    assert_eq!(digests(&merged), digests(&folder), "the same flights, bit for bit");
    assert_eq!(merged_summary["figures"], summary["figures"]);
    assert_eq!(merged_summary["notes"], Value::Array(Vec::new()));
}

#[test]
fn stopped_campaign_leaves_whole_lines_and_no_process_and_goes_on_where_it_was() {
    let _turn = among_others();
    let place = place();
    let folder = place.path().join("out");
    let six = ["--flights", "6", "--kills", "0..1"];
    let first = campaign(&place, "out", &six);
    let one = || (!lines(&folder).is_empty()).then_some(());
    assert!(await_some(PATIENCE, one).is_some(), "no flight: {}", first.said());
    let children = children_of(first.pid());
    assert!(!children.is_empty());
    first.signal_group(Signal::INT);
    let ended = first.end_within(PATIENCE).expect_code(1).expect_words(&["the same command goes on"]);
    assert!(
        ended.summary()["flown"].as_u64().unwrap() < 6,
        "it was stopped too late to tell: {}",
        ended.stderr
    );
    let gone = || children.iter().all(|child| !child.is_alive()).then_some(());
    assert!(await_some(Duration::from_secs(20), gone).is_some(), "{children:?}");
    let before = digests(&folder);
    // A crash in the middle of a line.
    let path = folder.join("flights.jsonl");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text + "{\"number\":5,\"se").unwrap();
    let ended =
        campaign(&place, "out", &six).end_within(PATIENCE).expect_words(&["cut off", "are there already"]);
    assert_eq!(ended.summary()["flown"], 6, "{}", ended.stderr);
    let after = digests(&folder);
    assert!(before.iter().all(|(number, digest)| after[number] == *digest));
    campaign(&place, "out", &["--flights", "6", "--kills", "0..1", "--wind", "1..2"])
        .end()
        .expect_code(2)
        .expect_words(&["holds another campaign (wind, m/s"]);
}

/// The program of a flight, once it is there.
#[track_caller]
fn flight_of(campaign: &Started) -> Process {
    // Before its program begins, a child is called as the campaign is, and a campaign waits for one that is stopped then.
    let is_flight = |child: &Process| {
        let line = std::fs::read_to_string(format!("/proc/{}/cmdline", child.pid)).unwrap_or_default();
        line.split('\0').nth(1) == Some("fly")
    };
    let found = || children_of(campaign.pid()).into_iter().find(is_flight);
    await_some(PATIENCE, found).unwrap_or_else(|| panic!("no flight: {}", campaign.said()))
}

#[test]
fn flight_that_hangs_is_ended_and_has_failed() {
    let _turn = among_others();
    let place = place();
    let hung = campaign(&place, "out", &["--flights", "1", "--patience", "3"]);
    let flight = flight_of(&hung);
    flight.signal(Signal::STOP);
    let ended = hung.end_within(PATIENCE).expect_code(1);
    assert!(!flight.is_alive());
    let flights = lines(&place.path().join("out"));
    assert_eq!(flights[&0]["failure"], "it hangs: no end after 3 s (--patience)", "{}", ended.stderr);
}

#[test]
fn flight_that_is_killed_has_failed_and_the_next_one_flies() {
    let _turn = among_others();
    let place = place();
    let killed = campaign(&place, "out", &["--flights", "2", "--jobs", "1"]);
    flight_of(&killed).signal(Signal::KILL);
    let ended = killed.end_within(PATIENCE).expect_code(1);
    let flights = lines(&place.path().join("out"));
    assert_eq!(flights.len(), 2, "{}", ended.stderr);
    let failure = flights[&0]["failure"].as_str().unwrap();
    assert!(failure.starts_with("the flight was ended by signal 9"), "{failure}");
    assert!(flights[&1]["digest"].is_string(), "the next one flew");
}

#[test]
fn flight_that_can_not_begin_has_failed_with_its_last_words() {
    let _turn = among_others();
    let place = place();
    let ended = campaign(&place, "out", &["--flights", "2", "--", "--mission=/dev/null"]);
    ended.end_within(PATIENCE).expect_code(1);
    for flight in lines(&place.path().join("out")).values() {
        let failure = flight["failure"].as_str().unwrap();
        assert!(
            failure.contains("ended with code 2") && failure.contains("the mission has no way-points"),
            "{failure}"
        );
    }
}

#[test]
fn failed_flight_flies_again_from_its_command() {
    let _turn = among_others();
    let place = place();
    // Six deaths in ten seconds are more than the budget: the Estimator rests, and the mission fails.
    let kills: Vec<String> = (0..6).map(|n| format!("--kill=estimator@{}", 60 + n)).collect();
    let mut options = vec!["--flights", "1", "--kills", "0", "--"];
    options.extend(kills.iter().map(String::as_str));
    let ended = campaign(&place, "out", &options).end_within(PATIENCE).expect_code(1);
    let failure = &ended.summary()["failed"][0];
    assert!(failure["reason"].as_str().unwrap().contains("estimator is idle"), "{failure}");
    let command = failure["command"].as_str().unwrap();
    assert!(ended.stderr.contains(command), "{}", ended.stderr);
    let mut words: Vec<&str> = command.split(' ').skip(1).collect();
    words.extend(["--format", "json"]);
    let again = bateleur(&words).end_within(PATIENCE).expect_code(1).summary();
    assert_eq!(again["digest"], lines(&place.path().join("out"))[&0]["digest"]);
    assert!(place.path().join("out/flights/0/ports.mcap").exists(), "logs of failed flights are kept");
}

/// A judge in a shell: it fails seed 3, and can not judge seed 5.
const JUDGE: &str = "#!/bin/sh\ntest -s \"$1/windows.csv\" || exit 9\necho judged $BATELEUR_SEED, code $BATELEUR_EXIT\n\
    test $BATELEUR_SEED = 3 && exit 1\ntest $BATELEUR_SEED = 5 && exit 7\nexit 0\n";

fn judge(folder: &Path) -> String {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("judge.sh");
    std::fs::write(&path, JUDGE).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn plan_that_does_not_fly_is_judged_by_the_users_own_program() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new()
        .partition("one", "counter", 1000, "")
        .partition("two", "counter", 500, "")
        .write(folder.path());
    let output = folder.path().join("runs");
    let judge = judge(folder.path());
    let begun = |options: &[&str]| {
        let all =
            ["campaign", "--schedule", &schedule, "--output", output.to_str().unwrap(), "--format", "json"];
        bateleur(&[&all[..], options].concat()).end()
    };
    let options = ["--flights", "6", "--until", "2", "--kills", "1..2", "--judge", &judge];
    begun(&options).expect_code(1);
    let runs = lines(&output);
    assert_eq!(runs.len(), 6);
    for (number, run) in &runs {
        let seed = number + 1;
        assert_eq!(run["completed"] == true, seed != 3 && seed != 5, "{run}");
        let failure = run["failure"].as_str().unwrap_or_default();
        match seed {
            3 => assert_eq!(failure, "judged 3, code 0"),
            5 => assert!(failure.contains("could not judge") && failure.contains("judged 5"), "{failure}"),
            _ => assert_eq!(failure, ""),
        }
        let command = run["command"].as_str().unwrap();
        assert!(command.starts_with("bateleur run --fast") && command.contains("--kill="), "{command}");
    }
    // Again nothing is left to do, and without a judge or a length nothing begins.
    assert!(begun(&options).expect_code(1).stderr.contains("0 flights to fly"));
    begun(&["--flights", "2"]).expect_code(2).expect_words(&["does not fly", "--until SECONDS", "--judge"]);
    begun(&["--flights", "2", "--until", "2", "--judge", &schedule])
        .expect_code(2)
        .expect_words(&["no program"]);
    begun(&[&options[..], &["--wind", "3..4"]].concat())
        .expect_code(2)
        .expect_words(&["only flights draw that"]);
    begun(&[&options[..], &["--", "--bad"]].concat()).expect_code(2).expect_words(&["--bad"]);
}

#[test]
fn flight_that_has_completed_its_mission_can_still_fail_before_a_judge() {
    let _turn = among_others();
    let place = place();
    let judge = judge(place.path());
    campaign(&place, "judged", &["--flights", "2", "--seed", "2", "--judge", &judge]).end().expect_code(1);
    let flights = lines(&place.path().join("judged"));
    let of = |number: u64| (flights[&number]["completed"] == true, flights[&number]["failure"].clone());
    assert_eq!((of(0), of(1)), ((true, Value::Null), (false, "judged 3, code 0".into())));
    assert!(flights[&1]["digest"].is_string(), "its figures are kept");
}
