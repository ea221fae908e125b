//! What is planned to happen to partitions at instants of module time: the same again at every run of the same plan.

use crate::monitor::Monitor;
use crate::plan::Plan;

/// What can be done to a partition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// Its process dies.
    Kill,
    /// It is ended until it is started.
    Stop,
    /// It is started from nothing.
    Start,
    /// It is held.
    Freeze,
    /// It goes on.
    Thaw,
}

impl Act {
    /// Its word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Stop => "stop",
            Self::Start => "start",
            Self::Freeze => "freeze",
            Self::Thaw => "thaw",
        }
    }
}

/// One of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedAct {
    /// What is done.
    pub act: Act,
    /// The partition's name.
    pub partition: String,
    /// Module time, ns.
    pub at_ns: u64,
}

/// What is still to come, the next one last.
#[derive(Debug, Default)]
pub struct PlannedActs(Vec<(u64, usize, Act)>);

impl PlannedActs {
    /// Names that are not in the plan were refused before.
    #[must_use]
    pub fn of(plan: &Plan, acts: &[PlannedAct]) -> Self {
        let place = |one: &PlannedAct| Some((one.at_ns, plan.partition(&one.partition)?.index(), one.act));
        let mut list: Vec<_> = acts.iter().filter_map(place).collect();
        list.sort_by_key(|(at_ns, ..)| *at_ns);
        list.reverse();
        Self(list)
    }

    /// Does what is due.
    pub fn perform(&mut self, module_ns: u64, monitor: &mut Monitor) {
        while let Some((_, partition, act)) = self.0.pop_if(|(at_ns, ..)| *at_ns <= module_ns) {
            match act {
                Act::Kill => monitor.kill(partition, module_ns),
                Act::Stop => monitor.stop(partition, module_ns),
                Act::Start => monitor.start(partition, module_ns),
                Act::Freeze => monitor.freeze(partition, module_ns),
                Act::Thaw => monitor.thaw(partition, module_ns),
            };
        }
    }
}
