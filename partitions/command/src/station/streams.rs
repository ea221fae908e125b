//! What a ground station is told unasked.
//!
//! Rates are those that QGroundControl's instruments need. Everything is what the functions tell of themselves: this has no
//! sources of its own, and what nobody has told yet is not said.

use bateleur_mavlink::Runway;
use bateleur_mavlink::common::{
    ATTITUDE_DATA, BATTERY_STATUS_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA,
    EstimatorStatusFlags as Estimates, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GpsFixType,
    HEARTBEAT_DATA, HIGHRES_IMU_DATA, HOME_POSITION_DATA, HighresImuUpdatedFlags as Imu,
    LOCAL_POSITION_NED_DATA, MISSION_CURRENT_DATA, MISSION_ITEM_REACHED_DATA, MavAutopilot, MavLandedState,
    MavMessage, MavModeFlag, MavSeverity, MavState, MavSysStatusSensor as Sensor, MavType,
    NAMED_VALUE_INT_DATA, NAV_CONTROLLER_OUTPUT_DATA, SERVO_OUTPUT_RAW_DATA, SYS_STATUS_DATA,
    SYSTEM_TIME_DATA, VFR_HUD_DATA, WIND_COV_DATA,
};
use bateleur_messages::control::{NO_POWER, PITOT_NOT_BELIEVED, STALLED};
use bateleur_messages::state::STATUS_COARSE;
use bateleur_messages::telemetry::{
    GpsTelemetry, ImuTelemetry, NAVIGATION_ABORTED, NAVIGATION_AUTOPILOT, NAVIGATION_FINISHED,
    NAVIGATION_LANDED, NAVIGATION_LANDING, NAVIGATION_LOITER, NAVIGATION_ON, NAVIGATION_OUTSIDE,
    NAVIGATION_PROTECTION_SHIFT, NAVIGATION_RETURN, NAVIGATION_TAKE_OFF, Navigation, Primary, ServoTelemetry,
    StateTelemetry, Telemetry, Voltages,
};
use bateleur_messages::{SimulatorLink, State};

use super::Out;
use super::items::Items;
use crate::Rates;

const SECOND_NS: u64 = 1_000_000_000;
const UNKNOWN: u16 = u16::MAX;
/// A fix that is older when it is told is none: the receiver has lost its satellites, or is gone.
const STALE_FIX_NS: u64 = 3 * SECOND_NS;

/// What is needed of a state, from a port or from telemetry.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Motion {
    valid_ns: u64,
    position_ned_m: [f64; 3],
    velocity_ned_mps: [f64; 3],
    euler_rad: [f64; 3],
    rates_radps: [f64; 3],
    wind_ne_mps: [f64; 2],
    status: u32,
}

/// Lower and slower than this over ground the aircraft stands or rolls, m, m/s: a wing that flies is faster, one that
/// climbs is higher.
const GROUND_M: f64 = 4.0;
const GROUND_MPS: f64 = 9.0;

/// [`State::health`]: as good as it should be.
const GOOD_ATTITUDE: u64 = 16;
const GOOD_VELOCITY: u64 = 32;
const GOOD_POSITION: u64 = 64;

/// When something is due next, module time, ns.
#[derive(Debug, Clone, Copy, Default)]
struct Due(u64);

