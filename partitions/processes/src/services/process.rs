//! Process management.

use super::{configured, valid};
use crate::health::Notice;
use crate::partition::{Partition, Progress, Runner};
use crate::process::{Phase, Process, Wait};
use crate::return_code::ReturnCode;
use crate::scheduling::TimeOut;
use crate::settings::{AffinityPermission, Limit};
use crate::standard::{
    CORE_AFFINITY_ANY, CORE_AFFINITY_NO_PREFERENCE, INFINITE_TIME_VALUE, MAX_LOCK_LEVEL, MAX_PRIORITY,
    MIN_PRIORITY, Name, OperatingMode, ProcessAttributes, ProcessId, ProcessState, ProcessStatus,
    QueuingDiscipline, SystemTime,
};

/// The core on which the processes take turns.
const CORE: i32 = 0;

pub(super) fn is_priority(priority: i32) -> bool {
    (MIN_PRIORITY..=MAX_PRIORITY).contains(&priority)
}

/// A span of time above 0, or infinite.
fn is_span(span: SystemTime) -> bool {
    span > 0 || span == INFINITE_TIME_VALUE
}

impl Partition {
    /// GET_PROCESS_ID. The main process and the error handler have no name.
    ///
    /// # Errors
    /// INVALID_CONFIG: no process has that name.
    pub fn get_process_id(&self, name: &str) -> Result<ProcessId, ReturnCode> {
        let name = Name::new(name);
        let place = self.processes.iter().position(|process| Some(process.attributes.name) == name);
        place.map(ProcessId::of).ok_or(ReturnCode::InvalidConfig)
    }

    /// GET_PROCESS_STATUS.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process.
    pub fn get_process_status(&self, id: ProcessId) -> Result<ProcessStatus, ReturnCode> {
        let place = self.place(id)?;
        let process = &self.processes[place];
        let state = match process.phase {
            Phase::Dormant => ProcessState::Dormant,
            Phase::Faulted => ProcessState::Faulted,
            Phase::Started if process.waits() => ProcessState::Waiting,
            Phase::Started if self.caller() == Some(place) => ProcessState::Running,
            Phase::Started => ProcessState::Ready,
        };
        Ok(ProcessStatus {
            deadline_time: process.deadline,
            current_priority: process.priority,
            state,
            attributes: process.attributes,
        })
    }

    /// CREATE_PROCESS.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, their stacks are larger together, or the period is no multiple of the
    /// partition's. NO_ACTION: one with that name exists. INVALID_PARAM: stack size, priority, period or time capacity.
    /// INVALID_MODE: NORMAL.
    pub fn create_process(&mut self, attributes: &ProcessAttributes) -> Result<ProcessId, ReturnCode> {
        let exceeded = self.exceeded_by(attributes);
        if let Some(limit @ (Limit::Processes(_) | Limit::Stacks(_))) = exceeded {
            return self.refuse(limit);
        }
        let same = self.processes.iter().find(|process| process.attributes.name == attributes.name);
        if let Some(same) = same {
            if !same.attributes.name.is_exactly(&attributes.name) {
                self.notices.add(Notice::SameNameButCase { name: attributes.name });
            }
            return Err(ReturnCode::NoAction);
        }
        valid(self.settings.limits.stack.contains(&attributes.stack_size))?;
        valid(is_priority(attributes.base_priority))?;
        let (period, capacity) = (attributes.period, attributes.time_capacity);
        let (periodic, limited) = (period != INFINITE_TIME_VALUE, capacity != INFINITE_TIME_VALUE);
        valid(is_span(period))?;
        if let Some(limit) = exceeded {
            return self.refuse(limit);
        }
        valid(is_span(capacity) && !(periodic && limited && capacity > period))?;
        self.initialising()?;
        self.stack_memory += u64::from(attributes.stack_size);
        self.processes.push(Process::new(*attributes));
        self.queues.add_node();
        Ok(ProcessId::of(self.processes.len() - 1))
    }

    /// What the plan says against such a process.
    #[must_use]
    pub fn exceeded_by(&self, attributes: &ProcessAttributes) -> Option<Limit> {
        let (limits, grid) = (&self.settings.limits, self.settings.grid);
        if self.processes.len() >= limits.processes {
            return Some(Limit::Processes(limits.processes));
        }
        if self.stack_memory + u64::from(attributes.stack_size) > limits.stack_memory {
            return Some(Limit::Stacks(limits.stack_memory));
        }
        let fits = attributes.period == INFINITE_TIME_VALUE || attributes.period % grid.period == 0;
        (!fits).then_some(Limit::Period(grid.period))
    }

    fn refuse<T>(&mut self, limit: Limit) -> Result<T, ReturnCode> {
        self.notices.refused(limit);
        Err(ReturnCode::InvalidConfig)
    }

    /// SET_PRIORITY. That of an owner of a mutex or of the preemption lock changes when it gives it up. The place in a queue stays.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process, or no such priority. INVALID_MODE: it is dormant.
    pub fn set_priority(&mut self, id: ProcessId, priority: i32) -> Result<(), ReturnCode> {
        let place = self.place(id)?;
        valid(is_priority(priority))?;
        if self.is_dormant(place) {
            return Err(ReturnCode::InvalidMode);
        }
        self.processes[place].retained = priority;
        if !self.owns_something(place) {
            self.change_priority(place, priority, false);
        }
        Ok(())
    }

