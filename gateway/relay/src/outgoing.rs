//! What goes out: messages are put into the datagram that is being made, large ones in pieces over several.
//!
//! Responsible for: numbers of messages, and what is left of a message that was begun. It must never send part of a message
//! twice, nor begin one for which there is no room.

use crate::link::{Link, Sealed};
use crate::wire::{self, MESSAGE_BYTES, PIECE_BYTES, Part};

/// The smallest piece but the last, bytes: smaller ones would be mostly heads.
pub(crate) const LEAST_PIECE: usize = 32;

/// What the source said of its message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Stamp {
    /// When it wrote it, module time, ns.
    pub source_ns: u64,
    /// Its own count of its messages.
    pub sequence: u64,
}

/// The channels that go out from here.
#[derive(Debug, Default)]
pub(crate) struct Outgoing {
    /// Messages sent so far to the peer's present life, by channel; none: the channel comes in.
    sent: Vec<Option<u32>>,
    begun: Begun,
}

/// A message that did not fit into one datagram.
#[derive(Debug, Default)]
struct Begun {
    channel: u16,
    sequence: u32,
    stamp: Stamp,
    bytes: Vec<u8>,
    /// Bytes that have gone out; all of them: there is nothing.
    sent: usize,
}

impl Begun {
    fn left(&self) -> usize {
        self.bytes.len() - self.sent
    }
}

impl Outgoing {
    /// For channels of which some go out, with messages of `most` bytes.
    pub(crate) fn new(goes_out: impl Iterator<Item = bool>, most: usize) -> Self {
        let sent = goes_out.map(|out| out.then_some(0)).collect();
        Self { sent, begun: Begun { bytes: Vec::with_capacity(most), ..Begun::default() } }
    }

    /// Part of a message has gone out, and not all of it.
    pub(crate) fn has_more(&self) -> bool {
        self.begun.left() > 0
    }

    /// For a new life of the peer.
    pub(crate) fn restart(&mut self) {
        self.sent.iter_mut().flatten().for_each(|sent| *sent = 0);
        self.begun.bytes.clear();
        self.begun.sent = 0;
    }
}

/// A datagram that is being made.
pub struct Composer<'a> {
    pub(crate) link: &'a mut Link,
    /// Bytes that the datagram may have before its tag.
    pub(crate) end: usize,
    pub(crate) count: u16,
    pub(crate) open: bool,
}

impl<'a> Composer<'a> {
    /// Whether the peer takes messages; until it does, they stay where they are.
    #[must_use]
    pub fn takes_messages(&self) -> bool {
        self.open
    }

    /// Whether a message of `bytes` fits, whole or, where it is longer than any datagram, in pieces.
    #[must_use]
    pub fn has_room(&self, bytes: usize) -> bool {
        let free = self.free();
        self.open
            && self.count < u16::MAX
            && (bytes + MESSAGE_BYTES <= free
                || self.is_long(bytes)
                    && self.link.outgoing.begun.left() == 0
                    && free >= MESSAGE_BYTES + PIECE_BYTES + LEAST_PIECE)
    }

    /// Puts a message in. False: there is no room, or the channel at this place of the table does not go out; nothing was
    /// done.
    pub fn put(&mut self, channel: usize, stamp: Stamp, bytes: &[u8]) -> bool {
        let Some(id) = self.link.channel_id(channel) else { return false };
        if !self.has_room(bytes.len()) {
            return false;
        }
        let fits = bytes.len() + MESSAGE_BYTES <= self.free();
        let Some(Some(sent)) = self.link.outgoing.sent.get_mut(channel) else { return false };
        let sequence = *sent;
        *sent = sent.wrapping_add(1);
        self.link.counters.messages_sent += 1;
        if fits {
            self.append(id, sequence, stamp, None, bytes);
        } else {
            let begun = &mut self.link.outgoing.begun;
            begun.bytes.clear();
            begun.bytes.extend_from_slice(bytes);
            (begun.channel, begun.sequence, begun.stamp, begun.sent) = (id, sequence, stamp, 0);
            self.go_on(self.free());
        }
        true
    }

    /// The datagram is done, and goes at `now_ns`.
    pub fn finish(mut self, now_ns: u64) -> Sealed<'a> {
        if self.open {
            self.go_on(self.free());
        }
        self.link.seal(self.count, now_ns)
    }

    /// Puts in a further piece of the message that was begun, of at most `room` bytes with its heads.
    pub(crate) fn go_on(&mut self, room: usize) {
        let left = self.link.outgoing.begun.left();
        let room = room.min(self.free()).saturating_sub(MESSAGE_BYTES + PIECE_BYTES);
        let length = left.min(room);
        if left == 0 || length < left.min(LEAST_PIECE) {
            return;
        }
        let mut begun = std::mem::take(&mut self.link.outgoing.begun);
        let bytes = &begun.bytes[begun.sent..begun.sent + length];
        // A message is at most as long as the plan says, in 32 bits.
        let piece = (begun.bytes.len() as u32, begun.sent as u32);
        self.append(begun.channel, begun.sequence, begun.stamp, Some(piece), bytes);
        begun.sent += length;
        self.link.outgoing.begun = begun;
    }

    fn append(&mut self, id: u16, sequence: u32, stamp: Stamp, piece: Option<(u32, u32)>, bytes: &[u8]) {
        let source_sequence = stamp.sequence as u32; // its low half
        let part = Part { channel: id, sequence, source_sequence, source_ns: stamp.source_ns, piece, bytes };
        wire::put(&mut self.link.datagram, &part);
        self.count += 1;
    }

    fn free(&self) -> usize {
        self.end.saturating_sub(self.link.datagram.len())
    }

    /// Longer than what an empty datagram holds.
    fn is_long(&self, bytes: usize) -> bool {
        bytes + MESSAGE_BYTES + wire::HEADER_BYTES > self.end
    }
}