impl Due {
    fn now(&mut self, now_ns: u64, hz: f64) -> bool {
        if hz <= 0.0 || now_ns < self.0 {
            return false;
        }
        let period_ns = (SECOND_NS as f64 / hz) as u64;
        // In step with the last one, unless that is long ago.
        let late = self.0 == 0 || now_ns >= self.0 + period_ns;
        self.0 = if late { now_ns + period_ns } else { self.0 + period_ns };
        true
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Streams {
    runway: Runway,
    motion: Option<Motion>,
    /// The state comes through a port; telemetry's is older.
    has_port: bool,
    primary: Option<Primary>,
    navigation: Option<Navigation>,
    imu: Option<ImuTelemetry>,
    servo: Option<ServoTelemetry>,
    volts: Option<Voltages>,
    /// The last fix that was told was fresh.
    fixed: bool,
    /// Module time of the last window, ns.
    now_ns: u64,
    /// The last state as the port gave it.
    estimate: Option<State>,
    heartbeat: Due,
    status: Due,
    attitude: Due,
    position: Due,
    hud: Due,
    home: Due,
}

impl Streams {
    pub(super) fn new(runway: Runway) -> Self {
        Self {
            runway,
            motion: None,
            has_port: false,
            primary: None,
            navigation: None,
            imu: None,
            servo: None,
            volts: None,
            fixed: false,
            now_ns: 0,
            estimate: None,
            heartbeat: Due::default(),
            status: Due::default(),
            attitude: Due::default(),
            position: Due::default(),
            hud: Due::default(),
            home: Due::default(),
        }
    }

    /// The estimated state, as the other functions have it.
    pub(super) fn state(&mut self, state: &State) {
        self.has_port = true;
        self.estimate = Some(*state);
        self.motion = Some(Motion {
            valid_ns: state.valid_ns,
            position_ned_m: state.position_ned_m,
            velocity_ned_mps: state.velocity_ned_mps,
            euler_rad: state.euler_rad,
            rates_radps: state.rates_radps,
            wind_ne_mps: state.wind_ne_mps,
            status: state.status,
        });
    }

    /// Takes what a function tells; says at once what came in its own rhythm.
    pub(super) fn telemetry(&mut self, telemetry: &Telemetry, items: &Items, out: &mut Out) {
        match telemetry {
            Telemetry::Primary(primary) => self.primary(primary, out),
            Telemetry::Voltages(volts) => {
                self.volts = Some(*volts);
                out.say(&battery(volts));
            }
            Telemetry::Gps(gps) => {
                self.fixed = self.now_ns.saturating_sub(gps.measured_ns) <= STALE_FIX_NS;
                out.say(&raw_fix(gps, self.fixed));
            }
            Telemetry::Imu(imu) => {
                self.imu = Some(*imu);
                out.say(&inertial(imu));
            }
            Telemetry::State(state) => self.told(state, out),
            Telemetry::Navigation(navigation) => self.navigation(navigation, items, out),
            Telemetry::Servo(servo) => {
                self.servo = Some(*servo);
                out.say(&pulses(servo));
            }
            Telemetry::Simulator(link) => hil_link(link).iter().for_each(|counter| out.say(counter)),
            Telemetry::Loops(_)
            | Telemetry::Acknowledge(_)
            | Telemetry::Parameter(_)
            | Telemetry::Health(_) => {}
        }
    }

    /// Says what is due.
    pub(super) fn window(&mut self, now_ns: u64, rates: &Rates, items: &Items, out: &mut Out) {
        self.now_ns = now_ns;
        if self.heartbeat.now(now_ns, 1.0) {
            out.say(&self.heartbeat());
            let time_boot_ms = milliseconds(now_ns);
            out.say(&MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_boot_ms, ..SYSTEM_TIME_DATA::DEFAULT }));
        }
        if self.status.now(now_ns, 1.0) {
            out.say(&self.health());
            out.say(&self.landed());
            self.estimate.iter().for_each(|state| out.say(&estimates(state)));
            if let Some(navigation) = &self.navigation {
                let seq = items.place_of(navigation.next_waypoint);
                out.say(&MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
                    seq,
                    total: items.count(),
                    ..MISSION_CURRENT_DATA::DEFAULT
                }));
            }
        }
        if self.home.now(now_ns, 0.1) {
            out.say(&self.home_position());
        }
        let Some(motion) = self.motion.filter(|motion| motion.status >= STATUS_COARSE) else { return };
        if self.attitude.now(now_ns, rates.attitude_hz) {
            out.say(&attitude(&motion));
        }
        if self.position.now(now_ns, rates.position_hz) {
            out.say(&self.global_position(&motion));
            out.say(&local_position(&motion));
        }
        if self.hud.now(now_ns, rates.hud_hz) {
            out.say(&self.instruments(&motion));
        }
    }

    /// What HEARTBEAT says, also on request.
    pub(super) fn mode(&self) -> MavModeFlag {
        let navigation = self.navigation.map_or(0, |navigation| navigation.flags);
        let autopilot = navigation & NAVIGATION_AUTOPILOT != 0;
        let mut mode = match autopilot {
            true => MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED,
            false => MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
        };
        mode.set(MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED, navigation & NAVIGATION_ON != 0);
        mode.set(
            MavModeFlag::MAV_MODE_FLAG_HIL_ENABLED,
            self.primary.is_some_and(|primary| primary.hil == 1),
        );
        mode
    }

    pub(super) fn home_position(&self) -> MavMessage {
        let (latitude, longitude) = self.runway.units(0.0, 0.0);
        MavMessage::HOME_POSITION(HOME_POSITION_DATA {
            latitude,
            longitude,
            altitude: (self.runway.altitude_m * 1e3).round() as i32,
            q: [1.0, 0.0, 0.0, 0.0],
            ..HOME_POSITION_DATA::DEFAULT
        })
    }

    fn heartbeat(&self) -> MavMessage {
        let estimates = self.motion.is_some_and(|motion| motion.status >= STATUS_COARSE);
        let autopilot = self.mode().contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_FIXED_WING,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            base_mode: self.mode(),
            system_status: match (estimates, autopilot) {
                (false, true) => MavState::MAV_STATE_CRITICAL,
                (false, false) => MavState::MAV_STATE_CALIBRATING,
                (true, true) => MavState::MAV_STATE_ACTIVE,
                (true, false) => MavState::MAV_STATE_STANDBY,
            },
            mavlink_version: 3,
        })
    }

    fn landed(&self) -> MavMessage {
        let landed_state = match self.motion.filter(|motion| motion.status >= STATUS_COARSE) {
            None => MavLandedState::MAV_LANDED_STATE_UNDEFINED,
            Some(motion) => {
                let [north_mps, east_mps, _] = motion.velocity_ned_mps;
                let low = -motion.position_ned_m[2] < GROUND_M;
                match low && north_mps.hypot(east_mps) < GROUND_MPS {
                    true => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
                    false => MavLandedState::MAV_LANDED_STATE_IN_AIR,
                }
            }
        };
        MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state,
            ..EXTENDED_SYS_STATE_DATA::DEFAULT
        })
    }

    fn health(&self) -> MavMessage {
        let sensors = Sensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
            | Sensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | Sensor::MAV_SYS_STATUS_SENSOR_3D_MAG
            | Sensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
            | Sensor::MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE
            | Sensor::MAV_SYS_STATUS_SENSOR_GPS;
        let all = sensors | Sensor::MAV_SYS_STATUS_AHRS;
        let mut health = Sensor::empty();
        health.set(sensors, self.primary.is_none_or(|primary| primary.hil == 0 || primary.hil_ready == 1));
        if !self.fixed {
            health.remove(Sensor::MAV_SYS_STATUS_SENSOR_GPS);
        }
        self.remove_what_is_not_taken(&mut health);
        health.set(
            Sensor::MAV_SYS_STATUS_AHRS,
            self.primary.is_some_and(|primary| primary.estimator_ready == 1),
        );
        MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            onboard_control_sensors_present: all,
            onboard_control_sensors_enabled: all,
            onboard_control_sensors_health: health,
            voltage_battery: self.volts.map_or(UNKNOWN, |volts| millivolts(volts.main_v)),
            current_battery: -1,
            battery_remaining: -1,
            ..SYS_STATUS_DATA::DEFAULT
        })
    }

    /// In the air, a sensor that the filter does not take is not healthy. The pitot is not needed below flying speed.
    fn remove_what_is_not_taken(&self, health: &mut Sensor) {
        let Some(state) = &self.estimate else { return };
        let [north_mps, east_mps, down_mps] = state.velocity_ned_mps;
        let flies =
            -state.position_ned_m[2] > GROUND_M && north_mps.hypot(east_mps).hypot(down_mps) > GROUND_MPS;
        if !flies || state.status < STATUS_COARSE {
            return;
        }
        for (bit, sensor) in [
            (1, Sensor::MAV_SYS_STATUS_SENSOR_GPS),
            (2, Sensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE),
            (4, Sensor::MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE),
            (8, Sensor::MAV_SYS_STATUS_SENSOR_3D_MAG),
        ] {
            if state.health & bit == 0 {
                health.remove(sensor);
            }
        }
    }

    fn primary(&mut self, primary: &Primary, out: &mut Out) {
        if let Some(before) = self.primary.replace(*primary) {
            let on_hil = primary.hil == 1 && before.hil == 1;
            for (now, then, gone, back) in [
                (primary.hil_ready, before.hil_ready, "simulator does not answer", "simulator answers"),
                (
                    primary.estimator_ready,
                    before.estimator_ready,
                    "no usable state estimate",
                    "state estimate usable",
                ),
            ] {
                match (now, then) {
                    (0, 1) if on_hil => out.text(MavSeverity::MAV_SEVERITY_CRITICAL, gone),
                    (1, 0) => out.text(MavSeverity::MAV_SEVERITY_NOTICE, back),
                    _ => {}
                }
            }
        }
    }

    fn told(&mut self, state: &StateTelemetry, out: &mut Out) {
        let [wind_x, wind_y] = state.wind_ne_mps.map(|wind| wind as f32);
        out.say(&MavMessage::WIND_COV(WIND_COV_DATA {
            time_usec: state.valid_ns / 1_000,
            wind_x,
            wind_y,
            wind_alt: -state.position_ned_m[2] as f32,
            ..WIND_COV_DATA::DEFAULT
        }));
        if !self.has_port {
            self.motion = Some(Motion {
                valid_ns: state.valid_ns,
                position_ned_m: state.position_ned_m,
                velocity_ned_mps: state.velocity_ned_mps,
                euler_rad: state.euler_rad,
                rates_radps: self.imu.map_or([0.0; 3], |imu| imu.rates_radps),
                wind_ne_mps: state.wind_ne_mps,
                status: state.status,
            });
        }
    }

    fn navigation(&mut self, navigation: &Navigation, items: &Items, out: &mut Out) {
        let before = self.navigation.replace(*navigation);
        let height_m = self.motion.map(|motion| -motion.position_ned_m[2]);
        let airspeed_mps = self.airspeed_mps();
        out.say(&MavMessage::NAV_CONTROLLER_OUTPUT(NAV_CONTROLLER_OUTPUT_DATA {
            nav_roll: navigation.bank_reference_rad.to_degrees() as f32,
            alt_error: height_m.map_or(0.0, |height_m| navigation.altitude_reference_m - height_m) as f32,
            aspd_error: airspeed_mps.map_or(0.0, |mps| navigation.airspeed_reference_mps - mps) as f32,
            xtrack_error: navigation.cross_track_m as f32,
            ..NAV_CONTROLLER_OUTPUT_DATA::DEFAULT
        }));
        let Some(before) = before else { return };
        if navigation.waypoints_reached > before.waypoints_reached {
            let seq = items.place_of(before.next_waypoint);
            out.say(&MavMessage::MISSION_ITEM_REACHED(MISSION_ITEM_REACHED_DATA { seq }));
            out.text(MavSeverity::MAV_SEVERITY_INFO, &format!("way-point {} reached", before.next_waypoint));
        }
        let turned = |bit: u32| (navigation.flags & bit != 0, before.flags & bit != 0);
        for (bit, on, off) in [
            (NAVIGATION_AUTOPILOT, "the autopilot flies", "the safety pilot flies"),
            (NAVIGATION_ON, "navigation is on", "navigation is off"),
            (NAVIGATION_FINISHED, "the laps are flown", "the laps begin"),
            (NAVIGATION_LOITER, "it circles", "the circle is left"),
            (NAVIGATION_RETURN, "it flies back to the runway", "it flies back no more"),
            (NAVIGATION_TAKE_OFF, "taking off", "the take-off is over"),
            (NAVIGATION_LANDING, "landing", ""),
            (NAVIGATION_LANDED, "landed", ""),
            (PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT, "", "the pitot is believed again"),
            (NO_POWER << NAVIGATION_PROTECTION_SHIFT, "", "the motor drives again"),
        ] {
            match turned(bit) {
                (true, false) if !on.is_empty() => out.text(MavSeverity::MAV_SEVERITY_NOTICE, on),
                (false, true) if !off.is_empty() => out.text(MavSeverity::MAV_SEVERITY_NOTICE, off),
                _ => {}
            }
        }
        for (bit, text) in [
            (NAVIGATION_OUTSIDE, "outside of the fence"),
            (NAVIGATION_ABORTED, "the take-off was given up"),
            (1 << NAVIGATION_PROTECTION_SHIFT, "bank limited"),
            (2 << NAVIGATION_PROTECTION_SHIFT, "load factor limited"),
            (4 << NAVIGATION_PROTECTION_SHIFT, "angle of attack limited"),
            (8 << NAVIGATION_PROTECTION_SHIFT, "airspeed too low: the nose goes down"),
            (16 << NAVIGATION_PROTECTION_SHIFT, "angle of climb limited"),
            (PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT, "pitot not believed: airspeed by lift"),
            (NO_POWER << NAVIGATION_PROTECTION_SHIFT, "no power: gliding to the runway"),
            (STALLED << NAVIGATION_PROTECTION_SHIFT, "the wing has stalled: nose down"),
        ] {
            if turned(bit) == (true, false) {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, text);
            }
        }
    }

    /// Airspeed, m/s: the pitot's, or where it is not believed that of the motion through the wind.
    fn airspeed_mps(&self) -> Option<f64> {
        let doubted = PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT;
        if self.navigation.is_none_or(|navigation| navigation.flags & doubted == 0) {
            return self.imu.map(|imu| imu.airspeed_mps);
        }
        self.motion.map(|motion| {
            let [north_mps, east_mps, down_mps] = motion.velocity_ned_mps;
            let [wind_north, wind_east] = motion.wind_ne_mps;
            (north_mps - wind_north).hypot(east_mps - wind_east).hypot(down_mps)
        })
    }

    fn global_position(&self, motion: &Motion) -> MavMessage {
        let [north_m, east_m, down_m] = motion.position_ned_m;
        let (lat, lon) = self.runway.units(north_m, east_m);
        let [vx, vy, vz] = motion.velocity_ned_mps.map(|speed| (speed * 1e2).round() as i16);
        MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
            time_boot_ms: milliseconds(motion.valid_ns),
            lat,
            lon,
            alt: ((self.runway.altitude_m - down_m) * 1e3).round() as i32,
            relative_alt: (-down_m * 1e3).round() as i32,
            vx,
            vy,
            vz,
            hdg: (heading_deg(motion) * 1e2).round() as u16 % 36_000,
        })
    }

    fn instruments(&self, motion: &Motion) -> MavMessage {
        let [north_mps, east_mps, down_mps] = motion.velocity_ned_mps;
        let throttle = self.servo.map_or(0, |servo| servo.timers_us[4].saturating_sub(1000) / 10);
        MavMessage::VFR_HUD(VFR_HUD_DATA {
            airspeed: self.airspeed_mps().unwrap_or(0.0) as f32,
            groundspeed: north_mps.hypot(east_mps) as f32,
            alt: (self.runway.altitude_m - motion.position_ned_m[2]) as f32,
            climb: -down_mps as f32,
            heading: heading_deg(motion).round() as i16 % 360,
            throttle: throttle.min(100),
        })
    }
}

