//! Reads TOML tables key by key and notes everything that is wrong on the way.
//!
//! Deserialising stops at the first fault. This reader walks the parsed document instead, so that one look at a
//! file reports every unknown key, missing key and wrong type in it, each at its place.

use std::collections::BTreeMap;
use std::net::{SocketAddr, SocketAddrV4};

use serde_json::{Value, json};
use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use super::catalogue;
use super::closed::Closed;
use super::findings::{Finding, Findings, Key, Span, Under};
use super::model::Attribute;
use super::units::{self, QuantityError};
use bateleur_plan::words::{did_you_mean, listed, nearest};

/// A value with its place in the source.
#[derive(Clone, Debug)]
pub(super) struct At<T> {
    pub(super) value: T,
    pub(super) span: Span,
}

/// What a table says for one key.
#[derive(Clone, Debug)]
pub(super) enum Field<T> {
    /// Nothing, and that is allowed.
    Absent,
    /// Something unusable, which has been reported.
    Broken,
    /// A value.
    Said(At<T>),
}

impl<T> Field<T> {
    /// The value with its place, if there is one.
    pub(super) fn said(&self) -> Option<&At<T>> {
        match self {
            Self::Said(at) => Some(at),
            Self::Absent | Self::Broken => None,
        }
    }

    pub(super) fn is_absent(&self) -> bool {
        matches!(self, Self::Absent)
    }
}

impl<T: Clone> Field<T> {
    /// The value, if there is one.
    pub(super) fn get(&self) -> Option<T> {
        self.said().map(|at| at.value.clone())
    }

    /// The value, or the default if the file says nothing; nothing if it says something unusable.
    pub(super) fn or(&self, default: T) -> Option<T> {
        match self {
            Self::Absent => Some(default),
            Self::Broken => None,
            Self::Said(at) => Some(at.value.clone()),
        }
    }
}

impl<T> Field<Vec<At<T>>> {
    /// The items of a list; none if there is no list.
    pub(super) fn items(&self) -> &[At<T>] {
        self.said().map_or(&[], |list| &list.value)
    }
}

impl Field<Nanoseconds> {
    /// The time, or the default where there is none, ns.
    pub(super) fn ns(&self, default: u64) -> u64 {
        self.said().map_or(default, |at| at.value.0)
    }
}

impl<T: Copy> Field<Word<T>> {
    /// The word, if there is one.
    pub(super) fn word(&self) -> Option<T> {
        self.said().map(|at| at.value.0)
    }
}

/// A value that can be read from TOML. A fault is reported by the reading itself.
pub(super) trait FromToml: Sized {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self>;

    /// The same as a JSON schema: it may let through what the reader refuses, and never the other way round.
    fn schema() -> Value;
}

/// One table on its way to a raw type.
pub(super) struct TableReader<'r, 'i> {
    table: &'r DeTable<'i>,
    /// Where the table begins: its header or its key.
    span: Span,
    /// What the table is, for messages.
    what: String,
    known: Vec<Key>,
    /// Keys that must be there and are not, with an example of each.
    missing: Vec<(&'static str, String)>,
    findings: &'r Findings<'r>,
}

impl<'r, 'i> TableReader<'r, 'i> {
    pub(super) fn new(
        table: &'r DeTable<'i>,
        span: Span,
        what: impl Into<String>,
        findings: &'r Findings<'r>,
    ) -> Self {
        Self { table, span, what: what.into(), known: Vec::new(), missing: Vec::new(), findings }
    }

    /// A key that need not be there.
    pub(super) fn optional<T: FromToml>(&mut self, key: &'static str) -> Field<T> {
        let Some((_, value)) = self.entry(key, Under::Value(T::schema)) else { return Field::Absent };
        match T::from_toml(value, self.findings) {
            Some(read) => Field::Said(At { value: read, span: value.span() }),
            None => Field::Broken,
        }
    }

