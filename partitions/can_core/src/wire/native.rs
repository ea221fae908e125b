//! The gateway's own datagrams.
//!
//! ```text
//! offset  size  what                                                        (numbers: big endian)
//!      0     8  prefix "BTLR-CAN"
//!      8     1  version: 2
//!      9     1  kind: 1 frames, 2 discover, 3 alive, 4 leaving
//!     10     2  frames in this datagram; 0 unless kind 1
//!     12     8  identity of the sender: the same for as long as it is the same gateway
//!     20     4  session of the sender: another one with each start
//!     24     4  number of this datagram among those of kind 1; of other kinds, the number that the next one will have
//!     28     4  number of the first frame among all frames sent; of other kinds, of the next one
//!     32     8  cookie: what the sender made of the address that this goes to, and wants back from there; 0: it goes to everybody
//!     40     8  echo: the cookie that the receiver sent last; 0: none has come
//!     48     …  frames, one after the other:
//!               4  identifier, with the flags of Linux: extended 0x80000000, remote 0x40000000, error 0x20000000
//!               1  flags: FD 1, bit-rate switch 2, error state indicator 4
//!               1  length in bytes, 0 to 64; of a remote frame, what it asks for
//!               2  age when it was sent, in steps of 100 µs; 65535: that or more
//!               …  as many data bytes as the length says; none of a remote frame
//! ```
//!
//! Version 1 had neither cookie nor echo: anybody could have frames sent to any address. Gateways of the two versions refuse each
//! other's datagrams, and say so. Numbers start at 0 with a session and wrap. A datagram with one flaw is refused as a whole: nothing of it is believed.

use crate::frame::{FD_BYTES, Frame, FrameError, Kind};

/// What every datagram of ours begins with.
pub const PREFIX: [u8; 8] = *b"BTLR-CAN";
/// The version of this layout.
pub const VERSION: u8 = 2;
/// The port that gateways listen at unless they are told another.
pub const PORT: u16 = 15_210;
/// Bytes before the first frame.
pub const HEADER_BYTES: usize = 48;
/// Where the cookie begins; the echo follows it.
const COOKIE_AT: usize = 32;
/// Bytes of a frame beside its data.
pub const FRAME_BYTES: usize = 8;
/// Nothing longer is sent: it passes an Ethernet without being cut in pieces.
pub const DATAGRAM_BYTES: usize = 1_400;
/// One step of a frame's age, ns.
pub const AGE_STEP_NS: u64 = 100_000;

const FD: u8 = 1;
const BRS: u8 = 2;
const ESI: u8 = 4;

/// What a datagram is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Frames of a bus.
    Frames = 1,
    /// Who is there? To everybody; and to one that has not shown yet that it gets what is sent to its address.
    Discover = 2,
    /// I am here, and want your frames: the answer to that, and repeated for as long as it is so.
    Alive = 3,
    /// I go: send no more.
    Leaving = 4,
}

impl Purpose {
    fn of(number: u8) -> Option<Self> {
        let all = [Self::Frames, Self::Discover, Self::Alive, Self::Leaving];
        all.into_iter().find(|purpose| *purpose as u8 == number)
    }
}

/// The first part of every datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// What for.
    pub purpose: Purpose,
    /// Who sends.
    pub identity: u64,
    /// Since which start of his.
    pub session: u32,
    /// Number of the datagram.
    pub sequence: u32,
    /// Number of its first frame.
    pub first_frame: u32,
    /// What the sender wants back from the address to which it sends.
    pub cookie: u64,
    /// What came from there last.
    pub echo: u64,
}

/// A frame with the time that it has been on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Aged {
    /// The frame.
    pub frame: Frame,
    /// Its age when it was sent, ns, rounded down to [`AGE_STEP_NS`].
    pub age_ns: u64,
}

/// Why a datagram is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It does not begin as ours do.
    #[error("it is none of a gateway's: it does not begin with \"BTLR-CAN\"")]
    Foreign,
    /// Another version of this layout.
    #[error("it is of version {0}, this gateway speaks version {VERSION}: bring both to one release")]
    Version(u8),
    /// A kind that there is not.
    #[error("there is no kind {0} of datagram")]
    Purpose(u8),
    /// It ends too soon, or too late.
    #[error("it is cut short, or something follows its last frame")]
    Length,
    /// A frame that can not be.
    #[error("frame {place}: {error}")]
    Frame {
        /// Its place, from 0.
        place: u16,
        /// What is wrong with it.
        error: FrameError,
    },
}

