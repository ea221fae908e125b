//! Reading a schedule file from the disk with the message types of this build.

use std::io::{IsTerminal, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bateleur_host::keys;
use bateleur_checker::{Keys, MessageCatalogue, Programs, Report, Surroundings, check, check_among};
use bateleur_plan::Plan;

/// The message types that this program was built with.
pub(crate) struct Catalogue;

impl MessageCatalogue for Catalogue {
    fn size_of(&self, name: &str) -> Option<usize> {
        bateleur_messages::find(name).map(|message| message.size)
    }

    fn layout_of(&self, name: &str) -> u32 {
        bateleur_messages::find(name).map_or(0, |message| bateleur_messages::layout_of(message.fields))
    }

    fn names(&self) -> Vec<&str> {
        bateleur_messages::CATALOGUE.iter().map(|message| message.name).collect()
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
            Ok(_) => None,
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

/// Longest text that a person is taken to have written, bytes.
const MOST_BYTES: u64 = 8 << 20;

/// What a person wrote into `path`; a file that never ends, or an endless device, is refused before memory is.
pub(crate) fn read_bounded(path: &Path) -> std::io::Result<String> {
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
pub(crate) fn read_among(
    path: &Path,
    programs: Option<&Path>,
    keys: bool,
) -> Result<Result<(Plan, Report), Report>> {
    let text = read_bounded(path)
        .with_context(|| format!("cannot read {} (name another file with --schedule)", path.display()))?;
    let schedule = path.parent().map(Path::to_owned).unwrap_or_default();
    let key_files = keys.then(|| KeyFiles(schedule.clone()));
    let keys = key_files.as_ref().map(|files| files as &dyn Keys);
    let folder = programs.map(|programs| Folder { programs, schedule });
    let programs = folder.as_ref().map(|folder| folder as &dyn Programs);
    let surroundings = Surroundings { messages: &Catalogue, programs, keys };
    Ok(check_among(&path.display().to_string(), &text, &surroundings))
}

/// The plan in `text`, which a program wrote; or all that is wrong with it.
pub(crate) fn read_text(name: &str, text: &str) -> std::result::Result<Plan, Report> {
    check(name, text, &Catalogue)
}

/// What there is to say of a `text` that can be used; or all that is wrong with it.
pub(crate) fn read_report(name: &str, text: &str) -> std::result::Result<Report, Report> {
    let surroundings = Surroundings { messages: &Catalogue, programs: None, keys: None };
    check_among(name, text, &surroundings).map(|(_, report)| report)
}

/// The plan in `path`, with errors printed for a person; `None` if it can not be used.
pub(crate) fn read_quietly(path: &Path) -> Result<Option<Plan>> {
    Ok(read_or_print(path)?.map(|(plan, _)| plan))
}

/// As [`read_quietly`]; of warnings it says how many there are.
pub(crate) fn read_or_say(path: &Path) -> Result<Option<Plan>> {
    let Some((plan, report)) = read_or_print(path)? else { return Ok(None) };
    let warnings = match report.warnings() {
        0 => return Ok(Some(plan)),
        1 => "1 warning".to_owned(),
        several => format!("{several} warnings"),
    };
    eprintln!("{warnings}: see `bateleur check {}`", path.display());
    Ok(Some(plan))
}

fn read_or_print(path: &Path) -> Result<Option<(Plan, Report)>> {
    match read_among(path, None, false)? {
        Ok(read) => Ok(Some(read)),
        Err(report) => {
            eprint!("{}", report.render(std::io::stderr().is_terminal()));
            Ok(None)
        }
    }
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
