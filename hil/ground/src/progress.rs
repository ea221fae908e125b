//! What a mission tells its caller after each step.

use std::fmt;

/// Where the script stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// Ordering HIL mode.
    EnableHil,
    /// Waiting for the first sensor values.
    AwaitSensors,
    /// Taking sensor biases at standstill.
    InitialiseSensors,
    /// Starting the Estimator.
    InitialiseEstimator,
    /// Waiting for a state that can be flown on.
    AwaitEstimator,
    /// Loading the way-points.
    LoadWaypoints,
    /// Switching navigation on.
    SwitchNavigation,
    /// Calling the safety pilot.
    OrderTakeOff,
    /// Waiting for height.
    Climb,
    /// Engaging the autopilot.
    Engage,
    /// Watching the laps.
    Watch,
    /// The laps are flown.
    Loiter,
    /// Landing.
    Land,
    /// Over.
    End,
}

impl Phase {
    /// A word for a terminal.
    pub fn name(self) -> &'static str {
        match self {
            Self::EnableHil => "enabling HIL mode",
            Self::AwaitSensors => "waiting for sensors",
            Self::InitialiseSensors => "initialising sensors",
            Self::InitialiseEstimator => "initialising the estimator",
            Self::AwaitEstimator => "waiting for the estimator",
            Self::LoadWaypoints => "loading way-points",
            Self::SwitchNavigation => "switching navigation on",
            Self::OrderTakeOff => "calling the safety pilot",
            Self::Climb => "climbing",
            Self::Engage => "engaging the autopilot",
            Self::Watch => "flying the laps",
            Self::Loiter => "laps flown",
            Self::Land => "landing",
            Self::End => "over",
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How much a message matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// As it should be.
    Info,
    /// Something had to be done again.
    Warning,
    /// The mission is lost.
    Failure,
}

/// A message for the terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    /// The caller's time, ns.
    pub time_ns: u64,
    /// How much it matters.
    pub severity: Severity,
    /// One sentence.
    pub text: String,
}

/// How the mission stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It goes on.
    Running,
    /// The laps are flown.
    Finished,
    /// It failed; why.
    Failed(String),
}

/// The state of a mission after a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Where the script stands.
    pub phase: Phase,
    /// The caller's time, ns.
    pub time_ns: u64,
    /// Way-point flown to, once navigation tells.
    pub next_waypoint: Option<u32>,
    /// Estimated height above the runway, m; `None` if the newest estimate is old.
    pub altitude_m: Option<f64>,
    /// Measured airspeed, m/s; `None` if the newest measurement is old.
    pub airspeed_mps: Option<f64>,
    /// For how long the Estimator, which has spoken before, has been silent, ns; `None` if it is not.
    pub estimator_silent_ns: Option<u64>,
    /// Way-points reached since navigation was last switched on.
    pub waypoints_reached: u32,
    /// Way-points to reach in all.
    pub waypoints_to_reach: u32,
    /// Things that were sent again in flight because a function had lost them.
    pub rearmed: u32,
    /// Messages since the last step.
    pub events: Vec<Event>,
    /// How it stands.
    pub outcome: Outcome,
}

impl Progress {
    /// Whether the mission is over, well or not.
    pub fn is_over(&self) -> bool {
        self.outcome != Outcome::Running
    }
}
