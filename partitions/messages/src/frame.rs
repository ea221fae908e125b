//! The seed's serial framing: `$AA data * CS`.
//!
//! `$` opens a frame, two equal letters name it, `*` and one checksum byte close it. A `$` or `*` in the data is
//! doubled. The checksum is the XOR of the bytes between the delimiters before doubling (the letters cancel each
//! other); where it comes out as `*` it is sent as `+`, so that it can not be read as the second half of a
//! doubled star. The checksum does not protect the letters and holds 8 bits: on a lossy link do not trust it alone.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Opens a frame.
const OPEN: u8 = b'$';
/// Closes the data; the checksum follows.
const CLOSE: u8 = b'*';

/// The longest data a decoder collects, bytes. Longer input is noise: it is dropped and counted.
pub const MAX_DATA: usize = 512;

/// The frame called `letter` around `data`, appended to `out`.
pub fn encode(letter: u8, data: &[u8], out: &mut Vec<u8>) {
    out.extend_from_slice(&[OPEN, letter, letter]);
    for &byte in data {
        out.push(byte);
        if byte == OPEN || byte == CLOSE {
            out.push(byte);
        }
    }
    out.extend_from_slice(&[CLOSE, checksum(data)]);
}

/// XOR of the data, never `*`.
pub fn checksum(data: &[u8]) -> u8 {
    match data.iter().fold(0, |sum, byte| sum ^ byte) {
        CLOSE => b'+',
        sum => sum,
    }
}

/// One frame that arrived whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// The letter that stood twice after `$`.
    pub letter: u8,
    /// The data, undoubled.
    pub data: Vec<u8>,
}

/// What a decoder has refused so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Refused {
    /// Frames whose checksum did not fit.
    pub checksum: u64,
    /// Frames whose two letters differed.
    pub letters: u64,
    /// Frames cut short by the next one's start.
    pub cut_short: u64,
    /// Frames longer than [`MAX_DATA`].
    pub too_long: u64,
    /// Bytes outside any frame.
    pub noise_bytes: u64,
}

impl Refused {
    /// Frames refused for any reason.
    pub fn frames(&self) -> u64 {
        self.checksum + self.letters + self.cut_short + self.too_long
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expect {
    Open,
    FirstLetter,
    SecondLetter,
    Data,
    AfterDollar,
    AfterStar,
}

/// Finds frames in a stream of bytes that may start anywhere and hold anything.
#[derive(Debug)]
pub struct Decoder {
    expect: Expect,
    letter: u8,
    data: Vec<u8>,
    refused: Refused,
}

/// A decoder in the middle of a stream as plain data, for whoever goes on in its place. Every bit pattern is one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct DecoderState {
    /// As in [`Refused`], in its order.
    refused: [u64; 5],
    /// Place in [`EXPECTATIONS`].
    expect: u8,
    letter: u8,
    /// Bytes of `data` in use.
    length: u16,
    reserved: u32,
    data: [u8; MAX_DATA],
}

const EXPECTATIONS: [Expect; 6] = [
    Expect::Open,
    Expect::FirstLetter,
    Expect::SecondLetter,
    Expect::Data,
    Expect::AfterDollar,
    Expect::AfterStar,
];

impl Default for Decoder {
    fn default() -> Self {
        Self {
            expect: Expect::Open,
            letter: 0,
            data: Vec::with_capacity(MAX_DATA),
            refused: Refused::default(),
        }
    }
}

impl Decoder {
    /// A decoder that waits for its first `$`.
    pub fn new() -> Self {
        Self::default()
    }

    /// Where it stands.
    pub fn state(&self) -> DecoderState {
        let Refused { checksum, letters, cut_short, too_long, noise_bytes } = self.refused;
        let mut data = [0; MAX_DATA];
        data[..self.data.len()].copy_from_slice(&self.data);
        DecoderState {
            refused: [checksum, letters, cut_short, too_long, noise_bytes],
            expect: EXPECTATIONS.iter().position(|one| *one == self.expect).unwrap_or(0) as u8,
            letter: self.letter,
            length: self.data.len() as u16,
            reserved: 0,
            data,
        }
    }

    /// A decoder that goes on where another stood. One that can not be is where nothing has come yet.
    pub fn resume(state: &DecoderState) -> Self {
        let length = usize::from(state.length);
        let Some(expect) = EXPECTATIONS.get(usize::from(state.expect)) else { return Self::new() };
        let Some(data) = state.data.get(..length) else { return Self::new() };
        let [checksum, letters, cut_short, too_long, noise_bytes] = state.refused;
        let refused = Refused { checksum, letters, cut_short, too_long, noise_bytes };
        let mut decoder = Self { expect: *expect, letter: state.letter, refused, ..Self::new() };
        decoder.data.extend_from_slice(data);
        decoder
    }

    /// What was refused so far.
    pub fn refused(&self) -> Refused {
        self.refused
    }

