//! What the tests of the plan share.

use std::path::PathBuf;

use bateleur_executive::plan::MessageCatalogue;

/// The message types that the schedules of the tests name, each with a size.
pub(crate) struct Table;

const NAMES: &[&str] = &[
    "Rate",
    "RawGps",
    "RawAnalog",
    "Custom",
    "GpsPosition",
    "GpsVelocity",
    "Acceleration",
    "Rates",
    "Magnetization",
    "Pressure",
    "State",
    "ActuatorCommand",
    "ServoTimers",
    "FunctionStatus",
    "GroundMessage",
    "TelemetryMessage",
];

impl MessageCatalogue for Table {
    fn size_of(&self, name: &str) -> Option<usize> {
        NAMES.contains(&name).then_some(if name == "GroundMessage" { 256 } else { 64 })
    }

    fn names(&self) -> Vec<&str> {
        NAMES.to_vec()
    }
}

/// The top of the repository.
pub(crate) fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).parent().map(PathBuf::from).unwrap_or_default()
}
