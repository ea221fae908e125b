//! The link to the simulator: which protocols there are, and the native one, frames of [`crate::frame`] in UDP datagrams.
//!
//! Once a cycle the flight computer sends `TT` ([`Actuators`]); the simulator advances its aircraft to the module
//! time that stands in it and answers with one datagram that holds `II` ([`crate::RawAnalog`]), `CC` ([`Custom`]),
//! `GG` ([`crate::RawGps`]) where a fix is due, and `RR` ([`crate::Range`]) where a range finder sees the ground. A repeated `TT` with the same time gets the same answer again, so that
//! a retry is harmless. `PP` ([`PilotOrder`]) tells the simulated safety pilot at the field what to do; the simulator
//! echoes it.

use std::fmt;
use std::str::FromStr;

use crate::frame;
pub use crate::packet::{Actuators, PilotOrder};
use crate::{Custom, Message, Range, RawAnalog, RawGps, ServoTimers};

/// What flight computer and simulator speak. The words are those of HILInterface's attribute `protocol` and of the
/// simulator's option of that name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Protocol {
    /// The frames of this module, over UDP.
    #[default]
    Native = 0,
    /// MAVLink over UDP.
    Mavlink = 1,
    /// MAVLink over TCP; the simulator listens.
    MavlinkTcp = 2,
}

impl Protocol {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Native, Self::Mavlink, Self::MavlinkTcp];

    /// The word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Mavlink => "mavlink",
            Self::MavlinkTcp => "mavlink-tcp",
        }
    }

    /// The port at which a simulator listens that was told no other.
    pub const fn port(self) -> u16 {
        match self {
            Self::Native => 15_200,
            Self::Mavlink => 14_560,
            Self::MavlinkTcp => 4_560,
        }
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A word that names no protocol.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no protocol \"{0}\"; there are \"native\", \"mavlink\" (over UDP) and \"mavlink-tcp\"")]
pub struct UnknownProtocol(pub String);

impl FromStr for Protocol {
    type Err = UnknownProtocol;

    fn from_str(word: &str) -> Result<Self, UnknownProtocol> {
        let found = Self::ALL.into_iter().find(|protocol| protocol.name() == word);
        found.ok_or_else(|| UnknownProtocol(word.to_owned()))
    }
}

/// Flight computer → simulator: actuators.
pub const ACTUATORS: u8 = b'T';
/// Simulator → flight computer: inertial, magnetic and pressure sensors.
pub const ANALOG: u8 = b'I';
/// Simulator → flight computer: a satellite fix.
pub const GPS: u8 = b'G';
/// Simulator → flight computer: safety pilot's sticks and supply voltages.
pub const CUSTOM: u8 = b'C';
/// Simulator → flight computer: distance to the ground.
pub const RANGE: u8 = b'R';
/// Ground crew → simulator: an order to the safety pilot; echoed.
pub const PILOT: u8 = b'P';

impl Actuators {
    /// The packet for `timers`, to be flown until `module_ns`.
    pub fn new(module_ns: u64, sequence: u64, timers: &ServoTimers) -> Self {
        Self {
            module_ns,
            sequence,
            aileron_left_us: timers.aileron_left_us,
            aileron_right_us: timers.aileron_right_us,
            elevator_us: timers.elevator_us,
            rudder_us: timers.rudder_us,
            throttle_us: timers.throttle_us,
            autopilot: timers.autopilot,
            reserved: 0,
        }
    }
}

/// Safety pilot: throttle closed, hands on the sticks.
pub const PILOT_STAND_BY: u32 = PilotOrder::ORDER_STAND_BY;
/// Safety pilot: full throttle, rotate, climb straight ahead.
pub const PILOT_TAKE_OFF: u32 = PilotOrder::ORDER_TAKE_OFF;

/// A frame of the simulator link, decoded.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)] // lives on the stack of one loop
pub enum Packet {
    /// See [`ACTUATORS`].
    Actuators(Actuators),
    /// See [`ANALOG`].
    Analog(RawAnalog),
    /// See [`GPS`].
    Gps(RawGps),
    /// See [`CUSTOM`].
    Custom(Custom),
    /// See [`RANGE`].
    Range(Range),
    /// See [`PILOT`].
    Pilot(PilotOrder),
}

/// Why a whole frame was not a packet of this link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// A letter that the link does not use.
    #[error("frame \"{0}\" is not one of T, I, G, C, R, P")]
    UnknownLetter(char),
    /// Data of another length than the message's.
    #[error("frame \"{letter}\" holds {found} bytes where {expected} belong")]
    WrongLength {
        /// The frame's letter.
        letter: char,
        /// Bytes that came.
        found: usize,
        /// Bytes that the message has.
        expected: usize,
    },
}

impl Packet {
    /// Reads the packet in a frame.
    pub fn of(frame: &frame::Frame) -> Result<Self, PacketError> {
        match frame.letter {
            ACTUATORS => data(frame).map(Self::Actuators),
            ANALOG => data(frame).map(Self::Analog),
            GPS => data(frame).map(Self::Gps),
            CUSTOM => data(frame).map(Self::Custom),
            RANGE => data(frame).map(Self::Range),
            PILOT => data(frame).map(Self::Pilot),
            letter => Err(PacketError::UnknownLetter(letter as char)),
        }
    }

    /// Appends the packet's frame to `out`.
    pub fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Actuators(message) => append(ACTUATORS, message, out),
            Self::Analog(message) => append(ANALOG, message, out),
            Self::Gps(message) => append(GPS, message, out),
            Self::Custom(message) => append(CUSTOM, message, out),
            Self::Range(message) => append(RANGE, message, out),
            Self::Pilot(message) => append(PILOT, message, out),
        }
    }
}

fn append<T: Message>(letter: u8, message: &T, out: &mut Vec<u8>) {
    frame::encode(letter, message.as_bytes(), out);
}

pub(crate) fn data<T: Message>(frame: &frame::Frame) -> Result<T, PacketError> {
    T::read_from_bytes(&frame.data).map_err(|_| PacketError::WrongLength {
        letter: frame.letter as char,
        found: frame.data.len(),
        expected: size_of::<T>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Decoder;

    #[test]
    fn one_datagram_carries_a_sensor_set() {
        let mut bytes = Vec::new();
        let analog = RawAnalog {
            measured_ns: 20_000_000,
            specific_force_mps2: [0.0, 0.0, -9.81],
            ..Default::default()
        };
        Packet::Analog(analog).write(&mut bytes);
        Packet::Gps(RawGps { satellites: 9, fix: 3, ..Default::default() }).write(&mut bytes);
        let mut decoder = Decoder::new();
        let packets: Vec<_> = decoder.extend(&bytes).map(|frame| Packet::of(&frame)).collect();
        assert_eq!(packets.len(), 2);
        assert_eq!(packets[0], Ok(Packet::Analog(analog)));
    }

    #[test]
    fn every_protocol_is_found_by_its_word_and_another_word_lists_them() {
        for protocol in Protocol::ALL {
            assert_eq!(protocol.name().parse(), Ok(protocol));
        }
        let error = "udp".parse::<Protocol>().unwrap_err().to_string();
        assert!(Protocol::ALL.iter().all(|protocol| error.contains(protocol.name())), "{error}");
    }

    #[test]
    fn a_short_frame_says_what_was_expected() {
        let frame = frame::Frame { letter: PILOT, data: vec![1] };
        let error = Packet::of(&frame).unwrap_err();
        assert_eq!(error.to_string(), "frame \"P\" holds 1 bytes where 8 belong");
    }
}