    /// A key that must be there, with an example of it.
    pub(super) fn required<T: FromToml>(&mut self, key: &'static str, example: &str) -> Field<T> {
        let field = self.optional(key);
        if let Some(known) = self.known.iter_mut().find(|known| known.name == key) {
            known.required = true;
        }
        match field {
            Field::Absent => {
                self.missing.push((key, example.to_owned()));
                Field::Broken
            }
            field => field,
        }
    }

    /// Says something else of all keys that are missing so far.
    pub(super) fn missing_all(&mut self, message: String, mend: String) {
        self.missing.clear();
        self.findings.add(Finding::new(&catalogue::MISSING_KEY, &self.span, message, mend));
    }

    /// The entries of a table under `key`, in the order of the file; none if it is not there or no table.
    pub(super) fn entries(&mut self, key: &'static str) -> Vec<Entry<'r, 'i>> {
        let Some((_, value)) = self.entry(key, Under::Table) else { return Vec::new() };
        table_of(value, self.findings).map(in_order).unwrap_or_default()
    }

    /// The tables of a list under `key`; none if it is not there or no list.
    pub(super) fn tables(&mut self, key: &'static str) -> Vec<(&'r DeTable<'i>, Span)> {
        let Some((_, value)) = self.entry(key, Under::Tables) else { return Vec::new() };
        match value.get_ref() {
            DeValue::Array(array) => {
                array.iter().filter_map(|item| Some((table_of(item, self.findings)?, item.span()))).collect()
            }
            DeValue::Table(table) => {
                let written = self.findings.source(&value.span());
                let (mend, alone) = match written.chars().next() {
                    Some('[') => (format!("write `[{written}]`, in double brackets"), true),
                    Some('{') => (format!("put it in brackets: `{key} = [{{ … }}]`"), true),
                    _ => (format!("write a list of tables: `{key} = [{{ … }}]`"), false),
                };
                wrong_type::<()>("a list", value, mend, self.findings);
                // What was meant is plain, so that nothing follows from it.
                if alone { vec![(table, value.span())] } else { Vec::new() }
            }
            _ => {
                let mend = format!("write a list of tables: `{key} = [{{ … }}]`");
                wrong_type::<()>("a list", value, mend, self.findings);
                Vec::new()
            }
        }
    }

    /// The table under `key` with the place of the key, if it is there.
    pub(super) fn table(&mut self, key: &'static str) -> Option<(&'r DeTable<'i>, Span)> {
        let (span, value) = self.entry(key, Under::Table)?;
        Some((table_of(value, self.findings)?, span))
    }

    /// Whether the table has a key that was not asked for so far.
    pub(super) fn has_unknown_keys(&self) -> bool {
        !self.unknown().is_empty()
    }

    fn unknown(&self) -> Vec<At<String>> {
        let keys = in_order(self.table).into_iter().map(|(key, _)| key);
        keys.filter(|key| !self.known.iter().any(|known| known.name == key.value)).collect()
    }

    /// Reports every key that was never asked for, and every one that is missing.
    pub(super) fn finish(self) {
        self.finish_with(|_| None);
    }

    /// As [`Self::finish`]; for some keys that were never asked for there is a mend of their own.
    pub(super) fn finish_with(self, mend_of: impl Fn(&str) -> Option<String>) {
        let names = || self.known.iter().map(|known| known.name);
        let mut meant = Vec::new();
        for key in self.unknown() {
            let message = format!("{} has no key `{}`", self.what, key.value);
            let near = nearest(&key.value, names());
            meant.extend(near);
            let mend = mend_of(&key.value).or_else(|| match near {
                Some(_) => None,
                None => belongs_to(&key.value, self.findings),
            });
            let mend = mend.unwrap_or_else(|| did_you_mean(&key.value, names()));
            self.findings.add(Finding::new(&catalogue::UNKNOWN_KEY, &key.span, message, mend));
        }
        // A key that is only mistyped is not missing as well.
        for (key, example) in self.missing.iter().filter(|(key, _)| !meant.contains(key)) {
            let message = format!("{} has no `{key}`", self.what);
            let mend = format!("add `{key} = {example}`");
            self.findings.add(Finding::new(&catalogue::MISSING_KEY, &self.span, message, mend));
        }
        self.findings.asked(self.what, self.known);
    }

