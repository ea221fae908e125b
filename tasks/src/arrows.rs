//! Holds the crates' dependencies on each other against the table in `docs/src/architecture.md`: each crate is built on exactly those
//! that its row names, and they stand above it, so no arrow runs back up. Rows of one top folder stand together, so none runs up between
//! top folders either.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::links::files;

/// The page with the table, and the first cells of its head.
pub(crate) const PAGE: &str = "docs/src/architecture.md";
const HEAD: &str = "| crate | is built on |";

/// The crates of the table, each with those that it is built on.
pub(crate) struct Crates<'p>(Vec<(&'p str, Vec<&'p str>)>);

impl<'p> Crates<'p> {
    /// Those of a page.
    pub(crate) fn of(page: &'p str) -> Self {
        Self(rows(page).collect())
    }

    /// A crate and all that it is built on, directly or not, in the table's order.
    pub(crate) fn below(&self, folder: &str) -> Vec<&'p str> {
        let mut needed = vec![folder];
        // Each stands below what it is built on.
        for (row, named) in self.0.iter().rev() {
            if needed.contains(row) {
                needed.extend(named);
            }
        }
        self.0.iter().map(|(row, _)| *row).filter(|row| needed.contains(row)).collect()
    }
}

/// What is wrong, a line each.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let page = fs::read_to_string(root.join(PAGE)).unwrap_or_default();
    let manifests = files(root, "Cargo.toml").into_iter().filter_map(|path| {
        let folder = path.parent()?.strip_prefix(root).ok()?.to_string_lossy().into_owned();
        if folder.contains("/templates/") || folder.starts_with("examples/") {
            return None; // of somebody else's crate
        }
        Some((folder, fs::read_to_string(&path).ok()?))
    });
    faults(&page, &manifests.collect())
}

/// `manifests`: the text of each, by its folder.
fn faults(page: &str, manifests: &BTreeMap<String, String>) -> Vec<String> {
    let packages = manifests.iter().filter_map(|(folder, text)| Some((package(text)?, folder.as_str())));
    let packages: BTreeMap<&str, &str> = packages.collect();
    let rows: Vec<(&str, Vec<&str>)> = rows(page).collect();
    let mut faults = Vec::new();
    for (place, (folder, named)) in rows.iter().enumerate() {
        let Some(manifest) = manifests.get(*folder) else {
            faults.push(format!("{PAGE}: there is no crate {folder}"));
            continue;
        };
        let built_on: Vec<&str> =
            dependencies(manifest).filter_map(|name| packages.get(name).copied()).collect();
        let unnamed = built_on.iter().filter(|other| !named.contains(other));
        faults.extend(unnamed.map(|other| {
            format!("{folder}/Cargo.toml: {folder} must not be built on {other} (or {PAGE} has to say so)")
        }));
        let unused = named.iter().filter(|other| !built_on.contains(other));
        faults.extend(unused.map(|other| format!("{PAGE}: {folder} is not built on {other}")));
        let below = named.iter().filter(|other| !rows[..place].iter().any(|(above, _)| above == *other));
        faults.extend(
            below.map(|other| format!("{PAGE}: {folder} must stand below {other}, which it is built on")),
        );
    }
    faults.extend(scattered(&rows).map(|folder| {
        format!("{PAGE}: {folder} must stand with the other crates of its top folder, or arrows run both ways between folders")
    }));
    let missing = packages.values().filter(|folder| !rows.iter().any(|(row, _)| row == *folder));
    faults.extend(missing.map(|folder| format!("{PAGE}: {folder} has no row in the table of crates")));
    faults
}

/// Crates that others of other top folders keep apart from those of their own.
fn scattered<'p>(rows: &[(&'p str, Vec<&str>)]) -> impl Iterator<Item = &'p str> {
    let top = |place: usize| rows[place].0.split('/').next();
    let is_apart = move |place: &usize| {
        let earlier = (0..*place).rev().find(|other| top(*other) == top(*place));
        earlier.is_some_and(|earlier| earlier + 1 < *place)
    };
    (0..rows.len()).filter(is_apart).map(|place| rows[place].0)
}

