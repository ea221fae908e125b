//! Aircraft that are not quite what their file says: for campaigns, and to ask what one number is worth.
//!
//! The laws keep the file; only the simulated aircraft changes. A key's draw belongs to its name, so that a key or a range
//! more never changes another key's value.

use crate::airframe::{Airframe, AirframeError};
use crate::fault::share;
use crate::noise::Noise;
use crate::words::unknown;
use std::str::FromStr;
use thiserror::Error;
use toml::{Table, Value};

/// Largest variation, as a share: beyond it an aircraft is another one.
const WIDEST: f64 = 0.5;
/// Keys of the aerodynamics that are no derivatives: where and how sharply the flow separates.
const SEPARATION: &str = "stall_";

/// How far each group of numbers may be off, as a share: 0.1 is ±10 %. Zero leaves a group as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ranges {
    /// Mass.
    pub mass: f64,
    /// Moments and product of inertia.
    pub inertia: f64,
    /// Every derivative in `[aerodynamics]`, the stall left out.
    pub derivatives: f64,
    /// Battery voltage or engine power.
    pub power: f64,
    /// Bandwidth of the servos.
    pub servo: f64,
}

/// Why an aircraft could not be varied.
#[derive(Debug, Error)]
pub enum VariationError {
    /// What was asked for makes no sense. The message says how to mend it.
    #[error("{0}")]
    Asked(String),
    /// What came out makes no sense.
    #[error(transparent)]
    Airframe(#[from] AirframeError),
}

/// One number of the aircraft set or scaled: `mass.mass_kg=12`, `aerodynamics.lift_alpha=x0.8`.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Section and key, joined by dots as in the airframe file.
    pub key: String,
    /// The number, or what it is multiplied by.
    pub to: To,
}

/// What becomes of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum To {
    /// This.
    Value(f64),
    /// So many times what it was.
    Times(f64),
}

impl Ranges {
    /// What campaigns fly: mass and inertia ±10 %, derivatives ±20 %.
    pub const CAMPAIGN: Self = Self { mass: 0.1, inertia: 0.1, derivatives: 0.2, power: 0.0, servo: 0.0 };

    /// The range of a key; `None` if it is not varied.
    fn of(&self, section: &str, key: &str) -> f64 {
        match (section, key) {
            ("mass", "mass_kg") => self.mass,
            ("mass", _) => self.inertia,
            ("aerodynamics", key) if !key.starts_with(SEPARATION) => self.derivatives,
            ("propulsion", "battery_voltage_v" | "power_w") => self.power,
            ("servo", "bandwidth_radps") => self.servo,
            _ => 0.0,
        }
    }
}

impl FromStr for Ranges {
    type Err = VariationError;

    /// Reads `mass=10%,derivatives=20%`; what is not named is not varied.
    fn from_str(text: &str) -> Result<Self, VariationError> {
        let mut ranges = Self::default();
        for part in text.split(',') {
            let wrong = || {
                VariationError::Asked(format!(
                    "`{part}` is no variation: write mass=10%,derivatives=20%, 50% at most"
                ))
            };
            let (group, range) = part.split_once('=').ok_or_else(wrong)?;
            let range = share(range).filter(|range| (0.0..=WIDEST).contains(range)).ok_or_else(wrong)?;
            let groups = ["mass", "inertia", "derivatives", "power", "servo"];
            let place = match group.trim() {
                "mass" => &mut ranges.mass,
                "inertia" => &mut ranges.inertia,
                "derivatives" => &mut ranges.derivatives,
                "power" => &mut ranges.power,
                "servo" => &mut ranges.servo,
                other => return Err(VariationError::Asked(unknown("variation", other, groups.into_iter()))),
            };
            *place = range;
        }
        Ok(ranges)
    }
}

impl std::fmt::Display for Ranges {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { mass, inertia, derivatives, power, servo } = self;
        write!(f, "mass={mass},inertia={inertia},derivatives={derivatives},power={power},servo={servo}")
    }
}

impl FromStr for Change {
    type Err = VariationError;

    fn from_str(text: &str) -> Result<Self, VariationError> {
        let wrong = || {
            VariationError::Asked(format!(
                "`{text}` is no change: write mass.mass_kg=12, or aerodynamics.lift_alpha=x0.8 for a factor"
            ))
        };
        let (key, value) = text.split_once('=').ok_or_else(wrong)?;
        let number = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite());
        let to = match value.strip_prefix('x') {
            Some(factor) => To::Times(number(factor).ok_or_else(wrong)?),
            None => To::Value(number(value).ok_or_else(wrong)?),
        };
        Ok(Self { key: key.trim().to_owned(), to })
    }
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.to {
            To::Value(value) => write!(f, "{}={value}", self.key),
            To::Times(factor) => write!(f, "{}=x{factor}", self.key),
        }
    }
}

/// An aircraft drawn about a given one: each number of a group even within its range, by the seed.
///
/// # Errors
/// When what was drawn makes no sense as an aircraft.
pub fn vary(airframe: &Airframe, seed: u64, ranges: &Ranges) -> Result<Airframe, VariationError> {
    let mut table = table(airframe)?;
    for (section, entry) in &mut table {
        let Value::Table(keys) = entry else { continue };
        for (key, value) in keys {
            let range = ranges.of(section, key);
            if let (Value::Float(number), true) = (value, range > 0.0) {
                *number *= 1.0 + Noise::named(seed, &format!("{section}.{key}")).within(range);
            }
        }
    }
    airframe_of(table)
}

