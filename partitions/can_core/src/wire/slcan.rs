//! The text that serial CAN adapters speak (LAWICEL): one command a line, ended by a carriage return.
//!
//! `t1232AABB` standard, `T000001232AABB` extended, `r1234` and `R…` remote; `d`, `D` FD and `b`, `B` FD with bit-rate switch, with one
//! hexadecimal digit for the length code. `O` opens, `C` closes, `S0` to `S8` set the bit rate, `V`, `N`, `F` ask. An adapter answers
//! with a carriage return, or with a bell where it refuses.

use crate::frame::{Frame, Id, Kind};

/// Longest line that is collected, bytes: an extended FD frame with 64 bytes has 138, a time stamp 4 more.
pub const LINE_BYTES: usize = 160;
/// Ends a line; alone, the adapter's "done".
pub const DONE: u8 = b'\r';
/// The adapter's "no".
pub const BELL: u8 = 7;

/// Bytes of each length code of an FD frame.
const FD_LENGTHS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// The command for each bit rate that the protocol has a number for, bit/s.
pub const BIT_RATES: [(u32, u8); 9] = [
    (10_000, b'0'),
    (20_000, b'1'),
    (50_000, b'2'),
    (100_000, b'3'),
    (125_000, b'4'),
    (250_000, b'5'),
    (500_000, b'6'),
    (800_000, b'7'),
    (1_000_000, b'8'),
];

/// A line, understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line {
    /// A frame.
    Frame(Frame),
    /// An empty line: the adapter has done what it was told. `z` and `Z` say it of a frame.
    Done,
    /// A bell.
    Refused,
    /// Any other command, by its letter and the first character after it.
    Command(u8, Option<u8>),
}

/// What was wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A frame that can not be read.
    #[error("a line begins as a frame and is none")]
    NoFrame,
    /// A line without end.
    #[error("a line is longer than {LINE_BYTES} characters")]
    TooLong,
}

/// Finds lines in a stream that may start anywhere.
#[derive(Debug, Default)]
pub struct Decoder {
    line: Vec<u8>,
    overlong: bool,
}

impl Decoder {
    /// One that has read nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a byte; gives what it completes.
    pub fn push(&mut self, byte: u8) -> Option<Result<Line, Refusal>> {
        match byte {
            DONE => {
                let result = if std::mem::take(&mut self.overlong) {
                    Err(Refusal::TooLong)
                } else {
                    parse(&self.line)
                };
                self.line.clear();
                Some(result)
            }
            // An adapter's refusal is not ended by anything.
            BELL if self.line.is_empty() => Some(Ok(Line::Refused)),
            b'\n' => None,
            _ if self.line.len() >= LINE_BYTES => {
                self.overlong = true;
                None
            }
            _ => {
                self.line.push(byte);
                None
            }
        }
    }
}

fn parse(line: &[u8]) -> Result<Line, Refusal> {
    let Some((&letter, rest)) = line.split_first() else { return Ok(Line::Done) };
    match letter {
        b't' | b'T' | b'r' | b'R' | b'd' | b'D' | b'b' | b'B' => {
            frame(letter, rest).map(Line::Frame).ok_or(Refusal::NoFrame)
        }
        b'z' | b'Z' if rest.is_empty() => Ok(Line::Done),
        _ => Ok(Line::Command(letter, rest.first().copied())),
    }
}

fn frame(letter: u8, rest: &[u8]) -> Option<Frame> {
    let (digits, after) = rest.split_at_checked(if letter.is_ascii_uppercase() { 8 } else { 3 })?;
    let number = number(digits)?;
    let id = if letter.is_ascii_uppercase() { Id::extended(number)? } else { Id::standard(number)? };
    let (code, after) = after.split_first()?;
    let code = nibble(*code)?;
    let kind = match letter.to_ascii_lowercase() {
        b'r' if code <= 8 => return Frame::remote(id, code.into()).ok().filter(|_| is_end(after)),
        b't' if code <= 8 => Kind::Data,
        b'd' => Kind::Fd { brs: false, esi: false },
        b'b' => Kind::Fd { brs: true, esi: false },
        _ => return None,
    };
    let length = FD_LENGTHS[usize::from(code)];
    let (data, after) = after.split_at_checked(2 * length)?;
    let mut bytes = [0; 64];
    for (byte, pair) in bytes.iter_mut().zip(data.chunks_exact(2)) {
        *byte = nibble(pair[0])? << 4 | nibble(pair[1])?;
    }
    Frame::new(id, kind, &bytes[..length]).ok().filter(|_| is_end(after))
}

