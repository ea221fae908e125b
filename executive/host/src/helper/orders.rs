//! What helpers are told, each as its one argument, and what they answer.

use bateleur_contract::SealedDescriptors;
use serde::{Deserialize, Serialize};

/// What a helper says before the name of a channel that it leaves out.
pub const BAD: &str = "bad";
/// What the channel holder says when it holds every channel that can be held.
pub const READY: &str = "ready";
/// What it says before the name of each channel, when it comes to it.
pub const AT: &str = "at";

/// What the channel holder is told, as its one argument.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Order {
    /// Root of the module's shared memory.
    pub root: String,
    /// The channels.
    pub channels: Vec<OrderedChannel>,
}

/// One channel of the order.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct OrderedChannel {
    /// The service's name.
    pub name: String,
    /// The source port, `partition.port`.
    pub source: String,
    /// The message type's name.
    pub message: String,
    /// Bytes of a message.
    pub size: usize,
    /// Queue length; `None`: sampling.
    pub depth: Option<usize>,
    /// Destination ports.
    pub destinations: usize,
    /// Sources beside it: of a standby, and of a dead process that is not cleaned up after yet.
    #[serde(default)]
    pub spare_writers: usize,
    /// Destination ports beside them, likewise.
    #[serde(default)]
    pub spare_readers: usize,
    /// Where its memory was handed over, if it is sealed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sealed: Option<SealedDescriptors>,
}

/// What the channel probe is told, as its one argument.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Examination {
    /// Root of the module's shared memory.
    pub root: String,
    /// The ports whose channels are examined.
    pub ports: Vec<ExaminedPort>,
}

/// One port of the order.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ExaminedPort {
    /// Its channel.
    pub channel: OrderedChannel,
    /// It is the channel's source.
    pub writes: bool,
}

/// What the channel cleaner is told.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Cleaning {
    /// Root of the module's shared memory.
    pub root: String,
    /// Whose remains are removed.
    pub dead: Dead,
    /// The directories of the channels that it was attached to.
    pub channels: Vec<String>,
    /// Those among them whose memory must not be looked at.
    pub damaged: Vec<String>,
}

/// A dead process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dead {
    /// Its number.
    pub pid: u32,
    /// The user that nobody else has and of which no process lives: everything that is its own goes. `None` if what goes is
    /// found by the names.
    pub user: Option<u32>,
}
