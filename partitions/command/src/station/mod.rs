//! The aircraft's end of a MAVLink line to a ground station.
//!
//! Responsible for: what a ground station is told unasked (heartbeat, telemetry, texts), and the answers to what it asks (commands, missions,
//! parameters). It moves no bytes and knows no port: bytes come in, messages and orders come out. It must never say that an order was
//! taken before the function has said so.
#![allow(deprecated)] // ground stations in use still send the older messages

mod commands;
mod items;
mod marks;
mod mission;
#[cfg(test)]
mod mission_tests;
mod parameters;
mod streams;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use bateleur_mavlink::common::{
    COMMAND_LONG_DATA, MavCmd, MavMessage, MavSeverity, MavType, STATUSTEXT_DATA,
};
use bateleur_mavlink::{Decoder, Encoder, Foreign, Received, Runway};
use bateleur_messages::State;
use bateleur_messages::ground::{Order, Waypoint};
use bateleur_messages::mark::Mark;
use bateleur_messages::telemetry::{Acknowledge, HealthText, Refusal, Telemetry};
use mavlink::Message;

use commands::Commands;
pub(crate) use mission::MOST_WAYPOINTS;
use mission::Missions;
pub use parameters::Encoding;
use parameters::Parameters;
use streams::Streams;

use crate::Rates;

/// Number of the component: the flight computer of its system.
const AUTOPILOT: u8 = 1;
/// Messages that wait at most; a line that takes none loses the oldest.
const WAITING: usize = 128;
/// Letters of one message's text.
const PIECE: usize = 50;

/// How the station is set up: attributes of Command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// Number of the system.
    pub system: u8,
    /// Where zero is.
    pub runway: Runway,
    /// Functions that can be asked for parameters, one bit for each `FROM_…` constant.
    pub functions: u16,
    /// How whole numbers are put into parameters.
    pub encoding: Encoding,
    /// How often something is told.
    pub rates: Rates,
}

/// Somebody on the line: system, component.
type Peer = (u8, u8);

/// What goes out: messages to the ground, orders to the functions.
#[derive(Debug)]
struct Out {
    encoder: Encoder,
    messages: VecDeque<Vec<u8>>,
    orders: Vec<Order>,
    dropped: u64,
    /// Number of the last text that went in pieces.
    texts: u16,
}

impl Out {
    fn say(&mut self, message: &MavMessage) {
        self.put(|encoder, bytes| encoder.write(message, bytes));
    }

    fn put(&mut self, write: impl FnOnce(&mut Encoder, &mut Vec<u8>)) {
        if self.messages.len() == WAITING {
            self.messages.pop_front();
            self.dropped += 1;
        }
        let mut bytes = Vec::with_capacity(64);
        write(&mut self.encoder, &mut bytes);
        self.messages.push_back(bytes);
    }

    /// A text for the person at the ground station. A longer one than a message holds goes in pieces, which belong together by
    /// their number.
    fn text(&mut self, severity: MavSeverity, text: &str) {
        let pieces = text.as_bytes().chunks(PIECE);
        let whole = text.len() < PIECE;
        if !whole {
            self.texts = self.texts.wrapping_add(1).max(1);
        }
        // A piece that is full says that another one follows.
        let empty: &[u8] = &[];
        let end = (!whole && text.len().is_multiple_of(PIECE)).then_some(empty);
        for (piece, number) in pieces.chain(end).zip(0..=u8::MAX) {
            let mut bytes = [0; PIECE];
            bytes[..piece.len()].copy_from_slice(piece);
            self.say(&MavMessage::STATUSTEXT(STATUSTEXT_DATA {
                severity,
                text: bytes.into(),
                id: if whole { 0 } else { self.texts },
                chunk_seq: number,
            }));
        }
    }
}

/// See the module.
#[derive(Debug)]
pub struct Station {
    system: u8,
    decoder: Decoder,
    out: Out,
    streams: Streams,
    commands: Commands,
    missions: Missions,
    parameters: Parameters,
    heard: bool,
    rates: Rates,
    /// Those of the parameters, which a ground station can come back to.
    usual_rates: Rates,
}

