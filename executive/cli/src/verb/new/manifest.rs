//! The text of `Cargo.toml`.

use std::fmt::Write;

use toml::{Table, Value};

use super::skeleton::Skeleton;
use super::workspace::{Home, Workspace};

pub(super) fn text(skeleton: &Skeleton, home: &Home) -> String {
    match home {
        Home::Member(_) => inside(skeleton),
        Home::Alone(library) => outside(skeleton, library),
    }
}

/// What the crate is built on, apart from the library itself.
fn packages(skeleton: &Skeleton) -> Vec<&'static str> {
    let mut packages = vec!["bateleur-apex"];
    packages.extend(skeleton.needs_messages().then_some("bateleur-messages"));
    packages.extend(skeleton.needs_zerocopy().then_some("zerocopy"));
    packages
}

fn inside(skeleton: &Skeleton) -> String {
    let mut out = format!("[package]\nname = \"{}\"\n", skeleton.package);
    for key in ["version", "edition", "rust-version", "license", "publish"] {
        let _ = writeln!(out, "{key}.workspace = true"); // a text takes all
    }
    out += &end_of_package(skeleton);
    for package in packages(skeleton) {
        let _ = writeln!(out, "{package}.workspace = true");
    }
    out + "\n[lints]\nworkspace = true\n"
}

fn end_of_package(skeleton: &Skeleton) -> String {
    format!(
        "description = \"The partition {}.\"\n\n[[bin]]\nname = \"{}\"\npath = \"src/main.rs\"\n\n[dependencies]\n",
        skeleton.partition, skeleton.program
    )
}

fn outside(skeleton: &Skeleton, library: &Workspace) -> String {
    let common = |key: &str, default: &str| {
        let value = library.value(&["workspace", "package", key]).and_then(Value::as_str);
        format!("{key} = {}\n", Value::from(value.unwrap_or(default)))
    };
    let mut out = format!("[package]\nname = \"{}\"\nversion = \"0.1.0\"\n", skeleton.package_alone);
    out += &(common("edition", "2024") + &common("rust-version", "1.89"));
    out += "publish = false\n";
    out += &end_of_package(skeleton);
    for package in packages(skeleton) {
        let there = library.value(&["workspace", "dependencies", package]);
        let _ = writeln!(out, "{package} = {}", dependency(package, there, library));
    }
    out += "\n# A workspace of its own, wherever it lies.\n[workspace]\n";
    out += "\n# As in the library's workspace, so that what is built for one is of use to the other.\n";
    out += &part(library, &["profile"], "profile");
    out += "\n# The library's lints.\n";
    out + &part(library, &["workspace", "lints"], "lints")
}

/// A dependency of the library's workspace as another workspace has to write it.
fn dependency(package: &str, there: Option<&Value>, library: &Workspace) -> Value {
    let path = there.and_then(|there| there.get("path")).and_then(Value::as_str);
    if let Some(path) = path {
        let mut table = Table::new();
        table.insert("path".to_owned(), library.root.join(path).display().to_string().into());
        return Value::Table(table);
    }
    there.cloned().unwrap_or_else(|| Value::from(if package == "zerocopy" { "0.8" } else { "*" }))
}

/// A table of the library's manifest under another name.
fn part(library: &Workspace, path: &[&str], name: &str) -> String {
    let Some(value) = library.value(path) else { return String::new() };
    let mut table = Table::new();
    table.insert(name.to_owned(), value.clone());
    toml::to_string(&table).unwrap_or_default()
}
