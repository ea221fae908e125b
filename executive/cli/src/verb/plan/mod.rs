//! `bateleur plan`: makes a schedule from what the partitions need (a period and a duration each, perhaps a core or an
//! offset), in the order of the chains and within their ages. What it prints has passed the checker. Needs are written down, or taken
//! from a run.
//!
//! Exit codes: 0 there is the schedule, 1 there is none or none was found, and why, 2 the input can not be used.

mod from_run;
mod module;
mod needs;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bateleur_checker::planner::{Answer, plan};
use bateleur_checker::{Report, Severity, Violation};
use bateleur_plan::units::ShowTime;

use super::{CANNOT_RUN, Code, FINE, WRONG};
use crate::output::refuse_file;
use crate::plan_file;
use from_run::Run;
use module::Module;
use needs::{Needs, Wanted};

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
    #[arg(required_unless_present = "from_run")]
    needs: Option<PathBuf>,
    /// Take what NEEDS does not say from the windows of a run or flight of the schedule file, in this folder.
    #[arg(long, value_name = "FOLDER")]
    from_run: Option<PathBuf>,
    /// What is added to the times of a run, in percent.
    #[arg(long, value_name = "PERCENT", default_value = "50", requires = "from_run")]
    margin: u32,
    /// The schedule file with the partitions, the cores and the chains; its windows count with `--from-run` only.
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
        let read: Vec<&Path> =
            [&arguments.schedule].into_iter().chain(&arguments.needs).map(PathBuf::as_path).collect();
        refuse_file(output, MADE, &read)?;
    }
    let module = Module::read(&arguments.schedule)?;
    let needs = arguments.needs.as_deref().map(Needs::read).transpose()?.unwrap_or_default();
    let run = match &arguments.from_run {
        None => None,
        Some(folder) => {
            let Some(plan) = plan_file::read_quietly(&arguments.schedule)? else { return Ok(CANNOT_RUN) };
            Some(Run::read(folder, &plan, arguments.margin)?)
        }
    };
    let wanted = needs.wanted(&module, run.as_ref());
    let wanted = match &arguments.needs {
        Some(needs) => wanted.with_context(|| format!("in {}", needs.display()))?,
        None => wanted?,
    };
    let answer = match plan(&wanted.request) {
        Ok(answer) => answer,
        Err(reason) => {
            eprintln!("there is no such schedule: {reason}");
            return Ok(WRONG);
        }
    };
    let name = needs.name.clone().unwrap_or_else(|| module.schedule_name());
    let text = text(&name, module.is_initial(&name), &wanted, &answer);
    let text = match &run {
        Some(run) => text.replacen(MADE, &format!("{MADE}\n{}", run.comments().trim_end()), 1),
        None => text,
    };
    let whole = module.with_schedule(&name, &text)?;
    let name_of_file = arguments.schedule.display().to_string();
    match plan_file::read_report(&name_of_file, &whole) {
        Ok(report) => tell(&report, Severity::Warning, "warning"),
        Err(report) => {
            refuse(&arguments.schedule, &name_of_file, &report)?;
            return Ok(CANNOT_RUN);
        }
    }
    if let Some(note) = module.silence_note(&name, answer.minor_frame_ns) {
        eprintln!("{note}");
    }
    put(arguments.output.as_deref(), &text)?;
    Ok(FINE)
}

fn tell(report: &Report, most: Severity, word: &str) {
    for one in report.violations().iter().filter(|one| one.severity <= most) {
        eprintln!("{word}[{}]: {}", one.rule, one.message);
    }
}

/// Says what is wrong with the file at its lines; what only the planned schedule is to blame for has none.
fn refuse(path: &Path, name: &str, planned: &Report) -> Result<()> {
    let file = plan_file::read_report(name, &plan_file::read_text_of(path)?).err();
    let of_both = |one: &Violation| {
        planned.violations().iter().any(|other| other.rule == one.rule && other.message == one.message)
    };
    let own = file.and_then(|report| report.only(|one| one.severity == Severity::Error && of_both(one)));
    match own {
        Some(own) => eprint!("{}", own.render(false)),
        None => {
            eprintln!("{name} with the planned schedule in it breaks rules:");
            tell(planned, Severity::Error, "error");
        }
    }
    Ok(())
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
fn text(name: &str, initial: bool, wanted: &Wanted, answer: &Answer) -> String {
    let needs = &wanted.request.needs;
    let mut rows: Vec<[String; 3]> = Vec::new();
    for window in &answer.windows {
        let cores = &needs[window.need].cores;
        let several = cores.len() > 1 || needs.iter().any(|other| other.cores != *cores);
        let core = if several { format!(", core = {}", window.core) } else { String::new() };
        let minor = window.minor.as_ref().map_or_else(String::new, |list| format!(", minor = {list:?}"));
        let mut offset_ns = window.offset_ns;
        for member in &wanted.members[window.need] {
            rows.push([
                format!("\"{}\",", member.name),
                format!("\"{}\",", ShowTime(offset_ns)),
                format!("\"{}\"{core}{minor}", ShowTime(member.duration_ns)),
            ]);
            offset_ns += member.duration_ns + wanted.request.gap_ns;
        }
    }
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
