//! The text of `src/main.rs`, laid out as `cargo fmt` with this project's settings would.

use std::collections::BTreeSet;
use std::fmt::Write;

use bateleur_plan::Role;

use super::skeleton::{Skeleton, SkeletonAttribute, SkeletonPort};
use super::values::Reading;

/// Letters in a line.
const WIDTH: usize = 110;
/// Reports that one window may make: more would push out the first.
const MOST_REPORTS: usize = 8;

pub(super) fn text(skeleton: &Skeleton) -> String {
    let mut out = head(skeleton);
    out += &imports(skeleton);
    out += &constants(skeleton);
    out += &types(skeleton);
    out += &structure(skeleton);
    let _ = write!(out, "\nimpl Partition for {} {{\n", skeleton.type_name); // a text takes all
    if skeleton.error_handler {
        out += "    const ERROR_HANDLER: bool = true;\n\n";
    }
    out += &start(skeleton);
    out += &take_over(skeleton);
    out += error_handler(skeleton);
    out += &window(skeleton);
    out += "}\n";
    let _ =
        write!(out, "\nfn main() -> ExitCode {{\n    bateleur_apex::run::<{}>()\n}}\n", skeleton.type_name);
    out + &super::test_source::text(skeleton)
}

fn head(skeleton: &Skeleton) -> String {
    let mut out = format!(
        "//! The partition `{}`: say here in a sentence what it is for, and what it must never do.\n//!\n\
         //! `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. Once `window` has\n\
         //! more than a few lines, put what it computes into `src/lib.rs`, which knows no ports and no clock.\n",
        skeleton.partition
    );
    for grant in &skeleton.grants {
        let _ = write!(out, "//!\n//! {grant}\n");
    }
    out + "\n"
}

fn imports(skeleton: &Skeleton) -> String {
    let mut apex: BTreeSet<String> =
        ["Context", "Partition", "StartError", "Window"].iter().map(|name| (*name).to_owned()).collect();
    apex.extend(skeleton.ports.iter().map(|port| port_type(port.role).to_owned()));
    apex.extend(skeleton.retained_bytes.map(|_| "Retained".to_owned()));
    apex.extend(skeleton.standby.then(|| "Takeover".to_owned()));
    if skeleton.error_handler {
        apex.extend(["HealthError", "Response"].map(str::to_owned));
    }
    let mut messages: BTreeSet<String> = skeleton
        .ports
        .iter()
        .filter(|port| matches!(port.content, super::skeleton::Content::Message(_)))
        .map(|port| port.content.type_name())
        .collect();
    if skeleton.has_bytes() {
        messages.extend(["Field", "FieldKind", "Message"].map(str::to_owned));
    }
    let mut out = "use std::process::ExitCode;\n\n".to_owned();
    out += &import("bateleur_apex", &apex);
    out += &import("bateleur_messages", &messages);
    if skeleton.needs_zerocopy() {
        out += "use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};\n";
    }
    out
}

/// One `use`, in as many lines as it takes.
fn import(package: &str, names: &BTreeSet<String>) -> String {
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    match names.as_slice() {
        [] => String::new(),
        [one] => format!("use {package}::{one};\n"),
        several => {
            let line = format!("use {package}::{{{}}};\n", several.join(", "));
            if line.len() <= WIDTH + 1 {
                line
            } else {
                format!("use {package}::{{\n{}}};\n", filled(several))
            }
        }
    }
}

/// Names with commas, in lines as full as they may be.
fn filled(names: &[&str]) -> String {
    let (mut out, mut line) = (String::new(), String::from("   "));
    for name in names {
        if line.len() + name.len() + 2 > WIDTH {
            out += &line;
            out.push('\n');
            line = String::from("   ");
        }
        let _ = write!(line, " {name},");
    }
    out + &line + "\n"
}

fn constants(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    for port in &skeleton.ports {
        if let Role::QueuingDestination { depth } = port.role {
            let _ = write!(
                out,
                "\n/// Messages of `{}` that one window takes at most: as many as may wait there.\n\
                 const {}: u32 = {depth};\n",
                port.name,
                depth_of(port)
            );
        }
    }
    if skeleton.ports.iter().any(|port| port.role == Role::QueuingSource) {
        out += "\n/// In one of so many windows a message goes into each queue: a full one helps nobody.\nconst SEND_EVERY: u64 = 50;\n";
    }
    out
}

pub(super) fn depth_of(port: &SkeletonPort) -> String {
    format!("{}_DEPTH", port.field.to_uppercase())
}

