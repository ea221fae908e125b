//! The simulator link: what the messages mean in the units of the ports, in both directions.
//!
//! Signs and axes are those of the ports: body axes forward, right, down; aileron positive rolls right, elevator positive
//! pitches down, rudder positive yaws left. The whole table stands in the book, "The link to a simulator".

use bateleur_messages::hil::Actuators;
use bateleur_messages::{Custom, Range, RawAnalog, RawGps, ServoTimers};
use mavlink::dialects::common::{
    BATTERY_STATUS_DATA, DISTANCE_SENSOR_DATA, HEARTBEAT_DATA, HIL_ACTUATOR_CONTROLS_DATA, HIL_GPS_DATA,
    HIL_RC_INPUTS_RAW_DATA, HIL_SENSOR_DATA, HilActuatorControlsFlags, HilSensorUpdatedFlags, MavAutopilot,
    MavMessage, MavModeFlag, MavPowerStatus, MavSensorOrientation, MavState, MavType, POWER_STATUS_DATA,
};

/// Places in the list of controls.
const AILERON: usize = 0;
const ELEVATOR: usize = 1;
const THROTTLE: usize = 2;
const RUDDER: usize = 3;

/// Pulse of a neutral surface, µs.
const NEUTRAL_US: f32 = 1500.0;
/// From neutral to the stop, µs.
const HALF_RANGE_US: f32 = 500.0;
/// Pulse of a closed throttle, µs.
const CLOSED_US: f32 = 1000.0;
/// From closed to full throttle, µs.
const THROTTLE_RANGE_US: f32 = 1000.0;

/// Pascals in a hectopascal.
pub const PA_PER_HPA: f64 = 100.0;
/// 0 °C, K.
pub const CELSIUS_ZERO_K: f64 = 273.15;
/// `eph` and `epv` of a receiver that does not know its errors, and the voltage of a cell that is not there.
pub const UNKNOWN_U16: u16 = u16::MAX;
/// `covariance` of a range finder that does not know it.
const UNKNOWN_COVARIANCE: u8 = u8::MAX;
/// Degrees in one unit of latitude and longitude.
const DEGREES: f64 = 1e-7;
/// Errors that stand for unknown ones, m: those of an ordinary receiver.
const HORIZONTAL_ACCURACY_M: f64 = 2.5;
const VERTICAL_ACCURACY_M: f64 = 4.0;
/// The message has no place for it, m/s: that of an ordinary receiver.
const SPEED_ACCURACY_MPS: f64 = 0.1;

/// What an actuator message says that was sent on from `timers` for module time `time_usec`, µs.
pub fn actuator_controls(time_usec: u64, timers: &ServoTimers, lockstep: bool) -> MavMessage {
    let mut controls = [0.0; 16];
    controls[AILERON] = surface(mean(timers.aileron_left_us, timers.aileron_right_us));
    controls[ELEVATOR] = surface(f32::from(timers.elevator_us));
    controls[THROTTLE] = ((f32::from(timers.throttle_us) - CLOSED_US) / THROTTLE_RANGE_US).clamp(0.0, 1.0);
    controls[RUDDER] = surface(f32::from(timers.rudder_us));
    let flags = match lockstep {
        true => HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP,
        false => HilActuatorControlsFlags::empty(),
    };
    let mode = mode(timers.autopilot == 1);
    MavMessage::HIL_ACTUATOR_CONTROLS(HIL_ACTUATOR_CONTROLS_DATA { time_usec, flags, controls, mode })
}

/// What a flight computer in HIL mode says about itself once a second.
pub fn heartbeat(autopilot: bool) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_FIXED_WING,
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        base_mode: mode(autopilot),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

/// Armed, because a simulator's motors shall turn; and who flies.
fn mode(autopilot: bool) -> MavModeFlag {
    let flies = match autopilot {
        true => MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED,
        false => MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
    };
    MavModeFlag::MAV_MODE_FLAG_HIL_ENABLED | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED | flies
}

fn mean(left_us: u16, right_us: u16) -> f32 {
    0.5 * (f32::from(left_us) + f32::from(right_us))
}

fn surface(pulse_us: f32) -> f32 {
    ((pulse_us - NEUTRAL_US) / HALF_RANGE_US).clamp(-1.0, 1.0)
}

