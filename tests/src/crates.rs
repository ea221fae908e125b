//! Crates and projects that `bateleur` makes, built with a target folder of their own beside that of the programs: a copy of the checkout
//! in the usual one would have everything built anew, there and back.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::programs::program;

/// Where everything of these is built.
pub fn crates_target() -> PathBuf {
    program("bateleur").ancestors().nth(2).unwrap().join("new-partition")
}

/// An empty folder outside of any checkout; of the same name each time, so that what was built for it is of use again.
pub fn empty_folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join("bateleur-new-partition").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Makes `to` a copy of a folder, without `target` and what is hidden. What is the same is not touched, so that it is not built again; what
/// an earlier run has left is removed.
pub fn copy(from: &Path, to: &Path) {
    if !from.is_dir() {
        let text = fs::read(from).unwrap();
        if fs::read(to).ok().as_ref() != Some(&text) {
            fs::write(to, text).unwrap();
            fs::set_permissions(to, fs::metadata(from).unwrap().permissions()).unwrap();
        }
        return;
    }
    fs::create_dir_all(to).unwrap();
    let names = |folder: &Path| {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        entries
            .filter(|name| name != "target" && !name.to_string_lossy().starts_with('.'))
            .collect::<Vec<_>>()
    };
    let wanted = names(from);
    for name in names(to).into_iter().filter(|name| !wanted.contains(name)) {
        let path = to.join(name);
        if path.is_dir() { fs::remove_dir_all(path).unwrap() } else { fs::remove_file(path).unwrap() }
    }
    wanted.iter().for_each(|name| copy(&from.join(name), &to.join(name)));
}

/// A command in `folder` that builds into [`crates_target`], without a network.
pub fn building(program: &str, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command.current_dir(folder).env("CARGO_TARGET_DIR", crates_target()).env("CARGO_NET_OFFLINE", "true");
    // What is built is judged by what it does, not by how fast.
    command.env("CARGO_PROFILE_RELEASE_OPT_LEVEL", "0").env("CARGO_PROFILE_RELEASE_DEBUG", "none");
    // What the cargo that runs this test says of its own package.
    for (name, _) in
        std::env::vars().filter(|(name, _)| name.starts_with("CARGO_PKG") || name == "CARGO_MANIFEST_DIR")
    {
        command.env_remove(name);
    }
    command
}

/// Has cargo do something in `folder`; fails with what it says.
#[track_caller]
pub fn cargo(folder: &Path, arguments: &[&str]) {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    expect_success(building(&cargo, folder).args(arguments));
}

/// Runs a command to its end, which has to be a good one; gives what it printed.
#[track_caller]
pub fn expect_success(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, errors) = (said(&output.stdout), said(&output.stderr));
    assert!(output.status.success(), "{command:?}:\n{out}{errors}");
    out
}
