//! `bateleur plan`: makes a schedule from what the partitions need (a period and a duration each, perhaps a core or an
//! offset), in the order of the chains and within their ages. What it prints has passed the checker.
//!
//! Exit codes: 0 there is the schedule, 1 there is none or none was found, and why, 2 the input can not be used.

mod module;
mod needs;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bateleur_checker::Severity;
use bateleur_checker::planner::{Answer, Request, plan};
use bateleur_plan::units::ShowTime;

use super::{CANNOT_RUN, Code, FINE, WRONG};
use crate::output::refuse_file;
use crate::plan_file;
use module::Module;
use needs::Needs;

/// Make a schedule from what the partitions need.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A file of needs:\n\n    gap = \"100us\"            # optional: free between two windows\n\n    [need]\n    \
    imu       = { period = \"20ms\", duration = \"500us\" }\n    command   = { period = \"20ms\", duration = \"2ms\", offset = \"13ms\" }\n    \
    telemetry = { period = \"100ms\", duration = \"1ms\", core = 2 }\n\n\
    Exit codes: 0 there is the schedule; 1 there is none, or none was found; 2 the input can not be used."
)]
pub struct Arguments {
    /// What the partitions need.
    needs: PathBuf,
    /// The schedule file with the partitions, the cores and the chains; its windows are not looked at.
    #[arg(long, short, value_name = "FILE", default_value = "schedule.toml")]
    schedule: PathBuf,
    /// Write the schedule into this file instead of printing it.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// The first line of a schedule that was made.
const MADE: &str = "# Made by `bateleur plan`.";

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(output) = &arguments.output {
        refuse_file(output, MADE, &[&arguments.needs, &arguments.schedule])?;
    }
    let module = Module::read(&arguments.schedule)?;
    let needs = Needs::read(&arguments.needs)?;
    let request = needs.request(&module).with_context(|| format!("in {}", arguments.needs.display()))?;
    let answer = match plan(&request) {
        Ok(answer) => answer,
        Err(reason) => {
            eprintln!("there is no such schedule: {reason}");
            return Ok(WRONG);
        }
    };
    let name = needs.name.clone().unwrap_or_else(|| module.schedule_name());
    let text = text(&name, module.is_initial(&name), &request, &answer);
    let whole = module.with_schedule(&name, &text)?;
    let title = format!("{} with the planned schedule", arguments.schedule.display());
    match plan_file::read_report(&title, &whole) {
        Ok(report) => {
            report.violations().iter().filter(|one| one.severity != Severity::Note).for_each(|one| {
                eprintln!("warning[{}]: {}", one.rule, one.message);
            })
        }
        Err(report) => {
            eprint!("{}", report.render(false));
            return Ok(CANNOT_RUN);
        }
    }
    put(arguments.output.as_deref(), &text)?;
    Ok(FINE)
}

fn put(output: Option<&Path>, text: &str) -> Result<()> {
    match output {
        Some(path) => std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display())),
        None => {
            print!("{text}");
            Ok(())
        }
    }
}

/// The schedule as the file has it, in columns.
fn text(name: &str, initial: bool, request: &Request, answer: &Answer) -> String {
    let cells = |place: usize| {
        let window = &answer.windows[place];
        let need = &request.needs[window.need];
        let several = need.cores.len() > 1 || request.needs.iter().any(|other| other.cores != need.cores);
        let core = if several { format!(", core = {}", window.core) } else { String::new() };
        let minor = window.minor.as_ref().map_or_else(String::new, |list| format!(", minor = {list:?}"));
        [
            format!("\"{}\",", need.name),
            format!("\"{}\",", ShowTime(window.offset_ns)),
            format!("\"{}\"{core}{minor}", ShowTime(need.duration_ns)),
        ]
    };
    let rows: Vec<[String; 3]> = (0..answer.windows.len()).map(cells).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let (first, second) = (width(0), width(1));
    let mut out = format!(
        "{MADE}\n[schedule.{name}]\nmajor_frame = \"{}\"\nminor_frame = \"{}\"\n",
        ShowTime(answer.major_frame_ns),
        ShowTime(answer.minor_frame_ns)
    );
    if initial {
        out.push_str("initial     = true\n");
    }
    out.push_str("window = [\n");
    for [partition, offset, rest] in &rows {
        out.push_str(&format!(
            "    {{ partition = {partition:<first$} offset = {offset:<second$} duration = {rest} }},\n"
        ));
    }
    out + "]\n"
}
