//! What a crate's `Cargo.toml` says beside its name, in each of its homes.

use serde::Serialize;
use toml::{Table, Value};

use super::skeleton::Skeleton;
use super::workspace::{Home, Workspace};
use crate::templates::Written;

/// Keys of a package that a workspace may give to all of its members.
const COMMON: [&str; 5] = ["version", "edition", "rust-version", "license", "publish"];

/// See the module's head.
#[derive(Serialize)]
pub(super) struct Dependencies {
    pub(super) package: String,
    common: String,
    dependencies: String,
    /// A workspace of its own, with these tables.
    alone: bool,
    profile: String,
    lints: String,
}

impl Dependencies {
    pub(super) fn of(skeleton: &Skeleton, home: &Home) -> Self {
        let packages = packages(skeleton);
        match home {
            Home::Member(workspace) => {
                let prefix = workspace.is_checkout.then_some("bateleur");
                let inherited = |keys: &[&str]| {
                    keys.iter().map(|key| format!("{key}.workspace = true")).collect::<Vec<_>>().join("\n")
                };
                let given = |key: &&str| {
                    workspace.is_checkout || workspace.value(&["workspace", "package", key]).is_some()
                };
                let keys: Vec<&str> = COMMON.into_iter().filter(given).collect();
                Self {
                    package: super::names::package(&skeleton.partition, prefix),
                    common: inherited(&keys),
                    dependencies: inherited(&packages),
                    alone: false,
                    profile: String::new(),
                    lints: String::new(),
                }
            }
            Home::Alone(library) => {
                let common = |key: &str, default: &str| {
                    let value = library.value(&["workspace", "package", key]).and_then(Value::as_str);
                    format!("{key} = {}", Value::from(value.unwrap_or(default)))
                };
                let dependency = |package: &&str| {
                    format!(
                        "{package} = {}",
                        library.dependency(package, &library.root.display().to_string())
                    )
                };
                Self {
                    package: super::names::package(&skeleton.partition, None),
                    common: format!(
                        "version = \"0.1.0\"\n{}\n{}\npublish = false",
                        common("edition", "2024"),
                        common("rust-version", "1.89")
                    ),
                    dependencies: packages.iter().map(dependency).collect::<Vec<_>>().join("\n"),
                    alone: true,
                    profile: library.profiles(),
                    lints: library.table(&["workspace", "lints"], "lints"),
                }
            }
        }
    }
}

/// What the crate is built on.
fn packages(skeleton: &Skeleton) -> Vec<&'static str> {
    let mut packages = vec!["bateleur-apex"];
    packages.extend(skeleton.needs_messages().then_some("bateleur-messages"));
    packages.extend(skeleton.needs_zerocopy().then_some("zerocopy"));
    packages
}

impl Workspace {
    /// A dependency of this workspace as another has to write it, with `root` for the path of this one's folder.
    pub(crate) fn dependency(&self, package: &str, root: &str) -> Value {
        let there = self.value(&["workspace", "dependencies", package]);
        let path = there.and_then(|there| there.get("path")).and_then(Value::as_str);
        let Some(path) = path else {
            return there
                .cloned()
                .unwrap_or_else(|| Value::from(if package == "zerocopy" { "0.8" } else { "*" }));
        };
        let mut table = Table::new();
        table.insert("path".to_owned(), format!("{root}/{path}").into());
        if let Some(version) = there.and_then(|there| there.get("version")) {
            table.insert("version".to_owned(), version.clone());
        }
        Value::Table(table)
    }

    /// What the skeletons are formatted, linted and built by: the library's own.
    pub(crate) fn shared(&self) -> impl Iterator<Item = Written> {
        ["rustfmt.toml", "clippy.toml", "Cargo.lock"]
            .into_iter()
            .filter_map(|name| Some((name, std::fs::read_to_string(self.root.join(name)).ok()?)))
    }

    /// How this workspace's crates are built, but for its packages.
    pub(crate) fn profiles(&self) -> String {
        ["dev", "release"].map(|name| self.table(&["profile", name], &format!("profile.{name}"))).join("\n\n")
    }

    /// A table of this workspace's manifest under another name.
    pub(crate) fn table(&self, path: &[&str], name: &str) -> String {
        let Some(value) = self.value(path) else { return String::new() };
        let inner = name
            .rsplit('.')
            .fold(value.clone(), |inner, key| Table::from_iter([(key.to_owned(), inner)]).into());
        let Value::Table(table) = inner else { return String::new() };
        toml::to_string(&table).unwrap_or_default().trim_end().to_owned()
    }
}
