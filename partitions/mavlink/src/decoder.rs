//! Bytes to messages.
//!
//! MAVLink 1 and 2 are both understood, message by message. A frame is believed when its checksum is right; after one that is not, the search goes on
//! with the byte after its mark, so that damage costs the damaged message alone. A message that this dialect does not
//! know can not be checked: it is passed over in its whole length, and counted. Signatures are passed over, not
//! verified.

use mavlink::dialects::common::MavMessage;
use mavlink::{MavlinkVersion, Message, calculate_crc};

use crate::Foreign;

/// The mark of MAVLink 1.
const MARK_1: u8 = 0xfe;
/// The mark of MAVLink 2.
const MARK_2: u8 = 0xfd;
/// Bytes before the payload: mark, length, sequence, system, component, message.
const HEADER_1: usize = 6;
/// Two flag bytes more, and a message number of three bytes.
const HEADER_2: usize = 10;
const CHECKSUM: usize = 2;
/// Flag of MAVLink 2: a signature follows the checksum.
const SIGNED: u8 = 1;
const SIGNATURE: usize = 13;

/// One message with a right checksum.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// Who sent it.
    pub system: u8,
    /// Which part of that system.
    pub component: u8,
    /// Its number, modulo 256.
    pub sequence: u8,
    /// What it says, if the dialect has all its values.
    pub message: Result<MavMessage, Foreign>,
}

/// What could not be taken so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Refused {
    /// Frames with a wrong checksum, or that broke off with the datagram.
    pub damaged: u64,
    /// Messages that the dialect does not know, or with flags that nobody may pass over.
    pub unknown: u64,
    /// Messages with a right checksum and a value outside its enumeration. They are given to the taker as well.
    pub malformed: u64,
    /// Bytes that belong to no frame.
    pub noise_bytes: u64,
}

impl Refused {
    /// All of them but the noise.
    pub fn messages(&self) -> u64 {
        self.damaged + self.unknown + self.malformed
    }
}

/// Finds messages in bytes. One for each sender of datagrams, or one for each stream.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    bytes: Vec<u8>,
    refused: Refused,
}

/// What the bytes at the front are.
#[allow(clippy::large_enum_variant)] // lives on the stack of one loop
enum Front {
    /// A frame that is not whole yet.
    Incomplete,
    /// No frame begins here, or a damaged one.
    Noise { damaged: bool },
    /// So many bytes that are not for us.
    Unknown(usize),
    /// A frame of so many bytes with a right checksum.
    Sound(usize, Received),
}

impl Decoder {
    /// With nothing received yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What could not be taken so far.
    pub fn refused(&self) -> Refused {
        self.refused
    }

    /// Forgets what came of a message that is not whole: the stream has ended.
    pub fn cut(&mut self) {
        self.refused.damaged += u64::from(!self.bytes.is_empty());
        self.bytes.clear();
    }

    /// Takes a datagram, which holds whole messages: what is not whole at its end never will be.
    pub fn datagram(&mut self, bytes: &[u8], mut take: impl FnMut(Received)) {
        self.bytes.clear();
        self.bytes.extend_from_slice(bytes);
        self.search(true, &mut take);
        self.bytes.clear();
    }

    /// Takes the next bytes of a stream. What is not whole waits for the next ones.
    pub fn stream(&mut self, bytes: &[u8], mut take: impl FnMut(Received)) {
        self.bytes.extend_from_slice(bytes);
        let used = self.search(false, &mut take);
        self.bytes.drain(..used);
    }

    /// Gives how many bytes are done with. `ends`: nothing will follow.
    fn search(&mut self, ends: bool, take: &mut impl FnMut(Received)) -> usize {
        let mut place = 0;
        while place < self.bytes.len() {
            match front(&self.bytes[place..]) {
                Front::Incomplete if !ends => break,
                Front::Incomplete | Front::Noise { damaged: true } => {
                    self.refused.damaged += 1;
                    place += 1;
                    // What is left of the damaged frame is not noise of its own.
                    place += self.bytes[place..].iter().take_while(|byte| !is_mark(**byte)).count();
                }
                Front::Noise { damaged: false } => {
                    self.refused.noise_bytes += 1;
                    place += 1;
                }
                Front::Unknown(length) => {
                    self.refused.unknown += 1;
                    place += length;
                }
                Front::Sound(length, received) => {
                    self.refused.malformed += u64::from(received.message.is_err());
                    take(received);
                    place += length;
                }
            }
        }
        place
    }
}

