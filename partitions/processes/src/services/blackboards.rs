//! Blackboards: a message that every process of the partition can read until it is cleared.

use super::{configured, copy, valid};
use crate::partition::{Partition, Progress};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{BlackboardId, BlackboardStatus, EmptyIndicator, QueuingDiscipline, SystemTime};

#[derive(Debug)]
pub(crate) struct Blackboard {
    pub(crate) max_size: usize,
    message: Vec<u8>,
    shown: bool,
    waiting: ListId,
}

impl Partition {
    /// CREATE_BLACKBOARD.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, or no memory is left. NO_ACTION: it exists. INVALID_PARAM: the size.
    /// INVALID_MODE: NORMAL.
    pub fn create_blackboard(
        &mut self,
        name: &str,
        max_message_size: i32,
    ) -> Result<BlackboardId, ReturnCode> {
        let name = self.blackboards.new_name(name, &mut self.notices)?;
        let limits = &self.settings.limits;
        valid((1..=limits.message_size).contains(&max_message_size))?;
        let max_size = max_message_size as usize;
        let memory = self.object_memory + max_size as u64;
        configured(memory <= limits.object_memory)?;
        self.initialising()?;
        self.object_memory = memory;
        let waiting = self.queues.add_list();
        let message = Vec::with_capacity(max_size);
        let blackboard = Blackboard { max_size, message, shown: false, waiting };
        Ok(BlackboardId::of(self.blackboards.add(name, blackboard)))
    }

    /// DISPLAY_BLACKBOARD: every process that waits has this message, whatever is displayed when it runs.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such blackboard, or the message is empty or too long.
    pub fn display_blackboard(&mut self, id: BlackboardId, message: &[u8]) -> Result<(), ReturnCode> {
        let blackboard = self.blackboards.get_mut(id.index())?;
        valid((1..=blackboard.max_size).contains(&message.len()))?;
        copy(message, &mut blackboard.message);
        blackboard.shown = true;
        let waiting = blackboard.waiting;
        while let Some(reader) = self.serve_first(waiting) {
            copy(message, &mut self.processes[reader].message);
        }
        Ok(())
    }

    /// READ_BLACKBOARD: what is displayed, or, after waiting, [`Partition::message`].
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such blackboard, or the time-out. NOT_AVAILABLE: it is empty. INVALID_MODE: the caller would have
    /// to wait and must not. TIMED_OUT, as the result.
    pub fn read_blackboard(
        &mut self,
        id: BlackboardId,
        time_out: SystemTime,
        into: &mut Vec<u8>,
    ) -> Result<Progress, ReturnCode> {
        into.clear();
        let blackboard = self.blackboards.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        if blackboard.shown {
            copy(&blackboard.message, into);
            return Ok(Progress::Done(()));
        }
        let place = self.wait_in(blackboard.waiting, QueuingDiscipline::Fifo, time_out)?;
        self.processes[place].message.clear();
        Ok(Progress::Waits)
    }

    /// CLEAR_BLACKBOARD. Who has been woken keeps its message.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such blackboard.
    pub fn clear_blackboard(&mut self, id: BlackboardId) -> Result<(), ReturnCode> {
        self.blackboards.get_mut(id.index())?.shown = false;
        Ok(())
    }

    /// GET_BLACKBOARD_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no blackboard has that name.
    pub fn get_blackboard_id(&self, name: &str) -> Result<BlackboardId, ReturnCode> {
        self.blackboards.find(name).map(BlackboardId::of)
    }

    /// GET_BLACKBOARD_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such blackboard.
    pub fn get_blackboard_status(&self, id: BlackboardId) -> Result<BlackboardStatus, ReturnCode> {
        let blackboard = self.blackboards.get(id.index())?;
        Ok(BlackboardStatus {
            empty_indicator: if blackboard.shown { EmptyIndicator::Occupied } else { EmptyIndicator::Empty },
            max_message_size: blackboard.max_size as i32,
            waiting_processes: self.queues.length(blackboard.waiting),
        })
    }
}
