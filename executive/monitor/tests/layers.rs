//! The files of the crate stand in layers: the list at the head of `lib.rs` is the order.

#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

/// The names in that list, from the lowest layer to the highest.
fn layers(head: &str) -> Vec<&str> {
    let items = head.lines().filter_map(|line| line.strip_prefix("//! - ")?.split_once(':'));
    items.flat_map(|(names, _)| names.split(", ").map(|name| name.trim_matches('`'))).collect()
}

/// What a file imports of the crate, its tests apart.
fn imports(text: &str) -> Vec<&str> {
    let code = text.split("#[cfg(test)]\n").next().unwrap();
    let uses = code.split("crate::").skip(1);
    uses.map(|rest| rest.split(|letter: char| !(letter.is_alphanumeric() || letter == '_')).next().unwrap())
        .collect()
}

/// The files of one layer: `NAME.rs`, or those in the folder `NAME`.
fn files(source: &Path, name: &str) -> Vec<PathBuf> {
    let one = source.join(name).with_extension("rs");
    if one.is_file() {
        return vec![one];
    }
    let all = std::fs::read_dir(source.join(name)).unwrap().map(|entry| entry.unwrap().path());
    all.filter(|path| !path.ends_with("tests.rs")).collect()
}

#[test]
fn no_file_imports_one_that_does_not_stand_above_it_in_the_list() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let head = std::fs::read_to_string(source.join("lib.rs")).unwrap();
    let layers = layers(&head);
    for (place, name) in layers.iter().enumerate() {
        for file in files(&source, name) {
            let text = std::fs::read_to_string(&file).unwrap();
            for import in imports(&text).into_iter().filter(|import| import != name) {
                let above = layers[..place].contains(&import);
                assert!(above, "{} imports {import}, which is not above it", file.display());
            }
        }
    }
    let modules = head.lines().filter(|line| line.contains("mod ") && line.ends_with(';'));
    assert_eq!(
        layers.len(),
        modules.filter(|line| !line.contains("test_support")).count(),
        "every module is in the list"
    );
}
