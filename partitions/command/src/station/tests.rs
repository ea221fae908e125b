use super::*;
use bateleur_mavlink::common::*;
use bateleur_messages::GroundMessage;
use bateleur_messages::frame::Frame;
use bateleur_messages::ground::ParameterSetting;
use bateleur_messages::parameter::ParameterValue;
use bateleur_messages::telemetry::{
    ACCEPTED, FROM_COMMAND, FROM_CONTROLLER, FROM_IMU, FROM_SERVO, GpsTelemetry, Navigation, REFUSED,
    Voltages,
};
use mavlink::{Message, calculate_crc};

use crate::{Numbers, parameters};

const CYCLE: u64 = 20_000_000;
const GROUND: (u8, u8) = (255, 190);

/// An aircraft, the functions behind it, and a ground station.
pub(super) struct World {
    pub(super) station: Station,
    ground: Encoder,
    window: u64,
    /// What the functions answer to an order.
    answers: fn(&Order) -> Vec<Acknowledge>,
    pub(super) ordered: Vec<Order>,
    /// This function's parameters, which the Controller here has as well.
    numbers: Numbers,
    table: bateleur_messages::parameter::Parameters<Numbers>,
    controller_is_silent: bool,
}

fn numbers() -> Numbers {
    Numbers {
        baud: 57_600,
        mavlink: true,
        system: 1,
        runway: Runway::default(),
        encoding: Encoding::Bytes,
        rates: Rates::default(),
        lost_link: 0,
        lost_link_after_s: 10.0,
    }
}

/// The same parameter as another function's, with its own name.
fn named_of(of: u8, value: ParameterValue) -> ParameterValue {
    let mut value = ParameterValue { from: of, ..value };
    if of == FROM_CONTROLLER && value.name[0] != 0 {
        value.name[..3].copy_from_slice(b"CTL");
    }
    value
}

pub(super) fn accept(order: &Order) -> Vec<Acknowledge> {
    let first = order.data()[0];
    let by =
        |from| Acknowledge { letter: order.letter(), first, from, result: ACCEPTED, ..Default::default() };
    match order {
        Order::Autopilot { .. } => vec![by(FROM_CONTROLLER), by(FROM_SERVO)],
        _ => vec![by(FROM_CONTROLLER)],
    }
}

pub(super) fn refuse(order: &Order) -> Vec<Acknowledge> {
    let reason = Refusal::NoState as u32;
    accept(order).into_iter().map(|answer| Acknowledge { result: REFUSED, reason, ..answer }).collect()
}

impl World {
    pub(super) fn new(answers: fn(&Order) -> Vec<Acknowledge>) -> Self {
        let numbers = numbers();
        let setup = Setup {
            system: 1,
            runway: numbers.runway,
            functions: 1 << FROM_COMMAND | 1 << FROM_CONTROLLER,
            encoding: Encoding::Bytes,
            rates: Rates::default(),
        };
        Self {
            station: Station::new(&setup),
            ground: Encoder::new(GROUND.0, GROUND.1),
            window: 0,
            answers,
            ordered: Vec::new(),
            numbers,
            table: parameters(),
            controller_is_silent: false,
        }
    }

    /// One window after these messages; gives what the ground hears.
    pub(super) fn window(&mut self, messages: &[MavMessage]) -> Vec<MavMessage> {
        self.window += 1;
        let now_ns = self.window * CYCLE;
        let mut bytes = Vec::new();
        messages.iter().for_each(|message| self.ground.write(message, &mut bytes));
        self.station.datagram(&bytes, now_ns);
        for order in self.station.window(now_ns) {
            if self.parameter(&order) {
                continue;
            }
            self.station.ordered(&order);
            self.ordered.push(order);
            for answer in (self.answers)(&order) {
                self.station.telemetry(&Telemetry::Acknowledge(answer));
            }
        }
        let mut heard = Vec::new();
        while let Some(message) = self.station.next_message() {
            Decoder::new().datagram(&message, |received| heard.extend(received.message));
        }
        heard
    }

    /// What the functions answer to an order about parameters.
    fn parameter(&mut self, order: &Order) -> bool {
        let (Order::ReadParameter { of, .. } | Order::SetParameter(ParameterSetting { of, .. })) = *order
        else {
            return false;
        };
        let order = match *order {
            Order::SetParameter(mut setting) if of == FROM_CONTROLLER => {
                setting.name[..3].copy_from_slice(b"CMD");
                Order::SetParameter(setting)
            }
            order => order,
        };
        let frame = Frame { letter: order.letter(), data: order.data() };
        let message = GroundMessage::from_frame(&frame).unwrap();
        let answer = self.table.take(&message, &mut self.numbers, 0).unwrap();
        for message in answer.messages().filter(|_| of == FROM_COMMAND || !self.controller_is_silent) {
            let frame = Frame { letter: message.letter, data: message.bytes().to_vec() };
            let telemetry = match Telemetry::of(&frame).unwrap() {
                Telemetry::Parameter(value) => Telemetry::Parameter(named_of(of, value)),
                other => other,
            };
            self.station.telemetry(&telemetry);
        }
        true
    }

    /// So many windows without a word from the ground.
    fn windows(&mut self, count: usize) -> Vec<MavMessage> {
        (0..count).flat_map(|_| self.window(&[])).collect()
    }

    /// What a ground station does that uploads `items`; gives the verdict.
    pub(super) fn upload(&mut self, items: &[MISSION_ITEM_INT_DATA]) -> Option<MavMissionResult> {
        self.upload_of(MavMissionType::MAV_MISSION_TYPE_MISSION, items)
    }