/// The table's rows: a crate, and those that it is built on.
fn rows(page: &str) -> impl Iterator<Item = (&str, Vec<&str>)> {
    let table = page.lines().skip_while(|line| !line.starts_with(HEAD)).skip(2);
    table.take_while(|line| line.starts_with('|')).filter_map(|line| {
        let mut cells = line.split('|').skip(1);
        let folder = cells.next()?.trim().trim_matches('`');
        let named = cells.next()?.split(',').map(|name| name.trim().trim_matches('`'));
        Some((folder, named.filter(|name| *name != "–").collect()))
    })
}

fn package(manifest: &str) -> Option<&str> {
    let mut lines = manifest.lines().skip_while(|line| *line != "[package]");
    lines.find_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"'))
}

/// The names in the table `[dependencies]`. Tests may be built on more.
fn dependencies(manifest: &str) -> impl Iterator<Item = &str> {
    let table = manifest.lines().skip_while(|line| *line != "[dependencies]").skip(1);
    let lines = table.take_while(|line| !line.starts_with('['));
    lines.filter_map(|line| line.split(['.', ' ', '=']).next()).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest(name: &str, built_on: &[&str]) -> String {
        let lines: String = built_on.iter().map(|other| format!("{other}.workspace = true\n")).collect();
        format!(
            "[package]\nname = \"{name}\"\n\n[dependencies]\nlibc.workspace = true\n{lines}\n[dev-dependencies]\nup.workspace = true\n"
        )
    }

    fn project(of_low: &[&str], of_high: &[&str]) -> BTreeMap<String, String> {
        [("a/low", manifest("low", of_low)), ("b/high", manifest("high", of_high))]
            .map(|(folder, text)| (folder.to_owned(), text))
            .into()
    }

    const TABLE: &str =
        "| crate | is built on | knows |\n|---|---|---|\n| `a/low` | – | x |\n| `b/high` | `a/low` | y |\n";

    #[test]
    fn crates_that_are_built_as_the_table_says_are_fine() {
        assert_eq!(faults(TABLE, &project(&[], &["low"])), Vec::<String>::new());
    }

    #[test]
    fn an_arrow_that_the_table_does_not_name_is_a_fault() {
        let said = faults(TABLE, &project(&["high"], &["low"]));
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("a/low/Cargo.toml: a/low must not be built on b/high"), "{said:?}");
    }

    #[test]
    fn an_arrow_back_up_is_a_fault_even_where_the_table_names_it() {
        let table = TABLE.replace("`a/low` | –", "`a/low` | `b/high`");
        let said = faults(&table, &project(&["high"], &["low"]));
        assert_eq!(said, [format!("{PAGE}: a/low must stand below b/high, which it is built on")]);
    }

    #[test]
    fn an_arrow_up_between_top_folders_is_a_fault_where_each_crate_stands_below_what_it_is_built_on() {
        let mut manifests = project(&[], &["low"]);
        manifests.insert("a/top".to_owned(), manifest("top", &["high"]));
        let table = format!("{TABLE}| `a/top` | `b/high` | z |\n");
        let said = faults(&table, &manifests);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with(&format!("{PAGE}: a/top must stand with the other crates")), "{said:?}");
    }

    #[test]
    fn rows_without_a_crate_crates_without_a_row_and_arrows_that_are_gone_are_faults() {
        let said = faults(TABLE, &project(&[], &[]));
        assert_eq!(said, [format!("{PAGE}: b/high is not built on a/low")]);
        let more = format!("{TABLE}| `c/gone` | – | z |\n");
        assert_eq!(faults(&more, &project(&[], &["low"])), [format!("{PAGE}: there is no crate c/gone")]);
        let less = TABLE.replace("| `b/high` | `a/low` | y |\n", "");
        let said = faults(&less, &project(&[], &["low"]));
        assert_eq!(said, [format!("{PAGE}: b/high has no row in the table of crates")]);
    }
}