/// Writes a datagram without frames.
pub fn encode(header: &Header, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&PREFIX);
    out.extend_from_slice(&[VERSION, header.purpose as u8, 0, 0]);
    out.extend_from_slice(&header.identity.to_be_bytes());
    out.extend_from_slice(&header.session.to_be_bytes());
    out.extend_from_slice(&header.sequence.to_be_bytes());
    out.extend_from_slice(&header.first_frame.to_be_bytes());
    out.extend_from_slice(&header.cookie.to_be_bytes());
    out.extend_from_slice(&header.echo.to_be_bytes());
}

/// Gives a datagram that [`encode`] began another cookie and echo: the same goes to several.
pub fn address_to(out: &mut [u8], cookie: u64, echo: u64) {
    out[COOKIE_AT..COOKIE_AT + 8].copy_from_slice(&cookie.to_be_bytes());
    out[COOKIE_AT + 8..HEADER_BYTES].copy_from_slice(&echo.to_be_bytes());
}

/// Appends a frame to a datagram that [`encode`] began. False: it no longer fits.
pub fn append(aged: &Aged, out: &mut Vec<u8>) -> bool {
    let Aged { frame, age_ns } = aged;
    if out.len() + size(frame) > DATAGRAM_BYTES {
        return false;
    }
    let count = u16::from_be_bytes([out[10], out[11]]) + 1; // at most 169 fit
    out[10..12].copy_from_slice(&count.to_be_bytes());
    let flags = match frame.kind() {
        Kind::Fd { brs, esi } => FD | if brs { BRS } else { 0 } | if esi { ESI } else { 0 },
        _ => 0,
    };
    let age = u16::try_from(age_ns / AGE_STEP_NS).unwrap_or(u16::MAX);
    out.extend_from_slice(&frame.word().to_be_bytes());
    out.extend_from_slice(&[flags, frame.length() as u8]);
    out.extend_from_slice(&age.to_be_bytes());
    out.extend_from_slice(frame.data());
    true
}

/// Bytes that a frame needs.
pub fn size(frame: &Frame) -> usize {
    FRAME_BYTES + frame.data().len()
}

/// Reads a datagram; its frames are appended to `frames`, all or none.
///
/// # Errors
/// Why nothing of it is believed.
pub fn decode(bytes: &[u8], frames: &mut Vec<Aged>) -> Result<Header, Refusal> {
    if bytes.len() < PREFIX.len() || bytes[..PREFIX.len()] != PREFIX {
        return Err(Refusal::Foreign);
    }
    // Another version may have another length.
    if let Some(version) = bytes.get(PREFIX.len()).filter(|version| **version != VERSION) {
        return Err(Refusal::Version(*version));
    }
    let (head, mut rest) = bytes.split_at_checked(HEADER_BYTES).ok_or(Refusal::Length)?;
    let purpose = Purpose::of(head[9]).ok_or(Refusal::Purpose(head[9]))?;
    let count = u16::from_be_bytes([head[10], head[11]]);
    if (purpose != Purpose::Frames && count != 0) || bytes.len() > DATAGRAM_BYTES {
        return Err(Refusal::Length);
    }
    let word = |at: usize| u32::from_be_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let long = |at: usize| u64::from(word(at)) << 32 | u64::from(word(at + 4));
    let begun = frames.len();
    for place in 0..count {
        match take_frame(&mut rest) {
            Some(Ok(aged)) => frames.push(aged),
            Some(Err(error)) => {
                frames.truncate(begun);
                return Err(Refusal::Frame { place, error });
            }
            None => {
                frames.truncate(begun);
                return Err(Refusal::Length);
            }
        }
    }
    if !rest.is_empty() {
        frames.truncate(begun);
        return Err(Refusal::Length);
    }
    Ok(Header {
        purpose,
        identity: long(12),
        session: word(20),
        sequence: word(24),
        first_frame: word(28),
        cookie: long(COOKIE_AT),
        echo: long(COOKIE_AT + 8),
    })
}

