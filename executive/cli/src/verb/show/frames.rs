//! The windows of a schedule as lines of letters: one line for each kind of minor frame, one letter for each partition.

use std::fmt::Write;

use bateleur_plan::units::ShowTime;
use bateleur_plan::{CoreTimeline, ModuleId, PartitionId, Plan, ScheduleId, Timeline, TimelineWindow};

/// Letters of a line, so that it fits a terminal of 100 columns with its label.
const COLUMNS: u64 = 80;
const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789";

/// Minor frames that have the same windows at the same places.
pub(super) struct Alike {
    /// Counted from zero, rising.
    pub(super) minors: Vec<u32>,
    /// Start and end from the start of the minor frame, ns.
    pub(super) windows: Vec<(u64, u64, PartitionId)>,
}

impl Alike {
    /// "minor frames 0, 2 to 4"
    pub(super) fn label(&self) -> String {
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for &minor in &self.minors {
            match runs.last_mut() {
                Some(run) if run.1 + 1 == minor => run.1 = minor,
                _ => runs.push((minor, minor)),
            }
        }
        let run = |&(first, last): &(u32, u32)| match last - first {
            0 => first.to_string(),
            1 => format!("{first}, {last}"),
            _ => format!("{first} to {last}"),
        };
        let runs: Vec<String> = runs.iter().map(run).collect();
        format!("minor frame{} {}", if self.minors.len() == 1 { "" } else { "s" }, runs.join(", "))
    }
}

/// The minor frames of a core by what is in them, in the order of the first of each kind.
pub(super) fn alike(core: &CoreTimeline, minor_ns: u64, minors: u32) -> Vec<Alike> {
    let mut kinds: Vec<Alike> = Vec::new();
    for minor in 0..minors {
        let start = u64::from(minor) * minor_ns;
        let mine = core.windows.iter().filter(|window| window.minor == minor);
        let within =
            |window: &TimelineWindow| (window.start_ns - start, window.end_ns - start, window.partition);
        let windows: Vec<_> = mine.map(within).collect();
        match kinds.iter_mut().find(|kind| kind.windows == windows) {
            Some(kind) => kind.minors.push(minor),
            None => kinds.push(Alike { minors: vec![minor], windows }),
        }
    }
    kinds
}

/// Every module with its timeline of one schedule.
pub(super) fn lines(plan: &Plan, schedule: ScheduleId) -> Vec<(&str, Timeline)> {
    let module = |module: &'_ bateleur_plan::Module| plan.module(&module.name).map(|view| view.id());
    let ids: Vec<ModuleId> = plan.modules.iter().filter_map(module).collect();
    ids.into_iter().map(|id| (plan[id].name.as_str(), Timeline::of(plan, id, schedule))).collect()
}

/// The letter of a partition; those beyond the last letter share a sign.
fn letter(partition: PartitionId) -> char {
    LETTERS.get(partition.index()).map_or('#', |&letter| char::from(letter))
}

/// The whole schedule.
pub(super) fn text(plan: &Plan, schedule: ScheduleId) -> String {
    let table = &plan[schedule];
    let mut out = String::new();
    let initial = if table.initial { ", initial" } else { "" };
    let _ = writeln!(
        out,
        "schedule `{}`: major frame {}, {} minor frame(s) of {}{initial}",
        table.name,
        ShowTime(table.major_frame_ns),
        table.minor_frames(),
        ShowTime(table.minor_frame_ns)
    );
    for (module, line) in lines(plan, schedule) {
        for core in &line.cores {
            let _ = writeln!(
                out,
                "\ncore {} of `{module}`, a column is {}",
                core.core,
                column(table.minor_frame_ns)
            );
            for kind in alike(core, table.minor_frame_ns, table.minor_frames()) {
                one(&mut out, plan, &kind, table.minor_frame_ns);
            }
        }
    }
    out
}

fn column(minor_ns: u64) -> ShowTime {
    ShowTime(minor_ns / COLUMNS)
}

fn one(out: &mut String, plan: &Plan, kind: &Alike, minor_ns: u64) {
    let _ = writeln!(out, "  {}", kind.label());
    let cells: String = (0..COLUMNS).map(|cell| who(kind, minor_ns, cell)).collect();
    let _ = writeln!(out, "  |{cells}|");
    let name = |partition: PartitionId| plan[partition].name.as_str();
    let width = kind.windows.iter().map(|window| name(window.2).len()).max().unwrap_or(0);
    for &(start, end, partition) in &kind.windows {
        let (start, end, length) = (ShowTime(start), ShowTime(end), ShowTime(end - start));
        let who = letter(partition);
        let _ = writeln!(out, "   {who} {:<width$}  {length} from {start} to {end}", name(partition));
    }
}

/// The letter of whoever has most of a column; a point where that is nobody.
fn who(kind: &Alike, minor_ns: u64, cell: u64) -> char {
    let edge =
        |cell: u64| u64::try_from(u128::from(minor_ns) * u128::from(cell) / u128::from(COLUMNS)).unwrap_or(0);
    let (from, to) = (edge(cell), edge(cell + 1));
    let part = |&(start, end, partition): &(u64, u64, PartitionId)| {
        (end.min(to).saturating_sub(start.max(from)), std::cmp::Reverse(start), partition)
    };
    let most = kind.windows.iter().map(part).filter(|part| part.0 > 0).max();
    // A short window shows even where most of its column is free.
    most.map_or('.', |(_, _, partition)| letter(partition))
}
