//! What a module says about itself: the figures behind `bateleur ps` and `bateleur top`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// A module at one moment.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Its name in the plan.
    pub module: String,
    /// The executive's process.
    pub pid: i32,
    /// "wall" or "virtual".
    pub clock: String,
    /// Module time, ns.
    pub module_ns: u64,
    /// Where it writes its logs.
    #[serde(default)]
    pub folder: PathBuf,
    /// The schedules that it has.
    #[serde(default)]
    pub schedules: Vec<String>,
    /// The schedule that runs.
    pub schedule: String,
    /// The schedule that was asked for and comes with the next major frame.
    pub next_schedule: Option<String>,
    /// Length of its minor frame, ns.
    pub minor_frame_ns: u64,
    /// Length of its major frame, ns.
    pub major_frame_ns: u64,
    /// Windows granted.
    pub windows: u64,
    /// Windows whose start the dispatcher reached late.
    pub late_windows: u64,
    /// Windows that were not closed in time.
    pub window_overruns: u64,
    /// Windows lost because the dispatcher came too late for them.
    pub lost_windows: u64,
    /// How its major frames lie to those that they follow; null: they follow nobody's.
    #[serde(default)]
    pub alignment: Option<AlignmentStatus>,
    /// Its partitions, in the order of the plan.
    pub partitions: Vec<PartitionStatus>,
}

/// How the major frames of a module lie to those that they follow.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlignmentStatus {
    /// The module that is followed, or `realtime`.
    pub follows: String,
    /// `seeking`, `locked` or `lost`.
    pub state: String,
    /// How much later than the own frame the other one begins, as far as is known, ns; null: nothing was measured.
    pub error_ns: Option<i64>,
    /// The standard deviation of that, ns.
    pub deviation_ns: u64,
    /// The uncertainty of the last measurement, ns.
    pub uncertainty_ns: u64,
    /// How fast the other clock runs ahead, parts in 10⁹; negative: the own frames are too long.
    pub drift_ppb: i64,
    /// By how much the end of the last frame was moved, ns.
    pub correction_ns: i64,
    /// Measurements that counted.
    pub measurements: u64,
    /// Measurements that were not believed.
    pub refused: u64,
    /// How often it was lost.
    pub lost: u64,
}

/// A partition at that moment. Times of windows are over the whole run, all incarnations.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PartitionStatus {
    /// Its name in the plan.
    pub name: String,
    /// Its process; null: none.
    pub pid: Option<i32>,
    /// What it does: `normal`, `starting`, `restarting`, `idle`, `frozen`.
    pub mode: String,
    /// What stands by for it: `ready`, `starting`, `absent`; null: its plan wants nothing.
    #[serde(default)]
    pub standby: Option<String>,
    /// Incarnations before this one.
    pub generation: u32,
    /// Restarts so far.
    pub restarts: u64,
    /// The last error of its health.
    pub last_fault: Option<LastFault>,
    /// Windows granted.
    pub windows: u64,
    /// Windows that passed ungranted: it had no process then, or the dispatcher came too late.
    pub windows_missed: u64,
    /// Windows granted and not closed in time.
    pub overruns: u64,
    /// Length of its latest window, ns.
    pub window_ns: u64,
    /// From a window's grant to its closing, ns; null: none was closed.
    pub use_ns: Option<Spread>,
    /// What was left of a window when it was closed, ns.
    pub slack_ns: Option<Spread>,
    /// From the planned start of a window to its grant, ns.
    pub lateness_ns: Option<Lateness>,
    /// Its ARINC 653 processes as they were at the end of its last window, the error handler last; empty: it is one loop, or has
    /// had no window. They are the partition's own words.
    #[serde(default)]
    pub processes: Vec<ProcessStatus>,
}

