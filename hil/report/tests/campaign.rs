//! What a campaign leaves on the disk, and what is made of it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::path::Path;

use bateleur_report::campaign::{
    CampaignError, CampaignResult, Flown, Plan, RESULTS, append, join, page, read, repair,
};

fn plan(part: u64, parts: u64, flights: u64) -> Plan {
    Plan {
        flights,
        seed: 10,
        shard: (part, parts),
        space: BTreeMap::from([("wind, m/s".to_owned(), "0..8".to_owned())]),
        common: vec!["--set=controller.laps=1".into()],
        schedule: "abc".into(),
        programs: "def".into(),
        version: "0.1.0".into(),
    }
}

fn flown(number: u64) -> Flown {
    let completed = number % 10 != 3;
    Flown {
        number,
        seed: 10 + number,
        command: format!("bateleur fly --fast --seed={}", 10 + number),
        conditions: BTreeMap::new(),
        completed,
        failure: (!completed).then(|| format!("no way-point for {}.5 s", 60 + number)),
        figures: BTreeMap::from([
            ("altitude_rms_m".to_owned(), number as f64),
            ("conditions.touchdown.along_m".to_owned(), 10.0 - number as f64),
        ]),
        digest: Some(format!("digest {number}")),
        module_time_s: Some(200.0),
        wall_time_s: 36.0,
        folder: None,
        engine: None,
        compared: false,
    }
}

fn write(folder: &Path, plan: &Plan, numbers: impl Iterator<Item = u64>) {
    std::fs::create_dir_all(folder).unwrap();
    plan.write(folder).unwrap();
    let mut results = OpenOptions::new().create(true).append(true).open(folder.join(RESULTS)).unwrap();
    numbers.for_each(|number| append(&mut results, &flown(number)).unwrap());
}

#[test]
fn line_that_was_cut_off_does_not_count_and_is_taken_away() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &plan(0, 1, 5), 0..5);
    let path = folder.path().join(RESULTS);
    let whole = std::fs::read(&path).unwrap();
    let before_last = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').unwrap() + 1;
    for keep in [whole.len() - 1, before_last + 1, before_last] {
        std::fs::write(&path, &whole[..keep]).unwrap();
        assert_eq!(read(folder.path()).unwrap().flights.len(), 4, "{keep}");
        assert_eq!(repair(folder.path()).unwrap(), (keep - before_last) as u64);
        assert_eq!(std::fs::read(&path).unwrap(), whole[..before_last]);
    }
    std::fs::write(&path, "no line at all").unwrap();
    assert_eq!(repair(folder.path()).unwrap(), 14);
    assert_eq!(repair(Path::new("/nowhere")).unwrap(), 0, "nothing there is nothing torn");
}

#[test]
fn every_flight_belongs_to_one_shard() {
    let mut all: Vec<u64> =
        (0..7).flat_map(|part| plan(part, 7, 100).numbers().collect::<Vec<_>>()).collect();
    all.sort_unstable();
    assert_eq!(all, (0..100).collect::<Vec<_>>());
    assert_eq!(plan(3, 7, 3).numbers().count(), 0);
}

#[test]
fn shards_join_in_any_order_and_what_is_missing_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    write(&a, &plan(0, 2, 100), plan(0, 2, 100).numbers());
    write(&b, &plan(1, 2, 100), plan(1, 2, 100).numbers().filter(|number| *number != 41));
    let (joined, lines) = join(&[b.clone(), a.clone()]).unwrap();
    assert_eq!((joined.shard, lines.flights.len()), ((0, 1), 99));
    let result = CampaignResult::of(&joined, &lines);
    assert_eq!((result.asked, result.flown, result.completed, result.failed.len()), (100, 99, 89, 10));
    assert_eq!(result.notes, ["not flown: 1 of 100 flights (41)"]);
    assert_eq!(result.reasons, BTreeMap::from([("no way-point for … s".to_owned(), 10)]));
    assert!((result.flight_hours - 0.99).abs() < 1e-9);
    let half = CampaignResult::of(&plan(0, 2, 100), &read(&a).unwrap());
    assert_eq!((half.asked, half.completed), (50, 50), "a shard alone is whole");
}

