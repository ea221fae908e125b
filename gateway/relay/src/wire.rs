//! The layout of a datagram: header, messages, tag. Everything is little endian and nothing is aligned.
//!
//! Responsible for: turning bytes into headers and message heads, and refusing what is not a datagram of this version from
//! its first to its last byte. It must never trust a length: every one is held against the bytes that are there.

use zerocopy::little_endian::{U16, U32, U64};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// First bytes of every datagram.
pub const MAGIC: [u8; 4] = *b"BTLK";
/// Raised whenever the layout or the meaning of a field changes.
pub const VERSION: u8 = 1;
/// Bytes of the header.
pub const HEADER_BYTES: usize = size_of::<Header>();
/// Bytes before each message.
pub const MESSAGE_BYTES: usize = size_of::<MessageHead>();
/// Further bytes before a piece of a message.
pub const PIECE_BYTES: usize = size_of::<PieceHead>();
/// In [`MessageHead::channel`]: what follows is a piece.
pub(crate) const PIECE: u16 = 1 << 15;
/// Channels are numbered below this.
pub(crate) const CHANNELS: u16 = PIECE;

/// [`Header::kind`]: messages of channels, perhaps none.
pub(crate) const KIND_MESSAGES: u8 = 0;
/// [`Header::kind`]: digests of the plan's parts, for a peer with another plan.
pub(crate) const KIND_SECTIONS: u8 = 1;

/// What stands before the messages.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(crate) struct Header {
    /// [`MAGIC`].
    pub(crate) magic: [u8; 4],
    /// [`VERSION`].
    pub(crate) version: u8,
    /// [`KIND_MESSAGES`] or [`KIND_SECTIONS`].
    pub(crate) kind: u8,
    /// The link's number in the plan.
    pub(crate) link: U16,
    /// Bytes of the datagram, the tag included.
    pub(crate) length: U32,
    /// Messages or sections in it.
    pub(crate) count: U16,
    /// 1: a tag follows.
    pub(crate) tagged: U16,
    /// The first half of the plan's digest.
    pub(crate) plan: [u8; 16],
    /// The sender's life: a number that it drew at its start.
    pub(crate) session: U64,
    /// The life of the receiver that the sender has proof of; 0: none.
    pub(crate) to_session: U64,
    /// What the sender wants to see in `answer` as proof that the receiver lives now.
    pub(crate) challenge: U64,
    /// The receiver's challenge that the sender saw last; 0: none.
    pub(crate) answer: U64,
    /// Datagrams of this life before this one.
    pub(crate) sequence: U64,
    /// When it was sent, the sender's module time, ns.
    pub(crate) sent_ns: U64,
    /// `sent_ns` of the receiver's latest datagram that the sender has seen; 0: none.
    pub(crate) echo_sent_ns: U64,
    /// When that one came, the sender's module time, ns.
    pub(crate) echo_came_ns: U64,
    /// The sender's major frames before the present one.
    pub(crate) frame: U64,
    /// When its present major frame began, the sender's module time, ns.
    pub(crate) frame_ns: U64,
}

/// What stands before each message or piece.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(crate) struct MessageHead {
    /// The channel's number; with [`PIECE`], a [`PieceHead`] follows.
    pub(crate) channel: U16,
    /// Bytes that follow the head or heads.
    pub(crate) length: U16,
    /// Messages of this channel in this life of the sender before this one.
    pub(crate) sequence: U32,
    /// The source's own count of its messages, its low half.
    pub(crate) source_sequence: U32,
    /// When the source wrote it, the sender's module time, ns.
    pub(crate) source_ns: U64,
}

/// Where a piece belongs in its message.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(crate) struct PieceHead {
    /// Bytes of the whole message.
    pub(crate) total: U32,
    /// Bytes of it before this piece.
    pub(crate) offset: U32,
}

/// Why a datagram is refused. The order is that of the counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(usize)]
pub enum Rejection {
    /// Shorter than it says, or than a header.
    Truncated = 0,
    /// Longer than it says, or than the plan allows.
    Giant,
    /// No datagram of a relay.
    Foreign,
    /// Of another version of the protocol.
    Version,
    /// Of a link that does not end here.
    Link,
    /// Its tag was not made with this link's key, or a byte was changed; or tagged where no tag belongs, or the reverse.
    Key,
    /// Of a relay with another plan.
    Plan,
    /// Of a life of the peer that is not proven to be the present one, or for a life of this end that is over.
    Restart,
    /// From before the replay window.
    Replay,
    /// What is in it can not be taken apart.
    Malformed,
    /// It holds a message of a channel that does not come in here, or one that is too long for it.
    Channel,
    /// From an address that is not the peer's.
    Stranger,
}

impl Rejection {
    /// All of them, in order.
    pub const ALL: [Self; bateleur_messages::link::REASONS] = [
        Self::Truncated,
        Self::Giant,
        Self::Foreign,
        Self::Version,
        Self::Link,
        Self::Key,
        Self::Plan,
        Self::Restart,
        Self::Replay,
        Self::Malformed,
        Self::Channel,
        Self::Stranger,
    ];

    /// The word for it in tables.
    pub fn name(self) -> &'static str {
        bateleur_messages::link::REASON_NAMES[self as usize]
    }
}

/// The link that a datagram says it belongs to; nothing where it is none of a relay.
pub fn link_of(datagram: &[u8]) -> Option<u16> {
    let (header, _) = Header::ref_from_prefix(datagram).ok()?;
    (header.magic == MAGIC).then(|| header.link.get())
}