fn is_mark(byte: u8) -> bool {
    byte == MARK_1 || byte == MARK_2
}

fn front(bytes: &[u8]) -> Front {
    match bytes {
        [MARK_1, _, sequence, system, component, id, ..] => {
            let sender = (*system, *component, *sequence);
            frame(bytes, MavlinkVersion::V1, sender, u32::from(*id), 0)
        }
        [MARK_2, _, flags, _, sequence, system, component, low, middle, high, ..] => {
            let sender = (*system, *component, *sequence);
            frame(bytes, MavlinkVersion::V2, sender, u32::from_le_bytes([*low, *middle, *high, 0]), *flags)
        }
        [MARK_1 | MARK_2, ..] => Front::Incomplete,
        _ => Front::Noise { damaged: false },
    }
}

fn frame(bytes: &[u8], version: MavlinkVersion, sender: (u8, u8, u8), id: u32, flags: u8) -> Front {
    let header = if version == MavlinkVersion::V1 { HEADER_1 } else { HEADER_2 };
    let payload_end = header + usize::from(bytes[1]);
    let signature = if flags & SIGNED == 0 { 0 } else { SIGNATURE };
    let length = payload_end + CHECKSUM + signature;
    if bytes.len() < length {
        return Front::Incomplete;
    }
    if flags & !SIGNED != 0 || !is_known(id) {
        return Front::Unknown(length);
    }
    let told = u16::from_le_bytes([bytes[payload_end], bytes[payload_end + 1]]);
    if calculate_crc(&bytes[1..payload_end], MavMessage::extra_crc(id)) != told {
        return Front::Noise { damaged: true };
    }
    let (system, component, sequence) = sender;
    let payload = &bytes[header..payload_end];
    let message = MavMessage::parse(version, id, payload).map_err(|error| Foreign::of(id, payload, &error));
    Front::Sound(length, Received { system, component, sequence, message })
}

