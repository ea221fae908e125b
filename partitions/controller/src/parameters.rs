//! What the ground can read of this function, and set: the plan's attributes, the gains and limits of the laws, the aircraft.
//!
//! Settable ones come first (see [`bateleur_messages::parameter::Parameters`]). A new one goes behind the last settable, so
//! that retained memory of an older program is not taken for another parameter.

use bateleur_flight::airframe::{Airframe, Propeller, Propulsion};
use bateleur_flight::atmosphere::SEA_LEVEL_DENSITY_KGPM3;
use bateleur_flight::control::inner::{Signals, axial_gains, lateral_gains, normal_gains, roll_gains};
use bateleur_flight::control::takeoff::Method;
use bateleur_flight::guidance::{Corner, Finish};
use bateleur_messages::parameter::{Changed, Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_CONTROLLER;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::fence::{Fence, FenceAction};
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
    Parameters::new(FROM_CONTROLLER, ROWS)
}

/// Length of a cycle for which gains are told, s: the usual one.
const CYCLE_S: f64 = 0.02;

/// A number of the settings that can be set.
macro_rules! real {
    ($name:literal, $low:expr, $high:expr, $($place:ident).+) => {
        Row::settable($name, Kind::Real, ($low, $high), |s: &Settings| Some(s.$($place).+), |s, value| {
            s.$($place).+ = value;
            true
        })
    };
}
/// A number that is as it is.
macro_rules! fixed {
    ($name:literal, $($place:ident).+) => {
        Row::fixed($name, Kind::Real, |s: &Settings| Some(s.$($place).+))
    };
}
/// A gain that follows from the aircraft, at cruise airspeed at sea level.
macro_rules! gain {
    ($name:literal, $gains:ident, $field:ident) => {
        Row::fixed($name, Kind::Real, |s: &Settings| {
            Some($gains(&s.airframe, &s.control.inner, &cruise(s)).$field)
        })
    };
}

