//! Holds the executive's sources free of circles: files and folders that stand side by side import each other in one direction.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use crate::links::files;

/// Folders whose crates are looked at.
const TOP: &str = "executive";

/// Circles that are known, by the folder and one of their members.
const KNOWN: &[(&str, &str)] = &[
    // Who stops a partition and what can be stopped know each other.
    ("executive/time/src", "time_guard"),
];

/// What is wrong, a line each.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let crates =
        fs::read_dir(root.join(TOP)).into_iter().flatten().flatten().map(|entry| entry.path().join("src"));
    let mut crates: Vec<_> = crates.filter(|source| source.is_dir()).collect();
    crates.sort();
    let circles = crates.iter().flat_map(|source| {
        let texts = files(source, ".rs").into_iter().filter_map(|path| {
            let place = path.strip_prefix(source).ok()?.with_extension("").to_string_lossy().into_owned();
            Some((place, fs::read_to_string(path).ok()?))
        });
        let shown = source.strip_prefix(root).unwrap_or(source).to_string_lossy().into_owned();
        circles(&texts.collect()).into_iter().map(move |(folder, members)| match folder.as_str() {
            "" => (shown.clone(), members),
            folder => (format!("{shown}/{folder}"), members),
        })
    });
    faults(&circles.collect::<Vec<_>>())
}

fn faults(circles: &[(String, Vec<String>)]) -> Vec<String> {
    let is_of = |known: &(&str, &str), circle: &(String, Vec<String>)| {
        circle.0 == known.0 && circle.1.iter().any(|member| member == known.1)
    };
    let new = circles.iter().filter(|circle| !KNOWN.iter().any(|known| is_of(known, circle)));
    let gone = KNOWN.iter().filter(|known| !circles.iter().any(|circle| is_of(known, circle)));
    let new = new.map(|(folder, members)| {
        format!("{folder}: files import each other in a circle: {}", members.join(", "))
    });
    let gone = gone.map(|(folder, member)| {
        format!("{folder}: no circle goes through {member} any more: remove it from tasks/src/circles.rs")
    });
    new.chain(gone).collect()
}

/// Every circle: its folder, and its members. `texts`: each source by its place in the crate, without the ending.
fn circles(texts: &BTreeMap<String, String>) -> Vec<(String, Vec<String>)> {
    let modules: BTreeMap<Vec<&str>, &str> =
        texts.iter().filter_map(|(place, text)| Some((module(place)?, without_tests(text)))).collect();
    let mut arrows: BTreeMap<String, BTreeSet<(&str, &str)>> = BTreeMap::new();
    for (own, text) in &modules {
        for path in imports(text, own) {
            let depth = own.iter().zip(&path).take_while(|(one, other)| one == other).count();
            let (Some(from), Some(to)) = (own.get(depth), path.get(depth)) else { continue };
            let folder = &own[..depth];
            let stands_there = |name: &str| {
                modules.keys().any(|key| key.starts_with(folder) && key.get(depth) == Some(&name))
            };
            let to = if stands_there(to) {
                Some(*to)
            } else {
                exported(&modules, folder, to).filter(|to| stands_there(to))
            };
            if let Some(to) = to.filter(|to| to != from) {
                arrows.entry(folder.join("/")).or_default().insert((from, to));
            }
        }
    }
    arrows
        .into_iter()
        .flat_map(|(folder, arrows)| knots(&arrows).into_iter().map(move |knot| (folder.clone(), knot)))
        .collect()
}

/// The module that a source is; `None` for tests and programs beside the crate's own.
fn module(place: &str) -> Option<Vec<&str>> {
    let mut parts: Vec<&str> = place.split('/').collect();
    if parts.iter().any(|part| ["tests", "bin"].contains(part)) {
        return None;
    }
    parts.pop_if(|last| ["lib", "main", "mod"].contains(last));
    Some(parts)
}

fn without_tests(text: &str) -> &str {
    text.split("#[cfg(test)]\nmod ").next().unwrap_or(text)
}

/// The module within `folder` from which it hands `name` on.
fn exported<'t>(modules: &BTreeMap<Vec<&str>, &'t str>, folder: &[&str], name: &str) -> Option<&'t str> {
    let text: &'t str = modules.get(folder)?;
    let uses = text.lines().scan(0, |place, line| {
        let begun = *place;
        *place += line.len() + 1;
        Some((begun, line))
    });
    let uses = uses.filter_map(|(place, line)| {
        Some(place + line.find("use ").filter(|at| !line[..*at].contains("//"))? + 4)
    });
    let paths = uses.flat_map(|place| {
        let mut paths = Vec::new();
        tree(&text[place..], &[], &mut paths);
        paths
    });
    paths.filter(|path| path.last() == Some(&name)).find_map(|path| path.first().copied())
}

