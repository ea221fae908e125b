//! `bateleur check`: holds every rule against a schedule file and reports all violations at once, each with its place,
//! the other place involved, and a way to mend it. Nothing is started.
//!
//! Of a plan for several modules it says what each link costs. With `--verbose` it also says what is no fault: notes, how full each core is, how old each chain becomes. Exit codes:
//! 0 the file can be used, 1 it can be used and has warnings, which `--deny warnings` forbids, 2 it can not be used.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_checker::{Facts, RULES, Report, Rule, example_of};
use bateleur_plan::Plan;
use bateleur_plan::compiled::{self, Compiled};

use super::{CANNOT_RUN, Code, FINE, WRONG};
use crate::installed::usual_schedule;
use crate::output::refuse_file;
use crate::plan_file::{self, Messages};
use crate::words::nearest;

/// Check a schedule file against every rule.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 the file can be used; 1 it has warnings, and they are denied; 2 it can not be used."
)]
pub struct Arguments {
    /// The schedule file [default: schedule.toml].
    file: Option<PathBuf>,
    /// The schedule file, as the other verbs name it.
    #[arg(long, short, value_name = "FILE", conflicts_with = "file")]
    schedule: Option<PathBuf>,
    /// Say why a rule exists, with an example that breaks it and how to mend that, and end.
    #[arg(long, value_name = "RULE")]
    explain: Option<String>,
    /// End with code 1 where there is a warning.
    #[arg(long, value_name = "WHAT", value_parser = ["warnings"])]
    deny: Option<String>,
    /// Look for the partitions' programs in this folder.
    #[arg(long, value_name = "FOLDER")]
    programs: Option<PathBuf>,
    /// Look whether the keys of links can be used here.
    #[arg(long)]
    keys: bool,
    /// Write the compiled plan, which `bateleurd` runs, into this file.
    #[arg(long, value_name = "FILE")]
    compile: Option<PathBuf>,
    /// Print notes and what follows from the file too: how full the cores are, how old the chains become.
    #[arg(long, short)]
    verbose: bool,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// What the report is printed as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// For a person.
    Text,
    /// For a program.
    Json,
    /// For editors and code hosts (SARIF 2.1.0).
    Sarif,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if let Some(rule) = &arguments.explain {
        return explain(rule);
    }
    let given = arguments.file.as_ref().or(arguments.schedule.as_ref());
    let path = &given.cloned().unwrap_or_else(usual_schedule);
    if let Some(folder) = arguments.programs.as_ref().filter(|folder| !folder.is_dir()) {
        bail!(
            "{} is no folder: name the one with the built programs, such as target/release",
            folder.display()
        );
    }
    if let Some(output) = &arguments.compile {
        refuse_file(output, compiled::MAGIC, &[path])?;
    }
    let source = plan_file::read_text_of(path)?;
    let read = plan_file::check_among_files(path, &source, arguments.programs.as_deref(), arguments.keys);
    let (plan, report) = match &read {
        Ok((plan, report)) => (Some(plan), report),
        Err(report) => (None, report),
    };
    match arguments.format {
        Format::Json => println!("{:#}", json(plan, report)),
        Format::Sarif => println!("{:#}", report.to_sarif()),
        Format::Text => print!("{}", text(arguments, path, plan, report)),
    }
    match (plan, report.warnings()) {
        (None, _) => Ok(CANNOT_RUN),
        (Some(_), 1..) if arguments.deny.is_some() => Ok(WRONG),
        (Some(plan), _) => {
            if let Some(output) = &arguments.compile {
                let bytes = Compiled::new(&path.display().to_string(), &source, plan.clone()).write()?;
                std::fs::write(output, bytes)
                    .with_context(|| format!("cannot write {}", output.display()))?;
            }
            Ok(FINE)
        }
    }
}

