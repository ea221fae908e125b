//! From the aircraft to the ground. One letter a message; numbers little endian, SI and radians.

use crate::frame::Frame;
use crate::hil::{self, PacketError};
pub use crate::packet::{
    Acknowledge, GpsTelemetry, HealthText, ImuTelemetry, Loops, Navigation, ParameterValue, Primary,
    ServoTelemetry, StateTelemetry, Voltages,
};
use crate::{GroundMessage, Message, SimulatorLink, TelemetryMessage};

/// Bytes of data that a telemetry message can hold.
pub const TELEMETRY_DATA: usize = 126;

impl TelemetryMessage {
    /// The message that carries `item`.
    pub fn of(item: &Telemetry) -> Self {
        let (letter, bytes) = item.parts();
        let mut message = Self { letter, ..Self::default() };
        let length = bytes.len().min(TELEMETRY_DATA);
        message.data[..length].copy_from_slice(&bytes[..length]);
        message.length = length as u8; // TELEMETRY_DATA < 256
        message
    }

    /// The data in use.
    pub fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.length).min(TELEMETRY_DATA)]
    }
}

/// [`Navigation::flags`]: the autopilot is engaged.
pub const NAVIGATION_AUTOPILOT: u32 = 1;
/// [`Navigation::flags`]: way-point navigation is on.
pub const NAVIGATION_ON: u32 = 2;
/// [`Navigation::flags`]: the laps are flown.
pub const NAVIGATION_FINISHED: u32 = 4;
/// [`Navigation::flags`]: it circles.
pub const NAVIGATION_LOITER: u32 = 8;
/// [`Navigation::flags`]: it flies back to the runway, or circles above it.
pub const NAVIGATION_RETURN: u32 = 16;
/// [`Navigation::flags`]: a take-off is under way.
pub const NAVIGATION_TAKE_OFF: u32 = 32;
/// [`Navigation::flags`]: the take-off was given up.
pub const NAVIGATION_ABORTED: u32 = 64;
/// [`Navigation::flags`]: the aircraft is outside of the fence.
pub const NAVIGATION_OUTSIDE: u32 = 128;
/// [`Navigation::flags`]: what it does it does because the ground is silent.
pub const NAVIGATION_LINK_LOST: u32 = 256;
/// [`Navigation::flags`]: it lands, and is in the air yet.
pub const NAVIGATION_LANDING: u32 = 512;
/// [`Navigation::flags`]: it has landed, and rolls or stands.
pub const NAVIGATION_LANDED: u32 = 1024;
/// [`Navigation::flags`]: the limits begin with this bit.
pub const NAVIGATION_PROTECTION_SHIFT: u32 = 16;

/// Bytes of a [`HealthText`]'s text.
pub const HEALTH_TEXT: usize = 104;

impl HealthText {
    /// Of a text that came `times` times; what is too long is cut.
    pub fn of(severity: u8, text: &str, times: u32, time_ns: u64) -> Self {
        let end = (0..=text.len().min(HEALTH_TEXT)).rev().find(|end| text.is_char_boundary(*end));
        let length = end.unwrap_or_default();
        let mut bytes = [0; HEALTH_TEXT];
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        Self { time_ns, times, severity, length: length as u8, text: bytes, ..Self::default() }
    }

    /// The text; empty where it is none.
    pub fn text(&self) -> &str {
        let length = usize::from(self.length).min(HEALTH_TEXT);
        std::str::from_utf8(&self.text[..length]).unwrap_or_default()
    }
}

/// Why an order is not possible now, for the person who gave it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Refusal {
    /// The Controller gets no state that could be flown on.
    NoState = 1,
    /// The Controller has no way-points to navigate along.
    NoWaypoints = 2,
    /// The Controller's list of way-points is too short for this one.
    TooManyWaypoints = 3,
    /// The IMU takes its biases at standstill only, and needs its sensors for that.
    NotStanding = 4,
    /// The plan has switched this off (the IMU's attribute `gyro_bias`).
    SwitchedOff = 5,
    /// The Estimator does not begin without inertial attitude in flight.
    InFlight = 6,
    /// The function takes no orders out of its port: it does not run, or cannot keep up.
    NotTaken = 7,
    /// The Controller does not fly: the autopilot is off, or the wheels are on the ground.
    NotFlying = 8,
    /// The aircraft is outside of its fence: it comes back first.
    OutsideFence = 9,
    /// There is no take-off that could be stopped: none is under way, or it is in the air.
    NoTakeOff = 10,
    /// The function has no parameter of that name.
    NoSuchParameter = 11,
    /// The parameter comes from the schedule file or the airframe, and stays as it is while the function runs.
    BelongsToPlan = 12,
    /// The parameter does not take this value.
    OutOfRange = 13,
    /// The parameter takes whole numbers.
    NotWhole = 14,
    /// The list of way-points has no such entry, or a jump that leads to none.
    NoSuchEntry = 15,
    /// These areas are no fence: the runway is not inside, or a polygon is in pieces.
    NoFence = 16,
}

