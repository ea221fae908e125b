//! Bytes of the receiver → its solutions and answers.

use bateleur_messages::RawGps;
use ublox::UbxPacket;
use ublox::nav_pvt::common::NavPvtFlags;
use ublox::proto23::{PacketRef, Proto23};
use ublox::{FixedBuffer, Parser, ParserBuilder};

use crate::Epoch;

/// Longest packet that is waited for, bytes: noise that looks like the head of a longer one must not hide the solutions of
/// seconds. Those with a line for each satellite have some hundred.
const LONGEST: usize = 1024;
/// Satellite navigation with height.
const THREE_DIMENSIONS: u32 = 3;

/// What came so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Solutions.
    pub solutions: u64,
    /// Packets whose check sum or length was wrong.
    pub damaged: u64,
    /// Other packets.
    pub others: u64,
}

/// Something that the receiver said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Heard {
    /// Where it is, with or without a fix.
    Solution(RawGps),
    /// Yes or no to an order of that class and number.
    Answer {
        /// Class of the order.
        class: u8,
        /// Its number.
        number: u8,
        /// Yes.
        granted: bool,
    },
}

/// Takes bytes as they come, in pieces of any size; NMEA sentences and noise between packets are passed over.
pub struct Decoder {
    parser: Parser<FixedBuffer<LONGEST>, Proto23>,
    epoch: Epoch,
    counters: Counters,
}

impl Decoder {
    /// At the beginning of a stream.
    #[must_use]
    pub fn new(epoch: Epoch) -> Self {
        let parser = ParserBuilder::new().with_protocol::<Proto23>().with_fixed_buffer();
        Self { parser, epoch, counters: Counters::default() }
    }

    /// What the bytes say that came by `now_ns`, module time.
    pub fn take(&mut self, bytes: &[u8], now_ns: u64) -> Vec<Heard> {
        let mut heard = Vec::new();
        let mut packets = self.parser.consume_ubx(bytes);
        while let Some(packet) = packets.next() {
            match packet {
                Ok(UbxPacket::Proto23(PacketRef::NavPvt(solution))) => {
                    self.counters.solutions += 1;
                    let believed = solution.flags().contains(NavPvtFlags::GPS_FIX_OK);
                    heard.push(Heard::Solution(RawGps {
                        measured_ns: self.epoch.measured_ns(solution.itow(), now_ns),
                        latitude_rad: solution.latitude().to_radians(),
                        longitude_rad: solution.longitude().to_radians(),
                        altitude_m: solution.height_msl(),
                        velocity_ned_mps: [solution.vel_north(), solution.vel_east(), solution.vel_down()],
                        horizontal_accuracy_m: solution.horizontal_accuracy(),
                        vertical_accuracy_m: solution.vertical_accuracy(),
                        speed_accuracy_mps: solution.speed_accuracy(),
                        satellites: u32::from(solution.num_satellites()),
                        fix: if believed { fix(solution.fix_type_raw()) } else { 0 },
                    }));
                }
                Ok(UbxPacket::Proto23(PacketRef::AckAck(answer))) => heard.push(Heard::Answer {
                    class: answer.class(),
                    number: answer.msg_id(),
                    granted: true,
                }),
                Ok(UbxPacket::Proto23(PacketRef::AckNak(answer))) => heard.push(Heard::Answer {
                    class: answer.class(),
                    number: answer.msg_id(),
                    granted: false,
                }),
                Ok(_) => self.counters.others += 1,
                Err(_) => self.counters.damaged += 1,
            }
        }
        heard
    }

    /// What came so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.counters
    }
}

