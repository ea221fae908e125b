//! Reads an airframe file and says everything that is wrong with it, each flaw at its place.
//!
//! Which keys there are is known from the airframes that are built in: a file for an electric drive has the keys of the
//! Aerosonde's, one for a piston engine those of the Rascal's.

use crate::airframe::Airframe;
use crate::words::nearest;
use std::fmt;
use std::ops::Range;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// Something wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flaw {
    /// Where, in bytes of the text.
    pub span: Range<usize>,
    /// The line where it begins, from 1.
    pub line: usize,
    /// The character in that line, from 1.
    pub column: usize,
    /// What is wrong.
    pub message: String,
    /// How to mend it.
    pub mend: String,
}

impl Flaw {
    /// A flaw at a stretch of `text`.
    pub fn at(text: &str, span: &Range<usize>, message: impl Into<String>, mend: impl Into<String>) -> Self {
        let floor =
            |byte: usize| (0..=byte.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
        let (start, end) = (floor(span.start), floor(span.end).max(floor(span.start)));
        let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            span: start..end,
            line: text[..start].matches('\n').count() + 1,
            column: text[line_start..start].chars().count() + 1,
            message: message.into(),
            mend: mend.into(),
        }
    }
}

impl fmt::Display for Flaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}; {}", self.line, self.column, self.message, self.mend)
    }
}

/// All flaws of one file, in its order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flaws(pub Vec<Flaw>);

