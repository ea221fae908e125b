//! Numbers that the dialect does not know, where somebody waits for an answer all the same.
//!
//! A command, or an item of a mission, that names an unknown number can not be said as a message of the dialect. It must
//! not be passed over: who sent it would repeat it until he gives up. Payloads are read at the places where the
//! message definitions have their fields, in the order of the wire.
#![allow(deprecated)] // ground stations in use still send the older item

use mavlink::dialects::common::{COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, MISSION_ITEM_DATA};
use mavlink::dialects::common::{MISSION_ITEM_INT_DATA, MavMessage};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, MessageData};

/// A message with a right checksum and a value outside its enumeration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Foreign {
    /// A command: COMMAND_LONG, COMMAND_INT.
    Command {
        /// What is commanded.
        number: u16,
        /// Whom.
        target_system: u8,
    },
    /// An item of a mission: MISSION_ITEM, MISSION_ITEM_INT.
    Item {
        /// Its place in the mission.
        seq: u16,
        /// For whom.
        target_system: u8,
        /// Its command is known, its frame is not.
        by_frame: bool,
    },
    /// Something that nobody waits for an answer to.
    Other,
}

impl Foreign {
    /// What message `id` was, which could not be read because of `error`.
    pub(crate) fn of(id: u32, payload: &[u8], error: &ParserError) -> Self {
        // Zeros at the end of a payload are left out on the wire.
        let byte = |place: usize| payload.get(place).copied().unwrap_or(0);
        let number = |place| u16::from_le_bytes([byte(place), byte(place + 1)]);
        let ParserError::InvalidEnum { enum_type, .. } = error else { return Self::Other };
        match id {
            COMMAND_LONG_DATA::ID | COMMAND_INT_DATA::ID => {
                Self::Command { number: number(28), target_system: byte(30) }
            }
            MISSION_ITEM_DATA::ID | MISSION_ITEM_INT_DATA::ID => {
                Self::Item { seq: number(28), target_system: byte(32), by_frame: *enum_type == "MavFrame" }
            }
            _ => Self::Other,
        }
    }
}

/// COMMAND_ACK for a command by its number.
#[derive(Debug, Clone)]
pub(crate) struct Acknowledgement {
    pub(crate) number: u16,
    /// All but the command.
    pub(crate) rest: COMMAND_ACK_DATA,
}

impl MessageData for Acknowledgement {
    type Message = MavMessage;

    const ID: u32 = COMMAND_ACK_DATA::ID;
    const NAME: &'static str = COMMAND_ACK_DATA::NAME;
    const EXTRA_CRC: u8 = COMMAND_ACK_DATA::EXTRA_CRC;
    const ENCODED_LEN: usize = COMMAND_ACK_DATA::ENCODED_LEN;

    fn ser(&self, version: MavlinkVersion, payload: &mut [u8]) -> usize {
        let length = self.rest.ser(version, payload);
        let number = self.number.to_le_bytes();
        payload[..number.len()].copy_from_slice(&number);
        length.max(number.len())
    }

    fn deser(version: MavlinkVersion, payload: &[u8]) -> Result<Self, ParserError> {
        COMMAND_ACK_DATA::deser(version, payload).map(|rest| Self { number: rest.command as u16, rest })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, Encoder};
    use mavlink::dialects::common::{MavFrame, MavResult};
    use mavlink::{Message, calculate_crc};

    /// What comes of `message` when its payload says `value` at `place`.
    fn heard(message: &MavMessage, place: usize, value: &[u8]) -> Vec<Result<MavMessage, Foreign>> {
        let (mut frame, mut all) = (Vec::new(), Vec::new());
        Encoder::new(255, 190).write(message, &mut frame);
        let end = frame.len() - 2;
        frame[10 + place..][..value.len()].copy_from_slice(value);
        let checksum = calculate_crc(&frame[1..end], MavMessage::extra_crc(message.message_id()));
        frame[end..].copy_from_slice(&checksum.to_le_bytes());
        Decoder::new().datagram(&frame, |received| all.push(received.message));
        all
    }

    #[test]
    fn command_that_the_dialect_does_not_know_is_given_with_its_number() {
        let expected = [Err(Foreign::Command { number: 42_424, target_system: 1 })];
        let long = COMMAND_LONG_DATA { target_system: 1, ..COMMAND_LONG_DATA::DEFAULT };
        assert_eq!(heard(&MavMessage::COMMAND_LONG(long), 28, &42_424_u16.to_le_bytes()), expected);
        let int = COMMAND_INT_DATA { target_system: 1, ..COMMAND_INT_DATA::DEFAULT };
        assert_eq!(heard(&MavMessage::COMMAND_INT(int), 28, &42_424_u16.to_le_bytes()), expected);
    }

    #[test]
    fn item_with_an_unknown_command_or_frame_is_given_with_its_place() {
        let frame = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT;
        let int = MavMessage::MISSION_ITEM_INT(MISSION_ITEM_INT_DATA {
            seq: 3,
            target_system: 1,
            frame,
            ..MISSION_ITEM_INT_DATA::DEFAULT
        });
        let old = MavMessage::MISSION_ITEM(MISSION_ITEM_DATA {
            seq: 3,
            target_system: 1,
            frame,
            ..MISSION_ITEM_DATA::DEFAULT
        });
        for item in [int, old] {
            for (place, value, by_frame) in [(30, &9_999_u16.to_le_bytes()[..], false), (34, &[99], true)] {
                let expected = [Err(Foreign::Item { seq: 3, target_system: 1, by_frame })];
                assert_eq!(heard(&item, place, value), expected);
            }
        }
    }

    #[test]
    fn answer_to_an_unknown_command_says_its_number_and_has_a_right_checksum() {
        let mut frame = Vec::new();
        let result = MavResult::MAV_RESULT_UNSUPPORTED;
        let answer = COMMAND_ACK_DATA { result, target_system: 255, ..COMMAND_ACK_DATA::DEFAULT };
        Encoder::new(1, 1).write_command_ack(42_424, answer.clone(), &mut frame);
        assert_eq!(frame[10..13], [0xb8, 0xa5, result as u8]);
        // Damage would be counted as such: the checksum is right, the number is none of the dialect's.
        let mut decoder = Decoder::new();
        decoder.datagram(&frame, |received| assert_eq!(received.message, Err(Foreign::Other)));
        assert_eq!((decoder.refused().malformed, decoder.refused().damaged), (1, 0));
        // With nothing but zeros behind it, the number is still whole.
        let mut short = Vec::new();
        Encoder::new(1, 1).write_command_ack(400, COMMAND_ACK_DATA::DEFAULT, &mut short);
        Decoder::new().datagram(&short, |received| {
            let Ok(MavMessage::COMMAND_ACK(ack)) = received.message else { panic!() };
            assert_eq!(ack.command as u16, 400);
        });
    }
}