/// Kind of the fix in the words of [`RawGps::fix`]: dimensions, 0 without one. Dead reckoning alone is none; with satellites it has height.
fn fix(receivers: u8) -> u32 {
    match receivers {
        2 => 2,
        3 | 4 => THREE_DIMENSIONS,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(class: u8, number: u8, payload: &[u8]) -> Vec<u8> {
        let mut body = vec![class, number];
        body.extend((payload.len() as u16).to_le_bytes());
        body.extend(payload);
        // Fletcher's sum of 8 bits (UBX-13003221, 32.4).
        let (a, b) = body.iter().fold((0_u8, 0_u8), |(a, b), byte| {
            let a = a.wrapping_add(*byte);
            (a, b.wrapping_add(a))
        });
        [vec![0xb5, 0x62], body, vec![a, b]].concat()
    }

    fn solution(fix_type: u8, flags: u8) -> Vec<u8> {
        let mut payload = [0_u8; 92];
        payload[0..4].copy_from_slice(&(345_600_200_u32).to_le_bytes());
        (payload[20], payload[21], payload[23]) = (fix_type, flags, 11);
        let mut put = |at: usize, value: i32| payload[at..at + 4].copy_from_slice(&value.to_le_bytes());
        put(24, 187_402_978); // longitude, 1e-7 degrees
        put(28, -340_466_050);
        put(36, 160_250); // above mean sea level, mm
        put(40, 1_500);
        put(44, 2_500);
        put(48, 21_900); // north, mm/s
        put(52, -400);
        put(56, 120);
        put(68, 150);
        packet(0x01, 0x07, &payload)
    }

    fn decoder() -> Decoder {
        Decoder::new(Epoch::new(0))
    }

    #[test]
    fn solution_arrives_in_si_units_at_the_module_time_of_its_last_byte() {
        let heard = decoder().take(&solution(3, 1), 5_000_000_000);
        let [Heard::Solution(raw)] = heard[..] else { panic!("{heard:?}") };
        assert!((raw.latitude_rad.to_degrees() + 34.046605).abs() < 1e-9);
        assert!((raw.longitude_rad.to_degrees() - 18.7402978).abs() < 1e-9);
        assert_eq!(
            (raw.measured_ns, raw.altitude_m, raw.satellites, raw.fix),
            (5_000_000_000, 160.25, 11, 3)
        );
        let near = |(found, wanted): (f64, f64)| (found - wanted).abs() < 1e-9;
        assert!(raw.velocity_ned_mps.into_iter().zip([21.9, -0.4, 0.12]).all(near), "{raw:?}");
        assert_eq!(
            (raw.horizontal_accuracy_m, raw.vertical_accuracy_m, raw.speed_accuracy_mps),
            (1.5, 2.5, 0.15)
        );
    }

    #[test]
    fn solution_that_the_receiver_does_not_believe_is_no_fix() {
        for (fix_type, flags, wanted) in
            [(3, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 2), (4, 1, 3), (5, 1, 0), (9, 1, 0)]
        {
            let heard = decoder().take(&solution(fix_type, flags), 0);
            let [Heard::Solution(raw)] = heard[..] else { panic!("{heard:?}") };
            assert_eq!(raw.fix, wanted, "type {fix_type}, flags {flags}");
        }
    }

    #[test]
    fn packets_come_in_pieces_between_sentences_and_noise() {
        let mut stream = b"$GPGGA,1,2,3*00\r\n\xb5\xb5".to_vec();
        stream.extend(packet(0x05, 0x01, &[0x06, 0x08]));
        stream.extend(b"noise \xb5 and more");
        stream.extend(solution(3, 1));
        stream.extend(packet(0x05, 0x00, &[0x06, 0x01]));
        let mut decoder = decoder();
        let heard: Vec<Heard> = stream.chunks(7).flat_map(|piece| decoder.take(piece, 1)).collect();
        assert_eq!(heard[0], Heard::Answer { class: 6, number: 8, granted: true });
        assert!(matches!(heard[1], Heard::Solution(_)));
        assert_eq!(heard[2], Heard::Answer { class: 6, number: 1, granted: false });
        assert_eq!(heard.len(), 3);
    }

    #[test]
    fn damaged_packet_is_counted_and_the_next_one_is_heard() {
        let mut damaged = solution(3, 1);
        damaged[40] ^= 1;
        let mut decoder = decoder();
        assert!(decoder.take(&damaged, 0).is_empty());
        assert_eq!(decoder.take(&solution(3, 1), 0).len(), 1);
        assert_eq!(decoder.counters(), Counters { solutions: 1, damaged: 1, others: 0 });
    }

    #[test]
    fn any_bytes_are_borne() {
        let mut decoder = decoder();
        let mut state = 1_u64;
        for _ in 0..20_000 {
            let bytes: Vec<u8> = (0..16)
                .map(|_| {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    [(state >> 33) as u8, 0xb5, 0x62, 0x01, 0x07][(state >> 60) as usize % 5]
                })
                .collect();
            let _ = decoder.take(&bytes, 0);
        }
        assert_eq!(decoder.counters().solutions, 0);
        let long = vec![0; 2_000]; // ends whatever the last piece had begun
        let _ = decoder.take(&long, 0);
        assert_eq!(decoder.take(&solution(3, 1), 0).len(), 1);
    }
}
