//! Reading the logs that a run writes.

use std::path::Path;

use serde_json::Value;

/// A line of `health.jsonl`.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// The incarnation that failed.
    pub generation: u64,
    /// Module time, ns.
    pub time_ns: u64,
    /// Where it was dealt with.
    pub level: String,
    /// The partition; empty: the module itself.
    pub partition: String,
    /// The error's name.
    pub error: String,
    /// What was done.
    pub action: String,
    /// What is known beside it.
    pub detail: String,
    /// The successor's first window.
    pub recovered_ns: Option<u64>,
}

/// A line of `windows.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// The major frame, from the start of the module.
    pub frame: u64,
    /// The core.
    pub core: u32,
    /// The partition.
    pub partition: String,
    /// When the schedule starts it, ns.
    pub planned_start_ns: u64,
    /// When the schedule ends it, ns.
    pub planned_end_ns: u64,
    /// When it was granted; `None` if it was not.
    pub granted_ns: Option<u64>,
    /// When the partition closed it.
    pub closed_ns: Option<u64>,
    /// The dispatcher itself came late.
    pub late: bool,
    /// Its flags, letters of docs/src/time.md.
    pub flags: String,
    /// What was left of it when it was closed, ns.
    pub slack_ns: Option<u64>,
    /// The schedule that it belongs to.
    pub schedule: String,
}

impl Window {
    /// Granted, but not closed at its end.
    pub fn is_overrun(&self) -> bool {
        self.granted_ns.is_some() && self.closed_ns.is_none()
    }

    /// From the planned to the real start, ns.
    pub fn lateness_ns(&self) -> Option<u64> {
        Some(self.granted_ns?.saturating_sub(self.planned_start_ns))
    }
}

pub(crate) fn faults(folder: &Path) -> Vec<Fault> {
    let text = std::fs::read_to_string(folder.join("health.jsonl")).expect("health.jsonl");
    text.lines().map(|line| fault(&serde_json::from_str(line).expect("a line of JSON"))).collect()
}

fn fault(line: &Value) -> Fault {
    let text = |key: &str| line[key].as_str().expect("a text").to_owned();
    Fault {
        generation: line["generation"].as_u64().expect("a number"),
        time_ns: line["time_ns"].as_u64().expect("a time"),
        level: text("level"),
        partition: line["partition"].as_str().unwrap_or_default().to_owned(),
        error: text("error"),
        action: text("action"),
        detail: text("detail"),
        recovered_ns: line["recovered_ns"].as_u64(),
    }
}

pub(crate) fn windows(folder: &Path) -> Vec<Window> {
    let text = std::fs::read_to_string(folder.join("windows.csv")).expect("windows.csv");
    let mut lines = text.lines();
    let heading = lines.next().expect("a heading");
    assert_eq!(
        heading,
        "frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags,slack_ns,schedule"
    );
    lines.map(window).collect()
}

fn window(line: &str) -> Window {
    let fields: Vec<&str> = line.split(',').collect();
    assert_eq!(fields.len(), 12, "{line}");
    Window {
        frame: fields[0].parse().unwrap(),
        core: fields[2].parse().unwrap(),
        partition: fields[3].to_owned(),
        planned_start_ns: fields[4].parse().unwrap(),
        planned_end_ns: fields[5].parse().unwrap(),
        granted_ns: fields[6].parse().ok(),
        closed_ns: fields[8].parse().ok(),
        late: fields[9].contains('L'),
        flags: fields[9].to_owned(),
        slack_ns: fields[10].parse().ok(),
        schedule: fields[11].to_owned(),
    }
}

/// The `part` (0 to 1) quantile of `values`.
pub fn quantile(values: impl IntoIterator<Item = u64>, part: f64) -> u64 {
    let mut values: Vec<u64> = values.into_iter().collect();
    assert!(!values.is_empty(), "a quantile of nothing");
    values.sort_unstable();
    values[((values.len() - 1) as f64 * part).round() as usize]
}
