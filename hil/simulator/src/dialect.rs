//! What is said in MAVLink: the flight computer's actuators and orders in, sensor sets out.

use crate::flight::Sample;
use bateleur_mavlink::common::{COMMAND_ACK_DATA, MavCmd, MavMessage, MavResult};
use bateleur_mavlink::{Decoder, Encoder, Foreign, Received, hil};
use bateleur_messages::hil::{Actuators, PILOT_TAKE_OFF};

/// A simulator is another component of the aircraft's system; numbers from 25 on are anybody's.
const SYSTEM: u8 = 1;
const COMPONENT: u8 = 25;
/// Answers between two messages about the supply: half a second.
const SUPPLY_ANSWERS: u64 = 25;

/// What somebody wants of the simulator.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Asked {
    /// Fly on, with these actuators.
    Advance(Actuators),
    /// An order for the safety pilot, and its answer.
    Pilot(u32, Vec<u8>),
    /// Something that it does not do, and the answer to that.
    Nothing(Vec<u8>),
}

/// The state of the conversation.
#[derive(Debug, Clone)]
pub(crate) struct Dialect {
    encoder: Encoder,
    decoder: Decoder,
    answers: u64,
}

impl Default for Dialect {
    fn default() -> Self {
        Self { encoder: Encoder::new(SYSTEM, COMPONENT), decoder: Decoder::new(), answers: 0 }
    }
}

impl Dialect {
    /// Reads a datagram; false: it held garbage, in whole or in part.
    pub(crate) fn datagram(&mut self, bytes: &[u8], asked: &mut Vec<Asked>) -> bool {
        self.read(asked, |decoder, received| decoder.datagram(bytes, |one| received.push(one)))
    }

    /// Reads the next bytes of a stream.
    pub(crate) fn stream(&mut self, bytes: &[u8], asked: &mut Vec<Asked>) -> bool {
        self.read(asked, |decoder, received| decoder.stream(bytes, |one| received.push(one)))
    }

    /// Forgets a message that is not whole.
    pub(crate) fn cut(&mut self) {
        self.decoder.cut();
    }

    fn read(&mut self, asked: &mut Vec<Asked>, feed: impl FnOnce(&mut Decoder, &mut Vec<Received>)) -> bool {
        let before = self.decoder.refused();
        let mut received = Vec::new();
        feed(&mut self.decoder, &mut received);
        received.iter().for_each(|one| asked.extend(self.asked(one)));
        self.decoder.refused() == before
    }

    fn asked(&mut self, received: &Received) -> Option<Asked> {
        const TAKE_OFF: u16 = MavCmd::MAV_CMD_NAV_TAKEOFF as u16;
        let number = match &received.message {
            Ok(MavMessage::HIL_ACTUATOR_CONTROLS(message)) => {
                return Some(Asked::Advance(hil::actuators(message)));
            }
            Ok(MavMessage::COMMAND_LONG(command)) => command.command as u16,
            Err(Foreign::Command { number, .. }) => *number,
            // Heartbeats and whatever else a flight computer says of itself.
            _ => return None,
        };
        let result = match number {
            TAKE_OFF => MavResult::MAV_RESULT_ACCEPTED,
            _ => MavResult::MAV_RESULT_UNSUPPORTED,
        };
        let answer = COMMAND_ACK_DATA {
            result,
            target_system: received.system,
            target_component: received.component,
            ..COMMAND_ACK_DATA::DEFAULT
        };
        let mut bytes = Vec::new();
        self.encoder.write_command_ack(number, answer, &mut bytes);
        Some(match number {
            TAKE_OFF => Asked::Pilot(PILOT_TAKE_OFF, bytes),
            _ => Asked::Nothing(bytes),
        })
    }

    /// Appends a sensor set, the sensors last: with them the answer is whole.
    pub(crate) fn answer(&mut self, sample: &Sample, out: &mut Vec<u8>) {
        if let Some(gps) = &sample.gps {
            self.encoder.write(&hil::fix(gps), out);
        }
        if self.answers.is_multiple_of(SUPPLY_ANSWERS) {
            self.encoder.write(&hil::battery(hil::MAIN_BATTERY, sample.custom.main_v), out);
            self.encoder.write(&hil::battery(hil::BACKUP_BATTERY, sample.custom.backup_v), out);
            self.encoder.write(&hil::board_supply(sample.custom.actuator_board_v), out);
        }
        if let Some(range) = &sample.range {
            self.encoder.write(&hil::distance(range), out);
        }
        self.answers += 1;
        self.encoder.write(&hil::sticks(&sample.custom), out);
        self.encoder.write(&hil::sensor(&sample.analog), out);
    }
}
