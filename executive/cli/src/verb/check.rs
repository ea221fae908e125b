//! `bateleur check`: holds every rule against a schedule file and reports all violations at once, each with its place,
//! the other place involved, and a way to mend it. Nothing is started. Exit code 2 where the file can not be used.

use std::io::IsTerminal;
use std::path::PathBuf;

use anyhow::Result;

use super::{CANNOT_RUN, Code, FINE, Format, WRONG};
use crate::plan_file;

/// Check a schedule file against every rule.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The schedule file.
    #[arg(long, short, default_value = "schedule.toml")]
    schedule: PathBuf,
    /// Say why a rule exists (its id, such as T03-window-overlap), and end.
    #[arg(long, value_name = "RULE")]
    explain: Option<String>,
    /// Treat warnings as errors (exit code 1).
    #[arg(long)]
    deny_warnings: bool,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(rule) = &arguments.explain {
        return explain(rule);
    }
    let read = plan_file::read(&arguments.schedule)?;
    let (usable, report) = match &read {
        Ok((_, report)) => (true, report),
        Err(report) => (false, report),
    };
    match arguments.format {
        Format::Json => println!("{:#}", report.to_json()),
        Format::Text => {
            print!("{}", report.render(std::io::stdout().is_terminal()));
            if let Ok((plan, _)) = &read {
                println!("{}: {}", arguments.schedule.display(), counts(plan));
            }
        }
    }
    match (usable, report.warnings()) {
        (false, _) => Ok(CANNOT_RUN),
        (true, 1..) if arguments.deny_warnings => Ok(WRONG),
        (true, _) => Ok(FINE),
    }
}

fn counts(plan: &bateleur_executive::plan::Plan) -> String {
    format!(
        "{} module(s), {} partitions, {} channels, {} schedule(s): fine",
        plan.modules.len(),
        plan.partitions.len(),
        plan.channels.len(),
        plan.schedules.len()
    )
}

fn explain(id: &str) -> Result<Code> {
    use bateleur_executive::plan::RULES;
    match RULES.iter().find(|rule| rule.id == id || rule.id.split('-').next() == Some(id)) {
        Some(rule) => {
            println!("{} ({:?}): {}", rule.id, rule.severity, rule.reason);
            Ok(FINE)
        }
        None => {
            eprintln!("there is no rule {id}; the rules are:");
            RULES.iter().for_each(|rule| eprintln!("  {}", rule.id));
            Ok(CANNOT_RUN)
        }
    }
}