impl Station {
    /// A station that nobody has spoken to.
    pub fn new(setup: &Setup) -> Self {
        Self {
            system: setup.system,
            decoder: Decoder::new(),
            out: Out {
                encoder: Encoder::new(setup.system, AUTOPILOT),
                messages: VecDeque::with_capacity(WAITING),
                orders: Vec::new(),
                dropped: 0,
                texts: 0,
            },
            streams: Streams::new(setup.runway),
            commands: Commands::new(setup.encoding),
            missions: Missions::new(setup.runway),
            parameters: Parameters::new(setup.functions, setup.encoding),
            rates: setup.rates,
            usual_rates: setup.rates,
            heard: false,
        }
    }

    /// Whether a ground station spoke since this was last asked. A modem that reports or another vehicle's heartbeat is none:
    /// neither says that there is still somebody who could give an order.
    pub fn was_heard(&mut self) -> bool {
        std::mem::take(&mut self.heard)
    }

    /// Tells the person at the ground station what Command itself has noticed.
    pub fn warn(&mut self, text: &str) {
        self.out.text(MavSeverity::MAV_SEVERITY_WARNING, text);
    }

    /// What could not be read so far.
    pub fn refused(&self) -> u64 {
        self.decoder.refused().messages()
    }

    /// Messages that the line did not take in time.
    pub fn dropped(&self) -> u64 {
        self.out.dropped
    }

    /// Takes a datagram of the ground station.
    pub fn datagram(&mut self, bytes: &[u8], now_ns: u64) {
        let mut decoder = std::mem::take(&mut self.decoder);
        decoder.datagram(bytes, |received| self.received(&received, now_ns));
        self.decoder = decoder;
    }

    /// Takes the next bytes of a line.
    pub fn stream(&mut self, bytes: &[u8], now_ns: u64) {
        let mut decoder = std::mem::take(&mut self.decoder);
        decoder.stream(bytes, |received| self.received(&received, now_ns));
        self.decoder = decoder;
    }

    /// Tells things at other rates from now on.
    pub fn set_rates(&mut self, rates: Rates) {
        (self.rates, self.usual_rates) = (rates, rates);
    }

    /// Goes on with the Controller's way-points as they were known before a restart.
    pub fn resume_mission(&mut self, waypoints: Vec<Waypoint>) {
        self.missions.resume(waypoints);
    }

    /// The Controller's way-points, as far as they are known.
    pub fn mission(&self) -> &[Waypoint] {
        self.missions.waypoints()
    }

    /// Goes on with the Controller's fence and rally points as they were known before a restart.
    pub fn resume_marks(&mut self, marks: Vec<Mark>) {
        self.missions.resume_marks(marks);
    }

    /// The Controller's fence and rally points, as far as they are known.
    pub fn marks(&self) -> Vec<Mark> {
        self.missions.marks().copied().collect()
    }

    /// Takes what a function tells the ground.
    pub fn telemetry(&mut self, telemetry: &Telemetry) {
        match telemetry {
            Telemetry::Acknowledge(answer) => {
                self.commands.answered(answer, &mut self.out);
                self.missions.answered(answer, &mut self.out);
                self.parameters.answered(answer);
            }
            Telemetry::Parameter(value) => self.parameters.told(value, &mut self.out),
            Telemetry::Health(text) => self.health(text),
            Telemetry::Navigation(navigation) => self.missions.told(navigation.waypoint_count),
            _ => {}
        }
        self.streams.telemetry(telemetry, self.missions.items(), &mut self.out);
    }

    fn health(&mut self, text: &HealthText) {
        use MavSeverity as S;
        let severity = match text.severity {
            0 | 1 => S::MAV_SEVERITY_ALERT,
            2 => S::MAV_SEVERITY_CRITICAL,
            3 => S::MAV_SEVERITY_ERROR,
            4 => S::MAV_SEVERITY_WARNING,
            _ => S::MAV_SEVERITY_NOTICE,
        };
        match text.times {
            0 | 1 => self.out.text(severity, text.text()),
            times => self.out.text(severity, &format!("{} ({times} times)", text.text())),
        }
    }

    /// Takes the estimated state, where the plan gives it.
    pub fn state(&mut self, state: &State) {
        self.streams.state(state);
    }

    /// An order went to the functions, whoever gave it: the way-points are known then.
    pub fn ordered(&mut self, order: &Order) {
        self.missions.ordered(order);
    }

