//! Buffers: messages between the processes of a partition, each received once.

use super::{configured, copy, discipline, valid};
use crate::partition::{Partition, Progress};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{BufferId, BufferStatus, QueuingDiscipline, SystemTime};

#[derive(Debug)]
pub(crate) struct Buffer {
    pub(crate) max_size: usize,
    /// The length of the message in each slot.
    lengths: Vec<usize>,
    /// The slots, one after the other.
    bytes: Vec<u8>,
    /// The slot of the oldest message.
    first: usize,
    count: usize,
    discipline: QueuingDiscipline,
    /// Senders if it is full, receivers if it is empty.
    waiting: ListId,
}

impl Buffer {
    fn is_full(&self) -> bool {
        self.count == self.lengths.len()
    }

    fn store(&mut self, message: &[u8]) {
        let slot = (self.first + self.count) % self.lengths.len();
        self.lengths[slot] = message.len();
        self.bytes[slot * self.max_size..][..message.len()].copy_from_slice(message);
        self.count += 1;
    }

    fn take(&mut self, into: &mut Vec<u8>) {
        copy(&self.bytes[self.first * self.max_size..][..self.lengths[self.first]], into);
        self.first = (self.first + 1) % self.lengths.len();
        self.count -= 1;
    }
}

impl Partition {
    /// CREATE_BUFFER.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, or no memory is left. NO_ACTION: it exists. INVALID_PARAM: a size, or
    /// the discipline. INVALID_MODE: NORMAL.
    pub fn create_buffer(
        &mut self,
        name: &str,
        max_message_size: i32,
        max_nb_message: i32,
        queuing_discipline: impl Into<u32>,
    ) -> Result<BufferId, ReturnCode> {
        let name = self.buffers.new_name(name, &mut self.notices)?;
        let limits = &self.settings.limits;
        valid((1..=limits.message_size).contains(&max_message_size))?;
        valid((1..=limits.messages).contains(&max_nb_message))?;
        let discipline = discipline(queuing_discipline)?;
        let (max_size, slots) = (max_message_size as usize, max_nb_message as usize);
        let memory = self.object_memory + (max_size * slots) as u64;
        configured(memory <= limits.object_memory)?;
        self.initialising()?;
        self.object_memory = memory;
        let (lengths, bytes) = (vec![0; slots], vec![0; max_size * slots]);
        let waiting = self.queues.add_list();
        let buffer = Buffer { max_size, lengths, bytes, first: 0, count: 0, discipline, waiting };
        Ok(BufferId::of(self.buffers.add(name, buffer)))
    }

    /// SEND_BUFFER.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such buffer, the message is empty or too long, or the time-out. NOT_AVAILABLE: it is full.
    /// INVALID_MODE: the caller would have to wait and must not. TIMED_OUT, as the result.
    pub fn send_buffer(
        &mut self,
        id: BufferId,
        message: &[u8],
        time_out: SystemTime,
    ) -> Result<Progress, ReturnCode> {
        let buffer = self.buffers.get_mut(id.index())?;
        valid((1..=buffer.max_size).contains(&message.len()))?;
        let (waiting, discipline, full) = (buffer.waiting, buffer.discipline, buffer.is_full());
        let time_out = self.time_out(time_out)?;
        if full {
            let place = self.wait_in(waiting, discipline, time_out)?;
            copy(message, &mut self.processes[place].message);
            return Ok(Progress::Waits);
        }
        match self.serve_first(waiting) {
            Some(receiver) => copy(message, &mut self.processes[receiver].message),
            None => self.buffers.get_mut(id.index())?.store(message),
        }
        Ok(Progress::Done(()))
    }

    /// RECEIVE_BUFFER: the oldest message, or, after waiting, [`Partition::message`].
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such buffer, or the time-out. NOT_AVAILABLE: it is empty. INVALID_MODE: the caller would have to
    /// wait and must not. TIMED_OUT, as the result.
    pub fn receive_buffer(
        &mut self,
        id: BufferId,
        time_out: SystemTime,
        into: &mut Vec<u8>,
    ) -> Result<Progress, ReturnCode> {
        into.clear();
        let buffer = self.buffers.get(id.index())?;
        let (waiting, discipline, empty) = (buffer.waiting, buffer.discipline, buffer.count == 0);
        let time_out = self.time_out(time_out)?;
        if empty {
            let place = self.wait_in(waiting, discipline, time_out)?;
            self.processes[place].message.clear();
            return Ok(Progress::Waits);
        }
        let sender = self.serve_first(waiting);
        let buffer = self.buffers.get_mut(id.index())?;
        buffer.take(into);
        if let Some(sender) = sender {
            buffer.store(&self.processes[sender].message);
        }
        Ok(Progress::Done(()))
    }

    /// GET_BUFFER_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no buffer has that name.
    pub fn get_buffer_id(&self, name: &str) -> Result<BufferId, ReturnCode> {
        self.buffers.find(name).map(BufferId::of)
    }

    /// GET_BUFFER_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such buffer.
    pub fn get_buffer_status(&self, id: BufferId) -> Result<BufferStatus, ReturnCode> {
        let buffer = self.buffers.get(id.index())?;
        Ok(BufferStatus {
            nb_message: buffer.count as i32,
            max_nb_message: buffer.lengths.len() as i32,
            max_message_size: buffer.max_size as i32,
            waiting_processes: self.queues.length(buffer.waiting),
        })
    }
}
