//! The datagrams of cannelloni, format 2: the same over UDP as many CAN tools speak it.
//!
//! Five bytes of header (version 2, operation 0 for data, sequence, count big endian), then for each frame the identifier with
//! the flags of Linux, the length (with 0x80: FD, and one byte of flags follows), and the data, none of a remote frame.
//! Its numbers wrap at 256 and show gaps; they decide nothing.

use crate::frame::{FD_BYTES, Frame, Kind, REMOTE_FLAG};

/// The port that it uses unless it is told another.
pub const PORT: u16 = 20_000;
/// Nothing longer is sent.
pub const DATAGRAM_BYTES: usize = 1_400;

const VERSION: u8 = 2;
const DATA: u8 = 0;
const HEADER_BYTES: usize = 5;
const FD_LENGTH: u8 = 0x80;
const BRS: u8 = 1;
const ESI: u8 = 2;

/// What came in one datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// Its number.
    pub sequence: u8,
    /// Whether the end was thrown away, because a frame in it was none.
    pub damaged: bool,
}

/// Begins a datagram.
pub fn encode(sequence: u8, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&[VERSION, DATA, sequence, 0, 0]);
}

/// Appends a frame. False: it no longer fits, or it is a controller's report of errors, which no bus carries.
pub fn append(frame: &Frame, out: &mut Vec<u8>) -> bool {
    let needs = 6 + frame.data().len();
    if out.len() + needs > DATAGRAM_BYTES || !frame.is_of_the_bus() {
        return false;
    }
    let count = u16::from_be_bytes([out[3], out[4]]) + 1; // at most 279 fit
    out[3..5].copy_from_slice(&count.to_be_bytes());
    out.extend_from_slice(&frame.word().to_be_bytes());
    let length = frame.length() as u8;
    match frame.kind() {
        Kind::Fd { brs, esi } => {
            let flags = if brs { BRS } else { 0 } | if esi { ESI } else { 0 };
            out.extend_from_slice(&[length | FD_LENGTH, flags]);
        }
        _ => out.push(length),
    }
    out.extend_from_slice(frame.data());
    true
}

/// Reads a datagram; its frames are appended to `frames`. The frames before a damaged one count. `None` if it is no data of
/// this format.
pub fn decode(bytes: &[u8], frames: &mut Vec<Frame>) -> Option<Arrival> {
    let (head, mut rest) = bytes.split_at_checked(HEADER_BYTES)?;
    if head[0] != VERSION || head[1] != DATA {
        return None;
    }
    let count = u16::from_be_bytes([head[3], head[4]]);
    for _ in 0..count {
        match take_frame(&mut rest) {
            Some(frame) => frames.push(frame),
            None => return Some(Arrival { sequence: head[2], damaged: true }),
        }
    }
    Some(Arrival { sequence: head[2], damaged: false })
}

fn take_frame(rest: &mut &[u8]) -> Option<Frame> {
    let (head, after) = rest.split_at_checked(5)?;
    let word = u32::from_be_bytes([head[0], head[1], head[2], head[3]]);
    let (is_fd, length) = (head[4] & FD_LENGTH != 0, usize::from(head[4] & !FD_LENGTH));
    if length > FD_BYTES {
        return None;
    }
    let (flags, after) = after.split_at_checked(usize::from(is_fd))?;
    let (data, after) = after.split_at_checked(if word & REMOTE_FLAG != 0 { 0 } else { length })?;
    *rest = after;
    let fd = flags.first().map(|flags| (flags & BRS != 0, flags & ESI != 0));
    Frame::of_word(word, fd, length, data).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Id, any};
    use proptest::prelude::*;

    fn datagram(sequence: u8, frames: &[Frame]) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(sequence, &mut bytes);
        assert!(frames.iter().all(|frame| append(frame, &mut bytes)));
        bytes
    }

    fn hex(text: &str) -> Vec<u8> {
        (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap()).collect()
    }

    #[test]
    fn vectors_of_the_real_program_are_written_and_read() {
        let count: Vec<u8> = (0..12).collect();
        let fd = Frame::new(Id::Standard(0x321), Kind::Fd { brs: true, esi: false }, &count).unwrap();
        let vectors: [(u8, Vec<Frame>, &str); 5] = [
            (0, vec![Frame::classic(Id::Standard(0x123), &[1, 2, 3])], "02000000010000012303010203"),
            (
                1,
                vec![Frame::classic(Id::Extended(0x1abc_def0), &count[..8])],
                "02000100019abcdef0080001020304050607",
            ),
            (2, vec![Frame::remote(Id::Standard(0x123), 4).unwrap()], "02000200014000012304"),
            (3, vec![fd], "0200030001000003218c01000102030405060708090a0b"),
            (
                255,
                vec![Frame::classic(Id::Standard(0x100), &[0xaa]), Frame::classic(Id::Standard(0x200), &[])],
                "0200ff00020000010001aa0000020000",
            ),
        ];
        for (sequence, frames, bytes) in vectors {
            assert_eq!(datagram(sequence, &frames), hex(bytes));
            let mut read = Vec::new();
            assert_eq!(decode(&hex(bytes), &mut read), Some(Arrival { sequence, damaged: false }));
            assert_eq!(read, frames);
        }
    }

    #[test]
    fn a_length_without_its_data_and_lengths_above_64_are_rejected() {
        let mut frames = Vec::new();
        let short = hex("0200000001000001237f");
        assert_eq!(decode(&short, &mut frames), Some(Arrival { sequence: 0, damaged: true }));
        let mut long = hex("02000000010000012341");
        long.extend([0; 65]);
        assert_eq!(decode(&long, &mut frames), Some(Arrival { sequence: 0, damaged: true }));
        assert!(frames.is_empty());
    }

    #[test]
    fn frames_before_a_damaged_one_count_and_other_versions_do_not() {
        let good = [Frame::classic(Id::Standard(1), &[1]), Frame::classic(Id::Standard(2), &[2])];
        let bytes = datagram(9, &good);
        let mut frames = Vec::new();
        let arrival = decode(&bytes[..bytes.len() - 1], &mut frames);
        assert_eq!(arrival, Some(Arrival { sequence: 9, damaged: true }));
        assert_eq!(frames, good[..1]);
        for (place, value) in [(0, 1), (1, 1), (1, 2)] {
            let mut other = bytes.clone();
            other[place] = value;
            assert_eq!(decode(&other, &mut frames), None);
        }
        assert_eq!(decode(&[2, 0, 0, 0, 0], &mut frames), Some(Arrival { sequence: 0, damaged: false }));
        assert_eq!(frames.len(), 1, "a count of 0 brings nothing");
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(sequence: u8, sent in proptest::collection::vec(any::frame(), 0..18)) {
            let mut read = Vec::new();
            prop_assert_eq!(decode(&datagram(sequence, &sent), &mut read), Some(Arrival { sequence, damaged: false }));
            prop_assert_eq!(read, sent);
        }
    }
}
