//! Runs what the project's pages tell people to type, each block in a copy of what it needs, and compares what comes of it.
//!
//! Responsible for: README and the book telling the truth about commands. It must never touch the project's own folder: a block
//! runs in a folder of its own, in which the schedules, the airframes and the built programs lie.

use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::blocks::{Block, Shown, blocks};
use crate::links::files;

/// Longest time for one command: many times what any of them takes, but for building a new partition with all that is below.
const PATIENCE: Duration = Duration::from_secs(300);

/// What the shell finds as `cargo`. The programs are built already; a crate that a page makes is built, where the tests of such
/// crates build theirs, as these do (`tests/src/crates.rs`), and finds the result in its own folder.
fn cargo_of_a_page(programs: &Path, cargo: &Path) -> String {
    let built = programs.parent().unwrap_or(programs).join("new-partition");
    format!(
        "#!/bin/sh\ncase \"$1 $3\" in\n\
         'fly '*) shift; exec bateleur fly \"$@\" ;;\n\
         'build --manifest-path')\n  \
         CARGO_TARGET_DIR='{built}' CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_DEBUG=none \
         '{cargo}' \"$@\" --offline --quiet || exit\n  \
         ln -s '{built}' \"$(dirname \"$4\")/target\" ;;\n\
         'build '*) exit 0 ;;\n\
         *) echo \"cargo $1 is not run here\" >&2; exit 2 ;;\nesac\n",
        built = built.display(),
        cargo = cargo.display(),
    )
}

/// The cargo that started this program, by its path: its bare name would be the pages' own one, which would call itself for
/// ever.
///
/// # Errors
/// It was not started by cargo.
pub(crate) fn own_cargo(said: Option<OsString>) -> Result<PathBuf, String> {
    said.map(PathBuf::from).filter(|path| path.is_absolute()).ok_or_else(|| {
        "the pages' commands need the cargo that builds them, and nobody said where it is (CARGO): start this by \
         `cargo run --release -p tasks -- commands`, or by `cargo verify`"
            .into()
    })
}

/// Every page's blocks; gives how many were run, how many were not, and what is wrong.
pub(crate) fn check(root: &Path, programs: &Path, cargo: &Path) -> Result<(usize, usize), Vec<String>> {
    let mut pages = vec![root.join("README.md")];
    pages.extend(files(&root.join("docs/src"), ".md"));
    let (mut run, mut left, mut faults) = (0, 0, Vec::new());
    for page in pages {
        let text = fs::read_to_string(&page).unwrap_or_default();
        let name = page.strip_prefix(root).unwrap_or(&page).display().to_string();
        for block in blocks(&text) {
            let place = format!("{name}:{}", block.line);
            faults.extend(
                block.unknown.iter().map(|word| format!("{place}: no directive is called \"{word}\"")),
            );
            if block.not_run.is_some() {
                left += 1;
                continue;
            }
            run += 1;
            if let Err(fault) = run_block(root, programs, cargo, &block) {
                faults.push(format!("{place}: {fault}"));
            }
        }
    }
    if faults.is_empty() { Ok((run, left)) } else { Err(faults) }
}

fn run_block(root: &Path, programs: &Path, cargo: &Path, block: &Block) -> Result<(), String> {
    let place = Place::make(root, programs, cargo)
        .map_err(|error| format!("cannot make a folder to try it in: {error}"))?;
    for command in &block.before {
        place.run(command, 0).map_err(|fault| format!("before it: {fault}"))?;
    }
    block.commands.iter().try_for_each(|shown| try_one(&place, block, shown))
}

fn try_one(place: &Place, block: &Block, shown: &Shown) -> Result<(), String> {
    let said = place.run(&shown.command, block.exit)?;
    block.compare(&shown.output, &said).map_err(|line| {
        format!("`{}` does not say what the page shows: {line}\nit says:\n{said}", shown.command)
    })
}

/// A folder in which a block may do what it likes; removed when dropped.
struct Place(PathBuf);

