//! Commands of a ground station: arming, modes, calibration, questions.
//!
//! Armed means that the autopilot has the actuators; disarmed, that the safety pilot has them. Mode AUTO is way-point navigation. A command is
//! acknowledged when every function that it concerns has answered, with its reason as a text where one refused.

use bateleur_mavlink::common::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, MavCmd, MavMessage,
    MavModeFlag, MavProtocolCapability, MavResult, MavSeverity, PROTOCOL_VERSION_DATA, SET_MODE_DATA,
};
use bateleur_messages::ground::{
    Manoeuvre, Order, Reason, SENSOR_ACCELEROMETER, SENSOR_GYROSCOPE, SENSOR_PRESSURE,
};
use bateleur_messages::telemetry::{
    ACCEPTED, Acknowledge, FROM_COMMAND, FROM_CONTROLLER, FROM_HIL_INTERFACE, FROM_IMU, FROM_SERVO,
    NOT_UNDERSTOOD,
};

use super::parameters::Encoding;
use super::streams::Streams;
use super::{Out, Peer, why};
use crate::Rates;
use crate::numbers::HZ;

/// How long the functions may take to answer, module time, ns.
const PATIENCE_NS: u64 = 1_500_000_000;
/// The IMU answers when it has measured, which IMU_INIT_TIME may make 10 s.
const CALIBRATION_NS: u64 = 10_000_000_000 + PATIENCE_NS;
/// Numbers of messages that may be asked for.
const AUTOPILOT_VERSION: u32 = 148;
const HOME_POSITION: u32 = 242;
const PROTOCOL_VERSION: u32 = 300;

/// A command that waits for its functions.
#[derive(Debug)]
struct Pending {
    command: u16,
    peer: Peer,
    /// Letter and function of each answer that is missing.
    missing: Vec<(u8, u8)>,
    /// Goes out when all those are there and nobody has refused: the aircraft is handed over to what has taken its orders.
    handover: Option<Order>,
    result: MavResult,
    /// When whoever waits is told next that it takes its time.
    tell_ns: u64,
    until_ns: u64,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Commands {
    pending: Option<Pending>,
    encoding: Encoding,
}

impl Commands {
    pub(super) fn new(encoding: Encoding) -> Self {
        Self { pending: None, encoding }
    }

    pub(super) fn command(
        &mut self,
        command: &COMMAND_LONG_DATA,
        peer: Peer,
        now_ns: u64,
        streams: &Streams,
        out: &mut Out,
    ) {
        let number = command.command as u16;
        let orders = match command.command {
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => {
                switch(command.param1).map(|on| vec![Order::Autopilot { on }])
            }
            MavCmd::MAV_CMD_DO_SET_MODE => match mode_bits(command.param1) {
                Some(mode) if is_custom(mode) => return refuse_custom(peer, out),
                mode => mode.map(orders_of_mode),
            },
            MavCmd::MAV_CMD_MISSION_START => {
                Some(vec![Order::Navigation { on: true }, Order::Autopilot { on: true }])
            }
            MavCmd::MAV_CMD_NAV_TAKEOFF => {
                Some(vec![manoeuvre(Manoeuvre::TakeOff), Order::Autopilot { on: true }])
            }
            MavCmd::MAV_CMD_NAV_LAND => Some(vec![manoeuvre(Manoeuvre::Land)]),
            MavCmd::MAV_CMD_NAV_LOITER_UNLIM => Some(vec![manoeuvre(Manoeuvre::Loiter)]),
            MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => Some(vec![manoeuvre(Manoeuvre::Return)]),
            MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION => calibration(command).map(|sensors| vec![sensors]),
            MavCmd::MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES => {
                acknowledge(number, peer, MavResult::MAV_RESULT_ACCEPTED, out);
                return out.say(&version(out.encoder.identity().0, self.encoding));
            }
            MavCmd::MAV_CMD_REQUEST_MESSAGE => {
                let message = match command.param1 as u32 {
                    AUTOPILOT_VERSION => Some(version(out.encoder.identity().0, self.encoding)),
                    PROTOCOL_VERSION => Some(protocol()),
                    HOME_POSITION => Some(streams.home_position()),
                    _ => None,
                };
                let result = match message {
                    Some(_) => MavResult::MAV_RESULT_ACCEPTED,
                    None => MavResult::MAV_RESULT_UNSUPPORTED,
                };
                acknowledge(number, peer, result, out);
                return message.iter().for_each(|message| out.say(message));
            }
            _ => return self.unsupported(number, peer, out),
        };
        match orders {
            Some(orders) => self.begin(number, peer, orders, now_ns, out),
            None => {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, "command refused: its parameters make no sense");
                acknowledge(number, peer, MavResult::MAV_RESULT_DENIED, out);
            }
        }
    }