fn milliseconds(time_ns: u64) -> u32 {
    (time_ns / 1_000_000) as u32 // wraps after 49 days, as the message does
}

/// A battery that nobody measures is told as 0 V by the OnBoardComputer.
fn millivolts(volts: f64) -> u16 {
    match volts > 0.0 {
        true => (volts * 1e3).round().min(f64::from(UNKNOWN - 1)) as u16, // in range
        false => UNKNOWN,
    }
}

fn heading_deg(motion: &Motion) -> f64 {
    motion.euler_rad[2].to_degrees().rem_euclid(360.0)
}

fn attitude(motion: &Motion) -> MavMessage {
    let [roll, pitch, yaw] = motion.euler_rad.map(|angle| angle as f32);
    let [rollspeed, pitchspeed, yawspeed] = motion.rates_radps.map(|rate| rate as f32);
    let time_boot_ms = milliseconds(motion.valid_ns);
    MavMessage::ATTITUDE(ATTITUDE_DATA { time_boot_ms, roll, pitch, yaw, rollspeed, pitchspeed, yawspeed })
}

fn local_position(motion: &Motion) -> MavMessage {
    let [x, y, z] = motion.position_ned_m.map(|metres| metres as f32);
    let [vx, vy, vz] = motion.velocity_ned_mps.map(|speed| speed as f32);
    let time_boot_ms = milliseconds(motion.valid_ns);
    MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, z, vx, vy, vz })
}

