//! `bateleur bench` and `bateleur doctor` as a user meets them. No duration is judged here: the machine is shared.

use std::time::Duration;

use bateleur_tests::{Ended, alone, among_others, bateleur, flight_schedule};
use serde_json::Value;

fn json(ended: &Ended) -> Value {
    serde_json::from_str(&ended.stdout)
        .unwrap_or_else(|_| panic!("no JSON:\n{}\n{}", ended.stdout, ended.stderr))
}

#[test]
fn a_figure_that_nobody_knows_is_refused_with_those_that_there_are() {
    let ended = bateleur(&["bench", "speed"]).end();
    ended.expect_code(2).expect_words(&["there is no figure \"speed\"", "starts, fence, switch, ports"]);
}

#[test]
fn doctor_says_of_every_lack_what_it_costs_and_how_to_mend_it() {
    let _turn = among_others();
    let schedule = flight_schedule();
    let ended = bateleur(&["doctor", "--format", "json", "--schedule", schedule.to_str().unwrap()]).end();
    let examined = json(&ended);
    let findings = examined["findings"].as_array().unwrap();
    assert!(findings.len() > 20, "{examined:#}");
    let lacks: Vec<&Value> = findings.iter().filter(|finding| finding["state"] == "lacks").collect();
    for lack in &lacks {
        assert!(lack["costs"] != "" && lack["mend"] != "", "{lack}");
    }
    assert_eq!(examined["lacking"], lacks.len());
    ended.expect_code(if lacks.is_empty() { 0 } else { 1 });
}

#[test]
fn doctor_needs_no_schedule_file_and_refuses_a_broken_one() {
    let _turn = among_others();
    let ended = bateleur(&["doctor"]).end();
    assert!(ended.stdout.contains("no schedule file here"), "{}{}", ended.stdout, ended.stderr);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.toml");
    std::fs::write(&path, "[module.a]\n").unwrap();
    bateleur(&["doctor", "--schedule", path.to_str().unwrap()]).end().expect_code(2);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn every_figure_of_a_quick_bench_has_a_value_or_says_why_not() {
        let _turn = alone();
        let schedule = flight_schedule();
        let arguments = ["bench", "--quick", "--format", "json", "--schedule", schedule.to_str().unwrap()];
        let ended = bateleur(&arguments).end_within(Duration::from_secs(300));
        let measured = json(&ended);
        let rows = measured["rows"].as_array().unwrap();
        let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
        // Only what needs a privilege may be missing.
        let missing: Vec<&Value> = rows.iter().filter(|row| row["value"].is_null()).collect();
        assert!(missing.is_empty() || !rustix::process::geteuid().is_root(), "{missing:#?}");
        for beginning in [
            "window start, window before full, p99.9",
            "window start, window before closed early, p50",
            "activity past the window's end, p99.9",
            "executive's processor time per switch",
            "sampling port, write in place, 64 B",
            "sampling port, read a new value, 65536 B",
            "process, service GET_TIME",
            "process, switch among 64",
            "process, release, p99.9",
            "cold restart, p99",
            "warm restart, p99",
            "64 partitions, restart",
            "chain GPS to Servo, computing, p99",
            "executive's memory",
            "virtual clock",
        ] {
            let named = names.iter().any(|name| name.starts_with(beginning));
            assert!(named || !missing.is_empty(), "no row {beginning} among {names:#?}");
        }
        for row in rows {
            let keys: Vec<&String> = row.as_object().unwrap().keys().collect();
            assert_eq!(keys, ["about", "met", "name", "ratio", "reach", "reference", "unit", "value"]);
            if row["value"].is_null() {
                assert_ne!(row["about"], "", "{row} does not say why");
            } else {
                assert!(row["value"].as_f64().unwrap().is_finite(), "{row}");
            }
            if let Some(reference) = row["reference"].as_f64().filter(|reference| *reference != 0.0) {
                let ratio = row["value"].as_f64().unwrap() / reference;
                assert!((row["ratio"].as_f64().unwrap() - ratio).abs() < 1e-9, "{row}");
            }
        }
        let all = rows.iter().all(|row| !row["value"].is_null());
        ended.expect_code(if all { 0 } else { 1 });
    }

    #[test]
    fn the_table_of_one_figure_has_its_columns_and_nothing_else() {
        let _turn = alone();
        let ended = bateleur(&["bench", "--quick", "ports"]).end_within(Duration::from_secs(120));
        let mut lines = ended.stdout.lines();
        let machine = lines.next().unwrap();
        assert!(machine.contains(" processors (") && machine.contains(", runs: 1"), "{machine}");
        let mut lines = lines.filter(|line| !line.is_empty());
        let heading: Vec<&str> = lines.next().unwrap().trim_matches('|').split('|').map(str::trim).collect();
        assert_eq!(heading, ["figure", "value", "reference", "ratio", "reach", "met"]);
        let mut rows = lines.skip_while(|line| line.starts_with("|-"));
        assert!(
            rows.all(|line| line.starts_with("| sampling port") || line.starts_with("not here")),
            "{}",
            ended.stdout
        );
    }
}
