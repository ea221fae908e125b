//! What a schedule file lacks for a partition that is not in it: its table, and a window where the core is free.

use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_plan::units::{ShowTime, duration_ns};
use bateleur_plan::{ModuleId, Plan, Schedule, Timeline};

use super::list::with_item;
use crate::plan_file;
use crate::{CANNOT_RUN, Code, FINE};

/// Left free before and after a window that is added: a switch takes some of it.
const GAP_NS: u64 = 100_000;
/// The longest name of a partition.
const LONGEST_NAME: usize = 30;

/// The partition that is wanted.
pub(super) struct Wish<'a> {
    pub(super) name: &'a str,
    /// `None`: the only module.
    pub(super) module: Option<&'a str>,
    pub(super) window_ns: u64,
    /// As the schedule file names it.
    pub(super) program: String,
    /// The most that it may create.
    pub(super) processes: u32,
    /// What else the command that writes it has to say.
    pub(super) option: &'static str,
}

/// What is missing.
pub(super) struct Missing {
    name: String,
    /// The partition's table.
    table: String,
    /// The schedule that the module starts with.
    schedule: String,
    /// Its window there; `None` if it would have to be so long in every minor frame, and no hole of the core is.
    window: Result<String, String>,
    option: &'static str,
}

/// A length of a window on the command line.
pub(super) fn window_length(text: &str) -> Result<u64, String> {
    match duration_ns(text) {
        Ok(0) => Err("a window has a length".into()),
        Ok(ns) => Ok(ns),
        Err(error) => Err(format!("{error}: write a time such as 500us")),
    }
}

impl Missing {
    pub(super) fn of(plan: &Plan, wish: &Wish<'_>) -> Result<Self> {
        let name = wish.name;
        let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '-';
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(plain) {
            bail!(
                "`{name}` can not be a partition: a name has 1 to {LONGEST_NAME} of the letters a to z, digits, `_` and `-`"
            );
        }
        let (module, module_name) = module(plan, wish.module)?;
        let schedule = &plan[plan.initial_schedule()];
        let window = match free_offset(plan, module, schedule, wish.window_ns) {
            Ok(offset_ns) => Ok(format!(
                "{{ partition = \"{name}\", offset = \"{}\", duration = \"{}\" }}",
                ShowTime(offset_ns),
                ShowTime(wish.window_ns)
            )),
            Err(largest_ns) => Err(format!(
                "no hole of the first core of `{module_name}` has room for {} in every minor frame of `{}`: {}; shorten a window, \
                 or let `bateleur plan` lay all of them anew",
                ShowTime(wish.window_ns),
                schedule.name,
                match largest_ns {
                    0 => "there is none".to_owned(),
                    ns => format!("the largest has room for --window {}", ShowTime(ns)),
                }
            )),
        };
        let table = table(wish, module_name);
        let (schedule, option) = (schedule.name.clone(), wish.option);
        Ok(Self { name: name.to_owned(), table, schedule, window, option })
    }

    /// For a person who adds it.
    pub(super) fn advice(&self) -> String {
        let window = match &self.window {
            Ok(window) => format!("and a window, in [schedule.{}]:\n\n    {window},\n", self.schedule),
            Err(reason) => format!("and a window, in [schedule.{}]; {reason}\n", self.schedule),
        };
        format!("add its table:\n\n{}\n{window}", self.table)
    }
}

fn module<'p>(plan: &'p Plan, wanted: Option<&str>) -> Result<(ModuleId, &'p str)> {
    let names: Vec<&str> = plan.modules.iter().map(|module| module.name.as_str()).collect();
    let name = match (wanted, names.as_slice()) {
        (Some(name), _) => name,
        (None, [one]) => one,
        (None, _) => bail!("the file has the modules {}: say which with --module NAME", names.join(", ")),
    };
    match plan.module(name) {
        Some(module) => Ok((module.id(), module.name())),
        None => bail!("there is no module `{name}`: the file has {}", names.join(", ")),
    }
}

fn table(wish: &Wish<'_>, module: &str) -> String {
    let Wish { name, program, .. } = wish;
    let processes = match wish.processes {
        0 => String::new(),
        most => format!("processes  = {most}\n"),
    };
    format!(
        "[partition.{name}]\n\
         program    = \"{program}\"\n\
         module     = \"{module}\"\n\
         memory     = \"32MiB\"\n\
         {processes}\
         restart    = {{ start = \"cold\", budget = 5, within = \"10s\", then = \"idle\" }}\n\
         \n\
         [partition.{name}.port]\n\
         # What it reads and writes, such as:\n\
         # state   = {{ direction = \"destination\", kind = \"sampling\", message = \"State\", refresh = \"40ms\" }}\n\
         # answers = {{ direction = \"source\",      kind = \"queuing\",  message = \"TelemetryMessage\" }}\n"
    )
}

/// An offset at which the module's first core is free in every minor frame, at the start of the largest hole; where no hole is
/// long enough, the longest window that would fit, ns.
fn free_offset(plan: &Plan, module: ModuleId, schedule: &Schedule, window_ns: u64) -> Result<u64, u64> {
    let line = Timeline::of(plan, module, plan.initial_schedule());
    let minor_ns = schedule.minor_frame_ns;
    let Some(core) = line.cores.first() else { return Err(0) };
    let mut busy: Vec<(u64, u64)> = core
        .windows
        .iter()
        .map(|window| (window.start_ns % minor_ns, window.start_ns % minor_ns + window.duration_ns()))
        .collect();
    busy.sort_unstable();
    let (mut holes, mut free_from) = (Vec::new(), 0);
    for (start, end) in busy.into_iter().chain([(minor_ns, minor_ns)]) {
        if start > free_from {
            holes.push((start - free_from, free_from));
        }
        free_from = free_from.max(end);
    }
    let largest = holes.iter().max_by_key(|&&(length, start)| (length, std::cmp::Reverse(start)));
    let Some(&(length, start)) = largest else { return Err(0) };
    match length.saturating_sub(2 * GAP_NS) {
        room_ns if room_ns < window_ns => Err(room_ns),
        _ if start == 0 => Ok(0),
        _ => Ok(start + GAP_NS),
    }
}

/// Writes it into the file, if the file is as good with it.
pub(super) fn add(path: &Path, missing: &Missing) -> Result<Code> {
    let window = match &missing.window {
        Ok(window) => window,
        Err(reason) => bail!("{reason}"),
    };
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let list = ["schedule", missing.schedule.as_str(), "window"];
    let Some(with_window) = with_item(&text, &list, window, |_| true) else {
        eprintln!(
            "`window` of [schedule.{}] is no list in brackets: nothing was changed\n",
            missing.schedule
        );
        eprintln!("{}", missing.advice());
        return Ok(CANNOT_RUN);
    };
    let gap = if with_window.ends_with('\n') { "\n" } else { "\n\n" };
    let whole = [&with_window, gap, &missing.table].concat();
    if let Err(report) = plan_file::read_report(&path.display().to_string(), &whole) {
        eprint!("{}", report.render(false));
        bail!("with it the file could not be used: nothing was changed");
    }
    std::fs::write(path, whole).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}: added to [schedule.{}]", path.display(), missing.schedule);
    println!("    {window},");
    println!(
        "and at its end [partition.{0}] and [partition.{0}.port]; nothing else was changed",
        missing.name
    );
    println!(
        "\nnext: its ports there, an end for each in a channel, then `bateleur new {}{}`",
        missing.name, missing.option
    );
    Ok(FINE)
}
