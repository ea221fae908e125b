//! Events: up or down, for any number of processes.

use crate::partition::{Partition, Progress};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{EventId, EventState, EventStatus, QueuingDiscipline, SystemTime};

#[derive(Debug)]
pub(crate) struct Event {
    up: bool,
    waiting: ListId,
}

impl Partition {
    /// CREATE_EVENT.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be. NO_ACTION: it exists. INVALID_MODE: NORMAL.
    pub fn create_event(&mut self, name: &str) -> Result<EventId, ReturnCode> {
        let name = self.events.new_name(name, &mut self.notices)?;
        self.initialising()?;
        let waiting = self.queues.add_list();
        Ok(EventId::of(self.events.add(name, Event { up: false, waiting })))
    }

    /// SET_EVENT: everybody who waits for it goes on.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such event.
    pub fn set_event(&mut self, id: EventId) -> Result<(), ReturnCode> {
        let event = self.events.get_mut(id.index())?;
        event.up = true;
        let waiting = event.waiting;
        self.serve_all(waiting);
        Ok(())
    }

    /// RESET_EVENT.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such event.
    pub fn reset_event(&mut self, id: EventId) -> Result<(), ReturnCode> {
        self.events.get_mut(id.index())?.up = false;
        Ok(())
    }

    /// WAIT_EVENT.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such event, or the time-out. NOT_AVAILABLE: it is down. INVALID_MODE: the caller would have to
    /// wait and must not. TIMED_OUT, as the result.
    pub fn wait_event(&mut self, id: EventId, time_out: SystemTime) -> Result<Progress, ReturnCode> {
        let event = self.events.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        if event.up {
            return Ok(Progress::Done(()));
        }
        self.wait_plainly(event.waiting, QueuingDiscipline::Fifo, time_out)
    }

    /// GET_EVENT_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no event has that name.
    pub fn get_event_id(&self, name: &str) -> Result<EventId, ReturnCode> {
        self.events.find(name).map(EventId::of)
    }

    /// GET_EVENT_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such event.
    pub fn get_event_status(&self, id: EventId) -> Result<EventStatus, ReturnCode> {
        let event = self.events.get(id.index())?;
        Ok(EventStatus {
            event_state: if event.up { EventState::Up } else { EventState::Down },
            waiting_processes: self.queues.length(event.waiting),
        })
    }
}
