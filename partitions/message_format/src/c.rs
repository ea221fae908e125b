//! Types in C: a header for C99 and C++17.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crate::FieldKind;
use crate::layout::{Body, Type};
use crate::scalar::Scalar;
use crate::syntax::Constant;
use crate::words::PACKAGE;

/// A header with `types` and all types within them. `guard` is what keeps it from being read twice, a C identifier.
///
/// A type `package/Name` is the structure `package_Name`, one without a package `bateleur_Name`. Sizes and places of fields are
/// asserted when it is compiled. `…_NAME` and `…_LAYOUT` are what the schedule file and a port's description call them. A program with the
/// library for C tells it both when it begins, so that a port whose type has other fields in the plan is refused.
#[must_use]
pub fn header<'a>(guard: &str, types: impl IntoIterator<Item = &'a Type>) -> String {
    let mut out = format!(
        "/* Made by bateleur from message definitions: change those instead. */\n#ifndef {guard}\n#define {guard}\n\n\
         #include <stddef.h>\n#include <stdint.h>\n"
    );
    let mut told = BTreeSet::new();
    for of in types {
        add(of, &mut out, &mut told);
    }
    // Weak: whoever only decodes messages has no library.
    out.push_str(
        "\n#if defined(__GNUC__) && defined(__ELF__)\n#ifdef __cplusplus\nextern \"C\"\n#endif\n\
         void bateleur_built_with(const char *name, uint32_t layout) __attribute__((weak));\n",
    );
    let _ = writeln!(out, "static void __attribute__((constructor, unused)) {guard}_is_told(void)\n{{");
    out.push_str("    if (!bateleur_built_with) {\n        return;\n    }\n");
    for name in told.iter().map(|name| c_name(name)) {
        let _ = writeln!(out, "    bateleur_built_with({name}_NAME, {name}_LAYOUT);");
    }
    let _ = write!(out, "}}\n#endif\n\n#endif /* {guard} */\n");
    out
}

/// The structure in C of the type with this name: `package_Name`, of one without a package `bateleur_Name`.
#[must_use]
pub fn c_name(of: &str) -> String {
    let (package, name) = of.split_once('/').unwrap_or((PACKAGE, of));
    format!("{package}_{name}")
}

fn add(of: &Type, out: &mut String, told: &mut BTreeSet<String>) {
    if !told.insert(of.name.clone()) {
        return;
    }
    for member in &of.members {
        if let Body::Nested(nested) = &member.body {
            add(nested, out, told);
        }
    }
    let name = c_name(&of.name);
    let _ = write!(out, "\n{}", comment("", &of.text, ""));
    let _ = writeln!(out, "typedef struct {name} {{");
    for member in &of.members {
        let kind = match &member.body {
            Body::Plain(kind) => kind.c_name().to_owned(),
            Body::Nested(nested) => c_name(&nested.name),
        };
        let array = member.count.map_or(String::new(), |count| format!("[{count}]"));
        out.push_str(&comment("    ", &member.text, &member.unit));
        let _ = writeln!(out, "    {kind} {}{array};", member.name);
    }
    let _ = writeln!(out, "}} {name};");
    let _ = writeln!(out, "#define {name}_NAME \"{}\"", of.name);
    let _ = writeln!(out, "#define {name}_LAYOUT UINT32_C({:#010x})", of.layout());
    for constant in &of.constants {
        out.push_str(&comment("", &constant.text, &constant.unit));
        let _ = writeln!(out, "#define {name}_{} {}", constant.name, value(constant));
    }
    // A negative length does not compile: C99 has no static assertion, and C++17 has another one than C11.
    let _ =
        writeln!(out, "typedef char {name}_has_{}_bytes[sizeof({name}) == {} ? 1 : -1];", of.size, of.size);
    for member in &of.members {
        let (field, at) = (&member.name, member.offset);
        let _ = writeln!(
            out,
            "typedef char {name}_{field}_is_at_{at}[offsetof({name}, {field}) == {at} ? 1 : -1];"
        );
    }
}

fn value(constant: &Constant) -> String {
    let unsigned = |value: i128| format!("UINT{}_C({value})", 8 * constant.kind.size());
    match (constant.kind, constant.value) {
        (_, Scalar::Bool(value)) => u8::from(value).to_string(),
        (_, Scalar::Single(value)) => format!("({value:?}f)"),
        (_, Scalar::Real(value)) => format!("({value:?})"),
        (FieldKind::U8 | FieldKind::U16 | FieldKind::U32 | FieldKind::U64, Scalar::Whole(value)) => {
            unsigned(value)
        }
        (kind, Scalar::Whole(value)) => {
            let bits = 8 * kind.size();
            match kind.range() {
                // Its positive counterpart is no number of the type.
                Some((lowest, _)) if value == lowest => format!("(-INT{bits}_C({}) - 1)", -(value + 1)),
                _ if value < 0 => format!("(-INT{bits}_C({}))", -value),
                _ => format!("INT{bits}_C({value})"),
            }
        }
    }
}

fn comment(indent: &str, text: &str, unit: &str) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!("[{unit}] ") };
    let text = format!("{unit}{text}");
    if text.trim().is_empty() {
        return String::new();
    }
    // What would end the comment, or begin one within it; a question mark may begin a trigraph.
    let text = text.trim().replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?");
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    format!("{indent}/* {} */\n", lines.join(&format!("\n{indent} * ")))
}
