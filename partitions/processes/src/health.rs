//! Errors: who decides about them, the list of the error handler, and what the driver is told.

use std::collections::VecDeque;

use crate::partition::{End, Partition, Runner};
use crate::settings::{Level, Limit, PartitionAction};
use crate::standard::{
    ErrorCode, ErrorHandlerConcurrency, ErrorStatus, MAIN_PROCESS_ID, NULL_PROCESS_ID, Name, OperatingMode,
    ProcessId, StartCondition, SystemTime, Text,
};

/// What was decided about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The module's table decides: the driver hands it on.
    Module,
    /// The partition's table says this.
    Partition(PartitionAction),
    /// The error handler has it.
    Process,
    /// The error handler's list was full.
    Lost,
}

/// What the driver is told, for the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Notice {
    /// REPORT_APPLICATION_MESSAGE.
    Report {
        /// Module time, ns.
        time: SystemTime,
        /// Who said it; [`NULL_PROCESS_ID`] for the error handler.
        process: ProcessId,
        /// What was said.
        text: Text,
    },
    /// An error, and what was decided.
    Error {
        /// Module time, ns.
        time: SystemTime,
        /// The process that it concerns; [`NULL_PROCESS_ID`] for none.
        process: ProcessId,
        /// What happened.
        code: ErrorCode,
        /// What was decided.
        verdict: Verdict,
    },
    /// CREATE_PROCESS was refused because of what the plan says. Told once for each kind of limit.
    Refused {
        /// What the plan allows.
        limit: Limit,
    },
    /// An object was not created because one exists whose name differs in case only.
    SameNameButCase {
        /// That of the object that was not created.
        name: Name,
    },
}

/// What waits for the driver: a bounded list.
#[derive(Debug)]
pub(crate) struct Notices {
    waiting: VecDeque<Notice>,
    most: usize,
    pub(crate) lost: u32,
    /// The kinds of limits that were told of.
    told: Vec<std::mem::Discriminant<Limit>>,
}

impl Notices {
    pub(crate) fn new(most: usize) -> Self {
        Self { waiting: VecDeque::with_capacity(most), most, lost: 0, told: Vec::new() }
    }

    pub(crate) fn add(&mut self, notice: Notice) {
        if self.waiting.len() < self.most {
            self.waiting.push_back(notice);
        } else {
            self.lost = self.lost.saturating_add(1);
        }
    }

    pub(crate) fn refused(&mut self, limit: Limit) {
        let kind = std::mem::discriminant(&limit);
        if !self.told.contains(&kind) {
            self.told.push(kind);
            self.add(Notice::Refused { limit });
        }
    }

    pub(crate) fn take(&mut self) -> Option<Notice> {
        self.waiting.pop_front()
    }
}

/// The error handler of a partition.
#[derive(Debug)]
pub(crate) struct Handler {
    /// It runs, or will as soon as the partition does.
    pub(crate) active: bool,
    /// It sleeps outside of services, and is passed over for the time being.
    pub(crate) lent: bool,
    /// How often it was started.
    pub(crate) life: u32,
    /// It has errors before NORMAL too.
    pub(crate) serves_start: bool,
    pub(crate) concurrency: ErrorHandlerConcurrency,
    pub(crate) core: i32,
}

impl Handler {
    pub(crate) fn run(&mut self) {
        self.active = true;
        self.lent = false;
        self.life = self.life.wrapping_add(1);
    }
}

/// The errors that wait for the handler, oldest first.
#[derive(Debug)]
pub(crate) struct ErrorList {
    entries: VecDeque<ErrorStatus>,
    most: usize,
}

impl ErrorList {
    pub(crate) fn new(most: usize) -> Self {
        Self { entries: VecDeque::with_capacity(most), most }
    }

    /// False if it is full. A fault goes before a missed deadline of its own process.
    fn add(&mut self, error: ErrorStatus) -> bool {
        if self.entries.len() >= self.most {
            return false;
        }
        let later = |entry: &ErrorStatus| {
            entry.failed_process_id == error.failed_process_id
                && entry.error_code == ErrorCode::DeadlineMissed
        };
        let place = if error.error_code == ErrorCode::DeadlineMissed {
            None
        } else {
            self.entries.iter().position(later)
        };
        self.entries.insert(place.unwrap_or(self.entries.len()), error);
        true
    }

