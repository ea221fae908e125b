//! The files of a crate: templates, and what is put into them. Source is laid out as `cargo fmt` with this project's settings would.

use std::collections::BTreeSet;
use std::fmt::Write;

use anyhow::Result;
use bateleur_plan::Role;
use serde::Serialize;

use super::dependencies::Dependencies;
use super::skeleton::{Content, Skeleton, SkeletonAttribute, SkeletonPort};
use super::values::{Reading, grouped};
use crate::templates::{Written, filled};

const MAIN: &str = include_str!("../../../templates/partition/main.rs");
const README: &str = include_str!("../../../templates/partition/README.md");
const MANIFEST: &str = include_str!("../../../templates/partition/Cargo.toml");

/// Letters in a line.
const WIDTH: usize = 110;
/// Reports that one window may make: more would push out the first.
const MOST_REPORTS: usize = 8;
/// Length of a queue that nobody but the test empties.
const TEST_DEPTH: u32 = 8;

/// What the templates take.
#[derive(Serialize)]
struct Values<'a> {
    partition: &'a str,
    program: &'a str,
    type_name: &'a str,
    grants: &'a [String],
    imports: String,
    /// The folder of message types of one's own, as Rust writes it; empty: no port has such a type.
    messages: String,
    ports: Vec<PortText>,
    attributes: Vec<AttributeText>,
    byte_sizes: Vec<usize>,
    /// The bytes that are kept over a warm restart; empty: none.
    kept: String,
    standby: bool,
    error_handler: bool,
    like_a_constant: bool,
    /// Whether there is a queue to send into.
    sends: bool,
    /// Whether there is a sampling port to read.
    samples: bool,
    /// What `start` returns.
    started: String,
    told_alone: Vec<String>,
    told_together: Vec<String>,
    #[serde(flatten)]
    dependencies: &'a Dependencies,
}

#[derive(Serialize)]
struct PortText {
    name: String,
    field: String,
    /// The library's type.
    kind: &'static str,
    r#type: String,
    message: String,
    direction: &'static str,
    depth: u32,
    depth_name: String,
    /// How a message is put into it, a source.
    put: String,
    /// The other end in a test, and where nobody uses it there.
    far_end: String,
    far_end_held: String,
    /// The value that a test sends, and the call; empty for a source.
    value: String,
    sent: &'static str,
    /// The call by which a test takes what was written; empty for a destination.
    taken: &'static str,
}

#[derive(Serialize)]
struct AttributeText {
    shown: String,
    unit: &'static str,
    field: String,
    r#type: String,
    default: String,
}

/// `Cargo.toml`, `README.md` and `src/main.rs`.
pub(super) fn files(skeleton: &Skeleton, dependencies: &Dependencies) -> Result<Vec<Written>> {
    let values = values(skeleton, dependencies);
    Ok(vec![
        ("Cargo.toml", filled(MANIFEST, &values)?),
        ("README.md", filled(README, &values)?),
        ("src/main.rs", filled(MAIN, &values)?),
    ])
}

fn values<'a>(skeleton: &'a Skeleton, dependencies: &'a Dependencies) -> Values<'a> {
    let shown = shown(skeleton);
    let together = shown.len() > MOST_REPORTS;
    let (told_alone, told_together) = if together {
        (Vec::new(), shown)
    } else {
        (
            shown
                .iter()
                .map(|shown| shown.strip_prefix("format!").map_or(shown.clone(), |_| format!("&{shown}")))
                .collect(),
            Vec::new(),
        )
    };
    let has = |role: fn(Role) -> bool| skeleton.ports.iter().any(|port| role(port.role));
    Values {
        partition: &skeleton.partition,
        program: &skeleton.program,
        type_name: &skeleton.type_name,
        grants: &skeleton.grants,
        imports: imports(skeleton),
        messages: skeleton.messages.as_ref().map_or_else(String::new, |folder| format!("{folder:?}")),
        ports: skeleton.ports.iter().map(port).collect(),
        attributes: skeleton.attributes.iter().map(attribute).collect(),
        byte_sizes: skeleton.byte_sizes(),
        kept: skeleton.retained_bytes.map_or_else(String::new, |bytes| grouped(&bytes.to_string())),
        standby: skeleton.standby,
        error_handler: skeleton.error_handler,
        like_a_constant: skeleton
            .attributes
            .iter()
            .any(|attribute| attribute.reading.looks_like_a_constant()),
        sends: has(|role| role == Role::QueuingSource),
        samples: has(|role| matches!(role, Role::SamplingDestination { .. })),
        started: started(skeleton),
        told_alone,
        told_together,
        dependencies,
    }
}

