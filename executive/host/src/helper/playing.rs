//! What the executive and a player, which writes recorded messages into channels, say to each other, and the form of the messages.
//!
//! A group of channels is played up to an instant: an order is the group's number, four bytes, and the instant, eight; the answer is
//! the instant of the group's next message, eight bytes. All are little-endian.

use serde::{Deserialize, Serialize};

use super::orders::Order;

/// The group of the ports that the plan leaves to the operator. Those of the partitions that are not started follow.
pub const OPERATORS: u32 = 0;
/// The next message of a group that has none any more.
pub const NEVER: u64 = u64::MAX;
/// Bytes of an order.
pub const ORDER_BYTES: usize = 12;
/// Bytes before each message: module time and sequence, eight each; the channel's place in the order and the length, four each.
pub const HEAD_BYTES: usize = 24;

/// What a player is told, as its one argument.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PlayerOrder {
    /// The channels that it is the source of.
    pub order: Order,
    /// The group of each of them.
    pub groups: Vec<u32>,
    /// Messages before this module time were played already, ns.
    pub from_ns: u64,
}

/// What stands before a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// Module time, ns.
    pub time_ns: u64,
    /// Its number at its source.
    pub sequence: u64,
    /// The channel's place in the order.
    pub channel: u32,
    /// Bytes of the message.
    pub length: u32,
}

impl Head {
    /// As it is written.
    #[must_use]
    pub fn to_bytes(self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        bytes[..8].copy_from_slice(&self.time_ns.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.channel.to_le_bytes());
        bytes[20..].copy_from_slice(&self.length.to_le_bytes());
        bytes
    }

    /// The first of `bytes`, and what follows it; `None`: they are too few.
    #[must_use]
    pub fn split(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (time_ns, rest) = bytes.split_first_chunk()?;
        let (sequence, rest) = rest.split_first_chunk()?;
        let (channel, rest) = rest.split_first_chunk()?;
        let (length, rest) = rest.split_first_chunk()?;
        let head = Self {
            time_ns: u64::from_le_bytes(*time_ns),
            sequence: u64::from_le_bytes(*sequence),
            channel: u32::from_le_bytes(*channel),
            length: u32::from_le_bytes(*length),
        };
        Some((head, rest))
    }
}
