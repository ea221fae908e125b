//! What a partition is told at its start, as JSON behind [`crate::DESCRIPTION_FD`].

use std::collections::BTreeMap;
use std::net::SocketAddrV4;

use serde::{Deserialize, Serialize};

use crate::logbook::LogbookSizes;
use crate::sealed::SealedDescriptors;

/// The port through which a replica is told by a voter on another module that it is outvoted: plain bytes, the reason, with the stamp of
/// the message that it is outvoted for. The voter's port is called so, with `_` and the replica's number behind.
pub const OUTVOTED_PORT: &str = "outvoted";

/// The longest such reason, bytes.
pub const OUTVOTED_BYTES: u32 = 128;

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
    /// It is a spare: it waits before it does anything, until the control page says why it begins. That counts, and not
    /// `start_condition`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub spare: bool,
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
    /// Its number and times, and what its processes may take.
    pub processes: ProcessPlan,
    /// Its times in schedules in which they are others, by the schedule's number.
    #[serde(default)]
    pub schedule_times: BTreeMap<u32, PartitionTimes>,
    /// Descriptor of its [`crate::ProcessTable`]; it has none where it can have one thread only.
    #[serde(default)]
    pub process_table: Option<i32>,
    /// Descriptor of its crash memory ([`crate::crash`]).
    #[serde(default)]
    pub crash_memory: Option<i32>,
    /// The processes whose times the plan knows.
    #[serde(default)]
    pub planned_processes: Vec<PlannedProcess>,
    /// Errors of processes, as the health tables name them, that the plan does not leave to an error handler of theirs.
    #[serde(default)]
    pub taken_errors: Vec<String>,
    /// The partition may tell how the module's major frames lie to a peer's: it is the relay of a module that follows.
    #[serde(default)]
    pub may_align: bool,
    /// It is a replica, and its voter is on another module: through its last port, [`OUTVOTED_PORT`], it is told of verdicts on what it
    /// wrote. For the library only: it is none of the ports that a partition's own code sees.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub voted_elsewhere: bool,
    /// Bytes of retained memory behind [`crate::RETAINED_FD`]; 0: none.
    pub retained_bytes: u64,
    /// The memory blocks that it is given.
    #[serde(default)]
    pub memory_blocks: Vec<MemoryBlockDescription>,
    /// Its logbooks.
    #[serde(default)]
    pub logbooks: Vec<LogbookDescription>,
    /// The module's name services, by name: addresses of service access points, by theirs.
    #[serde(default)]
    pub name_services: BTreeMap<String, BTreeMap<String, SocketAddrV4>>,
    /// Directory of the module's channels: each has a directory of its own in it.
    pub ports_root: String,
}

/// What the plan says of a partition's processes, and of the time that it gives them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessPlan {
    /// The partition's number; no other of its module has it.
    pub identifier: u32,
    /// From one release point to the next, ns; above 0.
    pub period_ns: u64,
    /// One of the release points, module time, ns.
    pub release_ns: u64,
    /// Time that the partition has in each period at least, ns.
    pub duration_ns: u64,
    /// Processes that it may create at most.
    pub most: u32,
    /// Bytes that their stacks may have together.
    pub stacks_bytes: u64,
}

/// A partition's period in a schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartitionTimes {
    /// From one release point to the next, ns; above 0.
    pub period_ns: u64,
    /// The first release point, from the start of a major frame, ns.
    pub release_ns: u64,
    /// Time that the partition has in each period at least, ns.
    pub duration_ns: u64,
}

/// A process as the plan has it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlannedProcess {
    /// Its name.
    pub name: String,
    /// 1 to 239, the highest is the most urgent.
    pub priority: u8,
    /// From one release to the next, ns; `None`: it is not periodic.
    pub period_ns: Option<u64>,
    /// From a release to its deadline, ns; `None`: it has none.
    pub deadline_ns: Option<u64>,
}

/// A memory block (ARINC 653 part 2) that a partition is given.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemoryBlockDescription {
    /// Its name in the plan.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// The partition may write it; otherwise the descriptor only reads.
    pub writable: bool,
    /// The descriptor of its memory.
    pub descriptor: i32,
}

/// A logbook (ARINC 653 part 2) of a partition.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogbookDescription {
    /// Its name in the plan.
    pub name: String,
    /// How much it holds.
    pub sizes: LogbookSizes,
    /// The descriptor of its memory.
    pub descriptor: i32,
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
    const ALL: [Self; 6] = [
        Self::NormalStart,
        Self::PartitionRestart,
        Self::PartitionWarmRestart,
        Self::HmModuleRestart,
        Self::HmPartitionWarmRestart,
        Self::HmPartitionColdRestart,
    ];

    /// Its number on the control page; never 0.
    #[must_use]
    pub fn number(self) -> u32 {
        self as u32 + 1
    }

    /// The condition with this number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|condition| condition.number() == number)
    }

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
    /// The message type's name; [`PLAIN_BYTES`] where there is none.
    pub message: String,
    /// Bytes of a message; for queuing ports and plain bytes the most that one holds.
    pub size: u32,
    /// A number that differs where the message type's fields do; 0: they are not known.
    pub layout: u32,
    /// The message type's text, and behind it those of the types within it; empty: they are not known.
    #[serde(default)]
    pub definition: String,
    /// The service that carries the channel; empty for a port without a channel.
    pub channel: String,
    /// Where the channel's memory is, if it is a sealed one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sealed: Option<SealedDescriptors>,
    /// Sampling destination: the age up to which a value is valid, ns.
    pub refresh_ns: u64,
    /// Queuing: messages that wait at most.
    pub depth: u32,
    /// The partition need not create it.
    pub optional: bool,
}

/// Stands for the message type where the plan gives a size alone.
pub const PLAIN_BYTES: &str = "bytes";

impl PortDescription {
    /// It carries bytes without a message type.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.message == PLAIN_BYTES && self.layout == 0
    }

    /// Whether a message of `bytes` can be one of this port's: of any length up to its size, but for a sampling port with a message type.
    #[must_use]
    pub fn carries(&self, bytes: usize) -> bool {
        self.kind.carries(self.is_plain(), self.size as usize, bytes)
    }
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
    /// Whether a message of `bytes` can be one of a channel whose longest has `most`: the only length of a sampling channel's, unless
    /// it carries `plain` bytes.
    #[must_use]
    pub fn carries(self, plain: bool, most: usize, bytes: usize) -> bool {
        match self {
            Self::Sampling if !plain => bytes == most,
            Self::Sampling | Self::Queuing => (1..=most).contains(&bytes),
        }
    }
}
