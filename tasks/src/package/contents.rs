//! The package `bateleur`: what flies, what an administrator edits, the manual.

use std::path::Path;
use std::process::Command;

use super::tree::Tree;
use super::{Order, licences, read, succeed, words_of};

/// The folder of all programs: each looks for the others beside itself, and their names are too common for `/usr/bin`.
const PROGRAMS: &str = "usr/lib/bateleur";
/// Programs with a file of their own.
const FILES: [&str; 7] =
    ["bateleur", "bateleurd", "bateleur_channels", "relay", "can_gateway", "can_board", "simulator"];
/// All partitions of the flight in one file.
const TOGETHER: &str = "bateleur_partitions";
/// The names of that file, in the order of their windows, then those that may replace the simulator's, and the voter of replicas.
const PARTITIONS: [&str; 12] = [
    "rate_generator",
    "hil_interface",
    "gps",
    "imu",
    "estimator",
    "controller",
    "servo",
    "onboard_computer",
    "command",
    "receiver",
    "can_interface",
    "voter",
];
/// Where each shell looks, and what `bateleur completions` calls it.
const SHELLS: [(&str, &str); 3] = [
    ("bash", "usr/share/bash-completion/completions/bateleur"),
    ("zsh", "usr/share/zsh/vendor-completions/_bateleur"),
    ("fish", "usr/share/fish/vendor_completions.d/bateleur.fish"),
];
/// The crates whose programs are in the package, by their names for cargo.
const CRATES: [&str; 8] = [
    "bateleur",
    "bateleur-daemon",
    "bateleur-channels",
    "bateleur-relay",
    "bateleur-can",
    "bateleur-can-board",
    "bateleur-simulator",
    "bateleur-together",
];
const CONTROL: &str = "Package: bateleur
Section: science
Suggests: bateleur-dev
Description: time- and space-partitioned executive and its flight control unit
 Bateleur runs partitions in windows of time and walls of their own, in the
 manner of integrated modular avionics (ARINC 653), on Linux. This package has
 the executive, the partitions of a flight control unit, and the simulated
 aircraft that they fly: `bateleur fly --fast`.
";

pub(super) fn lay(order: &Order<'_>, tree: &mut Tree) -> Result<(), String> {
    for name in FILES.iter().chain(&[TOGETHER]) {
        tree.program(order, name, &format!("{PROGRAMS}/{name}"))?;
    }
    for name in PARTITIONS {
        tree.same(&format!("{PROGRAMS}/{TOGETHER}"), &format!("{PROGRAMS}/{name}"))?;
    }
    tree.link("usr/bin/bateleur", "../lib/bateleur/bateleur")?;
    settings(order, tree)?;
    manual(order, tree)?;
    tree.folder(&order.root.join("docs/src"), "usr/share/doc/bateleur/book")?;
    for (name, text) in [
        ("postinst", include_str!("../../packaging/postinst")),
        ("prerm", include_str!("../../packaging/prerm")),
        ("postrm", include_str!("../../packaging/postrm")),
    ] {
        tree.script(&format!("DEBIAN/{name}"), text)?;
    }
    let linked = licences::linked(order, &CRATES)?;
    tree.documents(order, "bateleur", &licences::text(order, &linked)?)?;
    tree.text("usr/share/doc/bateleur/bateleur.cdx.json", &licences::cyclone(order, "bateleur", &linked))?;
    tree.control = CONTROL.replacen('\n', &format!("\nDepends: {}\n", libraries(order)?), 1);
    Ok(())
}

/// What an upgrade keeps when it was edited.
fn settings(order: &Order<'_>, tree: &Tree) -> Result<(), String> {
    tree.copy(&order.root.join("schedule.toml"), "etc/bateleur/schedule.toml")?;
    for folder in ["schedules", "airframes"] {
        tree.folder(&order.root.join(folder), &format!("etc/bateleur/{folder}"))?;
    }
    let unit = read(&order.root.join("docs/bateleur.service"))?;
    tree.text("lib/systemd/system/bateleur.service", &packaged(&unit)).map(drop)
}

/// The unit of the book, with the folders of the package.
fn packaged(unit: &str) -> String {
    let head = "# A unit for a machine that flies, or tests all day; `systemctl start bateleur` flies /etc/bateleur/schedule.toml. To\n\
                # change it: systemctl edit bateleur. What each line is for stands in the book, \"Running on your machine\".\n\n";
    let body = unit.split_once("[Unit]").map_or(unit, |(_, body)| body);
    let body = body
        .replace("Documentation=file:///opt/bateleur/docs/src/machine.md", "Documentation=man:bateleur(1)");
    let body = body.replace("WorkingDirectory=/opt/bateleur", "WorkingDirectory=/etc/bateleur");
    format!("{head}[Unit]{}", body.replace("/opt/bateleur/", "/usr/bin/"))
}

fn manual(order: &Order<'_>, tree: &Tree) -> Result<(), String> {
    let folder = tree.place("usr/share/man/man1/bateleur.1")?;
    let folder = folder.parent().unwrap_or(Path::new(""));
    succeed(Command::new(order.bateleur).arg("man").arg(folder))?;
    let pages = std::fs::read_dir(folder).map_err(|error| error.to_string())?;
    for page in pages {
        let page = page.map_err(|error| error.to_string())?.path();
        succeed(Command::new("gzip").args(["-9", "--no-name"]).arg(&page))?;
    }
    for (shell, path) in SHELLS {
        tree.text(path, &words_of(Command::new(order.bateleur).args(["completions", shell]))?)?;
    }
    Ok(())
}

/// The C library that the programs ask for, as they name its versions.
fn libraries(order: &Order<'_>) -> Result<String, String> {
    let mut newest = (2, 17);
    for name in FILES.iter().chain(&[TOGETHER]) {
        let path = order.programs.join(name);
        let bytes =
            std::fs::read(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        newest = newest.max(newest_of(&bytes));
    }
    Ok(format!("libc6 (>= {}.{}), libgcc-s1 (>= 4.2)", newest.0, newest.1))
}

fn newest_of(bytes: &[u8]) -> (u32, u32) {
    const MARK: &[u8] = b"GLIBC_";
    let places = bytes.windows(MARK.len()).enumerate().filter(|(_, window)| *window == MARK);
    let version = |at: usize| {
        let rest = &bytes[at + MARK.len()..];
        let end = rest.iter().position(|byte| !(byte.is_ascii_digit() || *byte == b'.'))?;
        let mut numbers = std::str::from_utf8(&rest[..end]).ok()?.split('.').map(str::parse);
        Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
    };
    places.filter_map(|(at, _)| version(at)).max().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_version_of_the_c_library_is_found_among_others() {
        assert_eq!(newest_of(b"\0GLIBC_2.9\0GLIBC_2.34\0GLIBC_2.4\0GLIBC_PRIVATE\0GLIBC_2.3.4\0"), (2, 34));
        assert_eq!(newest_of(b"nothing"), (0, 0));
    }

    #[test]
    fn unit_of_the_package_has_its_folders_and_no_others() {
        let unit = packaged(include_str!("../../../docs/bateleur.service"));
        assert!(unit.contains("\nExecStart=/usr/bin/bateleur run --schedule schedule.toml"), "{unit}");
        assert!(unit.contains("\nWorkingDirectory=/etc/bateleur\n"), "{unit}");
        assert!(!unit.contains("/opt"), "{unit}");
    }
}
