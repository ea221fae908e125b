//! Mutexes with a priority ceiling: whoever owns one runs at its priority.

use super::process::is_priority;
use super::{discipline, valid};
use crate::partition::{Partition, Progress, Runner};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{
    MAIN_PROCESS_ID, MAX_LOCK_LEVEL, MutexId, MutexState, MutexStatus, NO_MUTEX_OWNED, NULL_PROCESS_ID,
    PREEMPTION_LOCK_MUTEX, ProcessId, QueuingDiscipline, SystemTime,
};

#[derive(Debug)]
pub(crate) struct Mutex {
    pub(crate) priority: i32,
    discipline: QueuingDiscipline,
    pub(crate) waiting: ListId,
    owner: Option<Owner>,
    count: i32,
}

/// Who owns a mutex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Main,
    /// By its place.
    Process(usize),
}

impl Owner {
    fn id(self) -> ProcessId {
        match self {
            Self::Main => MAIN_PROCESS_ID,
            Self::Process(place) => ProcessId::of(place),
        }
    }
}

impl Partition {
    /// CREATE_MUTEX.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be. NO_ACTION: it exists. INVALID_PARAM: the priority, or the discipline.
    /// INVALID_MODE: NORMAL.
    pub fn create_mutex(
        &mut self,
        name: &str,
        priority: i32,
        queuing_discipline: impl Into<u32>,
    ) -> Result<MutexId, ReturnCode> {
        let name = self.mutexes.new_name(name, &mut self.notices)?;
        valid(is_priority(priority))?;
        let discipline = discipline(queuing_discipline)?;
        self.initialising()?;
        let waiting = self.queues.add_list();
        let mutex = Mutex { priority, discipline, waiting, owner: None, count: 0 };
        Ok(MutexId::of(self.mutexes.add(name, mutex)))
    }

    /// ACQUIRE_MUTEX. An owner may take it again, up to 16 times.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such mutex, it stands for the preemption lock, or the time-out. INVALID_MODE: the caller is the
    /// error handler, owns another mutex or the preemption lock, or is more urgent than the mutex. INVALID_CONFIG: taken 16 times.
    /// NOT_AVAILABLE: another process owns it. TIMED_OUT, as the result.
    pub fn acquire_mutex(&mut self, id: MutexId, time_out: SystemTime) -> Result<Progress, ReturnCode> {
        let mutex = self.mutexes.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        let caller = self.owner_to_be()?;
        let owned = self.owned_by(caller);
        let locker = matches!(caller, Owner::Process(place) if self.lock.owner == Some(place));
        let too_urgent =
            matches!(caller, Owner::Process(place) if self.processes[place].priority > mutex.priority);
        if locker || too_urgent || (owned.is_some() && owned != id.index()) {
            return Err(ReturnCode::InvalidMode);
        }
        let (waiting, discipline) = (mutex.waiting, mutex.discipline);
        match mutex.owner {
            None => self.own(id, caller)?,
            Some(owner) if owner != caller => return self.wait_plainly(waiting, discipline, time_out),
            Some(_) if mutex.count >= MAX_LOCK_LEVEL => return Err(ReturnCode::InvalidConfig),
            Some(_) => self.mutexes.get_mut(id.index())?.count += 1,
        }
        Ok(Progress::Done(()))
    }

    /// The caller, if it can own a mutex.
    fn owner_to_be(&self) -> Result<Owner, ReturnCode> {
        match self.running() {
            Some(Runner::Main) => Ok(Owner::Main),
            Some(Runner::Process(id)) => self.place(id).map(Owner::Process),
            Some(Runner::Handler) | None => Err(ReturnCode::InvalidMode),
        }
    }

    fn owned_by(&self, owner: Owner) -> Option<usize> {
        match owner {
            Owner::Main => self.main_mutex,
            Owner::Process(place) => self.processes[place].mutex,
        }
    }

    /// A free mutex has an owner.
    fn own(&mut self, id: MutexId, owner: Owner) -> Result<(), ReturnCode> {
        let mutex = self.mutexes.get_mut(id.index())?;
        mutex.owner = Some(owner);
        mutex.count = 1;
        let ceiling = mutex.priority;
        match owner {
            Owner::Main => self.main_mutex = id.index(),
            Owner::Process(place) => {
                self.processes[place].mutex = id.index();
                self.change_priority(place, ceiling, true);
            }
        }
        Ok(())
    }