    fn entry(&mut self, key: &'static str, under: Under) -> Option<(Span, &'r Spanned<DeValue<'i>>)> {
        if !self.known.iter().any(|known| known.name == key) {
            self.known.push(Key { name: key, required: false, under });
        }
        self.table.get_key_value(key).map(|(key, value)| (key.span(), value))
    }
}

/// Where a key belongs that a table does not know; nothing if no other does.
fn belongs_to(key: &str, findings: &Findings<'_>) -> Option<String> {
    let tables = findings.tables_with(key);
    let named = tables.iter().map(|table| match table.starts_with("the ") || table.starts_with('`') {
        true => table.clone(),
        false => format!("a {table}"),
    });
    let named: Vec<String> = named.collect();
    (!named.is_empty()).then(|| format!("it is a key of {}: move it there", named.join(" or of ")))
}

/// A key with its place, and its value.
pub(super) type Entry<'r, 'i> = (At<String>, &'r Spanned<DeValue<'i>>);

/// The entries of a table in the order of the file, which the parser does not keep.
pub(super) fn in_order<'r, 'i>(table: &'r DeTable<'i>) -> Vec<Entry<'r, 'i>> {
    let mut entries: Vec<Entry<'r, 'i>> = table
        .iter()
        .map(|(key, value)| (At { value: key.get_ref().to_string(), span: key.span() }, value))
        .collect();
    entries.sort_by_key(|(key, _)| key.span.start);
    entries
}

/// The value as a table.
pub(super) fn table_of<'r, 'i>(
    value: &'r Spanned<DeValue<'i>>,
    findings: &Findings<'_>,
) -> Option<&'r DeTable<'i>> {
    match value.get_ref() {
        DeValue::Table(table) => Some(table),
        _ => wrong_type("a table", value, "write a table, such as `{ … }`", findings),
    }
}

/// Reports a value of another type than expected.
fn wrong_type<T>(
    expected: &str,
    value: &Spanned<DeValue<'_>>,
    mend: impl Into<String>,
    findings: &Findings<'_>,
) -> Option<T> {
    let message = format!("{expected} belongs here, not {}", article(value.get_ref()));
    findings.add(Finding::new(&catalogue::WRONG_TYPE, &value.span(), message, mend));
    None
}

/// A value as it is written, or the only item of a list; nothing for what has several parts.
fn word<'f>(value: &Spanned<DeValue<'_>>, findings: &Findings<'f>) -> Option<&'f str> {
    let single = match value.get_ref() {
        DeValue::Table(_) => return None,
        DeValue::Array(items) => match &items[..] {
            [item] if item.get_ref().is_array() || item.get_ref().is_table() => return None,
            [item] => item,
            _ => return None,
        },
        _ => value,
    };
    let written = findings.source(&single.span());
    (!written.is_empty() && !written.contains('\n')).then_some(written)
}

/// A value as it is written, without quotes.
fn bare<'f>(value: &Spanned<DeValue<'_>>, findings: &Findings<'f>) -> &'f str {
    word(value, findings).unwrap_or_default().trim_matches(['"', '\''])
}

fn article(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number with a fraction",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}

impl FromToml for String {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        match value.get_ref() {
            DeValue::String(text) => Some(text.to_string()),
            _ => {
                let mend = match word(value, findings) {
                    Some(text) => format!("write `\"{}\"`", text.trim_matches(['"', '\''])),
                    None => "write one string in quotes".to_owned(),
                };
                wrong_type("a string", value, mend, findings)
            }
        }
    }

    fn schema() -> Value {
        json!({ "type": "string" })
    }
}

impl FromToml for bool {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        match value.get_ref() {
            DeValue::Boolean(said) => Some(*said),
            _ => {
                let mend = match bare(value, findings).to_lowercase().as_str() {
                    "true" | "yes" | "on" | "1" => "write `true`",
                    "false" | "no" | "off" | "0" => "write `false`",
                    _ => "write `true` or `false`",
                };
                wrong_type("true or false", value, mend, findings)
            }
        }
    }

