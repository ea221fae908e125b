//! The page `docs/src/apex.md`: which requirements of ARINC 653 have a test, made from their list and from the tests' names.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::links::files;
use crate::trusted::with;

const LIST: &str = "partitions/processes/tests/requirements.txt";
const PAGE: &str = "docs/src/apex.md";

/// What has become of a requirement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// It has a test.
    Built,
    /// It has none yet.
    Open,
    /// It says nothing about this project.
    Foreign,
}

/// A line of the list.
#[derive(Debug)]
struct Requirement<'l> {
    identifier: String,
    state: State,
    text: &'l str,
    /// Where implementations differ, and what is done here.
    differs: &'l str,
}

/// A group of the list.
#[derive(Debug)]
struct Group<'l> {
    name: &'l str,
    what: &'l str,
    requirements: Vec<Requirement<'l>>,
}

/// What is wrong with list, tests and page, a line each; `write`: the page is written as it must be first.
pub(crate) fn check(root: &Path, write: bool) -> Vec<String> {
    let list = fs::read_to_string(root.join(LIST)).unwrap_or_default();
    let groups = groups(&list);
    let sources = files(root, ".rs").into_iter().filter_map(|path| fs::read_to_string(path).ok());
    let tests: Vec<String> = sources.flat_map(|text| tests(&text)).collect();
    let (tests, mut faults) = matched(&groups, &tests);
    let path = root.join(PAGE);
    let page = fs::read_to_string(&path).unwrap_or_default();
    let wanted = with(&with(&page, "counts", &counts(&groups)), "requirements", &tables(&groups, &tests));
    if wanted == page {
        return faults;
    }
    if write {
        faults.extend(fs::write(&path, wanted).err().map(|error| format!("cannot write {PAGE}: {error}")));
    } else {
        faults.push(format!("{PAGE}: its tables are out of date: cargo run -p tasks -- apex"));
    }
    faults
}

fn groups(list: &str) -> Vec<Group<'_>> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for line in list.lines() {
        if let Some((name, what)) = line.strip_prefix("= ").and_then(|line| line.split_once(' ')) {
            groups.push(Group { name, what, requirements: Vec::new() });
        } else if let Some(group) = groups.last_mut() {
            group.requirements.extend(requirement(group.name, line));
        }
    }
    groups
}

fn requirement<'l>(group: &str, line: &'l str) -> Option<Requirement<'l>> {
    let (number, rest) = line.split_once(' ')?;
    let (state, rest) = match rest.split_at_checked(2) {
        Some(("? ", rest)) => (State::Open, rest),
        Some(("- ", rest)) => (State::Foreign, rest),
        _ => (State::Built, rest),
    };
    let (text, differs) = rest.split_once(" // ").unwrap_or((rest, ""));
    Some(Requirement { identifier: format!("{group}-{number}"), state, text, differs })
}

/// The names of the tests in a source file.
fn tests(source: &str) -> Vec<String> {
    let lines: Vec<&str> = source.lines().map(str::trim).collect();
    let of_pair = |pair: &[&str]| {
        let name = pair[1].strip_prefix("fn ").filter(|_| pair[0] == "#[test]")?;
        Some(name.split('(').next()?.to_owned())
    };
    lines.windows(2).filter_map(of_pair).collect()
}

/// How the name of a requirement's test begins.
fn prefix(identifier: &str) -> String {
    identifier.to_lowercase().replace('-', "_") + "_"
}

/// The tests by the identifier of their requirement; and what is wrong.
fn matched<'t>(groups: &[Group<'_>], tests: &'t [String]) -> (BTreeMap<String, &'t str>, Vec<String>) {
    let mut found = BTreeMap::new();
    let mut faults = Vec::new();
    for requirement in groups.iter().flat_map(|group| &group.requirements) {
        let identifier = &requirement.identifier;
        let named: Vec<&String> = tests.iter().filter(|test| test.starts_with(&prefix(identifier))).collect();
        match (requirement.state, named.as_slice()) {
            (State::Built, []) => faults.push(format!("{LIST}: {identifier} has no test (or is open: `?`)")),
            (State::Built, [test]) => drop(found.insert(identifier.clone(), test.as_str())),
            (State::Built, [..]) => faults.push(format!("{LIST}: {identifier} has several tests: {named:?}")),
            (_, []) => {}
            (_, [test, ..]) => {
                faults.push(format!(
                    "{LIST}: {identifier} has the test {test}: it is built, take its mark away"
                ));
            }
        }
    }
    let unknown =
        tests.iter().filter(|test| is_numbered(groups, test) && !found.values().any(|known| known == test));
    faults.extend(unknown.map(|test| format!("{test}: its number is none of {LIST}")));
    (found, faults)
}