fn json(plan: Option<&Plan>, report: &Report) -> serde_json::Value {
    let mut document = report.to_json();
    document["facts"] = plan.map_or(serde_json::Value::Null, |plan| serde_json::json!(Facts::of(plan)));
    document
}

fn text(arguments: &Arguments, path: &Path, plan: Option<&Plan>, report: &Report) -> String {
    let color = std::io::stdout().is_terminal();
    let mut text = if arguments.verbose { report.render_all(color) } else { report.render(color) };
    let Some(plan) = plan else { return text };
    text.push_str(&format!("{}: {}\n", path.display(), counts(plan, report)));
    text.push_str(&super::show::facts::links(plan, &Facts::of(plan)));
    if arguments.verbose {
        text.push_str(&super::show::facts::text(plan, &Facts::of(plan)));
        text.push_str(&memory(&Facts::of(plan)));
    }
    text
}

fn counts(plan: &Plan, report: &Report) -> String {
    let verdict = match report.warnings() {
        0 => "fine".to_owned(),
        1 => "usable, with a warning".to_owned(),
        several => format!("usable, with {several} warnings"),
    };
    format!(
        "{} module(s), {} partitions, {} channels, {} schedule(s): {verdict}",
        plan.modules.len(),
        plan.partitions.len(),
        plan.channels.len(),
        plan.schedules.len()
    )
}

/// What the modules' partitions may use together, against what this machine has: worth knowing, and no more, because the
/// module may be meant for another machine.
fn memory(facts: &Facts) -> String {
    let mebibytes = |bytes: u64| bytes >> 20;
    let machine = machine_memory_bytes();
    let line = |module: &bateleur_checker::facts::ModuleMemory| {
        let here = match machine {
            Some(machine) if module.memory_bytes > machine => {
                format!(": MORE than the {} MiB of this machine", mebibytes(machine))
            }
            Some(machine) => format!(" of {} MiB on this machine", mebibytes(machine)),
            None => String::new(),
        };
        format!("memory of `{}`: {} MiB{here}\n", module.module, mebibytes(module.memory_bytes))
    };
    facts.memory.iter().map(line).collect()
}

fn machine_memory_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes << 10)
}

fn explain(id: &str) -> Result<Code> {
    let rule = find(id)?;
    let example = example_of(rule, &Messages::beside(rule.example_name))
        .context("the rule has no example: this is a fault of the checker")?;
    println!("{}: {}\n\n{}\n", rule.id, severity(rule), rule.reason);
    println!("For example, and how to mend it:\n\n{}", example.render_first(std::io::stdout().is_terminal()));
    Ok(FINE)
}

fn severity(rule: &Rule) -> &'static str {
    use bateleur_checker::Severity;
    match rule.severity {
        Severity::Error => "an error, there is no plan",
        Severity::Warning => "a warning, there is a plan that is probably not the one that was meant",
        Severity::Note => "a note, worth knowing and no fault",
    }
}

/// A rule by its whole id, its number, or its name; upper and lower case are the same.
fn find(id: &str) -> Result<&'static Rule> {
    let asked = id.to_lowercase();
    let names = |rule: &Rule| {
        let whole = rule.id.to_lowercase();
        let (number, name) = whole.split_once('-').unwrap_or((&whole, ""));
        [whole.clone(), number.to_owned(), name.to_owned()]
    };
    if let Some(rule) = RULES.iter().find(|rule| names(rule).contains(&asked)) {
        return Ok(rule);
    }
    let all: Vec<(String, &Rule)> =
        RULES.iter().flat_map(|rule| names(rule).map(|name| (name, rule))).collect();
    let near = nearest(&asked, all.iter().map(|(name, _)| name.as_str()));
    match near.and_then(|near| all.iter().find(|(name, _)| name == near)) {
        Some((_, rule)) => bail!("there is no rule {id}: did you mean {}?", rule.id),
        None => {
            bail!("there is no rule {id}: a report names the rule in brackets, such as T03-window-overlap")
        }
    }
}
