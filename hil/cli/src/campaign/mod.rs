//! `bateleur campaign`: many flights on the virtual clock, each with its own seed, air, aircraft, faults and kills, side by side;
//! a table of how their figures spread, and what to type to fly a failed one again.
//!
//! Results are appended to `flights.jsonl` in the campaign's folder, a whole line a flight. The same command goes on where it was stopped.
//! With `--shard` a machine flies a part; `bateleur campaign merge` joins the parts. A flight that fails, hangs or crashes counts as failed
//! and stops nothing. Progress goes to standard error, the result to standard output, and to `report.html` and `result.json`. Exit codes: 0 every
//! flight completed its mission, 1 some did not, or it was stopped, 2 it could not begin.

mod again;
mod fleet;
mod flight;
mod merge;
mod shard;
mod space;

use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_host::programs::program_path;
use bateleur_monitor::inject::EXECUTIVE;
use bateleur_plan::{ModuleAction, ModuleError, Plan as SchedulePlan};
use bateleur_report::campaign::{CampaignResult, Plan, RESULTS, page, read, read_plan, repair, text};
use bateleur_system::sched;
use clap::Parser;
use rustix::fs::{FlockOperation, flock};

use super::air::seed;
use super::{CANNOT_RUN, Code, FINE, Format, WRONG, fly};
use crate::fly::here::{self, Engine};
use bateleur_executive_cli::installed::{self, SCHEDULE};
use bateleur_executive_cli::plan_file;
use fleet::Fleet;
use flight::Order;
use shard::Shard;
use space::Space;