    /// The mission goes on with this way-point; `None`: the mission has no such item.
    pub(super) fn go_on_with(&mut self, index: Option<u8>, peer: Peer, now_ns: u64, out: &mut Out) {
        let number = MavCmd::MAV_CMD_DO_SET_MISSION_CURRENT as u16;
        match index {
            Some(index) => self.begin(number, peer, vec![Order::GoOnWith { index }], now_ns, out),
            None => {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, "the mission has no such item");
                acknowledge(number, peer, MavResult::MAV_RESULT_DENIED, out);
            }
        }
    }

    /// A command that is not carried out here, in whatever form it came: who sent it must not wait.
    pub(super) fn unsupported(&self, number: u16, peer: Peer, out: &mut Out) {
        acknowledge(number, peer, MavResult::MAV_RESULT_UNSUPPORTED, out);
    }

    /// The old way to set a mode, which has no answer of its own.
    pub(super) fn set_mode(&mut self, message: &SET_MODE_DATA, peer: Peer, now_ns: u64, out: &mut Out) {
        if is_custom(message.base_mode) {
            return refuse_custom(peer, out);
        }
        let orders = orders_of_mode(message.base_mode);
        self.begin(MavCmd::MAV_CMD_DO_SET_MODE as u16, peer, orders, now_ns, out);
    }

    /// An answer of a function.
    pub(super) fn answered(&mut self, answer: &Acknowledge, out: &mut Out) {
        let Some(pending) = &mut self.pending else { return };
        let before = pending.missing.len();
        // Command answers in the place of a function that is not there or takes nothing.
        pending.missing.retain(|(letter, from)| {
            *letter != answer.letter || (*from != answer.from && answer.from != FROM_COMMAND)
        });
        if pending.missing.len() == before {
            return;
        }
        if answer.result != ACCEPTED {
            pending.result = match answer.result {
                NOT_UNDERSTOOD => MavResult::MAV_RESULT_DENIED,
                _ => MavResult::MAV_RESULT_TEMPORARILY_REJECTED,
            };
            pending.handover = None;
            out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("refused: {}", why(answer)));
        }
        if !pending.missing.is_empty() {
            return;
        }
        if let Some(order) = pending.handover.take() {
            pending.missing = answers_to(&order).to_vec();
            out.orders.push(order);
        } else if let Some(pending) = self.pending.take() {
            acknowledge(pending.command, pending.peer, pending.result, out);
        }
    }

    pub(super) fn window(&mut self, now_ns: u64, out: &mut Out) {
        if let Some(pending) = self.pending.take_if(|pending| now_ns >= pending.until_ns) {
            out.text(MavSeverity::MAV_SEVERITY_WARNING, "a function did not answer: does it run?");
            acknowledge(pending.command, pending.peer, MavResult::MAV_RESULT_FAILED, out);
        }
        if let Some(pending) = self.pending.as_mut().filter(|pending| now_ns >= pending.tell_ns) {
            pending.tell_ns = now_ns.saturating_add(PATIENCE_NS);
            acknowledge(pending.command, pending.peer, MavResult::MAV_RESULT_IN_PROGRESS, out);
        }
    }

    fn begin(&mut self, command: u16, peer: Peer, mut orders: Vec<Order>, now_ns: u64, out: &mut Out) {
        match &self.pending {
            // Sent again because the answer is not there yet.
            Some(pending) if pending.command == command && pending.peer == peer => return,
            Some(_) => {
                return acknowledge(command, peer, MavResult::MAV_RESULT_TEMPORARILY_REJECTED, out);
            }
            None => {}
        }
        let hands_over = orders.len() > 1 && orders.last() == Some(&Order::Autopilot { on: true });
        let handover = if hands_over { orders.pop() } else { None };
        let missing = orders.iter().flat_map(|order| answers_to(order)).copied().collect();
        let measures = orders.iter().any(|order| matches!(order, Order::InitialiseSensors { .. }));
        let patience_ns = if measures { CALIBRATION_NS } else { PATIENCE_NS };
        out.orders.extend(orders);
        self.pending = Some(Pending {
            command,
            peer,
            missing,
            handover,
            result: MavResult::MAV_RESULT_ACCEPTED,
            tell_ns: now_ns.saturating_add(PATIENCE_NS),
            until_ns: now_ns.saturating_add(patience_ns),
        });
    }
}

/// A command with integers as one without; `None` where it names a place to go to, which no command here does.
pub(super) fn without_place(command: &COMMAND_INT_DATA) -> Option<COMMAND_LONG_DATA> {
    // MAV_CMD: numbers up to that of NAV_LAST are about navigation. Zeros and the greatest number stand for no place.
    let navigates = (command.command as u16) < MavCmd::MAV_CMD_NAV_LAST as u16;
    let named = [command.x, command.y].iter().any(|place| ![0, i32::MAX].contains(place));
    (!navigates || !named).then_some(COMMAND_LONG_DATA {
        param1: command.param1,
        param2: command.param2,
        param3: command.param3,
        param4: command.param4,
        param5: command.x as f32,
        param6: command.y as f32,
        param7: command.z,
        command: command.command,
        target_system: command.target_system,
        target_component: command.target_component,
        confirmation: 0,
    })
}

/// Numbers of messages whose rates can be chosen.
const ATTITUDE: f32 = 30.0;
const LOCAL_POSITION_NED: f32 = 32.0;
const GLOBAL_POSITION_INT: f32 = 33.0;
const VFR_HUD: f32 = 74.0;

