//! The JSON schema of the schedule file beside the reader: what the reader takes, the schema takes, and what is wrong in
//! its structure, both refuse.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::fs;

use bateleur_checker::schema;
use plan_support::repository;
use plan_support::schema_check::{STRUCTURAL, fault_in};

#[test]
fn the_flight_schedule_meets_the_schema() {
    let text = fs::read_to_string(repository().join("schedule.toml")).unwrap();
    assert_eq!(fault_in(&schema(), &text), None);
}

#[test]
fn what_the_schema_cannot_see_is_let_through_and_wrong_structure_is_not() {
    let schema = schema();
    let (mut refused, mut taken) = (0, 0);
    for entry in fs::read_dir(repository().join("tests/schedule")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|end| end != "toml") {
            continue;
        }
        let text = fs::read_to_string(&path).unwrap();
        let rules: Vec<&str> =
            text.lines().next().unwrap().strip_prefix("# breaks ").unwrap().split(", ").collect();
        let breaks = |ids: &[&str]| rules.iter().any(|rule| ids.iter().any(|id| rule.starts_with(id)));
        // An empty file lacks what only a whole plan needs, which a schema would have to ask of every draft.
        // A number like 1e999 is TOML, and no number of a library that reads it.
        let no_number = path.ends_with("partition_attribute_not_finite.toml");
        if breaks(&["S01", "N02"]) || path.ends_with("file_empty.toml") || no_number {
            continue; // the others are no TOML
        }
        let fault = fault_in(&schema, &text);
        if breaks(STRUCTURAL) {
            assert!(fault.is_some(), "{} breaks {rules:?}, and the schema takes it", path.display());
            refused += 1;
        } else if !breaks(&["S07"]) {
            assert_eq!(fault, None, "{} breaks {rules:?} only", path.display());
            taken += 1;
        }
    }
    assert!(refused >= 10 && taken >= 40, "{refused} refused, {taken} taken");
}

#[test]
fn every_unknown_key_is_refused_wherever_it_stands() {
    let text = fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let schema = schema();
    for (old, new) in [
        ("[module.fcu]", "[module.fcu]\ncolour = 1"),
        ("[schedule.flight]", "[schedule.flight]\ncolour = 1"),
        ("offset = \"3.8ms\"", "offset = \"3.8ms\", colour = 1"),
        ("[health]", "[health]\ncolour = 1"),
        ("[health.module]", "[health.module]\ncolour = \"ignore\""),
        ("[partition.imu]", "[partition.imu]\ncolour = 1"),
        ("start = \"cold\"", "start = \"cold\", colour = 1"),
        ("kind = \"sampling\"", "kind = \"sampling\", colour = 1"),
        ("[[channel]]", "[[channel]]\ncolour = 1"),
        ("[[chain]]", "[[chain]]\ncolour = 1"),
        ("[module.fcu]", "[paint]\ncolour = 1\n[module.fcu]"),
    ] {
        assert!(text.contains(old), "schedule.toml no longer has {old:?}: correct this test");
        let fault = fault_in(&schema, &text.replacen(old, new, 1));
        assert!(fault.as_ref().is_some_and(|fault| fault.ends_with("no such key")), "{new}: {fault:?}");
    }
}