    /// RELEASE_MUTEX. The first process that waits owns it at once.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such mutex. INVALID_MODE: the caller does not own it.
    pub fn release_mutex(&mut self, id: MutexId) -> Result<(), ReturnCode> {
        let caller = self.owner_to_be();
        let mutex = self.mutexes.get_mut(id.index())?;
        if caller.is_err() || mutex.owner != caller.ok() {
            return Err(ReturnCode::InvalidMode);
        }
        mutex.count -= 1;
        if mutex.count > 0 {
            return Ok(());
        }
        self.hand_over(id)
    }

    /// RESET_MUTEX: takes a mutex from a process that has faulted or was stopped. The error handler can also take the preemption
    /// lock.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such mutex or process, or the preemption lock, unless the caller is the error handler.
    /// INVALID_MODE: the process does not own it, the caller is neither the process nor the error handler, or the mode is not
    /// NORMAL.
    pub fn reset_mutex(&mut self, id: MutexId, process: ProcessId) -> Result<(), ReturnCode> {
        let by_handler = self.running() == Some(Runner::Handler);
        if id == PREEMPTION_LOCK_MUTEX && by_handler {
            let place = self.place(process)?;
            if self.lock.owner != Some(place) {
                return Err(ReturnCode::InvalidMode);
            }
            self.hand_over_lock();
            return Ok(());
        }
        let mutex = self.mutexes.get(id.index())?;
        let owner = self.mutex_owner(process)?;
        let by_owner = self.caller().map(Owner::Process) == Some(owner);
        if mutex.owner != Some(owner) || !(by_owner || by_handler) || !self.is_normal() {
            return Err(ReturnCode::InvalidMode);
        }
        self.hand_over(id)
    }

    fn mutex_owner(&self, id: ProcessId) -> Result<Owner, ReturnCode> {
        if id == MAIN_PROCESS_ID { Ok(Owner::Main) } else { self.place(id).map(Owner::Process) }
    }

    /// The mutex leaves its owner for the first process that waits, or is free.
    fn hand_over(&mut self, id: MutexId) -> Result<(), ReturnCode> {
        let mutex = self.mutexes.get_mut(id.index())?;
        let (waiting, ceiling) = (mutex.waiting, mutex.priority);
        mutex.count = 0;
        match mutex.owner.take() {
            Some(Owner::Process(place)) => {
                self.processes[place].mutex = None;
                self.change_priority(place, self.processes[place].retained, true);
            }
            Some(Owner::Main) => self.main_mutex = None,
            None => {}
        }
        if let Some(place) = self.queues.first(waiting) {
            let process = &mut self.processes[place];
            process.priority = ceiling;
            process.mutex = id.index();
            let mutex = self.mutexes.get_mut(id.index())?;
            mutex.owner = Some(Owner::Process(place));
            mutex.count = 1;
            self.end_wait(place, Ok(()));
        }
        Ok(())
    }

    /// GET_MUTEX_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: no mutex has that name.
    pub fn get_mutex_id(&self, name: &str) -> Result<MutexId, ReturnCode> {
        self.mutexes.find(name).map(MutexId::of)
    }

    /// GET_MUTEX_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such mutex.
    pub fn get_mutex_status(&self, id: MutexId) -> Result<MutexStatus, ReturnCode> {
        let mutex = self.mutexes.get(id.index())?;
        Ok(MutexStatus {
            mutex_owner: mutex.owner.map_or(NULL_PROCESS_ID, Owner::id),
            mutex_state: if mutex.owner.is_some() { MutexState::Owned } else { MutexState::Available },
            mutex_priority: mutex.priority,
            lock_count: mutex.count,
            waiting_processes: self.queues.length(mutex.waiting),
        })
    }

    /// GET_PROCESS_MUTEX_STATE: the mutex that a process owns.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process.
    pub fn get_process_mutex_state(&self, process: ProcessId) -> Result<MutexId, ReturnCode> {
        let owner = self.mutex_owner(process)?;
        if let Owner::Process(place) = owner
            && self.lock.owner == Some(place)
        {
            return Ok(PREEMPTION_LOCK_MUTEX);
        }
        Ok(self.owned_by(owner).map_or(NO_MUTEX_OWNED, MutexId::of))
    }
}