    pub(crate) fn take(&mut self) -> Option<ErrorStatus> {
        self.entries.pop_front()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

/// An error that has happened.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Occurrence {
    pub(crate) code: ErrorCode,
    /// Whom it concerns.
    pub(crate) who: Option<Runner>,
    pub(crate) address: usize,
    pub(crate) text: Text,
}

impl Occurrence {
    fn process(&self) -> ProcessId {
        match self.who {
            Some(Runner::Process(id)) => id,
            Some(Runner::Main) => MAIN_PROCESS_ID,
            Some(Runner::Handler) | None => NULL_PROCESS_ID,
        }
    }
}

impl Partition {
    /// The operating system found a fault, at `address` in whatever runs; a power failure concerns no process.
    pub fn fault(&mut self, code: ErrorCode, address: usize) {
        let who = self.running().filter(|_| code != ErrorCode::PowerFail);
        self.error(Occurrence { code, who, address, text: Text::empty() });
    }

    pub(crate) fn miss_deadline(&mut self, place: usize) {
        let who = Some(Runner::Process(ProcessId::of(place)));
        self.error(Occurrence { code: ErrorCode::DeadlineMissed, who, address: 0, text: Text::empty() });
    }

    pub(crate) fn error(&mut self, error: Occurrence) {
        if error.code.stops_its_process()
            && self.mode == OperatingMode::Normal
            && let Some(Runner::Process(id)) = error.who
            && let Ok(place) = self.place(id)
        {
            self.end_in_fault(place);
        }
        let verdict = match self.level_of(&error) {
            Level::Module => Verdict::Module,
            Level::Process => self.tell_handler(&error),
            Level::Partition => Verdict::Partition(self.act(error.code)),
        };
        let (time, process, code) = (self.now, error.process(), error.code);
        self.notices.add(Notice::Error { time, process, code, verdict });
    }

    /// Who decides. The handler does not do so about itself, before NORMAL only if it was enabled, and never about a fault of the main
    /// process, which could not go on.
    fn level_of(&self, error: &Occurrence) -> Level {
        let level = self.settings.health.level[error.code as usize];
        let serves = |handler: &Handler| self.mode == OperatingMode::Normal || handler.serves_start;
        let decides = match error.who {
            Some(Runner::Handler) => false,
            Some(Runner::Main) => !error.code.stops_its_process(),
            Some(Runner::Process(_)) | None => true,
        };
        let handled = decides && self.handler.as_ref().is_some_and(serves);
        if level == Level::Process && !handled { Level::Partition } else { level }
    }

    fn tell_handler(&mut self, error: &Occurrence) -> Verdict {
        let status = ErrorStatus {
            error_code: error.code,
            failed_process_id: error.process(),
            failed_address: error.address,
            message: error.text,
        };
        if !self.errors.add(status) {
            return Verdict::Lost;
        }
        if let Some(handler) = self.handler.as_mut().filter(|handler| !handler.active) {
            handler.run();
        }
        Verdict::Process
    }

    /// Does what the partition's table says of an error.
    fn act(&mut self, code: ErrorCode) -> PartitionAction {
        let action = match self.settings.health.action[code as usize] {
            // What was stopped by a fault would fault again for ever.
            PartitionAction::Ignore if code.stops_its_process() => PartitionAction::ColdStart,
            // Nothing has been initialised that could be found again.
            PartitionAction::WarmStart if self.mode == OperatingMode::ColdStart => PartitionAction::ColdStart,
            action => action,
        };
        let condition = StartCondition::HmPartitionRestart;
        match action {
            PartitionAction::Ignore => {}
            PartitionAction::Idle => self.become_idle(),
            PartitionAction::ColdStart => {
                self.end = Some(End::Restart { mode: OperatingMode::ColdStart, condition });
            }
            PartitionAction::WarmStart => {
                self.end = Some(End::Restart { mode: OperatingMode::WarmStart, condition });
            }
        }
        action
    }

    pub(crate) fn become_idle(&mut self) {
        self.mode = OperatingMode::Idle;
        self.end = Some(End::Idle);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(error_code: ErrorCode, process: i32) -> ErrorStatus {
        ErrorStatus {
            error_code,
            failed_process_id: ProcessId(process),
            failed_address: 0,
            message: Text::empty(),
        }
    }

    #[test]
    fn hmt_08_fault_goes_before_the_missed_deadline_of_its_process() {
        let mut list = ErrorList::new(8);
        for (code, process) in [
            (ErrorCode::DeadlineMissed, 1),
            (ErrorCode::DeadlineMissed, 2),
            (ErrorCode::NumericError, 2),
            (ErrorCode::DeadlineMissed, 3),
        ] {
            assert!(list.add(error(code, process)));
        }
        let order: Vec<(ErrorCode, i32)> = std::iter::from_fn(|| list.take())
            .map(|error| (error.error_code, error.failed_process_id.0))
            .collect();
        assert_eq!(
            order,
            [
                (ErrorCode::DeadlineMissed, 1),
                (ErrorCode::NumericError, 2),
                (ErrorCode::DeadlineMissed, 2),
                (ErrorCode::DeadlineMissed, 3),
            ]
        );
    }
}