/// The simulator's side: the pulses that an actuator message stands for. What is not a number becomes no pulse.
pub fn actuators(message: &HIL_ACTUATOR_CONTROLS_DATA) -> Actuators {
    let pulse = |place: usize, zero_us: f32, range_us: f32| {
        let control = message.controls[place];
        // NaN casts to 0, which is no pulse.
        (zero_us + range_us * control.clamp(-1.0, 1.0)).round() as u16
    };
    let aileron_us = pulse(AILERON, NEUTRAL_US, HALF_RANGE_US);
    Actuators {
        module_ns: message.time_usec.saturating_mul(1_000),
        sequence: 0,
        aileron_left_us: aileron_us,
        aileron_right_us: aileron_us,
        elevator_us: pulse(ELEVATOR, NEUTRAL_US, HALF_RANGE_US),
        rudder_us: pulse(RUDDER, NEUTRAL_US, HALF_RANGE_US),
        throttle_us: pulse(THROTTLE, CLOSED_US, THROTTLE_RANGE_US),
        autopilot: u16::from(message.mode.contains(MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED)),
        reserved: 0,
    }
}

/// Every field that the simulator link uses.
pub fn all_updated() -> HilSensorUpdatedFlags {
    accelerometer() | gyroscope() | magnetometer() | pressures()
}

/// All of the accelerometer.
pub fn accelerometer() -> HilSensorUpdatedFlags {
    HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_XACC
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_YACC
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_ZACC
}

/// All of the gyroscope.
pub fn gyroscope() -> HilSensorUpdatedFlags {
    HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_XGYRO
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_YGYRO
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_ZGYRO
}

/// All of the magnetometer.
pub fn magnetometer() -> HilSensorUpdatedFlags {
    HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_XMAG
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_YMAG
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_ZMAG
}

fn pressures() -> HilSensorUpdatedFlags {
    HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_ABS_PRESSURE
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_DIFF_PRESSURE
        | HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_TEMPERATURE
}

/// The fields of a sensor set that hold numbers: what a sensor could not measure is none.
fn measured(analog: &RawAnalog) -> HilSensorUpdatedFlags {
    let finite = |vector: &[f64; 3]| vector.iter().all(|value| value.is_finite());
    let groups = [
        (finite(&analog.specific_force_mps2), accelerometer()),
        (finite(&analog.rates_radps), gyroscope()),
        (finite(&analog.field_gauss), magnetometer()),
        (analog.static_pressure_pa.is_finite(), HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_ABS_PRESSURE),
        (
            analog.differential_pressure_pa.is_finite(),
            HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_DIFF_PRESSURE,
        ),
        (analog.temperature_k.is_finite(), HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_TEMPERATURE),
    ];
    let there = groups.into_iter().filter(|(measured, _)| *measured);
    there.fold(HilSensorUpdatedFlags::empty(), |all, (_, flags)| all | flags)
}

/// The simulator's side: a whole sensor set. What is not a number is marked as not updated.
pub fn sensor(analog: &RawAnalog) -> MavMessage {
    let [xacc, yacc, zacc] = analog.specific_force_mps2.map(|value| value as f32);
    let [xgyro, ygyro, zgyro] = analog.rates_radps.map(|value| value as f32);
    let [xmag, ymag, zmag] = analog.field_gauss.map(|value| value as f32);
    MavMessage::HIL_SENSOR(HIL_SENSOR_DATA {
        time_usec: analog.measured_ns / 1_000,
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag,
        ymag,
        zmag,
        abs_pressure: (analog.static_pressure_pa / PA_PER_HPA) as f32,
        diff_pressure: (analog.differential_pressure_pa / PA_PER_HPA) as f32,
        temperature: (analog.temperature_k - CELSIUS_ZERO_K) as f32,
        fields_updated: measured(analog),
        ..HIL_SENSOR_DATA::DEFAULT
    })
}

/// The simulator's side: a fix.
pub fn fix(gps: &RawGps) -> MavMessage {
    let [north, east, down] = gps.velocity_ned_mps;
    let speed = north.hypot(east);
    // Casts from floating point saturate.
    MavMessage::HIL_GPS(HIL_GPS_DATA {
        time_usec: gps.measured_ns / 1_000,
        fix_type: gps.fix as u8, // 0 to 3
        lat: (gps.latitude_rad.to_degrees() / DEGREES).round() as i32,
        lon: (gps.longitude_rad.to_degrees() / DEGREES).round() as i32,
        alt: (gps.altitude_m * 1e3).round() as i32,
        eph: (gps.horizontal_accuracy_m * 1e2).round() as u16,
        epv: (gps.vertical_accuracy_m * 1e2).round() as u16,
        vel: (speed * 1e2).round() as u16,
        vn: (north * 1e2).round() as i16,
        ve: (east * 1e2).round() as i16,
        vd: (down * 1e2).round() as i16,
        cog: (east.atan2(north).to_degrees().rem_euclid(360.0) * 1e2).round() as u16 % 36_000,
        satellites_visible: gps.satellites.min(254) as u8,
        ..HIL_GPS_DATA::DEFAULT
    })
}

