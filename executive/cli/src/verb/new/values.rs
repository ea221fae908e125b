//! Attributes as Rust reads them: the type of a value, and the value as it is written in source.

use bateleur_plan::Attribute;

/// More letters than this, and a default is left empty: the schedule file has the value.
const LONGEST: usize = 40;
/// The most that a tuple may have.
const WIDEST: usize = 12;

/// How an attribute is read.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Reading {
    /// As a duration, in nanoseconds.
    Duration {
        /// What stands in source.
        default: String,
    },
    /// As a value of this type.
    Value {
        /// The type.
        kind: String,
        /// What stands in source.
        default: String,
    },
}

impl Reading {
    pub(super) fn of(value: &Attribute) -> Self {
        if let Attribute::String(text) = value
            && let Some(ns) = duration_ns(text)
        {
            return Self::Duration { default: grouped(&ns.to_string()) };
        }
        let kind = kind(value);
        let whole = literal(value, &kind);
        let default = if whole.len() <= LONGEST { whole } else { empty(&kind) };
        Self::Value { kind, default }
    }

    /// The type of the field.
    pub(super) fn kind(&self) -> &str {
        match self {
            Self::Duration { .. } => "u64",
            Self::Value { kind, .. } => kind,
        }
    }

    pub(super) fn default(&self) -> &str {
        match self {
            Self::Duration { default } | Self::Value { default, .. } => default,
        }
    }

    /// A number that a lint may take for a mistyped constant.
    pub(super) fn looks_like_a_constant(&self) -> bool {
        use std::f64::consts::{E, LN_2, LN_10, LOG2_E, LOG10_E, PI, SQRT_2};
        let known = [
            PI,
            PI * 2.0,
            PI / 2.0,
            PI / 3.0,
            PI / 4.0,
            PI / 6.0,
            PI / 8.0,
            1.0 / PI,
            2.0 / PI,
            E,
            LN_2,
            LN_10,
            LOG2_E,
            LOG10_E,
            SQRT_2,
            1.0 / SQRT_2,
            2.0 / PI.sqrt(),
            1.0 / LOG10_E,
            1.0 / LN_2,
            LN_2 / LN_10,
        ];
        let numbers = self.default().split(['[', ']', ',', ' ', '(', ')', '!']);
        let numbers = numbers.filter(|part| part.contains('.')).filter_map(|part| part.parse::<f64>().ok());
        numbers.map(f64::abs).any(|number| known.iter().any(|constant| (number - constant).abs() < 0.01))
    }
}

/// As the library reads it.
fn duration_ns(text: &str) -> Option<u64> {
    let split = text.find(|letter: char| !letter.is_ascii_digit() && letter != '.')?;
    let known = ["ns", "us", "µs", "ms", "s"].contains(&&text[split..]);
    let plain = text.replace("µs", "us");
    known.then(|| bateleur_plan::units::duration_ns(&plain).ok()).flatten()
}

fn kind(value: &Attribute) -> String {
    match value {
        Attribute::String(_) => "String".into(),
        Attribute::Integer(number) if *number < 0 => "i64".into(),
        Attribute::Integer(_) => "u64".into(),
        Attribute::Float(_) => "f64".into(),
        Attribute::Boolean(_) => "bool".into(),
        Attribute::Array(list) => list_kind(list),
    }
}

/// A list where all values have one type that fits them, else as many types as values.
fn list_kind(list: &[Attribute]) -> String {
    let kinds: Vec<String> = list.iter().map(kind).collect();
    let Some(common) = common(&kinds) else {
        let width = kinds.len().min(WIDEST);
        return format!("({})", kinds[..width].join(", "));
    };
    format!("Vec<{common}>")
}

/// The type that takes values of all these; whole numbers become numbers with a fraction where one has one.
fn common(kinds: &[String]) -> Option<String> {
    let Some(first) = kinds.first() else { return Some("f64".into()) };
    let all = |wanted: &[&str]| kinds.iter().all(|kind| wanted.contains(&kind.as_str()));
    if kinds.iter().all(|kind| kind == first) {
        Some(first.clone())
    } else if all(&["u64", "i64"]) {
        Some("i64".into())
    } else if all(&["u64", "i64", "f64"]) {
        Some("f64".into())
    } else {
        let inner: Option<Vec<String>> =
            kinds.iter().map(|kind| Some(kind.strip_prefix("Vec<")?.strip_suffix('>')?.to_owned())).collect();
        common(&inner?).map(|inner| format!("Vec<{inner}>"))
    }
}

