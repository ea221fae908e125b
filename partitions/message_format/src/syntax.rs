//! The text of one type, line by line.
//!
//! ```text
//! file     = { line }
//! line     = [ field | constant ] [ "#" comment ]
//! field    = type [ "[" COUNT "]" ] name
//! constant = type NAME "=" value
//! type     = bool | byte | char | int8 … uint64 | float32 | float64 | Name | package/Name | package/msg/Name
//! comment  = { "[" UNIT "]" | "[@enum" PREFIX "]" | "[@range …]" | "[@invalid …]" | "[@frame …]" } text
//! ```
//!
//! The comment lines at the head of a file are the type's text. The comment lines directly above a field, and the comment behind it,
//! are the field's. A unit has no space and no comma. `[@enum STATUS]` binds the constants whose names begin with `STATUS_` to the
//! field. `[@range …]`, `[@invalid …]` and `[@frame …]`, which PX4's files have, stay in the text.

use crate::bounds;
use crate::fault::{Reporter, Spot};
use crate::field::FieldKind;
use crate::scalar::Scalar;
use crate::words;

/// The longest unit, characters.
const UNIT: usize = 24;
/// Annotations that are left in the text, for people.
const KEPT: [&str; 3] = ["range", "invalid", "frame"];

/// A named value of a type.
#[derive(Debug, Clone, PartialEq)]
pub struct Constant {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: FieldKind,
    /// Its value, which the kind holds.
    pub value: Scalar,
    /// Its unit; empty: none is given.
    pub unit: String,
    /// What it means.
    pub text: String,
}

/// What stands in a text, before names of other types are looked up.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Definition {
    pub(crate) name: String,
    pub(crate) text: String,
    pub(crate) fields: Vec<FieldLine>,
    pub(crate) constants: Vec<Constant>,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FieldLine {
    pub(crate) name: String,
    pub(crate) of: Reference,
    pub(crate) count: Option<usize>,
    pub(crate) notes: Notes,
    /// Where its type stands.
    pub(crate) at: Spot,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Reference {
    Plain(FieldKind),
    /// Another type, by its name in full.
    Named(String),
}

/// What a comment says.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Notes {
    pub(crate) unit: String,
    pub(crate) choices: Option<String>,
    pub(crate) text: String,
}

/// Reads the text of the type `name`; everything wrong goes to `report`.
pub(crate) fn parse(name: &str, text: &str, report: &mut Reporter<'_>) -> Definition {
    let definition =
        Definition { name: name.to_owned(), text: String::new(), fields: Vec::new(), constants: Vec::new() };
    let mut reader = Reader { definition, above: Vec::new(), at_head: true, report };
    for (number, line) in text.lines().enumerate() {
        reader.line(number + 1, line);
    }
    reader.take_head();
    if reader.definition.fields.is_empty() {
        let at = Spot { line: 1, column: 1 };
        reader.report.add(
            at,
            format!("{name} has no field"),
            "give it one, such as `float64 height  # [m] …`",
        );
    }
    reader.definition
}

struct Reader<'a, 'b> {
    definition: Definition,
    /// Comment lines above what comes next.
    above: Vec<String>,
    /// Nothing but comments has come yet.
    at_head: bool,
    report: &'a mut Reporter<'b>,
}

/// A word and where it begins, in bytes of its line.
type Word<'a> = (usize, &'a str);

impl Reader<'_, '_> {
    fn line(&mut self, number: usize, line: &str) {
        if let Some((place, c)) = line.char_indices().find(|(_, c)| c.is_control() && *c != '\t') {
            let at = spot(number, line, place);
            self.report.add(at, format!("a control character, {c:?}"), "leave it out");
            return;
        }
        let (code, comment) = line.split_once('#').map_or((line, None), |(code, note)| (code, Some(note)));
        match (code.trim().is_empty(), comment) {
            (true, Some(comment)) => self.above.push(plain(comment)),
            (true, None) if self.at_head => self.take_head(),
            (true, None) => self.above.clear(),
            (false, _) => {
                self.take_head();
                let mut comments = std::mem::take(&mut self.above);
                comments.push(plain(comment.unwrap_or_default()));
                self.item(number, line, code, &comments);
            }
        }
    }

    /// What stands at the head of the file is the type's text.
    fn take_head(&mut self) {
        if std::mem::take(&mut self.at_head) {
            self.definition.text = std::mem::take(&mut self.above).join("\n").trim_matches('\n').to_owned();
        }
    }

