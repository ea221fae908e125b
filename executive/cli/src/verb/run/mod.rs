//! `bateleur run`: runs one module of a schedule file until Ctrl-C, SIGTERM, a partition's stop, or `--until`.
//!
//! Says at its start what this machine can not promise; writes `windows.csv`, `health.jsonl` and the partitions'
//! standard error into `--output`. Leaves nothing behind, however it ends. Exit codes: 0 it ran and was stopped,
//! 1 an error of the module ended it, by the table `[health.module]`, or a log could not be written, 2 it could not run.

mod hosts;
mod play;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Seek;
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, anyhow};
use bateleur_host::programs::beside_own;
use bateleur_monitor::run_order::RunOrder;
use bateleur_system::handed_over;
use bateleur_time::shared_clock::SharedClock;

use super::{CANNOT_RUN, Code};
use crate::faults::Faults;
use crate::installed::{self, SCHEDULE};
use crate::plan_file;
use crate::setting::{Setting, module_time, parse_setting};

/// Run a module of a schedule file.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The schedule file.
    #[arg(long, short, default_value = SCHEDULE, value_parser = installed::schedule())]
    schedule: PathBuf,
    /// The module to run; may be left out where the file has one.
    #[arg(long, short)]
    module: Option<String>,
    /// Folder for logs; the default is target/runs/latest, which every run writes over that finds no other at it.
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// The folder of the partitions' logbooks, which outlive the run [default: target/logbooks]; a run on the virtual clock has its own.
    #[arg(long, value_name = "FOLDER", conflicts_with = "fast")]
    logbooks: Option<PathBuf>,
    /// Run all modules of the plan on this machine, each in a process of its own: in network namespaces that are joined by virtual
    /// Ethernets and have the plan's addresses (root needed), or over the loopback interface; by default whichever can be.
    #[arg(long, value_name = "WHERE", num_args = 0..=1, require_equals = true, default_missing_value = "any")]
    #[arg(hide_possible_values = true, conflicts_with_all = ["module", "together", "events_fd", "companion_fd"])]
    hosts: Option<hosts::Where>,
    /// The folder for logs may hold an earlier run: that of `--hosts`.
    #[arg(long, hide = true)]
    over: bool,
    /// Run on the virtual clock: as fast as the machine can.
    #[arg(long)]
    fast: bool,
    /// Share the virtual clock with other modules on this machine, through this file: their windows come in one order, the
    /// same in every run. The first module makes the file, the last removes it.
    #[arg(long, value_name = "FILE", requires = "fast", requires = "place")]
    together: Option<PathBuf>,
    /// This module's place among those that share the virtual clock, and how many they are, such as 0/2; of windows at one
    /// instant the lower place comes first.
    #[arg(long, value_name = "PLACE/COUNT", requires = "together", value_parser = parse_place)]
    place: Option<(usize, usize)>,
    /// Its process was killed and this is the next: the module time at which its windows begin again, ns.
    #[arg(long, hide = true, value_name = "NANOSECONDS", requires = "together")]
    back_at: Option<u64>,
    /// End at this module time, seconds.
    #[arg(long, value_name = "SECONDS", value_parser = module_time, allow_negative_numbers = true)]
    until: Option<f64>,
    /// Replace an attribute of the plan.
    #[arg(long, value_name = "PARTITION.ATTRIBUTE=VALUE", value_parser = parse_setting)]
    set: Vec<Setting>,
    /// Take the key of a link from another file than the plan's; relative to the schedule file.
    #[arg(long, value_name = "LINK=FILE", value_parser = parse_key)]
    key: Vec<(String, PathBuf)>,
    /// Use another address in place of one of the plan's, for this module and its peers.
    #[arg(long, value_name = "PLANNED=OTHER", value_parser = parse_address)]
    address: Vec<(SocketAddr, SocketAddr)>,
    #[command(flatten)]
    faults: Faults,
    #[command(flatten)]
    recorded: play::Recorded,
    /// Refuse to start where this machine lacks something.
    #[arg(long, value_name = "HOW", value_parser = ["strict"])]
    require: Option<String>,
    /// Write every message of every port into ports.mcap.
    #[arg(long)]
    record: bool,
    /// Stop when standard input closes.
    #[arg(long)]
    until_stdin_closes: bool,
    /// Descriptor for events, one JSON object a line.
    #[arg(long, hide = true)]
    events_fd: Option<RawFd>,
    /// Descriptor of the socket to whoever holds the other end of a partition's line under the virtual clock.
    #[arg(long, hide = true)]
    companion_fd: Option<RawFd>,
    /// Virtual clock: the processor for all windows.
    #[arg(long, hide = true, requires = "fast")]
    processor: Option<u32>,
}

