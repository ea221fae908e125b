//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};
use bateleur_flight::airframe::Airframe;
use bateleur_flight::servo::ServoMap;

/// How long the last output may stand without a command, ns: ten cycles, twice what a warm restart takes.
const HOLD_NS: u64 = 200_000_000;

/// What the plan sets.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// The aircraft's travel.
    pub map: ServoMap,
    /// How long the last output may stand without a command, ns.
    pub hold_ns: u64,
}

impl Settings {
    /// Reads them.
    ///
    /// # Errors
    /// When an attribute has another type, or there is no such aircraft.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        let airframe: String = attributes.get("airframe", "aerosonde".into())?;
        // See `Airframe::from_attribute`.
        let airframe = Airframe::from_attribute(&airframe, |path| std::fs::read_to_string(path))
            .map_err(StartError::Other)?;
        Ok(Self { map: airframe.servo_map(), hold_ns: attributes.duration_ns("hold", HOLD_NS)? })
    }
}
