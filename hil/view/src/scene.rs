//! What is shown of one instant, whether it is now or was recorded.

use std::collections::BTreeMap;

use bateleur_control::Status;
use bateleur_report::health::HealthEntry;
use bateleur_report::run::Clock;
use bateleur_report::windows::Window;

use crate::air::{Air, Place};

/// Windows of the past that are kept: some twenty major frames of the delivered module.
pub(crate) const MOST_WINDOWS: usize = 1024;
/// Entries of the health log that are kept.
pub(crate) const MOST_ENTRIES: usize = 200;
/// How much of the past a plot of a port shows, ns.
pub(crate) const PLOT_NS: u64 = 30_000_000_000;
/// Lines of a plot; further elements of an array are left out.
pub(crate) const MOST_LINES: usize = 5;

/// One instant.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scene {
    /// Module time, ns.
    pub(crate) time_ns: u64,
    pub(crate) clock: Clock,
    /// What the module says of itself; `None` of a recorded one.
    pub(crate) status: Option<Status>,
    /// The last ones, in the order of the log.
    pub(crate) windows: Vec<Window>,
    /// The last ones, the oldest first.
    pub(crate) health: Vec<HealthEntry>,
    pub(crate) air: Air,
    pub(crate) waypoints: Vec<Place>,
    /// What the relay says, in lines.
    pub(crate) links: String,
    pub(crate) plot: Plot,
    /// What a person has to know besides, such as that the module has ended.
    pub(crate) note: String,
}

/// The values of a field over time.
#[derive(Debug, Clone, Default)]
pub(crate) struct Plot {
    pub(crate) title: String,
    pub(crate) unit: String,
    /// For each element: module time, s, and value.
    pub(crate) lines: Vec<Vec<(f64, f64)>>,
}

impl Scene {
    /// The windows of the last major frame that is over; none before the first one is.
    pub(crate) fn frame(&self) -> Vec<Window> {
        let newest = self.windows.iter().map(|window| window.frame).max();
        let Some(last) = newest.and_then(|newest| newest.checked_sub(1)) else { return Vec::new() };
        self.windows.iter().filter(|window| window.frame == last).cloned().collect()
    }

    /// The last windows of each partition.
    pub(crate) fn by_partition(&self) -> BTreeMap<&str, Vec<&Window>> {
        let mut all: BTreeMap<&str, Vec<&Window>> = BTreeMap::new();
        self.windows.iter().for_each(|window| all.entry(&window.partition).or_default().push(window));
        all
    }
}

/// A port and its fields, to choose from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Port {
    /// `partition.port`.
    pub(crate) name: String,
    pub(crate) fields: Vec<String>,
}

/// What is to be plotted: a port and a field of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Choice {
    pub(crate) port: String,
    pub(crate) field: String,
}