    /// SUSPEND_SELF. `TIMED_OUT` comes as the result if nobody resumed the process.
    ///
    /// # Errors
    /// INVALID_MODE: the caller owns a mutex or the preemption lock, is periodic, or no process. INVALID_PARAM: the time-out.
    pub fn suspend_self(&mut self, time_out: SystemTime) -> Result<Progress, ReturnCode> {
        let place = self.may_wait()?;
        let time_out = self.time_out(time_out)?;
        if self.processes[place].is_periodic() {
            return Err(ReturnCode::InvalidMode);
        }
        if time_out == TimeOut::Poll {
            return Ok(Progress::Done(()));
        }
        self.leave_ready(place);
        self.processes[place].suspended = true;
        self.processes[place].result = Ok(());
        if let TimeOut::At(at) = time_out {
            self.timers.arm(place, at);
        }
        Ok(Progress::Waits)
    }

    /// SUSPEND. One that waits goes on waiting, and is suspended as well.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process, or it is the caller. INVALID_MODE: it owns a mutex or the preemption lock or waits
    /// for one, is dormant, faulted or periodic. NO_ACTION: it is suspended.
    pub fn suspend(&mut self, id: ProcessId) -> Result<(), ReturnCode> {
        let place = self.other(id)?;
        let process = &self.processes[place];
        let started = process.phase == Phase::Started;
        if !started || process.is_periodic() || self.owns_something(place) || self.waits_for_mutex(place) {
            return Err(ReturnCode::InvalidMode);
        }
        if process.suspended {
            return Err(ReturnCode::NoAction);
        }
        if process.is_able() {
            self.leave_ready(place);
        }
        self.processes[place].suspended = true;
        Ok(())
    }

    fn waits_for_mutex(&self, place: usize) -> bool {
        let list = self.queues.list_of(place);
        list == Some(self.lock.waiting) || self.mutexes.iter().any(|mutex| Some(mutex.waiting) == list)
    }

    /// RESUME. A faulted process goes on where it stopped.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process, or it is the caller. INVALID_MODE: it is dormant, or periodic and not faulted.
    /// NO_ACTION: it is neither suspended nor faulted.
    pub fn resume(&mut self, id: ProcessId) -> Result<(), ReturnCode> {
        let place = self.other(id)?;
        let process = &mut self.processes[place];
        match process.phase {
            Phase::Dormant => return Err(ReturnCode::InvalidMode),
            Phase::Faulted => {
                process.phase = Phase::Started;
                self.make_ready(place);
                return Ok(());
            }
            Phase::Started if process.is_periodic() => return Err(ReturnCode::InvalidMode),
            Phase::Started if !process.suspended => return Err(ReturnCode::NoAction),
            Phase::Started => {}
        }
        process.suspended = false;
        if process.wait == Wait::Nothing {
            self.timers.cancel(place); // of SUSPEND_SELF
            self.make_ready(place);
        }
        Ok(())
    }

    /// STOP_SELF: the caller is dormant. The error handler runs again if errors are left.
    pub fn stop_self(&mut self) {
        match self.running() {
            None => {}
            Some(Runner::Main) => self.main_ended = true,
            Some(Runner::Handler) => self.stop_handler(),
            Some(Runner::Process(id)) => {
                if let Ok(place) = self.place(id) {
                    self.end_process(place);
                }
            }
        }
    }

    /// STOP. The process leaves whatever it waits for. A mutex stays its own.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process, or it is the caller. NO_ACTION: it is dormant.
    pub fn stop(&mut self, id: ProcessId) -> Result<(), ReturnCode> {
        let place = self.other(id)?;
        if self.is_dormant(place) {
            return Err(ReturnCode::NoAction);
        }
        self.end_process(place);
        Ok(())
    }

    /// START.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process. NO_ACTION: it is not dormant. INVALID_CONFIG: its deadline is beyond all times.
    pub fn start(&mut self, id: ProcessId) -> Result<(), ReturnCode> {
        let place = self.place(id)?;
        if !self.is_dormant(place) {
            return Err(ReturnCode::NoAction);
        }
        self.begin(place, 0)
    }

    /// DELAYED_START. A periodic process begins so much after the next start of a period, and every later release too.
    ///
    /// # Errors
    /// As [`Partition::start`]; also INVALID_PARAM: the delay is none, infinite, or not below the period.
    pub fn delayed_start(&mut self, id: ProcessId, delay: SystemTime) -> Result<(), ReturnCode> {
        let place = self.place(id)?;
        if !self.is_dormant(place) {
            return Err(ReturnCode::NoAction);
        }
        valid(delay >= 0 && self.now.checked_add(delay).is_some())?;
        let process = &self.processes[place];
        valid(!process.is_periodic() || delay < process.attributes.period)?;
        self.begin(place, delay)
    }

