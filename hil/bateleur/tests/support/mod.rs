//! Runs the program and compares what it prints with texts that are kept.

// Each test file uses a part of it.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The top of the repository.
pub(crate) fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// What the program did.
pub(crate) struct Ended {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs the program in the repository.
pub(crate) fn bateleur(arguments: &[&str]) -> Ended {
    bateleur_in(&repository(), arguments)
}

/// Runs the program in a folder.
pub(crate) fn bateleur_in(folder: &Path, arguments: &[&str]) -> Ended {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bateleur"));
    // As wide as on a terminal that says nothing of itself.
    command.current_dir(folder).args(arguments).env_remove("COLUMNS");
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Ended { code: status.code().unwrap(), stdout: text(stdout), stderr: text(stderr) }
}

/// Compares a text with the one kept under `golden/`; with `BLESS=1` in the environment it is written instead.
#[track_caller]
pub(crate) fn assert_golden(name: &str, text: &str) {
    assert_kept(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name), text);
}

/// As [`assert_golden`], with a file anywhere in the repository.
#[track_caller]
pub(crate) fn assert_kept(path: &Path, text: &str) {
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(path, text).unwrap();
        return;
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    assert!(kept == text, "{} differs; run again with BLESS=1 if this is meant:\n{text}", path.display());
}
