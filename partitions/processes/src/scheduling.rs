//! How processes become ready, wait, and end.

use crate::partition::{Partition, Progress};
use crate::process::{Phase, Wait};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::standard::{INFINITE_TIME_VALUE, OperatingMode, QueuingDiscipline, SystemTime};

/// How long a service may wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TimeOut {
    /// Not at all.
    Poll,
    /// Until this instant.
    At(SystemTime),
    /// For ever.
    Never,
}

impl Partition {
    /// The first process of the highest priority that is ready.
    #[inline]
    pub(crate) fn most_urgent(&self) -> Option<usize> {
        let word = self.ready.iter().rposition(|word| *word != 0)?;
        let priority = word * 64 + self.ready[word].ilog2() as usize;
        self.queues.first(ListId::number(priority))
    }

    fn ready_list(&mut self, place: usize) -> ListId {
        let priority = self.processes[place].priority as usize;
        self.ready[priority / 64] |= 1 << (priority % 64);
        ListId::number(priority)
    }

    /// Puts a process behind its equals, if nothing keeps it from running.
    pub(crate) fn make_ready(&mut self, place: usize) {
        if self.processes[place].is_able() {
            let list = self.ready_list(place);
            self.queues.push_back(list, place);
        }
    }

    /// As above, before its equals.
    pub(crate) fn make_ready_first(&mut self, place: usize) {
        if self.processes[place].is_able() {
            let list = self.ready_list(place);
            self.queues.push_front(list, place);
        }
    }

    /// Takes a ready process from its equals.
    pub(crate) fn leave_ready(&mut self, place: usize) {
        let priority = self.processes[place].priority as usize;
        self.queues.remove(place);
        if self.queues.is_empty(ListId::number(priority)) {
            self.ready[priority / 64] &= !(1 << (priority % 64));
        }
    }

    /// Gives a process a priority; a ready one goes before its new equals (`first`) or behind them.
    pub(crate) fn change_priority(&mut self, place: usize, priority: i32, first: bool) {
        let able = self.processes[place].is_able();
        if able {
            self.leave_ready(place);
        }
        self.processes[place].priority = priority;
        if able {
            let list = self.ready_list(place);
            if first {
                self.queues.push_front(list, place);
            } else {
                self.queues.push_back(list, place);
            }
        }
    }

    /// The process gives way to its equals.
    pub(crate) fn yield_to_equals(&mut self, place: usize) {
        let priority = self.processes[place].priority;
        self.change_priority(place, priority, false);
    }

    /// The caller, if it may wait: a process that owns neither a mutex nor the preemption lock.
    pub(crate) fn may_wait(&self) -> Result<usize, ReturnCode> {
        let caller = self.caller().filter(|place| !self.owns_something(*place));
        caller.ok_or(ReturnCode::InvalidMode)
    }

    /// The process owns a mutex or the preemption lock.
    pub(crate) fn owns_something(&self, place: usize) -> bool {
        self.processes[place].mutex.is_some() || self.lock.owner == Some(place)
    }

    /// What a time-out of a service means from now on.
    pub(crate) fn time_out(&self, time_out: SystemTime) -> Result<TimeOut, ReturnCode> {
        match time_out {
            0 => Ok(TimeOut::Poll),
            INFINITE_TIME_VALUE => Ok(TimeOut::Never),
            span if span > 0 => self.now.checked_add(span).map(TimeOut::At).ok_or(ReturnCode::InvalidParam),
            _ => Err(ReturnCode::InvalidParam),
        }
    }

    /// The caller waits in a list, served in the order of `discipline`.
    pub(crate) fn wait_in(
        &mut self,
        list: ListId,
        discipline: QueuingDiscipline,
        time_out: TimeOut,
    ) -> Result<usize, ReturnCode> {
        if time_out == TimeOut::Poll {
            return Err(ReturnCode::NotAvailable);
        }
        let place = self.may_wait()?;
        self.leave_ready(place);
        self.processes[place].wait = Wait::Object;
        match discipline {
            QueuingDiscipline::Fifo => self.queues.push_back(list, place),
            QueuingDiscipline::Priority => {
                let key = self.processes[place].priority;
                self.queues.push_by_key(list, place, key);
            }
        }
        if let TimeOut::At(at) = time_out {
            self.timers.arm(place, at);
        }
        Ok(place)
    }

    /// As above, for a service that gives nothing but its return code.
    pub(crate) fn wait_plainly(
        &mut self,
        list: ListId,
        discipline: QueuingDiscipline,
        time_out: TimeOut,
    ) -> Result<Progress, ReturnCode> {
        self.wait_in(list, discipline, time_out)?;
        Ok(Progress::Waits)
    }

    /// The process waits until an instant.
    pub(crate) fn wait_until(&mut self, place: usize, at: SystemTime) {
        self.leave_ready(place);
        self.processes[place].wait = Wait::Time;
        self.timers.arm(place, at);
    }

    /// What the process waits for has come, or will not come any more.
    pub(crate) fn end_wait(&mut self, place: usize, result: Result<(), ReturnCode>) {
        self.queues.remove(place);
        self.timers.cancel(place);
        self.processes[place].wait = Wait::Nothing;
        self.processes[place].result = result;
        self.make_ready(place);
    }

    /// The first process of a list has what it waits for.
    pub(crate) fn serve_first(&mut self, list: ListId) -> Option<usize> {
        let place = self.queues.first(list)?;
        self.end_wait(place, Ok(()));
        Some(place)
    }

    /// All processes of a list have it.
    pub(crate) fn serve_all(&mut self, list: ListId) {
        while self.serve_first(list).is_some() {}
    }

    /// The timer of a process's deadline; that of what it waits for has the process's own place.
    fn deadline_timer(&self, place: usize) -> usize {
        self.settings.limits.processes + place
    }

