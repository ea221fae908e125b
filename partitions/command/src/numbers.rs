//! The numbers that this function is set up with, and what the ground can read and set of them.

use bateleur_mavlink::Runway;
use bateleur_messages::parameter::{Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_COMMAND;

use crate::station::Encoding;

/// How often a ground station on MAVLink is told something, Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// ATTITUDE.
    pub attitude_hz: f64,
    /// GLOBAL_POSITION_INT, LOCAL_POSITION_NED.
    pub position_hz: f64,
    /// VFR_HUD.
    pub hud_hz: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self { attitude_hz: 10.0, position_hz: 5.0, hud_hz: 5.0 }
    }
}

/// Attributes of Command that are numbers, and its rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numbers {
    /// Symbols a second on the line.
    pub baud: u32,
    /// MAVLink is spoken.
    pub mavlink: bool,
    /// The aircraft's number there.
    pub system: u8,
    /// Where zero is.
    pub runway: Runway,
    /// How whole numbers are put into MAVLink's parameters.
    pub encoding: Encoding,
    /// How often something is told.
    pub rates: Rates,
    /// What is flown when the ground is silent: 0 nothing else, 1 a circle, 2 the way back.
    pub lost_link: u8,
    /// After how long, s.
    pub lost_link_after_s: f64,
}

/// A runway that GPS would have as well.
///
/// # Errors
/// What is wrong with it, and what to give.
pub fn sane_runway(runway: Runway) -> Result<Runway, String> {
    let is_sane = runway.latitude_deg.abs() < 85.0
        && runway.longitude_deg.abs() <= 180.0
        && (-500.0..6_000.0).contains(&runway.altitude_m);
    match is_sane {
        true => Ok(runway),
        false => Err(format!(
            "attributes origin_…: {runway:?} is no runway; give degrees within ±85 and ±180 and metres above sea level, \
             the same as GPS has"
        )),
    }
}

/// The table.
pub fn parameters() -> Parameters<Numbers> {
    Parameters::new(FROM_COMMAND, ROWS)
}

/// What the rates may be.
pub(crate) const HZ: (f64, f64) = (0.0, 50.0);

static ROWS: &[Row<Numbers>] = &[
    Row::settable(
        "CMD_RATE_ATT",
        Kind::Real,
        HZ,
        |n| spoken(n, n.rates.attitude_hz),
        |n, value| {
            n.rates.attitude_hz = value;
            true
        },
    ),
    Row::settable(
        "CMD_RATE_POS",
        Kind::Real,
        HZ,
        |n| spoken(n, n.rates.position_hz),
        |n, value| {
            n.rates.position_hz = value;
            true
        },
    ),
    Row::settable(
        "CMD_RATE_HUD",
        Kind::Real,
        HZ,
        |n| spoken(n, n.rates.hud_hz),
        |n, value| {
            n.rates.hud_hz = value;
            true
        },
    ),
    Row::fixed("CMD_BAUD", Kind::Whole, |n| Some(f64::from(n.baud))),
    Row::fixed("CMD_SYSTEM", Kind::Whole, |n| Some(f64::from(n.system))),
    Row::fixed("CMD_ORIGIN_LAT", Kind::Real, |n| Some(n.runway.latitude_deg)),
    Row::fixed("CMD_ORIGIN_LON", Kind::Real, |n| Some(n.runway.longitude_deg)),
    Row::fixed("CMD_ORIGIN_ALT", Kind::Real, |n| Some(n.runway.altitude_m)),
    Row::fixed("CMD_LOST_LINK", Kind::Choice, |n| Some(f64::from(n.lost_link))),
    Row::fixed("CMD_LOST_AFTER", Kind::Real, |n| Some(n.lost_link_after_s)),
    Row::fixed("CMD_PARAM_ENC", Kind::Choice, |n| spoken(n, f64::from(n.encoding as u8))),
];

/// A value that is of use only where MAVLink is spoken.
fn spoken(numbers: &Numbers, value: f64) -> Option<f64> {
    numbers.mavlink.then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runway_that_is_nowhere_on_earth_is_refused_as_gps_refuses_it() {
        let usual = Runway::default();
        assert_eq!(sane_runway(usual), Ok(usual));
        for runway in [
            Runway { latitude_deg: 999.0, ..usual },
            Runway { latitude_deg: f64::NAN, ..usual },
            Runway { longitude_deg: -181.0, ..usual },
            Runway { altitude_m: 9e3, ..usual },
        ] {
            assert!(sane_runway(runway).unwrap_err().contains("origin_"), "{runway:?}");
        }
    }
}
