//! The link to the simulator: frames of [`crate::frame`] in UDP datagrams.
//!
//! Once a cycle the flight computer sends `TT` ([`Actuators`]); the simulator advances its aircraft to the module
//! time that stands in it and answers with one datagram that holds `II` ([`crate::RawAnalog`]), `CC` ([`Custom`]) and,
//! where a fix is due, `GG` ([`crate::RawGps`]). A repeated `TT` with the same time gets the same answer again, so that
//! a retry is harmless. `PP` ([`PilotOrder`]) tells the simulated safety pilot at the field what to do; the simulator
//! echoes it.

use crate::field::message;
use crate::frame;
use crate::{Message, RawAnalog, RawGps, ServoTimers};

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
    fn a_short_frame_says_what_was_expected() {
        let frame = frame::Frame { letter: PILOT, data: vec![1] };
        let error = Packet::of(&frame).unwrap_err();
        assert_eq!(error.to_string(), "frame \"P\" holds 1 bytes where 8 belong");
    }
}
