//! Attributes: the values that a plan gives a partition.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;
use serde_json::Value;

/// Why an attribute can not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AttributeError {
    /// The plan gives a value of another type.
    #[error("attribute {name}: {reason}")]
    Type {
        /// The attribute.
        name: String,
        /// What was expected, and what was found.
        reason: String,
    },
    /// The plan gives attributes that the partition does not know.
    #[error("unknown attribute {name}{hint}")]
    Unknown {
        /// The attribute.
        name: String,
        /// "; did you mean …?" or what there is.
        hint: String,
    },
}

/// The plan's attributes, and which of them were asked for.
#[derive(Debug, Default)]
pub struct Attributes {
    values: BTreeMap<String, Value>,
    asked: BTreeSet<String>,
}

impl Attributes {
    /// Those of one partition: a partition asks its [`crate::Context`], a program without partitions reads a plan.
    pub fn new(values: BTreeMap<String, Value>) -> Self {
        Self { values, asked: BTreeSet::new() }
    }

    /// The plan's value, or `default` where it has none.
    pub fn get<T: DeserializeOwned>(&mut self, name: &str, default: T) -> Result<T, AttributeError> {
        self.asked.insert(name.into());
        let Some(value) = self.values.get(name) else { return Ok(default) };
        serde_json::from_value(value.clone())
            .map_err(|error| wrong_type(name, in_our_words(&error.to_string())))
    }

    /// A duration such as "20ms", as nanoseconds.
    pub fn duration_ns(&mut self, name: &str, default_ns: u64) -> Result<u64, AttributeError> {
        let text: String = match self.values.get(name) {
            None => {
                self.asked.insert(name.into());
                return Ok(default_ns);
            }
            Some(_) => self.get(name, String::new())?,
        };
        let wrong = || format!("expected a duration such as \"20ms\" or \"1.5s\", found the text \"{text}\"");
        parse_duration(&text).ok_or_else(|| wrong_type(name, wrong()))
    }

    /// An error where the plan has an attribute that nobody asked for: most likely a slip of the pen.
    pub fn all_known(&self) -> Result<(), AttributeError> {
        let Some(name) = self.values.keys().find(|name| !self.asked.contains(*name)) else { return Ok(()) };
        let near = self
            .asked
            .iter()
            .map(|known| (strsim::jaro_winkler(known, name), known))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let hint = match near {
            Some((likeness, known)) if likeness > 0.8 => format!("; did you mean {known}?"),
            Some(_) => format!("; known are {}", self.asked.iter().cloned().collect::<Vec<_>>().join(", ")),
            None => "; this partition has none".into(),
        };
        Err(AttributeError::Unknown { name: name.clone(), hint })
    }
}

fn wrong_type(name: &str, reason: String) -> AttributeError {
    AttributeError::Type { name: name.into(), reason }
}

/// The library's "invalid type: string "two", expected u32" as a person who edits a schedule would say it; words of
/// another shape stay as they are.
fn in_our_words(error: &str) -> String {
    let known = ["invalid type: ", "invalid value: "].iter().find_map(|start| error.strip_prefix(start));
    let (known, prefix) = match (known, error.strip_prefix("invalid length ")) {
        (Some(rest), _) => (rest, ""),
        (None, Some(rest)) => (rest, "a list of "),
        (None, None) => return error.to_owned(),
    };
    match known.rsplit_once(", expected ") {
        Some((found, expected)) => {
            format!("expected {}, found {prefix}{}", expectation(expected), finding(found))
        }
        None => error.to_owned(),
    }
}