fn parse_key(text: &str) -> Result<(String, PathBuf), String> {
    let wrong = || format!("\"{text}\" is not LINK=FILE, such as nav=keys/nav.key");
    text.split_once('=').map(|(link, file)| (link.to_owned(), PathBuf::from(file))).ok_or_else(wrong)
}

fn parse_address(text: &str) -> Result<(SocketAddr, SocketAddr), String> {
    let addresses =
        text.split_once('=').and_then(|(one, other)| Some((one.parse().ok()?, other.parse().ok()?)));
    addresses
        .ok_or_else(|| format!("\"{text}\" is not PLANNED=OTHER, such as 10.77.0.1:15300=127.0.0.1:15300"))
}

/// A module's place among several, and their count.
fn parse_place(text: &str) -> Result<(usize, usize), String> {
    let numbers =
        text.split_once('/').and_then(|(place, count)| Some((place.parse().ok()?, count.parse().ok()?)));
    numbers.ok_or_else(|| format!("\"{text}\" is not PLACE/COUNT, such as 0/2 for the first of two modules"))
}

/// What the folder of logbooks is called: beside those of runs, or in that of a run on the virtual clock.
pub(crate) const LOGBOOKS: &str = "logbooks";

/// What reads the compiled plan and runs its module: the only program of the project that needs root.
const DAEMON: &str = "bateleurd";

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(folder) = arguments.output.as_ref().filter(|_| !arguments.over) {
        crate::output::refuse_used(folder)?;
    }
    if let Some(place) = arguments.hosts {
        return hosts::run(arguments, place);
    }
    let Ok(prepared) = arguments.recorded.prepare(&arguments.schedule, arguments.module.as_deref())? else {
        return Ok(CANNOT_RUN);
    };
    let plan = handed_over::file("plan").context("no memory for the compiled plan")?;
    // Whoever started it with a channel for events has read the file too, and said so.
    let quiet = arguments.events_fd.is_some() || arguments.recorded.is_asked_for();
    if !plan_file::compile(&arguments.schedule, &plan, quiet)? {
        return Ok(CANNOT_RUN);
    }
    let mut order = handed_over::file("order").context("no memory for the order")?;
    let play = prepared.as_ref().map(|prepared| prepared.play.clone());
    serde_json::to_writer(&mut order, &RunOrder { play, ..order_of(arguments) })
        .context("the order can not be written down")?;
    order.rewind()?;
    // This process becomes the daemon: it keeps its number, its signals and its standard streams.
    let daemon = beside_own(DAEMON);
    let argument = |file: &File| format!("fd:{}", file.as_fd().as_raw_fd());
    let error = Command::new(&daemon).args([argument(&plan), argument(&order)]).exec();
    Err(anyhow!(error).context(format!(
        "cannot start {} (`cargo build --release --workspace` makes it beside this program)",
        daemon.display()
    )))
}

fn order_of(arguments: &Arguments) -> RunOrder {
    let mut overrides: BTreeMap<String, BTreeMap<String, serde_json::Value>> = BTreeMap::new();
    for setting in &arguments.set {
        overrides
            .entry(setting.partition.clone())
            .or_default()
            .insert(setting.attribute.clone(), setting.value.clone());
    }
    let plan_folder = arguments.schedule.parent().map(Path::to_owned).unwrap_or_default();
    let nanoseconds = |seconds: f64| (seconds * 1e9) as u64;
    let output = arguments.output.clone().unwrap_or_else(installed::latest_run);
    // What is kept over runs would make each run on the virtual clock another one.
    let logbooks = match &arguments.logbooks {
        _ if arguments.fast => output.join(LOGBOOKS),
        Some(folder) => folder.clone(),
        None => installed::outputs(LOGBOOKS),
    };
    RunOrder {
        module: arguments.module.clone().unwrap_or_default(),
        fast: arguments.fast,
        processor: arguments.processor,
        output,
        logbooks,
        key_files: arguments.key.iter().map(|(link, file)| (link.clone(), plan_folder.join(file))).collect(),
        plan_folder,
        addresses: arguments.address.iter().copied().collect(),
        overrides,
        acts: arguments.faults.planned(),
        killings: arguments.faults.killings(),
        schedule_changes: arguments.faults.schedule_changes(),
        together: arguments.together.clone().zip(arguments.place).map(|(file, (place, count))| SharedClock {
            file,
            place,
            count,
            back_ns: arguments.back_at,
        }),
        until_ns: arguments.until.map(nanoseconds),
        strict: arguments.require.is_some(),
        record: arguments.record,
        until_stdin_closes: arguments.until_stdin_closes,
        events_fd: arguments.events_fd,
        companion_fd: arguments.companion_fd,
        play: None,
        supervised: None,
    }
}
