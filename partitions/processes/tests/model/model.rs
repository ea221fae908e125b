//! Processes, modes, time and errors of the model. Objects are in their own file.

use bateleur_processes::standard::*;
use bateleur_processes::{ReturnCode, Runner};

use crate::calls::{Answer, Call, Given, NOTHING};
use crate::objects::{Mutex, Object};
use crate::plan::{PERIOD, Plan, PlannedProcess};

const FOREVER: SystemTime = INFINITE_TIME_VALUE;
/// Errors that wait for the handler.
const ERRORS: usize = 3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Dormant,
    Started,
    Faulted,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wait {
    Nothing,
    Normal { delay: SystemTime },
    Time,
    At(Object),
}

pub(crate) struct Process {
    base: i32,
    pub(crate) period: SystemTime,
    capacity: SystemTime,
    pub(crate) phase: Phase,
    pub(crate) wait: Wait,
    pub(crate) suspended: bool,
    /// When waiting ends by time.
    pub(crate) wake: Option<SystemTime>,
    pub(crate) priority: i32,
    pub(crate) after_release: i32,
    /// Of two that are ready with one priority, the lower runs first; of two that wait, the lower came first.
    pub(crate) turn: i64,
    /// The priority with which it began to wait.
    pub(crate) urgency: i32,
    pub(crate) mutex: Option<usize>,
    deadline: SystemTime,
    /// The deadline was told.
    told: bool,
    release: SystemTime,
    pub(crate) result: Result<(), ReturnCode>,
    pub(crate) message: Vec<u8>,
    life: u32,
}

impl Process {
    pub(crate) fn can_run(&self) -> bool {
        self.phase == Phase::Started && self.wait == Wait::Nothing && !self.suspended
    }

    fn watched_deadline(&self) -> Option<SystemTime> {
        (self.deadline != FOREVER && !self.told).then_some(self.deadline)
    }
}

pub(crate) struct Model {
    now: SystemTime,
    pub(crate) normal: bool,
    main_ended: bool,
    pub(crate) ended: bool,
    pub(crate) processes: Vec<Process>,
    turns: i64,
    pub(crate) lock_owner: Option<usize>,
    pub(crate) lock_level: i32,
    pub(crate) by_priority: bool,
    has_handler: bool,
    handler_runs: bool,
    serves_start: bool,
    handler_life: u32,
    errors: Vec<(ErrorCode, i32)>,
    pub(crate) value: i32,
    pub(crate) up: bool,
    pub(crate) shown: Option<u8>,
    pub(crate) buffer: Vec<u8>,
    pub(crate) mutexes: Vec<Mutex>,
}

impl Model {
    pub(crate) fn new(plan: &Plan) -> Self {
        let process = |planned: &PlannedProcess| Process {
            base: planned.priority,
            period: planned.period,
            capacity: planned.capacity,
            phase: Phase::Dormant,
            wait: Wait::Nothing,
            suspended: false,
            wake: None,
            priority: planned.priority,
            after_release: planned.priority,
            turn: 0,
            urgency: 0,
            mutex: None,
            deadline: FOREVER,
            told: false,
            release: 0,
            result: Ok(()),
            message: Vec::new(),
            life: 0,
        };
        Self {
            now: 0,
            normal: false,
            main_ended: false,
            ended: false,
            processes: plan.processes.iter().map(process).collect(),
            turns: 0,
            lock_owner: None,
            lock_level: 0,
            by_priority: plan.by_priority,
            has_handler: plan.handler,
            handler_runs: false,
            serves_start: false,
            handler_life: 0,
            errors: Vec::new(),
            value: 0,
            up: false,
            shown: None,
            buffer: Vec::new(),
            mutexes: plan.mutexes.iter().map(|priority| Mutex::new(*priority)).collect(),
        }
    }

    pub(crate) fn running(&self) -> Option<Runner> {
        if self.ended {
            return None;
        }
        if self.handler_runs {
            return Some(Runner::Handler);
        }
        if !self.normal {
            return if self.main_ended { None } else { Some(Runner::Main) };
        }
        let mut best: Option<usize> = None;
        for (place, process) in self.processes.iter().enumerate() {
            if !process.can_run() {
                continue;
            }
            if self.lock_owner == Some(place) {
                best = Some(place);
                break;
            }
            let better = best.is_none_or(|best| {
                let best = &self.processes[best];
                process.priority > best.priority
                    || (process.priority == best.priority && process.turn < best.turn)
            });
            if better {
                best = Some(place);
            }
        }
        best.map(|place| Runner::Process(ProcessId(place as i32 + 1)))
    }