    /// LOCK_PREEMPTION: no other process runs until the lock is given back. Gives the lock's level. The error handler and other
    /// partitions are not held up. The caller waits if the owner has faulted.
    ///
    /// # Errors
    /// NO_ACTION: the caller is the error handler, or the mode is not NORMAL. INVALID_MODE: the caller owns a mutex.
    /// INVALID_CONFIG: the level is 16.
    pub fn lock_preemption(&mut self) -> Result<Progress<i32>, ReturnCode> {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        if self.processes[place].mutex.is_some() {
            return Err(ReturnCode::InvalidMode);
        }
        match self.lock.owner {
            Some(owner) if owner != place => {
                self.wait_in(self.lock.waiting, QueuingDiscipline::Priority, TimeOut::Never)?;
                return Ok(Progress::Waits);
            }
            Some(_) if self.lock.level >= MAX_LOCK_LEVEL => return Err(ReturnCode::InvalidConfig),
            Some(_) => {}
            None => self.lock.owner = Some(place),
        }
        self.lock.level += 1;
        Ok(Progress::Done(self.lock.level))
    }

    /// UNLOCK_PREEMPTION: gives the lock's level.
    ///
    /// # Errors
    /// NO_ACTION: the caller is the error handler, the mode is not NORMAL, or the lock is free. INVALID_MODE: another process owns
    /// it.
    pub fn unlock_preemption(&mut self) -> Result<i32, ReturnCode> {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        let owner = self.lock.owner.ok_or(ReturnCode::NoAction)?;
        if owner != place {
            return Err(ReturnCode::InvalidMode);
        }
        self.lock.level -= 1;
        let level = self.lock.level;
        if level == 0 {
            self.hand_over_lock();
        }
        Ok(level)
    }

    /// GET_MY_ID.
    ///
    /// # Errors
    /// INVALID_MODE: the caller is the main process or the error handler.
    pub fn get_my_id(&self) -> Result<ProcessId, ReturnCode> {
        self.caller().map(ProcessId::of).ok_or(ReturnCode::InvalidMode)
    }

    /// INITIALIZE_PROCESS_CORE_AFFINITY.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process. INVALID_CONFIG: the partition has no such core. INVALID_MODE: NORMAL.
    pub fn initialize_process_core_affinity(&mut self, id: ProcessId, core: i32) -> Result<(), ReturnCode> {
        let place = self.place(id)?;
        configured((0..self.settings.cores).contains(&core))?;
        self.initialising()?;
        self.processes[place].affinity = core;
        Ok(())
    }

    /// GET_MY_PROCESSOR_CORE_ID.
    #[must_use]
    pub fn get_my_processor_core_id(&self) -> i32 {
        let own = self.caller().map_or(self.default_affinity, |place| self.processes[place].affinity);
        own.max(self.default_affinity).max(CORE)
    }

    /// SET_PROCESS_CORE_AFFINITY (Part 2).
    ///
    /// # Errors
    /// INVALID_CONFIG: the partition may not bind processes, or has no such core. INVALID_PARAM: there is no such process. INVALID_MODE:
    /// it may before NORMAL only.
    pub fn set_process_core_affinity(&mut self, id: ProcessId, core: i32) -> Result<(), ReturnCode> {
        let permission = self.settings.affinity;
        configured(permission != AffinityPermission::NotPermitted)?;
        let place = self.place(id)?;
        configured(core == CORE_AFFINITY_NO_PREFERENCE || (0..self.settings.cores).contains(&core))?;
        if permission == AffinityPermission::InitOnly {
            self.initialising()?;
        }
        self.processes[place].affinity = core;
        Ok(())
    }

    /// GET_PROCESS_CORE_AFFINITY (Part 2): CORE_AFFINITY_NO_PREFERENCE where a process has none of its own.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such process.
    pub fn get_process_core_affinity(&self, id: ProcessId) -> Result<i32, ReturnCode> {
        Ok(self.processes[self.place(id)?].affinity)
    }

    /// SET_DEFAULT_PROCESS_CORE_AFFINITY (Part 2): of processes that have no core of their own.
    ///
    /// # Errors
    /// INVALID_CONFIG: the partition has no such core. INVALID_MODE: NORMAL.
    pub fn set_default_process_core_affinity(&mut self, core: i32) -> Result<(), ReturnCode> {
        configured(core == CORE_AFFINITY_ANY || (0..self.settings.cores).contains(&core))?;
        self.initialising()?;
        self.default_affinity = core;
        Ok(())
    }

    /// GET_MY_INDEX: a number of the caller that no other process of the partition has, from 0.
    ///
    /// # Errors
    /// INVALID_MODE: the caller is the main process or the error handler.
    pub fn get_my_index(&self) -> Result<i32, ReturnCode> {
        self.caller().map(|place| place as i32).ok_or(ReturnCode::InvalidMode)
    }

    fn stop_handler(&mut self) {
        let left = !self.errors.is_empty();
        if let Some(handler) = &mut self.handler {
            handler.active = false;
            if left {
                handler.run();
            }
        }
    }

    /// NORMAL has been entered.
    pub(crate) fn is_normal(&self) -> bool {
        self.mode == OperatingMode::Normal
    }
}
