//! `bateleur init`: makes a project of one's own: a workspace with a schedule file, two partitions, their messages, a health table,
//! tests with planned faults, and a script for CI. It is built and run as it is; `bateleur new` adds partitions to it.
//!
//! Exit codes: 0 written, 2 it can not be written.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;
use toml::Value;

use super::new::workspace::{Workspace, absolute, way};
use super::{Code, FINE};
use crate::templates::{Written, filled, make_a_program, refuse_to_overwrite, write};

/// Make a project of one's own: schedule, two partitions, messages, tests.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "For example: bateleur init tank, then in it: cargo build --release && bateleur run --fast --until 4\n\n\
    Exit codes: 0 written; 2 it can not be written."
)]
pub struct Arguments {
    /// Where the project goes.
    folder: PathBuf,
    /// The checkout of Bateleur, or the folder where it is installed, that the project's crates take the library from [default: the
    /// one around this program, or that it was installed with or built from].
    #[arg(long, value_name = "FOLDER")]
    library: Option<PathBuf>,
}

macro_rules! files {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_str!(concat!("../../templates/project/", $path)))),*]
    };
}

const FILES: &[(&str, &str)] = files![
    "Cargo.toml",
    "README.md",
    "schedule.toml",
    "messages/Level.msg",
    "messages/Valve.msg",
    "partitions/sensor/Cargo.toml",
    "partitions/sensor/src/main.rs",
    "partitions/watch/Cargo.toml",
    "partitions/watch/src/main.rs",
    "faults/Cargo.toml",
    "faults/lib.rs",
    "faults/tests/faults.rs",
    "ci",
];
/// Where git would read it, the repository of the templates would be meant.
const IGNORED: (&str, &str) = (".gitignore", include_str!("../../templates/project/gitignore"));
const SCRIPT: &str = "ci";

/// What the templates take.
#[derive(Serialize)]
struct Values {
    name: String,
    edition: String,
    rust_version: String,
    dependencies: String,
    profile: String,
    lints: String,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let here = std::env::current_dir().context("there is no current folder")?;
    let folder = absolute(&here, &arguments.folder);
    let library = Workspace::library(arguments.library.as_deref(), &folder)?;
    let values = Values::of(&folder, &library);
    let mut files = Vec::new();
    for (name, template) in FILES.iter().chain([&IGNORED]) {
        files.push((*name, filled(template, &values)?));
    }
    files.extend(library.shared());
    refuse_to_overwrite(&folder, &files)?;
    write(&folder, &files)?;
    make_a_program(&folder.join(SCRIPT))?;
    say(arguments, &library, &files);
    Ok(FINE)
}

fn say(arguments: &Arguments, library: &Workspace, files: &[Written]) {
    println!("{}: a project with the partitions `sensor` and `watch`", arguments.folder.display());
    files.iter().for_each(|(name, _)| println!("  {name}"));
    println!("it takes the library from {}\n", library.root.display());
    println!("go there:      cd {}", arguments.folder.display());
    println!("build it:      cargo build --release");
    println!("run it:        bateleur run --fast --until 4");
    println!("test it:       ./{SCRIPT}");
    println!("one partition more: bateleur new NAME --add, its ports in schedule.toml, bateleur new NAME");
}

impl Values {
    fn of(folder: &std::path::Path, library: &Workspace) -> Self {
        let common = |key: &str, default: &str| {
            let value = library.value(&["workspace", "package", key]).and_then(Value::as_str);
            value.unwrap_or(default).to_owned()
        };
        let root = way(folder, &library.root).display().to_string();
        let dependency = |package: &str| format!("{package} = {}", library.dependency(package, &root));
        Self {
            name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            edition: common("edition", "2024"),
            rust_version: common("rust-version", "1.89"),
            dependencies: ["bateleur-apex", "bateleur-messages", "zerocopy"].map(dependency).join("\n"),
            profile: library.profiles(),
            lints: library.table(&["workspace", "lints"], "workspace.lints"),
        }
    }
}
