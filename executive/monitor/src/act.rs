//! What can be done to a partition by an operator or a plan of faults.

use serde::{Deserialize, Serialize};

use crate::inject::Fault;

/// After a partition's name: the process that stands by for it. No name of a partition has a dot.
pub const STANDBY: &str = ".standby";

/// What can be done to a partition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    /// Its process dies.
    Kill,
    /// The process that stands by for it dies.
    KillStandby,
    /// It is ended until it is started.
    Stop,
    /// It is started from nothing.
    Start,
    /// It is held.
    Freeze,
    /// It goes on.
    Thaw,
    /// A fault is provoked.
    Inject(Fault),
}

impl Act {
    /// Its word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::KillStandby => "kill standby",
            Self::Stop => "stop",
            Self::Start => "start",
            Self::Freeze => "freeze",
            Self::Thaw => "thaw",
            Self::Inject(_) => "inject",
        }
    }
}
