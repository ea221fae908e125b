//! How the memory of a sealed channel is laid out: the executive makes it without looking into it, both ends map it.
//!
//! The source's memory is a ring of slots that the source alone may write. A queue has a second one, of its destination: what that has
//! taken. It must never hold a size that somebody reads from there: both ends know it from the plan.

use serde::{Deserialize, Serialize};

/// Bytes that the ring's slots may take together, where so many are enough for those who only look.
const ROOM: usize = 1 << 20;
/// Messages that a ring keeps, most: what somebody who looks at a channel may lag behind, as on a shared one.
const MOST_KEPT: usize = 128;
/// Messages that a ring keeps, least: a reader that is held up while it copies has so many writes until its slot is written over.
const LEAST_KEPT: usize = 8;
/// A word of the memory, bytes.
pub const WORD: usize = 8;
/// Words that one processor changes while another one reads its neighbours are so many bytes apart.
pub const LINE: usize = 64;
/// Bytes of a slot before its message: its number, the message's two stamps, its length and checksum.
pub const SLOT_HEAD: usize = 4 * WORD;
/// What the name of a sealed channel's memory begins with, as a map of the process shows it.
pub const MEMORY_NAME: &str = "memfd:channel ";
/// Bytes of a destination's memory.
pub const INDEX_BYTES: usize = 2 * LINE;

/// The ring of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RingShape {
    /// Bytes of the longest message.
    pub message_bytes: usize,
    /// Slots; at least two.
    pub slots: usize,
}

impl RingShape {
    /// Of a channel's longest message and its queue's length; `None`: sampling.
    #[must_use]
    pub fn new(message_bytes: usize, depth: Option<usize>) -> Self {
        let kept = (ROOM / slot_bytes(message_bytes)).clamp(LEAST_KEPT, MOST_KEPT).max(depth.unwrap_or(0));
        // One more than is kept: what is being written takes none of them away.
        Self { message_bytes, slots: kept + 1 }
    }

    /// From the start of one slot to that of the next, bytes.
    #[must_use]
    pub fn slot_bytes(&self) -> usize {
        slot_bytes(self.message_bytes)
    }

    /// Bytes of the whole memory: a line with the number of the last message, and the slots.
    #[must_use]
    pub fn bytes(&self) -> usize {
        LINE + self.slots * self.slot_bytes()
    }
}

fn slot_bytes(message_bytes: usize) -> usize {
    (SLOT_HEAD + message_bytes).next_multiple_of(LINE)
}

/// Where a process finds the memory of a sealed channel that it is attached to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SealedDescriptors {
    /// The source's memory, writable for the source alone.
    pub ring: i32,
    /// A queue's: the destination's memory, writable for the destination alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index: Option<i32>,
    /// Messages carry a checksum.
    #[serde(default)]
    pub checked: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_hold_a_whole_queue_and_one_and_begin_each_message_aligned() {
        for message_bytes in [1, 8, 64, 479, 8192, 65_536, 1 << 20] {
            for depth in [None, Some(1), Some(127), Some(512)] {
                let shape = RingShape::new(message_bytes, depth);
                assert!(shape.slots > depth.unwrap_or(1), "{shape:?}");
                assert_eq!((SLOT_HEAD % 16, shape.slot_bytes() % LINE), (0, 0));
                assert!(shape.slot_bytes() >= SLOT_HEAD + message_bytes);
                assert_eq!(shape.bytes(), LINE + shape.slots * shape.slot_bytes());
            }
        }
        assert_eq!(
            RingShape::new(64, None).slots,
            MOST_KEPT + 1,
            "whoever looks loses no more than on a shared one"
        );
    }
}
