//! What became of each window, as dispatchers leave it to the monitor.

use bateleur_plan::ChangeAction;

use crate::dispatcher::{Ending, LATE_NS, Occurrence};

/// What became of one window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowRecord {
    /// The window.
    pub occurrence: Occurrence,
    /// Which of the partition's controls had it, see [`crate::redundant_pair::RedundantPair`].
    pub member: usize,
    /// How the dispatcher came to its end.
    pub ending: Ending,
    /// Why it was not granted; `None` if it was.
    pub missed: Option<Missed>,
    /// The schedule that its partition has asked for.
    pub requested: Option<usize>,
    /// When it was granted, module time, ns; `None` if it was not.
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
    /// It was granted, and nothing of the partition could run: the kernel had not thawed it yet.
    StillFrozen,
    /// It was kept back for what a change of schedule means for its partition.
    Changed(ChangeAction),
}

impl Missed {
    /// The letter that stands in the window log.
    #[must_use]
    pub fn letter(self) -> u8 {
        match self {
            Self::NoPartition => b'S',
            Self::TooLate => b'M',
            Self::OtherCore => b'H',
            Self::StillFrozen => b'F',
            Self::Changed(_) => b'C',
        }
    }
}

impl WindowRecord {
    /// The executive did not give a partition its window that was there to take it.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        matches!(self.missed, Some(Missed::TooLate | Missed::OtherCore | Missed::StillFrozen))
    }

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

    /// The latest of them, ns.
    #[must_use]
    pub fn latest_ns(&self) -> u64 {
        let end_ns = if self.ending.shared { 0 } else { self.ending.late_ns };
        self.occurrence.late_ns.max(end_ns)
    }

    /// Granted, but not closed when it ended.
    #[must_use]
    pub fn is_overrun(&self) -> bool {
        self.granted_ns.is_some() && self.closed_ns.is_none()
    }

    /// What the partition left of its window, ns; `None` if it was not granted, or not closed.
    #[must_use]
    pub fn slack_ns(&self) -> Option<u64> {
        Some(self.occurrence.end_ns.saturating_sub(self.closed_ns?))
    }

    /// Appends what was wrong with the window, a letter each.
    pub fn flags(&self, line: &mut Vec<u8>) {
        line.extend(self.is_late().then_some(b'L'));
        line.extend(self.is_overrun().then_some(b'O'));
        line.extend(self.missed.map(Missed::letter));
    }
}
