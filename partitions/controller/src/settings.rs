//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::ControllerConfig;
use bateleur_flight::guidance::{Corner, GuidanceConfig, Waypoint};

/// What the plan sets.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// The aircraft.
    pub airframe: Airframe,
    /// Path and laps.
    pub guidance: GuidanceConfig,
    /// Gains, and the airspeed flown where nobody asks for another.
    pub control: ControllerConfig,
}

impl Settings {
    /// Reads them.
    ///
    /// # Errors
    /// When an attribute has another type or a value that makes no sense.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        Ok(Self {
            airframe: airframe(attributes)?,
            guidance: guidance(attributes)?,
            control: control(attributes)?,
        })
    }
}

/// See [`Airframe::from_attribute`].
fn airframe(attributes: &mut Attributes) -> Result<Airframe, StartError> {
    let value: String = attributes.get("airframe", "aerosonde".into())?;
    Airframe::from_attribute(&value, |path| std::fs::read_to_string(path)).map_err(StartError::Other)
}

fn guidance(attributes: &mut Attributes) -> Result<GuidanceConfig, StartError> {
    let path: String = attributes.get("path", "fillet".into())?;
    let corner = match path.as_str() {
        "fillet" => Corner::Fillet,
        "fly_through" => Corner::FlyThrough,
        other => {
            return Err(StartError::Other(format!(
                "attribute path = \"{other}\": give \"fillet\" or \"fly_through\""
            )));
        }
    };
    let radius_m: Option<f64> = attributes.get("radius_m", None)?;
    if radius_m.is_some_and(|radius_m| !(10.0..=10_000.0).contains(&radius_m)) {
        return Err(StartError::Other("attribute radius_m: give 10 to 10000 m, or leave it out".into()));
    }
    Ok(GuidanceConfig { corner, radius_m, laps: attributes.get("laps", 2)?, ..GuidanceConfig::default() })
}

fn control(attributes: &mut Attributes) -> Result<ControllerConfig, StartError> {
    let usual = ControllerConfig::default();
    let cruise_mps: f64 = attributes.get("cruise_mps", usual.cruise_mps)?;
    if !(10.0..=60.0).contains(&cruise_mps) {
        return Err(StartError::Other(format!("attribute cruise_mps = {cruise_mps}: give 10 to 60 m/s")));
    }
    Ok(ControllerConfig { cruise_mps, ..usual })
}

/// Way-points of the plan: `[north m, east m, altitude m, heading °, airspeed m/s]` each.
///
/// # Errors
/// When they are something else.
pub fn planned_waypoints(attributes: &mut Attributes) -> Result<Vec<Waypoint>, StartError> {
    let planned: Vec<[f64; 5]> = attributes.get("waypoints", Vec::new())?;
    let point = |[north_m, east_m, altitude_m, heading_deg, airspeed_mps]: [f64; 5]| Waypoint {
        north_m,
        east_m,
        altitude_m,
        airspeed_mps,
        heading_rad: heading_deg.to_radians(),
    };
    Ok(planned.into_iter().map(point).collect())
}
