//! `bateleur schema`: the schedule file as a JSON schema, for editors. Exit codes: 0 printed.

use anyhow::Result;

use super::{Code, FINE};

/// Print a JSON schema of the schedule file, for editors.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "For example: bateleur schema > schedule.schema.json, and as the first line of schedule.toml:\n\
    #:schema schedule.schema.json\n\nExit codes: 0 printed."
)]
pub struct Arguments {}

pub(crate) fn run() -> Result<Code> {
    println!("{}", serde_json::to_string_pretty(&bateleur_checker::schema())?);
    Ok(FINE)
}
