//! `bateleur compare A B`: where two flights first differ: the port, the field, the module time, the sequence, both values.
//!
//! A and B are folders of runs or flights, or their `ports.mcap`. Every message of every port is compared, bit for bit unless
//! a tolerance is given. A log that was cut off is compared as far as it goes; that the other one goes on is a difference.
//! `--html` also writes a page with both flights: tracks, charts, figures and faults.
//! Exit codes: 0 they are equal, 1 they differ, 2 they can not be compared, or not all of it: a port that only one of them
//! has, another message type, a file that is no log, a log that is damaged and in which nothing differs all the same.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bateleur_report::compare::{
    Comparison, Difference, End, Options, Place, PortComparison, Side, Tolerance, compare, file,
};
use bateleur_report::{Flight, beside};
use serde_json::Value;

use super::replay::as_flown;
use super::{CANNOT_RUN, Code, FINE, Format, WRONG, fly};
use bateleur_executive_cli::output::refuse_file;
use bateleur_executive_cli::setting::module_time;

/// Fields of the first difference that are printed; the rest is counted.
const MOST_FIELDS: usize = 12;
/// What one look of the recorder at all ports spans at most, ns: a file may be cut off between two of them.
const CUT_NS: u64 = 1_000_000_000;
/// What a page begins with.
const PAGE_BEGINNING: &str = "<!DOCTYPE html>";

/// Show where two flights first differ.
#[derive(Debug, clap::Args)]
#[command(after_help = "Exit codes: 0 equal, 1 they differ, 2 they can not be compared, or not all of it.")]
pub struct Arguments {
    /// The folder of a run or a flight, or its ports.mcap.
    #[arg(value_name = "A")]
    a: PathBuf,
    /// The other one.
    #[arg(value_name = "B")]
    b: PathBuf,
    #[command(flatten)]
    how: How,
    /// Leave out what is after this module time, s.
    #[arg(long, value_name = "SECONDS", value_parser = module_time, allow_negative_numbers = true)]
    until: Option<f64>,
    /// Write a page with both flights: tracks, main charts, figures and faults of both.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
}

/// What is compared, how exactly, and how that is printed.
#[derive(Debug, clap::Args)]
pub(crate) struct How {
    /// Compare only this partition, port, field or element (may be repeated): estimator, estimator.state,
    /// estimator.state.euler_rad, estimator.state.euler_rad[2].
    #[arg(long, value_name = "WHERE", value_parser = place)]
    only: Vec<Place>,
    /// Leave this out (may be repeated).
    #[arg(long, value_name = "WHERE", value_parser = place)]
    ignore: Vec<Place>,
    /// Numbers may differ by so much, in the unit of their field, everywhere or somewhere (may be repeated): 1e-9,
    /// servo.timers=1. The longest place that fits counts.
    #[arg(long, value_name = "[WHERE=]NUMBER", value_parser = tolerance)]
    tolerance: Vec<Tolerance>,
    /// Module times of two messages may differ by so much: for flights on the wall clock.
    #[arg(long, value_name = "SECONDS", value_parser = module_time, default_value_t = 0.0, allow_negative_numbers = true)]
    time_tolerance: f64,
    /// Leave out what is before this module time, s.
    #[arg(long, value_name = "SECONDS", value_parser = module_time, allow_negative_numbers = true)]
    from: Option<f64>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let logs = [&arguments.a, &arguments.b].map(|path| file(path));
    if let Some(html) = &arguments.html {
        refuse_file(html, PAGE_BEGINNING, &[&logs[0], &logs[1]])?;
    }
    let (comparison, code) =
        compare_and_print((&logs[0], &logs[1]), &arguments.how, arguments.until.map(ns))?;
    if let Some(html) = &arguments.html {
        let flights = [flight(&logs[0])?, flight(&logs[1])?];
        let page = beside::page([&flights[0], &flights[1]], &comparison);
        std::fs::write(html, page).with_context(|| format!("cannot write {}", html.display()))?;
        eprintln!("page: {}", html.display());
    }
    Ok(code)
}

/// The flight that a log is of, with what it was flown with; that of the usual mission where its folder does not say.
fn flight(log: &Path) -> Result<Flight> {
    let folder = match log.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (flown, changed) = as_flown(log).unzip();
    changed.iter().flatten().for_each(|sentence| eprintln!("{sentence}"));
    let inputs = flown.map(|flown| fly::inputs_of(&flown, folder)).transpose()?.flatten();
    Ok(Flight::load(folder, &inputs.unwrap_or_default())?)
}

fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Compares two logs, to an instant of module time, and prints what came out.
pub(crate) fn compare_and_print(
    (a, b): (&Path, &Path),
    how: &How,
    until_ns: Option<u64>,
) -> Result<(Comparison, Code)> {
    let options = Options {
        from_ns: how.from.map(ns),
        until_ns,
        only: how.only.clone(),
        ignored: how.ignore.clone(),
        tolerances: how.tolerance.clone(),
        time_tolerance_ns: ns(how.time_tolerance),
    };
    let comparison = compare(a, b, &options).context("the two can not be compared")?;
    let text = match how.format {
        Format::Json => serde_json::to_string_pretty(&comparison)? + "\n",
        Format::Text => text(&comparison),
    };
    print!("{text}");
    let code = match (&comparison.incomparable[..], comparison.equal) {
        ([], true) => FINE,
        ([], false) => WRONG,
        _ => CANNOT_RUN,
    };
    Ok((comparison, code))
}

