//! The health log (`health.jsonl`, one object a line) and the window log (`windows.csv`).

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde::Serialize;

use crate::dispatcher::{Ending, LATE_NS, Occurrence};
use crate::plan::ChangeAction;

/// One fault, from its detection to the successor's first window.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Module time of the detection, ns.
    pub time_ns: u64,
    /// The partition.
    pub partition: String,
    /// The incarnation that failed.
    pub generation: u32,
    /// The error, as the health tables name it.
    pub error: String,
    /// What was done.
    pub action: String,
    /// What is known beside it.
    pub detail: String,
    /// Module time of the successor's first window, ns; null where there was none (yet).
    pub recovered_ns: Option<u64>,
}

/// Appends faults; every line is on its way to the disk before the next thing happens.
#[derive(Debug)]
pub struct HealthLog(File);

impl HealthLog {
    /// A new log.
    pub fn create(path: &Path) -> io::Result<Self> {
        File::create(path).map(Self)
    }

    /// Appends a fault.
    pub fn write(&mut self, fault: &Fault) -> io::Result<()> {
        let mut line = serde_json::to_vec(fault)?;
        line.push(b'\n');
        self.0.write_all(&line)
    }
}

/// What became of one window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowRecord {
    /// The window.
    pub occurrence: Occurrence,
    /// Which of the partition's slots had it, see [`crate::seats::Seats`].
    pub seat: usize,
    /// How the dispatcher came to its end.
    pub ending: Ending,
    /// Why it was not granted; none: it was.
    pub missed: Option<Missed>,
    /// The schedule that its partition has asked for.
    pub requested: Option<usize>,
    /// When it was granted, module time, ns; none: it was not.
    pub granted_ns: Option<u64>,
    /// When the partition took it.
    pub opened_ns: Option<u64>,
    /// When the partition closed it.
    pub closed_ns: Option<u64>,
}

/// Why a window was not granted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Missed {
    /// No partition was there to run.
    NoPartition,
    /// The dispatcher was held up for longer than the window lasts.
    TooLate,
    /// Another core still had a window of the partition open.
    OtherCore,
    /// It was kept back for what a change of schedule means for its partition.
    Changed(ChangeAction),
}

impl Missed {
    /// The letter that stands in the window log.
    #[must_use]
    pub fn letter(self) -> char {
        match self {
            Self::NoPartition => 'S',
            Self::TooLate => 'M',
            Self::OtherCore => 'H',
            Self::Changed(_) => 'C',
        }
    }
}

impl WindowRecord {
    /// The dispatcher itself came late to its start.
    #[must_use]
    pub fn is_late(&self) -> bool {
        self.occurrence.late_ns > LATE_NS
    }

    /// Switches that the dispatcher came late to, for this window: its start, and its end where that is a switch of its own.
    #[must_use]
    pub fn late_switches(&self) -> u64 {
        u64::from(self.is_late()) + u64::from(!self.ending.shared && self.ending.late_ns > LATE_NS)
    }

    /// Granted, but not closed when it ended.
    #[must_use]
    pub fn is_overrun(&self) -> bool {
        self.granted_ns.is_some() && self.closed_ns.is_none()
    }

    /// What the partition left of its window, ns; none: it was not granted, or not closed.
    #[must_use]
    pub fn slack_ns(&self) -> Option<u64> {
        Some(self.occurrence.end_ns.saturating_sub(self.closed_ns?))
    }

    fn flags(&self) -> String {
        let flags = [(self.is_late(), 'L'), (self.is_overrun(), 'O')];
        let flags = flags.into_iter().filter_map(|(set, letter)| set.then_some(letter));
        flags.chain(self.missed.map(Missed::letter)).collect()
    }
}

/// Writes window records as lines of comma-separated values.
#[derive(Debug)]
pub struct WindowLog(BufWriter<File>);

impl WindowLog {
    /// A new log with its heading.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut file = BufWriter::with_capacity(1 << 16, File::create(path)?);
        writeln!(
            file,
            "frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags,slack_ns,schedule"
        )?;
        Ok(Self(file))
    }

    /// Appends a record of the partition called `name`, in the schedule of that name.
    pub fn write(&mut self, record: &WindowRecord, name: &str, schedule: &str) -> io::Result<()> {
        let at = &record.occurrence;
        let number = |value: Option<u64>| value.map_or_else(String::new, |value| value.to_string());
        writeln!(
            self.0,
            "{},{},{},{name},{},{},{},{},{},{},{},{schedule}",
            at.major_frame,
            at.window.minor,
            at.core,
            at.start_ns,
            at.end_ns,
            number(record.granted_ns),
            number(record.opened_ns),
            number(record.closed_ns),
            record.flags(),
            number(record.slack_ns())
        )
    }

    /// Hands everything to the kernel.
    pub fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}