impl Place {
    fn make(root: &Path, programs: &Path, cargo: &Path) -> std::io::Result<Self> {
        static NUMBER: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("bateleur-pages-{}-{number}", std::process::id()));
        fs::create_dir_all(folder.join("bin"))?;
        let place = Self(folder);
        let inside = &place.0;
        fs::create_dir_all(inside.join("target"))?;
        symlink(programs, inside.join("target/release"))?;
        symlink(programs.join("bateleur"), inside.join("bin/bateleur"))?;
        fs::write(inside.join("bin/cargo"), cargo_of_a_page(programs, cargo))?;
        fs::set_permissions(inside.join("bin/cargo"), fs::Permissions::from_mode(0o755))?;
        fs::copy(root.join("schedule.toml"), inside.join("schedule.toml"))?;
        for folder in ["airframes", "schedules"] {
            fs::create_dir_all(inside.join(folder))?;
            for file in files(&root.join(folder), ".toml") {
                fs::copy(&file, inside.join(folder).join(file.file_name().unwrap_or_default()))?;
            }
        }
        Ok(place)
    }

    /// What a command says on both outputs, if it ends with `exit`.
    fn run(&self, command: &str, exit: i32) -> Result<String, String> {
        let path = std::env::var("PATH").unwrap_or_default();
        let said = self.0.join("said");
        let out = fs::File::create(&said).map_err(|error| error.to_string())?;
        let errors = out.try_clone().map_err(|error| error.to_string())?;
        let mut child = Command::new("sh")
            .args(["-c", command])
            .current_dir(&self.0)
            .env("PATH", format!("{}:{path}", self.0.join("bin").display()))
            .stdin(Stdio::null())
            .stdout(out)
            .stderr(errors)
            .process_group(0)
            .spawn()
            .map_err(|error| format!("no shell can be started: {error}"))?;
        let begun = Instant::now();
        let status = loop {
            match child.try_wait() {
                Ok(Some(status)) => break Some(status),
                Ok(None) if begun.elapsed() < PATIENCE => thread::sleep(Duration::from_millis(10)),
                _ => break None,
            }
        };
        let text = || String::from_utf8_lossy(&fs::read(&said).unwrap_or_default()).into_owned();
        match status {
            Some(status) if status.code() == Some(exit) => Ok(text()),
            Some(status) => {
                Err(format!("`{command}` ended with {status} in place of {exit}; it says:\n{}", text()))
            }
            None => {
                let group = format!("-{}", child.id());
                let _ = Command::new("kill").args(["-KILL", "--", &group]).status(); // it has ended meanwhile
                let _ = child.wait();
                Err(format!("`{command}` takes longer than {} s; it says:\n{}", PATIENCE.as_secs(), text()))
            }
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0); // the system clears its temporary folder in time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A project of one page, whose program says "hello" and ends well.
    fn project(page: &str) -> PathBuf {
        let root =
            std::env::temp_dir().join(format!("bateleur-commands-{}-{}", std::process::id(), page.len()));
        for folder in ["docs/src", "airframes", "schedules", "built"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        fs::write(root.join("README.md"), page).unwrap();
        fs::write(root.join("schedule.toml"), "a = 1\n").unwrap();
        fs::write(root.join("airframes/one.toml"), "").unwrap();
        fs::write(root.join("built/bateleur"), "#!/bin/sh\necho hello $*\n").unwrap();
        fs::set_permissions(root.join("built/bateleur"), fs::Permissions::from_mode(0o755)).unwrap();
        root
    }

    fn checked(page: &str) -> Result<(usize, usize), Vec<String>> {
        let root = project(page);
        let result = check(&root, &root.join("built"), Path::new(env!("CARGO")));
        assert_eq!(
            fs::read_to_string(root.join("schedule.toml")).unwrap(),
            "a = 1\n",
            "the project is untouched"
        );
        fs::remove_dir_all(&root).unwrap();
        result
    }

    #[test]
    fn commands_find_the_programs_the_schedule_and_cargo() {
        let page = "<!-- before: sed -i s/1/2/ schedule.toml -->\n```console\n$ cargo fly --fast # comment\nhello fly --fast\n\
                    $ cat schedule.toml\na = 2\n$ target/release/bateleur check\nhello check\n$ ls airframes\none.toml\n```\n\
                    ```console not run, takes minutes\n$ sleep 1000\n```\n";
        assert_eq!(checked(page), Ok((1, 1)));
    }

    #[test]
    fn without_a_cargo_that_is_not_the_pages_own_nothing_is_run() {
        for said in [None, Some("cargo".into())] {
            let why = own_cargo(said).unwrap_err();
            assert!(why.contains("cargo run --release -p tasks -- commands"), "{why}");
        }
        assert_eq!(own_cargo(Some("/x/cargo".into())), Ok("/x/cargo".into()));
    }

    #[test]
    fn a_crate_that_a_page_makes_is_really_built() {
        let page = "```console exit 101\n$ cargo build --release --manifest-path nowhere/Cargo.toml\n```\n\
                    ```console\n$ cargo build --release --workspace --bins\n```\n";
        assert_eq!(checked(page), Ok((2, 0)));
    }

    #[test]
    fn wrong_exit_code_wrong_output_and_wrong_directive_are_told_with_their_place() {
        let page = "# Page\n\n```console\n$ false\n```\n\n```console\n$ bateleur ps\ngoodbye\n```\n```console exit one\n$ true\n```\n";
        let faults = checked(page).unwrap_err();
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(faults[0].starts_with("README.md:3: `false` ended with"), "{faults:?}");
        assert!(
            faults[1].starts_with("README.md:7: `bateleur ps` does not say what the page shows: goodbye"),
            "{faults:?}"
        );
        assert!(faults[2].starts_with("README.md:11: no directive is called \"exit one\""), "{faults:?}");
    }
}