    fn schema() -> Value {
        json!({ "type": "boolean" })
    }
}

fn integer(number: &DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(number.as_str(), number.radix()).ok()
}

impl FromToml for u32 {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let DeValue::Integer(number) = value.get_ref() else {
            let bare = bare(value, findings);
            let mend = match bare.strip_suffix(".0").unwrap_or(bare).parse::<Self>() {
                Ok(number) => format!("write `{number}`"),
                Err(_) => "write a whole number, such as `1`".to_owned(),
            };
            return wrong_type("a whole number", value, mend, findings);
        };
        let read = integer(number).and_then(|number| Self::try_from(number).ok());
        if read.is_none() {
            let fault = if number.as_str().starts_with('-') { "negative" } else { "too large" };
            let (message, mend) = (format!("`{number}` is {fault}"), "write a whole number, zero or above");
            findings.add(Finding::new(&catalogue::OUT_OF_RANGE, &value.span(), message, mend));
        }
        read
    }

    fn schema() -> Value {
        json!({ "type": "integer", "minimum": 0, "maximum": Self::MAX })
    }
}

impl<T: FromToml> FromToml for Vec<At<T>> {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let read = |item: &Spanned<DeValue<'_>>| {
            let value = T::from_toml(item, findings)?;
            Some(At { value, span: item.span() })
        };
        let DeValue::Array(array) = value.get_ref() else {
            let is_item = T::from_toml(value, &findings.aside()).is_some();
            let mend = match word(value, findings).filter(|_| is_item) {
                Some(text) => format!("write `[{text}]`"),
                None => "write a list in brackets: `[…]`".to_owned(),
            };
            return wrong_type("a list", value, mend, findings);
        };
        // Every item is read, so that every fault in the list is reported.
        let items: Vec<Option<At<T>>> = array.iter().map(read).collect();
        items.into_iter().collect()
    }

    fn schema() -> Value {
        json!({ "type": "array", "items": T::schema() })
    }
}

/// A time in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Nanoseconds(pub(super) u64);

impl FromToml for Nanoseconds {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let mend = format!("write a number and {}, such as \"20ms\"", units::TIME_UNITS);
        quantity(value, units::duration_ns, (&catalogue::BAD_DURATION, "time", mend), findings).map(Self)
    }

    fn schema() -> Value {
        json!({ "type": "string", "pattern": units::duration_pattern() })
    }
}

/// A size in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Bytes(pub(super) u64);

impl FromToml for Bytes {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let mend = format!("write a number and {}, such as \"64KiB\"", units::SIZE_UNITS);
        quantity(value, units::size_bytes, (&catalogue::BAD_SIZE, "size", mend), findings).map(Self)
    }

    fn schema() -> Value {
        json!({ "type": "string", "pattern": units::size_pattern() })
    }
}

/// A rate in bits per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Rate(pub(super) u64);

impl FromToml for Rate {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let mend = format!("write a number and {}, such as \"100Mbit/s\"", units::RATE_UNITS);
        quantity(value, units::rate_bits_per_s, (&catalogue::BAD_RATE, "rate", mend), findings).map(Self)
    }

    fn schema() -> Value {
        json!({ "type": "string", "pattern": units::rate_pattern() })
    }
}

