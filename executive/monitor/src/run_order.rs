//! What a run of a module is asked to do beside its plan: the file that `bateleur run` hands to the executive.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;

use bateleur_contract::Clock;
use bateleur_plan::ModuleError;
use bateleur_time::shared_clock::SharedClock;
use serde::{Deserialize, Serialize};

use crate::planned::{Killings, PlannedAct};

/// What a run is asked to do; what is left out is not asked for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunOrder {
    /// The module's name; may be empty where the plan has one module.
    pub module: String,
    /// The virtual clock.
    pub fast: bool,
    /// On the virtual clock: the processor for all windows; `None`: the executive claims one.
    #[serde(default)]
    pub processor: Option<u32>,
    /// Folder for logs; made where it is missing.
    pub output: PathBuf,
    /// Folder of the partitions' logbooks, likewise. On the virtual clock they begin anew.
    pub logbooks: PathBuf,
    /// Folder of the schedule file: programs with a path, and keys, start there.
    pub plan_folder: PathBuf,
    /// Attributes that replace the plan's, by partition.
    pub overrides: BTreeMap<String, BTreeMap<String, serde_json::Value>>,
    /// Files with keys of links, by link, in place of the plan's.
    pub key_files: BTreeMap<String, PathBuf>,
    /// Addresses in place of those of the plan.
    pub addresses: BTreeMap<SocketAddr, SocketAddr>,
    /// What is to happen to partitions, and when.
    pub acts: Vec<PlannedAct>,
    /// Partitions that chance kills.
    pub killings: Option<Killings>,
    /// Schedules to change to, with the module time at which they are asked for, ns.
    pub schedule_changes: Vec<(String, u64)>,
    /// Other modules on the same virtual clock.
    pub together: Option<SharedClock>,
    /// End at this module time, ns.
    pub until_ns: Option<u64>,
    /// Refuse to start where a promise does not hold.
    pub strict: bool,
    /// Write every message of every port into `ports.mcap`.
    pub record: bool,
    /// Stop when standard input closes.
    pub until_stdin_closes: bool,
    /// Descriptor for events, one JSON object a line; `None`: lines for a person on standard error.
    pub events_fd: Option<i32>,
    /// Descriptor of the socket to whoever holds the other end of a partition's line under the virtual clock.
    pub companion_fd: Option<i32>,
    /// A recording that drives the module's inputs.
    pub play: Option<Play>,
    /// What the executive's supervisor hands to it.
    pub supervised: Option<Supervised>,
}

/// A recording that drives the module's inputs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Play {
    /// Descriptor of the messages, in the form of `bateleur_host::helper::playing`.
    pub messages_fd: i32,
    /// The partitions that are not started, because the recording stands in their place.
    pub partitions: Vec<String>,
    /// The source ports that it drives, in the order in which the messages number them.
    pub ports: Vec<String>,
}

/// What a supervisor keeps for executives that follow each other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supervised {
    /// Descriptor of the page with the run's time and the signs of life.
    pub page_fd: i32,
    /// Descriptors of retained memories, by partition.
    pub retained_fds: BTreeMap<String, i32>,
    /// Descriptors of the memory blocks that partitions write, by name, and of logbooks, by path.
    pub memory_block_fds: BTreeMap<String, i32>,
    /// The executive that ran before; `None` if this is the first.
    pub after: Option<DeadExecutive>,
    /// For a supervisor that follows a dead one: a descriptor of the executive's process.
    pub executive_fd: Option<i32>,
}

/// An executive that has ended and was not to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeadExecutive {
    /// `executive_died` or `executive_hung`.
    pub error: ModuleError,
    /// How, in words.
    pub detail: String,
    /// Module time, ns.
    pub at_ns: u64,
    /// Starts of the module before the next one.
    pub resets: u32,
}

impl RunOrder {
    /// The clock that windows follow.
    #[must_use]
    pub fn clock(&self) -> Clock {
        if self.fast { Clock::Virtual } else { Clock::Wall }
    }
}