fn place(text: &str) -> Result<Place, String> {
    let parts: Vec<&str> = text.split('.').collect();
    match parts.len() {
        1..=4 if parts.iter().all(|part| !part.is_empty()) => Ok(Place(text.to_owned())),
        _ => {
            Err("name a partition, a port or a field: estimator, estimator.state, estimator.state.euler_rad"
                .into())
        }
    }
}

fn tolerance(text: &str) -> Result<Tolerance, String> {
    let (place, number) = match text.split_once('=') {
        Some((name, number)) => (Some(place(name)?), number),
        None => (None, text),
    };
    let at_most = number.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    let wrong = || format!("\"{number}\" is no tolerance: give a number of 0 or more, or WHERE=NUMBER");
    Ok(Tolerance { place, at_most: at_most.ok_or_else(wrong)? })
}

fn text(comparison: &Comparison) -> String {
    let Comparison { a, b, first, ports, incomparable, equal } = comparison;
    let mut text = String::new();
    // Into a string: nothing of this can fail.
    let _ = writeln!(text, "A  {}\nB  {}", end(a), end(b));
    for sentence in incomparable {
        let _ = writeln!(text, "not compared: {sentence}");
    }
    match first {
        Some(first) => {
            text.push_str(&first_difference(first, a, b));
            text.push_str(&table(ports));
        }
        None if *equal => {
            let messages: u64 = ports.iter().map(|port| port.compared).sum();
            let _ = writeln!(
                text,
                "equal: {} on {}",
                count(messages, "message"),
                count(ports.len() as u64, "port")
            );
        }
        None if ports.iter().all(|port| port.compared == 0) => text.push_str("nothing was compared\n"),
        None => text.push_str("what could be compared is equal\n"),
    }
    text
}

fn end(end: &End) -> String {
    let cut = end.cut.as_ref().map_or_else(String::new, |why| format!(", cut off there ({why})"));
    let damaged = end.damaged.as_ref().map_or_else(String::new, |why| format!(", damaged: {why}"));
    let messages = count(end.messages, "message");
    format!("{}: {messages}, to {:.3} s{cut}{damaged}", end.file.display(), end.time_ns as f64 / 1e9)
}

fn first_difference(first: &Difference, a: &End, b: &End) -> String {
    let Difference { port, sequence, time_ns, .. } = first;
    let mut text = format!(
        "first difference at {:.6} s: {port} ({}), sequence {sequence}\n",
        *time_ns as f64 / 1e9,
        first.message
    );
    if let Some(side) = first.only_in {
        let (name, other, end) = if side == Side::A { ("A", "B", b) } else { ("B", "A", a) };
        let end_s = end.time_ns as f64 / 1e9;
        // What is missing at the end of a file that was cut off is missing because of that: the recorder writes port by port.
        let _ = match (end.time_ns < *time_ns, &end.cut) {
            (_, Some(_)) if end.time_ns < time_ns.saturating_add(CUT_NS) => {
                writeln!(text, "  only {name} has it: {other} is cut off there, at {end_s:.6} s")
            }
            (true, _) => writeln!(text, "  only {name} has it: {other} ends at {end_s:.6} s"),
            (false, _) => writeln!(text, "  only {name} has it"),
        };
        return text;
    }
    let _ = writeln!(text, "  {:<32} {:>24} {:>24} {:>12}", "field", "A", "B", "B - A");
    for field in first.fields.iter().take(MOST_FIELDS) {
        let (a, b) = (word(&field.a), word(&field.b));
        let _ = writeln!(text, "  {:<32} {a:>24} {b:>24} {:>12}", field.field, short(field.difference));
    }
    let more = first.fields.len().saturating_sub(MOST_FIELDS) as u64 + first.more_fields;
    if more > 0 {
        let _ = writeln!(text, "  and {}", count(more, "more field"));
    }
    text
}

/// The ports that differ, the earliest first.
fn table(ports: &[PortComparison]) -> String {
    let mut different: Vec<(&PortComparison, u64)> =
        ports.iter().filter_map(|port| Some((port, port.first.as_ref()?.time_ns))).collect();
    different.sort_by_key(|(_, time_ns)| *time_ns);
    let mut text = format!(
        "\n{:<36} {:>10} {:>10} {:>9} {:>9} {:>12}\n",
        "port", "compared", "different", "only in A", "only in B", "first at, s"
    );
    for (port, time_ns) in &different {
        let _ = writeln!(
            text,
            "{:<36} {:>10} {:>10} {:>9} {:>9} {:>12.6}",
            port.port,
            port.compared,
            port.different,
            port.only_a,
            port.only_b,
            *time_ns as f64 / 1e9
        );
    }
    let equal = ports.len() - different.len();
    if equal > 0 {
        let _ = writeln!(
            text,
            "{} equal",
            if equal == 1 { "1 port is".into() } else { format!("{equal} ports are") }
        );
    }
    text
}

fn count(number: u64, thing: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {thing}{plural}")
}

fn word(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Enough digits to see how far apart two values are.
fn short(difference: f64) -> String {
    match difference.abs() {
        size if size == 0.0 || (1e-3..1e9).contains(&size) => {
            format!("{difference:.6}").trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        _ => format!("{difference:.2e}"),
    }
}