/// What the Estimator says of itself. It tells no innovations, only whether they were taken.
fn estimates(state: &State) -> MavMessage {
    let mut flags = Estimates::empty();
    flags.set(Estimates::ESTIMATOR_ATTITUDE, state.health & GOOD_ATTITUDE != 0);
    flags.set(
        Estimates::ESTIMATOR_VELOCITY_HORIZ | Estimates::ESTIMATOR_VELOCITY_VERT,
        state.health & GOOD_VELOCITY != 0,
    );
    let position = Estimates::ESTIMATOR_POS_HORIZ_REL
        | Estimates::ESTIMATOR_POS_HORIZ_ABS
        | Estimates::ESTIMATOR_POS_VERT_ABS;
    flags.set(position, state.health & GOOD_POSITION != 0);
    let [north_m, east_m, down_m] = state.position_sigma_m;
    let unknown = f32::NAN;
    MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
        time_usec: state.valid_ns / 1_000,
        vel_ratio: unknown,
        pos_horiz_ratio: unknown,
        pos_vert_ratio: unknown,
        mag_ratio: unknown,
        hagl_ratio: unknown,
        tas_ratio: unknown,
        pos_horiz_accuracy: north_m.hypot(east_m) as f32,
        pos_vert_accuracy: down_m as f32,
        flags,
    })
}

