//! What the ground can read of this function, and set. Settable ones come first, new ones behind the last of them.

use bateleur_messages::parameter::{Changed, Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_ESTIMATOR;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::{Kept, Settings};

/// Everything that outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Memory {
    /// The function.
    pub function: Kept,
    /// What the ground has set.
    pub parameters: Changed,
}

/// The table.
pub fn parameters() -> Parameters<Settings> {
    Parameters::new(FROM_ESTIMATOR, ROWS)
}

/// A number of the filter, as it is.
macro_rules! fixed {
    ($name:literal, $($place:ident).+) => {
        Row::fixed($name, Kind::Real, |s: &Settings| Some(s.$($place).+))
    };
}

static ROWS: &[Row<Settings>] = &[
    Row::settable(
        "EST_PRESSURE",
        Kind::Choice,
        (0.0, 1.0),
        |s| Some(f64::from(s.pressure_aiding)),
        |s, value| {
            s.pressure_aiding = value == 1.0;
            true
        },
    ),
    fixed!("EST_ORIGIN_LAT", site.latitude_deg),
    fixed!("EST_ORIGIN_LON", site.longitude_deg),
    fixed!("EST_ORIGIN_ALT", site.height_m),
    Row::fixed("EST_YEAR", Kind::Whole, |s| Some(f64::from(s.site.year))),
    Row::fixed("EST_DAY", Kind::Whole, |s| Some(f64::from(s.site.day_of_year))),
    Row::fixed("EST_FIELD_N", Kind::Real, |s| Some(s.config.field_ned_gauss.x)),
    Row::fixed("EST_FIELD_E", Kind::Real, |s| Some(s.config.field_ned_gauss.y)),
    Row::fixed("EST_FIELD_D", Kind::Real, |s| Some(s.config.field_ned_gauss.z)),
    fixed!("EST_GPS_XY", config.measurement.gps_horizontal_m),
    fixed!("EST_GPS_Z", config.measurement.gps_vertical_m),
    fixed!("EST_GPS_V", config.measurement.gps_velocity_mps),
    fixed!("EST_BARO", config.measurement.barometer_m),
    fixed!("EST_AIRSPEED", config.measurement.airspeed_mps),
    fixed!("EST_MAG", config.measurement.magnetometer_gauss),
    fixed!("EST_GATE", config.measurement.gate_sigma),
    fixed!("EST_GPS_WAIT", config.measurement.gps_patience_s),
    fixed!("EST_OTHER_WAIT", config.measurement.other_patience_s),
    fixed!("EST_LONGEST_GAP", config.longest_gap_s),
];

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_apex::Attributes;
    use bateleur_messages::GroundMessage;
    use bateleur_messages::frame::Frame;
    use bateleur_messages::ground::{Order, ParameterSetting};
    use bateleur_messages::parameter::name_bytes;

    #[test]
    fn pressure_aiding_is_switched_off_by_the_ground_and_stays_off_over_a_warm_restart() {
        let plan = Settings::read(&mut Attributes::default()).unwrap();
        let (mut settings, mut table) = (plan, parameters());
        let setting = ParameterSetting { of: 3, asker: 0, name: name_bytes("EST_PRESSURE"), value: 0.0 };
        let order = Order::SetParameter(setting);
        let message =
            GroundMessage::from_frame(&Frame { letter: order.letter(), data: order.data() }).unwrap();
        assert!(table.take(&message, &mut settings, 0).unwrap().changed);
        let (mut next, mut again) = (plan, parameters());
        again.resume(table.changed(), &mut next);
        assert!(plan.pressure_aiding && !settings.pressure_aiding && !next.pressure_aiding);
    }
}
