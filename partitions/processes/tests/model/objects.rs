//! Objects of the model, and who waits at them.

use bateleur_processes::standard::*;
use bateleur_processes::{Partition, ReturnCode, Runner};

use crate::calls::{Answer, Call, Given, NOTHING};
use crate::model::{Model, Wait};

/// What a process may wait at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Object {
    Buffer,
    Blackboard,
    Semaphore,
    Event,
    Mutex(usize),
    Lock,
}

/// The owner of a mutex that belongs to the main process.
const MAIN: i32 = -1;

pub(crate) struct Mutex {
    pub(crate) priority: i32,
    /// As its identifier.
    owner: Option<i32>,
    count: i32,
}

impl Mutex {
    pub(crate) fn new(priority: i32) -> Self {
        Self { priority, owner: None, count: 0 }
    }
}

impl Model {
    /// Those who wait at an object, in their order.
    fn waiting(&self, object: Object) -> Vec<usize> {
        let mut waiting: Vec<usize> = (0..self.processes.len())
            .filter(|place| self.processes[*place].wait == Wait::At(object))
            .collect();
        let by_priority = match object {
            Object::Blackboard | Object::Event => false,
            Object::Lock => true,
            Object::Buffer | Object::Semaphore | Object::Mutex(_) => self.by_priority,
        };
        waiting.sort_by_key(|place| {
            let process = &self.processes[*place];
            (if by_priority { -process.urgency } else { 0 }, process.turn)
        });
        waiting
    }

    fn first(&self, object: Object) -> Option<usize> {
        self.waiting(object).first().copied()
    }

    fn wait_at(&mut self, object: Object, time_out: SystemTime) -> Result<usize, ReturnCode> {
        let wake = self.instant(time_out)?;
        if time_out == 0 {
            return Err(ReturnCode::NotAvailable);
        }
        let place = self.may_wait()?;
        let process = &mut self.processes[place];
        process.wait = Wait::At(object);
        process.wake = wake;
        process.urgency = process.priority;
        self.behind(place);
        Ok(place)
    }

    fn wait_plainly(&mut self, object: Object, time_out: SystemTime) -> Answer {
        self.wait_at(object, time_out).map(|_| Given::Waits)
    }

    pub(crate) fn object(&mut self, call: Call) -> Answer {
        match call {
            Call::Lock => self.lock(),
            Call::Unlock => self.unlock(),
            Call::Send(byte, time_out) => self.send(byte, time_out),
            Call::Receive(time_out) => self.receive(time_out),
            Call::Display(byte) => {
                self.shown = Some(byte);
                for place in self.waiting(Object::Blackboard) {
                    self.processes[place].message = vec![byte];
                    self.wake(place, Ok(()));
                }
                NOTHING
            }
            Call::Read(time_out) => {
                self.instant(time_out)?;
                if let Some(byte) = self.shown {
                    return Ok(Given::Bytes(vec![byte]));
                }
                let place = self.wait_at(Object::Blackboard, time_out)?;
                self.processes[place].message.clear();
                Ok(Given::Waits)
            }
            Call::Clear => {
                self.shown = None;
                NOTHING
            }
            Call::WaitSemaphore(time_out) => {
                self.instant(time_out)?;
                if self.value == 0 {
                    return self.wait_plainly(Object::Semaphore, time_out);
                }
                self.value -= 1;
                NOTHING
            }
            Call::Signal => {
                if let Some(place) = self.first(Object::Semaphore) {
                    self.wake(place, Ok(()));
                } else if self.value == 2 {
                    return Err(ReturnCode::NoAction);
                } else {
                    self.value += 1;
                }
                NOTHING
            }
            Call::SetEvent => {
                self.up = true;
                for place in self.waiting(Object::Event) {
                    self.wake(place, Ok(()));
                }
                NOTHING
            }
            Call::ResetEvent => {
                self.up = false;
                NOTHING
            }
            Call::WaitEvent(time_out) => {
                self.instant(time_out)?;
                if self.up { NOTHING } else { self.wait_plainly(Object::Event, time_out) }
            }
            Call::Acquire(mutex, time_out) => self.acquire(mutex, time_out),
            Call::Release(mutex) => self.release(mutex),
            Call::Reset(mutex, process) => self.reset(mutex, process),
            Call::ResetLock(process) => {
                if self.running() != Some(Runner::Handler) {
                    return Err(ReturnCode::InvalidParam);
                }
                if self.lock_owner != Some(process) {
                    return Err(ReturnCode::InvalidMode);
                }
                self.pass_lock_on();
                NOTHING
            }
            other => panic!("{other:?} is of no object"),
        }
    }

