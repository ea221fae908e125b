//! From names of a schedule file to names in Rust and cargo: words that mean something else there, dashes, digits.

use std::collections::BTreeSet;

/// Words that can not be names (edition 2024), and those that would confuse a reader.
const KEYWORDS: &[&str] = &[
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "crate", "do", "dyn",
    "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop",
    "macro", "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "return", "self", "static",
    "struct", "super", "trait", "true", "try", "type", "typeof", "union", "unsafe", "unsized", "use",
    "virtual", "where", "while", "yield",
];

/// Names that cargo or the compiler keep for themselves, as a package's.
const RESERVED: &[&str] = &["alloc", "core", "proc-macro", "std", "test"];

/// Folders that cargo makes where it puts programs.
pub(super) const CARGO_FOLDERS: &[&str] = &["build", "deps", "examples", "incremental"];

/// The longest name that is made of another: that of a port, so that a line stays a line.
const LONGEST: usize = 30;

/// Names of one struct: each is given once.
#[derive(Default)]
pub(super) struct Fields(BTreeSet<String>);

impl Fields {
    /// With names that the skeleton itself needs.
    pub(super) fn without(own: &[&str]) -> Self {
        Self(own.iter().map(|name| (*name).to_owned()).collect())
    }

    /// The field for a port or an attribute called `name`; `what` it is stands in it where it can not stand alone.
    pub(super) fn field(&mut self, name: &str, what: &str) -> String {
        let mut plain = snake(name);
        if plain.is_empty() || plain.starts_with(|first: char| first.is_ascii_digit()) {
            plain = format!("{what}_{plain}").trim_end_matches('_').to_owned();
        }
        if KEYWORDS.contains(&plain.as_str()) || self.0.contains(&plain) {
            plain = format!("{plain}_{what}");
        }
        let mut field = plain.clone();
        for number in 2.. {
            if self.0.insert(field.clone()) {
                break;
            }
            field = format!("{plain}_{number}");
        }
        field
    }
}

/// A name in small letters, digits and single underscores.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        let letter = if letter.is_ascii_alphanumeric() { letter.to_ascii_lowercase() } else { '_' };
        if letter != '_' || !(snake.is_empty() || snake.ends_with('_')) {
            snake.push(letter);
        }
    }
    snake.truncate(LONGEST); // letters of one byte
    snake.trim_matches('_').to_owned()
}

/// The type of a partition; none of `taken`.
pub(super) fn type_name(name: &str, taken: &[&str]) -> String {
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let capital = |word: &str| {
        let (first, rest) = word.split_at(1);
        first.to_ascii_uppercase() + rest
    };
    let joined: String = words.map(capital).collect();
    if joined.starts_with(|first: char| first.is_ascii_digit()) {
        return format!("Partition{joined}");
    }
    if joined.is_empty() || joined == "Self" || taken.contains(&joined.as_str()) {
        format!("{joined}Function")
    } else {
        joined
    }
}

/// The name of a package: small letters, digits, dashes.
pub(super) fn package(name: &str, prefix: Option<&str>) -> String {
    let plain = snake(name).replace('_', "-");
    let alone = !plain.is_empty()
        && !plain.starts_with(|first: char| first.is_ascii_digit())
        && !KEYWORDS.contains(&plain.as_str())
        && !RESERVED.contains(&plain.as_str())
        && !CARGO_FOLDERS.contains(&plain.as_str());
    match prefix {
        Some(prefix) => format!("{prefix}-{plain}").trim_end_matches('-').to_owned(),
        None if alone => plain,
        None => format!("partition-{plain}").trim_end_matches('-').to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_names_in_rust_and_each_is_there_once() {
        let mut fields = Fields::without(&["retained"]);
        let named = ["raw", "Raw-Gps", "in", "type", "9th", "retained", "raw_gps", "raw-", "--", "größe"];
        let named: Vec<String> = named.iter().map(|name| fields.field(name, "port")).collect();
        let expected = [
            "raw",
            "raw_gps",
            "in_port",
            "type_port",
            "port_9th",
            "retained_port",
            "raw_gps_port",
            "raw_port",
            "port",
            "gr_e",
        ];
        assert_eq!(named, expected);
        assert_eq!(fields.field("raw", "port"), "raw_port_2");
    }

    #[test]
    fn types_are_in_capitals_and_hide_nothing_that_is_used() {
        let taken = ["Window", "State"];
        let types = ["height_watch", "imu2", "RateGen-2", "window", "state", "self", "9lives", "_"];
        let types: Vec<String> = types.iter().map(|name| type_name(name, &taken)).collect();
        assert_eq!(
            types,
            [
                "HeightWatch",
                "Imu2",
                "RateGen2",
                "WindowFunction",
                "StateFunction",
                "SelfFunction",
                "Partition9lives",
                "Function"
            ]
        );
    }

    #[test]
    fn packages_are_names_for_cargo() {
        let packages = ["height_watch", "IMU", "9lives", "match", "test", "build"];
        let alone: Vec<String> = packages.iter().map(|name| package(name, None)).collect();
        let expected = [
            "height-watch",
            "imu",
            "partition-9lives",
            "partition-match",
            "partition-test",
            "partition-build",
        ];
        assert_eq!(alone, expected);
        assert_eq!(package("9_lives", Some("bateleur")), "bateleur-9-lives");
    }
}