    /// The same of a list of this kind.
    pub(super) fn upload_of(
        &mut self,
        kind: MavMissionType,
        items: &[MISSION_ITEM_INT_DATA],
    ) -> Option<MavMissionResult> {
        let mut heard = self.window(&[count(items.len() as u16, kind)]);
        for _ in 0..300 {
            let mut answers = Vec::new();
            for message in &heard {
                match message {
                    MavMessage::MISSION_REQUEST_INT(request) => {
                        let seq = usize::from(request.seq);
                        answers.push(MavMessage::MISSION_ITEM_INT(MISSION_ITEM_INT_DATA {
                            seq: request.seq,
                            mission_type: kind,
                            ..items[seq].clone()
                        }));
                    }
                    MavMessage::MISSION_ACK(ack) => return Some(ack.mavtype),
                    _ => {}
                }
            }
            heard = self.window(&answers);
        }
        None
    }
}

pub(super) fn count(count: u16, mission_type: MavMissionType) -> MavMessage {
    MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
        count,
        target_system: 1,
        target_component: 1,
        mission_type,
        ..MISSION_COUNT_DATA::DEFAULT
    })
}

pub(super) fn item(north_m: f64, east_m: f64, z: f32) -> MISSION_ITEM_INT_DATA {
    let (x, y) = Runway::default().units(north_m, east_m);
    MISSION_ITEM_INT_DATA {
        x,
        y,
        z,
        target_system: 1,
        target_component: 1,
        command: MavCmd::MAV_CMD_NAV_WAYPOINT,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        ..MISSION_ITEM_INT_DATA::DEFAULT
    }
}

pub(super) fn speed(mps: f32) -> MISSION_ITEM_INT_DATA {
    MISSION_ITEM_INT_DATA {
        command: MavCmd::MAV_CMD_DO_CHANGE_SPEED,
        frame: MavFrame::MAV_FRAME_MISSION,
        param2: mps,
        ..item(0.0, 0.0, 0.0)
    }
}

pub(super) fn command(command: MavCmd, param1: f32) -> MavMessage {
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        command,
        param1,
        target_system: 1,
        ..COMMAND_LONG_DATA::DEFAULT
    })
}

pub(super) fn acknowledged(heard: &[MavMessage]) -> Vec<MavResult> {
    let results = heard.iter().filter_map(|message| match message {
        MavMessage::COMMAND_ACK(ack) => Some(ack.result),
        _ => None,
    });
    results.collect()
}

pub(super) fn texts(heard: &[MavMessage]) -> String {
    let texts = heard.iter().filter_map(|message| match message {
        MavMessage::STATUSTEXT(text) => Some(String::from_utf8_lossy(&*text.text).into_owned() + "\n"),
        _ => None,
    });
    texts.collect()
}

#[test]
fn heartbeat_comes_once_a_second_and_says_who_flies() {
    let mut world = World::new(accept);
    let heartbeats = |heard: &[MavMessage]| -> Vec<MavModeFlag> {
        let modes = heard.iter().filter_map(|message| match message {
            MavMessage::HEARTBEAT(heartbeat) => Some(heartbeat.base_mode),
            _ => None,
        });
        modes.collect()
    };
    let modes = heartbeats(&world.windows(500));
    assert_eq!(modes, [MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED; 10]);
    world.station.telemetry(&Telemetry::Navigation(Navigation { flags: 3, ..Default::default() }));
    let flies = MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
        | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED
        | MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED;
    assert_eq!(heartbeats(&world.windows(50)), [flies]);
}

#[test]
fn state_becomes_attitude_position_and_instruments_at_their_rates() {
    let mut world = World::new(accept);
    let mut heard = Vec::new();
    for cycle in 0..100 {
        world.station.state(&State {
            valid_ns: cycle * CYCLE,
            position_ned_m: [1_000.0, 0.0, -160.0],
            velocity_ned_mps: [0.0, 22.0, -1.0],
            euler_rad: [0.1, 0.05, std::f64::consts::FRAC_PI_2],
            status: 3,
            ..State::default()
        });
        heard.extend(world.window(&[]));
    }
    let of = |name: &str| heard.iter().filter(|message| mavlink_name(message) == name).count();
    assert_eq!((of("ATTITUDE"), of("GLOBAL_POSITION_INT"), of("VFR_HUD"), of("SYS_STATUS")), (20, 10, 10, 2));
    let position = heard.iter().find_map(|message| match message {
        MavMessage::GLOBAL_POSITION_INT(position) => Some(position.clone()),
        _ => None,
    });
    let position = position.unwrap();
    assert_eq!(
        (position.relative_alt, position.vy, position.vz, position.hdg),
        (160_000, 2_200, -100, 9_000)
    );
    let (latitude, longitude) = Runway::default().units(1_000.0, 0.0);
    assert_eq!((position.lat, position.lon), (latitude, longitude));
}

fn mavlink_name(message: &MavMessage) -> &'static str {
    match message {
        MavMessage::ATTITUDE(_) => "ATTITUDE",
        MavMessage::GLOBAL_POSITION_INT(_) => "GLOBAL_POSITION_INT",
        MavMessage::VFR_HUD(_) => "VFR_HUD",
        MavMessage::SYS_STATUS(_) => "SYS_STATUS",
        _ => "",
    }
}

#[test]
fn state_that_can_not_be_used_is_not_shown() {
    let mut world = World::new(accept);
    world.station.state(&State { status: 1, ..State::default() });
    let heard = world.windows(100);
    assert!(!heard.iter().any(|message| matches!(message, MavMessage::ATTITUDE(_))));
}