/// Memory that a flight takes at most, bytes: its processes (60 MB measured), its logs on their way to the disk, its report. Too
/// little, and a machine with many processors and little memory ends flights.
const FLIGHT_BYTES: u64 = 256 << 20;
/// Fly many flights with drawn conditions and show how their figures spread.
#[derive(Debug, Clone, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Exit codes: 0 every flight completed its mission; 1 some did not, or it was stopped; 2 it could not begin."
)]
pub struct Arguments {
    #[command(subcommand)]
    merge: Option<Verb>,
    /// How many flights there are in all shards together.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    flights: u64,
    /// Seed of the first flight; the next one has the next.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = seed, allow_negative_numbers = true)]
    seed: u64,
    /// The schedule file.
    #[arg(long, short, default_value = SCHEDULE, value_parser = installed::schedule())]
    schedule: PathBuf,
    /// What flies: each partition a process, or all in one process where that shows all of the flight; then one flight in twenty is
    /// flown a second time as partitions, and every actuator word has to be the same.
    #[arg(long, value_enum, default_value_t)]
    engine: Engine,
    #[command(flatten)]
    space: Space,
    /// Flights side by side [default: one for each processor that this program may use].
    #[arg(long, short, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    jobs: Option<u16>,
    /// Fly only this part: I/N with I from 0 to N-1; env/N or env takes the place from a job array (SLURM_ARRAY_TASK_ID,
    /// JOB_COMPLETION_INDEX).
    #[arg(long, value_name = "I/N", value_parser = shard::parse)]
    shard: Option<Shard>,
    /// Folder of the campaign; a shard has one of its own in it [default: one below target/campaigns, by what is flown].
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Keep the logs of every flight, not of failed ones alone: 30 MB each.
    #[arg(long)]
    keep: bool,
    /// Of how many failed flights the logs are kept; each can be flown again from its seed.
    #[arg(long, value_name = "N", default_value_t = 20)]
    keep_failed: u64,
    /// A program of one's own that says whether a flight or run went well: it gets the folder as its argument and the seed in
    /// BATELEUR_SEED; exit code 0 pass, 1 fail, and its last line why.
    #[arg(long, value_name = "PROGRAM")]
    judge: Option<PathBuf>,
    /// Module time of each run, s, of a plan that does not fly: kills are drawn, and the judge decides.
    #[arg(long, value_name = "SECONDS", requires = "judge", value_parser = module_time)]
    until: Option<f64>,
    /// Real time after which a flight hangs, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    patience: u64,
    /// What to print at the end.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// Options of `bateleur fly` (with `--until`, of `bateleur run`) that every flight has; `{seed}` in them is the flight's seed.
    #[arg(last = true, value_name = "OPTIONS OF FLY")]
    common: Vec<String>,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum Verb {
    Merge(merge::Arguments),
}

/// What the options of a flight are checked with before the first one starts.
#[derive(Debug, Parser)]
#[command(name = "bateleur fly", disable_help_flag = true)]
struct OfFly {
    #[command(flatten)]
    options: fly::Arguments,
}

/// The same for a plan that does not fly.
#[derive(Debug, Parser)]
#[command(name = "bateleur", disable_help_flag = true)]
struct OfRun {
    #[command(subcommand)]
    _verb: bateleur_executive_cli::Verb,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(Verb::Merge(merge)) = &arguments.merge {
        return merge::run(merge);
    }
    let Some(schedule) = plan_file::read_or_say(&arguments.schedule)? else { return Ok(CANNOT_RUN) };
    if arguments.until.is_none() {
        let flies = crate::fly::check_flies(&schedule);
        flies.context("a plan that does not fly needs --until SECONDS, and a --judge of one's own")?;
    } else if arguments.engine != Engine::Partitions {
        bail!(
            "--engine {}: only flights are flown so, and with --until a plan runs that does not fly",
            arguments.engine.name()
        );
    } else if let Some(what) = arguments.space.of_flights_alone() {
        bail!("only flights draw that ({what}): with --until a run draws kills, and nothing else");
    }
    let arguments = &Arguments { judge: judge(arguments)?, ..arguments.clone() };
    let hosts = arguments.until.is_none() && flies_hosts(arguments, &schedule);
    let victims = victims(arguments, &schedule, hosts).map_err(anyhow::Error::msg)?;
    check_options(arguments, hosts, &victims)?;
    let plan = plan(arguments, &schedule, &victims)?;
    let folder = folder(arguments, &plan);
    let results = open(&folder, &plan)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let known = read(&folder)?;
    let missing: Vec<u64> = plan.numbers().filter(|number| !known.flights.contains_key(number)).collect();
    say_beginning(&plan, &folder, missing.len());
    let orders = missing
        .into_iter()
        .map(|number| order(arguments, (&plan, &schedule, hosts), &victims, &folder, number));
    let fleet = Fleet {
        jobs: jobs(arguments),
        cores: sched::allowed_cores(),
        keep: arguments.keep,
        keep_failed: arguments.keep_failed,
        kept: known.flights.values().filter(|flight| !flight.completed && flight.folder.is_some()).count()
            as u64,
        stop: stop.clone(),
    };
    let flown = fleet.fly(orders.collect(), results);
    let result = CampaignResult::of(&plan, &read(&folder)?);
    finish(&result, Some(&folder), arguments.format)?;
    flown?;
    let interrupted = stop.load(Ordering::Acquire);
    if interrupted {
        eprintln!("stopped; the same command goes on where it was");
    }
    let all_well = !interrupted && result.completed == result.asked;
    Ok(if all_well { FINE } else { WRONG })
}

/// The judge, where it is.
fn judge(arguments: &Arguments) -> Result<Option<PathBuf>> {
    let Some(judge) = &arguments.judge else { return Ok(None) };
    let found = std::fs::canonicalize(judge).with_context(|| format!("--judge {}", judge.display()))?;
    if !found.is_file() || rustix::fs::access(&found, rustix::fs::Access::EXEC_OK).is_err() {
        bail!("--judge {}: it is no program that can be started (chmod +x?)", judge.display());
    }
    Ok(Some(found))
}

fn module_time(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.1..=1e6).contains(seconds));
    seconds.ok_or_else(|| format!("\"{text}\" is not a number of seconds from 0.1 to 1000000"))
}

/// A plan of several modules is flown with all of them, unless the options of every flight choose one.
fn flies_hosts(arguments: &Arguments, plan: &SchedulePlan) -> bool {
    let chosen = |word: &String| word == "--hosts" || word == "--module" || word.starts_with("--module=");
    plan.modules.len() > 1 && !arguments.common.iter().any(chosen)
}

