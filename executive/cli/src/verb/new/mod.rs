//! `bateleur new`: writes the crate of a partition from what the schedule file says of it: ports, attributes, retained
//! memory, a standby. It builds and runs as it is; what the partition computes is left to its author.
//!
//! It never writes over a file. In a project (`bateleur init`) or a checkout of Bateleur the crate becomes a member of the workspace;
//! anywhere else it is a workspace of its own that takes the library from a checkout. Where the file has no such partition yet, it says what
//! to add, or adds it (`--add`).
//!
//! Exit codes: 0 written, 1 the schedule file has no such partition yet, 2 it can not be written.

mod c_text;
mod crate_text;
mod dependencies;
mod list;
mod names;
mod skeleton;
mod stanza;
mod values;
pub(super) mod workspace;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_checker::Violation;
use bateleur_contract::OUTVOTED_PORT;
use bateleur_plan::{Partition, PartitionId, Plan};

use super::{CANNOT_RUN, Code, FINE, WRONG};
use crate::plan_file;
use crate::templates::{Written, make_a_program, refuse_to_overwrite, write};
use dependencies::Dependencies;
use skeleton::Skeleton;
use workspace::{Home, Workspace};

/// In the library: the flight's message types.
const FLIGHT_MESSAGES: &str = "partitions/messages/msg";

/// Write the crate of a partition from what the schedule file says of it.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "For example: bateleur new height_watch --add, then its ports in schedule.toml, then: bateleur new height_watch\n\n\
    Exit codes: 0 written; 1 the schedule file has no such partition yet, and what to add is printed; 2 it can not be written."
)]
pub struct Arguments {
    /// The partition, as the schedule file calls it.
    partition: String,
    /// The schedule file.
    #[arg(long, short, value_name = "FILE", default_value = "schedule.toml")]
    schedule: PathBuf,
    /// Where the crate goes; in a project or a checkout of Bateleur it becomes a member of the workspace [default:
    /// partitions/PARTITION in the workspace that holds the schedule file, else PARTITION here].
    #[arg(long, short, value_name = "FOLDER")]
    dir: Option<PathBuf>,
    /// The checkout that a crate outside of any workspace takes the library from [default: the one that this program was built
    /// from].
    #[arg(long, value_name = "FOLDER")]
    library: Option<PathBuf>,
    /// Add the partition, without ports, and a window to the schedule file, and write no crate.
    #[arg(long, conflicts_with_all = ["dir", "library"])]
    add: bool,
    /// What it is written in; C needs what the package `bateleur-dev` installs.
    #[arg(long, value_enum, default_value_t = Language::Rust)]
    language: Language,
    /// The length of that window.
    #[arg(long, value_name = "TIME", default_value = "500us", value_parser = stanza::window_length)]
    window: u64,
    /// The module of a partition that is added; may be left out where the file has one.
    #[arg(long, short, value_name = "NAME")]
    module: Option<String>,
}

/// What a partition is written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Language {
    Rust,
    C,
}

impl Language {
    /// As it is asked for, where it is not the usual one.
    fn option(self) -> &'static str {
        if self == Self::C { " --language c" } else { "" }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let Some(plan) = read(arguments)? else { return Ok(CANNOT_RUN) };
    let name = &arguments.partition;
    match (plan.partition(name), arguments.add) {
        (Some(id), false) => match arguments.language {
            Language::Rust => write_crate(arguments, &plan, &as_programmed(&plan, id)),
            Language::C => write_c(arguments, &plan, &as_programmed(&plan, id)),
        },
        (Some(_), true) => bail!("{} has a partition `{name}` already", arguments.schedule.display()),
        (None, add) => {
            let wish = stanza::Wish {
                name,
                module: arguments.module.as_deref(),
                window_ns: arguments.window,
                program: program_of(arguments, name)?,
                // A partition in C has processes; one in Rust need not.
                processes: if arguments.language == Language::C { 1 } else { 0 },
                option: arguments.language.option(),
            };
            let missing = stanza::Missing::of(&plan, &wish)?;
            if add {
                stanza::add(&arguments.schedule, &missing)
            } else {
                say_missing(arguments, &plan, &missing)
            }
        }
    }
}

