//! `bateleur campaign merge FOLDER …`: joins the shards of a campaign into one result.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use bateleur_report::campaign::{CampaignResult, RESULTS, join};

use super::finish;
use crate::{Code, FINE, Format, WRONG};

/// Join the shards of a campaign into one result.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "Exit codes: 0 every flight completed its mission; 1 some did not, or are missing; 2 they do not belong together."
)]
pub(crate) struct Arguments {
    /// Folders of campaigns: shards, or one alone.
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Write what is joined into this folder: a campaign like any other, that can go on.
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

pub(super) fn run(arguments: &Arguments) -> Result<Code> {
    let (plan, lines) = join(&arguments.folders)?;
    let result = CampaignResult::of(&plan, &lines);
    if let Some(folder) = &arguments.output {
        let path = folder.join(RESULTS);
        if path.exists() {
            bail!("{} holds a campaign already: name another folder with --output", folder.display());
        }
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let mut text = String::new();
        for flight in lines.flights.values() {
            text += &serde_json::to_string(flight)?;
            text.push('\n');
        }
        plan.write(folder)?;
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    finish(&result, arguments.output.as_deref(), arguments.format)?;
    Ok(if result.completed == result.asked && result.notes.is_empty() { FINE } else { WRONG })
}
