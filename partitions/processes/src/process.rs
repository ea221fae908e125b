//! One process.

use crate::return_code::ReturnCode;
use crate::services::port_lists::Wanted;
use crate::standard::{INFINITE_TIME_VALUE, ProcessAttributes, QueuingPortId, SystemTime};

/// What a process has come to, leaving aside what it waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Dormant,
    Started,
    Faulted,
}

/// What a started process waits for, leaving aside a suspension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wait {
    Nothing,
    /// For mode NORMAL, and then for this span, ns.
    Normal(SystemTime),
    /// For an instant.
    Time,
    /// For the object whose list it is in, perhaps with a time-out.
    Object,
}

#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) attributes: ProcessAttributes,
    pub(crate) phase: Phase,
    pub(crate) wait: Wait,
    /// By SUSPEND, or by SUSPEND_SELF: then with nothing else to wait for, and perhaps a time-out.
    pub(crate) suspended: bool,
    /// It sleeps outside of services, and is passed over for the time being.
    pub(crate) lent: bool,
    pub(crate) priority: i32,
    /// What the priority becomes when the process gives up its mutex or the preemption lock. The same as the priority of one that
    /// owns neither.
    pub(crate) retained: i32,
    /// The mutex that it owns, by its place. Stays when it is stopped.
    pub(crate) mutex: Option<usize>,
    /// Module time, ns; infinite: none.
    pub(crate) deadline: SystemTime,
    /// The last release point, module time, ns.
    pub(crate) release: SystemTime,
    /// Of the call in which it waited last.
    pub(crate) result: Result<(), ReturnCode>,
    /// What it waits to send, or what it was given while it waited.
    pub(crate) message: Vec<u8>,
    /// What it waits for at a list of ports.
    pub(crate) wanted: Wanted,
    /// The port of which it was told there.
    pub(crate) served_port: Option<QueuingPortId>,
    /// Starts so far: a driver that sees another number begins at the entry point.
    pub(crate) life: u32,
    pub(crate) affinity: i32,
}

impl Process {
    pub(crate) fn new(attributes: ProcessAttributes) -> Self {
        Self {
            attributes,
            phase: Phase::Dormant,
            wait: Wait::Nothing,
            suspended: false,
            lent: false,
            priority: attributes.base_priority,
            retained: attributes.base_priority,
            mutex: None,
            deadline: INFINITE_TIME_VALUE,
            release: 0,
            result: Ok(()),
            message: Vec::new(),
            wanted: Wanted::default(),
            served_port: None,
            life: 0,
            affinity: crate::standard::CORE_AFFINITY_NO_PREFERENCE,
        }
    }

    pub(crate) fn is_periodic(&self) -> bool {
        self.attributes.period != INFINITE_TIME_VALUE
    }

    /// It waits for something, or for RESUME.
    pub(crate) fn waits(&self) -> bool {
        self.wait != Wait::Nothing || self.suspended
    }

    /// Nothing keeps it from running.
    pub(crate) fn is_able(&self) -> bool {
        self.phase == Phase::Started && !self.waits() && !self.lent
    }

    /// The deadline of a release at `at`; `None` if a time can not say it.
    pub(crate) fn deadline_of(&self, at: SystemTime) -> Option<SystemTime> {
        match self.attributes.time_capacity {
            INFINITE_TIME_VALUE => Some(INFINITE_TIME_VALUE),
            capacity => at.checked_add(capacity),
        }
    }
}