#[test]
fn arming_is_acknowledged_when_controller_and_servo_have_taken_it() {
    let mut world = World::new(|_| Vec::new());
    let arm = command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0);
    assert_eq!(acknowledged(&world.window(std::slice::from_ref(&arm))), []);
    assert_eq!(world.ordered, [Order::Autopilot { on: true }]);
    let [controller, servo] = accept(&Order::Autopilot { on: true })[..] else { panic!() };
    world.station.telemetry(&Telemetry::Acknowledge(controller));
    assert_eq!(acknowledged(&world.window(&[arm])), [], "asked again while it waits");
    assert_eq!(world.ordered.len(), 1);
    world.station.telemetry(&Telemetry::Acknowledge(servo));
    assert_eq!(acknowledged(&world.window(&[])), [MavResult::MAV_RESULT_ACCEPTED]);
}

#[test]
fn refused_command_says_why_and_a_silent_function_is_told() {
    let mut world = World::new(refuse);
    let mut heard = world.window(&[command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0)]);
    heard.extend(world.window(&[]));
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_TEMPORARILY_REJECTED]);
    assert!(texts(&heard).contains("no usable state"), "{}", texts(&heard));
    let mut world = World::new(|_| Vec::new());
    world.window(&[command(MavCmd::MAV_CMD_MISSION_START, 0.0)]);
    let heard = world.windows(80);
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_FAILED]);
    assert!(texts(&heard).contains("did not answer"));
}

#[test]
fn aircraft_is_handed_over_only_when_what_it_is_to_fly_was_taken() {
    let start = || [command(MavCmd::MAV_CMD_MISSION_START, 0.0)];
    let mut world = World::new(refuse);
    let mut heard = world.window(&start());
    heard.extend(world.windows(5));
    assert_eq!(world.ordered, [Order::Navigation { on: true }], "and not the autopilot");
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_TEMPORARILY_REJECTED]);
    let mut world = World::new(accept);
    let mut heard = world.window(&start());
    heard.extend(world.windows(5));
    assert_eq!(world.ordered, [Order::Navigation { on: true }, Order::Autopilot { on: true }]);
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_ACCEPTED]);
}

#[test]
fn long_text_goes_in_pieces_that_belong_together_and_a_short_one_in_one() {
    let mut world = World::new(accept);
    world.windows(10);
    for (length, pieces) in [(0, 0), (49, 1), (50, 2), (51, 2), (100, 3), (101, 3)] {
        world.station.tell(MavSeverity::MAV_SEVERITY_INFO, &"x".repeat(length));
        let heard = world.window(&[]);
        let all: Vec<_> = heard
            .iter()
            .filter_map(|message| match message {
                MavMessage::STATUSTEXT(text) => {
                    Some((text.id, text.chunk_seq, text.text.iter().filter(|byte| **byte == b'x').count()))
                }
                _ => None,
            })
            .collect();
        assert_eq!(all.len(), pieces, "{length}");
        assert_eq!(all.iter().map(|(.., letters)| letters).sum::<usize>(), length);
        assert!(all.iter().zip(0..).all(|((id, number, _), place)| *number == place && *id == all[0].0));
        assert!(all.first().is_none_or(|(id, ..)| (*id == 0) == (length < 50)));
    }
}

#[test]
fn senseless_and_unknown_commands_are_refused_and_reach_nobody() {
    let mut world = World::new(accept);
    let heard = world.window(&[
        command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, f32::NAN),
        command(MavCmd::MAV_CMD_DO_SET_MODE, -4.0),
        command(MavCmd::MAV_CMD_NAV_LAND_LOCAL, 0.0),
    ]);
    let refused =
        [MavResult::MAV_RESULT_DENIED, MavResult::MAV_RESULT_DENIED, MavResult::MAV_RESULT_UNSUPPORTED];
    assert_eq!(acknowledged(&heard), refused);
    assert!(world.ordered.is_empty());
}

/// The bytes of `message` with `value` in its payload at `place`, where the dialect would not let it be said.
fn foreign(message: &MavMessage, place: usize, value: &[u8]) -> Vec<u8> {
    let mut frame = Vec::new();
    Encoder::new(GROUND.0, GROUND.1).write(message, &mut frame);
    let end = frame.len() - 2;
    frame[10 + place..][..value.len()].copy_from_slice(value);
    let checksum = calculate_crc(&frame[1..end], MavMessage::extra_crc(message.message_id()));
    frame[end..].copy_from_slice(&checksum.to_le_bytes());
    frame
}

#[test]
fn command_that_the_dialect_does_not_know_is_answered_unsupported_and_one_with_integers_is_carried_out() {
    const NUMBER: u16 = 42_424; // a calibration of another autopilot
    let int = COMMAND_INT_DATA {
        command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        param1: 1.0,
        target_system: 1,
        ..COMMAND_INT_DATA::DEFAULT
    };
    let long = command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0);
    let mut world = World::new(accept);
    world.windows(10);
    world.station.datagram(&foreign(&long, 28, &NUMBER.to_le_bytes()), 0);
    let answer = world.station.next_message().unwrap();
    let unsupported = MavResult::MAV_RESULT_UNSUPPORTED;
    let [low, high] = NUMBER.to_le_bytes();
    assert_eq!((answer[7], &answer[10..13]), (77, &[low, high, unsupported as u8][..]));
    assert!(world.ordered.is_empty(), "nothing of it was carried out");
    let mut heard = world.window(&[MavMessage::COMMAND_INT(int.clone())]);
    heard.extend(world.windows(5));
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_ACCEPTED]);
    assert_eq!(world.ordered, [Order::Autopilot { on: true }]);
    let there = COMMAND_INT_DATA { command: MavCmd::MAV_CMD_NAV_LOITER_UNLIM, x: -340_000_000, ..int };
    assert_eq!(acknowledged(&world.window(&[MavMessage::COMMAND_INT(there)])), [unsupported]);
    assert_eq!(world.ordered.len(), 1, "it does not circle here where it was asked to circle there");
}