/// Who may be killed. Relays only where they are named: one that dies alone takes its address again in real time, and its flight is
/// not the same twice. The executive, too, as `--kill` takes it.
fn victims(arguments: &Arguments, plan: &SchedulePlan, hosts: bool) -> Result<Vec<String>, String> {
    let names = |with_all: bool| {
        let partitions = plan.partitions.iter().filter(move |one| with_all || !one.relay);
        partitions.map(|partition| partition.name.clone())
    };
    let executive = (!hosts).then(|| EXECUTIVE.to_owned());
    let named = arguments.space.victims(&names(true).chain(executive).collect::<Vec<_>>())?;
    let comes_back = plan.health.module.action(ModuleError::ExecutiveDied) == ModuleAction::Reset;
    if named.iter().any(|name| name == EXECUTIVE) && !comes_back {
        return Err(format!(
            "--kill-only {EXECUTIVE}: it would end the flight; write executive_died = \"reset\" in [health.module] of the plan"
        ));
    }
    Ok(if named.is_empty() { names(false).collect() } else { named.to_vec() })
}

/// Options of fly that it would refuse would fail every flight: they are refused here.
fn check_options(arguments: &Arguments, hosts: bool, victims: &[String]) -> Result<()> {
    let mut words = vec![flight::FLY.to_owned()];
    words.extend(options(arguments, hosts, arguments.seed, victims).0);
    words.push("--output=somewhere".into());
    let checked = match arguments.until {
        None => OfFly::try_parse_from(words.into_iter().chain(["--format=json".into()])).map(drop),
        Some(_) => {
            words.splice(..1, ["bateleur".into(), flight::RUN.to_owned()]);
            OfRun::try_parse_from(words).map(drop)
        }
    };
    match checked {
        Ok(()) => Ok(()),
        Err(error) => bail!("the options after -- are not for every flight: {error}"),
    }
}

/// The options of the flight with a seed, and its conditions as numbers.
fn options(
    arguments: &Arguments,
    hosts: bool,
    seed: u64,
    victims: &[String],
) -> (Vec<String>, std::collections::BTreeMap<String, f64>) {
    let drawn = match arguments.until {
        None => arguments.space.draw(seed, victims),
        Some(until_s) => arguments.space.draw_run(seed, victims, until_s),
    };
    let mut options = vec!["--fast".to_owned(), format!("--schedule={}", arguments.schedule.display())];
    options.extend(hosts.then(|| "--hosts".to_owned()));
    options.extend(arguments.until.map(|until_s| format!("--until={until_s}")));
    options.extend(drawn.options);
    options.extend(arguments.common.iter().map(|word| word.replace("{seed}", &seed.to_string())));
    (options, drawn.conditions)
}

fn plan(arguments: &Arguments, schedule: &SchedulePlan, victims: &[String]) -> Result<Plan> {
    let Shard { part, parts } = arguments.shard.unwrap_or(Shard { part: 0, parts: 1 });
    if arguments.seed.checked_add(arguments.flights).is_none() {
        bail!("--seed and --flights together go beyond the last seed there is, {}", u64::MAX);
    }
    let own = std::env::current_exe().context("cannot find this program")?;
    let engine = (arguments.engine != Engine::Partitions).then(|| arguments.engine.name());
    let folder = arguments.schedule.parent().map(Path::to_owned).unwrap_or_default();
    Ok(Plan {
        flights: arguments.flights,
        seed: arguments.seed,
        shard: (part, parts),
        space: match arguments.until {
            None => arguments.space.sentences(victims),
            Some(_) => arguments.space.run_sentences(victims),
        },
        common: arguments
            .until
            .map(|until_s| format!("--until={until_s}"))
            .into_iter()
            .chain(engine.map(|name| format!("--engine={name}")))
            .chain(arguments.common.clone())
            .collect(),
        schedule: Plan::digest_of(&[&arguments.schedule])?,
        programs: Plan::digest_of(
            &programs(&own, schedule, &folder).into_iter().chain(arguments.judge.clone()).collect::<Vec<_>>(),
        )?,
        version: env!("CARGO_PKG_VERSION").into(),
    })
}

/// The programs of a flight, on which its outcome depends: this one, the simulator, and whatever the schedule's partitions run.
fn programs(own: &Path, schedule: &SchedulePlan, folder: &Path) -> Vec<PathBuf> {
    let simulator = own.with_file_name("simulator");
    let partitions = schedule.partitions.iter().map(|partition| program_path(&partition.program, folder));
    // In an order that does not depend on where they lie: shards are flown on several machines.
    [own.to_owned(), simulator].into_iter().chain(partitions).filter(|path| path.exists()).collect()
}

