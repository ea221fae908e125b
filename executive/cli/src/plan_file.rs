//! Reading a schedule file from the disk with the message types of this build.

use std::io::IsTerminal;
use std::path::Path;

use anyhow::{Context, Result};
use bateleur_executive::plan::{MessageCatalogue, Plan, Report, check, check_with_warnings};

/// The message types that this program was built with.
struct Catalogue;

impl MessageCatalogue for Catalogue {
    fn size_of(&self, name: &str) -> Option<usize> {
        bateleur_messages::find(name).map(|message| message.size)
    }

    fn names(&self) -> Vec<&str> {
        bateleur_messages::CATALOGUE.iter().map(|message| message.name).collect()
    }
}

/// The plan in `path` with its warnings, or all that is wrong with it.
pub(crate) fn read(path: &Path) -> Result<Result<(Plan, Report), Report>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read {} (name another file with --schedule)", path.display()))?;
    Ok(check_with_warnings(&path.display().to_string(), &text, &Catalogue))
}

/// The plan in `text`, which a program wrote; or all that is wrong with it.
pub(crate) fn read_text(name: &str, text: &str) -> std::result::Result<Plan, Report> {
    check(name, text, &Catalogue)
}

/// As [`read`], with errors printed for a person; none: it can not be used.
pub(crate) fn read_or_say(path: &Path) -> Result<Option<Plan>> {
    let color = std::io::stderr().is_terminal();
    match read(path)? {
        Ok((plan, _)) => Ok(Some(plan)),
        Err(report) => {
            eprint!("{}", report.render(color));
            Ok(None)
        }
    }
}
