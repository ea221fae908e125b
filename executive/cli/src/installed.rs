//! Where a package put things, and where what was installed writes to. Programs of a package lie together in `PREFIX/lib/bateleur`, so that
//! each finds the others beside itself; everything else is told from there. A program that was built and not installed knows the
//! folder that it is started in, and nothing else.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::builder::{OsStringValueParser, TypedValueParser};

/// The schedule file that every verb takes where none is named.
pub const SCHEDULE: &str = "schedule.toml";
/// Where programs lie, from the prefix.
const PROGRAMS: &str = "lib/bateleur";
/// Packages of a distribution have this prefix; their settings lie in `/etc`.
const DISTRIBUTION: &str = "/usr";

/// A package's folders.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Installed {
    prefix: PathBuf,
}

impl Installed {
    /// That of this program; `None`: it was built here and not installed.
    #[must_use]
    pub fn here() -> Option<Self> {
        // The kernel's name of it, which is behind the link in `PREFIX/bin`.
        Self::with(&std::env::current_exe().ok()?)
    }

    fn with(program: &Path) -> Option<Self> {
        let folder = program.parent()?;
        folder
            .ends_with(PROGRAMS)
            .then(|| folder.ancestors().nth(2).map(|prefix| Self { prefix: prefix.to_owned() }))?
    }

    /// What an administrator edits: `/etc/bateleur`, or `PREFIX/etc/bateleur` of another prefix than that of distributions.
    #[must_use]
    pub fn settings(&self) -> PathBuf {
        let root = if self.prefix == Path::new(DISTRIBUTION) { Path::new("/") } else { &self.prefix };
        root.join("etc/bateleur")
    }

    /// The crates that a partition links, where they are installed.
    #[must_use]
    pub fn library(&self) -> PathBuf {
        self.prefix.join("share/bateleur")
    }
}

/// A schedule file as it is given to a verb: where [`SCHEDULE`] is not in this folder, it is the package's.
#[must_use]
pub fn schedule() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(|given: OsString| schedule_for(given.into(), Installed::here().as_ref()))
}

/// The schedule file of a verb that was given none.
#[must_use]
pub fn usual_schedule() -> PathBuf {
    schedule_for(SCHEDULE.into(), Installed::here().as_ref())
}

fn schedule_for(given: PathBuf, installed: Option<&Installed>) -> PathBuf {
    if given != Path::new(SCHEDULE) || given.exists() {
        return given;
    }
    let packaged = installed.map(|installed| installed.settings().join(SCHEDULE));
    packaged.filter(|path| path.is_file()).unwrap_or(given)
}

/// The folder for runs, flights or campaigns that nobody named another one for: `target/KIND`, as beside everything else that a checkout or a
/// project makes. A program of a package that is started anywhere else writes to where an ordinary user's state belongs:
/// `$XDG_STATE_HOME/bateleur/KIND`, or `~/.local/state/bateleur/KIND`.
#[must_use]
pub fn outputs(kind: &str) -> PathBuf {
    let is_project = Path::new("Cargo.toml").exists() || Path::new("target").exists();
    let variable = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = variable("XDG_STATE_HOME").or_else(|| variable("HOME").map(|home| home.join(".local/state")));
    outputs_of(kind, Installed::here().is_some() && !is_project, state)
}

/// The folder of the newest run, and of a run that was given none.
pub(crate) fn latest_run() -> PathBuf {
    outputs("runs").join("latest")
}

fn outputs_of(kind: &str, apart: bool, state: Option<PathBuf>) -> PathBuf {
    let usual = || Path::new("target").join(kind);
    if apart { state.map_or_else(usual, |state| state.join("bateleur").join(kind)) } else { usual() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_a_package_are_told_from_the_programs_place() {
        let with = |program: &str| Installed::with(Path::new(program));
        let distribution = with("/usr/lib/bateleur/bateleur").unwrap();
        assert_eq!(distribution.settings(), Path::new("/etc/bateleur"));
        assert_eq!(distribution.library(), Path::new("/usr/share/bateleur"));
        let local = with("/opt/avionics/lib/bateleur/bateleur").unwrap();
        assert_eq!(local.settings(), Path::new("/opt/avionics/etc/bateleur"));
        assert_eq!(local.library(), Path::new("/opt/avionics/share/bateleur"));
        for built in ["/home/a/bateleur/target/release/bateleur", "/usr/bin/bateleur", "bateleur", "/"] {
            assert_eq!(with(built), None, "{built}");
        }
    }

    #[test]
    fn packages_schedule_is_taken_only_where_there_is_none_and_none_was_named() {
        let prefix = tempfile::tempdir().unwrap();
        let installed = Installed { prefix: prefix.path().to_owned() };
        let usual = || PathBuf::from(SCHEDULE);
        // A test is started in its crate's folder, where there is no schedule.
        assert_eq!(schedule_for(usual(), Some(&installed)), usual(), "the package has none");
        std::fs::create_dir_all(installed.settings()).unwrap();
        let packaged = installed.settings().join(SCHEDULE);
        std::fs::write(&packaged, "").unwrap();
        assert_eq!(schedule_for(usual(), Some(&installed)), packaged);
        assert_eq!(schedule_for(usual(), None), usual());
        assert_eq!(schedule_for("./schedule.toml".into(), Some(&installed)), Path::new("./schedule.toml"));
        let other = prefix.path().join("other/schedule.toml");
        assert_eq!(schedule_for(other.clone(), Some(&installed)), other);
    }

    #[test]
    fn output_of_a_package_goes_to_the_users_state_and_never_to_nowhere() {
        let state = || Some(PathBuf::from("/home/a/.local/state"));
        let of = |apart, state| outputs_of("flights", apart, state);
        assert_eq!(of(true, state()), Path::new("/home/a/.local/state/bateleur/flights"));
        assert_eq!(of(false, state()), Path::new("target/flights"));
        assert_eq!(of(true, None), Path::new("target/flights"));
    }
}