/// A value as source has it, as one of type `kind`.
fn literal(value: &Attribute, kind: &str) -> String {
    match value {
        Attribute::String(text) => format!("{text:?}.to_owned()"),
        Attribute::Integer(number) if kind == "f64" => format!("{:?}", *number as f64),
        Attribute::Integer(number) => grouped(&number.to_string()),
        Attribute::Float(number) if number.is_finite() => format!("{number:?}"),
        Attribute::Float(_) => "0.0".into(),
        Attribute::Boolean(value) => value.to_string(),
        Attribute::Array(list) => match kind.strip_prefix("Vec<").and_then(|rest| rest.strip_suffix('>')) {
            Some(_) if list.is_empty() => "Vec::new()".into(),
            Some(inner) => format!("vec![{}]", joined(list, |_| inner.to_owned())),
            None => format!("({})", joined(&list[..list.len().min(WIDEST)], super::values::kind)),
        },
    }
}

fn joined(list: &[Attribute], kind: impl Fn(&Attribute) -> String) -> String {
    let parts: Vec<String> = list.iter().map(|value| literal(value, &kind(value))).collect();
    parts.join(", ")
}

/// A value of type `kind` that says nothing.
fn empty(kind: &str) -> String {
    match kind {
        "String" => "String::new()".into(),
        kind if kind.starts_with("Vec<") => "Vec::new()".into(),
        _ => "Default::default()".into(),
    }
}

/// Digits in groups of three, where there are more than four.
pub(super) fn grouped(digits: &str) -> String {
    let (sign, digits) = digits.strip_prefix('-').map_or(("", digits), |digits| ("-", digits));
    let mut grouped = String::from(sign);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && digits.len() > 4 && (digits.len() - place).is_multiple_of(3) {
            grouped.push('_');
        }
        grouped.push(digit);
    }
    grouped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(toml: &str) -> (String, String) {
        fn attribute(value: &toml::Value) -> Attribute {
            match value {
                toml::Value::String(text) => Attribute::String(text.clone()),
                toml::Value::Integer(number) => Attribute::Integer(*number),
                toml::Value::Float(number) => Attribute::Float(*number),
                toml::Value::Boolean(value) => Attribute::Boolean(*value),
                toml::Value::Array(list) => Attribute::Array(list.iter().map(attribute).collect()),
                other => panic!("{other} is no attribute"),
            }
        }
        let table: toml::Table = toml::from_str(&format!("a = {toml}")).unwrap();
        let reading = Reading::of(&attribute(&table["a"]));
        (reading.kind().to_owned(), reading.default().to_owned())
    }

    #[test]
    fn each_value_has_the_type_that_the_library_reads() {
        for (value, kind, default) in [
            ("2", "u64", "2"),
            ("-2", "i64", "-2"),
            ("1234567", "u64", "1_234_567"),
            ("50.0", "f64", "50.0"),
            ("nan", "f64", "0.0"),
            ("true", "bool", "true"),
            ("\"20ms\"", "u64", "20_000_000"),
            ("\"1.5s\"", "u64", "1_500_000_000"),
            ("\"5min\"", "String", "\"5min\".to_owned()"),
            ("\"ab\\\"c\"", "String", "\"ab\\\"c\".to_owned()"),
            ("[1, 2.5]", "Vec<f64>", "vec![1.0, 2.5]"),
            ("[1, -2]", "Vec<i64>", "vec![1, -2]"),
            ("[]", "Vec<f64>", "Vec::new()"),
            ("[[1, 2], [2.5]]", "Vec<Vec<f64>>", "vec![vec![1.0, 2.0], vec![2.5]]"),
            ("[\"a\", 1, true]", "(String, u64, bool)", "(\"a\".to_owned(), 1, true)"),
            ("[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]", "Vec<u64>", "Vec::new()"),
        ] {
            assert_eq!(reading(value), (kind.to_owned(), default.to_owned()), "{value}");
        }
    }

    #[test]
    #[allow(clippy::approx_constant)] // that is what they are
    fn numbers_that_a_lint_takes_for_constants_are_known() {
        let value = |number: f64| Reading::of(&Attribute::Float(number)).looks_like_a_constant();
        assert!(value(3.14) && value(-6.28) && value(0.693) && value(1.414) && !value(50.0) && !value(9.81));
        let list = Attribute::Array(vec![Attribute::Float(3.1415), Attribute::Float(1.5)]);
        assert!(Reading::of(&list).looks_like_a_constant());
    }
}