/// The fix in a message, true at module time `measured_ns`.
pub fn raw_gps(message: &HIL_GPS_DATA, measured_ns: u64) -> RawGps {
    let metres = |value: u16, unknown_m: f64| match value {
        UNKNOWN_U16 => unknown_m,
        value => f64::from(value) * 1e-2,
    };
    RawGps {
        measured_ns,
        latitude_rad: (f64::from(message.lat) * DEGREES).to_radians(),
        longitude_rad: (f64::from(message.lon) * DEGREES).to_radians(),
        altitude_m: f64::from(message.alt) * 1e-3,
        velocity_ned_mps: [message.vn, message.ve, message.vd].map(|speed| f64::from(speed) * 1e-2),
        horizontal_accuracy_m: metres(message.eph, HORIZONTAL_ACCURACY_M),
        vertical_accuracy_m: metres(message.epv, VERTICAL_ACCURACY_M),
        speed_accuracy_mps: SPEED_ACCURACY_MPS,
        satellites: if message.satellites_visible == u8::MAX { 0 } else { message.satellites_visible.into() },
        // What is better than three dimensions (differential, real-time kinematic) is told as three.
        fix: u32::from(message.fix_type).min(3),
    }
}

/// The simulator's side: a distance to the ground.
pub fn distance(range: &Range) -> MavMessage {
    let centimetres = |metres: f64| (metres * 1e2).round() as u16; // saturates
    MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
        time_boot_ms: (range.measured_ns / 1_000_000) as u32, // after 49 days anew
        min_distance: centimetres(range.least_m),
        max_distance: centimetres(range.most_m),
        current_distance: centimetres(range.distance_m),
        orientation: MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270,
        covariance: UNKNOWN_COVARIANCE,
        ..DISTANCE_SENSOR_DATA::DEFAULT
    })
}

/// The distance to the ground in a message that came in the window of module time `measured_ns`; nothing where the sensor looks elsewhere. A
/// longest distance of 0 is none.
pub fn range(message: &DISTANCE_SENSOR_DATA, measured_ns: u64) -> Option<Range> {
    let metres = |centimetres: u16| f64::from(centimetres) * 1e-2;
    let most = if message.max_distance == 0 { u16::MAX } else { message.max_distance };
    let down = message.orientation == MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270;
    down.then(|| Range {
        measured_ns,
        distance_m: metres(message.current_distance),
        least_m: metres(message.min_distance),
        most_m: metres(most),
    })
}

/// The simulator's side: the safety pilot's sticks.
pub fn sticks(custom: &Custom) -> MavMessage {
    MavMessage::HIL_RC_INPUTS_RAW(HIL_RC_INPUTS_RAW_DATA {
        time_usec: custom.measured_ns / 1_000,
        chan1_raw: custom.pilot_aileron_us,
        chan2_raw: custom.pilot_elevator_us,
        chan3_raw: custom.pilot_throttle_us,
        chan4_raw: custom.pilot_rudder_us,
        chan5_raw: UNKNOWN_U16,
        chan6_raw: UNKNOWN_U16,
        chan7_raw: UNKNOWN_U16,
        chan8_raw: UNKNOWN_U16,
        chan9_raw: UNKNOWN_U16,
        chan10_raw: UNKNOWN_U16,
        chan11_raw: UNKNOWN_U16,
        chan12_raw: UNKNOWN_U16,
        rssi: u8::MAX,
    })
}

/// Numbers of the two batteries.
pub const MAIN_BATTERY: u8 = 0;
/// The battery that takes over.
pub const BACKUP_BATTERY: u8 = 1;

/// The simulator's side: a battery by its number.
pub fn battery(id: u8, volts: f64) -> MavMessage {
    let mut voltages = [UNKNOWN_U16; 10];
    voltages[0] = (volts * 1e3).round() as u16;
    MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA {
        id,
        voltages,
        temperature: i16::MAX,
        current_battery: -1,
        current_consumed: -1,
        energy_consumed: -1,
        battery_remaining: -1,
        ..BATTERY_STATUS_DATA::DEFAULT
    })
}

/// The voltage of all cells, V; `None` if no cell is known.
pub fn battery_v(message: &BATTERY_STATUS_DATA) -> Option<f64> {
    let cells = message.voltages.iter().filter(|cell| **cell != UNKNOWN_U16);
    let further = message.voltages_ext.iter().filter(|cell| **cell != 0 && **cell != UNKNOWN_U16);
    let (count, millivolts) =
        cells.chain(further).fold((0, 0_u32), |(count, sum), cell| (count + 1, sum + u32::from(*cell)));
    (count > 0).then_some(f64::from(millivolts) * 1e-3)
}

