//! The messages that travel through ports and over the links to the simulator and the ground.
//!
//! Responsible for: the layout of every message, a table of its fields (so that a log or a command line can
//! show values by name), and the byte protocols of the serial line and of the simulator link. It must never
//! know a partition, a port or a clock.
//!
//! One file a subject. A message is a `#[repr(C)]` structure without padding, little endian on every
//! processor that is supported; the derive of [`zerocopy::IntoBytes`] refuses a layout with holes. Names carry
//! units; SI and radians throughout.

#[cfg(target_endian = "big")]
compile_error!("port messages are shared as they lie in memory, little endian");

mod field;

pub mod control;
pub mod frame;
pub mod gps;
pub mod ground;
pub mod hil;
pub mod imu;
pub mod link;
pub mod parameter;
pub mod rate;
pub mod state;
pub mod telemetry;

pub use control::{ActuatorCommand, FunctionStatus, ServoTimers};
pub use field::{Field, FieldKind, FieldType, Message, layout_of};
pub use gps::{GpsPosition, GpsVelocity, RawGps};
pub use ground::GroundMessage;
pub use hil::{Custom, SimulatorLink};
pub use imu::{Acceleration, Magnetization, Pressure, Rates, RawAnalog};
pub use link::LinkStatus;
pub use rate::{Rate, Watch};
pub use state::State;
pub use telemetry::TelemetryMessage;

/// What the executive, the recorder and the command line need to know of a message type.
#[derive(Debug, Clone, Copy)]
pub struct MessageType {
    /// The name that `schedule.toml` uses.
    pub name: &'static str,
    /// Bytes in a port.
    pub size: usize,
    /// The fields in order.
    pub fields: &'static [Field],
}

impl MessageType {
    const fn of<T: Message>() -> Self {
        Self { name: T::NAME, size: size_of::<T>(), fields: T::FIELDS }
    }
}

/// Every message type that a port can carry. Add yours here, and `schedule.toml` may name it.
pub const CATALOGUE: &[MessageType] = &[
    MessageType::of::<Rate>(),
    MessageType::of::<RawGps>(),
    MessageType::of::<RawAnalog>(),
    MessageType::of::<Custom>(),
    MessageType::of::<GpsPosition>(),
    MessageType::of::<GpsVelocity>(),
    MessageType::of::<Acceleration>(),
    MessageType::of::<Rates>(),
    MessageType::of::<Magnetization>(),
    MessageType::of::<Pressure>(),
    MessageType::of::<State>(),
    MessageType::of::<ActuatorCommand>(),
    MessageType::of::<ServoTimers>(),
    MessageType::of::<FunctionStatus>(),
    MessageType::of::<SimulatorLink>(),
    MessageType::of::<GroundMessage>(),
    MessageType::of::<TelemetryMessage>(),
    MessageType::of::<LinkStatus>(),
];

/// The message type called `name`, exactly as written.
pub fn find(name: &str) -> Option<&'static MessageType> {
    CATALOGUE.iter().find(|message| message.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_is_described_from_its_first_to_its_last_byte() {
        for message in CATALOGUE {
            let mut end = 0;
            for field in message.fields {
                assert_eq!(field.offset, end, "{}.{} leaves a hole", message.name, field.name);
                end += field.kind.size() * field.count;
            }
            assert_eq!(end, message.size, "{} is longer than its fields", message.name);
        }
    }

    #[test]
    fn names_are_unique() {
        for (index, message) in CATALOGUE.iter().enumerate() {
            assert!(CATALOGUE[..index].iter().all(|other| other.name != message.name));
        }
    }
}