/// An aircraft with some of its numbers changed.
///
/// # Errors
/// When there is no such number, or what comes out makes no sense as an aircraft.
pub fn change(airframe: &Airframe, changes: &[Change]) -> Result<Airframe, VariationError> {
    let mut table = table(airframe)?;
    for change in changes {
        let number = find(&mut table, &change.key)?;
        *number = match change.to {
            To::Value(value) => value,
            To::Times(factor) => *number * factor,
        };
    }
    airframe_of(table)
}

fn table(airframe: &Airframe) -> Result<Table, VariationError> {
    Table::try_from(airframe).map_err(|error| VariationError::Asked(error.to_string()))
}

fn airframe_of(table: Table) -> Result<Airframe, VariationError> {
    let airframe: Airframe =
        table.try_into().map_err(|error| VariationError::Airframe(AirframeError::Syntax(error)))?;
    airframe.check()?;
    Ok(airframe)
}

fn find<'t>(table: &'t mut Table, path: &str) -> Result<&'t mut f64, VariationError> {
    let numbers = paths(table, "");
    if !numbers.iter().any(|number| number == path) {
        let names = numbers.iter().map(String::as_str);
        return Err(VariationError::Asked(unknown("number", path, names)));
    }
    let missing = || VariationError::Asked(format!("there is no number `{path}`"));
    let mut keys = path.split('.');
    let mut value = keys.next().and_then(|key| table.get_mut(key));
    for key in keys {
        value = value.and_then(|value| value.as_table_mut()).and_then(|table| table.get_mut(key));
    }
    match value {
        Some(Value::Float(number)) => Ok(number),
        _ => Err(missing()),
    }
}

/// Paths of all numbers in a table.
fn paths(table: &Table, before: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            Value::Float(_) => found.push(format!("{before}{key}")),
            Value::Table(inner) => found.extend(paths(inner, &format!("{before}{key}."))),
            _ => {}
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(airframe: &Airframe) -> Vec<(String, f64)> {
        let mut table = table(airframe).unwrap();
        paths(&table.clone(), "")
            .into_iter()
            .map(|path| (path.clone(), *find(&mut table, &path).unwrap()))
            .collect()
    }

    #[test]
    fn nothing_asked_for_changes_nothing() {
        let airframe = Airframe::rascal110();
        assert_eq!(vary(&airframe, 5, &Ranges::default()).unwrap(), airframe);
        assert_eq!(change(&airframe, &[]).unwrap(), airframe);
    }

    #[test]
    fn drawn_aircraft_stay_within_their_ranges_and_spread_over_them() {
        let airframe = Airframe::aerosonde();
        let given = numbers(&airframe);
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for seed in 0..200 {
            for ((path, was), (_, is)) in
                given.iter().zip(numbers(&vary(&airframe, seed, &Ranges::CAMPAIGN).unwrap()))
            {
                let factor = if *was == 0.0 { 1.0 } else { is / was };
                let range = match path.split_once('.').unwrap() {
                    ("mass", _) => 0.1,
                    ("aerodynamics", key) if !key.starts_with("stall") => 0.2,
                    _ => 0.0,
                };
                assert!((factor - 1.0).abs() <= range + 1e-12, "{path} times {factor}");
                if path == "aerodynamics.lift_alpha" {
                    (least, most) = (least.min(factor), most.max(factor));
                }
            }
        }
        assert!(least < 0.82 && most > 1.18, "{least} to {most}");
    }

    #[test]
    fn same_seed_is_the_same_aircraft_and_a_range_more_shifts_no_other() {
        let airframe = Airframe::aerosonde();
        let drawn = |seed, ranges| vary(&airframe, seed, &ranges).unwrap();
        assert_eq!(drawn(3, Ranges::CAMPAIGN), drawn(3, Ranges::CAMPAIGN));
        assert_ne!(drawn(3, Ranges::CAMPAIGN), drawn(4, Ranges::CAMPAIGN));
        let only_mass = drawn(3, Ranges { mass: 0.1, ..Ranges::default() });
        assert_eq!(only_mass.mass.mass_kg, drawn(3, Ranges::CAMPAIGN).mass.mass_kg);
    }

    #[test]
    fn one_number_is_set_or_scaled_by_its_path() {
        let changes: Vec<Change> =
            ["mass.mass_kg=12", "propulsion.propeller.diameter_m=x0.5", "servo.backlash_rad=0.01"]
                .map(|text| text.parse().unwrap())
                .into();
        let changed = change(&Airframe::aerosonde(), &changes).unwrap();
        assert_eq!((changed.mass.mass_kg, changed.servo.backlash_rad), (12.0, 0.01));
        assert_eq!(changed.propulsion.propeller().diameter_m, 0.254);
        assert_eq!(changes[1].to_string(), "propulsion.propeller.diameter_m=x0.5");
    }

    #[test]
    fn mistakes_are_answered_with_the_way_to_mend_them() {
        let refused = |text: &str| {
            let change = text.parse::<Change>().and_then(|one| change(&Airframe::aerosonde(), &[one]));
            change.unwrap_err().to_string()
        };
        assert!(refused("mass.mas_kg=12").contains("did you mean `mass.mass_kg`"));
        assert!(refused("mass.mass_kg=-1").contains("greater than zero"));
        assert!(refused("mass.mass_kg").contains("=x0.8"));
        let range = |text: &str| text.parse::<Ranges>().unwrap_err().to_string();
        assert!(range("mas=10%").contains("did you mean `mass`"));
        assert!(range("mass=90%").contains("50% at most"));
        assert_eq!("mass=10%,inertia=0.1,derivatives=1/5".parse::<Ranges>().unwrap(), Ranges::CAMPAIGN);
    }
}
