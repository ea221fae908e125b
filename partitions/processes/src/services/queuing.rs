//! Queuing ports: their checks, and the processes that wait at them.

use super::{configured, copy, discipline, valid};
use crate::partition::{Partition, Progress};
use crate::ports::{Ports, QueuingPort};
use crate::return_code::ReturnCode;
use crate::standard::{PortDirection, QueuingPortId, QueuingPortStatus, SystemTime};

impl Partition {
    /// CREATE_QUEUING_PORT.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, the plan has no such port, or another size, depth or direction, or the
    /// discipline. NO_ACTION: it is created. INVALID_PARAM: the name. INVALID_MODE: NORMAL.
    pub fn create_queuing_port(
        &mut self,
        ports: &impl Ports,
        name: &str,
        max_message_size: i32,
        max_nb_message: i32,
        port_direction: impl Into<u32>,
        queuing_discipline: impl Into<u32>,
    ) -> Result<QueuingPortId, ReturnCode> {
        let name = self.queuing_ports.new_name(name, &mut self.notices)?;
        let port = ports.queuing(&name).ok_or(ReturnCode::InvalidConfig)?;
        configured(max_message_size == port.max_size && max_nb_message == port.max_messages)?;
        configured(port_direction.into() == u32::from(port.direction))?;
        let discipline = discipline(queuing_discipline).map_err(|_| ReturnCode::InvalidConfig)?;
        self.initialising()?;
        let waiting = self.queues.add_list();
        let port = QueuingPort { configured: port, discipline, waiting };
        Ok(QueuingPortId::of(self.queuing_ports.add(name, port)))
    }

    /// SEND_QUEUING_MESSAGE.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port, the time-out, or the message is empty. INVALID_CONFIG: it is too long. INVALID_MODE: it
    /// is no source, or the caller would have to wait and must not. NOT_AVAILABLE: there is no room. TIMED_OUT, as the result.
    pub fn send_queuing_message(
        &mut self,
        ports: &mut impl Ports,
        id: QueuingPortId,
        message: &[u8],
        time_out: SystemTime,
    ) -> Result<Progress, ReturnCode> {
        let port = self.queuing_ports.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        configured(message.len() <= port.configured.max_size as usize)?;
        valid(!message.is_empty())?;
        require_direction(port, PortDirection::Source)?;
        let (waiting, discipline) = (port.waiting, port.discipline);
        if self.queues.is_empty(waiting) && ports.send(port.configured.key, message) {
            return Ok(Progress::Done(()));
        }
        let place = self.wait_in(waiting, discipline, time_out)?;
        copy(message, &mut self.processes[place].message);
        Ok(Progress::Waits)
    }

    /// RECEIVE_QUEUING_MESSAGE: the oldest message, or, after waiting, [`Partition::message`].
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port, or the time-out. INVALID_MODE: it is no destination, or the caller would have to wait
    /// and must not. NOT_AVAILABLE: there is no message. INVALID_CONFIG: there is one, and another was lost before it. TIMED_OUT,
    /// as the result.
    pub fn receive_queuing_message(
        &mut self,
        ports: &mut impl Ports,
        id: QueuingPortId,
        time_out: SystemTime,
        into: &mut Vec<u8>,
    ) -> Result<Progress, ReturnCode> {
        into.clear();
        let port = self.queuing_ports.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        require_direction(port, PortDirection::Destination)?;
        let (waiting, discipline) = (port.waiting, port.discipline);
        if self.queues.is_empty(waiting)
            && let Some(received) = ports.receive(port.configured.key, into)
        {
            configured(!received.overflow)?;
            return Ok(Progress::Done(()));
        }
        let place = self.wait_in(waiting, discipline, time_out)?;
        self.processes[place].message.clear();
        Ok(Progress::Waits)
    }

    /// Whether processes wait at queuing ports or lists of them, so that [`Partition::serve_ports`] has something to do.
    #[inline]
    #[must_use]
    pub fn waits_at_ports(&self) -> bool {
        self.queuing_ports.iter().any(|port| !self.queues.is_empty(port.waiting)) || self.waits_at_lists()
    }

    /// Something may have changed in the channels: processes that wait at ports get what there is. The driver calls this when a
    /// window begins, and after a partition in another window may have sent or received.
    pub fn serve_ports(&mut self, ports: &mut impl Ports) {
        for place in 0..self.queuing_ports.len() {
            while self.serve_port(ports, place) {}
        }
        self.serve_lists(ports);
    }

    /// The first process that waits at a port gets what it waits for. False if there is none, or nothing for it.
    fn serve_port(&mut self, ports: &mut impl Ports, place: usize) -> bool {
        let Some(port) = self.queuing_ports.at(place) else { return false };
        let Some(first) = self.queues.first(port.waiting) else { return false };
        let message = &mut self.processes[first].message;
        let result = match port.configured.direction {
            PortDirection::Source => ports.send(port.configured.key, message).then_some(Ok(())),
            PortDirection::Destination => {
                let received = ports.receive(port.configured.key, message);
                received.map(|received| configured(!received.overflow))
            }
        };
        let Some(result) = result else { return false };
        self.end_wait(first, result);
        true
    }

    /// GET_QUEUING_PORT_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no port with that name was created.
    pub fn get_queuing_port_id(&self, name: &str) -> Result<QueuingPortId, ReturnCode> {
        self.queuing_ports.find(name).map(QueuingPortId::of)
    }

    /// GET_QUEUING_PORT_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port.
    pub fn get_queuing_port_status(
        &self,
        ports: &impl Ports,
        id: QueuingPortId,
    ) -> Result<QueuingPortStatus, ReturnCode> {
        let port = self.queuing_ports.get(id.index())?;
        Ok(QueuingPortStatus {
            nb_message: ports.count(port.configured.key),
            max_nb_message: port.configured.max_messages,
            max_message_size: port.configured.max_size,
            port_direction: port.configured.direction,
            waiting_processes: self.queues.length(port.waiting),
        })
    }

    /// CLEAR_QUEUING_PORT.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such port. INVALID_MODE: it is no destination.
    pub fn clear_queuing_port(
        &mut self,
        ports: &mut impl Ports,
        id: QueuingPortId,
    ) -> Result<(), ReturnCode> {
        let port = self.queuing_ports.get(id.index())?;
        require_direction(port, PortDirection::Destination)?;
        ports.clear(port.configured.key);
        Ok(())
    }
}

fn require_direction(port: &QueuingPort, direction: PortDirection) -> Result<(), ReturnCode> {
    if port.configured.direction == direction { Ok(()) } else { Err(ReturnCode::InvalidMode) }
}