    pub(crate) fn caller(&self) -> Option<usize> {
        match self.running() {
            Some(Runner::Process(id)) => Some(id.0 as usize - 1),
            _ => None,
        }
    }

    pub(crate) fn life(&self, who: Runner) -> u32 {
        match who {
            Runner::Main => 1,
            Runner::Handler => self.handler_life,
            Runner::Process(id) => self.processes[id.0 as usize - 1].life,
        }
    }

    pub(crate) fn status(&self, place: usize) -> (ProcessState, i32, SystemTime) {
        let process = &self.processes[place];
        let state = match process.phase {
            Phase::Dormant => ProcessState::Dormant,
            Phase::Faulted => ProcessState::Faulted,
            Phase::Started if self.caller() == Some(place) => ProcessState::Running,
            Phase::Started if process.can_run() => ProcessState::Ready,
            Phase::Started => ProcessState::Waiting,
        };
        (state, process.priority, process.deadline)
    }

    pub(crate) fn next_timer(&self) -> Option<SystemTime> {
        let wakes = self.processes.iter().filter_map(|process| process.wake);
        let deadlines = self.processes.iter().filter_map(Process::watched_deadline);
        wakes.chain(deadlines).min()
    }

    pub(crate) fn advance(&mut self, now: SystemTime) {
        self.now = now;
        while !self.ended {
            // Everything that is due, the earliest first; waking before lateness, then in order of creation.
            let mut due = Vec::new();
            for (place, process) in self.processes.iter().enumerate() {
                due.extend(process.wake.map(|at| (at, 0, place)));
                due.extend(process.watched_deadline().map(|at| (at, 1, place)));
            }
            due.sort_unstable();
            match due.first() {
                Some((at, 0, place)) if *at <= now => self.wait_is_over(*place),
                Some((at, _, place)) if *at <= now => {
                    self.processes[*place].told = true;
                    self.error(ErrorCode::DeadlineMissed, *place as i32 + 1);
                }
                _ => return,
            }
        }
    }

    fn wait_is_over(&mut self, place: usize) {
        let process = &mut self.processes[place];
        let result = if process.wait == Wait::Time { Ok(()) } else { Err(ReturnCode::TimedOut) };
        if process.wait == Wait::Nothing {
            process.suspended = false;
        }
        self.wake(place, result);
    }

    /// A wait ends.
    pub(crate) fn wake(&mut self, place: usize, result: Result<(), ReturnCode>) {
        let process = &mut self.processes[place];
        process.wait = Wait::Nothing;
        process.wake = None;
        process.result = result;
        self.behind(place);
    }

    /// Behind all its equals.
    pub(crate) fn behind(&mut self, place: usize) {
        self.turns += 1;
        self.processes[place].turn = self.turns;
    }

    /// Before all its equals.
    pub(crate) fn before(&mut self, place: usize) {
        self.turns += 1;
        self.processes[place].turn = -self.turns;
    }

    fn error(&mut self, code: ErrorCode, process: i32) {
        if !self.has_handler || !(self.normal || self.serves_start) {
            self.ended = true;
            return;
        }
        if self.errors.len() == ERRORS {
            return;
        }
        let late = (ErrorCode::DeadlineMissed, process);
        match self.errors.iter().position(|error| *error == late) {
            Some(place) if code != ErrorCode::DeadlineMissed => self.errors.insert(place, (code, process)),
            _ => self.errors.push((code, process)),
        }
        if !self.handler_runs {
            self.handler_runs = true;
            self.handler_life += 1;
        }
    }

    fn fault(&mut self, code: ErrorCode) {
        if self.ended {
            return;
        }
        match self.running() {
            _ if code == ErrorCode::PowerFail => self.error(code, 0),
            Some(Runner::Main | Runner::Handler) => self.ended = true,
            Some(Runner::Process(id)) => {
                self.processes[id.0 as usize - 1].phase = Phase::Faulted;
                self.error(code, id.0);
            }
            None => self.error(code, 0),
        }
    }

    pub(crate) fn call(&mut self, call: Call) -> Answer {
        let answer = self.answer(call);
        self.advance(self.now);
        answer
    }