#[test]
fn messages_come_as_often_as_the_ground_station_asks_for() {
    let interval = |message: f32, interval_us: f32| {
        MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            param1: message,
            param2: interval_us,
            target_system: 1,
            ..COMMAND_LONG_DATA::DEFAULT
        })
    };
    let mut world = World::new(accept);
    world.station.state(&State { status: 3, ..State::default() });
    let mut told = |message: f32, interval_us: f32, result: MavResult| {
        assert_eq!(acknowledged(&world.window(&[interval(message, interval_us)])), [result]);
        world.windows(10);
        let heard = world.windows(100); // two seconds
        heard.iter().filter(|message| matches!(message, MavMessage::ATTITUDE(_))).count()
    };
    use MavResult as R;
    assert_eq!(told(30.0, 0.0, R::MAV_RESULT_ACCEPTED), 20, "as its parameter says");
    assert_eq!(told(30.0, 200_000.0, R::MAV_RESULT_ACCEPTED), 10);
    assert_eq!(told(30.0, 1.0, R::MAV_RESULT_ACCEPTED), 100, "not more often than a window comes");
    assert_eq!(told(30.0, -1.0, R::MAV_RESULT_ACCEPTED), 0);
    assert_eq!(told(30.0, f32::NAN, R::MAV_RESULT_DENIED), 0);
    assert_eq!(told(24.0, 1e5, R::MAV_RESULT_UNSUPPORTED), 0, "GPS_RAW_INT comes with each fix");
    assert_eq!(told(30.0, 0.0, R::MAV_RESULT_ACCEPTED), 20);
}

#[test]
fn item_with_an_unknown_command_or_frame_ends_the_upload_at_once() {
    let unsupported = MavMissionResult::MAV_MISSION_UNSUPPORTED;
    let frame = MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME;
    for (place, value, verdict) in [(30, &9_999_u16.to_le_bytes()[..], unsupported), (34, &[99][..], frame)] {
        let mut world = World::new(accept);
        world.window(&[count(2, MavMissionType::MAV_MISSION_TYPE_MISSION)]);
        let bytes = foreign(&MavMessage::MISSION_ITEM_INT(item(1.0, 1.0, 100.0)), place, value);
        world.station.datagram(&bytes, 2 * CYCLE);
        let heard = world.window(&[]);
        assert!(texts(&heard).contains("item 0: "), "{}", texts(&heard));
        let told =
            |message: &MavMessage| matches!(message, MavMessage::MISSION_ACK(ack) if ack.mavtype == verdict);
        assert!(heard.iter().any(told), "{heard:?}");
    }
}

#[test]
fn mode_without_the_hil_bit_leaves_hil_mode_alone() {
    let mut world = World::new(|_| Vec::new());
    world.window(&[command(MavCmd::MAV_CMD_DO_SET_MODE, 4.0)]);
    assert_eq!(world.ordered, [Order::Navigation { on: true }, Order::Autopilot { on: false }]);
}

#[test]
fn custom_mode_is_unsupported_in_either_message_and_switches_nothing_off() {
    const CUSTOM: u8 = 1;
    let set = MavMessage::SET_MODE(SET_MODE_DATA {
        base_mode: MavModeFlag::from_bits_retain(CUSTOM | 128),
        custom_mode: 4,
        target_system: 1,
    });
    for message in [command(MavCmd::MAV_CMD_DO_SET_MODE, f32::from(CUSTOM | 4 | 128)), set] {
        let mut world = World::new(accept);
        let heard = world.window(&[message]);
        assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_UNSUPPORTED]);
        assert!(texts(&heard).contains("no custom modes"), "{}", texts(&heard));
        assert!(world.ordered.is_empty());
    }
}

#[test]
fn calibration_that_takes_its_time_is_told_in_progress_and_is_no_failure() {
    let mut world = World::new(|_| Vec::new());
    let mut heard = world.window(&[command(MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)]);
    heard.extend(world.windows(500));
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_IN_PROGRESS; 6]);
    let [order] = world.ordered[..] else { panic!() };
    let answer = accept(&order)[0];
    world.station.telemetry(&Telemetry::Acknowledge(Acknowledge { from: FROM_IMU, ..answer }));
    assert_eq!(acknowledged(&world.windows(5)), [MavResult::MAV_RESULT_ACCEPTED]);
}

#[test]
fn fixes_that_stopped_are_no_fix_and_a_battery_that_nobody_measures_is_unknown() {
    let mut world = World::new(accept);
    let mut told = |measured_ns: u64, main_v: f64| {
        world.windows(50);
        world.station.telemetry(&Telemetry::Gps(GpsTelemetry { measured_ns, ..Default::default() }));
        world.station.telemetry(&Telemetry::Voltages(Voltages { main_v, ..Default::default() }));
        let mut said = (GpsFixType::GPS_FIX_TYPE_NO_GPS, 0, false, 0);
        for message in world.windows(50) {
            match message {
                MavMessage::GPS_RAW_INT(fix) => said.0 = fix.fix_type,
                MavMessage::BATTERY_STATUS(battery) => said.1 = battery.voltages[0],
                MavMessage::SYS_STATUS(status) => {
                    let gps = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS;
                    said.2 = status.onboard_control_sensors_health.contains(gps);
                    said.3 = status.voltage_battery;
                }
                _ => {}
            }
        }
        said
    };
    let (fix, none) = (GpsFixType::GPS_FIX_TYPE_3D_FIX, GpsFixType::GPS_FIX_TYPE_NO_FIX);
    assert_eq!(told(49 * CYCLE, 11.1), (fix, 11_100, true, 11_100));
    assert_eq!(told(49 * CYCLE, 0.0), (fix, u16::MAX, true, u16::MAX));
    assert_eq!(told(49 * CYCLE, f64::NAN), (none, u16::MAX, false, u16::MAX));
}

