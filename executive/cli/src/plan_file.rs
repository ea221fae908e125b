//! Reading a schedule file from the disk with the message types beside it.

use std::fs::File;
use std::io::{IsTerminal, Read, Seek, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Context, Result};
use bateleur_checker::{
    Contents, Keys, MessageCatalogue, Programs, Report, Surroundings, check, check_among,
};
use bateleur_host::keys;
use bateleur_messages::Catalogue;
use bateleur_messages::format::{self, Fault, Source};
use bateleur_plan::Plan;
use bateleur_plan::compiled::Compiled;
use bateleur_plan::units::ShowSize;
use bateleur_system::privileges;

/// The folder of message types that is looked into where the schedule file names none.
const FOLDER: &str = "messages";

/// The flight's message types, and those of a folder beside a schedule file.
pub struct Messages {
    schedule: PathBuf,
    /// The texts of the folder, or why they can not be read; `None`: they are read when they are asked for.
    read: Option<std::io::Result<Vec<Source>>>,
    opened: OnceLock<Catalogue>,
}

impl Messages {
    /// Of a schedule file of this name.
    pub fn beside(name: &str) -> Self {
        let schedule = Path::new(name).parent().map(Path::to_owned).unwrap_or_default();
        Self { schedule, read: None, opened: OnceLock::new() }
    }

    /// With the texts read already, of the folder that the schedule file names.
    fn with(name: &str, folder: Option<&str>) -> Self {
        let messages = Self::beside(name);
        Self { read: Some(messages.sources(folder)), ..messages }
    }

    fn sources(&self, folder: Option<&str>) -> std::io::Result<Vec<Source>> {
        let path = self.schedule.join(folder.unwrap_or(FOLDER));
        if folder.is_none() && !path.is_dir() { Ok(Vec::new()) } else { format::sources(&path) }
    }

    fn types(&self) -> &Catalogue {
        self.opened.get().unwrap_or_else(|| bateleur_messages::catalogue())
    }
}

impl MessageCatalogue for Messages {
    fn open(&self, folder: Option<&str>) -> std::result::Result<(), Vec<(String, String)>> {
        let refuse = |error: &std::io::Error| {
            let mend = "name the folder with the message types, or leave `messages` out";
            vec![(error.to_string(), mend.to_owned())]
        };
        let own = match &self.read {
            Some(read) => read.as_ref().map_err(refuse)?.clone(),
            None => self.sources(folder).map_err(|error| refuse(&error))?,
        };
        if own.is_empty() {
            return Ok(());
        }
        let all = bateleur_messages::sources().chain(own);
        let types = Catalogue::read(all).map_err(|faults| {
            let place =
                |fault: &Fault| format!("{}:{}:{}: {}", fault.file, fault.line, fault.column, fault.what);
            faults.0.iter().map(|fault| (place(fault), fault.mend.clone())).collect::<Vec<_>>()
        })?;
        let _ = self.opened.set(types);
        Ok(())
    }

    fn size_of(&self, name: &str) -> Option<usize> {
        self.types().find(name).map(|of| of.size())
    }

    fn layout_of(&self, name: &str) -> u32 {
        self.types().find(name).map_or(0, |of| of.layout())
    }

    fn definition_of(&self, name: &str) -> Option<String> {
        self.types().find(name).map(|of| of.schema())
    }

    fn names(&self) -> Vec<&str> {
        self.types().types().map(|of| of.name()).collect()
    }
}

/// Programs as they are found on this machine: names in a folder, paths from the schedule file.
struct Folder<'a> {
    programs: &'a Path,
    schedule: PathBuf,
}

impl Programs for Folder<'_> {
    fn fault(&self, program: &str) -> Option<String> {
        let base = if program.contains('/') { self.schedule.as_path() } else { self.programs };
        let path = base.join(program);
        match std::fs::metadata(&path) {
            Err(error) => Some(format!("{}: {error}", path.display())),
            Ok(found) if !found.is_file() => Some(format!("{} is no file", path.display())),
            Ok(found) if found.permissions().mode() & 0o111 == 0 => {
                Some(format!("{} is not executable", path.display()))
            }
            Ok(_) => bateleur_host::programs::script(&path),
        }
    }
}

/// Keys as they are found on this machine: paths from the schedule file.
struct KeyFiles(PathBuf);

impl Keys for KeyFiles {
    fn fault(&self, file: &str) -> Option<String> {
        keys::read(&self.0.join(file)).err().map(|error| error.to_string())
    }
}

/// Contents of memory blocks as they are found on this machine: paths from the schedule file.
struct ContentFiles(PathBuf);

impl Contents for ContentFiles {
    fn fault(&self, file: &str, size: u64) -> Option<String> {
        match std::fs::metadata(self.0.join(file)) {
            Err(error) => Some(error.to_string()),
            Ok(found) if !found.is_file() => Some("it is no ordinary file".to_owned()),
            Ok(found) if found.len() > size => {
                Some(format!("it has {}, and the block {}", ShowSize(found.len()), ShowSize(size)))
            }
            Ok(_) => None,
        }
    }
}

/// Longest text that a person is taken to have written, bytes.
const MOST_BYTES: u64 = 8 << 20;

/// What a person wrote into `path`; a file that never ends, or an endless device, is refused before memory is.
pub fn read_bounded(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    // One more shows that there is more.
    std::fs::File::open(path)?.take(MOST_BYTES + 1).read_to_string(&mut text)?;
    match text.len() as u64 > MOST_BYTES {
        true => Err(std::io::Error::other("it is longer than 8 MiB")),
        false => Ok(text),
    }
}

