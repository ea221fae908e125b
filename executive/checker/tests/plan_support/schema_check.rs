//! Holds a JSON schema against a TOML text.
//!
//! It knows the words of JSON schema that the schema of the schedule file uses, and fails on any other. Tests of other
//! packages take it in by its path: it must know nothing of this one.

// Whoever takes it in uses a part of it.
#![allow(dead_code)]

use std::cell::RefCell;
use std::collections::BTreeMap;

use regex::Regex;
use serde_json::{Value, json};

/// Rules about keys, types and words, which the schema has too; those of a number's range it has only in part.
pub(crate) const STRUCTURAL: &[&str] =
    &["S02", "S03", "S04", "S05", "S06", "S08", "S09", "S10", "H01", "H02"];

/// Whether a text is like a pattern. Making one of a pattern's text takes longer than all else here.
fn is_like(text: &str, pattern: &str) -> bool {
    thread_local! {
        static MADE: RefCell<BTreeMap<String, Regex>> = const { RefCell::new(BTreeMap::new()) };
    }
    let make = || Regex::new(pattern).unwrap();
    MADE.with_borrow_mut(|made| made.entry(pattern.to_owned()).or_insert_with(make).is_match(text))
}

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
            let fits = value.as_str().is_none_or(|text| is_like(text, said.as_str().unwrap()));
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

/// The first fault of a text, with the way to it; `None` if it meets the schema.
pub(crate) fn fault_in(schema: &Value, text: &str) -> Option<String> {
    let document: toml::Table = toml::from_str(text).unwrap();
    fault(schema, schema, &serde_json::to_value(document).unwrap(), "")
}
