//! Messages to bytes.

use mavlink::dialects::common::MavMessage;
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

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
        let header = MavHeader {
            system_id: u32::from(self.system),
            component_id: self.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        out.extend_from_slice(raw.raw_bytes());
    }
}