/// The link to the simulator, by name: no message of the dialect has places for its counters.
fn hil_link(link: &SimulatorLink) -> [MavMessage; 5] {
    let bad = link.refused + link.invalid + link.strangers + link.errors;
    [
        ("HIL_TAKEN", link.accepted),
        ("HIL_MISSED", link.missing),
        ("HIL_ASKED", link.repeated),
        ("HIL_STALE", link.stale),
        ("HIL_BAD", bad),
    ]
    .map(|(name, count)| {
        let value = i32::try_from(count).unwrap_or(i32::MAX);
        let time_boot_ms = milliseconds(link.time_ns);
        let mut message = NAMED_VALUE_INT_DATA { time_boot_ms, value, ..NAMED_VALUE_INT_DATA::DEFAULT };
        message.name = name.into();
        MavMessage::NAMED_VALUE_INT(message)
    })
}

fn battery(volts: &Voltages) -> MavMessage {
    let mut voltages = [UNKNOWN; 10];
    voltages[0] = millivolts(volts.main_v);
    MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA {
        voltages,
        temperature: i16::MAX,
        current_battery: -1,
        current_consumed: -1,
        energy_consumed: -1,
        battery_remaining: -1,
        ..BATTERY_STATUS_DATA::DEFAULT
    })
}

