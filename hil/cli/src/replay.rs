//! `bateleur replay FOLDER`: feeds the sensors, sticks and orders of a recorded flight to the same flight functions in one plain
//! loop of one process, without partitions, windows and ports, and compares every actuator word.
//!
//! Schedule and attributes are those that the flight's `run.json` names; the times at which the functions run in a cycle and how long
//! values are valid come from the schedule file. With `--output` the loop's own ports.mcap is kept. Exit codes: 0 every word of
//! every cycle is equal, 1 some differ or are missing, 2 it could not be replayed.

mod planned;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bateleur_main_cycle::{OUTPUTS, Replayed, Topics, replay};
use bateleur_report::compare::{Comparison, Options, Place, SEQUENCE, compare, file};
use bateleur_report::run::{FILE, Run};
use clap::Parser;

use super::{CANNOT_RUN, Code, FINE, Format, WRONG, fly};
use bateleur_executive_cli::installed::usual_schedule;
use bateleur_executive_cli::output::{LOG_BEGINNING, refuse_file};
use bateleur_executive_cli::plan_file;
use bateleur_executive_cli::setting::parse_setting;

/// Fly a recorded flight again in one plain loop, and compare every actuator word.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 every actuator word is equal; 1 some differ or are missing; 2 it could not be replayed."
)]
pub struct Arguments {
    /// The folder of a flight, or its ports.mcap.
    #[arg(value_name = "FOLDER|FILE")]
    flight: PathBuf,
    /// The schedule file [default: the one that the flight had].
    #[arg(long, short)]
    schedule: Option<PathBuf>,
    /// Replace an attribute of the plan, as the flight did (may be repeated).
    #[arg(long, value_name = "PARTITION.ATTRIBUTE=VALUE")]
    set: Vec<String>,
    /// Keep what the loop gave, as a log that `bateleur compare` and viewers read.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// How the flight was asked for, by its own words.
#[derive(Debug, Parser)]
struct AsFlown {
    #[command(flatten)]
    flown: fly::Arguments,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let log = file(&arguments.flight);
    if let Some(output) = &arguments.output {
        let given = arguments.schedule.clone().unwrap_or_else(usual_schedule);
        refuse_file(output, LOG_BEGINNING, &[&log, &given])?;
    }
    std::fs::metadata(&log).with_context(|| format!("cannot read {}", log.display()))?;
    let (flown, changed) = as_flown(&log).unzip();
    if flown.is_none() {
        eprintln!(
            "no {FILE} beside {} says how it was flown: airframe, mission and attributes are those of the plan and of this command",
            log.display()
        );
    }
    for sentence in changed.iter().flatten() {
        eprintln!("{sentence}");
    }
    let schedule = arguments.schedule.clone().or_else(|| flown.as_ref().map(|flown| flown.schedule.clone()));
    let schedule = schedule.unwrap_or_else(usual_schedule);
    let Some(plan) = plan_file::read_or_say(&schedule)? else { return Ok(CANNOT_RUN) };
    let mut given = planned::Attributes::of(&plan);
    let module = flown.as_ref().and_then(|flown| flown.module.clone());
    for flown in flown.iter() {
        if let Some(airframe) = &flown.airframe {
            ["controller", "servo"]
                .iter()
                .try_for_each(|program| given.set_airframe(&plan, program, airframe))?;
        }
        let mission = fly::read_mission(flown, &plan)?;
        set(&mut given, &fly::settings(flown, &plan, &mission)?)?;
    }
    set(&mut given, &arguments.set)?;
    let (settings, topics) = planned::read(&plan, module.as_deref(), &given)?;
    // Beside its place, and put there when it is whole: what could not be replayed leaves an earlier one as it was.
    let place = arguments.output.as_deref().filter(|output| !output.exists() || output.is_file());
    let scratch = match place.and_then(Path::parent) {
        Some(folder) if folder.as_os_str().is_empty() => tempfile::tempdir_in("."),
        Some(folder) => tempfile::tempdir_in(folder),
        None => tempfile::tempdir(),
    };
    let scratch = scratch.context("cannot make a folder for the loop's log")?;
    let own = scratch.path().join("loop.mcap");
    let replayed =
        replay(&log, settings, &topics, &own).with_context(|| format!("cannot replay {}", log.display()))?;
    let comparison = compare(&log, &own, &only_outputs(&topics, &plan))?;
    if let Some(output) = &arguments.output {
        let put = match place {
            Some(place) => std::fs::rename(&own, place),
            None => std::fs::copy(&own, output).map(|_| ()),
        };
        put.with_context(|| format!("cannot write {}", output.display()))?;
    }
    let text = match arguments.format {
        Format::Json => {
            let all = serde_json::json!({ "replayed": &replayed, "comparison": &comparison });
            serde_json::to_string_pretty(&all)? + "\n"
        }
        Format::Text => text(&replayed, &comparison),
    };
    print!("{text}");
    let words = &replayed.words;
    Ok(if words.different == 0 && words.absent_cycles == 0 { FINE } else { WRONG })
}

/// What the flight was asked for, and a sentence for each file that is another since; nothing where its folder does not say.
pub(crate) fn as_flown(log: &Path) -> Option<(fly::Arguments, Vec<String>)> {
    let folder = log.parent()?;
    let text = std::fs::read(folder.join(FILE)).ok()?;
    let run: Run = serde_json::from_slice(&text).ok()?;
    let words: Vec<String> = serde_json::from_value(run.arguments).ok()?;
    // The first word is the verb, where a program's name is expected.
    AsFlown::try_parse_from(words).ok().map(|as_flown| fly::kept::as_flown(folder, as_flown.flown))
}

fn set(given: &mut planned::Attributes, settings: &[String]) -> Result<()> {
    for text in settings {
        let setting = parse_setting(text).map_err(anyhow::Error::msg)?;
        given.set(&setting.partition, &setting.attribute, setting.value);
    }
    Ok(())
}

/// Everything that the loop gives too. A partition that was restarted counts its messages anew; the loop was not. On the wall
/// clock a message carries the instant at which it was written, in the loop that of its turn.
fn only_outputs(topics: &Topics, plan: &bateleur_plan::Plan) -> Options {
    let ports: Vec<String> =
        topics.outputs.iter().map(|topic| topic.trim_start_matches('/').replace('/', ".")).collect();
    let place = |port: &String| Place(port.clone());
    let sequence = |port: &String| Place(format!("{port}.{SEQUENCE}"));
    let frame_ns = plan.schedules.iter().map(|schedule| schedule.minor_frame_ns).min().unwrap_or_default();
    Options {
        only: ports.iter().map(place).collect(),
        ignored: ports.iter().map(sequence).collect(),
        time_tolerance_ns: frame_ns / 2,
        ..Options::default()
    }
}

fn text(replayed: &Replayed, comparison: &Comparison) -> String {
    let Replayed { cycles, words, flaw, too_late } = replayed;
    let mut text = String::new();
    // Into a string: nothing of this can fail.
    let _ = writeln!(text, "{cycles} cycles, {} actuator words: {} differ", words.compared, words.different);
    if let (Some(first_ns), Some(last_ns)) = (words.first_ns, words.last_ns) {
        let (first_s, last_s) = (first_ns as f64 / 1e9, last_ns as f64 / 1e9);
        let _ = writeln!(text, "the first at {first_s:.3} s, the last at {last_s:.3} s");
        let list: Vec<String> =
            words.greatest.iter().map(|(word, size)| format!("{word} by {size}")).collect();
        let _ = writeln!(text, "at most: {}", list.join(", "));
    }
    if words.absent_cycles > 0 {
        let _ = writeln!(text, "{} cycles in which the flight gave no words", words.absent_cycles);
    }
    if let Some(flaw) = flaw {
        let _ = writeln!(text, "the log {flaw}: replayed as far as it goes");
    }
    if *too_late > 0 {
        let _ = writeln!(text, "{too_late} messages stand in the log too late to be used in their cycle");
    }
    let _ = writeln!(
        text,
        "\n{:<28} {:>9} {:>9} {:>10} {:>10} {:>12}",
        "port", "compared", "differ", "flight only", "loop only", "first at, s"
    );
    debug_assert_eq!(comparison.ports.len(), OUTPUTS.len());
    for port in &comparison.ports {
        let first = port
            .first
            .as_ref()
            .map_or_else(|| "-".into(), |first| format!("{:.3}", first.time_ns as f64 / 1e9));
        let _ = writeln!(
            text,
            "{:<28} {:>9} {:>9} {:>10} {:>10} {first:>12}",
            port.port, port.compared, port.different, port.only_a, port.only_b
        );
    }
    text
}
