//! The package `bateleur-dev`: what partitions of one's own are built with, in C and in Rust.

use std::path::PathBuf;

use super::tree::{Tree, strip};
use super::{Order, licences, read};

/// What a partition in Rust links: these crates and no other of the project, each alone (decision 57).
const CRATES: [&str; 7] =
    ["apex", "contract", "message_format", "message_macro", "messages", "ports", "processes"];
/// Where `bateleur init` looks for them.
const SOURCES: &str = "usr/share/bateleur";
/// What `bateleur init` takes over from there into a project.
const SHARED: [&str; 3] = ["Cargo.lock", "clippy.toml", "rustfmt.toml"];
const CONTROL: &str = "Package: bateleur-dev
Section: devel
Suggests: cargo (>= 1.89), pkg-config
Description: libraries and headers for partitions of Bateleur
 For partitions in C and C++: a header and a library with the services of
 ARINC 653, and the program that writes C structures of message types. For
 partitions in Rust: the sources of the crates that they link, which
 `bateleur init` and `bateleur new` refer to.
";

pub(super) fn lay(order: &Order<'_>, tree: &mut Tree) -> Result<(), String> {
    let library = format!("usr/lib/{}", order.processor.triplet());
    let c = order.root.join("partitions/apex_c");
    tree.copy(&c.join("include/apex.h"), "usr/include/bateleur/apex.h")?;
    let archive = tree.copy(&c_library(order)?, &format!("{library}/libbateleur_apex_c.a"))?;
    strip(order, &archive, "--strip-debug")?;
    let found = read(&c.join("bateleur_apex_c.pc"))?
        .replace("prefix=${pcfiledir}/../..", "prefix=/usr")
        .replace("-I${prefix}/include", "-I${prefix}/include/bateleur")
        .replace("-L${prefix}/lib ", "");
    tree.text(&format!("{library}/pkgconfig/bateleur_apex_c.pc"), &found)?;
    tree.program(order, "message_header", "usr/bin/message_header")?;
    tree.folder(&c.join("examples"), "usr/share/doc/bateleur-dev/examples")?;
    for name in CRATES {
        tree.folder(&order.root.join("partitions").join(name), &format!("{SOURCES}/partitions/{name}"))?;
    }
    tree.text(&format!("{SOURCES}/Cargo.toml"), &manifest(&read(&order.root.join("Cargo.toml"))?)?)?;
    for name in SHARED {
        tree.copy(&order.root.join(name), &format!("{SOURCES}/{name}"))?;
    }
    let linked = licences::linked(order, &["bateleur-apex-c", "bateleur-message-format"])?;
    tree.documents(order, "bateleur-dev", &licences::text(order, &linked)?)?;
    tree.text(
        "usr/share/doc/bateleur-dev/bateleur-dev.cdx.json",
        &licences::cyclone(order, "bateleur-dev", &linked),
    )?;
    tree.control =
        CONTROL.replacen('\n', &format!("\nDepends: bateleur (= {}), libc6-dev\n", order.version), 1);
    Ok(())
}

/// The library for C; cargo keeps it among the parts where it was built for the sake of something else.
fn c_library(order: &Order<'_>) -> Result<PathBuf, String> {
    let places = ["", "deps"].map(|folder| order.programs.join(folder).join("libbateleur_apex_c.a"));
    let found = places.into_iter().find(|path| path.is_file());
    found.ok_or_else(|| {
        format!(
            "there is no libbateleur_apex_c.a in {}: `cargo build --release -p bateleur-apex-c` makes it",
            order.programs.display()
        )
    })
}

/// The workspace's manifest with those members alone that are there.
fn manifest(whole: &str) -> Result<String, String> {
    let wrong = || "Cargo.toml has no list of members".to_owned();
    let (head, rest) = whole.split_once("members = [\n").ok_or_else(wrong)?;
    let (_, rest) = rest.split_once("\n]\n").ok_or_else(wrong)?;
    let members: String = CRATES.iter().map(|name| format!("    \"partitions/{name}\",\n")).collect();
    let rest: String =
        rest.lines().filter(|line| !line.starts_with("exclude = ")).map(|line| format!("{line}\n")).collect();
    Ok(format!("{head}members = [\n{members}]\n{rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manifest_names_the_crates_that_are_there_and_keeps_the_versions() {
        let text = manifest(include_str!("../../../Cargo.toml")).unwrap();
        for name in CRATES {
            assert!(text.contains(&format!("    \"partitions/{name}\",\n")), "{name}: {text}");
        }
        assert!(!text.contains("\"hil/plant\",\n") && !text.contains("exclude = "), "{text}");
        assert!(text.contains("[workspace.dependencies]") && text.contains("zerocopy = "), "{text}");
    }
}
