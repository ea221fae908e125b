//! What is planned to happen to partitions at instants of module time: the same again at every run of the same plan.

use crate::event::Event;
use crate::inject::{Aim, Fault};
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
    /// A fault is provoked.
    Inject(Fault),
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
            Self::Inject(_) => "inject",
        }
    }
}

/// One of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedAct {
    /// What is done.
    pub act: Act,
    /// The partition's name; for a fault, what it is aimed at.
    pub partition: String,
    /// Module time, ns.
    pub at_ns: u64,
}

impl PlannedAct {
    /// Whom it hits.
    ///
    /// # Errors
    /// The plan has no such target, or it can not have this fault.
    pub fn aim(&self, plan: &Plan) -> Result<Aim, String> {
        match self.act {
            Act::Inject(fault) => fault.aim(plan, &self.partition),
            _ => match plan.partition(&self.partition) {
                Some(found) => Ok(Aim { partition: Some(found.index()), port: 0 }),
                None => Err(format!("there is no partition \"{}\"", self.partition)),
            },
        }
    }
}

/// What is still to come, the next one last.
#[derive(Debug, Default)]
pub struct PlannedActs(Vec<(u64, Aim, Act)>);

impl PlannedActs {
    /// Names that are not in the plan were refused before.
    #[must_use]
    pub fn of(plan: &Plan, acts: &[PlannedAct]) -> Self {
        let aimed = |one: &PlannedAct| Some((one.at_ns, one.aim(plan).ok()?, one.act));
        let mut list: Vec<_> = acts.iter().filter_map(aimed).collect();
        list.sort_by_key(|(at_ns, ..)| *at_ns);
        list.reverse();
        Self(list)
    }

    /// Does what is due.
    pub fn perform(&mut self, module_ns: u64, monitor: &mut Monitor) {
        while let Some((_, aim, act)) = self.0.pop_if(|(at_ns, ..)| *at_ns <= module_ns) {
            if let Act::Inject(fault) = act {
                if let Err(why) = monitor.provoke(fault, &aim, module_ns) {
                    let time_s = module_ns as f64 / 1e9;
                    let text = format!("fault {fault} could not be provoked: {why}");
                    let partition = crate::inject::DISPATCHER.to_owned();
                    monitor.events().tell(&Event::Message { time_s, partition, text });
                }
                continue;
            }
            let Some(partition) = aim.partition else { continue };
            match act {
                Act::Inject(_) => continue,
                Act::Kill => monitor.kill(partition, module_ns),
                Act::Stop => monitor.stop(partition, module_ns),
                Act::Start => monitor.start(partition, module_ns),
                Act::Freeze => monitor.freeze(partition, module_ns),
                Act::Thaw => monitor.thaw(partition, module_ns),
            };
        }
    }
}