/// The plan in `path` with its warnings, or all that is wrong with it; programs are looked for where a folder is given,
/// and the files with keys where that is wanted.
pub fn read_among(
    path: &Path,
    programs: Option<&Path>,
    keys: bool,
) -> Result<Result<(Plan, Report), Report>> {
    Ok(check_among_files(path, &read_text_of(path)?, programs, keys))
}

/// As [`read_among`], of a file whose text was read.
pub fn check_among_files(
    path: &Path,
    text: &str,
    programs: Option<&Path>,
    keys: bool,
) -> std::result::Result<(Plan, Report), Report> {
    let schedule = path.parent().map(Path::to_owned).unwrap_or_default();
    let key_files = keys.then(|| KeyFiles(schedule.clone()));
    let keys = key_files.as_ref().map(|files| files as &dyn Keys);
    let contents = ContentFiles(schedule.clone());
    let folder = programs.map(|programs| Folder { programs, schedule });
    let programs = folder.as_ref().map(|folder| folder as &dyn Programs);
    let name = path.display().to_string();
    let surroundings =
        Surroundings { messages: &Messages::beside(&name), programs, keys, contents: Some(&contents) };
    check_among(&name, text, &surroundings)
}

/// The plan in `text`, which a program wrote; or all that is wrong with it.
pub fn read_text(name: &str, text: &str) -> std::result::Result<Plan, Report> {
    check(name, text, &Messages::beside(name))
}

/// What there is to say of a `text` that can be used; or all that is wrong with it.
pub fn read_report(name: &str, text: &str) -> std::result::Result<Report, Report> {
    check_text(name, text, &Messages::beside(name)).map(|(_, report)| report)
}

/// The plan in `path`, with errors printed for a person; `None` if it can not be used.
pub fn read_quietly(path: &Path) -> Result<Option<Plan>> {
    Ok(print_errors(read_among(path, None, false)?).map(|(plan, _)| plan))
}

/// As [`read_quietly`]; of warnings it says how many there are.
pub fn read_or_say(path: &Path) -> Result<Option<Plan>> {
    let Some((plan, report)) = print_errors(read_among(path, None, false)?) else { return Ok(None) };
    say_warnings(&path.display().to_string(), &report);
    Ok(Some(plan))
}

fn say_warnings(name: &str, report: &Report) {
    match report.warnings() {
        0 => {}
        1 => eprintln!("1 warning: see `bateleur check {name}`"),
        several => eprintln!("{several} warnings: see `bateleur check {name}`"),
    }
}

/// Compiles the schedule file at `path` into `plan`, without privileges; errors are printed for a person, and of warnings, where not
/// `quiet`, how many there are. `false`: there is no plan.
pub fn compile(path: &Path, plan: &File, quiet: bool) -> Result<bool> {
    let (name, text) = (path.display().to_string(), read_text_of(path)?);
    // As the text itself, the types beside it may be where nobody else may read.
    let messages = Messages::with(&name, folder_named(&text, plan)?.as_deref());
    let compiled = privileges::without_privileges(|| match compiled(&name, &text, &messages, quiet) {
        Some(bytes) if (&*plan).write_all(&bytes).is_ok() => 0,
        _ => 1,
    });
    (&*plan).rewind()?;
    Ok(compiled.with_context(|| format!("{name} could not be compiled"))? == 0)
}

fn named_folder(text: &str) -> Option<String> {
    let document = toml::de::DeTable::parse(text).ok()?;
    Some(document.get_ref().get("messages")?.get_ref().as_str()?.to_owned())
}

/// The folder of message types beside a schedule file with this text, whether it is there or not.
pub fn messages_folder(schedule: &Path, text: &str) -> PathBuf {
    let folder = named_folder(text).unwrap_or_else(|| FOLDER.to_owned());
    schedule.parent().map(Path::to_owned).unwrap_or_default().join(folder)
}

/// The folder of message types that a schedule file names. What a person wrote is taken apart without privileges; `scratch` is empty
/// before and after.
fn folder_named(text: &str, scratch: &File) -> Result<Option<String>> {
    privileges::without_privileges(|| match named_folder(text) {
        Some(folder) if (&*scratch).write_all(folder.as_bytes()).is_ok() => 0,
        _ => 1,
    })?;
    let mut folder = String::new();
    (&*scratch).rewind()?;
    (&*scratch).read_to_string(&mut folder)?;
    (&*scratch).rewind()?;
    scratch.set_len(0)?;
    Ok((!folder.is_empty()).then_some(folder))
}

/// The compiled plan of a text, as a file holds it; errors and warnings are printed as in [`compile`].
pub fn compiled(name: &str, text: &str, messages: &Messages, quiet: bool) -> Option<Vec<u8>> {
    let (plan, report) = print_errors(check_text(name, text, messages))?;
    if !quiet {
        say_warnings(name, &report);
    }
    let compiled = Compiled::new(name, text, plan).write();
    compiled.map_err(|error| eprintln!("bateleur: {name}: {error}")).ok()
}

fn check_text(name: &str, text: &str, messages: &Messages) -> std::result::Result<(Plan, Report), Report> {
    check_among(name, text, &Surroundings::of(messages))
}

fn print_errors(read: std::result::Result<(Plan, Report), Report>) -> Option<(Plan, Report)> {
    read.map_err(|report| eprint!("{}", report.render(std::io::stderr().is_terminal()))).ok()
}

/// The text of a schedule file.
pub fn read_text_of(path: &Path) -> Result<String> {
    read_bounded(path)
        .with_context(|| format!("cannot read {} (name another file with --schedule)", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_that_never_ends_is_refused_before_memory_is() {
        let error = read_bounded(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(error.contains("longer than 8 MiB"), "{error}");
    }
}
