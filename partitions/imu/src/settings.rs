//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};

/// How long to average for a bias, ns: the noise of 50 samples is a seventh of one's.
const INITIALISE_NS: u64 = 1_000_000_000;

/// How biases are taken anew.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// How long is averaged, ns.
    pub initialise_ns: u64,
    /// The gyroscope's bias may be taken.
    pub gyro_bias: bool,
    /// The pitot tube is covered meanwhile.
    pub pitot_covered: bool,
}

impl Settings {
    /// Reads them.
    ///
    /// # Errors
    /// When an attribute has another type.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        Ok(Self {
            initialise_ns: attributes.duration_ns("initialise_time", INITIALISE_NS)?,
            gyro_bias: attributes.get("gyro_bias", true)?,
            pitot_covered: attributes.get("pitot_covered", false)?,
        })
    }
}
