//! The health log (`health.jsonl`, one object a line) and the window log (`windows.csv`).

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde::Serialize;

use crate::dispatcher::{LATE_NS, Occurrence};

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
    /// When it was granted, module time, ns; none: it was not.
    pub granted_ns: Option<u64>,
    /// When the partition took it.
    pub opened_ns: Option<u64>,
    /// When the partition closed it.
    pub closed_ns: Option<u64>,
}

impl WindowRecord {
    /// The dispatcher itself came late.
    #[must_use]
    pub fn is_late(&self) -> bool {
        self.occurrence.late_ns > LATE_NS
    }

    /// Granted, but not closed when it ended.
    #[must_use]
    pub fn is_overrun(&self) -> bool {
        self.granted_ns.is_some() && self.closed_ns.is_none()
    }

    fn flags(&self) -> String {
        let flags = [('L', self.is_late()), ('O', self.is_overrun()), ('S', self.granted_ns.is_none())];
        flags.iter().filter(|(_, set)| *set).map(|(letter, _)| letter).collect()
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
            "frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags"
        )?;
        Ok(Self(file))
    }

    /// Appends a record of the partition called `name`.
    pub fn write(&mut self, record: &WindowRecord, name: &str) -> io::Result<()> {
        let at = &record.occurrence;
        let number = |value: Option<u64>| value.map_or_else(String::new, |value| value.to_string());
        writeln!(
            self.0,
            "{},{},{},{name},{},{},{},{},{},{}",
            at.major_frame,
            at.window.minor,
            at.core,
            at.start_ns,
            at.end_ns,
            number(record.granted_ns),
            number(record.opened_ns),
            number(record.closed_ns),
            record.flags()
        )
    }

    /// Hands everything to the kernel.
    pub fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}