impl Rates {
    /// MAV_CMD_SET_MESSAGE_INTERVAL: the message of parameter 1 every so many microseconds as parameter 2 says; -1 never, 0 as `usual`.
    pub(super) fn set_interval(&mut self, usual: &Self, command: &COMMAND_LONG_DATA) -> MavResult {
        let (rate_hz, usual_hz) = match command.param1 {
            ATTITUDE => (&mut self.attitude_hz, usual.attitude_hz),
            LOCAL_POSITION_NED | GLOBAL_POSITION_INT => (&mut self.position_hz, usual.position_hz),
            VFR_HUD => (&mut self.hud_hz, usual.hud_hz),
            _ => return MavResult::MAV_RESULT_UNSUPPORTED,
        };
        *rate_hz = match f64::from(command.param2) {
            -1.0 => 0.0,
            0.0 => usual_hz,
            interval_us if interval_us > 0.0 && interval_us.is_finite() => (1e6 / interval_us).min(HZ.1),
            _ => return MavResult::MAV_RESULT_DENIED,
        };
        MavResult::MAV_RESULT_ACCEPTED
    }
}

/// Letter and function of the answers that an order has.
fn answers_to(order: &Order) -> &'static [(u8, u8)] {
    match order {
        Order::Hil { .. } => &[(b'H', FROM_HIL_INTERFACE)],
        Order::Autopilot { .. } => &[(b'A', FROM_CONTROLLER), (b'A', FROM_SERVO)],
        Order::Navigation { .. } => &[(b'N', FROM_CONTROLLER)],
        Order::Manoeuvre { .. } => &[(b'F', FROM_CONTROLLER)],
        Order::GoOnWith { .. } => &[(b'J', FROM_CONTROLLER)],
        Order::InitialiseSensors { .. } => &[(b'I', FROM_IMU)],
        _ => &[],
    }
}

fn manoeuvre(what: Manoeuvre) -> Order {
    Order::Manoeuvre { what, reason: Reason::Ordered }
}

fn switch(value: f32) -> Option<bool> {
    match value {
        0.0 => Some(false),
        1.0 => Some(true),
        _ => None,
    }
}

fn mode_bits(value: f32) -> Option<MavModeFlag> {
    (0.0..=255.0).contains(&value).then(|| MavModeFlag::from_bits_retain(value as u8))
}

/// It is another autopilot's mode by its number. The bits beside it are not meant by themselves: taken so, they would
/// switch navigation and the autopilot off.
fn is_custom(mode: MavModeFlag) -> bool {
    mode.contains(MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
}

fn refuse_custom(peer: Peer, out: &mut Out) {
    let text = "mode refused: there are no custom modes here; give base_mode 4 navigation, 128 armed, 32 HIL";
    out.text(MavSeverity::MAV_SEVERITY_WARNING, text);
    acknowledge(MavCmd::MAV_CMD_DO_SET_MODE as u16, peer, MavResult::MAV_RESULT_UNSUPPORTED, out);
}

/// A mode says whether to navigate and who flies. HIL mode is switched on by it, and off by nobody in flight: a mode that forgets
/// the bit must not take the sensors away.
fn orders_of_mode(mode: MavModeFlag) -> Vec<Order> {
    let navigation = mode.contains(MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED);
    let autopilot = mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
    let hil = mode.contains(MavModeFlag::MAV_MODE_FLAG_HIL_ENABLED).then_some(Order::Hil { on: true });
    let rest = [Order::Navigation { on: navigation }, Order::Autopilot { on: autopilot }];
    hil.into_iter().chain(rest).collect()
}

/// Gyroscope, pressure on the ground, accelerometer: 1 in the first, third and fifth parameter.
fn calibration(command: &COMMAND_LONG_DATA) -> Option<Order> {
    let asked = [
        (command.param1, SENSOR_GYROSCOPE),
        (command.param3, SENSOR_PRESSURE),
        (command.param5, SENSOR_ACCELEROMETER),
    ];
    let sensors = asked.iter().filter(|(value, _)| *value == 1.0).fold(0, |all, (_, bit)| all | bit);
    (sensors != 0).then_some(Order::InitialiseSensors { sensors })
}

pub(super) fn acknowledge(command: u16, peer: Peer, result: MavResult, out: &mut Out) {
    let answer = COMMAND_ACK_DATA {
        result,
        target_system: peer.0,
        target_component: peer.1,
        ..COMMAND_ACK_DATA::DEFAULT
    };
    out.put(|encoder, bytes| encoder.write_command_ack(command, answer, bytes));
}

fn version(system: u8, encoding: Encoding) -> MavMessage {
    let encoding = match encoding {
        Encoding::Bytes => MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
        Encoding::Cast => MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
    };
    MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | encoding,
        uid: u64::from(system),
        ..AUTOPILOT_VERSION_DATA::DEFAULT
    })
}

fn protocol() -> MavMessage {
    MavMessage::PROTOCOL_VERSION(PROTOCOL_VERSION_DATA {
        version: 200,
        min_version: 100,
        max_version: 200,
        ..PROTOCOL_VERSION_DATA::DEFAULT
    })
}
