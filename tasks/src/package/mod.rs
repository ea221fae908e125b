//! `package`: Debian packages, `bateleur` and `bateleur-dev`, for both kinds of processor. Programs are built with the profile `dist`, or
//! taken from a folder (`--programs`), as the tests do. `dpkg-deb` writes the archives: it sorts, and gives every file the
//! commit's time, so that one commit makes one package, to the byte.

mod contents;
mod development;
mod licences;
mod tree;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::{CANNOT_RUN, cargo, fly};
use tree::Tree;

const USAGE: &str = "usage: cargo run --release -p tasks -- package [--arch amd64|arm64] [--programs FOLDER] [--output FOLDER]";
/// How programs of a package are built.
const PROFILE: &str = "dist";
/// Where programs of a package say that they were built, wherever that was.
const BUILT_IN: &str = "/usr/src/bateleur";
/// What the packages install; one build, so that all programs are of the same crates.
const BUILT: [&str; 10] = [
    "bateleur",
    "bateleur-daemon",
    "bateleur-channels",
    "bateleur-relay",
    "bateleur-can",
    "bateleur-can-board",
    "bateleur-simulator",
    "bateleur-together",
    "bateleur-apex-c",
    "bateleur-message-format",
];

/// A kind of processor, by the names that different people gave it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Processor {
    Amd64,
    Arm64,
}

impl Processor {
    const ALL: [Self; 2] = [Self::Amd64, Self::Arm64];

    fn debian(self) -> &'static str {
        match self {
            Self::Amd64 => "amd64",
            Self::Arm64 => "arm64",
        }
    }

    fn target(self) -> &'static str {
        match self {
            Self::Amd64 => "x86_64-unknown-linux-gnu",
            Self::Arm64 => "aarch64-unknown-linux-gnu",
        }
    }

    /// Debian's name for the folder of its libraries, and the beginning of the names of its tools.
    fn triplet(self) -> &'static str {
        match self {
            Self::Amd64 => "x86_64-linux-gnu",
            Self::Arm64 => "aarch64-linux-gnu",
        }
    }

    fn is_own(self) -> bool {
        cfg!(target_arch = "aarch64") == (self == Self::Arm64)
    }
}

/// What was asked for.
#[derive(Debug, PartialEq)]
struct Asked {
    processors: Vec<Processor>,
    programs: Option<PathBuf>,
    output: Option<PathBuf>,
}

fn asked(arguments: &[OsString]) -> Option<Asked> {
    let mut asked = Asked { processors: Processor::ALL.to_vec(), programs: None, output: None };
    let mut named = false;
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        let value = words.next()?;
        match word.to_str()? {
            "--arch" => {
                asked.processors = vec![Processor::ALL.into_iter().find(|one| *value == *one.debian())?];
                named = true;
            }
            "--programs" => asked.programs = Some(value.into()),
            "--output" => asked.output = Some(value.into()),
            _ => return None,
        }
    }
    if asked.programs.is_some() && !named {
        asked.processors.retain(|one| one.is_own()); // a folder holds programs of one kind
    }
    Some(asked)
}

/// Everything that is needed to pack for one kind of processor.
struct Order<'a> {
    root: &'a Path,
    processor: Processor,
    /// Where the programs were built.
    programs: &'a Path,
    /// One that runs here: it writes its own manual and completions.
    bateleur: &'a Path,
    version: &'a str,
    /// Seconds since 1970: that of the commit.
    time: &'a str,
}

pub(crate) fn run(root: &Path, arguments: &[OsString]) -> ExitCode {
    let Some(asked) = asked(arguments) else {
        eprintln!("{USAGE}");
        return ExitCode::from(CANNOT_RUN);
    };
    match all(root, &asked) {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("package: {reason}");
            ExitCode::from(CANNOT_RUN)
        }
    }
}

fn all(root: &Path, asked: &Asked) -> Result<(), String> {
    let output = asked.output.clone().unwrap_or_else(|| root.join("target/packages"));
    let output = std::path::absolute(&output).map_err(|error| error.to_string())?;
    make_folder(&output)?;
    let (version, time) = (version(root)?, time(root)?);
    let own = fly::beside_self("bateleur").map_err(|error| error.to_string())?;
    for processor in &asked.processors {
        let programs = match &asked.programs {
            Some(folder) => folder.clone(),
            None => build(root, *processor)?,
        };
        let beside = programs.join("bateleur");
        let bateleur = if processor.is_own() { &beside } else { &own };
        if !bateleur.is_file() {
            return Err(format!(
                "there is no {}: build it with `cargo build --release -p bateleur`, which writes the manual",
                bateleur.display()
            ));
        }
        let order = Order {
            root,
            processor: *processor,
            programs: &programs,
            bateleur,
            version: &version,
            time: &time,
        };
        for lay in [contents::lay as Lay, development::lay] {
            let mut tree = Tree::new(&output.join("tree"))?;
            lay(&order, &mut tree)?;
            let (file, bytes) = tree.pack(&output, &order)?;
            println!("{} ({:.1} MB, installed {:.1} MB)", file.display(), bytes.0, bytes.1);
        }
    }
    Ok(())
}

