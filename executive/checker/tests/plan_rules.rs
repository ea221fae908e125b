//! One bad file for each rule, with the text that the checker answers.
//!
//! The first line of a file names the rules that it breaks, and it must break those and no other; notes may come on top. With
//! `BLESS=1` in the environment the texts are written instead of compared.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use bateleur_checker::{RULES, Report, Rule, Severity, example_of};
use bateleur_plan::{Plan, PortId};
use plan_support::{Table, answer_to, repository};

fn bad_files() -> Vec<PathBuf> {
    let entries = fs::read_dir(repository().join("tests/schedule")).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    files.sort();
    files
}

fn report_on(path: &Path) -> (String, Report) {
    let text = fs::read_to_string(path).unwrap();
    let name = format!("tests/schedule/{}", path.file_name().unwrap().display());
    let report = match answer_to(&name, &text) {
        Ok((_, report)) | Err(report) => report,
    };
    (text, report)
}

fn announced(text: &str) -> BTreeSet<&str> {
    let first = text.lines().next().unwrap_or_default();
    let rules = first.strip_prefix("# breaks ").expect("the first line names the rules that the file breaks");
    rules.split(", ").collect()
}

fn rule(id: &str) -> &'static Rule {
    RULES.iter().find(|rule| rule.id == id).unwrap_or_else(|| panic!("there is no rule {id}"))
}

/// The report as the file beside it has it: with notes only where they are what the file is about.
fn rendered(text: &str, report: &Report) -> String {
    let about_notes = announced(text).iter().any(|id| rule(id).severity == Severity::Note);
    if about_notes { report.render_all(false) } else { report.render(false) }
}

fn broken(report: &Report) -> BTreeSet<&str> {
    report.violations().iter().map(|violation| violation.rule).collect()
}

#[test]
fn every_bad_file_breaks_the_rules_that_it_announces_and_no_other() {
    for path in bad_files() {
        let (text, report) = report_on(&path);
        let expected = announced(&text);
        let noted = |id: &&str| !expected.contains(id) && rule(id).severity == Severity::Note;
        let found: BTreeSet<&str> = broken(&report).into_iter().filter(|id| !noted(id)).collect();
        assert_eq!(found, expected, "{}:\n{report}", path.display());
    }
}

#[test]
fn prt_08_channel_has_one_source_and_a_queue_one_destination() {
    let file = repository().join("tests/schedule/channel_queuing_several_destinations.toml");
    assert!(broken(&report_on(&file).1).contains("C05-queuing-several-destinations"));
    // The table of a channel has one source: a second one is a second channel into the same port.
    let file = repository().join("tests/schedule/channel_destination_twice.toml");
    assert!(broken(&report_on(&file).1).contains("C06-destination-twice"));
}

#[test]
fn every_rule_has_a_bad_file() {
    let reports: Vec<Report> = bad_files().iter().map(|path| report_on(path).1).collect();
    let found: BTreeSet<&str> = reports.iter().flat_map(broken).collect();
    let rules: BTreeSet<&str> = RULES.iter().map(|rule| rule.id).collect();
    assert_eq!(found, rules);
    assert_eq!(rules.len(), RULES.len(), "two rules share an id");
}

#[test]
fn every_bad_file_is_answered_with_the_text_beside_it() {
    let bless = std::env::var_os("BLESS").is_some();
    let mut differ = Vec::new();
    for path in bad_files() {
        let (text, report) = report_on(&path);
        let text = rendered(&text, &report);
        let expected = path.with_extension("stderr");
        if bless {
            fs::write(&expected, &text).unwrap();
        } else if fs::read_to_string(&expected).unwrap_or_default() != text {
            differ.push(format!("{}:\n{text}", expected.display()));
        }
    }
    assert!(differ.is_empty(), "{}\nrun again with BLESS=1 if this is meant", differ.join("\n"));
}

#[test]
fn every_expected_text_has_its_bad_file() {
    for entry in fs::read_dir(repository().join("tests/schedule")).unwrap() {
        let path = entry.unwrap().path();
        assert!(path.with_extension("toml").exists(), "{} has no file that it answers", path.display());
    }
}