#[test]
fn mission_is_loaded_in_order_with_its_speeds_and_comes_back_as_it_went() {
    let mut world = World::new(accept);
    let items = [
        speed(20.0),
        item(500.0, 0.0, 160.0),
        item(500.0, 500.0, 160.0),
        speed(24.0),
        item(0.0, 500.0, 120.0),
    ];
    assert_eq!(world.upload(&items), Some(MavMissionResult::MAV_MISSION_ACCEPTED));
    let loaded: Vec<_> = world
        .ordered
        .iter()
        .map(|order| match order {
            Order::Waypoint(point) => (point.index, point.count, point.north_m.round(), point.airspeed_mps),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(loaded, [(0, 3, 500.0, 20.0), (1, 3, 500.0, 20.0), (2, 3, 0.0, 24.0)]);
    let list = MavMessage::MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA {
        target_system: 1,
        ..MISSION_REQUEST_LIST_DATA::DEFAULT
    });
    let asked = (0..5).map(|seq| {
        MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
            seq,
            target_system: 1,
            ..MISSION_REQUEST_INT_DATA::DEFAULT
        })
    });
    let questions: Vec<_> = [list].into_iter().chain(asked).collect();
    let heard = world.window(&questions);
    let back: Vec<_> = heard
        .iter()
        .filter_map(|message| match message {
            MavMessage::MISSION_ITEM_INT(item) => Some((item.seq, item.command, item.x, item.z)),
            _ => None,
        })
        .collect();
    let sent: Vec<_> = items
        .iter()
        .zip(0..)
        .map(|(item, seq)| match item.command {
            MavCmd::MAV_CMD_NAV_WAYPOINT => (seq, item.command, item.x, item.z),
            command => (seq, command, 0, 0.0),
        })
        .collect();
    assert_eq!(back, sent);
    assert!(
        heard.iter().any(|message| matches!(message, MavMessage::MISSION_COUNT(count) if count.count == 5))
    );
}

#[test]
fn items_that_can_not_be_flown_are_refused_before_anything_is_loaded() {
    for (bad, verdict) in [
        (item(90_000.0, 0.0, 160.0), MavMissionResult::MAV_MISSION_INVALID_PARAM5_X),
        (item(0.0, 0.0, f32::NAN), MavMissionResult::MAV_MISSION_INVALID_PARAM7),
        (item(0.0, 0.0, -20.0), MavMissionResult::MAV_MISSION_INVALID_PARAM7),
        (speed(f32::INFINITY), MavMissionResult::MAV_MISSION_INVALID_PARAM2),
        (MISSION_ITEM_INT_DATA { param1: 1.0, ..speed(25.0) }, MavMissionResult::MAV_MISSION_INVALID_PARAM1),
        (
            MISSION_ITEM_INT_DATA { command: MavCmd::MAV_CMD_NAV_LAND_LOCAL, ..item(0.0, 0.0, 100.0) },
            MavMissionResult::MAV_MISSION_UNSUPPORTED,
        ),
        (
            MISSION_ITEM_INT_DATA { frame: MavFrame::MAV_FRAME_BODY_NED, ..item(0.0, 0.0, 100.0) },
            MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME,
        ),
    ] {
        let mut world = World::new(accept);
        assert_eq!(world.upload(&[item(1.0, 1.0, 100.0), bad]), Some(verdict));
        assert!(world.ordered.is_empty());
    }
    let mut world = World::new(accept);
    assert_eq!(world.upload(&vec![item(1.0, 1.0, 100.0); 33]), Some(MavMissionResult::MAV_MISSION_NO_SPACE));
    assert_eq!(world.upload(&[]), Some(MavMissionResult::MAV_MISSION_DENIED));
}

#[test]
fn neighbours_that_are_one_place_are_refused_by_their_items_and_a_single_way_point_is_not() {
    let (a, b, c) = (item(500.0, 0.0, 160.0), item(500.0, 500.0, 160.0), item(0.0, 500.0, 120.0));
    let near = item(503.0, 500.0, 160.0);
    for (items, named) in [
        (vec![a.clone(), b.clone(), near, c.clone()], "items 1 and 2 "),
        (vec![speed(20.0), a.clone(), b.clone(), c, a.clone()], "items 4 and 1 "),
        (vec![a.clone(), speed(24.0), a.clone()], "items 0 and 2 "),
    ] {
        let mut world = World::new(accept);
        let mut heard = world.window(&[count(items.len() as u16, MavMissionType::MAV_MISSION_TYPE_MISSION)]);
        for (item, seq) in items.into_iter().zip(0..) {
            let item = MISSION_ITEM_INT_DATA { seq, ..item };
            heard.extend(world.window(&[MavMessage::MISSION_ITEM_INT(item)]));
        }
        assert_eq!(verdicts(&heard), [MavMissionResult::MAV_MISSION_INVALID]);
        assert!(texts(&heard).contains(named), "{}", texts(&heard));
        assert!(world.ordered.is_empty());
    }
    let mut world = World::new(accept);
    assert_eq!(world.upload(&[a]), Some(MavMissionResult::MAV_MISSION_ACCEPTED));
    assert_eq!(world.upload(&[b.clone(), item(0.0, 0.0, 9.0)]), Some(MavMissionResult::MAV_MISSION_ACCEPTED));
}

