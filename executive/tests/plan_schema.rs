//! The JSON schema of the schedule file beside the reader: what the reader takes, the schema takes, and what is wrong in
//! its structure, both refuse.
//!
//! The check here knows the words of JSON schema that the schema uses, and fails on any other.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::fs;

use bateleur_executive::plan::schema;
use plan_support::repository;
use serde_json::{Value, json};

/// The first fault of `value`, with the way to it.
fn fault(root: &Value, schema: &Value, value: &Value, at: &str) -> Option<String> {
    let words = schema.as_object().unwrap();
    words.iter().find_map(|(word, said)| match word.as_str() {
        "$schema" | "$defs" | "title" | "description" => None,
        "$ref" => {
            let pointer = said.as_str().unwrap().strip_prefix('#').unwrap();
            fault(root, root.pointer(pointer).expect("a reference leads somewhere"), value, at)
        }
        "type" => {
            let types = said.as_array().cloned().unwrap_or_else(|| vec![said.clone()]);
            let fits = types.iter().any(|one| is_of(value, one.as_str().unwrap()));
            (!fits).then(|| format!("{at}: not of type {said}"))
        }
        "enum" => (!said.as_array().unwrap().contains(value)).then(|| format!("{at}: not one of {said}")),
        "pattern" => {
            let pattern = regex::Regex::new(said.as_str().unwrap()).unwrap();
            let fits = value.as_str().is_none_or(|text| pattern.is_match(text));
            (!fits).then(|| format!("{at}: not like {said}"))
        }
        "minimum" => (value.as_f64() < said.as_f64()).then(|| format!("{at}: below {said}")),
        "maximum" => (value.as_f64() > said.as_f64()).then(|| format!("{at}: above {said}")),
        "anyOf" => {
            let fits = said.as_array().unwrap().iter().any(|one| fault(root, one, value, at).is_none());
            (!fits).then(|| format!("{at}: none of {said}"))
        }
        "items" => {
            let mut items = value.as_array().into_iter().flatten().enumerate();
            items.find_map(|(n, item)| fault(root, said, item, &format!("{at}[{n}]")))
        }
        "required" => {
            let table = value.as_object()?;
            let missing =
                said.as_array().unwrap().iter().find(|key| !table.contains_key(key.as_str().unwrap()))?;
            Some(format!("{at}: no {missing}"))
        }
        "properties" => {
            let mut inner = value.as_object()?.iter();
            inner.find_map(|(key, inner)| fault(root, said.get(key)?, inner, &format!("{at}.{key}")))
        }
        "additionalProperties" => {
            let known = |key: &str| words.get("properties").is_some_and(|known| known.get(key).is_some());
            value.as_object()?.iter().filter(|(key, _)| !known(key)).find_map(|(key, inner)| {
                let at = format!("{at}.{key}");
                if said == &json!(false) {
                    return Some(format!("{at}: no such key"));
                }
                fault(root, said, inner, &at)
            })
        }
        other => panic!("the schema uses `{other}`, which this check does not know"),
    })
}

fn is_of(value: &Value, name: &str) -> bool {
    match name {
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("there is no type `{other}`"),
    }
}

fn fault_in(schema: &Value, text: &str) -> Option<String> {
    let document: toml::Table = toml::from_str(text).unwrap();
    fault(schema, schema, &serde_json::to_value(document).unwrap(), "")
}

#[test]
fn the_flight_schedule_meets_the_schema() {
    let text = fs::read_to_string(repository().join("schedule.toml")).unwrap();
    assert_eq!(fault_in(&schema(), &text), None);
}

#[test]
fn what_the_schema_cannot_see_is_let_through_and_wrong_structure_is_not() {
    // Rules about keys, types and words; those of a number's range only in part.
    let structural = ["S02", "S03", "S04", "S05", "S06", "S08", "H01", "H02"];
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
        if breaks(&["S01", "N02"]) || path.ends_with("file_empty.toml") {
            continue; // the others are no TOML
        }
        let fault = fault_in(&schema, &text);
        if breaks(&structural) {
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
