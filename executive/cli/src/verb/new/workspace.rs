//! The checkout of this project that a crate belongs to, or that it takes the library from.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, bail};
use toml::{Table, Value};

use super::list::with_item;

/// What every checkout has.
const LIBRARY: &str = "partitions/apex/Cargo.toml";

/// Where a crate is at home.
pub(super) enum Home {
    /// A member of a checkout's workspace.
    Member(Workspace),
    /// A workspace of its own, with the library of a checkout.
    Alone(Workspace),
}

/// A checkout.
pub(super) struct Workspace {
    /// Its folder, absolute.
    pub(super) root: PathBuf,
    text: String,
    manifest: Table,
}

/// What came of making a crate a member.
pub(super) enum Joined {
    /// It is one already, such as by a pattern.
    Already,
    /// The manifest with it.
    Text(String),
    /// The manifest is laid out as nobody expects.
    ByHand,
}

impl Workspace {
    /// The checkout in which `path` lies, which need not be there.
    pub(super) fn around(path: &Path) -> Option<Self> {
        path.ancestors().skip(1).find_map(Self::at)
    }

    fn at(root: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(root.join("Cargo.toml")).ok()?;
        let manifest: Table = toml::from_str(&text).ok()?;
        let is_one = manifest.contains_key("workspace") && root.join(LIBRARY).is_file();
        is_one.then(|| Self { root: root.to_owned(), text, manifest })
    }

    /// The checkout that holds the library: the one that is named, or the one around the schedule file or this program, or the
    /// one that this program was built from.
    pub(super) fn library(named: Option<&Path>, schedule: &Path) -> Result<Self> {
        if let Some(named) = named {
            let root = named.canonicalize().with_context(|| format!("cannot find {}", named.display()))?;
            return Self::at(&root).with_context(|| {
                format!("{} is no checkout of Bateleur: it has no {LIBRARY}", root.display())
            });
        }
        let built_from = Path::new(env!("CARGO_MANIFEST_DIR")).join("x");
        let program = std::env::current_exe().unwrap_or_default();
        let near = [schedule, &program, &built_from].into_iter().find_map(Self::around);
        near.context("there is no checkout of Bateleur near: say where one is with --library FOLDER")
    }

    /// A value of the manifest.
    pub(super) fn value(&self, path: &[&str]) -> Option<&Value> {
        let (first, rest) = path.split_first()?;
        rest.iter().try_fold(self.manifest.get(*first)?, |value, key| value.get(*key))
    }

    /// With a crate in the folder `member` among its members.
    pub(super) fn with_member(&self, member: &str) -> Result<Joined> {
        let members = self.value(&["workspace", "members"]).and_then(Value::as_array);
        let covers = |pattern: &str| match pattern.strip_suffix("/*") {
            Some(parent) => Path::new(member).parent() == Some(Path::new(parent)),
            None => pattern == member,
        };
        if members.into_iter().flatten().filter_map(Value::as_str).any(covers) {
            return Ok(Joined::Already);
        }
        let parent =
            Path::new(member).parent().map(|parent| format!("{}/", parent.display())).unwrap_or_default();
        let beside =
            |value: &toml::de::DeValue<'_>| value.as_str().is_some_and(|other| other.starts_with(&parent));
        let item = Value::String(member.to_owned()).to_string();
        Ok(with_item(&self.text, &["workspace", "members"], &item, beside)
            .map_or(Joined::ByHand, Joined::Text))
    }

    /// Two programs of one name would be built into one file.
    pub(super) fn refuse_a_second(&self, program: &str) -> Result<()> {
        let members = self.value(&["workspace", "members"]).and_then(Value::as_array).into_iter().flatten();
        for member in members.filter_map(Value::as_str) {
            let Ok(text) = std::fs::read_to_string(self.root.join(member).join("Cargo.toml")) else {
                continue;
            };
            let Ok(manifest) = toml::from_str::<Table>(&text) else { continue };
            let bins = manifest.get("bin").and_then(Value::as_array).into_iter().flatten();
            let mut names = bins.filter_map(|bin| bin.get("name")?.as_str());
            if names.any(|name| name == program) {
                bail!(
                    "`{member}` builds a program called `{program}` already: if that is the partition's, there is nothing to \
                     write; else choose another `program`, or a folder outside of the checkout with --dir"
                );
            }
        }
        Ok(())
    }
}

/// A path from `here`, without `.` and `..`: it need not be there.
pub(super) fn absolute(here: &Path, path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in here.join(path).components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_is_not_there_is_made_absolute() {
        assert_eq!(absolute(Path::new("/a/b"), Path::new("./../c/./d")), Path::new("/a/c/d"));
        assert_eq!(absolute(Path::new("/a/b"), Path::new("/x")), Path::new("/x"));
    }

    #[test]
    fn the_checkout_is_found_from_inside_and_takes_a_member_beside_its_like() {
        let workspace = Workspace::around(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src")).unwrap();
        assert!(matches!(workspace.with_member("partitions/imu").unwrap(), Joined::Already));
        let Joined::Text(text) = workspace.with_member("partitions/height_watch").unwrap() else {
            panic!("no text")
        };
        let line = text.lines().position(|line| line == "    \"partitions/height_watch\",").unwrap();
        assert!(text.lines().nth(line - 1).unwrap().starts_with("    \"partitions/"));
        assert!(text.lines().nth(line + 1).unwrap().starts_with("    \"gateway/"));
        let refused = workspace.refuse_a_second("imu").unwrap_err().to_string();
        assert!(refused.starts_with("`partitions/imu` builds a program called `imu` already"), "{refused}");
        assert!(workspace.refuse_a_second("height_watch").is_ok());
    }
}