/// Lays the files of a package.
type Lay = fn(&Order<'_>, &mut Tree) -> Result<(), String>;

/// Builds the programs; nothing in them tells where.
fn build(root: &Path, processor: Processor) -> Result<PathBuf, String> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(Path::new(&std::env::var_os("HOME")?).join(".cargo")));
    let home = home.ok_or("neither CARGO_HOME nor HOME says where cargo keeps the sources of crates")?;
    let remap = |from: &Path, to: &str| format!("--remap-path-prefix={}={to}", from.display());
    let flags = [remap(&home, "/usr/src/cargo"), remap(root, BUILT_IN)].join("\u{1f}");
    let mut command = Command::new(cargo());
    command.current_dir(root).args([
        "build",
        "--locked",
        "--profile",
        PROFILE,
        "--target",
        processor.target(),
    ]);
    command.args(BUILT.iter().flat_map(|name| ["--package", name]));
    command.env("CARGO_ENCODED_RUSTFLAGS", flags).env("BATELEUR_BUILT_FROM", BUILT_IN);
    command.env("CARGO_INCREMENTAL", "0");
    if !processor.is_own() {
        let variable = format!("CARGO_TARGET_{}_LINKER", processor.target().to_uppercase().replace('-', "_"));
        command.env(variable, format!("{}-gcc", processor.triplet()));
    }
    succeed(&mut command)?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    Ok(target.join(processor.target()).join(PROFILE))
}

/// The workspace's version, which is that of the packages.
fn version(root: &Path) -> Result<String, String> {
    let manifest = read(&root.join("Cargo.toml"))?;
    let value = manifest.split("[workspace.package]").nth(1).and_then(|rest| {
        let line = rest.lines().find_map(|line| line.strip_prefix("version = \""))?;
        line.strip_suffix('"')
    });
    value.map(str::to_owned).ok_or_else(|| "Cargo.toml has no version of the workspace".into())
}

/// `SOURCE_DATE_EPOCH`, or the time of the commit.
fn time(root: &Path) -> Result<String, String> {
    if let Ok(time) = std::env::var("SOURCE_DATE_EPOCH") {
        return Ok(time);
    }
    let mut git = Command::new("git");
    git.arg("-C").arg(root).args(["log", "-1", "--format=%ct"]);
    words_of(&mut git).map(|text| text.trim().to_owned()).map_err(|reason| {
        format!("{reason}; without a repository SOURCE_DATE_EPOCH says the time that the files get")
    })
}

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|error| format!("cannot read {}: {error}", path.display()))
}

fn make_folder(path: &Path) -> Result<(), String> {
    std::fs::create_dir_all(path)
        .map_err(|error| format!("cannot make the folder {}: {error}", path.display()))
}

fn succeed(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|error| format!("cannot start {command:?}: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("{command:?} failed")) }
}

/// What a command prints.
fn words_of(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| format!("cannot start {command:?}: {error}"))?;
    if !output.status.success() {
        return Err(format!("{command:?} failed: {}", String::from_utf8_lossy(&output.stderr).trim()));
    }
    String::from_utf8(output.stdout).map_err(|error| format!("{command:?}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(words: &str) -> Option<Asked> {
        asked(&words.split_whitespace().map(OsString::from).collect::<Vec<_>>())
    }

    #[test]
    fn both_kinds_are_packed_unless_one_is_named_or_programs_are_there() {
        assert_eq!(given("").unwrap().processors, Processor::ALL);
        assert_eq!(given("--arch arm64 --programs x").unwrap().processors, [Processor::Arm64]);
        let own = given("--programs x").unwrap().processors;
        assert!(matches!(own[..], [one] if one.is_own()), "{own:?}");
        for wrong in ["--arch", "--arch i386", "--what x", "x"] {
            assert_eq!(given(wrong), None, "{wrong}");
        }
    }
}