/// The plan; `None` if it breaks rules, which are printed. A message type that nobody knows may well be meant to come.
fn read(arguments: &Arguments) -> Result<Option<Plan>> {
    let (path, name) = (&arguments.schedule, &arguments.partition);
    match plan_file::read_among(path, None, false)? {
        Ok((plan, _)) => Ok(Some(plan)),
        Err(report) => {
            eprint!("{}", report.render(false));
            let names_it = |one: &Violation| {
                one.rule.starts_with("N04")
                    && one.message.contains(&format!("no partition is called `{name}`"))
            };
            if report.violations().iter().any(names_it) {
                eprintln!(
                    "nothing was added: take what names a port of `{name}` out, run `bateleur new {name} --add`, and put it \
                     back when `[partition.{name}.port]` has that port"
                );
            } else {
                eprintln!("nothing was written: mend that first");
            }
            Ok(None)
        }
    }
}

/// What the schedule file calls the program of a new partition: a project's programs lie in its target folder, those of a checkout
/// beside this program.
fn program_of(arguments: &Arguments, name: &str) -> Result<String> {
    let schedule = found(&arguments.schedule)?;
    Ok(match Workspace::around(&schedule).filter(|workspace| !workspace.is_checkout) {
        Some(project) => built(&schedule, &project.root, name),
        None => name.to_owned(),
    })
}

/// A program that cargo builds in `folder`, as a schedule file names it.
fn built(schedule: &Path, folder: &Path, program: &str) -> String {
    let built = folder.join("target/release").join(program);
    workspace::way(schedule.parent().unwrap_or(schedule), &built).display().to_string()
}

fn found(schedule: &Path) -> Result<PathBuf> {
    schedule.canonicalize().with_context(|| format!("cannot find {}", schedule.display()))
}

fn say_missing(arguments: &Arguments, plan: &Plan, missing: &stanza::Missing) -> Result<Code> {
    let (name, file) = (&arguments.partition, arguments.schedule.display());
    let near = crate::words::nearest(name, plan.partitions.iter().map(|partition| partition.name.as_str()));
    let hint = near.map_or_else(String::new, |near| format!(": did you mean `{near}`?"));
    eprintln!("there is no partition `{name}` in {file}{hint}\n");
    eprintln!("{}", missing.advice());
    eprintln!("`bateleur new {name} --add{}` writes that into the file.", arguments.language.option());
    Ok(WRONG)
}

/// The partition that the program is written for: of one with replicas, what each of them is. The voter is the executive's.
fn as_programmed(plan: &Plan, id: PartitionId) -> Partition {
    let voter = plan.voter_of(id).unwrap_or(id);
    let Some(&replica) = plan[voter].replicas.first() else { return plan[id].clone() };
    let mut partition = Partition { name: plan[voter].name.clone(), ..plan[replica].clone() };
    partition.ports.retain(|&port| plan[port].name != OUTVOTED_PORT);
    partition
}

fn write_crate(arguments: &Arguments, plan: &Plan, partition: &Partition) -> Result<Code> {
    let schedule = found(&arguments.schedule)?;
    let place = place(arguments, &schedule, &partition.name)?;
    let messages = plan_file::messages_folder(&schedule, &plan_file::read_text_of(&schedule)?);
    let messages = workspace::way(&place.folder, &messages).display().to_string();
    let skeleton = Skeleton::of(plan, partition, &messages)?;
    let dependencies = Dependencies::of(&skeleton, &place.home);
    let files = files(&skeleton, &dependencies, &place.home)?;
    refuse_to_overwrite(&place.folder, &files)?;
    if let Home::Member(workspace) = &place.home {
        workspace.refuse_a_second(&skeleton.program)?;
    }
    write(&place.folder, &files)?;
    println!("{}: the crate of partition `{}`", place.shown, skeleton.partition);
    for (name, _) in &files {
        println!("  {name}");
    }
    skeleton.notes().iter().for_each(|note| println!("note: {note}"));
    match &place.home {
        Home::Member(workspace) => say_next_inside(workspace, &place, &dependencies)?,
        Home::Alone(library) => say_next_outside(library, &place),
    }
    if let Some(built) =
        built_elsewhere(&place, &skeleton, &schedule).filter(|built| *built != partition.program)
    {
        println!("name it:   program = \"{built}\" in [partition.{}]", skeleton.partition);
    }
    println!("run it:    {}", run_command(arguments, plan, partition));
    println!("what to fill in: {}/src/main.rs", place.shown);
    Ok(FINE)
}

