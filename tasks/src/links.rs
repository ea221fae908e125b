//! Finds links in the project's own pages that lead to no file, and pages of the book that nobody can reach.

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
    }
    faults.extend(unreachable(&root.join("docs/src")));
    faults
}

/// Every Markdown file, in order.
fn pages(folder: &Path) -> Vec<PathBuf> {
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
            found.extend(pages(&path));
        } else if name.ends_with(".md") {
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

/// Pages of the book that its summary does not name.
fn unreachable(book: &Path) -> Vec<String> {
    let Ok(summary) = fs::read_to_string(book.join("SUMMARY.md")) else { return Vec::new() };
    let named: Vec<PathBuf> = targets(&summary).map(|target| book.join(target)).collect();
    let lost = pages(book).into_iter().filter(|page| !page.ends_with("SUMMARY.md") && !named.contains(page));
    lost.map(|page| format!("{}: docs/src/SUMMARY.md does not name it", page.display())).collect()
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
        fs::write(book.join("one.md"), "[gone](nowhere.md)").unwrap();
        fs::write(book.join("two.md"), "").unwrap();
        let faults = check(&root);
        fs::remove_dir_all(&root).unwrap();
        assert_eq!(faults.len(), 2, "{faults:?}");
        assert_eq!(faults[0], "docs/src/one.md: there is no nowhere.md");
        assert!(faults[1].ends_with("two.md: docs/src/SUMMARY.md does not name it"));
    }
}