/// Nothing, or a time stamp of four digits, which some adapters add.
fn is_end(rest: &[u8]) -> bool {
    rest.is_empty() || (rest.len() == 4 && number(rest).is_some())
}

fn number(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |number: u32, &digit| Some(number << 4 | u32::from(nibble(digit)?)))
}

fn nibble(digit: u8) -> Option<u8> {
    char::from(digit).to_digit(16).map(|value| value as u8)
}

/// Appends the line of a frame. False: the protocol has no line for it (a report of errors).
pub fn encode(frame: &Frame, out: &mut Vec<u8>) -> bool {
    let letter = match frame.kind() {
        Kind::Data => b't',
        Kind::Remote => b'r',
        Kind::Fd { brs: false, .. } => b'd',
        Kind::Fd { brs: true, .. } => b'b',
        Kind::Error => return false,
    };
    let (letter, digits) = match frame.id() {
        Id::Standard(_) => (letter, 3),
        Id::Extended(_) => (letter.to_ascii_uppercase(), 8),
    };
    let Some(code) = FD_LENGTHS.iter().position(|length| *length == frame.length()) else { return false };
    let number = frame.id().number();
    out.push(letter);
    out.extend((0..digits).rev().map(|digit| hex_digit((number >> (4 * digit)) as u8)));
    out.push(hex_digit(code as u8));
    frame.data().iter().for_each(|byte| out.extend([hex_digit(byte >> 4), hex_digit(*byte)]));
    out.push(DONE);
    true
}

fn hex_digit(value: u8) -> u8 {
    b"0123456789ABCDEF"[usize::from(value & 0xf)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::any;
    use proptest::prelude::*;

    fn lines(text: &[u8]) -> Vec<Result<Line, Refusal>> {
        let mut decoder = Decoder::new();
        text.iter().filter_map(|byte| decoder.push(*byte)).collect()
    }

    #[test]
    fn lines_of_real_adapters_are_read() {
        let said = lines(b"t1232AABB\rT1ABCDEF01ff\rr1234\rt12310A1B2C\r\rz\r\x07V1013\rS6\rO\rb32190001020304050607080910AB\r");
        let frame = |frame| Ok(Line::Frame(frame));
        let twelve = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0x10, 0xab];
        assert_eq!(
            said,
            [
                frame(Frame::classic(Id::Standard(0x123), &[0xaa, 0xbb])),
                frame(Frame::classic(Id::Extended(0x1abc_def0), &[0xff])),
                frame(Frame::remote(Id::Standard(0x123), 4).unwrap()),
                frame(Frame::classic(Id::Standard(0x123), &[0x0a])), // with a time stamp
                Ok(Line::Done),
                Ok(Line::Done),
                Ok(Line::Refused),
                Ok(Line::Command(b'V', Some(b'1'))),
                Ok(Line::Command(b'S', Some(b'6'))),
                Ok(Line::Command(b'O', None)),
                frame(Frame::new(Id::Standard(0x321), Kind::Fd { brs: true, esi: false }, &twelve).unwrap()),
            ]
        );
    }

    #[test]
    fn what_is_no_frame_is_refused_and_the_next_line_is_read() {
        for bad in
            ["t12", "t1239AA", "t8001AA", "T200000001AA", "t1232AAB", "t1232AABBC", "r1239", "tXYZ0", "dG"]
        {
            let said = lines(format!("{bad}\rt1230\r").as_bytes());
            let good = Line::Frame(Frame::classic(Id::Standard(0x123), &[]));
            assert_eq!(said, [Err(Refusal::NoFrame), Ok(good)], "{bad}");
        }
        let endless = [b"t".repeat(500), b"\rt1230\r".to_vec()].concat();
        assert_eq!(lines(&endless)[0], Err(Refusal::TooLong));
        assert!(matches!(lines(&endless)[1], Ok(Line::Frame(_))));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(frame in any::frame()) {
            let mut text = Vec::new();
            prop_assert!(encode(&frame, &mut text));
            let expected = match frame.kind() {
                // The protocol has no place for the error state.
                Kind::Fd { brs, .. } => Frame::new(frame.id(), Kind::Fd { brs, esi: false }, frame.data()).unwrap(),
                _ => frame,
            };
            prop_assert_eq!(lines(&text), [Ok(Line::Frame(expected))]);
        }
    }
}