impl Flaws {
    /// A line for each, `NAME:LINE:COLUMN: …`, as editors read it.
    pub fn in_file(&self, name: &str) -> String {
        let line =
            |flaw: &Flaw| format!("{name}:{}:{}: {}; {}", flaw.line, flaw.column, flaw.message, flaw.mend);
        self.0.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

impl fmt::Display for Flaws {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for Flaws {}

/// The texts whose keys are known.
const ELECTRIC: &str = include_str!("../../../airframes/aerosonde.toml");
const PISTON: &str = include_str!("../../../airframes/rascal110.toml");

/// Reads an airframe from the text of its file.
///
/// # Errors
/// Everything that is wrong with it.
pub fn read(text: &str) -> Result<Airframe, Flaws> {
    let document = DeTable::parse(text).map_err(|error| Flaws(vec![syntax(text, &error)]))?;
    let mut reader = Reader { text, flaws: Vec::new() };
    reader.check(document.get_ref());
    if !reader.flaws.is_empty() {
        return Err(reader.in_order());
    }
    let airframe: Airframe = toml::from_str(text).map_err(|error| Flaws(vec![syntax(text, &error)]))?;
    for complaint in airframe.complaints() {
        let span = locate(document.get_ref(), complaint.key);
        let message = format!("{} is {}", complaint.key, complaint.value);
        reader.flaws.push(Flaw::at(text, &span, message, format!("it must be {}", complaint.demand)));
    }
    if reader.flaws.is_empty() { Ok(airframe) } else { Err(reader.in_order()) }
}

/// Where a key's value stands in a text, its path joined by dots; the beginning where there is none.
pub fn place_of(text: &str, key: &str) -> Range<usize> {
    DeTable::parse(text).map_or(0..0, |document| locate(document.get_ref(), key))
}

fn syntax(text: &str, error: &toml::de::Error) -> Flaw {
    let words = error.message();
    Flaw::at(
        text,
        &error.span().unwrap_or(0..0),
        format!("this is no TOML: {words}"),
        "see toml.io for what it is",
    )
}

/// The span of the value under a path such as `gear.third_wheel_m[0]`.
fn locate(table: &DeTable<'_>, path: &str) -> Range<usize> {
    let (keys, index) = match path.split_once('[') {
        Some((keys, index)) => (keys, index.trim_end_matches(']').parse::<usize>().ok()),
        None => (path, None),
    };
    let mut keys = keys.split('.');
    let mut value = keys.next().and_then(|key| table.get(key));
    for key in keys {
        value = value.and_then(|value| value.get_ref().as_table()).and_then(|table| table.get(key));
    }
    let Some(value) = value else { return 0..0 };
    match (value.get_ref(), index) {
        (DeValue::Array(items), Some(index)) => items.get(index).map_or(value.span(), Spanned::span),
        _ => value.span(),
    }
}

struct Reader<'t> {
    text: &'t str,
    flaws: Vec<Flaw>,
}

impl Reader<'_> {
    fn flaw(&mut self, span: &Range<usize>, message: String, mend: String) {
        self.flaws.push(Flaw::at(self.text, span, message, mend));
    }

    fn in_order(mut self) -> Flaws {
        self.flaws.sort_by_key(|flaw| flaw.span.start);
        Flaws(self.flaws)
    }

    fn check(&mut self, document: &DeTable<'_>) {
        let kind = document.get("propulsion").and_then(|value| value.get_ref().as_table()?.get("kind"));
        let template = match kind.map(|kind| (kind.span(), kind.get_ref())) {
            Some((_, DeValue::String(kind))) if kind == "piston" => PISTON,
            Some((span, DeValue::String(kind))) if kind != "electric" => {
                let mend = match nearest(kind, ["electric", "piston"].into_iter()) {
                    Some(near) => format!("write \"{near}\""),
                    None => "write \"electric\" for a motor, or \"piston\" for an engine".to_owned(),
                };
                let message =
                    format!("there is no kind of propulsion `{kind}`, only `electric` and `piston`");
                self.flaw(&span, message, mend);
                return;
            }
            _ => ELECTRIC,
        };
        match toml::from_str::<Table>(template) {
            Ok(template) => self.table(document, &template, "the file", &(0..0)),
            Err(error) => self.flaw(
                &(0..0),
                format!("a built-in airframe cannot be read: {error}"),
                "report this".into(),
            ),
        }
    }

    /// Compares a table with the keys of one that is known.
    fn table(&mut self, given: &DeTable<'_>, known: &Table, what: &str, header: &Range<usize>) {
        for (key, value) in given {
            match known.get(key.get_ref().as_ref()) {
                Some(example) => self.value(key.get_ref(), value, example),
                None => {
                    let near = nearest(key.get_ref(), known.keys().map(String::as_str));
                    let all = || known.keys().map(|key| format!("`{key}`")).collect::<Vec<_>>().join(", ");
                    let mend = near.map_or_else(
                        || format!("it has {}", all()),
                        |near| format!("did you mean `{near}`?"),
                    );
                    self.flaw(&key.span(), format!("{what} has no key `{}`", key.get_ref()), mend);
                }
            }
        }
        for (key, example) in known.iter().filter(|(key, _)| !given.contains_key(key.as_str())) {
            let mend = match example {
                Value::Table(_) => format!("add the table `[{key}]`"),
                other => format!("add it, such as `{key} = {other}`"),
            };
            self.flaw(header, format!("{what} has no `{key}`"), mend);
        }
    }

    fn value(&mut self, key: &str, given: &Spanned<DeValue<'_>>, example: &Value) {
        let fits = match (given.get_ref(), example) {
            (DeValue::Table(inner), Value::Table(known)) => {
                let header = given.span();
                return self.table(inner, known, &format!("`[{key}]`"), &header);
            }
            (DeValue::Float(_) | DeValue::Integer(_), Value::Float(_))
            | (DeValue::String(_), Value::String(_)) => true,
            (DeValue::Array(items), Value::Array(known)) => array_fits(items, known),
            _ => false,
        };
        if !fits {
            let message = format!("`{key}` is not {}", kind_of(example));
            self.flaw(&given.span(), message, format!("write it as `{key} = {example}`"));
        }
    }
}

/// Whether the items are of the right kind, and of numbers as many.
fn array_fits(items: &toml::de::DeArray<'_>, known: &[Value]) -> bool {
    let numbers = known.first().is_some_and(Value::is_float);
    let fits = |item: &Spanned<DeValue<'_>>| match item.get_ref() {
        DeValue::Float(_) | DeValue::Integer(_) => numbers,
        DeValue::String(_) => !numbers,
        _ => false,
    };
    items.iter().all(fits) && (!numbers || items.iter().count() == known.len())
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Float(_) => "a number",
        Value::String(_) => "a text in quotes",
        Value::Array(items) if items.first().is_some_and(Value::is_float) => "a list of three numbers",
        Value::Array(_) => "a list of texts",
        _ => "a table",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flaws(text: &str) -> Vec<Flaw> {
        read(text).unwrap_err().0
    }