    fn answer(&mut self, call: Call) -> Answer {
        match call {
            Call::Mode(mode) => self.set_mode(mode),
            Call::SetPriority(place, priority) => self.set_priority(place, priority),
            Call::SuspendSelf(time_out) => self.suspend_self(time_out),
            Call::Suspend(place) => self.suspend(place),
            Call::Resume(place) => self.resume(place),
            Call::StopSelf => self.stop_self(),
            Call::Stop(place) => self.stop(place),
            Call::DelayedStart(place, delay) => self.start(place, delay),
            Call::TimedWait(delay) => self.timed_wait(delay),
            Call::PeriodicWait => self.periodic_wait(),
            Call::Replenish(budget) => self.replenish(budget),
            Call::EnableHandler if !self.has_handler => Err(ReturnCode::NoAction),
            Call::EnableHandler => {
                self.serves_start = true;
                NOTHING
            }
            Call::GetError => {
                if !self.handler_runs || self.running() != Some(Runner::Handler) {
                    return Err(ReturnCode::InvalidConfig);
                }
                if self.errors.is_empty() {
                    return Err(ReturnCode::NoAction);
                }
                let (code, process) = self.errors.remove(0);
                Ok(Given::Number(i64::from(u32::from(code)) * 1000 + i64::from(process)))
            }
            Call::Raise => {
                match self.running() {
                    Some(Runner::Process(id)) => self.error(ErrorCode::ApplicationError, id.0),
                    Some(Runner::Main) => self.error(ErrorCode::ApplicationError, MAIN_PROCESS_ID.0),
                    _ => self.ended = true,
                }
                NOTHING
            }
            Call::Fault(code) => {
                self.fault(code);
                NOTHING
            }
            of_object => self.object(of_object),
        }
    }

    fn set_mode(&mut self, mode: OperatingMode) -> Answer {
        if mode == OperatingMode::Idle {
            self.ended = true;
        } else if self.normal {
            return Err(ReturnCode::NoAction);
        } else if self.running() == Some(Runner::Handler) {
            return Err(ReturnCode::InvalidMode);
        } else {
            self.normal = true;
            let mut order: Vec<usize> = (0..self.processes.len()).collect();
            order.sort_by_key(|place| self.processes[*place].turn);
            for place in order {
                if let Wait::Normal { delay } = self.processes[place].wait {
                    self.first_release(place, delay);
                }
            }
        }
        NOTHING
    }

    fn first_release(&mut self, place: usize, delay: SystemTime) {
        let periodic = self.processes[place].period != FOREVER;
        let from = if periodic { (self.now / PERIOD + 1) * PERIOD } else { self.now };
        let release = from + delay;
        let process = &mut self.processes[place];
        process.release = release;
        process.told = false;
        process.deadline = if process.capacity == FOREVER { FOREVER } else { release + process.capacity };
        if release > self.now {
            process.wait = Wait::Time;
            process.wake = Some(release);
        } else {
            process.wait = Wait::Nothing;
            self.behind(place);
        }
    }

    fn set_priority(&mut self, place: usize, priority: i32) -> Answer {
        if !(1..=239).contains(&priority) {
            return Err(ReturnCode::InvalidParam);
        }
        if self.processes[place].phase == Phase::Dormant {
            return Err(ReturnCode::InvalidMode);
        }
        self.processes[place].after_release = priority;
        if self.lock_owner != Some(place) && self.processes[place].mutex.is_none() {
            self.processes[place].priority = priority;
            if self.processes[place].can_run() {
                self.behind(place);
            }
        }
        NOTHING
    }

    /// Whoever calls may wait.
    pub(crate) fn may_wait(&self) -> Result<usize, ReturnCode> {
        match self.caller() {
            Some(place) if self.processes[place].mutex.is_none() && self.lock_owner != Some(place) => {
                Ok(place)
            }
            _ => Err(ReturnCode::InvalidMode),
        }
    }

    fn suspend_self(&mut self, time_out: SystemTime) -> Answer {
        let place = self.may_wait()?;
        let wake = self.instant(time_out)?;
        if self.processes[place].period != FOREVER {
            return Err(ReturnCode::InvalidMode);
        }
        if time_out == 0 {
            return NOTHING;
        }
        let process = &mut self.processes[place];
        process.suspended = true;
        process.result = Ok(());
        process.wake = wake;
        Ok(Given::Waits)
    }

    /// When a time-out from now ends; `None` if never.
    pub(crate) fn instant(&self, time_out: SystemTime) -> Result<Option<SystemTime>, ReturnCode> {
        if time_out < FOREVER {
            return Err(ReturnCode::InvalidParam);
        }
        Ok((time_out != FOREVER).then_some(self.now + time_out))
    }