fn is_known(id: u32) -> bool {
    MavMessage::default_message_from_id(id).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Encoder;
    use mavlink::dialects::common::{HEARTBEAT_DATA, HIL_GPS_DATA, HIL_SENSOR_DATA};
    use proptest::prelude::*;

    fn sensor(time_usec: u64) -> MavMessage {
        MavMessage::HIL_SENSOR(HIL_SENSOR_DATA { time_usec, zacc: -9.81, ..HIL_SENSOR_DATA::DEFAULT })
    }

    fn bytes(messages: &[MavMessage]) -> Vec<u8> {
        let (mut encoder, mut out) = (Encoder::new(7, 9), Vec::new());
        messages.iter().for_each(|message| encoder.write(message, &mut out));
        out
    }

    fn datagram(decoder: &mut Decoder, bytes: &[u8]) -> Vec<MavMessage> {
        let mut all = Vec::new();
        decoder.datagram(bytes, |received| all.extend(received.message));
        all
    }

    #[test]
    fn several_messages_of_a_datagram_come_out_with_their_sender_and_number() {
        let mut all = Vec::new();
        Decoder::new().datagram(&bytes(&[sensor(1), sensor(2)]), |received| all.push(received));
        assert_eq!(all.len(), 2);
        assert_eq!((all[1].system, all[1].component, all[1].sequence), (7, 9, 1));
        assert_eq!(all[1].message, Ok(sensor(2)));
    }

    #[test]
    fn a_damaged_message_costs_itself_alone() {
        let mut damaged = bytes(&[sensor(1), sensor(2), sensor(3)]);
        let one = damaged.len() / 3;
        damaged[one + 15] ^= 0x10;
        let mut decoder = Decoder::new();
        assert_eq!(datagram(&mut decoder, &damaged), [sensor(1), sensor(3)]);
        assert_eq!(decoder.refused(), Refused { damaged: 1, ..Refused::default() });
    }

    #[test]
    fn half_a_message_at_the_end_of_a_datagram_does_not_swallow_the_next_datagram() {
        let whole = bytes(&[sensor(1)]);
        let mut decoder = Decoder::new();
        assert!(datagram(&mut decoder, &whole[..20]).is_empty());
        assert_eq!(datagram(&mut decoder, &whole), [sensor(1)]);
        assert_eq!(decoder.refused().damaged, 1);
    }

    #[test]
    fn a_stream_in_single_bytes_gives_the_same_messages() {
        let mut decoder = Decoder::new();
        let mut all = Vec::new();
        let noisy = [&b"noise"[..], &bytes(&[sensor(1), sensor(2)])].concat();
        noisy.iter().for_each(|byte| decoder.stream(&[*byte], |received| all.extend(received.message)));
        assert_eq!(all, [sensor(1), sensor(2)]);
        assert_eq!(decoder.refused(), Refused { noise_bytes: 5, ..Refused::default() });
    }

    #[test]
    fn unknown_message_is_passed_over_and_counted() {
        let mut foreign = bytes(&[sensor(1)]);
        foreign[7..10].copy_from_slice(&[0xff, 0xff, 0x7f]);
        foreign.extend(bytes(&[sensor(2)]));
        let mut decoder = Decoder::new();
        assert_eq!(datagram(&mut decoder, &foreign), [sensor(2)]);
        assert_eq!(decoder.refused(), Refused { unknown: 1, ..Refused::default() });
    }

    #[test]
    fn value_outside_its_enumeration_is_malformed() {
        let mut raw = bytes(&[MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT)]);
        let end = raw.len() - CHECKSUM;
        raw[HEADER_2 + 4] = 250; // kind of vehicle
        let checksum = calculate_crc(&raw[1..end], MavMessage::extra_crc(0)).to_le_bytes();
        raw[end..].copy_from_slice(&checksum);
        let mut decoder = Decoder::new();
        assert!(datagram(&mut decoder, &raw).is_empty());
        assert_eq!(decoder.refused(), Refused { malformed: 1, ..Refused::default() });
    }

    #[test]
    fn older_version_and_signed_messages_are_understood() {
        let mut first = mavlink::MAVLinkV1MessageRaw::new();
        let header = mavlink::MavHeader { system_id: 3, component_id: 4, sequence: 5 };
        let fix = MavMessage::HIL_GPS(HIL_GPS_DATA { lat: -330_000_000, ..HIL_GPS_DATA::DEFAULT });
        first.serialize_message(header, &fix);
        let mut signed = bytes(&[sensor(2)]);
        signed[2] = SIGNED;
        let end = signed.len() - CHECKSUM;
        let checksum = calculate_crc(&signed[1..end], MavMessage::extra_crc(107)).to_le_bytes();
        signed[end..].copy_from_slice(&checksum);
        signed.extend([9; SIGNATURE]);
        let mut decoder = Decoder::new();
        let both = [first.raw_bytes(), &signed].concat();
        assert_eq!(datagram(&mut decoder, &both), [fix, sensor(2)]);
        assert_eq!(decoder.refused(), Refused::default());
    }

    proptest! {
        #[test]
        fn no_bytes_panic_and_a_stream_never_grows(garbage in proptest::collection::vec(any::<u8>(), 0..600)) {
            let mut decoder = Decoder::new();
            decoder.datagram(&garbage, drop);
            decoder.stream(&garbage, drop);
            decoder.stream(&garbage, drop);
            prop_assert!(decoder.bytes.len() <= 300);
        }

        #[test]
        fn any_payload_of_any_message_is_parsed_or_refused(id in 0_u8..=255, payload in proptest::collection::vec(any::<u8>(), 0..=255)) {
            for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
                let _ = MavMessage::parse(version, u32::from(id), &payload);
            }
        }

        #[test]
        fn a_sound_message_is_found_behind_noise_without_marks(noise in proptest::collection::vec(0_u8..0xfd, 0..100)) {
            let mut decoder = Decoder::new();
            let all = datagram(&mut decoder, &[&noise[..], &bytes(&[sensor(5)])].concat());
            prop_assert_eq!(all, vec![sensor(5)]);
        }
    }
}