    fn lock(&mut self) -> Answer {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        if self.processes[place].mutex.is_some() {
            return Err(ReturnCode::InvalidMode);
        }
        if self.lock_owner.is_some_and(|owner| owner != place) {
            return self.wait_plainly(Object::Lock, INFINITE_TIME_VALUE);
        }
        if self.lock_level == 16 {
            return Err(ReturnCode::InvalidConfig);
        }
        if self.lock_owner.is_none() {
            self.processes[place].after_release = self.processes[place].priority;
        }
        self.lock_owner = Some(place);
        self.lock_level += 1;
        Ok(Given::Number(self.lock_level.into()))
    }

    fn unlock(&mut self) -> Answer {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        match self.lock_owner {
            None => return Err(ReturnCode::NoAction),
            Some(owner) if owner != place => return Err(ReturnCode::InvalidMode),
            Some(_) => self.lock_level -= 1,
        }
        let level = self.lock_level;
        if level == 0 {
            self.pass_lock_on();
        }
        Ok(Given::Number(level.into()))
    }

    /// The preemption lock leaves its owner.
    pub(crate) fn pass_lock_on(&mut self) {
        if let Some(owner) = self.lock_owner.take()
            && self.processes[owner].priority != self.processes[owner].after_release
        {
            self.processes[owner].priority = self.processes[owner].after_release;
            if self.processes[owner].can_run() {
                self.before(owner);
            }
        }
        self.lock_level = 0;
        if let Some(next) = self.first(Object::Lock) {
            self.lock_owner = Some(next);
            self.lock_level = 1;
            self.processes[next].after_release = self.processes[next].priority;
            self.wake(next, Ok(()));
        }
    }

    fn send(&mut self, byte: u8, time_out: SystemTime) -> Answer {
        self.instant(time_out)?;
        if self.buffer.len() == 2 {
            let place = self.wait_at(Object::Buffer, time_out)?;
            self.processes[place].message = vec![byte];
            return Ok(Given::Waits);
        }
        match self.first(Object::Buffer) {
            Some(receiver) => {
                self.processes[receiver].message = vec![byte];
                self.wake(receiver, Ok(()));
            }
            None => self.buffer.push(byte),
        }
        NOTHING
    }

    fn receive(&mut self, time_out: SystemTime) -> Answer {
        self.instant(time_out)?;
        if self.buffer.is_empty() {
            let place = self.wait_at(Object::Buffer, time_out)?;
            self.processes[place].message.clear();
            return Ok(Given::Waits);
        }
        let byte = self.buffer.remove(0);
        if let Some(sender) = self.first(Object::Buffer) {
            self.buffer.push(self.processes[sender].message[0]);
            self.wake(sender, Ok(()));
        }
        Ok(Given::Bytes(vec![byte]))
    }

    /// The identifier that the caller owns mutexes with.
    fn owning(&self) -> Result<i32, ReturnCode> {
        match self.running() {
            Some(Runner::Main) => Ok(MAIN),
            Some(Runner::Process(id)) => Ok(id.0),
            _ => Err(ReturnCode::InvalidMode),
        }
    }

    fn acquire(&mut self, mutex: usize, time_out: SystemTime) -> Answer {
        self.instant(time_out)?;
        let owning = self.owning()?;
        let owns_another =
            (0..self.mutexes.len()).any(|other| other != mutex && self.mutexes[other].owner == Some(owning));
        let caller = self.caller();
        let too_urgent =
            caller.is_some_and(|place| self.processes[place].priority > self.mutexes[mutex].priority);
        if owns_another || too_urgent || (caller.is_some() && self.lock_owner == caller) {
            return Err(ReturnCode::InvalidMode);
        }
        match self.mutexes[mutex].owner {
            Some(owner) if owner != owning => return self.wait_plainly(Object::Mutex(mutex), time_out),
            Some(_) if self.mutexes[mutex].count == 16 => return Err(ReturnCode::InvalidConfig),
            Some(_) => self.mutexes[mutex].count += 1,
            None => {
                self.give(mutex, owning);
                if let Some(place) = caller {
                    self.before(place);
                }
            }
        }
        NOTHING
    }

