//! `run.json`: what the executive says of the run as a whole. It writes this file with the same types.

use serde::{Deserialize, Serialize};

/// Name of the file in a flight's folder.
pub const FILE: &str = "run.json";

/// The clock that the windows followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// Windows at their instants.
    #[default]
    Wall,
    /// Module time jumps to the next window as soon as one is done.
    Virtual,
}

/// How the mission went, in the executive's and the ground station's words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default)]
pub struct Mission {
    /// All laps were flown and nothing ended the run early.
    pub completed: bool,
    /// Why not, if not.
    pub failure: Option<String>,
    /// Way-points that the aircraft said it reached, where the executive counted them.
    pub waypoints_reached: Option<u32>,
}

/// A promise, and whether the machine has the means for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Guarantee {
    /// What was promised.
    pub promise: String,
    /// Whether the means are there. Whether the promise was kept in this run say the windows' figures.
    pub held: bool,
    /// How, or why not.
    #[serde(default)]
    pub detail: String,
}

/// The run as a whole. Fields that an older or failed run lacks take their defaults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default)]
pub struct Run {
    /// The clock that the windows followed.
    pub clock: Clock,
    /// Seed of everything random.
    pub seed: u64,
    /// How long it took, s.
    pub wall_time_s: f64,
    /// How much module time passed, s.
    pub module_time_s: f64,
    /// The schedule file.
    pub schedule: String,
    /// The aircraft was somebody else's simulator, which leaves no truth: the aircraft's own count has to do.
    pub foreign_simulator: bool,
    /// How the mission went.
    pub mission: Mission,
    /// The means by which this machine lets promises be kept; see [`Guarantee::held`].
    pub guarantees: Vec<Guarantee>,
    /// Windows that the log lost, because it could not keep up.
    pub lost_records: u64,
    /// What whoever reads the report should know besides.
    pub notes: Vec<String>,
    /// What the run was started with.
    pub arguments: serde_json::Value,
}