/// An address and a port. Names are not looked up: what they stand for may differ from host to host.
impl FromToml for SocketAddr {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        socket("module", "\"10.77.0.1:15300\" or \"[fd00::1]:15300\"", Ok, value, findings)
    }

    fn schema() -> Value {
        json!({ "type": "string", "pattern": "^.+:[0-9]+$" })
    }
}

/// Where a service access point is reached: SAP_ADDRESS has no other form.
impl FromToml for SocketAddrV4 {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let of_version_4 = |address| match address {
            SocketAddr::V4(address) => Ok(address),
            SocketAddr::V6(_) => Err("it is one of IP version 6"),
        };
        socket("service access point", "\"10.77.0.1:15300\"", of_version_4, value, findings)
    }

    fn schema() -> Value {
        json!({ "type": "string", "pattern": "^[0-9.]+:[0-9]+$" })
    }
}

/// An address of `whose` with its port, which `taken` may refuse with what is wrong.
fn socket<T>(
    whose: &str,
    examples: &str,
    taken: impl FnOnce(SocketAddr) -> Result<T, &'static str>,
    value: &Spanned<DeValue<'_>>,
    findings: &Findings<'_>,
) -> Option<T> {
    let text = String::from_toml(value, findings)?;
    let address = match text.parse::<SocketAddr>() {
        Ok(address) if address.port() == 0 => Err("port 0 is none"),
        Ok(address) if address.ip().is_unspecified() => Err("it stands for every address of a computer"),
        Ok(address) => taken(address),
        Err(_) if text.parse::<std::net::IpAddr>().is_ok() => Err("it has no port"),
        Err(_) => Err("it is not written as one"),
    };
    let note = |fault| {
        let message = format!("`{text}` is no address of a {whose}: {fault}");
        let mend = format!("write the number of the interface and a port, such as {examples}");
        findings.add(Finding::new(&catalogue::BAD_ADDRESS, &value.span(), message, mend));
    };
    address.map_err(note).ok()
}

fn quantity(
    value: &Spanned<DeValue<'_>>,
    read: fn(&str) -> Result<u64, QuantityError>,
    (rule, what, mend): (&'static catalogue::Rule, &str, String),
    findings: &Findings<'_>,
) -> Option<u64> {
    let message = match value.get_ref() {
        DeValue::String(text) => match read(text) {
            Ok(quantity) => return Some(quantity),
            Err(error) => format!("`{text}` is not a {what}: {error}"),
        },
        DeValue::Integer(number) => format!("`{number}` is not a {what}: it has no unit"),
        DeValue::Float(number) => format!("`{number}` is not a {what}: it has no unit"),
        _ => return wrong_type(&format!("a {what} in quotes"), value, mend, findings),
    };
    findings.add(Finding::new(rule, &value.span(), message, mend));
    None
}

/// The members of a closed set as a JSON schema.
pub(super) fn one_of_the_words<T: Closed>() -> Value {
    let names: Vec<&str> = T::ALL.iter().map(|member| member.name()).collect();
    json!({ "enum": names })
}

/// A member of a closed set.
#[derive(Clone, Copy, Debug)]
pub(super) struct Word<T>(pub(super) T);

impl<T: Closed> FromToml for Word<T> {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let text = String::from_toml(value, findings)?;
        let read = T::from_name(&text);
        if read.is_none() {
            let names = || T::ALL.iter().map(|member| member.name());
            let message = format!("`{text}` is no `{}`: it is one of {}", T::WHAT, listed(names()));
            let mend = did_you_mean(&text, names());
            findings.add(Finding::new(&catalogue::UNKNOWN_WORD, &value.span(), message, mend));
        }
        read.map(Self)
    }

    fn schema() -> Value {
        one_of_the_words::<T>()
    }
}

/// Where a partition may do something: everywhere, nowhere, or in the schedules of a list.
#[derive(Clone, Debug)]
pub(super) enum Permission {
    /// In every schedule, or in none.
    Always(bool),
    /// In these.
    In(Vec<At<String>>),
}