    /// A mutex has a new owner, at its priority.
    fn give(&mut self, mutex: usize, owner: i32) {
        let ceiling = self.mutexes[mutex].priority;
        self.mutexes[mutex].owner = Some(owner);
        self.mutexes[mutex].count = 1;
        if owner != MAIN {
            let process = &mut self.processes[owner as usize - 1];
            process.mutex = Some(mutex);
            process.after_release = process.priority;
            process.priority = ceiling;
        }
    }

    fn release(&mut self, mutex: usize) -> Answer {
        if self.owning().is_err() || self.mutexes[mutex].owner != self.owning().ok() {
            return Err(ReturnCode::InvalidMode);
        }
        self.mutexes[mutex].count -= 1;
        if self.mutexes[mutex].count == 0 {
            self.take_away(mutex);
        }
        NOTHING
    }

    fn reset(&mut self, mutex: usize, process: usize) -> Answer {
        let id = process as i32 + 1;
        let allowed = self.running() == Some(Runner::Handler) || self.caller() == Some(process);
        if self.mutexes[mutex].owner != Some(id) || !allowed || !self.normal {
            return Err(ReturnCode::InvalidMode);
        }
        self.take_away(mutex);
        NOTHING
    }

    /// A mutex leaves its owner.
    fn take_away(&mut self, mutex: usize) {
        if let Some(owner) = self.mutexes[mutex].owner.take().filter(|owner| *owner != MAIN) {
            let place = owner as usize - 1;
            self.processes[place].mutex = None;
            self.processes[place].priority = self.processes[place].after_release;
            if self.processes[place].can_run() {
                self.before(place);
            }
        }
        self.mutexes[mutex].count = 0;
        if let Some(next) = self.first(Object::Mutex(mutex)) {
            self.give(mutex, next as i32 + 1);
            self.wake(next, Ok(()));
        }
    }

    pub(crate) fn mutex_of(&self, place: usize) -> MutexId {
        if self.lock_owner == Some(place) {
            return PREEMPTION_LOCK_MUTEX;
        }
        self.processes[place].mutex.map_or(NO_MUTEX_OWNED, |mutex| MutexId((5 << 12) + 1 + mutex as i32))
    }

    pub(crate) fn compare_objects(&self, partition: &Partition, about: &impl Fn() -> String) {
        let count = |object| self.waiting(object).len() as i32;
        let semaphore = partition.get_semaphore_status(partition.get_semaphore_id("s").unwrap()).unwrap();
        let found = (semaphore.current_value, semaphore.waiting_processes);
        assert_eq!(found, (self.value, count(Object::Semaphore)), "semaphore; {}", about());
        let event = partition.get_event_status(partition.get_event_id("e").unwrap()).unwrap();
        let found = (event.event_state == EventState::Up, event.waiting_processes);
        assert_eq!(found, (self.up, count(Object::Event)), "event; {}", about());
        let buffer = partition.get_buffer_status(partition.get_buffer_id("b").unwrap()).unwrap();
        let found = (buffer.nb_message as usize, buffer.waiting_processes);
        assert_eq!(found, (self.buffer.len(), count(Object::Buffer)), "buffer; {}", about());
        let board = partition.get_blackboard_status(partition.get_blackboard_id("b").unwrap()).unwrap();
        let found = (board.empty_indicator == EmptyIndicator::Occupied, board.waiting_processes);
        assert_eq!(found, (self.shown.is_some(), count(Object::Blackboard)), "blackboard; {}", about());
        for (place, mutex) in self.mutexes.iter().enumerate() {
            let id = partition.get_mutex_id(&format!("m{place}")).unwrap();
            let status = partition.get_mutex_status(id).unwrap();
            let found = (status.mutex_owner.0, status.lock_count, status.waiting_processes);
            let expected = (mutex.owner.unwrap_or(0), mutex.count, count(Object::Mutex(place)));
            assert_eq!(found, expected, "mutex {place}; {}", about());
        }
    }
}
