//! `bateleur bench`: measures what the executive promises, beside references taken in the same run.
//!
//! It starts real modules with real partition processes from schedules that it generates, in a temporary folder, and
//! takes the references in between on the same core at the same priority. Several runs; the table shows medians over
//! them. A figure that this machine can not give says why. Exit codes: 0 every figure that has a reach is within it,
//! 1 one is not (or could not be taken), 2 nothing could be measured. With --quick nothing is judged.

#[macro_use(eprintln, print)]
extern crate bateleur_executive_cli;

mod alignment;
mod attacks;
mod bare_switch;
mod can;
mod flight;
mod laws;
mod links;
mod module;
mod ports;
mod probe;
mod processes;
mod restart;
mod row;
mod scale;
mod sketch;
mod statistics;
mod turns;
mod windows;

use std::path::PathBuf;

use anyhow::{Result, bail};
use bateleur_system::sched;

use bateleur_executive_cli::installed::{self, SCHEDULE};
use bateleur_executive_cli::{Code, FINE, Format, WRONG};
use row::Row;

/// Measure what the executive promises, beside references taken in the same run.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Which figures; all where none is named: starts, fence, switch, ports, processes, links, alignment,
    /// can, restart, scale, laws, flight, virtual, attacks.
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    /// One short run of each: shows that it works, not how well.
    #[arg(long)]
    quick: bool,
    /// Runs; the table shows the median over them.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    runs: u32,
    /// The flight's schedule file, for the figures of a flight.
    #[arg(long, short, default_value = SCHEDULE, value_parser = installed::schedule())]
    schedule: PathBuf,
    /// The core whose time is partitioned; default: the last one that may be used.
    #[arg(long)]
    core: Option<u32>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// How to measure.
struct Settings {
    runs: usize,
    quick: bool,
    core: u32,
    /// Length of one run of a module, s.
    seconds: f64,
    /// The schedule file of a flight.
    schedule: PathBuf,
}

/// Measures one group of figures.
type Measure = fn(&Settings) -> Result<Vec<Row>>;

/// What can be measured, by name.
const FIGURES: &[(&str, Measure)] = &[
    ("starts", windows::starts),
    ("fence", windows::fence),
    ("switch", windows::switches),
    ("ports", ports::rows),
    ("processes", processes::rows),
    ("links", links::rows),
    ("alignment", alignment::rows),
    ("can", can::rows),
    ("restart", restart::rows),
    ("scale", scale::rows),
    ("laws", laws::rows),
    ("flight", flight::wall),
    ("virtual", flight::fast),
    ("attacks", attacks::rows),
];

/// Measures.
///
/// # Errors
/// A name of no figure, or a core that may not be used.
pub fn run(arguments: &Arguments) -> Result<Code> {
    let known: Vec<&str> = FIGURES.iter().map(|(name, _)| *name).collect();
    if let Some(name) = arguments.names.iter().find(|name| !known.contains(&name.as_str())) {
        bail!("there is no figure \"{name}\"; there are {}", known.join(", "));
    }
    let allowed = sched::allowed_cores();
    let machine = probe::machine(allowed.len());
    let core = arguments.core.or(allowed.last().copied()).unwrap_or(0);
    if !allowed.contains(&core) {
        bail!("this process may not use processor {core}; it may use {allowed:?}");
    }
    module::leave(core, allowed);
    let quick = arguments.quick;
    let runs = if quick { 1 } else { arguments.runs as usize };
    let settings = Settings {
        runs,
        quick,
        core,
        seconds: if quick { 0.5 } else { 8.0 },
        schedule: arguments.schedule.clone(),
    };
    let mut rows = Vec::new();
    let wanted = |name: &str| arguments.names.is_empty() || arguments.names.iter().any(|asked| asked == name);
    for (name, measure) in FIGURES.iter().filter(|(name, _)| wanted(name)) {
        eprintln!("measuring {name} …");
        match measure(&settings) {
            Ok(measured) => rows.extend(measured),
            Err(error) => rows.push(Row::impossible(*name, format!("{error:#}"))),
        }
    }
    let text = match arguments.format {
        Format::Json => {
            let all = serde_json::json!({ "machine": machine, "core": core, "runs": runs, "quick": quick, "rows": rows });
            format!("{all:#}\n")
        }
        Format::Text => format!("{machine}, core {core}, runs: {runs}\n\n{}", row::table(&rows)),
    };
    print!("{text}");
    // A quick run shows that every figure can be taken, and judges none.
    let all_well = rows.iter().all(|row| row.value.is_some() && (quick || row.met != Some(false)));
    Ok(if all_well { FINE } else { WRONG })
}

#[cfg(test)]
#[path = "../../../executive/checker/tests/plan_support/schema_check.rs"]
mod schema_check;