#[test]
fn absence_from_a_schedule_is_told_unless_the_schedule_says_that_it_is_meant() {
    let text =
        fs::read_to_string(repository().join("tests/schedule/partition_not_in_schedule.toml")).unwrap();
    let said = |action: &str| match answer_to("schedule.toml", &format!("{text}change_action = {action}\n")) {
        Ok((_, report)) | Err(report) => report,
    };
    assert_eq!(broken(&said("{ servo = \"ignore\" }")), BTreeSet::new());
    assert_eq!(broken(&said("{ imu = \"ignore\" }")), BTreeSet::from(["T10-not-in-schedule"]));
    let both = BTreeSet::from(["T10-not-in-schedule", "T20-change-action-unused"]);
    assert_eq!(broken(&said("{ servo = \"idle\" }")), both, "nobody is ended who has no window");
}

#[test]
fn every_violation_says_where_it_is_and_how_to_mend_it() {
    for path in bad_files() {
        let (text, report) = report_on(&path);
        for violation in report.violations() {
            let place = &violation.place;
            assert!(text.get(place.span.clone()).is_some(), "{violation:?}");
            let before: Vec<&str> = text[..place.span.start].split('\n').collect();
            assert_eq!(before.len(), place.line, "{violation:?}");
            assert_eq!(before.last().unwrap().chars().count() + 1, place.column, "{violation:?}");
            assert!(!violation.message.is_empty() && !violation.mend.is_empty(), "{violation:?}");
        }
    }
}

#[test]
fn the_example_of_a_rule_breaks_it_and_is_a_bad_file() {
    for rule in RULES {
        let path = repository().join("tests/schedule").join(rule.example_name);
        assert_eq!(fs::read_to_string(path).unwrap(), rule.example, "{}", rule.id);
        let report =
            example_of(rule, &Table).unwrap_or_else(|| panic!("{} is not broken by its example", rule.id));
        assert_eq!(broken(&report), BTreeSet::from([rule.id]));
        assert!(report.render_first(false).contains("help:"), "{}", rule.id);
    }
}

/// What every reader of the format relies on, for one document.
fn assert_sarif(document: &serde_json::Value, report: &Report) {
    assert_eq!(document["version"], "2.1.0");
    assert!(document["$schema"].as_str().unwrap().ends_with("sarif-schema-2.1.0.json"));
    let [run] = document["runs"].as_array().unwrap().as_slice() else { panic!("one run") };
    let rules = run["tool"]["driver"]["rules"].as_array().unwrap();
    assert!(run["tool"]["driver"]["name"].is_string() && rules.len() == RULES.len());
    assert_eq!(run["columnKind"], "unicodeCodePoints");
    let results = run["results"].as_array().unwrap();
    assert_eq!(results.len(), report.violations().len());
    for result in results {
        let index = usize::try_from(result["ruleIndex"].as_u64().unwrap()).unwrap();
        assert_eq!(result["ruleId"], rules[index]["id"]);
        assert!(["error", "warning", "note"].contains(&result["level"].as_str().unwrap()));
        assert!(!result["message"]["text"].as_str().unwrap().is_empty());
        let related = result["relatedLocations"].as_array().unwrap();
        for location in result["locations"].as_array().unwrap().iter().chain(related) {
            let place = &location["physicalLocation"];
            assert!(place["artifactLocation"]["uri"].as_str().unwrap().ends_with(".toml"));
            let number = |key: &str| place["region"][key].as_u64().unwrap();
            assert!(number("startLine") >= 1 && number("startColumn") >= 1);
            assert!(
                (number("endLine"), number("endColumn")) >= (number("startLine"), number("startColumn")),
                "{place}"
            );
        }
        assert!(related.iter().all(|location| location["message"]["text"].is_string()));
    }
}

#[test]
fn every_report_is_a_sarif_document() {
    for path in bad_files() {
        let (_, report) = report_on(&path);
        assert_sarif(&report.to_sarif(), &report);
    }
}

#[test]
fn a_report_for_programs_has_every_violation_with_its_places() {
    let (_, report) = report_on(&repository().join("tests/schedule/window_overlap.toml"));
    let json = report.to_json();
    assert_eq!((&json["errors"], &json["warnings"]), (&1.into(), &0.into()));
    let violation = &json["violations"][0];
    assert_eq!(violation["rule"], "T03-window-overlap");
    assert_eq!(violation["severity"], "error");
    assert_eq!((&violation["line"], &violation["related"][0]["line"]), (&30.into(), &29.into()));
    assert!(violation["mend"].as_str().is_some_and(|mend| mend.contains("1ms")));
}

