//! Lists of queuing ports (Part 2): a process waits at several ports at once, and is told which one has something.

use super::{configured, valid};
use crate::partition::{Partition, Progress};
use crate::ports::Ports;
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{
    PortAction, PortDirection, QueuingDiscipline, QueuingPortId, QueuingPortListId, ResetList, SystemTime,
};

#[derive(Debug)]
pub(crate) struct PortList {
    pub(crate) waiting: ListId,
    /// Ports that it may have.
    most: usize,
    /// The places of its ports, each with what is done with it.
    ports: Vec<(usize, PortAction)>,
    /// The place in it behind the port that was served last.
    next: usize,
}

/// What a process wants of a list.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    /// The longest message that it takes; `None`: the message stays in its port.
    size: Option<usize>,
    order: ResetList,
}

impl Default for Wanted {
    fn default() -> Self {
        Self { size: None, order: ResetList::Reset }
    }
}

impl Partition {
    /// CREATE_QUEUING_PORT_LIST.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be. NO_ACTION: it is created. INVALID_PARAM: the name, or how many ports it may
    /// have. INVALID_MODE: NORMAL.
    pub fn create_queuing_port_list(
        &mut self,
        name: &str,
        max_list_size: i32,
    ) -> Result<QueuingPortListId, ReturnCode> {
        let name = self.port_lists.new_name(name, &mut self.notices)?;
        valid(max_list_size > 0)?;
        self.initialising()?;
        let most = (max_list_size as usize).min(self.settings.limits.ports);
        let list =
            PortList { waiting: self.queues.add_list(), most, ports: Vec::with_capacity(most), next: 0 };
        Ok(QueuingPortListId::of(self.port_lists.add(name, list)))
    }

    /// ADD_PORT_TO_QUEUING_PORT_LIST. A port may be in several lists.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such list or port, or the action. INVALID_MODE: it is no destination; NORMAL. NO_ACTION: it is in the
    /// list. INVALID_CONFIG: the list is full.
    pub fn add_port_to_queuing_port_list(
        &mut self,
        list: QueuingPortListId,
        port: QueuingPortId,
        action: impl Into<u32>,
    ) -> Result<(), ReturnCode> {
        let (of_list, of_port) = (self.port_lists.get(list.index())?, self.queuing_ports.get(port.index())?);
        let action = PortAction::try_from(action.into())?;
        if of_port.configured.direction != PortDirection::Destination {
            return Err(ReturnCode::InvalidMode);
        }
        let place = port.index().ok_or(ReturnCode::InvalidParam)?;
        if of_list.ports.iter().any(|(known, _)| *known == place) {
            return Err(ReturnCode::NoAction);
        }
        configured(of_list.ports.len() < of_list.most)?;
        self.initialising()?;
        self.port_lists.get_mut(list.index())?.ports.push((place, action));
        Ok(())
    }

    /// SET_PORT_ACTION_IN_QUEUING_PORT_LIST.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such list or port, or the action. INVALID_CONFIG: the port is not in the list. NO_ACTION: it has this
    /// action.
    pub fn set_port_action_in_queuing_port_list(
        &mut self,
        list: QueuingPortListId,
        port: QueuingPortId,
        action: impl Into<u32>,
    ) -> Result<(), ReturnCode> {
        let (member, before) = self.member(list, port)?;
        let action = PortAction::try_from(action.into())?;
        if before == action {
            return Err(ReturnCode::NoAction);
        }
        self.port_lists.get_mut(list.index())?.ports[member].1 = action;
        Ok(())
    }

    /// GET_QUEUING_PORT_ACTION_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such list or port. INVALID_CONFIG: the port is not in the list.
    pub fn get_queuing_port_action_status(
        &self,
        list: QueuingPortListId,
        port: QueuingPortId,
    ) -> Result<PortAction, ReturnCode> {
        self.member(list, port).map(|(_, action)| action)
    }

    /// RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST: the oldest message of the first active port that has one, and that port; or, after
    /// waiting, [`Partition::message`] and [`Partition::served_port_of`].
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such list, the time-out, where to begin, or a message longer than `buffer_size`, which stays.
    /// INVALID_MODE: the caller would have to wait and must not. NOT_AVAILABLE: there is no message. INVALID_CONFIG: there is one, and
    /// another was lost before it. TIMED_OUT, as the result.
    pub fn receive_message_from_queuing_port_list(
        &mut self,
        ports: &mut impl Ports,
        list: QueuingPortListId,
        time_out: SystemTime,
        buffer_size: i32,
        reset_list: impl Into<u32>,
        into: (&mut Vec<u8>, &mut Option<QueuingPortId>),
    ) -> Result<Progress, ReturnCode> {
        let size = Some(usize::try_from(buffer_size).unwrap_or(0));
        self.wait_at_list(ports, (list, time_out), size, reset_list.into(), into)
    }

