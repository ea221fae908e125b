//! A type as text again: its definition, and the one that a log carries.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crate::catalogue::{Catalogue, Source};
use crate::fault::Faults;
use crate::layout::{Body, Type};
use crate::words;

/// What stands between the definitions of several types, as in a log of ROS 2.
const BETWEEN: &str = "================================================================================";
/// What stands before a type's name below that.
const MESSAGE: &str = "MSG: ";

impl Type {
    /// Its own text: what it is for, its constants, its fields. Reading it gives the same type.
    #[must_use]
    pub fn definition(&self) -> String {
        let mut out = String::new();
        for line in self.text.lines() {
            let _ = writeln!(out, "{}", format!("# {line}").trim_end());
        }
        // Comments at the head belong to the type.
        if !self.text.is_empty() {
            out.push('\n');
        }
        for constant in &self.constants {
            let item = format!("{} {}={}", constant.kind.ros2_name(), constant.name, constant.value);
            line(&mut out, &item, &constant.unit, None, &constant.text);
        }
        for member in &self.members {
            let kind = match &member.body {
                Body::Plain(kind) => kind.ros2_name(),
                Body::Nested(nested) => &nested.name,
            };
            // Within a package, a name alone means one of the same package.
            let outside = !words::package_of(&self.name).is_empty()
                && matches!(member.body, Body::Nested(_))
                && !kind.contains('/');
            let package = if outside { format!("{}/", words::PACKAGE) } else { String::new() };
            let array = member.count.map_or(String::new(), |count| format!("[{count}]"));
            let item = format!("{package}{kind}{array} {}", member.name);
            line(&mut out, &item, &member.unit, member.choices.as_deref(), &member.text);
        }
        out
    }

    /// Its definition, and behind it those of all types within it, as the schema of a log has them.
    #[must_use]
    pub fn schema(&self) -> String {
        let mut out = self.definition();
        let mut told = BTreeSet::new();
        self.add_nested(&mut out, &mut told);
        out
    }

    fn add_nested(&self, out: &mut String, told: &mut BTreeSet<String>) {
        for member in &self.members {
            if let Body::Nested(nested) = &member.body
                && told.insert(nested.name.clone())
            {
                let name = match words::package_of(&nested.name) {
                    "" => format!("{}/{}", words::PACKAGE, nested.name),
                    _ => nested.name.clone(),
                };
                let _ = write!(out, "{BETWEEN}\n{MESSAGE}{name}\n{}", nested.definition());
                nested.add_nested(out, told);
            }
        }
    }

    /// Reads the type `name` from a schema as [`Type::schema`] writes it.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn from_schema(name: &str, schema: &str) -> Result<Type, Faults> {
        let mut sources = vec![Source { name: name.to_owned(), file: name.to_owned(), text: String::new() }];
        let (mut begins, mut room) = (false, crate::bounds::TYPES * crate::bounds::DEPTH);
        for line in schema.lines() {
            if line.len() >= 3 && line.bytes().all(|byte| byte == b'=') {
                begins = true;
                continue;
            }
            if let (true, Some(called)) = (std::mem::take(&mut begins), line.strip_prefix(MESSAGE)) {
                let called = words::in_full(called.trim(), "");
                room = room.saturating_sub(1);
                if room == 0 {
                    break;
                }
                sources.push(Source { file: called.clone(), name: called, text: String::new() });
                continue;
            }
            if let Some(source) = sources.last_mut() {
                source.text.push_str(line);
                source.text.push('\n');
            }
        }
        let catalogue = Catalogue::read(sources)?;
        let missing = || Faults(Vec::new());
        catalogue.find(name).map(|found| Type::clone(found)).ok_or_else(missing)
    }
}

fn line(out: &mut String, item: &str, unit: &str, choices: Option<&str>, text: &str) {
    out.push_str(item);
    let unit = (!unit.is_empty()).then(|| format!("[{unit}]"));
    let choices = choices.map(|prefix| format!("[@enum {prefix}]"));
    let text = (!text.is_empty()).then(|| text.to_owned());
    let notes: Vec<String> = [unit, choices, text].into_iter().flatten().collect();
    if !notes.is_empty() {
        let _ = write!(out, "  # {}", notes.join(" "));
    }
    out.push('\n');
}
