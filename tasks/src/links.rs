//! Finds what has rotted in the project's own pages: links that lead to no file, pages of the book that nobody can reach,
//! tests that are no longer called so, windows that the schedule has otherwise.

use std::fs;
use std::path::{Path, PathBuf};

/// Looks at every page below `root`, but not at what was built or fetched; gives what is wrong.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let mut faults = Vec::new();
    for page in pages(root) {
        let Ok(text) = fs::read_to_string(&page) else { continue };
        let folder = page.parent().unwrap_or(root);
        let shown = page.strip_prefix(root).unwrap_or(&page).display();
        let dead = targets(&text).filter(|target| !folder.join(target).exists());
        faults.extend(dead.map(|target| format!("{shown}: there is no {target}")));
        if page.starts_with(root.join("docs/src")) {
            let lost = named_files(&text).filter(|file| is_below(root, file) && !root.join(file).exists());
            faults.extend(lost.map(|file| format!("{shown}: there is no {file}")));
        }
    }
    faults.extend(unreachable(&root.join("docs/src")));
    faults.extend(outdated(root));
    faults
}

/// Every Markdown file, in order.
fn pages(folder: &Path) -> Vec<PathBuf> {
    files(folder, ".md")
}

/// Every file whose name ends so, in order; not what was built or fetched.
pub(crate) fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut entries: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    entries.sort();
    let mut found = Vec::new();
    for path in entries {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.starts_with('.') || name == "target" || path.is_symlink() {
            continue;
        }
        if path.is_dir() {
            found.extend(files(&path, ending));
        } else if name.ends_with(ending) {
            found.push(path);
        }
    }
    found
}

/// Where a page's links lead, without those that leave the project and those inside code.
fn targets(text: &str) -> impl Iterator<Item = &str> {
    let mut code = false;
    let prose = text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    });
    let links = prose.flat_map(|line| line.split("](").skip(1).filter_map(|rest| rest.split(')').next()));
    let files = links.map(|link| link.split(['#', ' ']).next().unwrap_or_default());
    files.filter(|link| !link.is_empty() && !link.contains("://") && !link.starts_with("mailto:"))
}

/// Files that a page names in its prose, as code; names with capitals stand for others.
fn named_files(text: &str) -> impl Iterator<Item = &str> {
    let is_file = |code: &&str| {
        [".rs", ".toml", ".md", ".html"].iter().any(|ending| code.ends_with(ending))
            && code.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-' | b'.' | b'/'))
    };
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2)).filter(is_file)
}

/// Whether a path begins with a folder of the project.
fn is_below(root: &Path, file: &str) -> bool {
    file.split_once('/').is_some_and(|(folder, _)| {
        !folder.is_empty() && !folder.starts_with('.') && root.join(folder).is_dir()
    })
}

/// Pages of the book that its summary does not name.
fn unreachable(book: &Path) -> Vec<String> {
    let Ok(summary) = fs::read_to_string(book.join("SUMMARY.md")) else { return Vec::new() };
    let named: Vec<PathBuf> = targets(&summary).map(|target| book.join(target)).collect();
    let lost = pages(book).into_iter().filter(|page| !page.ends_with("SUMMARY.md") && !named.contains(page));
    lost.map(|page| format!("{}: docs/src/SUMMARY.md does not name it", page.display())).collect()
}

/// What the partitions' pages say of tests and windows, and what is no longer so.
fn outdated(root: &Path) -> Vec<String> {
    let sources = files(root, ".rs").into_iter().filter_map(|path| fs::read_to_string(path).ok());
    let sources: String = sources.collect();
    let schedule = fs::read_to_string(root.join("schedule.toml")).unwrap_or_default();
    let mut faults = Vec::new();
    for page in pages(&root.join("docs/src/partitions")) {
        let text = fs::read_to_string(&page).unwrap_or_default();
        let name = page.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let lost = named_tests(&text).filter(|test| !sources.contains(&format!("fn {test}(")));
        faults.extend(lost.map(|test| format!("{name}.md: no test is called {test}")));
        let wrong = windows(&text).filter(|window| !has_window(&schedule, name, *window));
        faults.extend(wrong.map(|(offset, duration)| {
            format!("{name}.md: schedule.toml has no window of {name} from {offset} for {duration}")
        }));
    }
    faults
}

/// The tests in a page's table of requirements: the last cell of each row.
fn named_tests(page: &str) -> impl Iterator<Item = &str> {
    let table = page.split_once("| requirement | test |").map_or("", |(_, table)| table);
    table.lines().filter_map(|row| row.strip_suffix("` |")?.rsplit_once('`').map(|(_, test)| test))
}

/// The windows that a page names, as offset and duration: `| window | 3.8ms to +500us of …`.
fn windows(page: &str) -> impl Iterator<Item = (&str, &str)> {
    let rows = page.lines().filter_map(|row| row.strip_prefix("| window | "));
    rows.filter_map(|row| row.split_once(" of ")?.0.split_once(" to +"))
}

fn has_window(schedule: &str, partition: &str, (offset, duration): (&str, &str)) -> bool {
    let says = |line: &str, key: &str, value: &str| line.contains(&format!("{key} = \"{value}\""));
    let mut lines = schedule.lines();
    lines.any(|line| {
        says(line, "partition", partition) && says(line, "offset", offset) && says(line, "duration", duration)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_in_prose_and_not_in_code() {
        let text = "[a](one.md), ![b](two.png#x) and [c](https://a.b)\n```\n[d](three.md)\n```\n[e](#here)";
        assert_eq!(targets(text).collect::<Vec<_>>(), ["one.md", "two.png"]);
    }

    #[test]
    fn a_dead_link_and_a_lost_page_are_named() {
        let root = std::env::temp_dir().join(format!("bateleur-links-{}", std::process::id()));
        let book = root.join("docs/src");
        fs::create_dir_all(&book).unwrap();
        fs::write(book.join("SUMMARY.md"), "- [One](one.md)").unwrap();
        let one = "[gone](nowhere.md), `docs/lost.rs`, `docs/src/two.md`, `docs/NAME.rs`, `lib/other.rs`, `/etc/other.toml`";
        fs::write(book.join("one.md"), one).unwrap();
        fs::write(book.join("two.md"), "").unwrap();
        let faults = check(&root);
        fs::remove_dir_all(&root).unwrap();
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert_eq!(faults[0], "docs/src/one.md: there is no nowhere.md");
        assert_eq!(faults[1], "docs/src/one.md: there is no docs/lost.rs");
        assert!(faults[2].ends_with("two.md: docs/src/SUMMARY.md does not name it"));
    }

    #[test]
    fn tests_and_windows_of_a_page_are_found() {
        let page = "| window | 3.8ms to +500us of every minor frame |\n| requirement | test |\n|---|---|\n\
                    | It `flies` | `it_flies` |\n";
        assert_eq!(named_tests(page).collect::<Vec<_>>(), ["it_flies"]);
        assert_eq!(windows(page).collect::<Vec<_>>(), [("3.8ms", "500us")]);
        let schedule = "    { partition = \"imu\", offset = \"3.8ms\", duration = \"500us\" },";
        assert!(has_window(schedule, "imu", ("3.8ms", "500us")));
        assert!(!has_window(schedule, "gps", ("3.8ms", "500us")));
    }
}