/// The header of a datagram that is one as far as its form goes: its length and that of its parts agree with `most` and with
/// what came.
pub(crate) fn parse(datagram: &[u8], most: usize) -> Result<&Header, Rejection> {
    if datagram.len() > most {
        return Err(Rejection::Giant);
    }
    let (header, _) = Header::ref_from_prefix(datagram).map_err(|_| Rejection::Truncated)?;
    if header.magic != MAGIC {
        return Err(Rejection::Foreign);
    }
    if header.version != VERSION {
        return Err(Rejection::Version);
    }
    match datagram.len().cmp(&(header.length.get() as usize)) {
        std::cmp::Ordering::Less => Err(Rejection::Truncated),
        std::cmp::Ordering::Greater => Err(Rejection::Giant),
        std::cmp::Ordering::Equal => Ok(header),
    }
}

/// A message or a piece of one, as it stands in a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Part<'a> {
    pub(crate) channel: u16,
    pub(crate) sequence: u32,
    pub(crate) source_sequence: u32,
    pub(crate) source_ns: u64,
    /// Total length and offset of a piece; `None` if the message is whole.
    pub(crate) piece: Option<(u32, u32)>,
    pub(crate) bytes: &'a [u8],
}

/// Takes the parts of a datagram out of what stands between header and tag. Fused: after something wrong there is nothing
/// more.
pub(crate) struct Parts<'a>(pub(crate) &'a [u8]);

impl<'a> Iterator for Parts<'a> {
    type Item = Result<Part<'a>, Rejection>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let part = take(self.0);
        self.0 = part.as_ref().map_or(&[], |(_, rest)| rest);
        Some(part.map(|(part, _)| part).ok_or(Rejection::Malformed))
    }
}

fn take(bytes: &[u8]) -> Option<(Part<'_>, &[u8])> {
    let (head, rest) = MessageHead::ref_from_prefix(bytes).ok()?;
    let (piece, rest) = match head.channel.get() & PIECE {
        0 => (None, rest),
        _ => {
            let (piece, rest) = PieceHead::ref_from_prefix(rest).ok()?;
            let end = u64::from(piece.offset.get()) + u64::from(head.length.get());
            if end > u64::from(piece.total.get()) || head.length.get() == 0 {
                return None;
            }
            (Some((piece.total.get(), piece.offset.get())), rest)
        }
    };
    let (bytes, rest) = rest.split_at_checked(usize::from(head.length.get()))?;
    let part = Part {
        channel: head.channel.get() & !PIECE,
        sequence: head.sequence.get(),
        source_sequence: head.source_sequence.get(),
        source_ns: head.source_ns.get(),
        piece,
        bytes,
    };
    Some((part, rest))
}

/// Puts a part at the end of `datagram`. The caller has seen to it that it fits, and that its length is one of 16 bits.
pub(crate) fn put(datagram: &mut Vec<u8>, part: &Part<'_>) {
    let flag = if part.piece.is_some() { PIECE } else { 0 };
    let head = MessageHead {
        channel: U16::new(part.channel | flag),
        length: U16::new(part.bytes.len() as u16),
        sequence: U32::new(part.sequence),
        source_sequence: U32::new(part.source_sequence),
        source_ns: U64::new(part.source_ns),
    };
    datagram.extend_from_slice(head.as_bytes());
    if let Some((total, offset)) = part.piece {
        let piece = PieceHead { total: U32::new(total), offset: U32::new(offset) };
        datagram.extend_from_slice(piece.as_bytes());
    }
    datagram.extend_from_slice(part.bytes);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone)]
    struct Owned {
        channel: u16,
        numbers: (u32, u32, u64),
        offset: Option<u16>,
        bytes: Vec<u8>,
    }

    impl Owned {
        fn part(&self) -> Part<'_> {
            let piece =
                self.offset.map(|offset| (u32::from(offset) + self.bytes.len() as u32 + 7, offset.into()));
            let (sequence, source_sequence, source_ns) = self.numbers;
            Part { channel: self.channel, sequence, source_sequence, source_ns, piece, bytes: &self.bytes }
        }
    }

    fn any_part() -> impl Strategy<Value = Owned> {
        let bytes = proptest::collection::vec(any::<u8>(), 1..200);
        (0..CHANNELS, any::<(u32, u32, u64)>(), any::<Option<u16>>(), bytes)
            .prop_map(|(channel, numbers, offset, bytes)| Owned { channel, numbers, offset, bytes })
    }

    proptest! {
        #[test]
        fn parts_come_out_as_they_were_put_in(parts in proptest::collection::vec(any_part(), 0..20)) {
            let mut datagram = Vec::new();
            parts.iter().for_each(|part| put(&mut datagram, &part.part()));
            let found: Result<Vec<_>, _> = Parts(&datagram).collect();
            let expected: Vec<_> = parts.iter().map(Owned::part).collect();
            prop_assert_eq!(found.unwrap(), expected);
        }
    }

    #[test]
    fn a_piece_that_reaches_beyond_its_message_is_malformed() {
        let mut datagram = Vec::new();
        let part =
            |piece| Part { channel: 1, sequence: 0, source_sequence: 0, source_ns: 0, piece, bytes: &[0; 8] };
        put(&mut datagram, &part(Some((15, 8))));
        assert_eq!(Parts(&datagram).next(), Some(Err(Rejection::Malformed)));
        datagram.clear();
        put(&mut datagram, &part(Some((u32::MAX, u32::MAX - 3))));
        assert_eq!(Parts(&datagram).next(), Some(Err(Rejection::Malformed)));
    }

    #[test]
    fn names_of_reasons_stand_at_their_places() {
        for (place, reason) in Rejection::ALL.into_iter().enumerate() {
            assert_eq!(reason as usize, place);
        }
        assert_eq!((Rejection::Key.name(), Rejection::Stranger.name()), ("key", "stranger"));
    }
}