    fn item(&mut self, number: usize, line: &str, code: &str, comments: &[String]) {
        let at = |word: Word<'_>| spot(number, line, word.0);
        let kind = word(code, 0);
        let rest = word(code, kind.0 + kind.1.len());
        let notes = self.notes(comments, at(kind));
        if rest.1.is_empty() {
            let what = format!("`{}` has no name behind it", kind.1);
            return self.report.add(at(kind), what, "write a type and a name, such as `float64 height`");
        }
        let behind = &code[rest.0..];
        match behind.split_once('=') {
            Some((name, value)) => {
                self.constant(at(kind), kind.1, (at(rest), name.trim(), value.trim()), notes)
            }
            None => {
                let more = word(code, rest.0 + rest.1.len());
                if !more.1.is_empty() {
                    let what = format!("`{}` behind the name `{}`", code[more.0..].trim_end(), rest.1);
                    let mend = "leave it out: a field has no default, every field of a new message is zero";
                    return self.report.add(at(more), what, mend);
                }
                self.field((at(kind), kind.1), (at(rest), rest.1), notes);
            }
        }
    }

    fn field(&mut self, (at, kind): (Spot, &str), (name_at, name): (Spot, &str), notes: Notes) {
        let (base, count) = match kind.split_once('[') {
            None => (kind, None),
            Some((base, count)) => match length(count) {
                Some(count) => (base, Some(count)),
                None => {
                    let what = format!("`{kind}` has no fixed length");
                    let mend = format!(
                        "write how many there are at most, such as `{base}[8]`, and how many count in a field of its own"
                    );
                    return self.report.add(at, what, mend);
                }
            },
        };
        let Some(of) = self.reference(at, base) else { return };
        if !words::is_field(name) || name.len() > bounds::FIELD_NAME_BYTES {
            let mend = "write lower case letters, digits and single underscores, a letter first, at most 60";
            return self.report.add(name_at, format!("`{name}` can not be the name of a field"), mend);
        }
        if words::is_reserved(name) {
            let mend = format!("call it `{name}_value`, for example");
            return self.report.add(name_at, format!("`{name}` is a word of C, C++ or Rust"), mend);
        }
        if self.definition.fields.iter().any(|other| other.name == name) {
            return self.report.add(name_at, format!("there are two fields `{name}`"), "rename one of them");
        }
        if self.definition.fields.len() == bounds::ITEMS {
            let what = format!("more than {} fields", bounds::ITEMS);
            return self.report.add(at, what, "use arrays, or put some into a type of their own");
        }
        self.definition.fields.push(FieldLine { name: name.to_owned(), of, count, notes, at });
    }

    fn reference(&mut self, at: Spot, word: &str) -> Option<Reference> {
        if let Some(kind) = FieldKind::named(word) {
            return Some(Reference::Plain(kind));
        }
        if word.starts_with("string") || word.starts_with("wstring") {
            let mend = "write `uint8[N]`, N bytes of text with zeros behind";
            self.report.add(at, format!("`{word}` has no fixed length"), mend);
            return None;
        }
        let parts: Vec<&str> = word.split('/').collect();
        let named = match parts.as_slice() {
            [name] => words::is_type(name),
            [package, name] | [package, "msg", name] => words::is_field(package) && words::is_type(name),
            _ => false,
        };
        if named {
            let package = words::package_of(&self.definition.name);
            return Some(Reference::Named(words::in_full(word, package)));
        }
        let kinds = FieldKind::ALL.iter().map(|kind| kind.ros2_name());
        let mend = match words::nearest(word, kinds.clone()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("write one of {}, or a type such as `package/Name`", list(kinds)),
        };
        self.report.add(at, format!("there is no type `{word}`"), mend);
        None
    }

    fn constant(&mut self, at: Spot, kind: &str, (name_at, name, value): (Spot, &str, &str), notes: Notes) {
        let Some(kind) = FieldKind::named(kind) else {
            let mend = "constants are numbers: write bool, an int, a uint or a float";
            return self.report.add(at, format!("a constant of type `{kind}`"), mend);
        };
        if !words::is_constant(name) || name.len() > bounds::FIELD_NAME_BYTES {
            let mend = "write upper case letters, digits and single underscores, a letter first, at most 60";
            return self.report.add(name_at, format!("`{name}` can not be the name of a constant"), mend);
        }
        if ["NAME", "FIELDS", "LAYOUT"].contains(&name) {
            let mend = format!("call it `{name}_VALUE`, for example");
            return self.report.add(
                name_at,
                format!("`{name}` is what the made sources call something else"),
                mend,
            );
        }
        if self.definition.constants.iter().any(|other| other.name == name) {
            return self.report.add(
                name_at,
                format!("there are two constants `{name}`"),
                "rename one of them",
            );
        }
        let Some(read) = number(kind, value) else {
            let mend = match kind.range() {
                Some((lowest, highest)) => format!("write a whole number from {lowest} to {highest}"),
                None => "write a number".to_owned(),
            };
            let what = format!("`{value}` is no value of a {}", kind.ros2_name());
            return self.report.add(name_at, what, mend);
        };
        if self.definition.constants.len() == bounds::ITEMS {
            let what = format!("more than {} constants", bounds::ITEMS);
            return self.report.add(at, what, "leave some out");
        }
        let Notes { unit, text, .. } = notes;
        self.definition.constants.push(Constant { name: name.to_owned(), kind, value: read, unit, text });
    }

