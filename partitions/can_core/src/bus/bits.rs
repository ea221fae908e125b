//! How long a frame is on the wire, bit by bit (ISO 11898-1): with its stuff bits, from its start to the end of the pause after it.

use crate::frame::{Frame, Id, Kind};

/// Bits of a second at each rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rates {
    /// Arbitration, and all of a classic frame, bit/s.
    pub nominal: u32,
    /// Data of an FD frame with bit-rate switch, bit/s.
    pub data: u32,
}

impl Rates {
    /// One rate for everything.
    pub const fn classic(nominal: u32) -> Self {
        Self { nominal, data: nominal }
    }
}

/// Bits of an error: flag, the others' flags over it at their longest, delimiter, pause.
pub const ERROR_BITS: u64 = 6 + 6 + 8 + 3;
/// Delimiter of the checksum, acknowledgement and its delimiter, end of frame, pause: none of them is stuffed.
const TAIL_BITS: u64 = 1 + 1 + 1 + 7 + 3;
/// The same after an FD frame's data, at the nominal rate; its delimiter goes at the data's.
const FD_TAIL_BITS: u64 = 1 + 1 + 7 + 3;
/// Generator of the checksum of classic frames.
const CRC15: u16 = 0x4599;

/// Bits of a frame on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bits {
    /// At the nominal rate.
    pub nominal: u64,
    /// At the data's rate.
    pub data: u64,
}

impl Bits {
    /// How long they take, ns.
    pub fn duration_ns(self, rates: Rates) -> u64 {
        let at = |bits: u64, rate: u32| (bits * 1_000_000_000).div_ceil(u64::from(rate.max(1)));
        at(self.nominal, rates.nominal) + at(self.data, rates.data)
    }
}

/// Counts bits as they are sent, and puts one in after five equal ones.
#[derive(Debug, Default)]
struct Stuffer {
    crc: u16,
    run: u32,
    last: bool,
    bits: u64,
}

impl Stuffer {
    /// The value's last `count` bits, the first one first.
    fn push(&mut self, value: u32, count: u32) {
        for place in (0..count).rev() {
            self.bit(value >> place & 1 != 0);
        }
    }

    fn bit(&mut self, bit: bool) {
        let carry = bit != (self.crc & 0x4000 != 0);
        self.crc = (self.crc << 1) & 0x7fff;
        if carry {
            self.crc ^= CRC15;
        }
        self.stuff(bit);
    }

    fn stuff(&mut self, bit: bool) {
        self.bits += 1;
        self.run = if self.bits > 1 && bit == self.last { self.run + 1 } else { 1 };
        self.last = bit;
        if self.run == 5 {
            // The stuff bit is the other one, and counts for the next five.
            self.bits += 1;
            self.last = !bit;
            self.run = 1;
        }
    }
}

/// The bits of `frame` on the wire. What a controller reports of errors has none.
pub fn bits(frame: &Frame) -> Bits {
    match frame.kind() {
        Kind::Data | Kind::Remote => Bits { nominal: classic(frame), data: 0 },
        Kind::Fd { brs, esi } => fd(frame, brs, esi),
        Kind::Error => Bits { nominal: 0, data: 0 },
    }
}

fn classic(frame: &Frame) -> u64 {
    let mut wire = Stuffer::default();
    let remote = u32::from(frame.kind() == Kind::Remote);
    wire.push(0, 1); // start of frame
    match frame.id() {
        // Identifier, remote bit, extension bit, reserved bit.
        Id::Standard(id) => {
            wire.push(id.into(), 11);
            wire.push(remote << 2, 3);
        }
        // First part, substitute and extension bit, second part, remote bit, two reserved ones.
        Id::Extended(id) => {
            wire.push(id >> 18, 11);
            wire.push(0b11, 2);
            wire.push(id, 18);
            wire.push(remote << 2, 3);
        }
    }
    wire.push(frame.length() as u32, 4);
    frame.data().iter().for_each(|byte| wire.push((*byte).into(), 8));
    let crc = wire.crc;
    (0..15).rev().for_each(|place| wire.stuff(crc >> place & 1 != 0));
    wire.bits + TAIL_BITS
}