/// Source and build script of a partition in C.
fn write_c(arguments: &Arguments, plan: &Plan, partition: &Partition) -> Result<Code> {
    let schedule = found(&arguments.schedule)?;
    let (folder, shown) = folder(arguments, &schedule, &partition.name)?;
    let own = plan_file::messages_folder(&schedule, &plan_file::read_text_of(&schedule)?);
    let own = workspace::way(&folder, &own).display().to_string();
    let skeleton = Skeleton::of(plan, partition, &own)?;
    let mut folders: Vec<String> = skeleton.messages.iter().cloned().collect();
    if skeleton.has_flight_messages() {
        let library = Workspace::library(arguments.library.as_deref(), &schedule)?;
        folders.push(workspace::way(&folder, &library.root.join(FLIGHT_MESSAGES)).display().to_string());
    }
    let near = schedule.parent().unwrap_or(&schedule);
    // A name without a folder is looked for beside the executive's programs: those of a checkout are.
    let (program, name) = match (partition.program.contains('/'), Workspace::around(&folder)) {
        (true, _) => (workspace::absolute(near, Path::new(&partition.program)), None),
        (false, Some(workspace)) => {
            let name = built(&schedule, &workspace.root, &skeleton.program);
            let program = workspace.root.join("target/release").join(&skeleton.program);
            (program, (!workspace.is_checkout).then_some(name))
        }
        (false, None) => {
            let name = built(&schedule, &folder, &skeleton.program);
            (folder.join("target/release").join(&skeleton.program), Some(name))
        }
    };
    if program == folder {
        bail!(
            "the program `{}` would lie where its folder {shown} is: give it another place in the schedule file",
            partition.program
        );
    }
    let files = c_text::files(&skeleton, &workspace::way(&folder, &program).display().to_string(), &folders)?;
    refuse_to_overwrite(&folder, &files)?;
    write(&folder, &files)?;
    make_a_program(&folder.join(c_text::SCRIPT))?;
    println!("{shown}: partition `{}` in C", skeleton.partition);
    files.iter().for_each(|(name, _)| println!("  {name}"));
    skeleton.notes().iter().for_each(|note| println!("note: {note}"));
    if !skeleton.attributes.is_empty() {
        println!("note: it has attributes, and no service of ARINC 653 reads them");
    }
    if partition.processes.most == 0 {
        println!("note: it creates a process: put `processes = 1` into [partition.{}]", skeleton.partition);
    }
    println!("\nbuild it:  {}", quoted(format!("{shown}/{}", c_text::SCRIPT)));
    if let Some(name) = name {
        println!("name it:   program = \"{name}\" in [partition.{}]", skeleton.partition);
    }
    println!("run it:    {}", run_command(arguments, plan, partition));
    println!("what to fill in: {shown}/main.c");
    Ok(FINE)
}

/// What the schedule file has to call the program where it is not built beside this one.
fn built_elsewhere(place: &Place, skeleton: &Skeleton, schedule: &Path) -> Option<String> {
    let folder = match &place.home {
        Home::Member(workspace) if workspace.is_checkout => return None,
        Home::Member(workspace) => &workspace.root,
        Home::Alone(_) => &place.folder,
    };
    Some(built(schedule, folder, &skeleton.program))
}