    /// What the comment lines of an item say together.
    fn notes(&mut self, comments: &[String], at: Spot) -> Notes {
        let (mut notes, mut texts) = (Notes::default(), Vec::new());
        for comment in comments {
            let mut rest = comment.as_str();
            while let Some((inside, behind)) = rest.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
                match inside.strip_prefix('@') {
                    Some(annotation) => texts.extend(self.annotation(annotation, &mut notes, at)),
                    None if notes.unit.is_empty() && is_unit(inside) => notes.unit = inside.to_owned(),
                    None => break,
                }
                rest = behind.trim_start();
            }
            texts.extend((!rest.is_empty()).then(|| rest.to_owned()));
        }
        notes.text = texts.join(" ");
        notes
    }

    /// What is between `[@` and `]`; gives it back where it is for people.
    fn annotation(&mut self, annotation: &str, notes: &mut Notes, at: Spot) -> Option<String> {
        match annotation.split_once(' ').unwrap_or((annotation, "")) {
            ("enum", prefix) if words::is_constant(prefix) && notes.choices.is_none() => {
                notes.choices = Some(prefix.to_owned());
            }
            ("enum", _) => {
                let mend = "write [@enum PREFIX] once: its constants are then called PREFIX_…";
                self.report.add(at, format!("`[@{annotation}]` names no constants"), mend);
            }
            (known, _) if KEPT.contains(&known) => return Some(format!("[@{annotation}]")),
            (unknown, _) => {
                let mend =
                    "there are [UNIT], [@enum PREFIX], and [@range …], [@invalid …], [@frame …] for people";
                self.report.add(at, format!("`[@{unknown} …]` means nothing"), mend);
            }
        }
        None
    }
}

/// Spaces are single, and none stands at an end.
fn plain(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn is_unit(word: &str) -> bool {
    let plain = |c: char| !c.is_whitespace() && !matches!(c, ',' | '[' | '"' | '\\');
    (1..=UNIT).contains(&word.chars().count()) && word.chars().all(plain)
}

/// The word at or after byte `from`; empty at the line's end.
fn word(line: &str, from: usize) -> Word<'_> {
    let rest = &line[from..];
    let start = from + (rest.len() - rest.trim_start().len());
    let end = line[start..].find(char::is_whitespace).map_or(line.len(), |end| start + end);
    (start, &line[start..end])
}

fn spot(line: usize, text: &str, byte: usize) -> Spot {
    Spot { line, column: text[..byte].chars().count() + 1 }
}

/// What stands behind the opening bracket of an array.
fn length(text: &str) -> Option<usize> {
    let digits = text.strip_suffix(']')?;
    let plain = digits.bytes().all(|digit| digit.is_ascii_digit());
    digits.parse().ok().filter(|count| plain && (1..=bounds::MESSAGE_BYTES).contains(count))
}

fn number(kind: FieldKind, text: &str) -> Option<Scalar> {
    let (negative, digits) = text.strip_prefix('-').map_or((false, text), |digits| (true, digits));
    let whole = match (digits, digits.strip_prefix("0x")) {
        ("true" | "True", _) if kind == FieldKind::Bool => Some(1),
        ("false" | "False", _) if kind == FieldKind::Bool => Some(0),
        (_, Some(hex)) => u64::from_str_radix(hex, 16).ok().map(i128::from),
        _ => digits.parse::<u64>().ok().map(i128::from),
    };
    let whole = whole.map(|whole| if negative { -whole } else { whole });
    let value = match kind {
        FieldKind::F32 => Scalar::Single(text.parse().ok().filter(|value: &f32| value.is_finite())?),
        FieldKind::F64 => Scalar::Real(text.parse().ok().filter(|value: &f64| value.is_finite())?),
        _ => Scalar::Whole(whole?),
    };
    // As a message would hold it, so that a bool is one.
    let mut bytes = [0; 8];
    value.write(kind, &mut bytes)?;
    Scalar::read(kind, &bytes)
}

pub(crate) fn list<'a>(words: impl Iterator<Item = &'a str>) -> String {
    words.collect::<Vec<_>>().join(", ")
}
