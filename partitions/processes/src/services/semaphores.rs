//! Counting semaphores.

use super::{discipline, valid};
use crate::partition::{Partition, Progress};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{MAX_SEMAPHORE_VALUE, QueuingDiscipline, SemaphoreId, SemaphoreStatus, SystemTime};

#[derive(Debug)]
pub(crate) struct Semaphore {
    value: i32,
    maximum: i32,
    discipline: QueuingDiscipline,
    waiting: ListId,
}

impl Partition {
    /// CREATE_SEMAPHORE.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be. NO_ACTION: it exists. INVALID_PARAM: a value, or the discipline.
    /// INVALID_MODE: NORMAL.
    pub fn create_semaphore(
        &mut self,
        name: &str,
        current_value: i32,
        maximum_value: i32,
        queuing_discipline: impl Into<u32>,
    ) -> Result<SemaphoreId, ReturnCode> {
        let name = self.semaphores.new_name(name, &mut self.notices)?;
        valid((0..=MAX_SEMAPHORE_VALUE).contains(&current_value))?;
        valid((current_value..=MAX_SEMAPHORE_VALUE).contains(&maximum_value))?;
        let discipline = discipline(queuing_discipline)?;
        self.initialising()?;
        let waiting = self.queues.add_list();
        let semaphore = Semaphore { value: current_value, maximum: maximum_value, discipline, waiting };
        Ok(SemaphoreId::of(self.semaphores.add(name, semaphore)))
    }

    /// WAIT_SEMAPHORE.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such semaphore, or the time-out. NOT_AVAILABLE: its value is 0. INVALID_MODE: the caller would
    /// have to wait and must not. TIMED_OUT, as the result.
    pub fn wait_semaphore(&mut self, id: SemaphoreId, time_out: SystemTime) -> Result<Progress, ReturnCode> {
        let time_out_from_now = self.time_out(time_out);
        let semaphore = self.semaphores.get_mut(id.index())?;
        let time_out = time_out_from_now?;
        if semaphore.value > 0 {
            semaphore.value -= 1;
            return Ok(Progress::Done(()));
        }
        let (waiting, discipline) = (semaphore.waiting, semaphore.discipline);
        self.wait_plainly(waiting, discipline, time_out)
    }

    /// SIGNAL_SEMAPHORE: the first process that waits has the unit at once; nobody can take it from that process.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such semaphore. NO_ACTION: its value is the highest, and nobody waits.
    pub fn signal_semaphore(&mut self, id: SemaphoreId) -> Result<(), ReturnCode> {
        let waiting = self.semaphores.get(id.index())?.waiting;
        if self.serve_first(waiting).is_some() {
            return Ok(());
        }
        let semaphore = self.semaphores.get_mut(id.index())?;
        if semaphore.value >= semaphore.maximum {
            return Err(ReturnCode::NoAction);
        }
        semaphore.value += 1;
        Ok(())
    }

    /// GET_SEMAPHORE_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no semaphore has that name.
    pub fn get_semaphore_id(&self, name: &str) -> Result<SemaphoreId, ReturnCode> {
        self.semaphores.find(name).map(SemaphoreId::of)
    }

    /// GET_SEMAPHORE_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such semaphore.
    pub fn get_semaphore_status(&self, id: SemaphoreId) -> Result<SemaphoreStatus, ReturnCode> {
        let semaphore = self.semaphores.get(id.index())?;
        Ok(SemaphoreStatus {
            current_value: semaphore.value,
            maximum_value: semaphore.maximum,
            waiting_processes: self.queues.length(semaphore.waiting),
        })
    }
}
