//! The switch instants of one schedule on one module, computed before frame 0 and never again.
//!
//! All instants count from the start of a major frame; [`Timeline::instant_ns`] turns them into time since the
//! origin of frame 0. Nothing is ever derived from "now", so no lateness can add up.

use serde::Serialize;

use super::model::{ModuleId, PartitionId, Plan, Schedule, ScheduleId, Window};

/// The windows of one schedule on one module, per core.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Timeline {
    /// The whole cycle.
    pub major_frame_ns: u64,
    /// The base period.
    pub minor_frame_ns: u64,
    /// One line for each partitioned core of the module, in the module's order; a core without windows has an empty line.
    pub cores: Vec<CoreTimeline>,
}

/// The windows of one core over the major frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CoreTimeline {
    /// The processor core.
    pub core: u32,
    /// The windows by rising start; none overlaps the next, though one may end where the next starts.
    pub windows: Vec<TimelineWindow>,
}

/// One occurrence of a window in the major frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct TimelineWindow {
    /// Its start, from the start of the major frame.
    pub start_ns: u64,
    /// Its end, from the start of the major frame.
    pub end_ns: u64,
    /// Whose it is.
    pub partition: PartitionId,
    /// The minor frame that it lies in, counted from zero.
    pub minor: u32,
    /// How many windows the same partition had before it in the major frame, on this core.
    pub number: u32,
    /// Its declaration: the place in [`Schedule::windows`].
    pub declared: usize,
}

impl TimelineWindow {
    /// Its length.
    #[must_use]
    pub fn duration_ns(&self) -> u64 {
        self.end_ns - self.start_ns
    }
}

impl Timeline {
    /// Lays out every window of a schedule that one module runs.
    #[must_use]
    pub fn of(plan: &Plan, module: ModuleId, schedule: ScheduleId) -> Self {
        let table = &plan[schedule];
        let cores = plan[module].cores.iter();
        Self {
            major_frame_ns: table.major_frame_ns,
            minor_frame_ns: table.minor_frame_ns,
            cores: cores.map(|&core| CoreTimeline::of(plan, module, table, core)).collect(),
        }
    }

    /// Those of all schedules, in the order of the plan.
    #[must_use]
    pub fn all(plan: &Plan, module: ModuleId) -> Vec<Self> {
        plan.schedule_ids().map(|schedule| Self::of(plan, module, schedule)).collect()
    }

    /// The time since the origin of frame 0 at which `from_frame_start_ns` of the given major frame is reached.
    #[must_use]
    pub fn instant_ns(&self, major_frame: u64, from_frame_start_ns: u64) -> u64 {
        major_frame * self.major_frame_ns + from_frame_start_ns
    }
}

impl CoreTimeline {
    fn of(plan: &Plan, module: ModuleId, schedule: &Schedule, core: u32) -> Self {
        let mut windows =
            schedule.laid(|window| window.core == core && plan[window.partition].module == module);
        number(&mut windows);
        Self { core, windows }
    }

    /// The time of the major frame that belongs to a partition.
    #[must_use]
    pub fn used_ns(&self) -> u64 {
        self.windows.iter().map(TimelineWindow::duration_ns).sum()
    }
}

impl Schedule {
    /// Every occurrence of some windows in the major frame, by rising start; none is numbered.
    #[must_use]
    pub fn laid(&self, of: impl Fn(&Window) -> bool) -> Vec<TimelineWindow> {
        let mut laid = Vec::new();
        for (declared, window) in self.windows.iter().enumerate().filter(|(_, window)| of(window)) {
            laid.extend(window.minor.iter().map(|&minor| {
                let start_ns = u64::from(minor) * self.minor_frame_ns + window.offset_ns;
                let end_ns = start_ns + window.duration_ns;
                TimelineWindow { start_ns, end_ns, partition: window.partition, minor, number: 0, declared }
            }));
        }
        laid.sort_by_key(|window| window.start_ns);
        laid
    }

    /// Start and end of each occurrence of a partition's windows in the major frame, ns from its start, by rising start.
    #[must_use]
    pub fn occurrences(&self, partition: PartitionId) -> Vec<(u64, u64)> {
        let laid = self.laid(|window| window.partition == partition);
        laid.into_iter().map(|window| (window.start_ns, window.end_ns)).collect()
    }

    /// When a partition's windows start in the major frame, ns from its start, rising.
    #[must_use]
    pub fn starts(&self, partition: PartitionId) -> Vec<u64> {
        self.occurrences(partition).into_iter().map(|(start, _)| start).collect()
    }
}

/// Counts the windows of each partition.
fn number(windows: &mut [TimelineWindow]) {
    let mut seen = std::collections::BTreeMap::new();
    for window in windows {
        let count = seen.entry(window.partition).or_insert(0);
        window.number = *count;
        *count += 1;
    }
}

/// The distances from each instant to the next in a cycle.
pub fn gaps(starts: &[u64], cycle: u64) -> impl Iterator<Item = u64> + '_ {
    let again = starts.first().map(|first| first + cycle);
    starts.iter().zip(starts.iter().copied().skip(1).chain(again)).map(|(start, next)| next - start)
}
