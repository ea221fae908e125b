//! What goes out: messages are put into the datagram that is being made, large ones in pieces over several.
//!
//! Responsible for: numbers of messages, and what is left of a message that was begun. It must never send part of a message
//! twice, nor begin one for which there is no room.

use bateleur_contract::PortKind;
use bateleur_contract::packing;
use bateleur_contract::relay::RelayChannel;

use crate::link::{Link, Sealed};
use crate::wire::{self, HEADER_BYTES, MESSAGE_BYTES, PIECE_BYTES, Part};

/// The smallest piece but the last, bytes: smaller ones would be mostly heads.
pub(crate) const LEAST_PIECE: usize = 32;

/// What a piece has before it, bytes.
const HEADS: usize = MESSAGE_BYTES + PIECE_BYTES;

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
    /// By place in the table; `None` if the channel comes in.
    channels: Vec<Option<Channel>>,
    begun: Begun,
}

#[derive(Debug, Clone, Copy)]
struct Channel {
    kind: PortKind,
    plain: bool,
    /// The longest message, bytes.
    most: usize,
    /// Its messages go in pieces where they do not fit.
    in_pieces: bool,
    /// Messages sent so far to the peer's present life.
    sent: u32,
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
    /// For the channels of a table, in datagrams of at most `max_datagram` bytes.
    pub(crate) fn new(channels: &[RelayChannel], max_datagram: u32) -> Self {
        let most = channels.iter().map(|channel| channel.max_bytes as usize).max().unwrap_or(0);
        let channel = |channel: &RelayChannel| Channel {
            kind: channel.kind,
            plain: channel.plain,
            most: channel.max_bytes as usize,
            in_pieces: packing::goes_in_pieces(channel.max_bytes.into(), max_datagram),
            sent: 0,
        };
        let channels = channels.iter().map(|one| one.outgoing.then(|| channel(one))).collect();
        Self { channels, begun: Begun { bytes: Vec::with_capacity(most), ..Begun::default() } }
    }

    /// Part of a message has gone out, and not all of it.
    pub(crate) fn has_more(&self) -> bool {
        self.begun.left() > 0
    }

    /// For a new life of the peer.
    pub(crate) fn restart(&mut self) {
        self.channels.iter_mut().flatten().for_each(|channel| channel.sent = 0);
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

    /// Whether any message of the channel at this place of the table can be put in, however long.
    #[must_use]
    pub fn has_room(&self, channel: usize) -> bool {
        self.channel(channel).is_some_and(|channel| self.takes(&channel, channel.most))
    }

    /// Whether a message of `bytes` can be put in: whole, or with a piece of it.
    fn takes(&self, channel: &Channel, bytes: usize) -> bool {
        // Before another one is begun, all of the one before has to be in.
        let before = match self.link.outgoing.begun.left() {
            0 => 0,
            left => left + HEADS,
        };
        self.open
            && self.count < u16::MAX
            && (bytes + MESSAGE_BYTES <= self.free_for_others()
                || channel.in_pieces && before + HEADS + LEAST_PIECE <= self.free())
    }

    fn channel(&self, place: usize) -> Option<Channel> {
        self.link.outgoing.channels.get(place).copied().flatten()
    }

    /// Puts a message in. False: there is no room, the channel at this place of the table does not go out, or its messages have
    /// another length (the peer would refuse the whole datagram); nothing was done.
    pub fn put(&mut self, channel: usize, stamp: Stamp, bytes: &[u8]) -> bool {
        let (Some(id), Some(known)) = (self.link.channel_id(channel), self.channel(channel)) else {
            return false;
        };
        if !known.kind.carries(known.plain, known.most, bytes.len()) || !self.takes(&known, bytes.len()) {
            return false;
        }
        let fits = bytes.len() + MESSAGE_BYTES <= self.free_for_others();
        let sequence = known.sent;
        self.link.outgoing.channels[channel] = Some(Channel { sent: sequence.wrapping_add(1), ..known });
        self.link.counters.messages_sent += 1;
        if fits {
            self.append(id, sequence, stamp, None, bytes);
        } else {
            self.go_on();
            let begun = &mut self.link.outgoing.begun;
            begun.bytes.clear();
            begun.bytes.extend_from_slice(bytes);
            (begun.channel, begun.sequence, begun.stamp, begun.sent) = (id, sequence, stamp, 0);
            self.go_on();
        }
        true
    }

    /// The datagram is done, and goes at `now_ns`.
    pub fn finish(mut self, now_ns: u64) -> Sealed<'a> {
        if self.open {
            self.go_on();
        }
        self.link.seal(self.count, now_ns)
    }

    /// Puts in a further piece of the message that was begun, as long as there is room for.
    fn go_on(&mut self) {
        let left = self.link.outgoing.begun.left();
        let length = left.min(self.free().saturating_sub(HEADS));
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

    /// Without what is kept for the message that was begun: its rest, but half of a datagram at most.
    fn free_for_others(&self) -> usize {
        let kept = match self.link.outgoing.begun.left() {
            0 => 0,
            left => (left + HEADS).min((self.end - HEADER_BYTES) / 2),
        };
        self.free().saturating_sub(kept)
    }
}