/// An ARINC 653 process of a partition.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Its name.
    pub name: String,
    /// `dormant`, `ready`, `running` (it goes on in the next window), `waiting` or `faulted`.
    pub state: String,
    /// Its present priority.
    pub priority: u32,
    /// The priority that it was created with.
    pub base_priority: u32,
    /// From one release to the next, ns; null: it is not periodic.
    pub period_ns: Option<u64>,
    /// From a release to its deadline, ns; null: it has none.
    pub capacity_ns: Option<u64>,
    /// Its present deadline, module time, ns; null: none.
    pub deadline_ns: Option<u64>,
    /// Module time for which it has run so far, ns.
    pub run_ns: u64,
    /// How often it was let run.
    pub switches: u32,
    /// How often it was started.
    pub starts: u32,
    /// Its errors.
    pub errors: u32,
    /// Bytes of its stack; null: not known.
    pub stack_bytes: Option<u64>,
    /// The most of them that it has used; null: not known.
    pub stack_used_bytes: Option<u64>,
}

/// In the folder of a run: what its links are called.
pub const LINKS_FILE: &str = "links.json";

/// What a link of a module is called. How it is says its relay, on a port of its own.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkName {
    /// Its number in the plan.
    pub id: u64,
    /// Its name.
    pub name: String,
    /// The module at the other end.
    pub peer: String,
    /// Its networks.
    pub networks: Vec<String>,
}

impl LinkName {
    /// Those of a module, in the order of the plan.
    #[must_use]
    pub fn of(view: &bateleur_plan::ModuleView<'_>) -> Vec<Self> {
        let plan = view.plan();
        let name = |id: bateleur_plan::LinkId| {
            let link = &plan[id];
            Some(Self {
                id: id.index() as u64,
                name: link.name.clone(),
                peer: plan[link.peer_of(view.id())?].name.clone(),
                networks: link.networks.iter().map(|&network| plan[network].name.clone()).collect(),
            })
        };
        plan.links_of(view.id()).filter_map(name).collect()
    }
}

/// A channel.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelStatus {
    /// The source port, `partition.port`.
    pub source: String,
    /// The destination ports.
    pub destinations: Vec<String>,
    /// Length of its queue; null: sampling.
    pub queue_depth: Option<u32>,
    /// The message type's name.
    pub message: String,
    /// Bytes of a message, at most.
    pub size: usize,
    /// The plan leaves the source to the operator.
    #[serde(default)]
    pub operator: bool,
    /// The message type's text, and behind it those of the types within it; empty: they are not known.
    #[serde(default)]
    pub definition: String,
}

/// A message that a publisher is to write: one line each.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Publication {
    /// Its bytes, two hexadecimal digits each.
    pub bytes: String,
}

/// A message that an observer has read: one line each.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observation {
    /// The source port, `partition.port`.
    pub source: String,
    /// The source's count of its messages.
    pub sequence: u64,
    /// Module time at which the source wrote it, ns.
    pub source_ns: u64,
    /// Its bytes, two hexadecimal digits each.
    pub bytes: String,
}

/// Least, mean and most.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Spread {
    /// Least.
    pub min: u64,
    /// Mean.
    pub mean: u64,
    /// Most.
    pub max: u64,
}

/// How late windows began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lateness {
    /// Half of the windows were not later.
    pub p50: u64,
    /// 99 of 100 were not later.
    pub p99: u64,
    /// The latest.
    pub max: u64,
    /// How many were not later than each of [`LATENESS_BOUNDS_NS`], or later by one part in 64 of it at most.
    #[serde(default)]
    pub within: [u64; LATENESS_BOUNDS_NS.len()],
    /// The sum of all, ns.
    #[serde(default)]
    pub sum: u64,
}

/// The bounds of [`Lateness::within`], ns.
pub const LATENESS_BOUNDS_NS: [u64; 12] =
    [500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000, 10_000_000];

/// An error that the health monitor saw.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LastFault {
    /// Module time, ns.
    pub time_ns: u64,
    /// The error, as the health tables name it.
    pub error: String,
    /// What was done.
    pub action: String,
    /// What is known beside it.
    pub detail: String,
}
