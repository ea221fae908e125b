//! What the plan's attributes say of this function.

use bateleur_apex::{Attributes, StartError};
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::ControllerConfig;
use bateleur_flight::control::landing::LandingConfig;
use bateleur_flight::control::takeoff::Method;
use bateleur_flight::guidance::{Corner, Finish, GuidanceConfig, Step, Waypoint};

use crate::fence::{Fence, FenceAction};

/// What the plan sets.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// The aircraft.
    pub airframe: Airframe,
    /// Path and laps.
    pub guidance: GuidanceConfig,
    /// Gains, and the airspeed flown where nobody asks for another.
    pub control: ControllerConfig,
    /// How it takes off.
    pub take_off: Method,
    /// Where it may be.
    pub fence: Fence,
    /// Least height of the way back to the runway, m above it.
    pub return_m: f64,
}

impl Settings {
    /// Reads them.
    ///
    /// # Errors
    /// When an attribute has another type or a value that makes no sense.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        let airframe = airframe(attributes)?;
        Ok(Self {
            airframe,
            guidance: guidance(attributes)?.of_airframe(&airframe),
            control: control(attributes)?,
            take_off: take_off(attributes, &airframe)?,
            fence: fence(attributes)?,
            return_m: within(attributes, "return_altitude_m", 100.0, 20.0, 5_000.0)?,
        })
    }
}

/// A number within a range.
fn within(
    attributes: &mut Attributes,
    name: &str,
    usual: f64,
    least: f64,
    most: f64,
) -> Result<f64, StartError> {
    let value: f64 = attributes.get(name, usual)?;
    if (least..=most).contains(&value) {
        return Ok(value);
    }
    Err(StartError::Other(format!("attribute {name} = {value}: give {least} to {most}")))
}

/// One word of a few.
fn word<T: Copy>(
    attributes: &mut Attributes,
    name: &str,
    usual: &str,
    words: &[(&str, T)],
) -> Result<T, StartError> {
    let given: String = attributes.get(name, usual.into())?;
    words.iter().find(|(word, _)| *word == given).map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<String> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        StartError::Other(format!("attribute {name} = \"{given}\": give {}", words.join(" or ")))
    })
}

/// On its wheels, where it has some.
fn take_off(attributes: &mut Attributes, airframe: &Airframe) -> Result<Method, StartError> {
    let usual = if airframe.gear.is_some() { "roll" } else { "launch" };
    let method = word(attributes, "take_off", usual, &[("roll", Method::Roll), ("launch", Method::Launch)])?;
    if method == Method::Roll && airframe.gear.is_none() {
        return Err(StartError::Other(
            "attribute take_off = \"roll\": the airframe has no [gear]; give \"launch\"".into(),
        ));
    }
    Ok(method)
}

fn fence(attributes: &mut Attributes) -> Result<Fence, StartError> {
    let actions =
        [("none", FenceAction::None), ("loiter", FenceAction::Loiter), ("return", FenceAction::Return)];
    let fence = Fence {
        radius_m: attributes.get("fence_radius_m", None)?,
        floor_m: attributes.get("fence_floor_m", None)?,
        ceiling_m: attributes.get("fence_ceiling_m", None)?,
        action: word(attributes, "fence_action", "return", &actions)?,
    };
    fence.check().map(|()| fence).map_err(StartError::Other)
}

/// See [`Airframe::from_attribute`].
fn airframe(attributes: &mut Attributes) -> Result<Airframe, StartError> {
    let value: String = attributes.get("airframe", "aerosonde".into())?;
    Airframe::from_attribute(&value, |path| std::fs::read_to_string(path)).map_err(StartError::Other)
}

fn guidance(attributes: &mut Attributes) -> Result<GuidanceConfig, StartError> {
    let corners = [("fillet", Corner::Fillet), ("fly_through", Corner::FlyThrough)];
    let corner = word(attributes, "path", "fillet", &corners)?;
    let finishes = [("loiter", Finish::Loiter), ("circuit", Finish::Circuit), ("land", Finish::Land)];
    let finish = word(attributes, "finish", "loiter", &finishes)?;
    let radius_m: Option<f64> = attributes.get("radius_m", None)?;
    if radius_m.is_some_and(|radius_m| !(10.0..=10_000.0).contains(&radius_m)) {
        return Err(StartError::Other("attribute radius_m: give 10 to 10000 m, or leave it out".into()));
    }
    let laps = attributes.get("laps", 2)?;
    Ok(GuidanceConfig { corner, radius_m, laps, finish, ..GuidanceConfig::default() })
}

fn control(attributes: &mut Attributes) -> Result<ControllerConfig, StartError> {
    let usual = ControllerConfig::default();
    let cruise_mps = within(attributes, "cruise_mps", usual.cruise_mps, 10.0, 60.0)?;
    let take_off_m = within(attributes, "take_off_altitude_m", usual.take_off_m, 20.0, 1_000.0)?;
    let landing = landing(attributes)?;
    Ok(ControllerConfig { cruise_mps, take_off_m, landing, ..usual })
}

fn landing(attributes: &mut Attributes) -> Result<LandingConfig, StartError> {
    let usual = LandingConfig::default();
    let height_m = within(attributes, "approach_altitude_m", usual.height_m, 25.0, 500.0)?;
    let slope_deg = within(attributes, "glide_slope_deg", usual.slope_rad.to_degrees(), 2.0, 8.0)?;
    let course_deg: Option<f64> = attributes.get("runway_deg", None)?;
    if course_deg.is_some_and(|degrees| !(0.0..=360.0).contains(&degrees)) {
        return Err(StartError::Other("attribute runway_deg: give 0 to 360 °, or leave it out".into()));
    }
    let course_rad = course_deg.map(f64::to_radians);
    Ok(LandingConfig { height_m, slope_rad: slope_deg.to_radians(), course_rad })
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
        step: Step::Pass,
    };
    Ok(planned.into_iter().map(point).collect())
}
