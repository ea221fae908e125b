//! The tables of `docs/src/trusted.md`: the lines of the crates that the daemon is built from, and the crates of other people that it
//! links.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::arrows::{Crates, PAGE as TABLE};
use crate::cargo;
use crate::links::files;

const PAGE: &str = "docs/src/trusted.md";
/// The crate of the program that runs as root.
const DAEMON: &str = "executive/daemon";

/// Crates of other people, each with what it is trusted with.
const OTHERS: &[(&str, &str)] = &[
    ("arrayvec", "of blake3"),
    ("bitflags", "of rustix and landlock"),
    ("blake3", "digests of plans"),
    ("cfg-if", "of several"),
    ("constant_time_eq", "of blake3"),
    ("cpufeatures", "of blake3"),
    ("crc32fast", "checks of the health log's records"),
    ("enumflags2", "of landlock"),
    ("errno", "of signal-hook"),
    ("itoa", "of serde_json"),
    ("landlock", "rules about files of partitions"),
    ("libc", "the kernel's interface"),
    ("linux-raw-sys", "of rustix"),
    ("memchr", "of serde_json"),
    ("rtrb", "the ring from dispatchers to the monitor"),
    ("rustix", "the kernel's interface with types"),
    ("seccompiler", "filters of system calls"),
    ("serde", "values to text and back"),
    ("serde_core", "of serde"),
    ("serde_json", "plans, orders, logs and the control socket"),
    ("signal-hook", "signals to the executive"),
    ("signal-hook-registry", "of signal-hook"),
    ("strsim", "\"did you mean\" in answers to operators"),
    ("thiserror", "texts of errors"),
    ("zmij", "of serde_json"),
];

/// What is wrong with the page, a line each; `write`: it is written as it must be first.
pub(crate) fn check(root: &Path, write: bool) -> Vec<String> {
    let path = root.join(PAGE);
    let page = fs::read_to_string(&path).unwrap_or_default();
    let table = fs::read_to_string(root.join(TABLE)).unwrap_or_default();
    let mut faults = Vec::new();
    let others = others(&linked(), &mut faults);
    let made = [("lines", lines(root, &Crates::of(&table))), ("crates", others)];
    let wanted = made.iter().fold(page.clone(), |page, (name, text)| with(&page, name, text));
    if wanted == page {
        return faults;
    }
    if write {
        faults.extend(fs::write(&path, wanted).err().map(|error| format!("cannot write {PAGE}: {error}")));
    } else {
        faults.push(format!("{PAGE}: its tables are out of date: cargo run -p tasks -- trusted"));
    }
    faults
}

/// A page with `text` in the part that is marked with `name`.
pub(crate) fn with(page: &str, name: &str, text: &str) -> String {
    let (begin, end) = (format!("<!-- made: {name} -->\n"), "<!-- /made -->");
    let parts = page.split_once(&begin).and_then(|(before, rest)| Some((before, rest.split_once(end)?.1)));
    parts.map_or_else(|| page.to_owned(), |(before, after)| format!("{before}{begin}\n{text}\n{end}{after}"))
}

/// The table of the daemon's crates.
fn lines(root: &Path, crates: &Crates<'_>) -> String {
    let mut text = String::from("| crate | lines |\n|---|---|\n");
    let mut sum = 0;
    for folder in crates.below(DAEMON) {
        let count: usize = files(&root.join(folder).join("src"), ".rs")
            .iter()
            .filter(|path| !path.ends_with("tests.rs") && !path.iter().any(|part| part == "tests"))
            .map(|path| code_lines(&fs::read_to_string(path).unwrap_or_default()))
            .sum();
        let rounded = count.next_multiple_of(100);
        sum += rounded;
        text += &format!("| `{folder}` | {rounded} |\n");
    }
    text + &format!("| together | {sum} |\n")
}

/// Lines that are neither empty, nor comments, nor tests at the end of the file.
fn code_lines(text: &str) -> usize {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let is_test =
        |pair: &[&str]| pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod ") && pair[1].ends_with('{');
    let end = lines.windows(2).position(is_test);
    // Tests that stand in a file of their own.
    let end = end.unwrap_or(if lines.contains(&"#[test]") { 0 } else { lines.len() });
    lines[..end].iter().filter(|line| !line.is_empty() && !line.starts_with("//")).count()
}

/// The names of what the daemon links and did not come from this project.
fn linked() -> Vec<String> {
    let mut command = Command::new(cargo());
    command.args(["tree", "--package", "bateleur-daemon", "--edges", "normal,no-proc-macro"]);
    let said = command.args(["--prefix", "none", "--format", "{p}"]).output();
    let text = said.map(|said| String::from_utf8_lossy(&said.stdout).into_owned()).unwrap_or_default();
    let mut names: Vec<String> =
        text.lines().filter_map(|line| Some(line.split(' ').next()?.to_owned())).collect();
    names.retain(|name| !name.starts_with("bateleur"));
    names.sort_unstable();
    names.dedup();
    names
}

/// The table of other people's crates.
fn others(linked: &[String], faults: &mut Vec<String>) -> String {
    for name in linked.iter().filter(|name| !OTHERS.iter().any(|(known, _)| known == name)) {
        faults
            .push(format!("bateleurd links {name}: tasks/src/trusted.rs has to say what it is trusted with"));
    }
    for (name, _) in OTHERS.iter().filter(|(known, _)| !linked.iter().any(|name| name == known)) {
        faults.push(format!("bateleurd does not link {name} any more: remove it from tasks/src/trusted.rs"));
    }
    let mut text = String::from("| crate | trusted with |\n|---|---|\n");
    OTHERS.iter().for_each(|(name, what)| text += &format!("| {name} | {what} |\n"));
    text + &format!("\n{} crates.\n", OTHERS.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_tests_are_no_code() {
        let text = "//! Head.\n\nuse a;\n/// What.\nfn b() {\n    c(); // why\n}\n\n#[cfg(test)]\nmod tests {\n    fn d() {}\n}\n";
        assert_eq!(code_lines(text), 4);
        assert_eq!(code_lines("#[cfg(test)]\nfn helper() {}\nfn a() {}\n"), 3, "one item alone");
        assert_eq!(code_lines("use super::*;\n#[test]\nfn a() {}\n"), 0, "a file of tests");
    }

    #[test]
    fn marked_part_is_replaced_and_the_rest_stays() {
        let page = "a\n<!-- made: x -->\nold\n<!-- /made -->\nb\n<!-- made: y -->\n<!-- /made -->\n";
        assert_eq!(
            with(page, "x", "new\n"),
            "a\n<!-- made: x -->\n\nnew\n\n<!-- /made -->\nb\n<!-- made: y -->\n<!-- /made -->\n"
        );
        assert_eq!(with(page, "z", "new"), page);
    }

    #[test]
    fn crate_that_is_linked_and_not_explained_is_a_fault() {
        let mut names: Vec<String> = OTHERS.iter().map(|(name, _)| (*name).to_owned()).collect();
        names.push("mystery".into());
        let mut faults = Vec::new();
        others(&names, &mut faults);
        assert!(faults.len() == 1 && faults[0].contains("mystery"), "{faults:?}");
    }
}