static ROWS: &[Row<Settings>] = &[
    // The plan's attributes.
    Row::settable("CTL_PATH", Kind::Choice, (0.0, 1.0), path, |s, value| {
        s.guidance.corner = if value == 0.0 { Corner::Fillet } else { Corner::FlyThrough };
        true
    }),
    Row::settable(
        "CTL_LAPS",
        Kind::Whole,
        (0.0, 1000.0),
        |s| Some(f64::from(s.guidance.laps)),
        |s, value| {
            s.guidance.laps = value as u32; // whole and in range
            true
        },
    ),
    // 0: from airspeed and wind.
    Row::settable(
        "CTL_RADIUS",
        Kind::Real,
        (0.0, 10_000.0),
        |s| Some(s.guidance.radius_m.unwrap_or(0.0)),
        |s, value| {
            let flown = value == 0.0 || value >= 10.0;
            if flown {
                s.guidance.radius_m = (value != 0.0).then_some(value);
            }
            flown
        },
    ),
    real!("CTL_CRUISE", 10.0, 60.0, control.cruise_mps),
    // Guidance.
    real!("CTL_RADIUS_MIN", 20.0, 1_000.0, guidance.least_radius_m),
    real!("CTL_TURN_BANK", 0.1, 0.9, guidance.turn_bank_rad),
    real!("CTL_LEAD", 0.0, 2.0, guidance.lead_s),
    // Outer loops.
    real!("CTL_ALT_P", 0.05, 1.0, control.outer.altitude_gain),
    real!("CTL_SINK_MAX", 0.5, 10.0, control.outer.descent_mps),
    real!("CTL_CLIMB_MAX", 0.5, 10.0, control.outer.climb_mps),
    real!("CTL_CLIMB_P", 0.2, 3.0, control.outer.climb_gain),
    real!("CTL_SPEED_P", 0.05, 2.0, control.outer.airspeed_gain),
    real!("CTL_BANK_P", 0.5, 5.0, control.outer.bank_gain),
    real!("CTL_ROLLRATE_MAX", 0.2, 3.0, control.outer.roll_rate_radps),
    real!("CTL_BANK_MAX", 0.2, 1.1, control.outer.bank_limit_rad),
    // Poles of the inner loops.
    real!("CTL_NORMAL_POLE", 0.5, 6.0, control.inner.normal_pole),
    real!("CTL_NORMAL_DAMP", 0.4, 1.5, control.inner.normal_damping),
    real!("CTL_YAW_DAMP", 0.0, 1.5, control.inner.yaw_damping),
    real!("CTL_LATERAL_P", 0.0, 0.1, control.inner.lateral_gain),
    real!("CTL_AXIAL_BW", 0.3, 4.0, control.inner.axial_bandwidth),
    real!("CTL_AXIAL_DAMP", 0.4, 1.5, control.inner.axial_damping),
    real!("CTL_ROLL_FAST", 4.0, 16.0, control.inner.roll_fast_pole),
    real!("CTL_ROLL_POLE", 1.0, 8.0, control.inner.roll_pole),
    real!("CTL_TAKEOFF_ALT", 20.0, 1_000.0, control.take_off_m),
    Row::settable("CTL_FINISH", Kind::Choice, (0.0, 2.0), finish, |s, value| {
        s.guidance.finish = match value {
            0.0 => Finish::Loiter,
            1.0 => Finish::Circuit,
            _ => Finish::Land,
        };
        true
    }),
    real!("CTL_LAND_ALT", 25.0, 500.0, control.landing.height_m),
    real!("CTL_LAND_SLOPE", 0.035, 0.14, control.landing.slope_rad),
    // −1: against the wind.
    Row::settable(
        "CTL_RUNWAY",
        Kind::Real,
        (-1.0, 6.3),
        |s| Some(s.control.landing.course_rad.unwrap_or(-1.0)),
        |s, value| {
            s.control.landing.course_rad = (value >= 0.0).then_some(value);
            true
        },
    ),
    // Where it may be; 0: without this limit.
    Row::settable(
        "CTL_FENCE_ACT",
        Kind::Choice,
        (0.0, 2.0),
        |s| {
            Some(match s.fence.action {
                FenceAction::None => 0.0,
                FenceAction::Loiter => 1.0,
                FenceAction::Return => 2.0,
            })
        },
        |s, value| {
            s.fence.action = match value {
                0.0 => FenceAction::None,
                1.0 => FenceAction::Loiter,
                _ => FenceAction::Return,
            };
            true
        },
    ),
    Row::settable(
        "CTL_FENCE_RADIUS",
        Kind::Real,
        (0.0, 50_000.0),
        |s| Some(s.fence.radius_m.unwrap_or(0.0)),
        |s, value| fenced(s, |fence| fence.radius_m = (value != 0.0).then_some(value)),
    ),
    Row::settable(
        "CTL_FENCE_FLOOR",
        Kind::Real,
        (0.0, 5_000.0),
        |s| Some(s.fence.floor_m.unwrap_or(0.0)),
        |s, value| fenced(s, |fence| fence.floor_m = (value != 0.0).then_some(value)),
    ),
    Row::settable(
        "CTL_FENCE_CEIL",
        Kind::Real,
        (0.0, 10_000.0),
        |s| Some(s.fence.ceiling_m.unwrap_or(0.0)),
        |s, value| fenced(s, |fence| fence.ceiling_m = (value != 0.0).then_some(value)),
    ),
    // How it leaves the ground, and comes back: as the plan says.
    Row::fixed("CTL_TAKEOFF", Kind::Choice, |s| Some(f64::from(u8::from(s.take_off == Method::Launch)))),
    fixed!("CTL_RETURN_ALT", return_m),
    // What follows from them and the aircraft.
    gain!("CTL_K_Q", normal_gains, pitch_rate),
    gain!("CTL_K_C", normal_gains, normal),
    gain!("CTL_K_E", normal_gains, integral),
    gain!("CTL_N_C", normal_gains, forward),
    gain!("CTL_K_R", lateral_gains, yaw_rate),
    gain!("CTL_K_B", lateral_gains, integral),
    Row::fixed("CTL_K_A", Kind::Real, |s| Some(axial(s).axial)),
    Row::fixed("CTL_K_EA", Kind::Real, |s| Some(axial(s).integral)),
    Row::fixed("CTL_K_T", Kind::Real, |s| Some(axial(s).slope_mps2)),
    gain!("CTL_K_P", roll_gains, roll_rate),
    gain!("CTL_K_EP", roll_gains, integral),
    gain!("CTL_N_P", roll_gains, forward),
    // The aircraft.
    fixed!("CTL_MASS", airframe.mass.mass_kg),
    fixed!("CTL_IXX", airframe.mass.inertia_xx_kgm2),
    fixed!("CTL_IYY", airframe.mass.inertia_yy_kgm2),
    fixed!("CTL_IZZ", airframe.mass.inertia_zz_kgm2),
    fixed!("CTL_WING_AREA", airframe.geometry.wing_area_m2),
    fixed!("CTL_WING_SPAN", airframe.geometry.wing_span_m),
    fixed!("CTL_CHORD", airframe.geometry.mean_chord_m),
    fixed!("CTL_LIFT_0", airframe.aerodynamics.lift_0),
    fixed!("CTL_LIFT_ALPHA", airframe.aerodynamics.lift_alpha),
    fixed!("CTL_LIFT_ELEV", airframe.aerodynamics.lift_elevator),
    fixed!("CTL_DRAG_0", airframe.aerodynamics.drag_0),
    fixed!("CTL_DRAG_INDUCED", airframe.aerodynamics.drag_induced),
    fixed!("CTL_ROLL_P", airframe.aerodynamics.roll_roll_rate),
    fixed!("CTL_ROLL_AIL", airframe.aerodynamics.roll_aileron),
    fixed!("CTL_PITCH_0", airframe.aerodynamics.pitch_0),
    fixed!("CTL_PITCH_ALPHA", airframe.aerodynamics.pitch_alpha),
    fixed!("CTL_PITCH_Q", airframe.aerodynamics.pitch_pitch_rate),
    fixed!("CTL_PITCH_ADOT", airframe.aerodynamics.pitch_alpha_rate),
    fixed!("CTL_PITCH_ELEV", airframe.aerodynamics.pitch_elevator),
    fixed!("CTL_YAW_BETA", airframe.aerodynamics.yaw_beta),
    fixed!("CTL_YAW_R", airframe.aerodynamics.yaw_yaw_rate),
    fixed!("CTL_YAW_RUD", airframe.aerodynamics.yaw_rudder),
    Row::fixed("CTL_MOTOR_KV", Kind::Real, |s| motor(s, |m| m[0])),
    Row::fixed("CTL_BATTERY_V", Kind::Real, |s| motor(s, |m| m[1])),
    Row::fixed("CTL_WINDING_OHM", Kind::Real, |s| motor(s, |m| m[2])),
    Row::fixed("CTL_IDLE_A", Kind::Real, |s| motor(s, |m| m[3])),
    Row::fixed("CTL_POWER_W", Kind::Real, |s| engine(s, |e| e[0])),
    Row::fixed("CTL_RATED_SPEED", Kind::Real, |s| engine(s, |e| e[1])),
    Row::fixed("CTL_FRICTION_NM", Kind::Real, |s| engine(s, |e| e[2])),
    Row::fixed("CTL_PROP_D", Kind::Real, |s| Some(propeller(&s.airframe).diameter_m)),
    Row::fixed("CTL_THRUST_0", Kind::Real, |s| Some(propeller(&s.airframe).thrust_0)),
    Row::fixed("CTL_THRUST_1", Kind::Real, |s| Some(propeller(&s.airframe).thrust_1)),
    Row::fixed("CTL_THRUST_2", Kind::Real, |s| Some(propeller(&s.airframe).thrust_2)),
    Row::fixed("CTL_TORQUE_0", Kind::Real, |s| Some(propeller(&s.airframe).torque_0)),
    Row::fixed("CTL_TORQUE_1", Kind::Real, |s| Some(propeller(&s.airframe).torque_1)),
    Row::fixed("CTL_TORQUE_2", Kind::Real, |s| Some(propeller(&s.airframe).torque_2)),
    Row::fixed("CTL_THRUST_LAG", Kind::Real, |s| Some(s.airframe.thrust_lag_s())),
    fixed!("CTL_SERVO_BW", airframe.servo.bandwidth_radps),
    fixed!("CTL_SERVO_DELAY", airframe.servo.delay_s),
    fixed!("CTL_AIL_MAX", airframe.servo.aileron_limit_rad),
    fixed!("CTL_ELEV_MAX", airframe.servo.elevator_limit_rad),
    fixed!("CTL_RUD_MAX", airframe.servo.rudder_limit_rad),
];