/// The paths of this crate that a text names, each from the crate's root.
fn imports<'t>(text: &'t str, own: &[&'t str]) -> Vec<Vec<&'t str>> {
    let mut paths = Vec::new();
    for line in lines_of_code(text) {
        for root in ["crate::", "self::", "super::"] {
            for (place, _) in text[line.clone()].match_indices(root) {
                let place = line.start + place;
                let before = text[..place].chars().next_back();
                // The second `super` of a path is read with the first.
                if before.is_some_and(|letter| is_of_word(letter) || letter == ':') {
                    continue;
                }
                let mut named = Vec::new();
                tree(&text[place..], &[], &mut named);
                paths.extend(named.iter().filter_map(|path| from_root(path, own)));
            }
        }
    }
    paths
}

/// Where the lines of a text stand, without comments.
fn lines_of_code(text: &str) -> impl Iterator<Item = std::ops::Range<usize>> {
    let mut begun = 0;
    text.split_inclusive('\n').map(move |line| {
        let range = begun..begun + line.find("//").unwrap_or(line.len());
        begun += line.len();
        range
    })
}

fn is_of_word(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

/// A path from the crate's root; `None` if it leads above it.
fn from_root<'t>(path: &[&'t str], own: &[&'t str]) -> Option<Vec<&'t str>> {
    let ups = path.iter().take_while(|part| **part == "super").count();
    let (base, skipped) = match *path.first()? {
        "crate" => (&own[..0], 1),
        "self" => (own, 1),
        _ => (own.get(..own.len().checked_sub(ups)?)?, ups),
    };
    Some([base, &path[skipped..]].concat())
}

/// The paths of a tree such as `a::{b, c::d}` at the beginning of a text; the bytes that it takes.
fn tree<'t>(text: &'t str, before: &[&'t str], paths: &mut Vec<Vec<&'t str>>) -> usize {
    let mut path = before.to_vec();
    let mut place = 0;
    loop {
        let rest = &text[place..];
        let word = &rest[..rest.find(|letter| !is_of_word(letter)).unwrap_or(rest.len())];
        place += word.len();
        if !word.is_empty() {
            path.push(word);
        }
        if text[place..].starts_with('{') {
            place += 1;
            while !text[place..].is_empty() && !text[place..].starts_with('}') {
                let taken = match text[place..].starts_with(is_of_word) {
                    true => tree(&text[place..], &path, paths),
                    false => 0,
                };
                // A comma, a space, or what is no tree at all.
                place +=
                    if taken > 0 { taken } else { text[place..].chars().next().map_or(1, char::len_utf8) };
            }
            return (place + 1).min(text.len());
        }
        if word.is_empty() || !text[place..].starts_with("::") {
            paths.push(path);
            return place;
        }
        place += 2;
    }
}

/// Members of each circle, in order.
fn knots(arrows: &BTreeSet<(&str, &str)>) -> Vec<Vec<String>> {
    let mut reached: BTreeSet<(&str, &str)> = arrows.clone();
    loop {
        let further = reached.iter().flat_map(|(from, through)| {
            arrows.iter().filter(move |(other, _)| other == through).map(move |(_, to)| (*from, *to))
        });
        let all: BTreeSet<(&str, &str)> = reached.iter().copied().chain(further).collect();
        if all.len() == reached.len() {
            break;
        }
        reached = all;
    }
    let in_circles = reached.iter().filter(|(from, to)| from == to).map(|(name, _)| *name);
    let of = |name: &str| {
        let both = |other: &&str| reached.contains(&(name, *other)) && reached.contains(&(*other, name));
        reached.iter().map(|(_, to)| *to).filter(both).collect::<BTreeSet<_>>()
    };
    let knots: BTreeSet<BTreeSet<&str>> = in_circles.map(of).collect();
    knots.into_iter().map(|knot| knot.into_iter().map(str::to_owned).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(texts: &[(&str, &str)]) -> Vec<(String, Vec<String>)> {
        circles(&texts.iter().map(|(place, text)| ((*place).to_owned(), (*text).to_owned())).collect())
    }

    fn circle(folder: &str, members: &[&str]) -> (String, Vec<String>) {
        (folder.to_owned(), members.iter().map(|member| (*member).to_owned()).collect())
    }

    #[test]
    fn circle_is_found_through_every_way_to_name_a_file() {
        assert_eq!(
            of(&[
                ("lib", ""),
                ("a", "use crate::b::X;"),
                ("b", "use std::x;"),
                ("c", "use super::{a, b::Y};")
            ]),
            []
        );
        for back in [
            "use crate::a::X;",
            "use super::a::X;",
            "use crate::{\n    c::Z,\n    a::{X, Y},\n};",
            "fn f() { crate::a::x() }",
            "use crate::X;",
        ] {
            let found =
                of(&[("lib", "pub use a::{X, Y};"), ("a", "use crate::b::Z;"), ("b", back), ("c", "")]);
            assert_eq!(found, [circle("", &["a", "b"])], "{back}");
        }
    }

    #[test]
    fn circle_goes_over_several_files_and_within_folders_and_tests_and_comments_make_none() {
        let three = [
            ("a", "use super::b;"),
            ("b", "use super::c::d::X;"),
            ("c/mod", ""),
            ("c/d", "use crate::a::Y;"),
        ];
        assert_eq!(of(&three), [circle("", &["a", "b", "c"])]);
        let inner = [("c/mod", "use d::X;"), ("c/d", "use super::{Y, e::Z};"), ("c/e", "use super::d::X;")];
        assert_eq!(of(&inner), [circle("c", &["d", "e"])]);
        let tested = [
            ("a", "use crate::b::X;"),
            ("b", "// see crate::a::Y\n#[cfg(test)]\nmod tests {\n    use crate::a::Y;\n}\n"),
            ("b/tests", "use crate::a::Y;"),
        ];
        assert_eq!(of(&tested), []);
    }

    #[test]
    fn known_circle_is_passed_over_and_told_of_when_it_is_gone() {
        let known: Vec<_> = KNOWN.iter().map(|(folder, member)| circle(folder, &["other", member])).collect();
        assert_eq!(faults(&known), [""; 0]);
        let said = faults(&[&known[1..], &[circle("executive/plan/src", &["a", "b"])]].concat());
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(
            said[0].starts_with("executive/plan/src: files import each other in a circle: a, b"),
            "{said:?}"
        );
        assert!(said[1].contains("no circle goes through"), "{said:?}");
    }
}