#[test]
fn percentiles_are_values_that_were_flown_and_the_worst_has_its_seed() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &plan(0, 1, 100), 0..100);
    let result = CampaignResult::of(&plan(0, 1, 100), &read(folder.path()).unwrap());
    let altitude = &result.figures[0];
    assert_eq!((altitude.figure.as_str(), altitude.flights), ("altitude_rms_m", 90));
    // Of 0 … 99 without those that end in 3: the 45th, 86th and 90th.
    assert_eq!((altitude.p50, altitude.p95, altitude.p99), (49.0, 95.0, 99.0));
    assert_eq!((altitude.worst, altitude.worst_flight, altitude.worst_seed), (99.0, 99, 109));
    assert!(result.failed[0].command.contains("--seed=13"));
    let short = &result.figures[1];
    assert_eq!(
        (short.figure.as_str(), short.worst),
        ("conditions.touchdown.along_m", 89.0),
        "89 m short is off as well"
    );
}

#[test]
fn flights_beyond_those_that_are_asked_for_do_not_count_and_are_said() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &plan(0, 1, 10), 0..10);
    let result = CampaignResult::of(&plan(0, 1, 3), &read(folder.path()).unwrap());
    assert_eq!((result.asked, result.flown, result.completed), (3, 3, 3));
    assert!(result.notes[0].starts_with("7 more are there"), "{:?}", result.notes);
}

#[test]
fn campaigns_of_other_flights_are_not_joined() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, c] = ["a", "b", "c"].map(|name| folder.path().join(name));
    write(&a, &plan(0, 2, 4), 0..1);
    write(&b, &Plan { seed: 11, ..plan(1, 2, 4) }, 1..2);
    write(&c, &Plan { programs: "other".into(), ..plan(1, 2, 4) }, 1..2);
    let error = join(&[a.clone(), b]).unwrap_err();
    assert!(
        matches!(error, CampaignError::Mixed { .. }) && error.to_string().contains("seed: 10 and 11"),
        "{error}"
    );
    let (_, lines) = join(&[a.clone(), c]).unwrap();
    assert!(lines.notes[0].contains("the programs have changed"), "{:?}", lines.notes);
    assert!(
        join(&[a, folder.path().join("nowhere")]).unwrap_err().to_string().contains("there is no campaign")
    );
    assert!(join(&[]).is_err());
}

#[test]
fn flight_that_ended_twice_and_not_the_same_way_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    write(&a, &plan(0, 1, 2), 0..2);
    write(&b, &plan(0, 1, 2), 0..1);
    let mut results = OpenOptions::new().append(true).open(b.join(RESULTS)).unwrap();
    append(&mut results, &Flown { digest: Some("another".into()), ..flown(1) }).unwrap();
    let (joined, lines) = join(&[a, b]).unwrap();
    let notes = CampaignResult::of(&joined, &lines).notes;
    assert_eq!(notes, ["flight 1 was flown twice and did not end the same way"]);
}

#[test]
fn page_loads_nothing_and_shows_words_as_words() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &plan(0, 1, 20), 0..20);
    let mut lines = read(folder.path()).unwrap();
    lines.flights.get_mut(&3).unwrap().failure = Some("<script>alert(1)</script>".into());
    let page = page(&CampaignResult::of(&plan(0, 1, 20), &lines));
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    for foreign in ["<script", "http://", "https://", "src=", "@import", "url("] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    assert!(page.contains("&lt;script&gt;") && page.contains("--seed=23"));
    assert!(CampaignResult::of(&plan(0, 1, 0), &read(Path::new("/nowhere")).unwrap()).figures.is_empty());
}

#[test]
fn plan_with_more_flights_than_memory_holds_is_told_of_and_does_not_end_the_program() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &plan(0, 1, 3_000_000_000), 0..3);
    let (joined, lines) = join(&[folder.path().to_path_buf()]).unwrap();
    let result = CampaignResult::of(&joined, &lines);
    assert_eq!((result.asked, result.flown), (3_000_000_000, 3));
    let note = "not flown: 2999999997 of 3000000000 flights (3, 4, 5, 6, 7, 8, 9, 10, …)";
    assert_eq!(result.notes, [note]);
}
