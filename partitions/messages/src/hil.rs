//! The link to the simulator: which protocols there are, and the native one, frames of [`crate::frame`] in UDP datagrams.
//!
//! Once a cycle the flight computer sends `TT` ([`Actuators`]); the simulator advances its aircraft to the module
//! time that stands in it and answers with one datagram that holds `II` ([`crate::RawAnalog`]), `CC` ([`Custom`]) and,
//! where a fix is due, `GG` ([`crate::RawGps`]). A repeated `TT` with the same time gets the same answer again, so that
//! a retry is harmless. `PP` ([`PilotOrder`]) tells the simulated safety pilot at the field what to do; the simulator
//! echoes it.

use std::fmt;
use std::str::FromStr;

use crate::field::message;
use crate::frame;
use crate::{Message, RawAnalog, RawGps, ServoTimers};

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
/// Ground crew → simulator: an order to the safety pilot; echoed.
pub const PILOT: u8 = b'P';

message! {
    /// The actuators of one cycle, and the time to advance to.
    pub struct Actuators {
        /// Module time to which the simulator shall advance, ns.
        pub module_ns: u64,
        /// Cycles so far.
        pub sequence: u64,
        /// The timer values.
        pub aileron_left_us: u16,
        /// Right aileron, µs.
        pub aileron_right_us: u16,
        /// Elevator, µs.
        pub elevator_us: u16,
        /// Rudder, µs.
        pub rudder_us: u16,
        /// Throttle, µs.
        pub throttle_us: u16,
        /// 1 when the autopilot flies.
        pub autopilot: u16,
        /// Unused, zero.
        pub reserved: u32,
    }
}

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

message! {
    /// What comes beside the sensors: the safety pilot's sticks and the supply voltages.
    pub struct Custom {
        /// Module time of the sample, ns.
        pub measured_ns: u64,
        /// Stick: aileron pulse, µs.
        pub pilot_aileron_us: u16,
        /// Stick: elevator pulse, µs.
        pub pilot_elevator_us: u16,
        /// Stick: rudder pulse, µs.
        pub pilot_rudder_us: u16,
        /// Stick: throttle pulse, µs.
        pub pilot_throttle_us: u16,
        /// Main battery, V.
        pub main_v: f64,
        /// Backup battery, V.
        pub backup_v: f64,
        /// Supply of the actuator board, V.
        pub actuator_board_v: f64,
    }
}

message! {
    /// What became of the conversation with the simulator so far; what each count means stands in the book, "The link
    /// to a simulator".
    pub struct SimulatorLink {
        /// Module time, ns.
        pub time_ns: u64,
        /// Module time of the newest sensor set that was taken, ns.
        pub measured_ns: u64,
        /// Windows with new sensors.
        pub accepted: u64,
        /// Windows without.
        pub missing: u64,
        /// Questions that were asked again because no answer came.
        pub repeated: u64,
        /// Sensor sets for another time than the one asked for.
        pub stale: u64,
        /// Frames and datagrams that could not be read, or that belong elsewhere.
        pub refused: u64,
        /// Sound messages that say nothing to a flight computer (MAVLink).
        pub unused: u64,
        /// Values that are no numbers, and time stamps that can not be (MAVLink).
        pub invalid: u64,
        /// Messages that are missing by their numbers (MAVLink).
        pub lost: u64,
        /// Datagrams from another address, and messages of another system.
        pub strangers: u64,
        /// Errors of the socket.
        pub errors: u64,
        /// Connections made (TCP).
        pub connections: u64,
        /// Times that the simulator's own clock was tied to module time (MAVLink).
        pub clock_ties: u64,
        /// 0 native, 1 MAVLink over UDP, 2 MAVLink over TCP.
        pub protocol: u32,
        /// 1 in lockstep, 0 free-running.
        pub lockstep: u32,
    }
}

message! {
    /// An order to the safety pilot.
    pub struct PilotOrder {
        /// 0 stand by with the throttle closed, 1 take off at full throttle and climb straight ahead.
        pub order: u32,
        /// Unused, zero.
        pub reserved: u32,
    }
}

/// Safety pilot: throttle closed, hands on the sticks.
pub const PILOT_STAND_BY: u32 = 0;
/// Safety pilot: full throttle, rotate, climb straight ahead.
pub const PILOT_TAKE_OFF: u32 = 1;

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
    /// See [`PILOT`].
    Pilot(PilotOrder),
}

/// Why a whole frame was not a packet of this link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// A letter that the link does not use.
    #[error("frame \"{0}\" is not one of T, I, G, C, P")]
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