fn types(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    for size in skeleton.byte_sizes() {
        let _ = write!(
            out,
            "\n/// Plain bytes: give them a meaning, or a message type of their own.\n\
             #[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]\n#[repr(C)]\n\
             struct Bytes{size}([u8; {size}]);\n\n\
             impl Message for Bytes{size} {{\n    const NAME: &'static str = \"bytes\";\n    \
             const FIELDS: &'static [Field] =\n        &[Field {{ name: \"bytes\", unit: \"\", kind: FieldKind::U8, count: {size}, offset: 0 }}];\n}}\n"
        );
    }
    if skeleton.retained_bytes.is_some() {
        out += "\n/// What the next incarnation finds after a warm restart: plain data, with padding written out as fields.\n\
                #[derive(Debug, Clone, Copy, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]\n#[repr(C)]\n\
                struct Kept {\n    /// Windows so far, of all incarnations.\n    windows: u64,\n}\n";
    }
    out
}

fn structure(skeleton: &Skeleton) -> String {
    let mut out = format!("\nstruct {} {{\n", skeleton.type_name);
    for port in &skeleton.ports {
        let _ = writeln!(out, "    {}: {}<{}>,", port.field, port_type(port.role), port.content.type_name());
    }
    for attribute in &skeleton.attributes {
        if matches!(attribute.reading, Reading::Duration { .. }) {
            let _ = writeln!(out, "    /// Attribute `{}`, ns.", attribute.name.escape_debug());
        } else {
            let _ = writeln!(out, "    /// Attribute `{}`.", attribute.name.escape_debug());
        }
        let _ = writeln!(out, "    {}: {},", attribute.field, attribute.reading.kind());
    }
    if skeleton.retained_bytes.is_some() {
        out += "    retained: Retained<Kept>,\n    kept: Kept,\n";
    }
    out + "    /// Windows of this incarnation.\n    windows: u64,\n}\n"
}

pub(super) fn port_type(role: Role) -> &'static str {
    match role {
        Role::SamplingSource => "SamplingSource",
        Role::SamplingDestination { .. } => "SamplingDestination",
        Role::QueuingSource => "QueuingSource",
        Role::QueuingDestination { .. } => "QueuingDestination",
    }
}

pub(super) fn port_call(role: Role) -> &'static str {
    match role {
        Role::SamplingSource => "sampling_source",
        Role::SamplingDestination { .. } => "sampling_destination",
        Role::QueuingSource => "queuing_source",
        Role::QueuingDestination { .. } => "queuing_destination",
    }
}

fn start(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    if skeleton.attributes.iter().any(|attribute| attribute.reading.looks_like_a_constant()) {
        out += "    #[allow(clippy::approx_constant)] // a value of the schedule file, not of mathematics\n";
    }
    let uses =
        !(skeleton.ports.is_empty() && skeleton.attributes.is_empty() && skeleton.retained_bytes.is_none());
    let context = if uses { "context" } else { "_context" };
    let _ = writeln!(out, "    fn start({context}: &mut Context) -> Result<Self, StartError> {{");
    out += "        // Before the first window, with all the time of `startup_timeout`: here it may allocate, read files and fail. The\n        \
            // text of an error is what the operator reads.\n";
    if skeleton.retained_bytes.is_some() {
        out += "        let mut retained = context.retained::<Kept>()?;\n        \
                // Nothing after a cold start. It comes from an incarnation that failed: believe only what makes sense.\n        \
                let kept = retained.load().unwrap_or_default();\n";
    }
    if !uses {
        return out + "        Ok(Self { windows: 0 })\n    }\n";
    }
    let mut fields: Vec<String> = Vec::new();
    for port in &skeleton.ports {
        fields.push(format!("{}: context.{}({:?})?", port.field, port_call(port.role), port.name));
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
    if !skeleton.attributes.is_empty() {
        out += "        // What stands beside the name of an attribute holds where the schedule file says nothing.\n";
    }
    out += &braced(8, "Ok(Self ", &fields, ")");
    out + "    }\n"
}

fn take_over(skeleton: &Skeleton) -> String {
    if !skeleton.standby {
        return String::new();
    }
    let mut out = "\n    fn take_over(&mut self, _takeover: &Takeover) {\n        \
                   // It stood by until now: what `start` loaded is long out of date.\n"
        .to_owned();
    out += if skeleton.retained_bytes.is_some() {
        "        self.kept = self.retained.load().unwrap_or_default();\n"
    } else {
        "        // Nothing is kept: with `retained` in the schedule file there would be something to load here.\n"
    };
    out + "    }\n"
}

fn error_handler(skeleton: &Skeleton) -> &'static str {
    if !skeleton.error_handler {
        return "";
    }
    "\n    fn error_handler(&mut self, error: &HealthError, window: &Window) -> Response {\n        \
     // An error that the plan leaves to this partition. Another answer ends it: see `Response`.\n        \
     window.report(&format!(\"{:?}: {}\", error.code, error.message));\n        Response::GoOn\n    }\n"
}

