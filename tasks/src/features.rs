//! Whether programs and tests are built from the same crates.
//!
//! A dependency of tests can ask for a feature of a crate that programs link too. Cargo then builds that crate, and all that is built on
//! it, once for the programs and once more for the tests.

use std::path::Path;
use std::process::Command;

use crate::cargo;

/// What is wrong, a line each.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let of_programs = crates(root, "normal,build");
    let of_tests = crates(root, "normal,build,dev");
    if of_programs.is_empty() {
        return vec!["cargo tree says nothing of this workspace".into()];
    }
    twice(&of_programs, &of_tests)
}

/// Every crate with its features, a line each.
fn crates(root: &Path, edges: &str) -> Vec<String> {
    let mut command = Command::new(cargo());
    command.args(["tree", "--workspace", "--prefix", "none", "--format", "{p} {f}"]);
    let said = command.args(["--edges", edges]).current_dir(root).output();
    let text = said.map(|said| String::from_utf8_lossy(&said.stdout).into_owned()).unwrap_or_default();
    // A crate that was shown before has a mark.
    let shown = |line: &str| line.trim_end_matches("(*)").trim_end().to_owned();
    let mut lines: Vec<String> = text.lines().map(shown).collect();
    lines.sort_unstable();
    lines.dedup();
    lines
}

fn twice(of_programs: &[String], of_tests: &[String]) -> Vec<String> {
    let differ = of_programs.iter().filter(|line| of_tests.binary_search(line).is_err());
    differ
        .map(|line| {
            format!(
                "Cargo.toml: tests build {} with other features than programs do, so it and what is built on it are built twice: \
                 give it the same features in both (programs: \"{line}\")",
                line.split(' ').next().unwrap_or(line)
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crate_that_tests_build_with_more_features_is_named_and_one_of_tests_alone_is_not() {
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
        let of_programs = lines("libc v0.2 std\nrand v0.10 std");
        assert_eq!(twice(&of_programs, &lines("libc v0.2 std\nproptest v1 std\nrand v0.10 std")), [""; 0]);
        let said = twice(&of_programs, &lines("libc v0.2 std\nrand v0.10 std,sys_rng"));
        assert!(said.len() == 1 && said[0].contains("tests build rand with other features"), "{said:?}");
    }
}
