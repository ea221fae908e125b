//! `bateleur key FILE`: makes the key of a link, of the kernel's random numbers, for its owner alone (mode 0600).
//!
//! The same file belongs on both hosts of the link: carry it over a way that you trust, such as `scp`. A file that is there
//! already is left alone. In a work tree of git the file is ignored from then on. Exit codes: 0 it was made, 2 it could not be.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result};
use bateleur_host::keys;

use super::{Code, FINE};

/// Make the key of a link.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The file to make, such as keys/nav.key: what the schedule file calls `key`, relative to it.
    file: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let file = &arguments.file;
    if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    // Before there is a key: git must never see one.
    if let Some(ignore) = hide(file).with_context(|| format!("cannot hide {} from git", file.display()))? {
        println!("{}: names it, so that git does not take it", ignore.display());
    }
    keys::make(file).with_context(|| format!("cannot make {}", file.display()))?;
    println!("{}: the key of a link; the other host needs the same file", file.display());
    Ok(FINE)
}

/// Has git ignore a file in one of its work trees, unless it does already; gives what says so.
fn hide(file: &Path) -> std::io::Result<Option<PathBuf>> {
    let (Some(folder), Some(name)) =
        (std::path::absolute(file)?.parent().map(Path::to_owned), file.file_name())
    else {
        return Ok(None);
    };
    let in_work_tree = folder.ancestors().any(|above| above.join(".git").exists());
    if !in_work_tree || file.exists() || is_ignored(&folder, Path::new(name)) {
        return Ok(None);
    }
    let ignore = folder.join(".gitignore");
    let before = std::fs::read_to_string(&ignore).unwrap_or_default();
    let gap = if before.is_empty() || before.ends_with('\n') { "" } else { "\n" };
    let mut text = OpenOptions::new().create(true).append(true).open(&ignore)?;
    writeln!(text, "{gap}/{}", name.to_string_lossy())?;
    Ok(Some(ignore))
}

/// Whether git ignores a file; not where there is no git.
fn is_ignored(folder: &Path, name: &Path) -> bool {
    let mut git = Command::new("git");
    git.args(["check-ignore", "--quiet"])
        .arg(name)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    git.status().is_ok_and(|status| status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_in_a_work_tree_is_ignored_once_and_elsewhere_nothing_is_written() {
        let place = tempfile::tempdir().unwrap();
        let key = place.path().join("keys/nav.key");
        std::fs::create_dir(place.path().join("keys")).unwrap();
        assert_eq!(hide(&key).unwrap(), None);
        std::fs::create_dir(place.path().join(".git")).unwrap();
        let ignore = place.path().join("keys/.gitignore");
        std::fs::write(&ignore, "/other.key").unwrap();
        assert_eq!(hide(&key).unwrap(), Some(ignore.clone()));
        assert_eq!(std::fs::read_to_string(&ignore).unwrap(), "/other.key\n/nav.key\n");
        std::fs::write(&key, "there").unwrap();
        assert_eq!(hide(&key).unwrap(), None, "one that is there is left alone");
    }
}
