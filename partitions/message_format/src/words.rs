//! Names: of types, fields and constants, and what becomes of them in Rust, C and a log.

/// The package of a type that is called without one.
pub const PACKAGE: &str = "bateleur";

/// Words of C and C++, and macros that compilers define, which no field of a C structure can be called.
const OF_C: &[&str] = &[
    "alignas",
    "alignof",
    "and",
    "and_eq",
    "asm",
    "auto",
    "bitand",
    "bitor",
    "bool",
    "break",
    "case",
    "catch",
    "char",
    "char16_t",
    "char32_t",
    "char8_t",
    "class",
    "co_await",
    "co_return",
    "co_yield",
    "compl",
    "concept",
    "const",
    "const_cast",
    "consteval",
    "constexpr",
    "constinit",
    "continue",
    "decltype",
    "default",
    "delete",
    "do",
    "double",
    "dynamic_cast",
    "else",
    "enum",
    "explicit",
    "export",
    "extern",
    "false",
    "float",
    "for",
    "friend",
    "goto",
    "if",
    "inline",
    "int",
    "linux",
    "long",
    "mutable",
    "namespace",
    "new",
    "noexcept",
    "not",
    "not_eq",
    "nullptr",
    "operator",
    "or",
    "or_eq",
    "private",
    "protected",
    "public",
    "register",
    "reinterpret_cast",
    "requires",
    "restrict",
    "return",
    "short",
    "signed",
    "sizeof",
    "static",
    "static_assert",
    "static_cast",
    "struct",
    "switch",
    "template",
    "this",
    "thread_local",
    "throw",
    "true",
    "try",
    "typedef",
    "typeid",
    "typename",
    "typeof",
    "union",
    "unix",
    "unsigned",
    "using",
    "virtual",
    "void",
    "volatile",
    "wchar_t",
    "while",
    "xor",
    "xor_eq",
];
/// Words of Rust that not even a raw identifier may be.
const NEVER_IN_RUST: &[&str] = &["crate", "self", "super"];
/// Words of Rust that a raw identifier may be, as far as C has not taken them.
const OF_RUST: &[&str] = &[
    "abstract", "as", "async", "await", "become", "box", "dyn", "final", "fn", "gen", "impl", "in", "let",
    "loop", "macro", "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "trait", "type",
    "unsafe", "unsized", "use", "where", "yield",
];

/// A field's or a package's name as Rust writes it.
#[must_use]
pub fn rust_name(name: &str) -> String {
    if OF_RUST.contains(&name) { format!("r#{name}") } else { name.to_owned() }
}

/// The name of a type's schema in a log, as ROS 2 writes it: package, `msg`, name.
#[must_use]
pub fn schema_name(type_name: &str) -> String {
    let (package, name) = type_name.split_once('/').unwrap_or((PACKAGE, type_name));
    format!("{package}/msg/{name}")
}

/// The type behind a schema's name; `None` if it is no such name.
#[must_use]
pub fn type_name_of_schema(schema: &str) -> Option<String> {
    let (package, name) = schema.split_once("/msg/")?;
    Some(if package == PACKAGE { name.to_owned() } else { format!("{package}/{name}") })
}

/// How a reference within `package` (empty: the one without a name) is called in full.
pub(crate) fn in_full(reference: &str, package: &str) -> String {
    let parts: Vec<&str> = reference.split('/').collect();
    match parts.as_slice() {
        [PACKAGE, name] | [PACKAGE, "msg", name] => (*name).to_owned(),
        [package, name] | [package, "msg", name] => format!("{package}/{name}"),
        _ if package.is_empty() => reference.to_owned(),
        _ => format!("{package}/{reference}"),
    }
}

pub(crate) fn package_of(type_name: &str) -> &str {
    type_name.split_once('/').map_or("", |(package, _)| package)
}

/// Whether `name` may be a field: lower case, digits and single underscores, a letter first.
pub(crate) fn is_field(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(plain)
        && !name.ends_with('_')
        && !name.contains("__")
}

/// Whether `name` may be a constant: upper case, digits and single underscores, a letter first.
pub(crate) fn is_constant(name: &str) -> bool {
    !name.chars().any(|c| c.is_ascii_lowercase()) && is_field(&name.to_ascii_lowercase())
}

/// Whether `name` may be a type: letters and digits, a capital first.
pub(crate) fn is_type(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.chars().all(|c| c.is_ascii_alphanumeric())
        && name != "Self"
}

/// Whether `name` is a word of a language that the sources are made in.
pub(crate) fn is_reserved(name: &str) -> bool {
    OF_C.contains(&name) || NEVER_IN_RUST.contains(&name)
}

/// The nearest of `known`, where one is near.
pub(crate) fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let near = known.map(|other| (distance(name, other), other)).min();
    near.filter(|(distance, _)| *distance <= 2 && *distance < name.len()).map(|(_, other)| other)
}

/// Letters to change, add or leave out between two words.
fn distance(one: &str, other: &str) -> usize {
    let mut row: Vec<usize> = (0..=other.len()).collect();
    for (i, a) in one.bytes().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, b) in other.bytes().enumerate() {
            let changed = diagonal + usize::from(!a.eq_ignore_ascii_case(&b));
            diagonal = row[j + 1];
            row[j + 1] = changed.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[other.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_names_go_there_and_back() {
        for (name, schema) in [("State", "bateleur/msg/State"), ("acme/Radar", "acme/msg/Radar")] {
            assert_eq!(schema_name(name), schema);
            assert_eq!(type_name_of_schema(schema).as_deref(), Some(name));
        }
        assert_eq!(type_name_of_schema("Radar"), None);
    }

    #[test]
    fn reference_is_looked_for_in_its_own_package() {
        for (reference, package, full) in [
            ("Point", "", "Point"),
            ("Point", "acme", "acme/Point"),
            ("acme/Point", "other", "acme/Point"),
            ("acme/msg/Point", "", "acme/Point"),
            ("bateleur/State", "acme", "State"),
        ] {
            assert_eq!(in_full(reference, package), full, "{reference} in {package}");
        }
    }

    #[test]
    fn near_word_is_offered_and_a_far_one_is_not() {
        let known = ["float32", "float64", "uint8"];
        assert_eq!(nearest("flaot64", known.into_iter()), Some("float64"));
        assert_eq!(nearest("Position", known.into_iter()), None);
    }
}