    fn suspend(&mut self, place: usize) -> Answer {
        if self.caller() == Some(place) {
            return Err(ReturnCode::InvalidParam);
        }
        let process = &self.processes[place];
        let bound = process.mutex.is_some()
            || self.lock_owner == Some(place)
            || matches!(process.wait, Wait::At(Object::Mutex(_) | Object::Lock));
        if bound || process.phase != Phase::Started || process.period != FOREVER {
            return Err(ReturnCode::InvalidMode);
        }
        if process.suspended {
            return Err(ReturnCode::NoAction);
        }
        self.processes[place].suspended = true;
        NOTHING
    }

    fn resume(&mut self, place: usize) -> Answer {
        if self.caller() == Some(place) {
            return Err(ReturnCode::InvalidParam);
        }
        let process = &mut self.processes[place];
        match process.phase {
            Phase::Dormant => return Err(ReturnCode::InvalidMode),
            Phase::Faulted => process.phase = Phase::Started,
            Phase::Started => {
                if process.period != FOREVER {
                    return Err(ReturnCode::InvalidMode);
                }
                if !process.suspended {
                    return Err(ReturnCode::NoAction);
                }
                process.suspended = false;
                if process.wait != Wait::Nothing {
                    return NOTHING;
                }
                process.wake = None;
            }
        }
        self.behind(place);
        NOTHING
    }

    fn stop_self(&mut self) -> Answer {
        match self.running() {
            Some(Runner::Main) => self.main_ended = true,
            Some(Runner::Handler) => {
                self.handler_runs = !self.errors.is_empty();
                self.handler_life += u32::from(self.handler_runs);
            }
            _ => {
                let place = self.caller().unwrap();
                self.end(place);
            }
        }
        NOTHING
    }

    fn stop(&mut self, place: usize) -> Answer {
        if self.caller() == Some(place) {
            return Err(ReturnCode::InvalidParam);
        }
        if self.processes[place].phase == Phase::Dormant {
            return Err(ReturnCode::NoAction);
        }
        self.end(place);
        NOTHING
    }

    fn end(&mut self, place: usize) {
        let process = &mut self.processes[place];
        process.phase = Phase::Dormant;
        process.wait = Wait::Nothing;
        process.wake = None;
        process.deadline = FOREVER;
        process.suspended = false;
        if self.lock_owner == Some(place) {
            self.pass_lock_on();
        }
    }

    fn start(&mut self, place: usize, delay: SystemTime) -> Answer {
        if self.processes[place].phase != Phase::Dormant {
            return Err(ReturnCode::NoAction);
        }
        let period = self.processes[place].period;
        if delay < 0 || (period != FOREVER && delay >= period) {
            return Err(ReturnCode::InvalidParam);
        }
        let ceiling = self.processes[place].mutex.map(|mutex| self.mutexes[mutex].priority);
        let process = &mut self.processes[place];
        process.phase = Phase::Started;
        process.life += 1;
        process.suspended = false;
        process.result = Ok(());
        process.after_release = process.base;
        process.priority = ceiling.unwrap_or(process.base);
        if self.normal {
            self.first_release(place, delay);
        } else {
            process.wait = Wait::Normal { delay };
            self.behind(place);
        }
        NOTHING
    }

    fn timed_wait(&mut self, delay: SystemTime) -> Answer {
        let place = self.may_wait()?;
        if delay < 0 {
            return Err(ReturnCode::InvalidParam);
        }
        if delay == 0 {
            self.behind(place);
            return NOTHING;
        }
        self.processes[place].wait = Wait::Time;
        self.processes[place].wake = Some(self.now + delay);
        Ok(Given::Waits)
    }

    fn periodic_wait(&mut self) -> Answer {
        let place = self.may_wait()?;
        let process = &mut self.processes[place];
        if process.period == FOREVER {
            return Err(ReturnCode::InvalidMode);
        }
        process.release += process.period;
        process.told = false;
        process.deadline =
            if process.capacity == FOREVER { FOREVER } else { process.release + process.capacity };
        process.wait = Wait::Time;
        process.wake = Some(process.release);
        Ok(Given::Waits)
    }

    fn replenish(&mut self, budget: SystemTime) -> Answer {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        if budget < FOREVER {
            return Err(ReturnCode::InvalidParam);
        }
        let now = self.now;
        let process = &mut self.processes[place];
        let beyond = budget == FOREVER || now + budget > process.release + process.period;
        if process.period != FOREVER && beyond {
            return Err(ReturnCode::InvalidMode);
        }
        if process.capacity != FOREVER {
            process.deadline = if budget == FOREVER { FOREVER } else { now + budget };
            process.told = false;
        }
        NOTHING
    }
}