fn window(skeleton: &Skeleton) -> String {
    let mut out = "\n    fn window(&mut self, window: &Window) {\n".to_owned();
    out += &first_words(skeleton);
    out += &inputs(skeleton);
    out += "        // Compute here. Nothing may block, and every loop needs a bound; the time is `window.start_ns()` or\n        \
            // `window.now_ns()`, never the system's. `window.report` tells the operator, `window.raise` is a health error.\n        \
            self.windows += 1;\n";
    if skeleton.retained_bytes.is_some() {
        out += "        self.kept.windows += 1;\n";
    }
    out += &outputs(skeleton);
    if skeleton.retained_bytes.is_some() {
        out += "        self.retained.store(&self.kept);\n";
    }
    out + "    }\n"
}

/// What it was told, said once: it shows that it runs, and uses what is not yet used otherwise.
fn first_words(skeleton: &Skeleton) -> String {
    let shown = |attribute: &SkeletonAttribute| {
        let name = attribute.name.replace('{', "{{").replace('}', "}}");
        format!("format!(\"{} = {{:?}}\", self.{})", name.escape_default(), attribute.field)
    };
    let mut shown: Vec<String> = skeleton.attributes.iter().map(shown).collect();
    if skeleton.retained_bytes.is_some() {
        shown.insert(0, "format!(\"{} windows before this one\", self.kept.windows)".to_owned());
    }
    let mut out = "        if self.windows == 0 {\n".to_owned();
    match shown.len() {
        0 => out += "            window.report(\"runs\");\n",
        1..=MOST_REPORTS => {
            shown.iter().for_each(|shown| out += &format!("            window.report(&{shown});\n"));
        }
        _ => {
            out += "            let told = [\n";
            shown.iter().for_each(|shown| out += &format!("                {shown},\n"));
            out += "            ];\n            window.report(&told.join(\", \")); // its first 128 bytes\n";
        }
    }
    out + "        }\n"
}

fn inputs(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    let sampled = |port: &&SkeletonPort| matches!(port.role, Role::SamplingDestination { .. });
    if skeleton.ports.iter().any(|port| sampled(&port)) {
        out += "        // None before the first message, and none once the last is older than the port's `refresh`.\n";
    }
    for port in skeleton.ports.iter().filter(sampled) {
        let _ = writeln!(out, "        let _{0} = self.{0}.read_valid();", port.field);
    }
    for port in skeleton.ports.iter().filter(|port| matches!(port.role, Role::QueuingDestination { .. })) {
        let _ = write!(
            out,
            "        for _ in 0..{} {{\n            let Some(_message) = self.{1}.receive() else {{ break }};\n        }}\n",
            depth_of(port),
            port.field
        );
    }
    out
}

fn outputs(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    for port in skeleton.ports.iter().filter(|port| port.role == Role::SamplingSource) {
        out += &put(8, port, "write");
    }
    let queues: Vec<&SkeletonPort> =
        skeleton.ports.iter().filter(|port| port.role == Role::QueuingSource).collect();
    if !queues.is_empty() {
        out += "        if self.windows.is_multiple_of(SEND_EVERY) {\n            \
                // Anything but `Sent::Queued` means that it was not taken: try again, or let it go. Never wait.\n";
        for port in queues {
            out += &put(12, port, "send");
        }
        out += "        }\n";
    }
    out
}

/// Puts a message with a value for each field into a port.
fn put(indent: usize, port: &SkeletonPort, call: &str) -> String {
    let (field, kind) = (&port.field, port.content.type_name());
    match port.content {
        super::skeleton::Content::Bytes(size) => {
            format!("{:indent$}self.{field}.{call}(&{kind}([0; {size}]));\n", "")
        }
        super::skeleton::Content::Message(_) => {
            braced(indent, &format!("self.{field}.{call}(&{kind} "), &port.content.fields(), ");")
        }
    }
}

/// A structure in braces: in one line where it fits, else a line for each field.
fn braced(indent: usize, before: &str, fields: &[String], after: &str) -> String {
    let one = format!("{:indent$}{before}{{ {} }}{after}\n", "", fields.join(", "));
    if one.len() <= WIDTH + 1 {
        return one;
    }
    let mut out = format!("{:indent$}{before}{{\n", "");
    for field in fields {
        let _ = writeln!(out, "{:indent$}    {field},", "");
    }
    let _ = writeln!(out, "{:indent$}}}{after}", "");
    out
}
