//! `bateleur show`: the windows of a schedule as text and as a picture, and the channels as a graph. The same file gives
//! the same bytes every time. Exit codes: 0 shown, 2 the file can not be used.

pub(crate) mod facts;
mod frames;
mod graph;
mod layout;
mod picture;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_checker::Facts;
use bateleur_plan::{Plan, ScheduleId};

use super::{CANNOT_RUN, Code, FINE};
use crate::installed::usual_schedule;
use crate::output::refuse_file;
use crate::plan_file;
use crate::words::nearest;

/// Show a schedule file: frames, use of the cores, chains, the graph of the channels.
#[derive(Debug, clap::Args)]
#[command(after_help = "Exit codes: 0 shown; 2 the file can not be used, or a picture can not be written.")]
pub struct Arguments {
    /// The schedule file [default: schedule.toml].
    file: Option<PathBuf>,
    /// The schedule file, as the other verbs name it.
    #[arg(long, short, value_name = "FILE", conflicts_with = "file")]
    schedule: Option<PathBuf>,
    /// Only the schedule of this name.
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Write the frames of a schedule (the initial one, or that of --only) as a picture.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Write the graph of the channels as a picture.
    #[arg(long, value_name = "FILE")]
    graph: Option<PathBuf>,
    /// Write the graph of the channels for Graphviz.
    #[arg(long, value_name = "FILE")]
    dot: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let given = arguments.file.as_ref().or(arguments.schedule.as_ref());
    let path = &given.cloned().unwrap_or_else(usual_schedule);
    let Some(plan) = plan_file::read_quietly(path)? else { return Ok(CANNOT_RUN) };
    let only = arguments.only.as_deref().map(|name| schedule_named(&plan, name)).transpose()?;
    let pictured = only.unwrap_or_else(|| plan.initial_schedule());
    for (output, beginning) in
        [(&arguments.svg, "<svg "), (&arguments.graph, "<svg "), (&arguments.dot, "digraph ")]
    {
        output.as_deref().map(|output| refuse_file(output, beginning, &[path])).transpose()?;
    }
    write(arguments.svg.as_deref(), || picture::svg(&plan, pictured))?;
    write(arguments.graph.as_deref(), || graph::svg(&plan))?;
    write(arguments.dot.as_deref(), || graph::dot(&plan))?;
    print!("{}", text(&plan, only));
    Ok(FINE)
}

fn schedule_named(plan: &Plan, name: &str) -> Result<ScheduleId> {
    if let Some(schedule) = plan.schedule(name) {
        return Ok(schedule);
    }
    let names: Vec<&str> = plan.schedules.iter().map(|schedule| schedule.name.as_str()).collect();
    match nearest(name, names.iter().copied()) {
        Some(near) => bail!("there is no schedule {name}: did you mean {near}?"),
        None => bail!("there is no schedule {name}: choose one of {}", names.join(", ")),
    }
}

fn write(path: Option<&Path>, text: impl FnOnce() -> String) -> Result<()> {
    let Some(path) = path else { return Ok(()) };
    std::fs::write(path, text()).with_context(|| format!("cannot write {}", path.display()))
}

fn text(plan: &Plan, only: Option<ScheduleId>) -> String {
    let mut facts = Facts::of(plan);
    let mut out = String::new();
    for schedule in &plan.schedules {
        let id = plan.schedule(&schedule.name);
        if only.is_none() || only == id {
            out.push_str(&id.map(|id| frames::text(plan, id)).unwrap_or_default());
        }
    }
    facts.schedules.retain(|one| only.is_none() || only == plan.schedule(&one.schedule));
    out.push_str(&facts::text(plan, &facts));
    out
}