/// The next frame of `rest`; `None` if it ends before.
fn take_frame(rest: &mut &[u8]) -> Option<Result<Aged, FrameError>> {
    let (head, after) = rest.split_at_checked(FRAME_BYTES)?;
    let word = u32::from_be_bytes([head[0], head[1], head[2], head[3]]);
    let (flags, length) = (head[4], usize::from(head[5]));
    let age_ns = u64::from(u16::from_be_bytes([head[6], head[7]])) * AGE_STEP_NS;
    if flags & !(FD | BRS | ESI) != 0 || (flags & FD == 0 && flags != 0) {
        return Some(Err(FrameError::Flags(flags.into())));
    }
    if length > FD_BYTES {
        return Some(Err(FrameError::Length(length)));
    }
    let is_remote = word & crate::frame::REMOTE_FLAG != 0;
    let (data, after) = after.split_at_checked(if is_remote { 0 } else { length })?;
    *rest = after;
    let fd = (flags & FD != 0).then_some((flags & BRS != 0, flags & ESI != 0));
    Some(Frame::of_word(word, fd, length, data).map(|frame| Aged { frame, age_ns }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Id, any};
    use proptest::prelude::*;

    fn header(purpose: Purpose) -> Header {
        Header {
            purpose,
            identity: 0x0102_0304_0506_0708,
            session: 0x1112_1314,
            sequence: 7,
            first_frame: 300,
            cookie: 0x2122_2324_2526_2728,
            echo: 0x3132_3334_3536_3738,
        }
    }

    fn datagram(frames: &[Aged]) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(&header(Purpose::Frames), &mut bytes);
        assert!(frames.iter().all(|aged| append(aged, &mut bytes)));
        bytes
    }

    #[test]
    fn the_bytes_are_those_of_the_book() {
        let aged = Aged { frame: Frame::classic(Id::Extended(0x1ab_cdef), &[0xaa, 0xbb]), age_ns: 1_250_000 };
        let expected =
            b"BTLR-CAN\x02\x01\0\x01\x01\x02\x03\x04\x05\x06\x07\x08\x11\x12\x13\x14\0\0\0\x07\0\0\x01\x2c\
                         \x21\x22\x23\x24\x25\x26\x27\x28\x31\x32\x33\x34\x35\x36\x37\x38\
                         \x81\xab\xcd\xef\0\x02\0\x0c\xaa\xbb";
        assert_eq!(datagram(&[aged]), expected);
        let mut discover = Vec::new();
        encode(&header(Purpose::Discover), &mut discover);
        assert_eq!(discover.len(), HEADER_BYTES);
        address_to(&mut discover, 5, 6);
        let other = Header { cookie: 5, echo: 6, ..header(Purpose::Discover) };
        assert_eq!(decode(&discover, &mut Vec::new()), Ok(other));
    }

    #[test]
    fn what_is_not_sound_is_refused_as_a_whole_with_its_reason() {
        let frame = Frame::classic(Id::Standard(1), &[1, 2]);
        let good = datagram(&[Aged { frame, age_ns: 0 }; 3]);
        let refused = |change: &dyn Fn(&mut Vec<u8>)| {
            let (mut bytes, mut frames) = (good.clone(), Vec::new());
            change(&mut bytes);
            let refusal = decode(&bytes, &mut frames).unwrap_err();
            assert!(frames.is_empty());
            refusal
        };
        assert_eq!(refused(&|bytes| bytes[0] = b'b'), Refusal::Foreign);
        assert_eq!(refused(&|bytes| bytes.truncate(5)), Refusal::Foreign);
        assert_eq!(refused(&|bytes| bytes.truncate(20)), Refusal::Length);
        assert_eq!(refused(&|bytes| bytes[8] = 9), Refusal::Version(9));
        assert_eq!(refused(&|bytes| bytes[9] = 0), Refusal::Purpose(0));
        assert_eq!(refused(&|bytes| bytes[9] = 2), Refusal::Length);
        assert_eq!(refused(&|bytes| bytes[11] = 4), Refusal::Length);
        assert_eq!(refused(&|bytes| bytes[11] = 2), Refusal::Length);
        let third = HEADER_BYTES + 2 * 10;
        assert_eq!(
            refused(&|bytes| bytes[third + 5] = 65),
            Refusal::Frame { place: 2, error: FrameError::Length(65) }
        );
        assert_eq!(
            refused(&|bytes| bytes[third + 4] = BRS),
            Refusal::Frame { place: 2, error: FrameError::Flags(2) }
        );
        assert_eq!(
            refused(&|bytes| bytes[third + 2] = 0x08),
            Refusal::Frame { place: 2, error: FrameError::Id(0x801) }
        );
    }

    #[test]
    fn a_datagram_is_full_before_it_would_be_cut_in_pieces() {
        let aged = Aged { frame: Frame::classic(Id::Standard(1), &[0; 8]), age_ns: 0 };
        let mut bytes = Vec::new();
        encode(&header(Purpose::Frames), &mut bytes);
        let fitted = (0..200).take_while(|_| append(&aged, &mut bytes)).count();
        assert_eq!((fitted, bytes.len()), (84, HEADER_BYTES + 84 * 16));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(frames in proptest::collection::vec((any::frame(), 0_u64..20_000), 0..18)) {
            let frames: Vec<Aged> = frames.into_iter().map(|(frame, steps)| Aged { frame, age_ns: steps * AGE_STEP_NS }).collect();
            let mut read = Vec::new();
            prop_assert_eq!(decode(&datagram(&frames), &mut read), Ok(header(Purpose::Frames)));
            prop_assert_eq!(read, frames);
        }
    }
}