fn folder(arguments: &Arguments, plan: &Plan) -> PathBuf {
    let whole = arguments.output.clone().unwrap_or_else(|| installed::outputs("campaigns").join(plan.name()));
    match arguments.shard {
        Some(Shard { part, parts }) => whole.join(format!("shard-{part}-of-{parts}")),
        None => whole,
    }
}

/// Opens the results for appending, alone, with what an earlier run of the same campaign left.
fn open(folder: &Path, plan: &Plan) -> Result<File> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(RESULTS);
    let mut open = OpenOptions::new();
    let results = open
        .create(true)
        .append(true)
        .open(&path)
        .with_context(|| format!("cannot write {}", path.display()))?;
    if flock(&results, FlockOperation::NonBlockingLockExclusive).is_err() {
        bail!(
            "another campaign writes into {}: wait for it, or name another folder with --output",
            folder.display()
        );
    }
    if let Some(older) = read_plan(folder)? {
        let why = older
            .disagreement(plan)
            .or_else(|| older.other_programs(plan))
            .or_else(|| older.other_shard(plan));
        if let Some(why) = why {
            bail!(
                "{} holds another campaign ({why}): name another folder with --output, or remove this one",
                folder.display()
            );
        }
    }
    let torn = repair(folder)?;
    if torn > 0 {
        eprintln!("the last line of the results was cut off and is taken away: its flight is flown again");
    }
    plan.write(folder)?;
    Ok(results)
}

fn say_beginning(plan: &Plan, folder: &Path, missing: usize) {
    let all = plan.numbers().count();
    let done = all - missing;
    let of = if done > 0 { format!(", {done} of {all} are there already") } else { String::new() };
    eprintln!("{missing} flights to fly{of}; results in {}", folder.display());
}

fn order(
    arguments: &Arguments,
    (plan, schedule, hosts): (&Plan, &SchedulePlan, bool),
    victims: &[String],
    folder: &Path,
    number: u64,
) -> Order {
    let seed = plan.seed + number;
    let (options, conditions) = options(arguments, hosts, seed, victims);
    let verb = if arguments.until.is_some() { flight::RUN } else { flight::FLY };
    Order {
        number,
        seed,
        verb,
        engine: engine(arguments, schedule, &options),
        mixed: arguments.engine != Engine::Partitions,
        options,
        judge: arguments.judge.clone(),
        conditions,
        folder: folder.join("flights").join(number.to_string()),
        patience: Duration::from_secs(arguments.patience),
    }
}

/// What flies a flight with these options: one process only where that was asked for and shows all of it.
fn engine(arguments: &Arguments, schedule: &SchedulePlan, options: &[String]) -> Engine {
    if arguments.engine == Engine::Partitions {
        return Engine::Partitions;
    }
    let words = ["fly".to_owned()].into_iter().chain(options.iter().cloned());
    match OfFly::try_parse_from(words) {
        Ok(of_fly) if here::unsuitable(&of_fly.options, schedule).is_none() => Engine::OneProcess,
        _ => Engine::Partitions,
    }
}

/// A flight on the virtual clock is one thread of thought: its processes take turns. So one processor flies one flight, and memory
/// is the other bound.
fn jobs(arguments: &Arguments) -> usize {
    if let Some(jobs) = arguments.jobs {
        return usize::from(jobs);
    }
    let by_memory = available_bytes().map_or(usize::MAX, |bytes| (bytes / FLIGHT_BYTES) as usize);
    sched::allowed_cores().len().min(by_memory).max(1)
}

/// Memory that programs may still take, by the system's own estimate.
fn available_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.split_ascii_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

/// Writes the result into the campaign's folder, and prints it.
fn finish(result: &CampaignResult, folder: Option<&Path>, format: Format) -> Result<()> {
    let json = serde_json::to_string_pretty(result)? + "\n";
    if let Some(folder) = folder {
        let write = |name: &str, text: &str| {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
        };
        write("result.json", &json)?;
        write("report.html", &page(result))?;
    }
    let mut printed = match format {
        Format::Json => json,
        Format::Text => text(result),
    };
    if let (Format::Text, Some(folder)) = (format, folder) {
        printed += &format!("report: {}\n", folder.join("report.html").display());
    }
    print!("{printed}");
    Ok(())
}
