//! `bateleur key FILE`: makes the key of a link, of the kernel's random numbers, for its owner alone (mode 0600).
//!
//! The same file belongs on both hosts of the link: carry it over a way that you trust, such as `scp`. A file that is there
//! already is left alone. Exit codes: 0 it was made, 2 it could not be.

use std::path::PathBuf;

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
    keys::make(file).with_context(|| format!("cannot make {}", file.display()))?;
    println!("{}: the key of a link; the other host needs the same file", file.display());
    Ok(FINE)
}
