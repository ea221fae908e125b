//! Links from a fault or a late window to its reason: the entry of the health log, the crash report, the answer of `bateleur why`.

use std::path::Path;

use serde::Deserialize;

use crate::flight::seconds;
use crate::health::HealthEntry;

/// Entries of the health log on a page; the rest is counted. No link leads to those.
pub(crate) const MOST_LISTED: usize = 200;
/// Answers on a page: a quarter of a megabyte.
pub(crate) const MOST_ANSWERS: usize = 1000;
/// An answer is about the windows before a fault, not earlier than this, s: silence is noticed after some of them.
const BEFORE_S: f64 = 1.0;

/// Who had the processor when a window was late, lost or not closed. The executive answers; whoever makes a report hands it over.
#[derive(Debug, Clone, PartialEq)]
pub struct Reason {
    /// Module time at which the window was late, s.
    pub time_s: f64,
    /// Whose window.
    pub partition: String,
    /// Its major frame.
    pub frame: u64,
    /// The answer.
    pub sentence: String,
}

/// A crash report.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Crash {
    /// Its file in the flight's folder.
    #[serde(skip)]
    pub file: String,
    /// The partition that ended.
    #[serde(default)]
    pub partition: String,
    /// Module time, ns.
    #[serde(default)]
    pub time_ns: u64,
}

impl Crash {
    /// The reports in a flight's folder; there is no folder of them where no partition ended by a fault.
    pub(crate) fn read(dir: &Path) -> Vec<Self> {
        let files = std::fs::read_dir(dir.join("crashes")).into_iter().flatten().flatten();
        let names = files.filter_map(|file| file.file_name().into_string().ok());
        let mut files: Vec<String> =
            names.filter(|name| name.ends_with(".json")).map(|name| format!("crashes/{name}")).collect();
        files.sort_unstable();
        let read = |file: String| {
            let bytes = std::fs::read(dir.join(&file)).unwrap_or_default();
            // One that is damaged is of nobody, and is listed all the same.
            let none = Self { file: String::new(), partition: String::new(), time_ns: 0 };
            Self { file, ..serde_json::from_slice(&bytes).unwrap_or(none) }
        };
        files.into_iter().map(read).collect()
    }

    /// Whether it is of the death that an entry is about.
    pub(crate) fn is_of(&self, entry: &HealthEntry) -> bool {
        entry.partition.as_deref() == Some(&self.partition) && entry.time_ns == self.time_ns
    }
}

/// The anchor of an entry on which something was done, by its place among those; `None` if it is not listed.
pub(crate) fn fault_anchor(place: usize) -> Option<String> {
    (place < MOST_LISTED).then(|| format!("fault-{place}"))
}

/// The anchor of the answer about a window.
pub(crate) fn of_window(reasons: &[Reason], partition: &str, frame: u64) -> Option<String> {
    let is_of = |reason: &Reason| reason.frame == frame && reason.partition == partition;
    anchor(reasons.iter().position(is_of)?)
}

/// The anchor of the last answer about the windows of a partition before an instant.
pub(crate) fn before(reasons: &[Reason], partition: &str, time_ns: u64) -> Option<String> {
    let before_s = 0.0..=BEFORE_S;
    let is_of = |reason: &Reason| {
        reason.partition == partition && before_s.contains(&(seconds(time_ns) - reason.time_s))
    };
    anchor(reasons.iter().rposition(is_of)?)
}

/// The anchor of an answer by its place; `None` if it is not listed.
pub(crate) fn anchor(place: usize) -> Option<String> {
    (place < MOST_ANSWERS).then(|| format!("why-{place}"))
}

/// What is drawn, with a link where there is something to be led to.
pub(crate) fn linked(anchor: Option<&str>, drawn: &str) -> String {
    anchor.map_or_else(|| drawn.to_owned(), |anchor| format!(r##"<a href="#{anchor}">{drawn}</a>"##))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_of_a_window_is_found_by_its_frame_and_that_of_a_fault_by_the_time_before_it() {
        let reason = |time_s, partition: &str, frame| Reason {
            time_s,
            partition: partition.into(),
            frame,
            sentence: String::new(),
        };
        let reasons = [reason(1.0, "imu", 50), reason(1.5, "imu", 75), reason(1.6, "gps", 80)];
        assert_eq!(of_window(&reasons, "imu", 75).as_deref(), Some("why-1"));
        assert_eq!(of_window(&reasons, "gps", 75), None);
        assert_eq!(before(&reasons, "imu", 1_600_000_000).as_deref(), Some("why-1"));
        assert_eq!(before(&reasons, "imu", 1_400_000_000).as_deref(), Some("why-0"));
        assert_eq!(before(&reasons, "imu", 2_700_000_000), None);
    }

    #[test]
    fn what_is_not_listed_is_not_linked() {
        assert_eq!((anchor(MOST_ANSWERS), fault_anchor(MOST_LISTED)), (None, None));
        assert_eq!(linked(None, "x"), "x");
        assert_eq!(linked(fault_anchor(3).as_deref(), "x"), r##"<a href="#fault-3">x</a>"##);
    }
}
