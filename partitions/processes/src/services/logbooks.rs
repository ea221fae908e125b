//! Logbooks (Part 2): messages that outlive the partition. Which there are is the plan's, where they are kept the driver's.

use std::sync::Arc;

use super::{configured, valid};
use crate::logbooks::LogbookMemory;
use crate::partition::Partition;
use crate::return_code::ReturnCode;
use crate::standard::{LogbookId, LogbookStatus, WriteStatus};

/// A logbook that was created.
pub(crate) type Logbook = Arc<dyn LogbookMemory>;

impl Partition {
    /// CREATE_LOGBOOK. What was stored before is still in it; what a predecessor had not written to its end is aborted.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, or the plan has no such logbook, or another size of it. NO_ACTION: it is
    /// created. INVALID_MODE: NORMAL.
    pub fn create_logbook(
        &mut self,
        name: &str,
        max_message_size: i32,
        max_logged: i32,
        max_in_progress: i32,
    ) -> Result<LogbookId, ReturnCode> {
        let name = self.logbooks.new_planned_name(name, &mut self.notices)?;
        let planned = self.settings.logbooks.iter().find(|planned| planned.name == name);
        let memory = planned.ok_or(ReturnCode::InvalidConfig)?.memory.clone();
        let LogbookStatus { max_message_size: size, max_logged: logged, max_in_progress: under_way, .. } =
            memory.status();
        configured((max_message_size, max_logged, max_in_progress) == (size, logged, under_way))?;
        self.initialising()?;
        memory.abort_unfinished();
        Ok(LogbookId::of(self.logbooks.add(name, memory)))
    }

    /// The logbook, if it takes a message of that length.
    fn logbook_for(&self, id: LogbookId, message: &[u8]) -> Result<&Logbook, ReturnCode> {
        let logbook = self.logbooks.get(id.index())?;
        valid(!message.is_empty() && message.len() <= logbook.status().max_message_size as usize)?;
        Ok(logbook)
    }

    /// WRITE_LOGBOOK. Does not wait for the store.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such logbook, or the message is empty or too long. NOT_AVAILABLE: as many messages are on their way to
    /// the store as may be.
    pub fn write_logbook(&self, id: LogbookId, message: &[u8]) -> Result<(), ReturnCode> {
        if self.logbook_for(id, message)?.write(message) { Ok(()) } else { Err(ReturnCode::NotAvailable) }
    }

    /// OVERWRITE_LOGBOOK. Where WRITE_LOGBOOK would find no room, the newest message that is on its way is replaced.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such logbook, or the message is empty or too long. INVALID_CONFIG: fewer than two messages may be on
    /// their way.
    pub fn overwrite_logbook(&self, id: LogbookId, message: &[u8]) -> Result<(), ReturnCode> {
        configured(self.logbooks.get(id.index())?.status().max_in_progress >= 2)?;
        configured(self.logbook_for(id, message)?.overwrite(message))
    }

    /// READ_LOGBOOK: the entry 0 is the newest one. One that was aborted has no content.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such logbook, or it never holds so many. NO_ACTION: it does not hold so many now.
    pub fn read_logbook(
        &self,
        id: LogbookId,
        entry: i32,
        into: &mut Vec<u8>,
    ) -> Result<WriteStatus, ReturnCode> {
        into.clear();
        let logbook = self.logbooks.get(id.index())?;
        valid((0..logbook.status().max_logged).contains(&entry))?;
        logbook.read(entry.cast_unsigned(), into).ok_or(ReturnCode::NoAction)
    }

    /// CLEAR_LOGBOOK.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such logbook. NOT_AVAILABLE: a message is on its way to the store.
    pub fn clear_logbook(&self, id: LogbookId) -> Result<(), ReturnCode> {
        if self.logbooks.get(id.index())?.clear() { Ok(()) } else { Err(ReturnCode::NotAvailable) }
    }

    /// GET_LOGBOOK_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: none with that name is created.
    pub fn get_logbook_id(&self, name: &str) -> Result<LogbookId, ReturnCode> {
        self.logbooks.find(name).map(LogbookId::of)
    }

    /// GET_LOGBOOK_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such logbook.
    pub fn get_logbook_status(&self, id: LogbookId) -> Result<LogbookStatus, ReturnCode> {
        self.logbooks.get(id.index()).map(|logbook| logbook.status())
    }
}