fn port(port: &SkeletonPort) -> PortText {
    let (kind, _) = library_names(port.role);
    let (direction, put, sent, taken) = match port.role {
        Role::SamplingSource => ("source, sampling", put(8, port, "write"), "", "read"),
        Role::SamplingDestination { .. } => ("destination, sampling", String::new(), "write", ""),
        Role::QueuingSource => ("source, queuing", put(12, port, "send"), "", "receive"),
        Role::QueuingDestination { .. } => ("destination, queuing", String::new(), "send", ""),
    };
    let depth = if let Role::QueuingDestination { depth } = port.role { depth } else { 0 };
    let value = match port.content {
        Content::Message { .. } => format!("{}::default()", port.content.type_name()),
        Content::Bytes(size) => format!("Bytes{size}([0; {size}])"),
    };
    PortText {
        name: port.name.clone(),
        field: port.field.clone(),
        kind,
        r#type: port.content.type_name(),
        message: port.content.message_name(),
        direction,
        depth,
        depth_name: format!("{}_DEPTH", port.field.to_uppercase()),
        put,
        far_end: far_end(port, &format!("mut {}", port.field)),
        far_end_held: far_end(port, &format!("_{}", port.field)),
        value: if sent.is_empty() { String::new() } else { value },
        sent,
        taken,
    }
}

fn attribute(attribute: &SkeletonAttribute) -> AttributeText {
    AttributeText {
        shown: attribute.name.escape_debug().to_string(),
        unit: if matches!(attribute.reading, Reading::Duration { .. }) { ", ns" } else { "" },
        field: attribute.field.clone(),
        r#type: attribute.reading.kind().to_owned(),
        default: attribute.reading.default().to_owned(),
    }
}

/// The library's type of a port, and the function that makes one.
fn library_names(role: Role) -> (&'static str, &'static str) {
    match role {
        Role::SamplingSource => ("SamplingSource", "sampling_source"),
        Role::SamplingDestination { .. } => ("SamplingDestination", "sampling_destination"),
        Role::QueuingSource => ("QueuingSource", "queuing_source"),
        Role::QueuingDestination { .. } => ("QueuingDestination", "queuing_destination"),
    }
}

fn imports(skeleton: &Skeleton) -> String {
    let mut apex: BTreeSet<String> =
        ["Context", "Partition", "StartError", "Window"].iter().map(|name| (*name).to_owned()).collect();
    apex.extend(skeleton.ports.iter().map(|port| library_names(port.role).0.to_owned()));
    apex.extend(skeleton.retained_bytes.map(|_| "Retained".to_owned()));
    apex.extend(skeleton.standby.then(|| "Takeover".to_owned()));
    if skeleton.error_handler {
        apex.extend(["HealthError", "Response"].map(str::to_owned));
    }
    let mut messages: BTreeSet<String> = skeleton
        .ports
        .iter()
        .filter(|port| matches!(port.content, Content::Message { own: false, .. }))
        .map(|port| port.content.type_name())
        .collect();
    if skeleton.has_bytes() {
        messages.extend(["Field", "FieldKind", "Message"].map(str::to_owned));
    }
    let mut lines = vec![import("bateleur_apex", &apex)];
    if !messages.is_empty() {
        lines.push(import("bateleur_messages", &messages));
    }
    if skeleton.needs_zerocopy() {
        lines.push("use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};".to_owned());
    }
    lines.join("\n")
}

/// One `use`, in as many lines as it takes.
fn import(package: &str, names: &BTreeSet<String>) -> String {
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    if let [one] = names.as_slice() {
        return format!("use {package}::{one};");
    }
    let line = format!("use {package}::{{{}}};", names.join(", "));
    if line.len() <= WIDTH { line } else { format!("use {package}::{{\n{}}};", in_full_lines(&names)) }
}

