//! `bateleur man`: the manual pages, one for the program and one for each verb. Exit codes: 0 written, 2 the folder can not
//! be written.

use std::path::PathBuf;

use anyhow::{Context, Result};

use bateleur_executive_cli::{Code, FINE};

/// Write the manual pages.
#[derive(Debug, clap::Args)]
#[command(after_help = "For example: bateleur man ~/.local/share/man/man1 && man bateleur-check\n\n\
    Exit codes: 0 written; 2 the folder can not be written.")]
pub(crate) struct Arguments {
    /// Folder for a page of the program and one of each verb; without it, the program's own page is printed.
    folder: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments, command: clap::Command) -> Result<Code> {
    let Some(folder) = &arguments.folder else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page)?;
        print!("{}", String::from_utf8_lossy(&page));
        return Ok(FINE);
    };
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    // Pages of the helpers that the program starts for itself are nobody's business.
    clap_mangen::generate_to(command, folder)
        .with_context(|| format!("cannot write into {}", folder.display()))?;
    Ok(FINE)
}