fn expectation(word: &str) -> String {
    match word {
        "u8" => "a whole number from 0 to 255".into(),
        "u16" => "a whole number from 0 to 65535".into(),
        "u32" | "u64" | "usize" => "a whole number from 0 on".into(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" => "true or false".into(),
        "a string" => "a text".into(),
        "a sequence" => "a list".into(),
        other => match other.strip_prefix("an array of length ") {
            Some(length) => format!("a list of {length}"),
            None => other.into(),
        },
    }
}

fn finding(words: &str) -> String {
    let quoted = words.split_once(' ').map_or("", |(_, quoted)| quoted);
    match words.split(' ').next().unwrap_or_default() {
        "string" => format!("the text {quoted}"),
        "integer" | "boolean" => quoted.trim_matches('`').into(),
        "floating" => quoted.trim_start_matches("point ").trim_matches('`').into(),
        "sequence" => "a list".into(),
        "map" => "a table".into(),
        "null" => "nothing".into(),
        _ => words.into(),
    }
}

/// A duration such as "20ms", "1.5s" or "5min", as nanoseconds; `None`: it is none.
pub fn parse_duration(text: &str) -> Option<u64> {
    let split = text.find(|c: char| !c.is_ascii_digit() && c != '.')?;
    let number: f64 = text[..split].parse().ok()?;
    let unit = match &text[split..] {
        "ns" => 1.0,
        "us" | "µs" => 1e3,
        "ms" => 1e6,
        "s" => 1e9,
        "min" => 6e10,
        _ => return None,
    };
    let ns = (number * unit).round();
    (ns < 1e18).then_some(ns as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attributes(json: &str) -> Attributes {
        Attributes::new(serde_json::from_str(json).unwrap())
    }

    #[test]
    fn a_missing_attribute_takes_its_default_and_a_present_one_its_value() {
        let mut attributes = attributes(r#"{"laps": 3, "sync_period": "20ms"}"#);
        assert_eq!(attributes.get("laps", 2), Ok(3));
        assert_eq!(attributes.get("radius", 90.0), Ok(90.0));
        assert_eq!(attributes.duration_ns("sync_period", 0), Ok(20_000_000));
        assert_eq!(attributes.all_known(), Ok(()));
    }

    #[test]
    fn a_slip_of_the_pen_is_named_with_what_was_meant() {
        let mut attributes = attributes(r#"{"pressure_aidng": true}"#);
        let _ = attributes.get("pressure_aiding", true);
        let error = attributes.all_known().unwrap_err();
        assert_eq!(error.to_string(), "unknown attribute pressure_aidng; did you mean pressure_aiding?");
    }

    #[test]
    fn a_value_of_the_wrong_type_is_shown_with_what_was_expected() {
        let mut attributes = attributes(
            r#"{"laps": "two", "count": -3, "baud": 1.5, "aiding": 1, "device": true, "radius_m": "wide",
                "waypoints": [[1, 2]], "points": [[1, "2"]], "byte": 300, "timeout": "5 parsecs", "wait": 5}"#,
        );
        let said = [
            attributes.get("laps", 2_u32).unwrap_err(),
            attributes.get("count", 2_u32).unwrap_err(),
            attributes.get("baud", 9600_u32).unwrap_err(),
            attributes.get("aiding", true).unwrap_err(),
            attributes.get("device", String::new()).unwrap_err(),
            attributes.get("radius_m", Some(1.0)).unwrap_err(),
            attributes.get("waypoints", Vec::<[f64; 5]>::new()).unwrap_err(),
            attributes.get("points", Vec::<[f64; 2]>::new()).unwrap_err(),
            attributes.get("byte", 1_u8).unwrap_err(),
            attributes.duration_ns("timeout", 1).unwrap_err(),
            attributes.duration_ns("wait", 1).unwrap_err(),
        ];
        let said: Vec<String> = said.iter().map(ToString::to_string).collect();
        assert_eq!(
            said,
            [
                "attribute laps: expected a whole number from 0 on, found the text \"two\"",
                "attribute count: expected a whole number from 0 on, found -3",
                "attribute baud: expected a whole number from 0 on, found 1.5",
                "attribute aiding: expected true or false, found 1",
                "attribute device: expected a text, found true",
                "attribute radius_m: expected a number, found the text \"wide\"",
                "attribute waypoints: expected a list of 5, found a list of 2",
                "attribute points: expected a number, found the text \"2\"",
                "attribute byte: expected a whole number from 0 to 255, found 300",
                "attribute timeout: expected a duration such as \"20ms\" or \"1.5s\", found the text \"5 parsecs\"",
                "attribute wait: expected a text, found 5",
            ]
        );
    }

    #[test]
    fn words_of_another_shape_stay_as_they_are() {
        assert_eq!(in_our_words("missing field `north`"), "missing field `north`");
        assert_eq!(in_our_words("invalid type: null"), "invalid type: null");
    }
}
