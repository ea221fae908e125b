//! What the verbs that read the notes of a run have in common: which file, and which of its notes.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use bateleur_monitor::health::ring::FILE;
use bateleur_recording::hosts;

use super::Format;
use crate::installed;

/// The file that was named, or the one called `name` in the folder of a run.
///
/// # Errors
/// The folder has none, but those of several modules.
pub(super) fn file_of(path: Option<&Path>, name: &str) -> Result<PathBuf> {
    let given = path.map_or_else(installed::latest_run, Path::to_owned);
    if !given.is_dir() {
        return Ok(given);
    }
    let file = given.join(name);
    let written = |path: &Path| path.metadata().and_then(|about| about.modified()).ok();
    match hosts::folders_in(&given).first() {
        // A module alone may have run there before, or since: each run begins a health log.
        Some(first) if written(&given.join(FILE)) < written(&first.join(FILE)) || !file.exists() => bail!(
            "{} holds the runs of several modules: name the folder of one, such as {}",
            given.display(),
            first.display()
        ),
        _ => Ok(file),
    }
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