fn run_command(arguments: &Arguments, plan: &Plan, partition: &Partition) -> String {
    let mut command = "bateleur run".to_owned();
    if arguments.schedule != Path::new("schedule.toml") {
        command += &format!(" --schedule {}", arguments.schedule.display());
    }
    if plan.modules.len() > 1 {
        command += &format!(" --module {}", plan[partition.module].name);
    }
    command + " --fast --until 1"
}

/// Where the crate goes.
struct Place {
    /// Absolute.
    folder: PathBuf,
    /// As the user would write it.
    shown: String,
    home: Home,
}

/// The folder of what is written, absolute and as the user would write it.
fn folder(arguments: &Arguments, schedule: &Path, partition: &str) -> Result<(PathBuf, String)> {
    let here = std::env::current_dir().context("there is no current folder")?;
    let given = match (&arguments.dir, Workspace::around(schedule)) {
        (Some(dir), _) => dir.clone(),
        (None, Some(workspace)) => workspace.root.join("partitions").join(partition),
        (None, None) => PathBuf::from(partition),
    };
    let folder = workspace::absolute(&here, &given);
    let shown = folder.strip_prefix(&here).unwrap_or(&folder).display().to_string();
    Ok((folder, shown))
}

fn place(arguments: &Arguments, schedule: &Path, partition: &str) -> Result<Place> {
    let (folder, shown) = folder(arguments, schedule, partition)?;
    let home = match Workspace::around(&folder) {
        Some(workspace) => Home::Member(workspace),
        None => Home::Alone(Workspace::library(arguments.library.as_deref(), schedule)?),
    };
    Ok(Place { folder, shown, home })
}

fn files(skeleton: &Skeleton, dependencies: &Dependencies, home: &Home) -> Result<Vec<Written>> {
    let mut files = crate_text::files(skeleton, dependencies)?;
    if let Home::Alone(library) = home {
        files.push((".gitignore", "/target\n".to_owned()));
        files.extend(library.shared());
    }
    Ok(files)
}

fn say_next_inside(workspace: &Workspace, place: &Place, dependencies: &Dependencies) -> Result<()> {
    let member = place.folder.strip_prefix(&workspace.root).unwrap_or(&place.folder).display().to_string();
    let manifest = workspace.root.join("Cargo.toml");
    match workspace.with_member(&member)? {
        workspace::Joined::Already => println!("{}: has it among its members", manifest.display()),
        workspace::Joined::Text(text) => {
            std::fs::write(&manifest, text)
                .with_context(|| format!("cannot write {}", manifest.display()))?;
            println!(
                "{}: `\"{member}\",` is now among its members; nothing else was changed",
                manifest.display()
            );
        }
        workspace::Joined::ByHand => {
            println!("{}: add `\"{member}\",` to `members` of `[workspace]` by hand", manifest.display());
        }
    }
    // All of the workspace, as the README builds it: another choice of packages would build what they have in common anew.
    let bins = if workspace.is_checkout { " --workspace --bins" } else { "" };
    println!("\nbuild it:  cargo build --release{bins}");
    println!("test it:   cargo test --release -p {}", dependencies.package);
    Ok(())
}

/// A path as a shell takes it for one word.
fn quoted(path: String) -> String {
    let plain = |letter: char| letter.is_alphanumeric() || "/._-+".contains(letter);
    if path.chars().all(plain) { path } else { format!("'{}'", path.replace('\'', "'\\''")) }
}

fn say_next_outside(library: &Workspace, place: &Place) {
    println!("it takes the library from {}", library.root.display());
    let manifest = quoted(format!("{}/Cargo.toml", place.shown));
    println!("\nbuild it:  cargo build --release --manifest-path {manifest}");
    println!("test it:   cargo test --release --manifest-path {manifest}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_with_a_blank_is_printed_as_one_word_of_a_shell() {
        assert_eq!(quoted("a/b-c.d/Cargo.toml".into()), "a/b-c.d/Cargo.toml");
        assert_eq!(quoted("a b/it's".into()), "'a b/it'\\''s'");
    }
}
