//! `windows.csv`: when each window was planned, granted, opened and closed.
//!
//! One line a window: `frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags`,
//! then `slack_ns` and `schedule`, and further cells that are not read here.
//! Times are ns from the module's origin; one that never came is empty. Under the virtual clock `opened_ns` and
//! `closed_ns` are stamps of the machine's monotonic clock, so only their differences mean anything.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Name of the file in a flight's folder.
pub const FILE: &str = "windows.csv";
/// The first line of the file.
pub const HEADER: &str =
    "frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags";

/// Flags of a window that was not granted.
const NOT_GRANTED: [char; 5] = ['S', 'M', 'H', 'F', 'C'];

/// One window.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Major frame, from 0.
    pub frame: u64,
    /// Minor frame in it, from 0.
    pub minor: u32,
    /// The core.
    pub core: u32,
    /// The partition.
    pub partition: String,
    /// ns.
    pub planned_start_ns: u64,
    /// ns.
    pub planned_end_ns: u64,
    /// When the dispatcher gave the processor, ns.
    pub granted_ns: Option<u64>,
    /// When the partition began to work, ns.
    pub opened_ns: Option<u64>,
    /// When the partition said that it was done, ns.
    pub closed_ns: Option<u64>,
    /// The dispatcher switched late (`L`).
    pub late: bool,
    /// The partition had not closed it at its end (`O`).
    pub overrun: bool,
    /// It was not granted: the partition was not there to run (`S`), or one of the other reasons of "Time" in the book.
    pub skipped: bool,
    /// The letters as they stand in the log.
    pub flags: String,
    /// The schedule that the window belongs to; empty in a log that does not say.
    pub schedule: String,
}

impl Window {
    /// Reads one line; `None` if it is not a whole one.
    pub fn parse(line: &str) -> Option<Self> {
        let mut rest = Some(line);
        // Cells are short: looking at each byte is quicker than a search.
        let mut cell = || {
            let now = rest?;
            let comma = now.bytes().position(|byte| byte == b',');
            rest = comma.and_then(|at| now.get(at + 1..));
            Some(comma.and_then(|at| now.get(..at)).unwrap_or(now).trim())
        };
        let window = Self {
            frame: cell()?.parse().ok()?,
            minor: cell()?.parse().ok()?,
            core: cell()?.parse().ok()?,
            partition: cell()?.to_owned(),
            planned_start_ns: cell()?.parse().ok()?,
            planned_end_ns: cell()?.parse().ok()?,
            granted_ns: stamp(cell()?)?,
            opened_ns: stamp(cell()?)?,
            closed_ns: stamp(cell()?)?,
            late: false,
            overrun: false,
            skipped: false,
            flags: String::new(),
            schedule: String::new(),
        };
        let flags = cell()?;
        let [late, overrun] = ['L', 'O'].map(|flag| flags.contains(flag));
        let skipped = flags.contains(NOT_GRANTED);
        let _slack = cell();
        let schedule = cell().unwrap_or_default().to_owned();
        Some(Self { late, overrun, skipped, flags: flags.to_owned(), schedule, ..window })
    }

    /// How long the partition worked, ns.
    pub fn used_ns(&self) -> Option<u64> {
        self.closed_ns?.checked_sub(self.opened_ns?)
    }

    /// How long after its planned start it opened, ns; an earlier one counts as on time.
    pub fn lateness_ns(&self) -> Option<u64> {
        Some(self.opened_ns?.saturating_sub(self.planned_start_ns))
    }
}

/// A time, or `Some(None)` for an empty cell; `None` if it is neither.
fn stamp(cell: &str) -> Option<Option<u64>> {
    if cell.is_empty() { Some(None) } else { cell.parse().ok().map(Some) }
}

/// Gives every window of the file to `each`; returns how many lines were none. The file is read once and not kept:
/// a day's flight has 40 million windows.
pub fn for_each(path: &Path, each: impl FnMut(Window)) -> std::io::Result<usize> {
    for_each_line(path, |_| true, each)
}

/// As [`for_each`], for the windows of one major frame.
pub fn for_each_of_frame(path: &Path, frame: u64, each: impl FnMut(Window)) -> std::io::Result<usize> {
    let start = format!("{frame},");
    for_each_line(path, |line| line.starts_with(start.as_bytes()), each)
}

fn for_each_line(
    path: &Path,
    is_wanted: impl Fn(&[u8]) -> bool,
    mut each: impl FnMut(Window),
) -> std::io::Result<usize> {
    let mut reader = BufReader::with_capacity(1 << 18, File::open(path)?);
    let (mut line, mut broken) = (Vec::new(), 0);
    while reader.read_until(b'\n', &mut line)? > 0 {
        if is_wanted(&line) {
            let text = std::str::from_utf8(&line).unwrap_or_default().trim_ascii();
            match Window::parse(text) {
                Some(window) => each(window),
                None if line.trim_ascii().is_empty() || text.starts_with("frame,") => {}
                None => broken += 1,
            }
        }
        line.clear();
    }
    Ok(broken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn window_that_never_closed_has_no_used_time() {
        let window = Window::parse("7,2,1,imu,1000,2000,1010,1015,,LO").unwrap();
        assert_eq!((window.used_ns(), window.lateness_ns()), (None, Some(15)));
        assert!(window.late && window.overrun && !window.skipped);
    }

    #[test]
    fn cut_lines_are_no_windows() {
        assert_eq!(Window::parse("7,2,1,imu,1000,2000,10"), None);
        assert_eq!(Window::parse("7,2,1,imu,1000,2000,1010,1015,x,"), None);
        assert!(Window::parse("7,2,1,imu,1000,2000,,,,S").unwrap().skipped);
    }

    #[test]
    fn schedule_is_read_where_the_log_has_one() {
        let schedule = |line: &str| Window::parse(line).unwrap().schedule;
        assert_eq!(schedule("7,2,1,imu,1000,2000,1010,1015,1020,,980,landing"), "landing");
        assert_eq!(schedule("7,2,1,imu,1000,2000,1010,1015,1020,"), "");
    }
}
