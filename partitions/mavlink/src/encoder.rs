//! Messages to bytes.

use mavlink::dialects::common::{COMMAND_ACK_DATA, MavMessage};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

use crate::foreign::Acknowledgement;

/// Writes messages of one component, numbered as they go. MAVLink 2, unsigned.
#[derive(Debug, Clone)]
pub struct Encoder {
    system: u8,
    component: u8,
    sequence: u8,
}

impl Encoder {
    /// For the component `component` of system `system`.
    pub fn new(system: u8, component: u8) -> Self {
        Self { system, component, sequence: 0 }
    }

    /// The system and the component that it writes for.
    pub fn identity(&self) -> (u8, u8) {
        (self.system, self.component)
    }

    /// Appends `message` to `out`.
    pub fn write(&mut self, message: &MavMessage, out: &mut Vec<u8>) {
        self.append(out, |raw, header| raw.serialize_message(header, message));
    }

    /// Appends the answer to the command `number`, which the dialect need not know; the command in `answer` does not matter.
    pub fn write_command_ack(&mut self, number: u16, answer: COMMAND_ACK_DATA, out: &mut Vec<u8>) {
        let answer = Acknowledgement { number, rest: answer };
        self.append(out, |raw, header| raw.serialize_message_data(header, &answer));
    }

    fn append(&mut self, out: &mut Vec<u8>, fill: impl FnOnce(&mut MAVLinkV2MessageRaw, MavHeader)) {
        let header = MavHeader {
            system_id: u32::from(self.system),
            component_id: self.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        fill(&mut raw, header);
        out.extend_from_slice(raw.raw_bytes());
    }
}