    /// A window at module time `now_ns`: says what is due; gives the orders that the ground station has given.
    pub fn window(&mut self, now_ns: u64) -> Vec<Order> {
        self.commands.window(now_ns, &mut self.out);
        self.missions.window(now_ns, &mut self.out);
        self.parameters.window(now_ns, &mut self.out);
        self.streams.window(now_ns, &self.rates, self.missions.items(), &mut self.out);
        std::mem::take(&mut self.out.orders)
    }

    /// The next message for the line, if one waits.
    pub fn next_message(&mut self) -> Option<Vec<u8>> {
        self.out.messages.pop_front()
    }

    /// Tells the person at the ground station something.
    pub fn tell(&mut self, severity: MavSeverity, text: &str) {
        self.out.text(severity, text);
    }

    fn received(&mut self, received: &Received, now_ns: u64) {
        use bateleur_mavlink::common::MavMessage as M;
        let peer: Peer = (received.system, received.component);
        if peer.0 == self.system && peer.1 == AUTOPILOT {
            return; // our own words, echoed
        }
        self.heard |= self.is_ground(received);
        let out = &mut self.out;
        let is_ours = |target_system: u8| target_system == self.system || target_system == 0;
        let message = match &received.message {
            Ok(message) => message,
            Err(Foreign::Command { number, target_system }) if is_ours(*target_system) => {
                return self.commands.unsupported(*number, peer, out);
            }
            Err(Foreign::Item { seq, target_system, by_frame }) if *target_system == self.system => {
                return self.missions.foreign(*seq, *by_frame, peer, out);
            }
            Err(_) => return,
        };
        // What is for a camera or a gimbal of this system is not for its autopilot.
        if message.target_component_id().is_some_and(|component| component != 0 && component != AUTOPILOT) {
            return;
        }
        match message {
            M::COMMAND_LONG(command) if is_ours(command.target_system) => self.command(command, peer, now_ns),
            M::COMMAND_INT(command) if is_ours(command.target_system) => {
                match commands::without_place(command) {
                    Some(command) => self.command(&command, peer, now_ns),
                    None => self.commands.unsupported(command.command as u16, peer, out),
                }
            }
            M::SET_MODE(message) if message.target_system == self.system => {
                self.commands.set_mode(message, peer, now_ns, out);
            }
            M::PARAM_REQUEST_LIST(message) if is_ours(message.target_system) => self.parameters.list(),
            M::PARAM_REQUEST_READ(message) if message.target_system == self.system => {
                self.parameters.read(message, peer);
            }
            M::PARAM_SET(message) if message.target_system == self.system => {
                self.parameters.set(message, peer, out);
            }
            message => self.missions.message(message, self.system, peer, now_ns, out),
        }
    }

    fn command(&mut self, command: &COMMAND_LONG_DATA, peer: Peer, now_ns: u64) {
        match command.command {
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                let result = self.rates.set_interval(&self.usual_rates, command);
                commands::acknowledge(command.command as u16, peer, result, &mut self.out);
            }
            MavCmd::MAV_CMD_DO_SET_MISSION_CURRENT => {
                // A cast saturates: what is no item's number is none's.
                let item = (command.param1 >= 0.0).then_some(command.param1 as u16);
                let entry = item.and_then(|seq| self.missions.items().waypoint_at(seq));
                self.commands.go_on_with(entry, peer, now_ns, &mut self.out);
            }
            _ => self.commands.command(command, peer, now_ns, &self.streams, &mut self.out),
        }
    }

    /// Whether this is a sign that a ground station is there: its heartbeat, or something said to this aircraft.
    fn is_ground(&self, received: &Received) -> bool {
        match &received.message {
            Ok(MavMessage::HEARTBEAT(heartbeat)) => heartbeat.mavtype == MavType::MAV_TYPE_GCS,
            Ok(message) => {
                let component = message.target_component_id().unwrap_or(AUTOPILOT);
                message.target_system_id() == Some(self.system) && (component == 0 || component == AUTOPILOT)
            }
            Err(Foreign::Command { target_system, .. } | Foreign::Item { target_system, .. }) => {
                *target_system == self.system
            }
            Err(_) => false,
        }
    }
}

/// Why a function did not take an order, for a person.
fn why(answer: &Acknowledge) -> &'static str {
    Refusal::of(answer).map_or("it is not understood", Refusal::text)
}
