//! The book as its readers get it: mdbook makes its pages, then every link and picture that stays within the book is followed.
//!
//! Pages include others and are renamed on the way, so a link can be right in its source (see [`crate::links`]) and lead nowhere here.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::links::files;

/// What stands for a page that is missing: its links begin where the book lies on a server, which is not known here.
const FOR_MISSING: &str = "404.html";

/// Links and pictures of the book in `folder` that lead nowhere, a line each.
pub(crate) fn check(folder: &Path) -> Vec<String> {
    let pages = files(folder, ".html").into_iter().filter(|path| !path.ends_with(FOR_MISSING));
    let pages: BTreeMap<PathBuf, String> =
        pages.filter_map(|path| Some((path.clone(), fs::read_to_string(path).ok()?))).collect();
    let mut faults = Vec::new();
    for (page, text) in &pages {
        let shown = page.strip_prefix(folder).unwrap_or(page).display();
        let targets = values(text, "href").chain(values(text, "src")).filter(|target| is_within(target));
        let dead = targets.filter_map(|target| Some((target, fault(page, target, &pages)?)));
        faults.extend(dead.map(|(target, why)| format!("book, {shown}: {target}: {why}")));
    }
    if pages.is_empty() {
        faults.push(format!("there is no book in {}", folder.display()));
    }
    faults
}

/// The values of an attribute in a page.
fn values<'t>(text: &'t str, attribute: &str) -> impl Iterator<Item = &'t str> {
    let opening = format!(" {attribute}=\"");
    let places: Vec<usize> = text.match_indices(&opening).map(|(place, _)| place + opening.len()).collect();
    places.into_iter().filter_map(|place| text[place..].split('"').next())
}

fn is_within(target: &str) -> bool {
    let leaves = ["http:", "https:", "mailto:", "data:"];
    !leaves.iter().any(|scheme| target.starts_with(scheme))
}

/// Why `target` leads nowhere from `page`; `None` if it leads somewhere.
fn fault(page: &Path, target: &str, pages: &BTreeMap<PathBuf, String>) -> Option<&'static str> {
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let path = match file {
        "" => page.to_owned(),
        file => resolved(&page.with_file_name(file)),
    };
    match pages.get(&path) {
        Some(text) if anchor.is_empty() || values(text, "id").any(|id| id == anchor) => None,
        Some(_) => Some("that page has no such heading"),
        None if path.is_file() => None,
        None => Some("there is no such file"),
    }
}

/// A path without `..`.
fn resolved(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => _ = plain.pop(),
            part => plain.push(part),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dead_links_pictures_and_headings_are_named_and_living_ones_are_not() {
        let book = std::env::temp_dir().join(format!("bateleur-book-{}", std::process::id()));
        fs::create_dir_all(book.join("part")).unwrap();
        let one = "<h1 id=\"top\"></h1><a href=\"part/two.html#deep\"></a><a href=\"#top\"></a><img src=\"a.svg\">\
                   <a href=\"https://example.org/x\"></a><a class=\"x\" href=\"part/two.html#shallow\"></a>";
        fs::write(book.join("one.html"), one).unwrap();
        let two = "<h2 id=\"deep\"></h2><a href=\"../one.html\"></a><a href=\"one.html\"></a>";
        fs::write(book.join("part/two.html"), two).unwrap();
        fs::write(book.join("404.html"), "<a href=\"/one.html\"></a>").unwrap();
        let faults = check(&book);
        fs::remove_dir_all(&book).unwrap();
        assert_eq!(
            faults,
            [
                "book, one.html: part/two.html#shallow: that page has no such heading",
                "book, one.html: a.svg: there is no such file",
                "book, part/two.html: one.html: there is no such file",
            ]
        );
        assert_eq!(check(&book).len(), 1, "a book that is not there is no book without faults");
    }
}
