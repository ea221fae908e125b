//! Text files that are made from templates, which lie in the folder `templates` of this crate.
//!
//! Responsible for: one way to fill them in. What they say is theirs.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use anyhow::{Context, Result, bail};
use minijinja::{Environment, UndefinedBehavior};
use serde::Serialize;

/// One file: its path below a folder, its text.
pub(crate) type Written = (&'static str, String);

/// A template with its places filled in.
pub(crate) fn filled(template: &str, values: &impl Serialize) -> Result<String> {
    let mut environment = Environment::new();
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.set_keep_trailing_newline(true);
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.render_str(template, values).context("a template of this program can not be filled in")
}

/// Fails where one of the files is there already.
pub(crate) fn refuse_to_overwrite(folder: &Path, files: &[Written]) -> Result<()> {
    let there: Vec<&str> =
        files.iter().map(|(name, _)| *name).filter(|name| folder.join(name).exists()).collect();
    if there.is_empty() {
        return Ok(());
    }
    bail!(
        "{} has {} already, and nothing is written over: name another folder, or move {} away",
        folder.display(),
        there.join(", "),
        if there.len() == 1 { "it" } else { "them" }
    )
}

/// Writes files below a folder, each a new one.
pub(crate) fn write(folder: &Path, files: &[Written]) -> Result<()> {
    for (name, text) in files {
        let path = folder.join(name);
        let parent = path.parent().unwrap_or(folder);
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot make the folder {}", parent.display()))?;
        // Also where somebody was quicker: never over a file.
        let mut file =
            std::fs::File::create_new(&path).with_context(|| format!("cannot write {}", path.display()))?;
        std::io::Write::write_all(&mut file, text.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// Lets everybody run a script that was written.
pub(crate) fn make_a_program(script: &Path) -> Result<()> {
    std::fs::set_permissions(script, Permissions::from_mode(0o755))
        .with_context(|| format!("cannot make {} a program", script.display()))
}