pub(super) fn verdicts(heard: &[MavMessage]) -> Vec<MavMissionResult> {
    let verdict = |message: &MavMessage| match message {
        MavMessage::MISSION_ACK(ack) => Some(ack.mavtype),
        _ => None,
    };
    heard.iter().filter_map(verdict).collect()
}

/// Index and count of the way-points that were ordered.
fn loaded(world: &World) -> Vec<(u8, u8)> {
    let place = |order: &Order| match order {
        Order::Waypoint(point) => Some((point.index, point.count)),
        _ => None,
    };
    world.ordered.iter().filter_map(place).collect()
}

#[test]
fn upload_of_as_many_way_points_as_are_flown_is_opened_so_that_the_controller_begins_it() {
    let (a, b, c) = (item(500.0, 0.0, 160.0), item(500.0, 500.0, 160.0), item(0.0, 500.0, 120.0));
    let accepted = Some(MavMissionResult::MAV_MISSION_ACCEPTED);
    let mut world = World::new(accept);
    assert_eq!(world.upload(&[a.clone(), b.clone()]), accepted);
    assert_eq!(loaded(&world), [(0, 2), (1, 2)], "the first has nothing to be told from");
    world.ordered.clear();
    assert_eq!(world.upload(&[b.clone(), c.clone()]), accepted);
    assert_eq!(loaded(&world), [(0, 3), (0, 2), (1, 2)]);
    assert_eq!(world.station.mission().iter().map(|point| point.count).collect::<Vec<_>>(), [2, 2]);
    // A plan has way-points as well: the Controller says how many.
    let mut world = World::new(accept);
    world.station.telemetry(&Telemetry::Navigation(Navigation { waypoint_count: 3, ..Default::default() }));
    assert_eq!(world.upload(&[a.clone(), b, c]), accepted);
    assert_eq!(loaded(&world), [(0, 2), (0, 3), (1, 3), (2, 3)]);
    // One way-point is opened with a list that is not whole with it.
    let mut world = World::new(accept);
    world.upload(std::slice::from_ref(&a));
    world.ordered.clear();
    assert_eq!(world.upload(&[a]), accepted);
    assert_eq!(loaded(&world), [(0, 2), (0, 1)]);
}

#[test]
fn parts_of_a_mission_are_answered_unsupported_and_a_choice_among_no_items_refused() {
    let mut world = World::new(accept);
    let heard = world.window(&[
        MavMessage::MISSION_REQUEST_PARTIAL_LIST(MISSION_REQUEST_PARTIAL_LIST_DATA {
            target_system: 1,
            ..MISSION_REQUEST_PARTIAL_LIST_DATA::DEFAULT
        }),
        MavMessage::MISSION_WRITE_PARTIAL_LIST(MISSION_WRITE_PARTIAL_LIST_DATA {
            target_system: 1,
            ..MISSION_WRITE_PARTIAL_LIST_DATA::DEFAULT
        }),
        MavMessage::MISSION_SET_CURRENT(MISSION_SET_CURRENT_DATA {
            target_system: 1,
            ..MISSION_SET_CURRENT_DATA::DEFAULT
        }),
    ]);
    use MavMissionResult::{
        MAV_MISSION_INVALID_SEQUENCE as SEQUENCE, MAV_MISSION_UNSUPPORTED as UNSUPPORTED,
    };
    assert_eq!(verdicts(&heard), [UNSUPPORTED, UNSUPPORTED, SEQUENCE]);
}

#[test]
fn clearing_everything_is_refused_as_clearing_the_mission_is() {
    use MavMissionType as T;
    for (mission_type, verdict) in [
        (T::MAV_MISSION_TYPE_MISSION, MavMissionResult::MAV_MISSION_DENIED),
        (T::MAV_MISSION_TYPE_ALL, MavMissionResult::MAV_MISSION_DENIED),
        (T::MAV_MISSION_TYPE_FENCE, MavMissionResult::MAV_MISSION_ACCEPTED),
    ] {
        let clear = MavMessage::MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA {
            target_system: 1,
            mission_type,
            ..MISSION_CLEAR_ALL_DATA::DEFAULT
        });
        assert_eq!(verdicts(&World::new(accept).window(&[clear])), [verdict]);
    }
}

#[test]
fn controller_that_refuses_or_does_not_answer_ends_the_upload_with_its_reason() {
    let mut world = World::new(refuse);
    assert_eq!(world.upload(&[item(1.0, 1.0, 100.0)]), Some(MavMissionResult::MAV_MISSION_DENIED));
    let mut world = World::new(|_| Vec::new());
    assert_eq!(world.upload(&[item(1.0, 1.0, 100.0)]), Some(MavMissionResult::MAV_MISSION_ERROR));
}

#[test]
fn lost_item_is_asked_for_again_and_a_lost_ground_station_is_given_up() {
    let mut world = World::new(accept);
    world.window(&[count(2, MavMissionType::MAV_MISSION_TYPE_MISSION)]);
    let heard = world.windows(300);
    let asked = heard
        .iter()
        .filter(|message| matches!(message, MavMessage::MISSION_REQUEST_INT(request) if request.seq == 0))
        .count();
    assert_eq!(asked, 4);
    assert!(heard.iter().any(|message| matches!(message, MavMessage::MISSION_ACK(ack) if ack.mavtype == MavMissionResult::MAV_MISSION_OPERATION_CANCELLED)));
}

