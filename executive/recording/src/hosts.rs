//! The hosts of a flight: each leaves a folder of its own, as if it had flown alone.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// Below a flight's folder: the hosts' folders, by module.
pub const FOLDER: &str = "hosts";
/// In a flight's folder: the hosts, and how their times go together.
pub const FILE: &str = "hosts.json";
/// A host of a flight; one that died and came back is another one for each of its starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Host {
    /// The module's name.
    pub module: String,
    /// Which of its starts this is, from 1.
    #[serde(default = "first", skip_serializing_if = "is_first")]
    pub start: u32,
    /// What has to be added to its module time to get that of the first host, ns.
    pub shift_ns: i64,
}

fn first() -> u32 {
    1
}

fn is_first(start: &u32) -> bool {
    *start == first()
}

impl Host {
    /// A module that has not been started before.
    #[must_use]
    pub fn of_module(module: &str) -> Self {
        Self { module: module.to_owned(), start: first(), shift_ns: 0 }
    }

    /// The module's name; for its second start with `.2`, and so on. No name of a module has a dot.
    #[must_use]
    pub fn name(&self) -> String {
        if is_first(&self.start) { self.module.clone() } else { format!("{}.{}", self.module, self.start) }
    }

    /// A module time of this host in that of the first one, ns.
    #[must_use]
    pub fn time_ns(&self, own_ns: u64) -> u64 {
        // What happened before the first host's time 0 happened at 0, for all who can only count from there.
        own_ns.saturating_add_signed(self.shift_ns)
    }
}

/// The hosts of a flight's folder, the one whose time counts first; empty if it flew on one.
pub fn of(folder: &Path) -> Vec<Host> {
    let text = std::fs::read(folder.join(FILE)).ok();
    text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
}

/// The folders of the modules of a run of several, by name, whether or not a flight has joined their times; empty if there was one.
pub fn folders_in(folder: &Path) -> Vec<PathBuf> {
    let all =
        std::fs::read_dir(folder.join(FOLDER)).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut folders: Vec<PathBuf> = all.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
}

/// The folder of a host.
pub fn folder_of(folder: &Path, host: &Host) -> PathBuf {
    folder.join(FOLDER).join(host.name())
}