/// The simulator's side: the supply of the actuator board.
pub fn board_supply(volts: f64) -> MavMessage {
    MavMessage::POWER_STATUS(POWER_STATUS_DATA {
        Vcc: (volts * 1e3).round() as u16,
        Vservo: (volts * 1e3).round() as u16,
        flags: MavPowerStatus::empty(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMERS: ServoTimers = ServoTimers {
        aileron_left_us: 1700,
        aileron_right_us: 1700,
        elevator_us: 1250,
        rudder_us: 1501,
        throttle_us: 1690,
        autopilot: 1,
        cycle: 5,
    };

    #[test]
    fn pulses_come_back_exactly_as_they_went() {
        for autopilot in [0, 1] {
            let timers = ServoTimers { autopilot, ..TIMERS };
            let MavMessage::HIL_ACTUATOR_CONTROLS(message) = actuator_controls(20_500, &timers, true) else {
                panic!()
            };
            let back = actuators(&message);
            assert_eq!(back, Actuators::new(20_500_000, 0, &timers));
        }
    }

    #[test]
    fn every_pulse_survives() {
        for pulse_us in 1000..=2000 {
            let timers = ServoTimers { elevator_us: pulse_us, throttle_us: pulse_us, ..TIMERS };
            let MavMessage::HIL_ACTUATOR_CONTROLS(message) = actuator_controls(1, &timers, false) else {
                panic!()
            };
            let back = actuators(&message);
            assert_eq!((back.elevator_us, back.throttle_us), (pulse_us, pulse_us));
        }
    }

    #[test]
    fn what_is_not_a_number_is_no_pulse() {
        let message =
            HIL_ACTUATOR_CONTROLS_DATA { controls: [f32::NAN; 16], ..HIL_ACTUATOR_CONTROLS_DATA::DEFAULT };
        assert_eq!(actuators(&message).elevator_us, 0);
    }

    #[test]
    fn sensor_that_could_not_measure_is_marked_as_not_updated() {
        let analog = RawAnalog { field_gauss: [f64::NAN; 3], ..RawAnalog::default() };
        let MavMessage::HIL_SENSOR(message) = sensor(&analog) else { panic!() };
        assert_eq!(message.fields_updated, all_updated().difference(magnetometer()));
    }

    #[test]
    fn a_fix_comes_back_within_the_resolution_of_its_units() {
        let gps = RawGps {
            measured_ns: 5_000,
            latitude_rad: -0.6,
            longitude_rad: 0.33,
            altitude_m: 123.456,
            velocity_ned_mps: [20.123, -3.5, 0.25],
            horizontal_accuracy_m: 2.5,
            vertical_accuracy_m: 4.0,
            speed_accuracy_mps: 0.1,
            satellites: 11,
            fix: 3,
        };
        let sensed = Range { measured_ns: 5_000, distance_m: 3.21, least_m: 0.1, most_m: 50.0 };
        let MavMessage::DISTANCE_SENSOR(message) = distance(&sensed) else { panic!() };
        let back = range(&message, 5_000).unwrap();
        assert!((back.distance_m - 3.21).abs() < 0.005 && (back.most_m - 50.0).abs() < 1e-9);
        let forward = DISTANCE_SENSOR_DATA {
            orientation: MavSensorOrientation::MAV_SENSOR_ROTATION_NONE,
            ..message.clone()
        };
        let no_limits = DISTANCE_SENSOR_DATA { min_distance: 0, max_distance: 0, ..message };
        assert_eq!(range(&forward, 1), None);
        assert!(range(&no_limits, 1).unwrap().most_m > 600.0);
        let MavMessage::HIL_GPS(message) = fix(&gps) else { panic!() };
        let back = raw_gps(&message, 5_000);
        assert!((back.latitude_rad - gps.latitude_rad).abs() < 2e-9);
        assert!((back.altitude_m - gps.altitude_m).abs() < 0.001);
        assert!((back.velocity_ned_mps[0] - 20.12).abs() < 1e-9);
        assert_eq!(
            RawGps {
                latitude_rad: 0.0,
                longitude_rad: 0.0,
                altitude_m: 0.0,
                velocity_ned_mps: [0.0; 3],
                ..back
            },
            RawGps {
                latitude_rad: 0.0,
                longitude_rad: 0.0,
                altitude_m: 0.0,
                velocity_ned_mps: [0.0; 3],
                ..gps
            }
        );
        let unknown = HIL_GPS_DATA { eph: UNKNOWN_U16, satellites_visible: 255, fix_type: 6, ..message };
        let back = raw_gps(&unknown, 1);
        assert_eq!((back.horizontal_accuracy_m, back.satellites, back.fix), (2.5, 0, 3));
    }

    #[test]
    fn voltages_are_those_of_all_cells() {
        let MavMessage::BATTERY_STATUS(mut message) = battery(MAIN_BATTERY, 44.4) else { panic!() };
        assert_eq!(battery_v(&message), Some(44.4));
        (message.voltages[0], message.voltages[1]) = (65_534, 1_466);
        assert_eq!(battery_v(&message), Some(67.0));
        message.voltages = [UNKNOWN_U16; 10];
        assert_eq!(battery_v(&message), None);
    }
}