/// Another fence, where it leaves room to fly in.
fn fenced(settings: &mut Settings, change: impl FnOnce(&mut Fence)) -> bool {
    let mut fence = settings.fence;
    change(&mut fence);
    let holds = fence.check().is_ok();
    if holds {
        settings.fence = fence;
    }
    holds
}

fn path(settings: &Settings) -> Option<f64> {
    Some(match settings.guidance.corner {
        Corner::Fillet => 0.0,
        Corner::FlyThrough => 1.0,
    })
}

fn finish(settings: &Settings) -> Option<f64> {
    Some(match settings.guidance.finish {
        Finish::Loiter => 0.0,
        Finish::Circuit => 1.0,
        Finish::Land => 2.0,
    })
}

/// Level flight at cruise airspeed at sea level.
fn cruise(settings: &Settings) -> Signals {
    Signals {
        airspeed_mps: settings.control.cruise_mps,
        density_kgpm3: SEA_LEVEL_DENSITY_KGPM3,
        ..Signals::default()
    }
}

fn axial(settings: &Settings) -> bateleur_flight::control::inner::AxialGains {
    let signals = cruise(settings);
    let trim = settings.airframe.trim(signals.airspeed_mps, signals.density_kgpm3);
    axial_gains(&settings.airframe, &settings.control.inner, &signals, trim.throttle, CYCLE_S)
}

