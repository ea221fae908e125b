//! What the verbs that read the notes of a run have in common: which file, and which of its notes.

use std::path::{Path, PathBuf};

use super::Format;
use crate::installed;

/// Which notes of a run are printed, and how.
#[derive(Debug, clap::Args)]
pub(super) struct Notes {
    /// The folder of a run, or the file itself [default: target/runs/latest].
    #[arg(value_name = "FOLDER|FILE")]
    path: Option<PathBuf>,
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
    /// The file that was named, or the one called `name` in the folder of the run.
    pub(super) fn file(&self, name: &str) -> PathBuf {
        let given = self.path.clone().unwrap_or_else(installed::latest_run);
        if given.is_dir() { given.join(name) } else { given }
    }

    /// The folder or file that was named.
    pub(super) fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Leaves the newest of those that are about the partition.
    pub(super) fn choose<T>(&self, all: &mut Vec<T>, partition_of: impl Fn(&T) -> &str) {
        all.retain(|one| self.partition.as_deref().is_none_or(|name| name == partition_of(one)));
        let surplus = all.len().saturating_sub(self.last.unwrap_or(usize::MAX));
        all.drain(..surplus);
    }
}