fn parameter(id: &str, param_value: f32, param_type: MavParamType) -> MavMessage {
    let mut message = PARAM_SET_DATA { param_value, param_type, target_system: 1, ..PARAM_SET_DATA::DEFAULT };
    message.param_id = id.into();
    MavMessage::PARAM_SET(message)
}

fn list() -> MavMessage {
    MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        ..PARAM_REQUEST_LIST_DATA::DEFAULT
    })
}

/// Place, count and value of what is told.
fn told(heard: &[MavMessage]) -> Vec<(u16, u16, f32)> {
    let value = |message: &MavMessage| match message {
        MavMessage::PARAM_VALUE(value) => Some((value.param_index, value.param_count, value.param_value)),
        _ => None,
    };
    heard.iter().filter_map(value).collect()
}

fn errors(heard: &[MavMessage]) -> Vec<MavParamError> {
    let error = |message: &MavMessage| match message {
        MavMessage::PARAM_ERROR(error) => Some(error.error),
        _ => None,
    };
    heard.iter().filter_map(error).collect()
}

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;

#[test]
fn parameters_of_all_functions_are_listed_whole_with_their_types() {
    let mut world = World::new(accept);
    let mut heard = world.window(&[list()]);
    heard.extend(world.windows(60));
    let told = told(&heard);
    assert_eq!(told.iter().map(|(index, ..)| *index).collect::<Vec<_>>(), (0..22).collect::<Vec<_>>());
    assert!(told.iter().all(|(_, count, _)| *count == 22));
    let whole = heard.iter().find_map(|message| match message {
        MavMessage::PARAM_VALUE(value) if value.param_type == MavParamType::MAV_PARAM_TYPE_INT32 => {
            Some((value.param_id.to_str().unwrap().to_owned(), value.param_value.to_bits()))
        }
        _ => None,
    });
    assert_eq!(whole, Some(("CMD_BAUD".into(), 57_600)));
}

#[test]
fn nothing_is_asked_of_the_functions_before_a_ground_station_asks() {
    let mut world = World::new(accept);
    world.windows(200);
    assert!(world.ordered.is_empty() && told(&world.windows(10)).is_empty());
}

#[test]
fn bad_parameters_are_refused_with_the_reason_and_the_one_that_stands() {
    use MavParamError as E;
    let mut world = World::new(accept);
    for (id, value, stands, error) in [
        ("CMD_RATE_HUD", 20.0, 20.0, None),
        ("CTL_RATE_HUD", 0.4, 0.4, None),
        ("CMD_RATE_HUD", 51.0, 0.4, Some(E::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)),
        ("CMD_RATE_HUD", f32::NAN, 0.4, Some(E::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)),
        ("CMD_ORIGIN_ALT", 9.0, Runway::default().altitude_m as f32, Some(E::MAV_PARAM_ERROR_READ_ONLY)),
    ] {
        let mut heard = world.window(&[parameter(id, value, REAL)]);
        heard.extend(world.windows(30));
        assert_eq!(told(&heard).last().unwrap().2, stands, "{id} = {value}");
        assert_eq!(errors(&heard), error.into_iter().collect::<Vec<_>>(), "{id} = {value}");
    }
    // What was sent as 0.4 is 0.4, and not the nearest that a float has.
    assert_eq!(world.numbers.rates.hud_hz, 0.4);
    for (id, kind, error) in [
        ("NOWHERE", REAL, E::MAV_PARAM_ERROR_DOES_NOT_EXIST),
        ("CMD_RATE_HUD", MavParamType::MAV_PARAM_TYPE_REAL64, E::MAV_PARAM_ERROR_TYPE_UNSUPPORTED),
    ] {
        let mut heard = world.window(&[parameter(id, 1.0, kind)]);
        heard.extend(world.windows(30));
        assert_eq!((told(&heard), errors(&heard)), (Vec::new(), vec![error]), "{id}");
    }
}

#[test]
fn whole_number_is_set_by_its_bits_and_by_its_value() {
    let mut world = World::new(accept);
    let bits = f32::from_bits(7);
    for (value, kind) in [(bits, MavParamType::MAV_PARAM_TYPE_INT32), (7.0, REAL)] {
        world.numbers.rates.hud_hz = 0.0;
        world.window(&[parameter("CMD_RATE_HUD", value, kind)]);
        world.windows(30);
        assert_eq!(world.numbers.rates.hud_hz, 7.0);
    }
}

#[test]
fn short_number_that_was_sent_by_its_value_is_not_taken_for_zero() {
    use MavParamType as T;
    let mut world = World::new(accept);
    for (value, kind) in [(1.0, T::MAV_PARAM_TYPE_UINT8), (3.0, T::MAV_PARAM_TYPE_INT16)] {
        let mut heard = world.window(&[parameter("CMD_RATE_HUD", value, kind)]);
        heard.extend(world.windows(30));
        assert_eq!(errors(&heard), [MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH]);
        assert!(texts(&heard).contains("CMD_RATE_HUD: sent by value?"), "{}", texts(&heard));
        assert_eq!(world.numbers.rates, Rates::default());
    }
    for (bits, kind, number) in [
        (7, T::MAV_PARAM_TYPE_UINT8, 7.0),
        (200, T::MAV_PARAM_TYPE_UINT8, 200.0),
        (u32::MAX, T::MAV_PARAM_TYPE_INT8, -1.0),
        (0xfffe, T::MAV_PARAM_TYPE_INT16, -2.0),
    ] {
        assert_eq!(Encoding::Bytes.decode(f32::from_bits(bits), kind), Ok(number));
    }
    assert_eq!(Encoding::Cast.decode(1.0, T::MAV_PARAM_TYPE_UINT8), Ok(1.0));
}

