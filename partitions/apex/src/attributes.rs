//! Attributes: the values that a plan gives a partition.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;
use serde_json::Value;

/// Why an attribute can not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AttributeError {
    /// The plan gives a value of another type.
    #[error("attribute {name} = {value}: {reason}")]
    Type {
        /// The attribute.
        name: String,
        /// The plan's value.
        value: String,
        /// What was expected.
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
#[derive(Debug)]
pub(crate) struct Attributes {
    values: BTreeMap<String, Value>,
    asked: BTreeSet<String>,
}

impl Attributes {
    pub(crate) fn new(values: BTreeMap<String, Value>) -> Self {
        Self { values, asked: BTreeSet::new() }
    }

    /// The plan's value, or `default` where it has none.
    pub(crate) fn get<T: DeserializeOwned>(&mut self, name: &str, default: T) -> Result<T, AttributeError> {
        self.asked.insert(name.into());
        let Some(value) = self.values.get(name) else { return Ok(default) };
        serde_json::from_value(value.clone()).map_err(|error| self.wrong_type(name, &error.to_string()))
    }

    /// A duration such as "20ms", as nanoseconds.
    pub(crate) fn duration_ns(&mut self, name: &str, default_ns: u64) -> Result<u64, AttributeError> {
        let text: String = match self.values.get(name) {
            None => {
                self.asked.insert(name.into());
                return Ok(default_ns);
            }
            Some(_) => self.get(name, String::new())?,
        };
        parse_duration(&text)
            .ok_or_else(|| self.wrong_type(name, "expected a duration such as \"20ms\" or \"1.5s\""))
    }

    fn wrong_type(&self, name: &str, reason: &str) -> AttributeError {
        let value = self.values.get(name).map(ToString::to_string).unwrap_or_default();
        AttributeError::Type { name: name.into(), value, reason: reason.into() }
    }

    /// An error where the plan has an attribute that nobody asked for: most likely a slip of the pen.
    pub(crate) fn all_known(&self) -> Result<(), AttributeError> {
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

fn parse_duration(text: &str) -> Option<u64> {
    let split = text.find(|c: char| !c.is_ascii_digit() && c != '.')?;
    let number: f64 = text[..split].parse().ok()?;
    let unit = match &text[split..] {
        "ns" => 1.0,
        "us" | "µs" => 1e3,
        "ms" => 1e6,
        "s" => 1e9,
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
    fn a_value_of_the_wrong_type_is_shown() {
        let mut attributes = attributes(r#"{"laps": "two", "timeout": "5 parsecs"}"#);
        assert!(
            attributes.get("laps", 2_u32).unwrap_err().to_string().starts_with("attribute laps = \"two\": ")
        );
        assert!(attributes.duration_ns("timeout", 1).unwrap_err().to_string().contains("such as \"20ms\""));
    }
}
