//! What a driver provides for ports. Here only their checks and their waiting processes are.

use crate::queues::ListId;
use crate::standard::{Name, PortDirection, QueuingDiscipline, SystemTime, Validity};

/// A sampling port of the plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplingConfiguration {
    /// How the driver calls it.
    pub key: usize,
    /// Bytes of a message.
    pub max_size: i32,
    /// Source or destination.
    pub direction: PortDirection,
    /// The age up to which a message is valid, ns.
    pub refresh: SystemTime,
}

/// A queuing port of the plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueuingConfiguration {
    /// How the driver calls it.
    pub key: usize,
    /// Bytes of a message.
    pub max_size: i32,
    /// Messages that it can hold.
    pub max_messages: i32,
    /// Source or destination.
    pub direction: PortDirection,
}

/// A message that was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// A message was lost since the one before, because the queue was full.
    pub overflow: bool,
}

/// Which message of a sampling port it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// When it was written, ns.
    pub at: SystemTime,
    /// Its number at its source, which begins anew where that starts again.
    pub sequence: u64,
}

/// The ports themselves. Nothing in here waits.
pub trait Ports {
    /// The sampling port with this name.
    fn sampling(&self, name: &Name) -> Option<SamplingConfiguration>;
    /// The queuing port with this name.
    fn queuing(&self, name: &Name) -> Option<QueuingConfiguration>;
    /// Replaces the message of a sampling source.
    fn write(&mut self, port: usize, message: &[u8], now: SystemTime);
    /// Copies the message of a sampling destination; gives which one it was. `None` before the first.
    fn read(&mut self, port: usize, into: &mut Vec<u8>) -> Option<Written>;
    /// Appends a message to a queuing source. False if there is no room.
    fn send(&mut self, port: usize, message: &[u8]) -> bool;
    /// Takes the oldest message of a queuing destination. `None` if there is none.
    fn receive(&mut self, port: usize, into: &mut Vec<u8>) -> Option<Received>;
    /// Bytes of the oldest message of a queuing destination, which stays. `None` if there is none.
    fn next_length(&self, port: usize) -> Option<usize>;
    /// Drops all messages of a queuing destination.
    fn clear(&mut self, port: usize);
    /// Messages on this side of a queuing port.
    fn count(&self, port: usize) -> i32;
}

#[derive(Debug)]
pub(crate) struct SamplingPort {
    pub(crate) configured: SamplingConfiguration,
    /// Of the last read.
    pub(crate) validity: Validity,
    /// The message of the last read.
    pub(crate) consumed: Option<Written>,
}

#[derive(Debug)]
pub(crate) struct QueuingPort {
    pub(crate) configured: QueuingConfiguration,
    pub(crate) discipline: QueuingDiscipline,
    pub(crate) waiting: ListId,
}
