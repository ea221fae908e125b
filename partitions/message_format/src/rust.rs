//! A type in Rust.

use std::fmt::Write as _;

use crate::field::FieldKind;
use crate::layout::{Body, Member, Type};
use crate::scalar::Scalar;
use crate::words;

/// What the made source calls things that are not its own.
#[derive(Debug, Clone, Copy)]
pub struct Paths<'a> {
    /// This crate.
    pub format: &'a str,
    /// The crate `zerocopy`, as its derives take it: an external crate, or a path that begins with `self` or `super`.
    pub zerocopy: &'a str,
    /// The module that holds the types without a package, and those of the packages below it; empty: this one.
    pub root: &'a str,
}

/// The structure of a type, its constants, and its traits. What `repr(C)` makes of it is compared with the layout when it is compiled.
#[must_use]
pub fn rust(of: &Type, paths: Paths<'_>) -> String {
    let mut out = doc(&of.text);
    let zerocopy = paths.zerocopy;
    let _ = write!(
        out,
        "#[allow(dead_code, unreachable_pub)]\n#[derive(::core::fmt::Debug, ::core::clone::Clone, ::core::marker::Copy, ::core::cmp::PartialEq, {zerocopy}::FromBytes, {zerocopy}::IntoBytes, {zerocopy}::Immutable, \
         {zerocopy}::KnownLayout)]\n#[zerocopy(crate = \"{zerocopy}\")]\n{}{}",
        structure(of, paths.root),
        constants(of)
    );
    let name = own_name(of);
    let _ = write!(
        out,
        "impl ::core::default::Default for {name} {{\n    fn default() -> Self {{\n        <Self as {zerocopy}::FromZeros>::new_zeroed()\n    }}\n}}\n\
         impl {format}::Message for {name} {{\n    const NAME: &'static str = {:?};\n    const FIELDS: &'static [{format}::Field] = &[\n",
        of.name,
        format = paths.format,
    );
    for leaf in &of.leaves {
        let _ = writeln!(
            out,
            "        {format}::Field {{ name: {:?}, unit: {:?}, kind: {format}::FieldKind::{}, count: {}, offset: {} }},",
            leaf.path,
            leaf.unit,
            leaf.kind.variant(),
            leaf.elements(),
            leaf.offset,
            format = paths.format,
        );
    }
    out + "    ];\n}\n"
}

/// The structure of a type alone, with assertions of its size and of the places of its fields; `root` as in [`Paths::root`].
#[must_use]
pub fn structure(of: &Type, root: &str) -> String {
    let name = own_name(of);
    let mut out = format!("#[repr(C)]\npub struct {name} {{\n");
    for member in &of.members {
        out += &doc(&member_text(member));
        let _ = writeln!(out, "    pub {}: {},", words::rust_name(&member.name), type_of(member, root));
    }
    let _ = write!(
        out,
        "}}\nconst _: () = {{\n    assert!(::core::mem::size_of::<{name}>() == {});\n    assert!(::core::mem::align_of::<{name}>() == {});\n",
        of.size, of.align
    );
    for member in &of.members {
        let field = words::rust_name(&member.name);
        let _ = writeln!(out, "    assert!(::core::mem::offset_of!({name}, {field}) == {});", member.offset);
    }
    out + "};\n"
}

fn constants(of: &Type) -> String {
    if of.constants.is_empty() {
        return String::new();
    }
    // A constant may be close to one of mathematics, or have more digits than its kind.
    let mut out = format!("#[allow(dead_code, unreachable_pub, clippy::all)]\nimpl {} {{\n", own_name(of));
    for constant in &of.constants {
        let text = if constant.text.is_empty() { constant.name.clone() } else { constant.text.clone() };
        out += &doc(&with_unit(&text, &constant.unit));
        let value = match constant.value {
            Scalar::Bool(value) => u8::from(value).to_string(),
            Scalar::Whole(value) => value.to_string(),
            Scalar::Single(value) => format!("{value:?}"),
            Scalar::Real(value) => format!("{value:?}"),
        };
        let _ = writeln!(out, "    pub const {}: {} = {value};", constant.name, constant.kind.rust_name());
    }
    out + "}\n"
}

/// The type's name without its package.
fn own_name(of: &Type) -> &str {
    of.name.split_once('/').map_or(&of.name, |(_, name)| name)
}

fn type_of(member: &Member, root: &str) -> String {
    let one = match &member.body {
        Body::Plain(kind) => FieldKind::rust_name(*kind).to_owned(),
        Body::Nested(nested) => {
            let path = match nested.name.split_once('/') {
                Some((package, name)) => format!("{}::{name}", words::rust_name(package)),
                None => nested.name.clone(),
            };
            if root.is_empty() { path } else { format!("{root}::{path}") }
        }
    };
    member.count.map_or(one.clone(), |count| format!("[{one}; {count}]"))
}

fn member_text(member: &Member) -> String {
    let text = if member.text.is_empty() { format!("`{}`", member.name) } else { member.text.clone() };
    let text = with_unit(&text, &member.unit);
    match &member.choices {
        Some(prefix) => format!("{text} One of the constants `{prefix}_…`."),
        None => text,
    }
}

/// The unit behind the text's first sentence, as people write it.
fn with_unit(text: &str, unit: &str) -> String {
    match text.strip_suffix('.').unwrap_or(text) {
        text if unit.is_empty() => format!("{text}."),
        text => format!("{text} (`{unit}`)."),
    }
}

fn doc(text: &str) -> String {
    // A space as after three slashes, so that no text is a list or a block by its indentation.
    let line = |line: &str| format!("#[doc = {:?}]\n", format!(" {line}"));
    if text.is_empty() { line("A message.") } else { text.lines().map(line).collect() }
}