    /// Takes one byte; gives the frame that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        match self.expect {
            Expect::Open => self.open(byte),
            Expect::FirstLetter => self.first_letter(byte),
            Expect::SecondLetter => self.second_letter(byte),
            Expect::Data => self.data(byte),
            Expect::AfterDollar => self.after_dollar(byte),
            Expect::AfterStar => return self.after_star(byte),
        }
        None
    }

    /// Takes many bytes; gives the frames that they complete.
    pub fn extend<'a>(&'a mut self, bytes: &'a [u8]) -> impl Iterator<Item = Frame> + 'a {
        bytes.iter().filter_map(|&byte| self.push(byte))
    }

    fn open(&mut self, byte: u8) {
        if byte == OPEN {
            self.expect = Expect::FirstLetter;
        } else {
            self.refused.noise_bytes += 1;
        }
    }

    fn first_letter(&mut self, byte: u8) {
        if byte == OPEN {
            // The `$` before was noise or a checksum; this one may open a frame.
            self.refused.noise_bytes += 1;
            return;
        }
        self.letter = byte;
        self.expect = Expect::SecondLetter;
    }

    fn second_letter(&mut self, byte: u8) {
        if byte == self.letter {
            self.data.clear();
            self.expect = Expect::Data;
        } else {
            self.refused.letters += 1;
            self.expect = if byte == OPEN { Expect::FirstLetter } else { Expect::Open };
        }
    }

    fn data(&mut self, byte: u8) {
        match byte {
            OPEN => self.expect = Expect::AfterDollar,
            CLOSE => self.expect = Expect::AfterStar,
            _ => self.keep(byte),
        }
    }

    fn after_dollar(&mut self, byte: u8) {
        if byte == OPEN {
            self.expect = Expect::Data;
            self.keep(byte);
        } else {
            // A single `$` inside data is the start of the next frame: this one lost its end.
            self.refused.cut_short += 1;
            self.expect = Expect::FirstLetter;
            self.first_letter(byte);
        }
    }

    fn after_star(&mut self, byte: u8) -> Option<Frame> {
        if byte == CLOSE {
            self.expect = Expect::Data;
            self.keep(byte);
            return None;
        }
        self.expect = Expect::Open;
        if byte == checksum(&self.data) {
            return Some(Frame { letter: self.letter, data: self.data.clone() });
        }
        self.refused.checksum += 1;
        None
    }

    fn keep(&mut self, byte: u8) {
        if self.data.len() == MAX_DATA {
            self.refused.too_long += 1;
            self.expect = Expect::Open;
        } else {
            self.data.push(byte);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encoded(letter: u8, data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        encode(letter, data, &mut out);
        out
    }

    #[test]
    fn known_vectors_are_written_and_read() {
        let vectors: [(u8, &[u8], &[u8]); 6] = [
            (b'A', &[], &[0x24, 0x41, 0x41, 0x2a, 0x00]),
            (b'G', &[1, 2, 3], &[0x24, 0x47, 0x47, 1, 2, 3, 0x2a, 0x00]),
            (b'I', b"$", &[0x24, 0x49, 0x49, 0x24, 0x24, 0x2a, 0x24]),
            (b'I', b"*", &[0x24, 0x49, 0x49, 0x2a, 0x2a, 0x2a, 0x2b]),
            (b'S', b"$*$", &[0x24, 0x53, 0x53, 0x24, 0x24, 0x2a, 0x2a, 0x24, 0x24, 0x2a, 0x2b]),
            (b'C', &[0x0e, 0x24], &[0x24, 0x43, 0x43, 0x0e, 0x24, 0x24, 0x2a, 0x2b]),
        ];
        for (letter, data, bytes) in vectors {
            assert_eq!(encoded(letter, data), bytes);
            let frames: Vec<_> = Decoder::new().extend(bytes).collect();
            assert_eq!(frames, [Frame { letter, data: data.to_vec() }]);
        }
    }

    #[test]
    fn a_damaged_byte_is_counted_and_the_next_frame_is_read() {
        let mut bytes = encoded(b'G', &[1, 2, 3]);
        bytes[4] ^= 0x10;
        bytes.extend(encoded(b'T', &[9]));
        let mut decoder = Decoder::new();
        let frames: Vec<_> = decoder.extend(&bytes).collect();
        assert_eq!(frames.len(), 1);
        assert_eq!(frames[0].letter, b'T');
        assert_eq!(decoder.refused().checksum, 1);
    }

    #[test]
    fn a_frame_that_never_ends_is_dropped() {
        let mut decoder = Decoder::new();
        let endless = [b"$AA".as_slice(), &[7; 3 * MAX_DATA]].concat();
        assert_eq!(decoder.extend(&endless).count(), 0);
        assert_eq!(decoder.refused().too_long, 1);
        assert_eq!(decoder.extend(&encoded(b'B', &[1])).count(), 1);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(letter in b'A'..=b'Z', data in proptest::collection::vec(any::<u8>(), 0..MAX_DATA)) {
            let frames: Vec<_> = Decoder::new().extend(&encoded(letter, &data)).collect();
            prop_assert_eq!(frames, vec![Frame { letter, data }]);
        }

        #[test]
        fn decoder_that_another_one_takes_over_from_at_any_byte_finds_the_same(
            bytes in proptest::collection::vec(prop_oneof![Just(b'$'), Just(b'*'), Just(b'A'), any::<u8>()], 0..300),
            at in 0_usize..300,
        ) {
            let bytes = [encoded(b'A', b"one"), bytes, encoded(b'B', &[7; 40])].concat();
            let (before, after) = bytes.split_at(at.min(bytes.len()));
            let mut first = Decoder::new();
            let mut frames: Vec<_> = first.extend(before).collect();
            let mut second = Decoder::resume(&first.state());
            frames.extend(second.extend(after));
            let mut only = Decoder::new();
            prop_assert_eq!(frames, only.extend(&bytes).collect::<Vec<_>>());
            prop_assert_eq!(second.refused(), only.refused());
        }

        #[test]
        fn noise_costs_at_most_one_good_frame(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut decoder = Decoder::new();
            let _ = decoder.extend(&noise).count();
            let good = encoded(b'Q', &[1, 2, 3]);
            let heard = (0..3).filter(|_| decoder.extend(&good).any(|frame| frame.letter == b'Q')).count();
            prop_assert!(heard >= 2);
        }
    }
}