    /// WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST: as above, and the message stays in its port.
    ///
    /// # Errors
    /// As above, but for what is wrong with a message.
    pub fn wait_for_message_from_queuing_port_list(
        &mut self,
        ports: &mut impl Ports,
        list: QueuingPortListId,
        time_out: SystemTime,
        reset_list: impl Into<u32>,
        port: &mut Option<QueuingPortId>,
    ) -> Result<Progress, ReturnCode> {
        self.wait_at_list(ports, (list, time_out), None, reset_list.into(), (&mut Vec::new(), port))
    }

    /// The port that a process was told of when its wait at a list ended.
    #[must_use]
    pub fn served_port_of(&self, id: crate::standard::ProcessId) -> Option<QueuingPortId> {
        self.place(id).ok().and_then(|place| self.processes[place].served_port)
    }

    fn wait_at_list(
        &mut self,
        ports: &mut impl Ports,
        (list, time_out): (QueuingPortListId, SystemTime),
        size: Option<usize>,
        reset_list: u32,
        (into, port): (&mut Vec<u8>, &mut Option<QueuingPortId>),
    ) -> Result<Progress, ReturnCode> {
        into.clear();
        *port = None;
        let waiting = self.port_lists.get(list.index())?.waiting;
        let place = list.index().ok_or(ReturnCode::InvalidParam)?;
        let time_out = self.time_out(time_out)?;
        let wanted = Wanted { size, order: ResetList::try_from(reset_list)? };
        if self.queues.is_empty(waiting)
            && let Some((served, result)) = self.next_of_list(ports, place, wanted, into)
        {
            *port = Some(served);
            return result.map(Progress::Done);
        }
        let process = self.wait_in(waiting, QueuingDiscipline::Fifo, time_out)?;
        let process = &mut self.processes[process];
        process.message.clear();
        (process.wanted, process.served_port) = (wanted, None);
        Ok(Progress::Waits)
    }

    /// Whether processes wait at lists.
    pub(crate) fn waits_at_lists(&self) -> bool {
        self.port_lists.iter().any(|list| !self.queues.is_empty(list.waiting))
    }

    /// Processes that wait at lists get what there is, behind those that wait at the ports themselves.
    pub(crate) fn serve_lists(&mut self, ports: &mut impl Ports) {
        for place in 0..self.port_lists.len() {
            while self.serve_list(ports, place) {}
        }
    }

    fn serve_list(&mut self, ports: &mut impl Ports, place: usize) -> bool {
        let Some(first) = self.port_lists.at(place).and_then(|list| self.queues.first(list.waiting)) else {
            return false;
        };
        let (wanted, mut message) =
            (self.processes[first].wanted, std::mem::take(&mut self.processes[first].message));
        let served = self.next_of_list(ports, place, wanted, &mut message);
        self.processes[first].message = message;
        let Some((port, result)) = served else { return false };
        self.processes[first].served_port = Some(port);
        self.end_wait(first, result);
        true
    }

    /// The port of a list that has something, and what comes of that; `None`: none has.
    fn next_of_list(
        &mut self,
        ports: &mut impl Ports,
        place: usize,
        wanted: Wanted,
        into: &mut Vec<u8>,
    ) -> Option<(QueuingPortId, Result<(), ReturnCode>)> {
        let list = self.port_lists.at(place)?;
        let (count, begin) = (list.ports.len(), if wanted.order == ResetList::Reset { 0 } else { list.next });
        let found = (0..count).map(|step| (begin + step) % count).find_map(|member| {
            let (port, action) = list.ports[member];
            let of_port = self.queuing_ports.at(port)?;
            // Who waits at the port itself comes first.
            let free = action == PortAction::Active && self.queues.is_empty(of_port.waiting);
            let length = if free { ports.next_length(of_port.configured.key) } else { None };
            length.map(|length| (member, port, of_port.configured.key, length))
        });
        let (member, port, key, length) = found?;
        let result = match wanted.size {
            None => Ok(()),
            Some(size) if size < length => Err(ReturnCode::InvalidParam),
            Some(_) => ports.receive(key, into).map_or(Ok(()), |received| configured(!received.overflow)),
        };
        if result != Err(ReturnCode::InvalidParam)
            && let Ok(list) = self.port_lists.get_mut(Some(place))
        {
            list.next = (member + 1) % count;
        }
        Some((QueuingPortId::of(port), result))
    }

    /// A port's place in a list, and what is done with it.
    fn member(
        &self,
        list: QueuingPortListId,
        port: QueuingPortId,
    ) -> Result<(usize, PortAction), ReturnCode> {
        let list = self.port_lists.get(list.index())?;
        self.queuing_ports.get(port.index())?;
        let member = list.ports.iter().position(|(known, _)| Some(*known) == port.index());
        member.map(|member| (member, list.ports[member].1)).ok_or(ReturnCode::InvalidConfig)
    }
}