/// The name begins with a group and a number of two digits.
fn is_numbered(groups: &[Group<'_>], test: &str) -> bool {
    groups.iter().any(|group| {
        let rest = test.strip_prefix(&prefix(group.name)).unwrap_or_default().as_bytes();
        matches!(rest, [tens, ones, b'_', ..] if tens.is_ascii_digit() && ones.is_ascii_digit())
    })
}

fn counts(groups: &[Group<'_>]) -> String {
    let of = |state| {
        let all = groups.iter().flat_map(|group| &group.requirements);
        all.filter(|requirement| requirement.state == state).count()
    };
    let (built, open, foreign) = (of(State::Built), of(State::Open), of(State::Foreign));
    format!(
        "| requirements | |\n|---|---|\n| with a test | {built} |\n| open | {open} |\n| do not apply | {foreign} |\n| together | {} |\n",
        built + open + foreign
    )
}

fn tables(groups: &[Group<'_>], tests: &BTreeMap<String, &str>) -> String {
    let mut text = String::new();
    for group in groups {
        text += &format!(
            "### {}: {}\n\n| | holds here | others | test |\n|---|---|---|---|\n",
            group.name, group.what
        );
        for Requirement { identifier, state, text: what, differs } in &group.requirements {
            let test = match (state, tests.get(identifier)) {
                (State::Built, Some(test)) => format!("`{test}`"),
                (State::Built | State::Open, _) => "open".into(),
                (State::Foreign, _) => "does not apply".into(),
            };
            text += &format!("| {identifier} | {what} | {differs} | {test} |\n");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &str =
        "# head\n\n= SEM-WAIT WAIT\n01 unknown: IP\n02 late // early for some\n03 ? open one\n04 - foreign\n";

    fn faults(names: &[&str]) -> Vec<String> {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        matched(&groups(LINES), &names).1
    }

    #[test]
    fn line_of_the_list_is_read() {
        let groups = groups(LINES);
        let states: Vec<State> = groups[0].requirements.iter().map(|requirement| requirement.state).collect();
        assert_eq!(states, [State::Built, State::Built, State::Open, State::Foreign]);
        let second = &groups[0].requirements[1];
        assert_eq!(
            (&*second.identifier, second.text, second.differs),
            ("SEM-WAIT-02", "late", "early for some")
        );
    }

    #[test]
    fn requirement_without_a_test_is_a_fault() {
        assert_eq!(faults(&["sem_wait_01_x", "sem_wait_02_x"]), Vec::<String>::new());
        let faults = faults(&["sem_wait_01_x"]);
        assert!(faults.len() == 1 && faults[0].contains("SEM-WAIT-02 has no test"), "{faults:?}");
    }

    #[test]
    fn test_without_a_requirement_is_a_fault() {
        let faults = faults(&["sem_wait_01_x", "sem_wait_02_x", "sem_wait_09_x", "other_01_x"]);
        assert!(faults.len() == 1 && faults[0].contains("sem_wait_09_x"), "{faults:?}");
    }

    #[test]
    fn two_tests_or_one_of_an_open_requirement_are_faults() {
        assert!(faults(&["sem_wait_01_x", "sem_wait_02_x", "sem_wait_02_y"])[0].contains("several"));
        assert!(faults(&["sem_wait_01_x", "sem_wait_02_x", "sem_wait_03_x"])[0].contains("is built"));
    }

    #[test]
    fn functions_that_are_no_tests_are_left_out() {
        assert_eq!(tests("#[test]\nfn a_01_x() {\n}\n    fn b_01_x() {}\n"), ["a_01_x"]);
    }
}