#[test]
fn colour_changes_the_look_and_not_the_words() {
    let (_, report) = report_on(&repository().join("tests/schedule/window_overlap.toml"));
    let coloured = report.render(true);
    assert!(coloured.contains("\u{1b}["));
    assert!(!report.render(false).contains('\u{1b}'));
    assert!(coloured.contains("overlap on core 1 of `fcu`"));
}

#[test]
fn a_damaged_file_is_answered_and_never_panics() {
    let text = fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    for skipped in 0..lines.len() {
        let rest = [&lines[..skipped], &lines[skipped + 1..]].concat().join("\n");
        answer(&rest);
    }
    for end in (0..text.len()).step_by(101) {
        answer(text.get(..end).unwrap_or_default());
    }
    for word in ["\"20ms\"", "\"imu\"", "[1]", "\"sampling\"", "\"source\""] {
        for other in [
            "0",
            "\"0\"",
            "\"0ms\"",
            "[]",
            "{}",
            "-1",
            "1e400",
            "\"\"",
            "\"ä.ö\"",
            "99999999999999999999",
            "[[]]",
        ] {
            answer(&text.replace(word, other));
        }
    }
}

fn answer(text: &str) {
    match answer_to("damaged.toml", text) {
        Ok((_, report)) => assert_eq!(report.errors(), 0),
        Err(report) => assert!(report.errors() > 0 && report.render(true).len() > 20),
    }
}

/// Where names of the file stand in quotes, and what they are.
fn names_in(text: &str, plan: &Plan) -> Vec<(std::ops::Range<usize>, &'static str)> {
    let mut known: Vec<(String, &str)> = Vec::new();
    known.extend(plan.modules.iter().map(|module| (module.name.clone(), "N06-unknown-module")));
    known.extend(plan.networks.iter().map(|network| (network.name.clone(), "N08-unknown-network")));
    known.extend(plan.partitions.iter().map(|one| (one.name.clone(), "N03-unknown-partition")));
    let ports = (0..plan.ports.len()).map(|place| plan.port_path(PortId(place)));
    known.extend(ports.map(|path| (path, "N04-unknown-port")));
    let is_name = |key: &str| !["program", "name"].contains(&key);
    let mut found = Vec::new();
    for (name, rule) in known {
        for (at, quoted) in text.match_indices(&format!("\"{name}\"")) {
            let line = text[..at].rsplit('\n').next().unwrap_or_default();
            let key = line.rsplit('=').nth(1).unwrap_or(line).trim().rsplit([' ', ',', '{']).next();
            if key.is_some_and(is_name) && !line.contains('#') {
                found.push((at + 1..at + quoted.len() - 1, rule));
            }
        }
    }
    found
}

#[test]
fn a_name_that_leads_nowhere_is_reported_where_it_stands_and_hides_nothing_else() {
    for name in ["schedule.toml", "schedules/two-hosts.toml", "schedules/three-hosts.toml"] {
        let text = fs::read_to_string(repository().join(name)).unwrap();
        let (plan, _) = answer_to(name, &text).unwrap();
        // Far behind all names, and nobody's fault.
        let faulty = format!("{text}\n[[chain]]\nname = \"none\"\npath = []\nmax_age = \"0ms\"\n");
        let places = names_in(&text, &plan);
        assert!(places.len() > 40, "{name}: {}", places.len());
        for (span, rule) in places {
            let misspelt = [&faulty[..span.start], "nowhere", &faulty[span.end..]].concat();
            let Err(report) = answer_to(name, &misspelt) else { panic!("{name}: {span:?} is taken") };
            let at = |rule: &str| {
                let mut found = report.violations().iter().filter(|one| one.rule == rule);
                found.any(|one| one.place.span.start + 1 == span.start)
            };
            assert!(at(rule), "{name}: {rule} at {span:?}:\n{report}");
            let others = BTreeSet::from(["L02-chain-too-short", "L03-chain-zero-age"]);
            assert!(broken(&report).is_superset(&others), "{name}: {span:?}:\n{report}");
            let said = report.violations().iter().flat_map(|one| [&one.message, &one.mend]);
            let stand_in = said.clone().find(|said| said.contains("``"));
            assert_eq!(stand_in, None, "{name}: {span:?}");
        }
    }
}