impl Refusal {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::NoState,
        Self::NoWaypoints,
        Self::TooManyWaypoints,
        Self::NotStanding,
        Self::SwitchedOff,
        Self::InFlight,
        Self::NotTaken,
        Self::NotFlying,
        Self::OutsideFence,
        Self::NoTakeOff,
        Self::NoSuchParameter,
        Self::BelongsToPlan,
        Self::OutOfRange,
        Self::NotWhole,
        Self::NoSuchEntry,
        Self::NoFence,
    ];

    /// The reason of an answer.
    pub fn of(answer: &Acknowledge) -> Option<Self> {
        Self::of_number(answer.reason)
    }

    /// The reason with this number.
    pub fn of_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|refusal| *refusal as u32 == number)
    }

    /// For a person.
    pub fn text(self) -> &'static str {
        match self {
            Self::NoState => {
                "there is no usable state from the Estimator: initialise it, and wait until it runs"
            }
            Self::NoWaypoints => "it has no way-points: load them first",
            Self::TooManyWaypoints => "its list of way-points is too short for that",
            Self::NotStanding => "the aircraft does not stand still, or no sensor values come",
            Self::SwitchedOff => "the plan has switched it off (attribute gyro_bias)",
            Self::InFlight => {
                "it does not begin without inertial attitude in flight: use full initialisation"
            }
            Self::NotTaken => "the function does not take orders: does it run?",
            Self::NotFlying => "the autopilot does not fly: it is off, or the wheels are on the ground",
            Self::OutsideFence => "the aircraft is outside of its fence: it comes back first",
            Self::NoTakeOff => "there is no take-off to be stopped: none is under way, or it is in the air",
            Self::NoSuchParameter => "it has no parameter of that name",
            Self::BelongsToPlan => {
                "it comes from the schedule file or the airframe and can not be set while the function runs"
            }
            Self::OutOfRange => "the value is outside its range",
            Self::NotWhole => "it takes whole numbers only",
            Self::NoFence => "the runway is not inside of this fence, or a polygon of it is in pieces",
            Self::NoSuchEntry => "the list has no such entry, or a jump in it leads to none",
        }
    }
}

impl Acknowledge {
    /// The answer of function `from` to `message` at module time `time_ns`: refused now, and why.
    pub fn refused(message: &GroundMessage, from: u8, refusal: Refusal, time_ns: u64) -> Self {
        Self { reason: refusal as u32, ..Self::of(message, from, REFUSED, time_ns) }
    }

    /// The answer of function `from` (a `FROM_…` constant) to `message` at module time `time_ns`.
    pub fn of(message: &GroundMessage, from: u8, result: u8, time_ns: u64) -> Self {
        let first = message.bytes().first().copied().unwrap_or_default();
        Self { time_ns, letter: message.letter, first, from, result, reason: 0 }
    }
}

/// [`Acknowledge::result`]: done.
pub const ACCEPTED: u8 = Acknowledge::RESULT_ACCEPTED;
/// [`Acknowledge::result`]: letter, length or value wrong.
pub const NOT_UNDERSTOOD: u8 = Acknowledge::RESULT_NOT_UNDERSTOOD;
/// [`Acknowledge::result`]: understood, but not possible in the present state.
pub const REFUSED: u8 = Acknowledge::RESULT_REFUSED;

/// [`Acknowledge::from`]: Command itself (no function knows the letter).
pub const FROM_COMMAND: u8 = 0;
/// [`Acknowledge::from`]: HILInterface.
pub const FROM_HIL_INTERFACE: u8 = 1;
/// [`Acknowledge::from`]: IMU.
pub const FROM_IMU: u8 = 2;
/// [`Acknowledge::from`]: Estimator.
pub const FROM_ESTIMATOR: u8 = 3;
/// [`Acknowledge::from`]: Controller.
pub const FROM_CONTROLLER: u8 = 4;
/// [`Acknowledge::from`]: Servo.
pub const FROM_SERVO: u8 = 5;
/// [`Acknowledge::from`]: GPS.
pub const FROM_GPS: u8 = 6;
/// [`Acknowledge::from`]: OnBoardComputer.
pub const FROM_ONBOARD_COMPUTER: u8 = 7;
/// [`Acknowledge::from`]: RateGenerator.
pub const FROM_RATE_GENERATOR: u8 = 8;

