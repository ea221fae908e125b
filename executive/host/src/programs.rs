//! Where programs lie.

use std::path::{Path, PathBuf};

/// Where a partition's program lies: a path counts from the schedule file's `folder`, a name from where this program lies.
#[must_use]
pub fn program_path(program: &str, folder: &Path) -> PathBuf {
    if program.contains('/') { folder.join(program) } else { beside_own(program) }
}

/// Where a program of the project lies: beside this one.
#[must_use]
pub fn beside_own(program: &str) -> PathBuf {
    let own = std::env::current_exe().ok();
    own.as_deref().and_then(Path::parent).unwrap_or(Path::new("")).join(program)
}