    /// The Aerosonde's file with one text in place of another, and the line of that.
    fn changed(from: &str, to: &str) -> (Vec<Flaw>, usize) {
        assert!(ELECTRIC.contains(from));
        let line = ELECTRIC[..ELECTRIC.find(from).unwrap()].matches('\n').count() + 1;
        (flaws(&ELECTRIC.replacen(from, to, 1)), line)
    }

    #[test]
    fn misspelt_key_is_told_with_its_place_and_the_right_one() {
        let (found, line) = changed("lift_alpha =", "lift_alfa =");
        assert_eq!(found.len(), 2, "the one is unknown and the other missing: {found:?}");
        let unknown = found.iter().find(|flaw| flaw.message.contains("lift_alfa")).unwrap();
        assert_eq!((unknown.line, unknown.column), (line, 1));
        assert!(unknown.mend.contains("did you mean `lift_alpha`"), "{unknown}");
        assert!(found.iter().any(|flaw| flaw.message == "`[aerodynamics]` has no `lift_alpha`"), "{found:?}");
    }

    #[test]
    fn all_flaws_come_at_once_and_in_the_order_of_the_file() {
        let text = ELECTRIC
            .replace("mass_kg = 11.0", "mass_kg = \"heavy\"")
            .replace("delay_s = 0.02", "delay = 0.02")
            .replace("[-1.0, 0.0, 0.0]", "[-1.0, 0.0]");
        let found = flaws(&text);
        let messages: Vec<&str> = found.iter().map(|flaw| flaw.message.as_str()).collect();
        assert_eq!(messages.len(), 4, "{messages:?}");
        assert_eq!(messages[0], "`mass_kg` is not a number");
        assert!(found.windows(2).all(|pair| pair[0].line <= pair[1].line), "{found:?}");
        assert_eq!(messages[3], "`tail_m` is not a list of three numbers");
    }

    #[test]
    fn senseless_values_are_told_at_the_value() {
        let (found, line) = changed("pitch_elevator = -0.99", "pitch_elevator = 0.99");
        assert_eq!((found.len(), found[0].line, found[0].column), (1, line, 18), "{found:?}");
        let (found, line) = changed("third_wheel_m = [0.55,", "third_wheel_m = [-0.55,");
        assert_eq!((found[0].line, found[0].column), (line, 18), "{found:?}");
    }

    #[test]
    fn several_senseless_values_are_all_told() {
        let text = ELECTRIC.replace("mass_kg = 11.0", "mass_kg = -1").replace("lag_s = 0.1", "lag_s = -1.0");
        assert_eq!(flaws(&text).len(), 2);
    }

    #[test]
    fn keys_of_the_other_drive_are_unknown() {
        let found = flaws(&PISTON.replace("\"piston\"", "\"electric\""));
        assert!(found.iter().any(|flaw| flaw.message == "`[propulsion]` has no key `power_w`"), "{found:?}");
        let (found, line) = changed("\"electric\"", "\"electrical\"");
        assert_eq!((found.len(), found[0].line), (1, line));
        assert_eq!(found[0].mend, "write \"electric\"");
        let (found, _) = changed("\"electric\"", "\"petrol\"");
        assert!(found[0].mend.contains("\"piston\" for an engine"), "{found:?}");
    }

    #[test]
    fn broken_toml_is_told_at_its_place() {
        let (found, line) = changed("wing_span_m = 2.8956", "wing_span_m = ");
        assert_eq!((found.len(), found[0].line), (1, line), "{found:?}");
        assert!(Flaws(found).in_file("mine.toml").starts_with(&format!("mine.toml:{line}:")));
    }
}