impl FromToml for Permission {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        match value.get_ref() {
            DeValue::Boolean(said) => Some(Self::Always(*said)),
            DeValue::Array(_) => Vec::<At<String>>::from_toml(value, findings).map(Self::In),
            _ => {
                let mend = match (value.get_ref(), word(value, findings)) {
                    (DeValue::String(_), Some(text)) => format!("write `[{text}]`"),
                    _ => "write `true`, `false` or a list of schedules in brackets".to_owned(),
                };
                wrong_type("true, false or a list of schedules", value, mend, findings)
            }
        }
    }

    fn schema() -> Value {
        json!({ "anyOf": [bool::schema(), Vec::<At<String>>::schema()] })
    }
}

/// How a partition is replicated.
#[derive(Clone, Debug)]
pub(super) enum Replicas {
    /// So many, all on its module.
    Number(u32),
    /// One on each of these modules.
    On(Vec<At<String>>),
}

impl FromToml for Replicas {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        match value.get_ref() {
            DeValue::Array(_) => Vec::<At<String>>::from_toml(value, findings).map(Self::On),
            DeValue::Integer(_) => u32::from_toml(value, findings).map(Self::Number),
            _ => {
                let mend = "write `3`, or a list of three modules in brackets".to_owned();
                wrong_type("a number or a list of modules", value, mend, findings)
            }
        }
    }

    fn schema() -> Value {
        json!({ "anyOf": [u32::schema(), Vec::<At<String>>::schema()] })
    }
}

/// The free table that a partition is told at its start.
pub(super) type Attributes = BTreeMap<String, Attribute>;

impl FromToml for Attributes {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        let entries = in_order(table_of(value, findings)?).into_iter();
        let read: Vec<_> =
            entries.map(|(key, value)| Some((key.value, Attribute::from_toml(value, findings)?))).collect();
        read.into_iter().collect()
    }

    fn schema() -> Value {
        json!({ "type": "object", "additionalProperties": Attribute::schema() })
    }
}

impl FromToml for Attribute {
    fn from_toml(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<Self> {
        match value.get_ref() {
            DeValue::String(text) => Some(Self::String(text.to_string())),
            DeValue::Boolean(said) => Some(Self::Boolean(*said)),
            DeValue::Integer(number) => {
                integer(number).map(Self::Integer).or_else(|| too_large(value, findings))
            }
            DeValue::Float(number) => match number.as_str().replace('_', "").parse() {
                Ok(read) if f64::is_finite(read) => Some(Self::Float(read)),
                _ => not_finite(number.as_str(), value, findings),
            },
            DeValue::Array(_) => {
                let items = Vec::<At<Self>>::from_toml(value, findings)?;
                Some(Self::Array(items.into_iter().map(|item| item.value).collect()))
            }
            DeValue::Table(_) | DeValue::Datetime(_) => {
                let expected = "a string, a number, true or false, or a list of these";
                wrong_type(expected, value, format!("write {expected}"), findings)
            }
        }
    }

    fn schema() -> Value {
        json!({ "$ref": "#/$defs/attribute" })
    }
}

/// A partition is told its attributes as JSON, which has no such number: it would read nothing at all.
fn not_finite<T>(number: &str, value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<T> {
    let message = format!("`{number}` is no number that a partition can be told");
    let mend = "write a finite number, or leave the attribute out";
    findings.add(Finding::new(&catalogue::OUT_OF_RANGE, &value.span(), message, mend));
    None
}

fn too_large<T>(value: &Spanned<DeValue<'_>>, findings: &Findings<'_>) -> Option<T> {
    let message = "the number does not fit 64 bits";
    findings.add(Finding::new(
        &catalogue::OUT_OF_RANGE,
        &value.span(),
        message,
        "write it in quotes, or smaller",
    ));
    None
}
