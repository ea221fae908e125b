//! `bateleur play FILE`: a recording drives the inputs of a module on the virtual clock, and what comes out is compared with what is in it.
//!
//! Inputs are the ports that the plan leaves to the operator, the channels of other modules, and all ports of the partitions that
//! `--in-place-of` names, which are not started. Each message comes with the time and the number that it had. The schedule file and
//! attributes of a flight are those that its `run.json` names. Exit codes: 0 what comes out is equal, 1 it differs, or the module
//! had an error, 2 it could not be played, or not all of it could be compared.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result};
use bateleur_executive_cli::installed::usual_schedule;
use bateleur_executive_cli::output::refuse_used;
use bateleur_executive_cli::plan_file;
use bateleur_executive_cli::setting::module_time;
use bateleur_recording::{PORTS_FILE, for_each};
use bateleur_report::compare::file;

use super::compare::{How, compare_and_print};
use super::{CANNOT_RUN, Code, FINE, WRONG, fly, replay};

/// Run a module on the inputs of a recording, and compare what comes out.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 what comes out is equal; 1 it differs, or the module had an error; 2 it could not be played, or not all of it could be compared."
)]
pub struct Arguments {
    /// The folder of a run or a flight, or its ports.mcap.
    #[arg(value_name = "FOLDER|FILE")]
    recording: PathBuf,
    /// The schedule file [default: the one that the flight had, or schedule.toml].
    #[arg(long, short)]
    schedule: Option<PathBuf>,
    /// The module to run; may be left out where the plan has one.
    #[arg(long, short)]
    module: Option<String>,
    /// Do not start this partition: what it writes comes from the recording (may be repeated).
    #[arg(long, value_name = "PARTITION")]
    in_place_of: Vec<String>,
    /// Replace an attribute of the plan, as the recorded run did (may be repeated).
    #[arg(long, value_name = "PARTITION.ATTRIBUTE=VALUE")]
    set: Vec<String>,
    /// End at this module time, s [default: that of the last message].
    #[arg(long, value_name = "SECONDS", value_parser = module_time, allow_negative_numbers = true)]
    until: Option<f64>,
    /// Keep the new run: the folder for its logs.
    #[arg(long, short, value_name = "FOLDER")]
    output: Option<PathBuf>,
    #[command(flatten)]
    how: How,
}

/// Behind the last message, ns: the frame in which it is written runs to its end.
const BEHIND_NS: u64 = 1_000;

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(folder) = &arguments.output {
        refuse_used(folder)?;
    }
    let log = file(&arguments.recording);
    let mut last_ns = 0;
    for_each(&log, |entry| last_ns = last_ns.max(entry.time_ns))?;
    if let Some(until_s) = arguments.until {
        last_ns = (until_s * 1e9) as u64;
    }
    let scratch = tempfile::tempdir().context("cannot make a folder for the new run")?;
    let folder = arguments.output.clone().unwrap_or_else(|| scratch.path().join("run"));
    let program = std::env::current_exe().context("cannot find this program")?;
    let mut command = Command::new(&program);
    command.args(["run", "--fast", "--record", "--output"]).arg(&folder).arg("--play").arg(&log);
    for name in &arguments.in_place_of {
        command.args(["--in-place-of", name]);
    }
    let Some(given) = as_recorded(arguments, &log)? else { return Ok(CANNOT_RUN) };
    command.args(given);
    command.args(["--until", &(last_ns.saturating_add(BEHIND_NS) as f64 / 1e9).to_string()]);
    // What is printed on standard output is the comparison.
    let status = command.stdout(Stdio::null()).status();
    let status = status.with_context(|| format!("cannot start {}", program.display()))?;
    if status.code() == Some(2) {
        return Ok(CANNOT_RUN);
    }
    let (_, compared) = compare_and_print((&log, &folder.join(PORTS_FILE)), &arguments.how, Some(last_ns))?;
    Ok(if compared == FINE && !status.success() { WRONG } else { compared })
}

/// Schedule file, module and attributes, as the recorded run had them; `None`: there is no plan, which was said.
fn as_recorded(arguments: &Arguments, log: &Path) -> Result<Option<Vec<String>>> {
    let (flown, changed) = replay::as_flown(log).unzip();
    changed.iter().flatten().for_each(|sentence| eprintln!("{sentence}"));
    let flown: Option<fly::Arguments> = flown;
    let schedule = arguments.schedule.clone().or_else(|| flown.as_ref().map(|flown| flown.schedule.clone()));
    let schedule = schedule.unwrap_or_else(usual_schedule);
    let mut given = vec!["--schedule".to_owned(), schedule.display().to_string()];
    let mut module = arguments.module.clone();
    if let Some(flown) = &flown {
        module = module.or_else(|| flown.module.clone());
        let Some(plan) = plan_file::read_or_say(&schedule)? else { return Ok(None) };
        let mission = fly::read_mission(flown, &plan)?;
        let mut settings = fly::settings(flown, &plan, &mission)?;
        if let Some(airframe) = &flown.airframe {
            let text = std::fs::read_to_string(airframe).unwrap_or_else(|_| airframe.clone());
            for program in ["controller", "servo"] {
                settings.push(format!("{}.airframe={text}", fly::partition_running(&plan, program)?));
            }
        }
        given.extend(settings.into_iter().flat_map(|setting| ["--set".to_owned(), setting]));
    }
    given.extend(module.into_iter().flat_map(|module| ["--module".to_owned(), module]));
    given.extend(arguments.set.iter().flat_map(|setting| ["--set".to_owned(), setting.clone()]));
    Ok(Some(given))
}
