//! Adds an item to a list of a TOML text and leaves everything else as it stands: layout, comments, order.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// `text` with `item` at the end of the list under `path`, or behind the last item that `beside` finds; `None` if there is no
/// such list, or where the text would not be the same afterwards but for the item.
pub(super) fn with_item(
    text: &str,
    path: &[&str],
    item: &str,
    beside: impl Fn(&DeValue<'_>) -> bool,
) -> Option<String> {
    let document = DeTable::parse(text).ok()?;
    let list = list_in(document.get_ref(), path)?;
    let DeValue::Array(items) = list.get_ref() else { return None };
    let neighbour = items.iter().rev().find(|item| beside(item.get_ref())).or(items.last());
    let (at, addition) = match neighbour {
        Some(neighbour) => behind(text, neighbour.span(), item),
        None => (list.span().start + 1, item.to_owned()),
    };
    let changed = [text.get(..at)?, &addition, text.get(at..)?].concat();
    is_one_longer(text, &changed, path).then_some(changed)
}

fn list_in<'t, 'i>(document: &'t DeTable<'i>, path: &[&str]) -> Option<&'t Spanned<DeValue<'i>>> {
    let (first, rest) = path.split_first()?;
    let value = document.get(*first)?;
    match (rest, value.get_ref()) {
        ([], _) => Some(value),
        (rest, DeValue::Table(table)) => list_in(table, rest),
        _ => None,
    }
}

/// Where an item goes that follows the one at `span`, and what has to be put there.
fn behind(text: &str, span: std::ops::Range<usize>, item: &str) -> (usize, String) {
    let line = text[..span.start].rfind('\n').map_or(0, |end| end + 1);
    let indent = &text[line..span.start];
    let rest = &text[span.end..];
    let comma = rest.find(|letter: char| !letter.is_whitespace()).filter(|&at| rest[at..].starts_with(','));
    let end = span.end + comma.map_or(0, |at| at + 1);
    let tail = text[end..].split('\n').next().unwrap_or_default();
    let alone = indent.trim().is_empty() && (tail.trim().is_empty() || tail.trim_start().starts_with('#'));
    match (alone, comma) {
        // A line of its own; where the last comma is missing, in front of a comment that stands there.
        (true, Some(_)) => (end + tail.trim_end_matches('\r').len(), format!("\n{indent}{item},")),
        (true, None) => (end, format!(",\n{indent}{item}")),
        (false, Some(_)) => (end, format!(" {item},")),
        (false, None) => (end, format!(", {item}")),
    }
}

/// The safeguard: the list has one item more, and nothing else is another.
fn is_one_longer(before: &str, after: &str, path: &[&str]) -> bool {
    let read = |text: &str| toml::from_str::<toml::Value>(text).ok();
    let (Some(before), Some(mut after)) = (read(before), read(after)) else { return false };
    let mut list = Some(&mut after);
    for key in path {
        list = list.and_then(|value| value.get_mut(*key));
    }
    let Some(list) = list.and_then(toml::Value::as_array_mut) else { return false };
    (0..list.len()).any(|place| {
        let removed = list.remove(place);
        let same = document_with(&before, path) == Some(list);
        list.insert(place, removed);
        same
    }) && without(&before, path) == without(&after, path)
}

fn document_with<'v>(document: &'v toml::Value, path: &[&str]) -> Option<&'v Vec<toml::Value>> {
    path.iter().try_fold(document, |value, key| value.get(*key))?.as_array()
}

/// A document whose list is empty.
fn without(document: &toml::Value, path: &[&str]) -> toml::Value {
    let mut document = document.clone();
    let mut list = Some(&mut document);
    for key in path {
        list = list.and_then(|value| value.get_mut(*key));
    }
    if let Some(list) = list.and_then(toml::Value::as_array_mut) {
        list.clear();
    }
    document
}

#[cfg(test)]
mod tests {
    use super::*;

    fn added(text: &str) -> Option<String> {
        let partition = |value: &DeValue<'_>| value.as_str().is_some_and(|member| member.starts_with('p'));
        with_item(text, &["workspace", "members"], "\"p/new\"", partition)
    }

    #[test]
    fn an_item_takes_its_place_and_the_layout_stays() {
        for (before, after) in [
            (
                "[workspace]\nmembers = [\n    \"a\", # first\n    \"p/one\", # of several\n    \"z\",\n]\nx = 1 # same\n",
                "[workspace]\nmembers = [\n    \"a\", # first\n    \"p/one\", # of several\n    \"p/new\",\n    \"z\",\n]\nx = 1 # same\n",
            ),
            ("workspace.members = [\"a\", \"b\"]\n", "workspace.members = [\"a\", \"b\", \"p/new\"]\n"),
            ("workspace.members = [\"p\", \"b\",]\n", "workspace.members = [\"p\", \"p/new\", \"b\",]\n"),
            ("[workspace]\nmembers = []\n", "[workspace]\nmembers = [\"p/new\"]\n"),
            (
                "[workspace]\nmembers = [\n  \"p\" # last\n]\n",
                "[workspace]\nmembers = [\n  \"p\",\n  \"p/new\" # last\n]\n",
            ),
            (
                "[workspace]\nmembers = [\n  \"a\",\n  \"p\"\n]\n",
                "[workspace]\nmembers = [\n  \"a\",\n  \"p\",\n  \"p/new\"\n]\n",
            ),
            (
                "[workspace]\r\nmembers = [\r\n \"p\",\r\n]\r\n",
                "[workspace]\r\nmembers = [\r\n \"p\",\n \"p/new\",\r\n]\r\n",
            ),
        ] {
            assert_eq!(added(before).as_deref(), Some(after));
        }
    }

    #[test]
    fn what_is_no_list_is_left_alone() {
        for text in [
            "",
            "[workspace]\n",
            "[workspace]\nmembers = \"a\"\n",
            "[workspace\n",
            "[[workspace]]\nmembers = []\n",
        ] {
            assert_eq!(added(text), None, "{text}");
        }
    }
}
