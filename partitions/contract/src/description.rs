//! What a partition is told at its start, as JSON behind [`crate::DESCRIPTION_FD`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Everything a partition knows about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The module that it runs in.
    pub module: String,
    /// Its name in the plan.
    pub partition: String,
    /// Incarnations before this one.
    pub generation: u32,
    /// Why it was started.
    pub start_condition: StartCondition,
    /// It stands by: it initialises, sleeps, and has its first window when it has taken over. Queues are attached then.
    pub standby: bool,
    /// Which clock module time follows. For the library only: a partition's own code can not tell.
    pub clock: Clock,
    /// Its ports.
    pub ports: Vec<PortDescription>,
    /// Its attributes, as the plan has them.
    pub attributes: BTreeMap<String, serde_json::Value>,
    /// The module's schedules, in the order of the plan: a schedule's number is its place.
    pub schedules: Vec<String>,
    /// The numbers of the schedules in which the partition may ask for another one.
    pub may_set_schedule: Vec<u32>,
    /// The plan counts on an error handler of the partition's own.
    pub error_handler: bool,
    /// The partition may tell how the module's major frames lie to a peer's: it is the relay of a module that follows.
    #[serde(default)]
    pub may_align: bool,
    /// Bytes of retained memory behind [`crate::RETAINED_FD`]; 0: none.
    pub retained_bytes: u64,
    /// Directory of the module's channels: each has a directory of its own in it.
    pub ports_root: String,
}

/// Why a partition was started (ARINC 653 START_CONDITION).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartCondition {
    /// The module was started.
    NormalStart,
    /// The partition asked for it; retained memory is zero.
    PartitionRestart,
    /// The partition asked for it; retained memory is as it was left.
    PartitionWarmRestart,
    /// Health monitoring restarted the module.
    HmModuleRestart,
    /// Health monitoring restarted the partition; retained memory is as it was left.
    HmPartitionWarmRestart,
    /// Health monitoring restarted the partition; retained memory is zero.
    HmPartitionColdRestart,
}

impl StartCondition {
    /// Retained memory is as it was left.
    #[must_use]
    pub fn is_warm(self) -> bool {
        matches!(self, Self::PartitionWarmRestart | Self::HmPartitionWarmRestart)
    }
}

/// The two clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// CLOCK_MONOTONIC.
    Wall,
    /// Jumps to the next event as soon as a window is closed.
    Virtual,
}

/// One port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PortDescription {
    /// Its name within the partition.
    pub name: String,
    /// Which end of the channel it is.
    pub direction: Direction,
    /// Sampling or queuing.
    pub kind: PortKind,
    /// The message type's name.
    pub message: String,
    /// Bytes of a message; for queuing ports the most that one holds.
    pub size: u32,
    /// A number that differs where the message type's fields do; 0: they are not known.
    pub layout: u32,
    /// The message type's text, and behind it those of the types within it; empty: they are not known.
    #[serde(default)]
    pub definition: String,
    /// The service that carries the channel; empty for a port without a channel.
    pub channel: String,
    /// Sampling destination: the age up to which a value is valid, ns.
    pub refresh_ns: u64,
    /// Queuing: messages that wait at most.
    pub depth: u32,
}

/// Which end of a channel a port is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Writes.
    Source,
    /// Reads.
    Destination,
}

/// What a port keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PortKind {
    /// The latest value.
    Sampling,
    /// Messages in order.
    Queuing,
}

impl PortKind {
    /// Whether a message of `bytes` can be one of a channel whose longest has `most`: the only length of a sampling channel's.
    #[must_use]
    pub fn carries(self, most: usize, bytes: usize) -> bool {
        match self {
            Self::Sampling => bytes == most,
            Self::Queuing => (1..=most).contains(&bytes),
        }
    }
}
