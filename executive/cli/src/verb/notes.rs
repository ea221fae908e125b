//! What the verbs that read the notes of a run have in common: which file, and which of its notes.

use std::path::{Path, PathBuf};

use super::Format;
use crate::installed;

/// The file that was named, or the one called `name` in the folder of a run.
pub(super) fn file_of(path: Option<&Path>, name: &str) -> PathBuf {
    let given = path.map_or_else(installed::latest_run, Path::to_owned);
    if given.is_dir() { given.join(name) } else { given }
}

/// Which notes of a run are printed, and how.
#[derive(Debug, clap::Args)]
pub(super) struct Notes {
    /// Only what is about this partition.
    #[arg(long, short)]
    pub(super) partition: Option<String>,
    /// Only the newest entries.
    #[arg(long, short = 'n', value_name = "NUMBER")]
    last: Option<usize>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    pub(super) format: Format,
}

impl Notes {
    /// Leaves the newest of those that are about the partition.
    pub(super) fn choose<T>(&self, all: &mut Vec<T>, partition_of: impl Fn(&T) -> &str) {
        all.retain(|one| self.partition.as_deref().is_none_or(|name| name == partition_of(one)));
        let surplus = all.len().saturating_sub(self.last.unwrap_or(usize::MAX));
        all.drain(..surplus);
    }
}