fn fd(frame: &Frame, brs: bool, esi: bool) -> Bits {
    let mut wire = Stuffer::default();
    wire.push(0, 1); // start of frame
    // Then identifier, reserved, format and again reserved bit, bit-rate switch.
    match frame.id() {
        Id::Standard(id) => {
            wire.push(id.into(), 11);
            wire.push(0b00100 | u32::from(brs), 5);
        }
        Id::Extended(id) => {
            wire.push(id >> 18, 11);
            wire.push(0b11, 2);
            wire.push(id, 18);
            wire.push(0b0100 | u32::from(brs), 4);
        }
    }
    let arbitration = wire.bits;
    wire.push(esi.into(), 1);
    wire.push(length_code(frame.length()), 4);
    frame.data().iter().for_each(|byte| wire.push((*byte).into(), 8));
    // Count of stuff bits and checksum have stuff bits at fixed places: one before, one after each four bits.
    let check = 4 + if frame.length() <= 16 { 17 } else { 21 };
    let data = wire.bits - arbitration + check + 1 + check / 4 + 1; // and the delimiter
    match brs {
        true => Bits { nominal: arbitration + FD_TAIL_BITS, data },
        false => Bits { nominal: arbitration + data + FD_TAIL_BITS, data: 0 },
    }
}

fn length_code(length: usize) -> u32 {
    match length {
        0..=8 => length as u32,
        9..=24 => 9 + (length as u32 - 12) / 4,
        32 => 13,
        48 => 14,
        _ => 15,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::any;
    use proptest::prelude::*;

    #[test]
    fn lengths_are_those_of_the_standard() {
        // Without stuff bits 47 bits and the data, with the pause; with them at most 135 (Davis et al. 2007).
        for data in [[0x55; 8], [0; 8], [0xff; 8], [0x3c; 8]] {
            let frame = Frame::classic(Id::Standard(0x078), &data);
            let bits = bits(&frame).nominal;
            assert_eq!(bits, 47 + 64 + stuffed_by_hand(&frame));
            assert!(bits <= 135);
        }
    }

    /// Stuff bits, counted in a text of the frame's bits.
    fn stuffed_by_hand(frame: &Frame) -> u64 {
        let Id::Standard(id) = frame.id() else { panic!() };
        let mut text = format!("0{id:011b}000{:04b}", frame.length());
        frame.data().iter().for_each(|byte| text += &format!("{byte:08b}"));
        let crc = text.bytes().fold(0_u16, |crc, bit| {
            let next = (crc << 1) & 0x7fff;
            if (crc >> 14 & 1) ^ u16::from(bit - b'0') == 1 { next ^ 0x4599 } else { next }
        });
        text += &format!("{crc:015b}");
        let (mut stuffed, mut last, mut run) = (0, b'x', 0);
        for bit in text.bytes() {
            run = if bit == last { run + 1 } else { 1 };
            last = bit;
            if run == 5 {
                (stuffed, last, run) = (stuffed + 1, if bit == b'0' { b'1' } else { b'0' }, 1);
            }
        }
        stuffed
    }

    #[test]
    fn an_fd_frame_is_quicker_where_its_data_go_at_the_second_rate() {
        let frame = |brs| Frame::new(Id::Standard(0x123), Kind::Fd { brs, esi: false }, &[0x55; 64]).unwrap();
        let (slow, fast) = (bits(&frame(false)), bits(&frame(true)));
        assert_eq!(slow.data, 0);
        assert!(fast.data > 512 + 25 && fast.nominal < 40, "{fast:?}");
        let rates = Rates { nominal: 1_000_000, data: 5_000_000 };
        assert!(4 * fast.duration_ns(rates) < slow.duration_ns(rates) + 150_000);
        assert_eq!(Bits { nominal: 8, data: 10 }.duration_ns(rates), 10_000);
    }

    proptest! {
        #[test]
        fn no_classic_frame_is_shorter_than_without_stuff_bits_or_longer_than_the_worst_case(frame in any::classic()) {
            let bits = bits(&frame).nominal;
            let (fixed, stuffable) = match frame.id() { Id::Standard(_) => (47, 34), Id::Extended(_) => (67, 54) };
            let data = 8 * frame.data().len() as u64;
            prop_assert!((fixed + data..=fixed + data + (stuffable + data - 1) / 4).contains(&bits), "{}", bits);
            if let Id::Standard(_) = frame.id() && frame.kind() == Kind::Data {
                prop_assert_eq!(bits, 47 + data + stuffed_by_hand(&frame));
            }
        }
    }
}