    pub(crate) fn set_deadline(&mut self, place: usize, deadline: SystemTime) {
        let timer = self.deadline_timer(place);
        self.processes[place].deadline = deadline;
        if deadline == INFINITE_TIME_VALUE {
            self.timers.cancel(timer);
        } else {
            self.timers.arm(timer, deadline);
        }
    }

    /// Lets everything that is due take effect.
    pub(crate) fn settle(&mut self) {
        while self.end.is_none()
            && let Some((_, timer)) = self.timers.first().filter(|(at, _)| *at <= self.now)
        {
            self.timers.cancel(timer);
            match timer.checked_sub(self.settings.limits.processes) {
                Some(place) => self.miss_deadline(place),
                None => self.waited_long_enough(timer),
            }
        }
    }

    fn waited_long_enough(&mut self, place: usize) {
        let process = &mut self.processes[place];
        match process.wait {
            Wait::Time => self.end_wait(place, Ok(())),
            Wait::Object => self.end_wait(place, Err(ReturnCode::TimedOut)),
            // It has suspended itself.
            Wait::Nothing | Wait::Normal(_) => {
                process.suspended = false;
                self.end_wait(place, Err(ReturnCode::TimedOut));
            }
        }
    }

    /// A dormant process begins: ready, or waiting for its first release.
    pub(crate) fn begin(&mut self, place: usize, delay: SystemTime) -> Result<(), ReturnCode> {
        let (release, deadline) = self.first_release(place, delay).ok_or(ReturnCode::InvalidConfig)?;
        let in_normal = self.mode == OperatingMode::Normal;
        let process = &mut self.processes[place];
        process.phase = Phase::Started;
        process.life = process.life.wrapping_add(1);
        process.suspended = false;
        process.result = Ok(());
        process.retained = process.attributes.base_priority;
        // Who was stopped with a mutex still has it, and its priority.
        let ceiling = process.mutex.and_then(|mutex| self.mutexes.at(mutex)).map(|mutex| mutex.priority);
        process.priority = ceiling.unwrap_or(process.attributes.base_priority);
        if in_normal {
            self.release(place, release, deadline);
        } else {
            self.processes[place].wait = Wait::Normal(delay);
            self.queues.push_back(self.started, place);
        }
        Ok(())
    }

    /// When a process that is started now is released first, and its deadline then.
    fn first_release(&self, place: usize, delay: SystemTime) -> Option<(SystemTime, SystemTime)> {
        let process = &self.processes[place];
        let from = if process.is_periodic() { self.settings.grid.next_after(self.now)? } else { self.now };
        let release = from.checked_add(delay)?;
        Some((release, process.deadline_of(release)?))
    }

    fn release(&mut self, place: usize, release: SystemTime, deadline: SystemTime) {
        self.processes[place].release = release;
        self.set_deadline(place, deadline);
        if release > self.now {
            self.processes[place].wait = Wait::Time;
            self.timers.arm(place, release);
        } else {
            self.processes[place].wait = Wait::Nothing;
            self.make_ready(place);
        }
    }

    /// The partition enters NORMAL: all that were started are released from this instant on.
    pub(crate) fn enter_normal(&mut self) {
        self.mode = OperatingMode::Normal;
        self.main_ended = true;
        self.reserve_messages();
        while let Some(place) = self.queues.first(self.started) {
            self.queues.remove(place);
            let Wait::Normal(delay) = self.processes[place].wait else { continue };
            // A deadline beyond the end of time is none.
            let first = self.first_release(place, delay);
            let (release, deadline) = first.unwrap_or((self.now, INFINITE_TIME_VALUE));
            self.release(place, release, deadline);
        }
        self.settle();
    }

    /// Every process can hold the longest message, so that none allocates later.
    fn reserve_messages(&mut self) {
        let buffers = self.buffers.iter().map(|buffer| buffer.max_size);
        let blackboards = self.blackboards.iter().map(|blackboard| blackboard.max_size);
        let ports = self.queuing_ports.iter().map(|port| port.configured.max_size as usize);
        let most = buffers.chain(blackboards).chain(ports).max().unwrap_or(0);
        self.processes.iter_mut().for_each(|process| process.message.reserve_exact(most));
    }

    /// The process becomes dormant, wherever it stands. A mutex stays its own.
    pub(crate) fn end_process(&mut self, place: usize) {
        self.quit_running(place);
        self.set_deadline(place, INFINITE_TIME_VALUE);
        let process = &mut self.processes[place];
        process.phase = Phase::Dormant;
        process.wait = Wait::Nothing;
        process.suspended = false;
        if self.lock.owner == Some(place) {
            self.hand_over_lock();
        }
    }

    /// The process faults: it runs no more until somebody resumes or stops it.
    pub(crate) fn end_in_fault(&mut self, place: usize) {
        self.quit_running(place);
        self.processes[place].phase = Phase::Faulted;
    }

    /// Takes a process out of the list that it is in, and its wait's timer with it.
    fn quit_running(&mut self, place: usize) {
        if self.processes[place].is_able() {
            self.leave_ready(place);
        }
        self.processes[place].lent = false;
        self.lent.retain(|lent| *lent != place);
        self.queues.remove(place);
        self.timers.cancel(place);
    }

    /// The preemption lock goes to whoever waits for it first, or is free.
    pub(crate) fn hand_over_lock(&mut self) {
        if let Some(owner) = self.lock.owner.take()
            && self.processes[owner].retained != self.processes[owner].priority
        {
            self.change_priority(owner, self.processes[owner].retained, true);
        }
        self.lock.owner = self.serve_first(self.lock.waiting);
        self.lock.level = i32::from(self.lock.owner.is_some());
    }
}
