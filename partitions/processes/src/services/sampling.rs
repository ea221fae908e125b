//! Sampling ports, with the extensions of Part 2.

use super::{configured, valid};
use crate::partition::Partition;
use crate::ports::{Ports, SamplingPort, Written};
use crate::return_code::ReturnCode;
use crate::standard::{
    MessageAge, PortDirection, SamplingPortCurrentStatus, SamplingPortId, SamplingPortStatus, SystemTime,
    Updated, Validity,
};

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
        let port = SamplingPort { configured: port, validity: Validity::Invalid, consumed: None };
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
        let port = self.sampling_destination(id)?;
        let written = ports.read(port.configured.key, into).ok_or(ReturnCode::NoAction)?;
        Ok(port.take(written, now))
    }

    /// READ_UPDATED_SAMPLING_MESSAGE: the latest message, if this port has not given it yet; `updated` says what there was. Any read
    /// counts as having given it, for this port alone.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port. INVALID_MODE: it is no destination. NO_ACTION: nothing was written yet, or nothing since
    /// the last read.
    pub fn read_updated_sampling_message(
        &mut self,
        ports: &mut impl Ports,
        id: SamplingPortId,
        into: &mut Vec<u8>,
        updated: &mut Updated,
    ) -> Result<(), ReturnCode> {
        into.clear();
        *updated = Updated::EmptyPort;
        let now = self.now;
        let port = self.sampling_destination(id)?;
        let written = ports.read(port.configured.key, into);
        *updated = port.updated(written);
        match (*updated, written) {
            (Updated::NewMessage, Some(written)) => {
                port.take(written, now);
                Ok(())
            }
            _ => {
                into.clear();
                Err(ReturnCode::NoAction)
            }
        }
    }

    /// READ_SAMPLING_MESSAGE_CONDITIONAL: the latest message, if it was written after `reference`; `time_stamp` says when it was, 0 where
    /// there is none.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port. INVALID_MODE: it is no destination. NO_ACTION: nothing was written yet, or not after that.
    pub fn read_sampling_message_conditional(
        &mut self,
        ports: &mut impl Ports,
        id: SamplingPortId,
        reference: SystemTime,
        into: &mut Vec<u8>,
        time_stamp: &mut SystemTime,
    ) -> Result<(), ReturnCode> {
        into.clear();
        *time_stamp = 0;
        let now = self.now;
        let port = self.sampling_destination(id)?;
        let written = ports.read(port.configured.key, into).ok_or(ReturnCode::NoAction)?;
        *time_stamp = written.at;
        if written.at <= reference {
            into.clear();
            return Err(ReturnCode::NoAction);
        }
        port.take(written, now);
        Ok(())
    }

    /// GET_SAMPLING_PORT_CURRENT_STATUS: of this moment, without reading. A source has no age and nothing to read.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port.
    pub fn get_sampling_port_current_status(
        &self,
        ports: &mut impl Ports,
        id: SamplingPortId,
    ) -> Result<SamplingPortCurrentStatus, ReturnCode> {
        let port = self.sampling_ports.get(id.index())?;
        let written = match port.configured.direction {
            PortDirection::Source => None,
            PortDirection::Destination => ports.read(port.configured.key, &mut Vec::new()),
        };
        let fresh = written.is_some_and(|written| port.is_fresh(written, self.now));
        Ok(SamplingPortCurrentStatus {
            refresh_period: port.configured.refresh,
            time_stamp: written.map_or(0, |written| written.at),
            max_message_size: port.configured.max_size,
            port_direction: port.configured.direction,
            message_age: if fresh { MessageAge::Fresh } else { MessageAge::Stale },
            updated: port.updated(written),
        })
    }

    fn sampling_destination(&mut self, id: SamplingPortId) -> Result<&mut SamplingPort, ReturnCode> {
        let port = self.sampling_ports.get_mut(id.index())?;
        match port.configured.direction {
            PortDirection::Destination => Ok(port),
            PortDirection::Source => Err(ReturnCode::InvalidMode),
        }
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

impl SamplingPort {
    fn is_fresh(&self, written: Written, now: SystemTime) -> bool {
        now.saturating_sub(written.at) <= self.configured.refresh
    }

    /// The message is given to the partition.
    fn take(&mut self, written: Written, now: SystemTime) -> Validity {
        self.consumed = Some(written);
        self.validity = if self.is_fresh(written, now) { Validity::Valid } else { Validity::Invalid };
        self.validity
    }

    fn updated(&self, written: Option<Written>) -> Updated {
        match written {
            None => Updated::EmptyPort,
            written if written == self.consumed => Updated::ConsumedMessage,
            Some(_) => Updated::NewMessage,
        }
    }
}
