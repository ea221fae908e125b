//! The workspace that a crate belongs to, a checkout of Bateleur or a project of one's own, and the checkout that the library is
//! taken from.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, bail};
use toml::{Table, Value};

use super::list::with_item;
use crate::installed::Installed;

/// What every checkout has.
const LIBRARY: &str = "partitions/apex/Cargo.toml";

/// The checkout that this program was built from. A package is built with another folder, so that it is the same wherever it is built.
const BUILT_FROM: &str = match option_env!("BATELEUR_BUILT_FROM") {
    Some(folder) => folder,
    None => env!("CARGO_MANIFEST_DIR"),
};

/// Where a crate is at home.
pub(super) enum Home {
    /// A member of the workspace of a checkout or of a project.
    Member(Workspace),
    /// A workspace of its own, with the library of a checkout.
    Alone(Workspace),
}

/// A workspace whose crates link the library.
pub(crate) struct Workspace {
    /// Its folder, absolute.
    pub(crate) root: PathBuf,
    /// The library itself is in it.
    pub(super) is_checkout: bool,
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
    /// The workspace in which `path` lies, which need not be there.
    pub(super) fn around(path: &Path) -> Option<Self> {
        path.ancestors().skip(1).find_map(Self::at)
    }

    fn at(root: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(root.join("Cargo.toml")).ok()?;
        let manifest: Table = toml::from_str(&text).ok()?;
        let workspace = manifest.get("workspace")?;
        let is_checkout = root.join(LIBRARY).is_file();
        let links = || workspace.get("dependencies")?.get("bateleur-apex");
        (is_checkout || links().is_some()).then(|| Self {
            root: root.to_owned(),
            is_checkout,
            text,
            manifest,
        })
    }

    /// The checkout that holds the library: the one that is named, or the one around `near` or this program, the one that lies where
    /// this program was installed, or the one that it was built from.
    pub(crate) fn library(named: Option<&Path>, near: &Path) -> Result<Self> {
        let checkout = |root: &Path| Self::at(root).filter(|found| found.is_checkout);
        if let Some(named) = named {
            let root = named.canonicalize().with_context(|| format!("cannot find {}", named.display()))?;
            return checkout(&root).with_context(|| {
                format!("{} is no checkout of Bateleur: it has no {LIBRARY}", root.display())
            });
        }
        let program = std::env::current_exe().unwrap_or_default();
        let around = |path: &Path| path.ancestors().skip(1).find_map(checkout);
        let found = around(near)
            .or_else(|| around(&program))
            .or_else(|| checkout(&Installed::here()?.library()))
            .or_else(|| around(&Path::new(BUILT_FROM).join("x")));
        found.context(
            "there is no checkout of Bateleur near, and no package bateleur-dev: install that one, or say where a checkout is with --library \
             FOLDER",
        )
    }

    /// A value of the manifest.
    pub(crate) fn value(&self, path: &[&str]) -> Option<&Value> {
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

/// The way from a folder to another path, both absolute: with `..` where they have more than the root in common.
pub(crate) fn way(from: &Path, to: &Path) -> PathBuf {
    let common = from.components().zip(to.components()).take_while(|(one, other)| one == other).count();
    if common < 2 {
        return to.to_owned();
    }
    let up = from.components().skip(common).map(|_| Component::ParentDir);
    up.chain(to.components().skip(common)).collect()
}

/// A path from `here`, without `.` and `..`: it need not be there.
pub(crate) fn absolute(here: &Path, path: &Path) -> PathBuf {
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
    fn a_way_is_relative_unless_nothing_is_shared() {
        let way = |from: &str, to: &str| super::way(Path::new(from), Path::new(to)).display().to_string();
        assert_eq!(way("/home/a/tank", "/home/a/bateleur"), "../bateleur");
        assert_eq!(way("/home/a/tank/partitions/x", "/home/a/tank/messages"), "../../messages");
        assert_eq!(way("/home/a/tank", "/usr/share/bateleur"), "/usr/share/bateleur");
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