#[test]
fn silent_function_is_named_does_not_hold_up_the_list_and_is_found_later_behind_the_others() {
    let mut world = World::new(accept);
    world.controller_is_silent = true;
    let mut heard = world.window(&[list()]);
    heard.extend(world.windows(150));
    assert_eq!(told(&heard).len(), 11);
    let named = heard.iter().any(|message| {
        matches!(message, MavMessage::STATUSTEXT(text) if text.text.to_str().is_ok_and(|t| t.starts_with("controller does not answer")))
    });
    assert!(named);
    world.controller_is_silent = false;
    let mut heard = world.window(&[list()]);
    heard.extend(world.windows(100));
    let places: Vec<_> = told(&heard).iter().map(|(index, ..)| *index).collect();
    assert_eq!(places, (0..22).collect::<Vec<_>>());
    // Known by now: the list has it, setting it says who does not answer.
    world.controller_is_silent = true;
    let mut heard = world.window(&[parameter("CTL_RATE_HUD", 1.0, REAL)]);
    heard.extend(world.windows(120));
    assert_eq!(errors(&heard), [MavParamError::MAV_PARAM_ERROR_READ_FAIL]);
}

#[test]
fn what_is_for_another_system_or_an_echo_or_garbage_does_nothing() {
    let mut world = World::new(accept);
    world.windows(10);
    let mut arm = COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        param1: 1.0,
        ..COMMAND_LONG_DATA::DEFAULT
    };
    arm.target_system = 2;
    assert_eq!(world.window(&[MavMessage::COMMAND_LONG(arm.clone())]), []);
    arm.target_system = 1;
    let mut echo = Vec::new();
    Encoder::new(1, 1).write(&MavMessage::COMMAND_LONG(arm), &mut echo);
    world.station.datagram(&echo, 0);
    world.station.datagram(b"\xfd\x09garbage", 0);
    world.station.stream(&[0xfe; 400], 0);
    assert!(world.ordered.is_empty() && world.station.refused() > 0);
}

#[test]
fn what_is_for_another_component_is_not_carried_out() {
    const GIMBAL: u8 = 154;
    let to = |target_component: u8| {
        [
            MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
                command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
                param1: 1.0,
                target_system: 1,
                target_component,
                ..COMMAND_LONG_DATA::DEFAULT
            }),
            MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                count: 1,
                target_system: 1,
                target_component,
                ..MISSION_COUNT_DATA::DEFAULT
            }),
            MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA { target_system: 1, target_component }),
        ]
    };
    let mut world = World::new(accept);
    world.windows(10);
    let mut heard = world.window(&to(GIMBAL));
    heard.extend(world.windows(30));
    assert_eq!((world.ordered.as_slice(), told(&heard), verdicts(&heard)), (&[][..], vec![], vec![]));
    assert!(!world.station.was_heard());
    for component in [0, AUTOPILOT] {
        let mut world = World::new(accept);
        let mut heard = world.window(&to(component));
        heard.extend(world.windows(60));
        assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_ACCEPTED]);
        assert_eq!(told(&heard).len(), 22);
    }
}

#[test]
fn list_of_parameters_that_all_systems_are_asked_for_is_told() {
    let mut world = World::new(accept);
    let all = PARAM_REQUEST_LIST_DATA { target_system: 0, target_component: 0 };
    let mut heard = world.window(&[MavMessage::PARAM_REQUEST_LIST(all)]);
    heard.extend(world.windows(60));
    assert_eq!(told(&heard).len(), 22);
}

#[test]
fn modem_and_other_vehicles_are_no_ground_station_that_is_heard() {
    let heartbeat = |mavtype| {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA { mavtype, mavlink_version: 3, ..HEARTBEAT_DATA::DEFAULT })
    };
    let mut world = World::new(accept);
    let mut is_heard = |message: MavMessage| {
        world.window(&[message]);
        world.station.was_heard()
    };
    assert!(!is_heard(MavMessage::RADIO_STATUS(RADIO_STATUS_DATA::DEFAULT)));
    assert!(!is_heard(heartbeat(MavType::MAV_TYPE_QUADROTOR)));
    assert!(is_heard(heartbeat(MavType::MAV_TYPE_GCS)));
    assert!(is_heard(command(MavCmd::MAV_CMD_REQUEST_MESSAGE, 148.0)));
    let to_another = COMMAND_LONG_DATA { target_system: 2, ..COMMAND_LONG_DATA::DEFAULT };
    assert!(!is_heard(MavMessage::COMMAND_LONG(to_another)));
}

#[test]
fn fault_in_the_module_is_a_text_with_its_severity_and_number() {
    let mut world = World::new(accept);
    world.windows(10);
    let text = "estimator: killed -> warm_restart (ended by SIGKILL)";
    world.station.telemetry(&Telemetry::Health(HealthText::of(3, text, 2, 0)));
    let texts: Vec<_> = world
        .window(&[])
        .iter()
        .filter_map(|message| match message {
            MavMessage::STATUSTEXT(text) => Some((text.severity, text.text.to_str().unwrap().to_owned())),
            _ => None,
        })
        .collect();
    let said: String = texts.iter().map(|(_, text)| text.as_str()).collect();
    assert_eq!(said, format!("{text} (2 times)"));
    assert!(texts.iter().all(|(severity, _)| *severity == MavSeverity::MAV_SEVERITY_ERROR));
}