fn raw_fix(gps: &GpsTelemetry, fresh: bool) -> MavMessage {
    let [north_mps, east_mps, _] = gps.velocity_ned_mps;
    MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA {
        time_usec: gps.measured_ns / 1_000,
        lat: (gps.latitude_rad.to_degrees() * 1e7).round() as i32,
        lon: (gps.longitude_rad.to_degrees() * 1e7).round() as i32,
        alt: (gps.altitude_m * 1e3).round() as i32,
        eph: UNKNOWN,
        epv: UNKNOWN,
        vel: (north_mps.hypot(east_mps) * 1e2).round() as u16,
        cog: (east_mps.atan2(north_mps).to_degrees().rem_euclid(360.0) * 1e2).round() as u16 % 36_000,
        fix_type: if fresh { GpsFixType::GPS_FIX_TYPE_3D_FIX } else { GpsFixType::GPS_FIX_TYPE_NO_FIX },
        satellites_visible: u8::MAX,
        ..GPS_RAW_INT_DATA::DEFAULT
    })
}

fn inertial(imu: &ImuTelemetry) -> MavMessage {
    let [xacc, yacc, zacc] = imu.specific_force_mps2.map(|value| value as f32);
    let [xgyro, ygyro, zgyro] = imu.rates_radps.map(|value| value as f32);
    let [xmag, ymag, zmag] = imu.field_gauss.map(|value| value as f32);
    let pressures = Imu::HIGHRES_IMU_UPDATED_ABS_PRESSURE
        | Imu::HIGHRES_IMU_UPDATED_DIFF_PRESSURE
        | Imu::HIGHRES_IMU_UPDATED_TEMPERATURE;
    MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
        time_usec: imu.measured_ns / 1_000,
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag,
        ymag,
        zmag,
        pressure_alt: imu.pressure_altitude_m as f32,
        fields_updated: Imu::from_bits_truncate(0x1fff).difference(pressures),
        ..HIGHRES_IMU_DATA::DEFAULT
    })
}

/// Left and right aileron, elevator, rudder, throttle.
fn pulses(servo: &ServoTelemetry) -> MavMessage {
    let [servo1_raw, servo2_raw, servo3_raw, servo4_raw, servo5_raw] = servo.timers_us;
    MavMessage::SERVO_OUTPUT_RAW(SERVO_OUTPUT_RAW_DATA {
        time_usec: (servo.time_ns / 1_000) as u32, // wraps, as the message does
        servo1_raw,
        servo2_raw,
        servo3_raw,
        servo4_raw,
        servo5_raw,
        ..SERVO_OUTPUT_RAW_DATA::DEFAULT
    })
}
