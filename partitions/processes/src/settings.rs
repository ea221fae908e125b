//! What the plan says of a partition, as far as its processes depend on it.

use std::ops::RangeInclusive;

use crate::logbooks::PlannedLogbook;
use crate::standard::{
    ErrorCode, MAX_MESSAGE_SIZE, MAX_MESSAGES, MAX_OBJECTS, MAX_PORTS, MAX_PROCESSES, MemoryBlockStatus,
    Name, OperatingMode, SapAddress, StartCondition, SystemTime,
};

/// The instants at which a period of the partition begins: `origin`, and every `period` from there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PeriodGrid {
    /// One of them, module time, ns.
    pub origin: SystemTime,
    /// From one to the next, ns, above 0.
    pub period: SystemTime,
}

impl PeriodGrid {
    /// The first one after `now`; `None` if it is beyond what a time can say.
    #[must_use]
    pub fn next_after(&self, now: SystemTime) -> Option<SystemTime> {
        let since = now.checked_sub(self.origin)?;
        let periods = since.div_euclid(self.period).checked_add(1)?;
        self.origin.checked_add(periods.checked_mul(self.period)?)
    }
}

/// Who decides about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// The module's health table, in the executive.
    Module,
    /// The partition's health table.
    Partition,
    /// The partition's error handler; without one, its table.
    Process,
}

/// What the partition's health table says of an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartitionAction {
    /// Nothing.
    Ignore,
    /// The partition ends.
    Idle,
    /// It starts again.
    ColdStart,
    /// It starts again, and finds what it retained.
    WarmStart,
}

/// Levels and actions, by the number of the error code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HealthTable {
    /// Who decides.
    pub level: [Level; ErrorCode::COUNT],
    /// What the partition's table says.
    pub action: [PartitionAction; ErrorCode::COUNT],
}

impl Default for HealthTable {
    /// Every error is the process's, and without a handler the partition is started again.
    fn default() -> Self {
        Self {
            level: [Level::Process; ErrorCode::COUNT],
            action: [PartitionAction::WarmStart; ErrorCode::COUNT],
        }
    }
}

/// What the plan does not let CREATE_PROCESS do, with how to mend it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// There are as many processes as there may be.
    Processes(usize),
    /// The stacks would have more bytes together.
    Stacks(u64),
    /// The period is no multiple of the partition's, ns.
    Period(SystemTime),
}

impl std::fmt::Display for Limit {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Processes(most) => write!(formatter, "the plan's `processes` allows {most}"),
            Self::Stacks(most) => write!(formatter, "the plan's `stacks` allows {most} bytes together"),
            Self::Period(period) => {
                write!(formatter, "its period is no multiple of the partition's, {} us", period / 1000)
            }
        }
    }
}

/// How much there is of everything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// Processes.
    pub processes: usize,
    /// Objects of each class.
    pub objects: usize,
    /// Ports of each class.
    pub ports: usize,
    /// Bytes of a message of buffers and blackboards.
    pub message_size: i32,
    /// Messages of a buffer.
    pub messages: i32,
    /// Bytes of a process's stack.
    pub stack: RangeInclusive<u32>,
    /// Bytes of all stacks together.
    pub stack_memory: u64,
    /// Bytes of all buffers and blackboards together.
    pub object_memory: u64,
    /// Errors that wait for the error handler.
    pub errors: usize,
    /// Notices that wait for the driver.
    pub notices: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            processes: MAX_PROCESSES,
            objects: MAX_OBJECTS,
            ports: MAX_PORTS,
            message_size: MAX_MESSAGE_SIZE,
            messages: MAX_MESSAGES,
            stack: 8 << 10..=64 << 20,
            stack_memory: 1 << 30,
            object_memory: 64 << 20,
            // A deadline and a fault of each process.
            errors: 2 * MAX_PROCESSES,
            notices: 64,
        }
    }
}

/// When a partition may bind its processes to cores (Part 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AffinityPermission {
    /// Never.
    NotPermitted,
    /// Before NORMAL.
    InitOnly,
    /// Always.
    AllModes,
}

/// A partition as the plan has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Its number in the plan.
    pub identifier: i32,
    /// When its periods begin.
    pub grid: PeriodGrid,
    /// Time that it has in each period, ns.
    pub duration: SystemTime,
    /// Cores that it may use; its processes take turns on one of them.
    pub cores: i32,
    /// When it may bind its processes to one of them.
    pub affinity: AffinityPermission,
    /// Its memory blocks, with where the driver has mapped them.
    pub memory_blocks: Vec<(Name, MemoryBlockStatus)>,
    /// Its logbooks.
    pub logbooks: Vec<PlannedLogbook>,
    /// The module's name services: what each knows, by name.
    pub name_services: Vec<(Name, Vec<(String, SapAddress)>)>,
    /// COLD_START or WARM_START.
    pub mode: OperatingMode,
    /// Why it is started.
    pub condition: StartCondition,
    /// Who decides about errors.
    pub health: HealthTable,
    /// How much there is of everything.
    pub limits: Limits,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::standard::{Deadline, INFINITE_TIME_VALUE, Name, ProcessAttributes};
    use crate::{Notice, Partition, ReturnCode};

    #[test]
    fn limit_of_the_plan_is_told_once_with_what_it_allows() {
        let mut settings = Settings::every(100);
        settings.limits.processes = 1;
        settings.limits.stack_memory = 10_000;
        let mut partition = Partition::new(settings);
        let mut attributes = ProcessAttributes {
            name: Name::new("one").unwrap(),
            entry_point: 0,
            stack_size: 8 << 10,
            base_priority: 1,
            period: 150,
            time_capacity: INFINITE_TIME_VALUE,
            deadline: Deadline::Soft,
        };
        let mut told = Vec::new();
        for (period, stack, refused) in
            [(150, 8192, true), (150, 8192, true), (200, 16_384, true), (200, 8192, false), (200, 8192, true)]
        {
            (attributes.period, attributes.stack_size) = (period, stack);
            let created = partition.create_process(&attributes);
            assert_eq!(created == Err(ReturnCode::InvalidConfig), refused, "{period} {stack}");
            told.extend(partition.take_notice());
        }
        let limits = [Limit::Period(100), Limit::Stacks(10_000), Limit::Processes(1)];
        assert_eq!(told, limits.map(|limit| Notice::Refused { limit }));
    }

    #[test]
    fn period_start_is_the_next_one_after_an_instant() {
        let grid = PeriodGrid { origin: 30, period: 100 };
        for (now, next) in [(-71, -70), (0, 30), (29, 30), (30, 130), (129, 130), (130, 230)] {
            assert_eq!(grid.next_after(now), Some(next), "after {now}");
        }
        assert_eq!(grid.next_after(SystemTime::MAX), None);
    }
}
