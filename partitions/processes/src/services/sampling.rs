//! Sampling ports.

use super::{configured, valid};
use crate::partition::Partition;
use crate::ports::{Ports, SamplingPort};
use crate::return_code::ReturnCode;
use crate::standard::{PortDirection, SamplingPortId, SamplingPortStatus, SystemTime, Validity};

impl Partition {
    /// CREATE_SAMPLING_PORT. The refresh period of a source means nothing, but has to be above 0.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, or the plan has no such port, or another size, direction or refresh
    /// period. NO_ACTION: it is created. INVALID_PARAM: the name. INVALID_MODE: NORMAL.
    pub fn create_sampling_port(
        &mut self,
        ports: &impl Ports,
        name: &str,
        max_message_size: i32,
        port_direction: impl Into<u32>,
        refresh_period: SystemTime,
    ) -> Result<SamplingPortId, ReturnCode> {
        let name = self.sampling_ports.new_name(name, &mut self.notices)?;
        let port = ports.sampling(&name).ok_or(ReturnCode::InvalidConfig)?;
        configured(max_message_size == port.max_size)?;
        configured(port_direction.into() == u32::from(port.direction))?;
        let source = port.direction == PortDirection::Source;
        configured(refresh_period > 0 && (source || refresh_period == port.refresh))?;
        self.initialising()?;
        let port = SamplingPort { configured: port, validity: Validity::Invalid };
        Ok(SamplingPortId::of(self.sampling_ports.add(name, port)))
    }

    /// WRITE_SAMPLING_MESSAGE.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port, or the message is empty. INVALID_CONFIG: it is too long. INVALID_MODE: it is no source.
    pub fn write_sampling_message(
        &mut self,
        ports: &mut impl Ports,
        id: SamplingPortId,
        message: &[u8],
    ) -> Result<(), ReturnCode> {
        let port = self.sampling_ports.get(id.index())?.configured;
        configured(message.len() <= port.max_size as usize)?;
        valid(!message.is_empty())?;
        if port.direction != PortDirection::Source {
            return Err(ReturnCode::InvalidMode);
        }
        ports.write(port.key, message, self.now);
        Ok(())
    }

    /// READ_SAMPLING_MESSAGE: the latest message, and whether it is valid.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port. INVALID_MODE: it is no destination. NO_ACTION: nothing was written yet.
    pub fn read_sampling_message(
        &mut self,
        ports: &mut impl Ports,
        id: SamplingPortId,
        into: &mut Vec<u8>,
    ) -> Result<Validity, ReturnCode> {
        into.clear();
        let now = self.now;
        let port = self.sampling_ports.get_mut(id.index())?;
        if port.configured.direction != PortDirection::Destination {
            return Err(ReturnCode::InvalidMode);
        }
        let written = ports.read(port.configured.key, into).ok_or(ReturnCode::NoAction)?;
        let fresh = now.saturating_sub(written) <= port.configured.refresh;
        port.validity = if fresh { Validity::Valid } else { Validity::Invalid };
        Ok(port.validity)
    }

    /// GET_SAMPLING_PORT_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no port with that name was created.
    pub fn get_sampling_port_id(&self, name: &str) -> Result<SamplingPortId, ReturnCode> {
        self.sampling_ports.find(name).map(SamplingPortId::of)
    }

    /// GET_SAMPLING_PORT_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port.
    pub fn get_sampling_port_status(&self, id: SamplingPortId) -> Result<SamplingPortStatus, ReturnCode> {
        let port = self.sampling_ports.get(id.index())?;
        Ok(SamplingPortStatus {
            refresh_period: port.configured.refresh,
            max_message_size: port.configured.max_size,
            port_direction: port.configured.direction,
            last_msg_validity: port.validity,
        })
    }
}