/// Names with commas, in lines as full as they may be.
fn in_full_lines(names: &[&str]) -> String {
    let (mut out, mut line) = (String::new(), String::from("   "));
    for name in names {
        if line.len() + name.len() + 2 > WIDTH {
            out += &line;
            out.push('\n');
            line = String::from("   ");
        }
        let _ = write!(line, " {name},"); // a text takes all
    }
    out + &line + "\n"
}

fn started(skeleton: &Skeleton) -> String {
    let mut fields: Vec<String> = Vec::new();
    for port in &skeleton.ports {
        fields.push(format!("{}: context.{}({:?})?", port.field, library_names(port.role).1, port.name));
    }
    for attribute in &skeleton.attributes {
        let call = match attribute.reading {
            Reading::Duration { .. } => "duration_ns",
            Reading::Value { .. } => "attribute",
        };
        let default = attribute.reading.default();
        let (field, name) = (&attribute.field, &attribute.name);
        let one = format!("{field}: context.{call}({name:?}, {default})?");
        // In its line stand 12 blanks and a comma too; a chain that ends with `?` has two letters less than other text.
        fields.push(if one.len() + 13 <= WIDTH - 2 {
            one
        } else {
            format!("{field}: context\n                .{call}({name:?}, {default})?")
        });
    }
    if skeleton.retained_bytes.is_some() {
        fields.extend(["retained".to_owned(), "kept".to_owned()]);
    }
    fields.push("windows: 0".to_owned());
    braced(8, "Ok(Self ", &fields, ")")
}

/// What it was told, said once: it shows that it runs, and uses what is not yet used otherwise.
fn shown(skeleton: &Skeleton) -> Vec<String> {
    let shown = |attribute: &SkeletonAttribute| {
        let name = attribute.name.replace('{', "{{").replace('}', "}}");
        format!("format!(\"{} = {{:?}}\", self.{})", name.escape_default(), attribute.field)
    };
    let mut shown: Vec<String> = skeleton.attributes.iter().map(shown).collect();
    if skeleton.retained_bytes.is_some() {
        shown.insert(0, "format!(\"{} windows before this one\", self.kept.windows)".to_owned());
    }
    if shown.is_empty() { vec!["\"runs\"".to_owned()] } else { shown }
}

/// Puts a message with a value for each field into a port.
fn put(indent: usize, port: &SkeletonPort, call: &str) -> String {
    let (field, kind) = (&port.field, port.content.type_name());
    match port.content {
        Content::Bytes(size) => format!("{:indent$}self.{field}.{call}(&{kind}([0; {size}]));", ""),
        Content::Message { .. } => {
            braced(indent, &format!("self.{field}.{call}(&{kind} "), &port.content.fields(), ");")
        }
    }
}

/// The far end of a port in a test, under a name.
fn far_end(port: &SkeletonPort, name: &str) -> String {
    let more = match port.role {
        Role::SamplingDestination { refresh_ns } => format!(", {}", grouped(&refresh_ns.to_string())),
        Role::QueuingDestination { depth } => format!(", {depth}"),
        Role::QueuingSource => format!(", {TEST_DEPTH}"),
        Role::SamplingSource => String::new(),
    };
    let (make, kind) = (library_names(port.role).1, port.content.type_name());
    let call = format!("harness.{make}::<{kind}>({:?}{more})?;", port.name);
    let line = format!("        let {name} = {call}");
    // Two letters less than elsewhere: so many are left to a chain of calls that ends with `?`.
    if line.len() < WIDTH - 1 { line } else { format!("        let {name} =\n            {call}") }
}

/// A structure in braces: in one line where it fits, else a line for each field.
fn braced(indent: usize, before: &str, fields: &[String], after: &str) -> String {
    let one = format!("{:indent$}{before}{{ {} }}{after}", "", fields.join(", "));
    if one.len() <= WIDTH {
        return one;
    }
    let mut out = format!("{:indent$}{before}{{\n", "");
    for field in fields {
        let _ = writeln!(out, "{:indent$}    {field},", "");
    }
    out + &format!("{:indent$}}}{after}", "")
}
