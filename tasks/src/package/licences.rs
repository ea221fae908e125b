//! What is linked into programs, with the texts of its licences, and as a list that other programs read (CycloneDX).

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Order, read, words_of};

/// A crate of somebody else's.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Crate {
    name: String,
    version: String,
    licence: String,
    repository: String,
}

/// How files begin that hold a licence or a notice.
const FILES: [&str; 6] = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE"];
/// Lines of texts that every Debian machine has: those of Apache-2.0, MPL-2.0, and of the GPL, which some offer as another choice.
const COMMON: [&str; 4] = [
    "TERMS AND CONDITIONS FOR USE, REPRODUCTION, AND DISTRIBUTION",
    "Mozilla Public License Version 2.0",
    "GNU GENERAL PUBLIC LICENSE",
    "GNU LESSER GENERAL PUBLIC LICENSE",
];
/// A text that is longer is the licence itself, and not a notice that names it.
const WHOLE_TEXT: usize = 5_000;

/// The crates of others that are linked into the programs of `crates`, sorted.
pub(super) fn linked(order: &Order<'_>, crates: &[&str]) -> Result<Vec<Crate>, String> {
    let mut tree = Command::new(crate::cargo());
    tree.current_dir(order.root).args(["tree", "--locked", "--edges", "normal", "--prefix", "none"]);
    tree.args(["--format", "{p}|{l}|{r}", "--target", order.processor.target()]);
    tree.args(crates.iter().flat_map(|name| ["--package", name]));
    let found: BTreeSet<Crate> = words_of(&mut tree)?.lines().filter_map(of_line).collect();
    Ok(found.into_iter().collect())
}

/// `None` of a crate of this workspace, which has a path behind its version.
fn of_line(line: &str) -> Option<Crate> {
    // A crate that was shown before has a mark.
    let mut fields = line.trim_end_matches("(*)").trim_end().split('|');
    let (package, licence) = (fields.next()?, fields.next()?);
    let mut words = package.split_whitespace();
    let (name, version) = (words.next()?, words.next()?.strip_prefix('v')?);
    let is_own = words.any(|word| word.starts_with("(/"));
    (!is_own).then(|| Crate {
        name: name.into(),
        version: version.into(),
        licence: licence.replace('/', " OR "),
        repository: fields.next().unwrap_or_default().into(),
    })
}

/// The file `copyright`: every crate, and every text once, with the crates that it is for.
pub(super) fn text(order: &Order<'_>, linked: &[Crate]) -> Result<String, String> {
    let mut text = "Bateleur is under MIT or Apache-2.0, as you like (the text of MIT is below; that of Apache-2.0 is in\n\
                    /usr/share/common-licenses/Apache-2.0, as those of Apache-2.0 and MPL-2.0 of all others here).\n\n\
                    Linked into its programs are the standard library of Rust (MIT or Apache-2.0; Copyright (c) The Rust Project\n\
                    Contributors) and these crates from https://crates.io:\n\n"
        .to_owned();
    for one in linked {
        text += &format!("{} {}: {}; {}\n", one.name, one.version, one.licence, one.repository);
    }
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let own = read(&order.root.join("LICENSE-MIT"))?;
    texts.entry(own.trim().to_owned()).or_default().push("Bateleur".into());
    let sources = sources(order)?;
    for one in linked {
        let name = format!("{}-{}", one.name, one.version);
        let folder = sources.iter().map(|root| root.join(&name)).find(|path| path.is_dir());
        let folder = folder
            .ok_or_else(|| format!("the sources of {name} are not here: `cargo fetch --locked` gets them"))?;
        for file in of_folder(&folder)? {
            texts.entry(file).or_default().push(name.clone());
        }
    }
    for (licence, names) in texts {
        text += &format!("\n{}\n{}:\n\n{licence}\n", "-".repeat(78), names.join(", "));
    }
    Ok(text)
}

/// Where cargo unpacked the crates.
fn sources(order: &Order<'_>) -> Result<Vec<PathBuf>, String> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(Path::new(&std::env::var_os("HOME")?).join(".cargo")));
    let place = home.unwrap_or_else(|| order.root.to_owned()).join("registry/src");
    let read = fs::read_dir(&place).map_err(|error| format!("cannot read {}: {error}", place.display()))?;
    Ok(read.filter_map(|entry| Some(entry.ok()?.path())).collect())
}

/// The texts in a crate's folder that are not on every machine, in one order.
fn of_folder(folder: &Path) -> Result<BTreeSet<String>, String> {
    let cannot = |error| format!("cannot read {}: {error}", folder.display());
    let mut texts = BTreeSet::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        if !path.is_file() || !FILES.iter().any(|beginning| name.starts_with(beginning)) {
            continue;
        }
        let text = String::from_utf8_lossy(&fs::read(&path).map_err(cannot)?).replace('\r', "");
        let is_common = text.len() > WHOLE_TEXT && COMMON.iter().any(|line| text.contains(line));
        if !is_common && !text.trim().is_empty() {
            texts.insert(text.trim().to_owned());
        }
    }
    Ok(texts)
}

/// The list in CycloneDX 1.5.
pub(super) fn cyclone(order: &Order<'_>, name: &str, linked: &[Crate]) -> String {
    let component = |one: &Crate| {
        let (name, version, licence) = (&one.name, &one.version, quoted(&one.licence));
        format!(
            "    {{ \"type\": \"library\", \"bom-ref\": \"pkg:cargo/{name}@{version}\", \"name\": \"{name}\", \"version\": \"{version}\", \
             \"purl\": \"pkg:cargo/{name}@{version}\", \"licenses\": [{{ \"expression\": {licence} }}] }}"
        )
    };
    let components: Vec<String> = linked.iter().map(component).collect();
    format!(
        "{{\n  \"bomFormat\": \"CycloneDX\",\n  \"specVersion\": \"1.5\",\n  \"version\": 1,\n  \"metadata\": {{ \"component\": {{ \"type\": \
         \"application\", \"name\": \"{name}\", \"version\": \"{}\" }} }},\n  \"components\": [\n{}\n  ]\n}}\n",
        order.version,
        components.join(",\n")
    )
}

/// As JSON has text.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_cargos_tree_is_a_crate_of_others_or_none() {
        let one = of_line("itoa v1.0.15|MIT/Apache-2.0|https://github.com/dtolnay/itoa").unwrap();
        assert_eq!((one.name.as_str(), one.version.as_str()), ("itoa", "1.0.15"));
        assert_eq!(one.licence, "MIT OR Apache-2.0");
        assert_eq!(of_line("bateleur-apex v0.1.0 (/a/partitions/apex)|MIT OR Apache-2.0|"), None);
        let made = of_line("serde_derive v1.0.2 (proc-macro)|MIT|https://x").unwrap();
        assert_eq!(made.name, "serde_derive");
        assert_eq!(of_line("serde_derive v1.0.2 (proc-macro)|MIT|https://x (*)"), Some(made));
        assert_eq!(of_line("bateleur-message-macro v0.1.0 (proc-macro) (/a/b)|MIT|"), None);
        assert_eq!(of_line(""), None);
    }
}
