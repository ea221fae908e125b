//! Partitions in C, compiled by the machine's compiler as a user would compile them.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::programs::repository;

/// The folder of the libraries for C, `libbateleur_apex_c.a` and `.so`, which were built with the tests.
pub fn c_library() -> PathBuf {
    let own = std::env::current_exe().unwrap();
    let folder = own.parent().unwrap().to_owned(); // target/release/deps
    assert!(folder.join("libbateleur_apex_c.a").is_file(), "no library for C in {}", folder.display());
    folder
}

/// Compiles `tests/c/NAME.c` into a program in `folder`, which every partition may enter from here on.
#[track_caller]
pub fn compile_c(source: &str, folder: &Path, name: &str, flags: &[&str]) -> PathBuf {
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)).unwrap();
    let (to, sources) = (folder.join(name), repository().join("tests/c"));
    let mut command = Command::new("cc");
    command
        .args([
            "-std=c99",
            "-O1",
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
            "-fstack-clash-protection",
            "-Wl,--gc-sections",
        ])
        .args((!flags.contains(&"-g")).then_some("-s"))
        .args(flags)
        .arg("-I")
        .arg(repository().join("partitions/apex_c/include"))
        .arg(sources.join(format!("{source}.c")))
        .arg(c_library().join("libbateleur_apex_c.a"))
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(&to);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{source}.c: {}", String::from_utf8_lossy(&output.stderr));
    to
}