/// The functions by their `FROM_…` constants: the name of each in the plan's ports to and from Command.
pub const FUNCTIONS: [(u8, &str); 9] = [
    (FROM_COMMAND, "command"),
    (FROM_RATE_GENERATOR, "rate_generator"),
    (FROM_HIL_INTERFACE, "hil_interface"),
    (FROM_GPS, "gps"),
    (FROM_IMU, "imu"),
    (FROM_ESTIMATOR, "estimator"),
    (FROM_CONTROLLER, "controller"),
    (FROM_SERVO, "servo"),
    (FROM_ONBOARD_COMPUTER, "onboard_computer"),
];

/// The name of a function in the plan's ports; none where there is no such function.
pub fn function_name(from: u8) -> Option<&'static str> {
    FUNCTIONS.into_iter().find(|(number, _)| *number == from).map(|(_, name)| name)
}

/// Everything that can come down.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)] // each variant is named after its documented message
pub enum Telemetry {
    Primary(Primary),
    Voltages(Voltages),
    Gps(GpsTelemetry),
    Imu(ImuTelemetry),
    State(StateTelemetry),
    Navigation(Navigation),
    Loops(Loops),
    Servo(ServoTelemetry),
    Simulator(SimulatorLink),
    Acknowledge(Acknowledge),
    Parameter(ParameterValue),
    Health(HealthText),
}

impl Telemetry {
    /// The letter on the line and the bytes.
    pub fn parts(&self) -> (u8, &[u8]) {
        use zerocopy::IntoBytes;
        match self {
            Self::Primary(message) => (b'P', message.as_bytes()),
            Self::Voltages(message) => (b'V', message.as_bytes()),
            Self::Gps(message) => (b'G', message.as_bytes()),
            Self::Imu(message) => (b'M', message.as_bytes()),
            Self::State(message) => (b'X', message.as_bytes()),
            Self::Navigation(message) => (b'Q', message.as_bytes()),
            Self::Loops(message) => (b'C', message.as_bytes()),
            Self::Servo(message) => (b'T', message.as_bytes()),
            Self::Simulator(message) => (b'S', message.as_bytes()),
            Self::Acknowledge(message) => (b'K', message.as_bytes()),
            Self::Parameter(message) => (b'Y', message.as_bytes()),
            Self::Health(message) => (b'H', message.as_bytes()),
        }
    }

    /// Reads a telemetry message from a frame.
    pub fn of(frame: &Frame) -> Result<Self, PacketError> {
        match frame.letter {
            b'P' => hil::data(frame).map(Self::Primary),
            b'V' => hil::data(frame).map(Self::Voltages),
            b'G' => hil::data(frame).map(Self::Gps),
            b'M' => hil::data(frame).map(Self::Imu),
            b'X' => hil::data(frame).map(Self::State),
            b'Q' => hil::data(frame).map(Self::Navigation),
            b'C' => hil::data(frame).map(Self::Loops),
            b'T' => hil::data(frame).map(Self::Servo),
            b'S' => hil::data(frame).map(Self::Simulator),
            b'K' => hil::data(frame).map(Self::Acknowledge),
            b'Y' => hil::data(frame).map(Self::Parameter),
            b'H' => hil::data(frame).map(Self::Health),
            letter => Err(PacketError::UnknownLetter(letter as char)),
        }
    }
}

const fn fits<T: Message>() {
    assert!(size_of::<T>() <= TELEMETRY_DATA);
}
const _: () = {
    fits::<Primary>();
    fits::<Voltages>();
    fits::<GpsTelemetry>();
    fits::<ImuTelemetry>();
    fits::<StateTelemetry>();
    fits::<Navigation>();
    fits::<Loops>();
    fits::<ServoTelemetry>();
    fits::<SimulatorLink>();
    fits::<Acknowledge>();
    fits::<ParameterValue>();
    fits::<HealthText>();
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_keeps_its_reason_over_the_line() {
        for refusal in Refusal::ALL {
            let message = GroundMessage { letter: b'A', ..GroundMessage::default() };
            let answer = Acknowledge::refused(&message, FROM_CONTROLLER, refusal, 5);
            let sent = TelemetryMessage::of(&Telemetry::Acknowledge(answer));
            let frame = Frame { letter: sent.letter, data: sent.bytes().to_vec() };
            assert_eq!(Telemetry::of(&frame), Ok(Telemetry::Acknowledge(answer)));
            assert_eq!((Refusal::of(&answer), answer.result), (Some(refusal), REFUSED));
        }
        assert_eq!(Refusal::of(&Acknowledge { reason: 4_000, ..Default::default() }), None);
    }

    #[test]
    fn telemetry_survives_the_port_and_the_line() {
        let item =
            Telemetry::Navigation(Navigation { next_waypoint: 2, waypoint_count: 4, ..Default::default() });
        let message = TelemetryMessage::of(&item);
        let frame = Frame { letter: message.letter, data: message.bytes().to_vec() };
        assert_eq!(Telemetry::of(&frame), Ok(item));
    }
}