fn motor(settings: &Settings, pick: fn(&[f64; 4]) -> f64) -> Option<f64> {
    match settings.airframe.propulsion {
        Propulsion::Electric {
            motor_kv_rpm_per_v,
            battery_voltage_v,
            winding_resistance_ohm,
            no_load_current_a,
            ..
        } => Some(pick(&[motor_kv_rpm_per_v, battery_voltage_v, winding_resistance_ohm, no_load_current_a])),
        Propulsion::Piston { .. } => None,
    }
}

fn engine(settings: &Settings, pick: fn(&[f64; 3]) -> f64) -> Option<f64> {
    match settings.airframe.propulsion {
        Propulsion::Piston { power_w, rated_speed_radps, friction_torque_nm, .. } => {
            Some(pick(&[power_w, rated_speed_radps, friction_torque_nm]))
        }
        Propulsion::Electric { .. } => None,
    }
}

fn propeller(airframe: &Airframe) -> &Propeller {
    match &airframe.propulsion {
        Propulsion::Electric { propeller, .. } | Propulsion::Piston { propeller, .. } => propeller,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_apex::Attributes;
    use bateleur_messages::GroundMessage;
    use bateleur_messages::frame::Frame;
    use bateleur_messages::ground::{Order, ParameterSetting};
    use bateleur_messages::parameter::{MOST_SETTABLE, ParameterValue, name_bytes};

    fn settings() -> Settings {
        Settings::read(&mut Attributes::default()).unwrap()
    }

    fn ask(table: &mut Parameters<Settings>, settings: &mut Settings, order: Order) -> ParameterValue {
        let message =
            GroundMessage::from_frame(&Frame { letter: order.letter(), data: order.data() }).unwrap();
        let told = table.take(&message, settings, 0).unwrap().messages().last().unwrap();
        let frame = Frame { letter: told.letter, data: told.bytes().to_vec() };
        match bateleur_messages::telemetry::Telemetry::of(&frame) {
            Ok(bateleur_messages::telemetry::Telemetry::Parameter(value)) => value,
            other => panic!("{other:?}"),
        }
    }

    fn all(settings: &mut Settings) -> Vec<ParameterValue> {
        let mut table = parameters();
        let count = ask(&mut table, settings, Order::ReadParameter { of: 4, index: 0, asker: 0 }).count;
        let read = |index| ask(&mut table, settings, Order::ReadParameter { of: 4, index, asker: 0 });
        (0..count).map(read).collect()
    }

    #[test]
    fn names_are_unique_settable_ones_come_first_and_usual_values_lie_in_their_ranges() {
        let all = all(&mut settings());
        for (place, one) in all.iter().enumerate() {
            assert!(all[..place].iter().all(|other| other.name != one.name), "{}", one.name());
            assert!(one.value.is_finite() && (one.lowest..=one.highest).contains(&one.value), "{one:?}");
        }
        let last = ROWS.iter().rposition(|row| format!("{row:?}").contains("lowest")).unwrap();
        assert!(last < MOST_SETTABLE);
        assert!(all[..=last].iter().all(|one| one.settable == 1));
    }

    #[test]
    fn aircraft_with_a_motor_has_no_engine() {
        let named = |name: &str| all(&mut settings()).iter().any(|one| one.name() == name);
        assert_ne!(named("CTL_MOTOR_KV"), named("CTL_POWER_W"));
    }

    #[test]
    fn every_settable_one_takes_effect_and_both_ends_of_its_range() {
        for one in all(&mut settings()).iter().filter(|one| one.settable == 1) {
            for value in [one.lowest, one.highest] {
                let (mut settings, mut table) = (settings(), parameters());
                let setting = ParameterSetting { of: 4, asker: 0, name: one.name, value };
                let told = ask(&mut table, &mut settings, Order::SetParameter(setting));
                assert_eq!((told.value, told.refusal()), (value, None), "{}", one.name());
            }
        }
    }

    #[test]
    fn radius_too_narrow_to_fly_is_refused_and_what_stood_stands() {
        let (mut settings, mut table) = (settings(), parameters());
        let setting = ParameterSetting { of: 4, asker: 0, name: name_bytes("CTL_RADIUS"), value: 5.0 };
        let told = ask(&mut table, &mut settings, Order::SetParameter(setting));
        assert!(told.refusal().is_some());
        assert_eq!((told.value, settings.guidance.radius_m), (0.0, None));
    }
}
