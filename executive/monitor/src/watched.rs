//! One partition as the monitor sees it: its sandbox, the life in it, and what is remembered of lives before.

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::sync::atomic::Ordering::Acquire;

use bateleur_contract::{ControlPage, Mode, StartCondition};

use super::figures::Figures;
use super::provoke::{InPlaceOf, Ordered};
use super::repeats::{Allowance, Repeats};
use super::standby::Standby;
use crate::health::decision::error_of;
use crate::health::log::Fault;
use bateleur_host::partition::Sandbox;
use bateleur_plan::{PartitionState, Plan};
use bateleur_system::cpu_starvation::{self, Spell};
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};
use bateleur_time::partition_control::Readiness;
use bateleur_time::redundant_pair::RedundantPair;

/// Whether process `pid`, which initialises since `since_ns`, is not ready in `limit_ns`, its waits for a processor apart.
pub(super) fn is_overdue(pid: i32, since_ns: u64, limit_ns: u64) -> bool {
    let most_ns = limit_ns.saturating_add(cpu_starvation::STARVED_PATIENCE_NS);
    cpu_starvation::has_had(pid, now_ns().saturating_sub(since_ns), limit_ns, most_ns)
}

#[derive(Debug)]
pub(super) enum Life {
    /// Initialises, since this instant of CLOCK_MONOTONIC.
    Starting(Spawned, u64),
    /// Takes windows.
    Running(Spawned),
    /// Its remains wait for the channel cleaner, or are with it.
    Dead(i32, Then),
    /// The machine could not start a successor; it is tried again at this instant of CLOCK_MONOTONIC.
    Unstarted(u64),
    /// No process, and none to come by itself.
    Gone,
}

/// Until when a partition without a process rests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Until {
    /// A change of schedule has made it idle, and another one may bring it back.
    Change,
    /// An operator, its tables, its budget or itself have stopped it: only an operator starts it again.
    Started,
}

/// What comes after a cleanup.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Then {
    /// A successor.
    Successor,
    /// Nothing: its windows pass.
    Rest,
}

#[derive(Debug)]
pub(super) struct Watched {
    /// That of the process which has the windows.
    pub(super) sandbox: Sandbox,
    /// Shared with the dispatchers: the sandbox's partition control is active.
    pub(super) pair: Arc<RedundantPair>,
    /// What stands by.
    pub(super) standby: Option<Standby>,
    pub(super) life: Life,
    pub(super) generation: u32,
    /// When this process was found ready, module time, ns: it may have windows from then on.
    pub(super) admitted_ns: u64,
    /// This process has had a window.
    pub(super) had_window: bool,
    /// The last process failed before it was ready.
    pub(super) start_failed: bool,
    pub(super) next_start: StartCondition,
    /// Module time of the restarts so far.
    pub(super) restarts: Vec<u64>,
    pub(super) fault: Option<Fault>,
    pub(super) reports_seen: u32,
    /// Granted windows in a row that were not closed.
    pub(super) unclosed: u32,
    /// Since the last of them, found at this module time, ns.
    pub(super) spell: Option<(u64, Spell)>,
    /// Processes that the kernel had ended for want of memory, at the last look.
    pub(super) starved: u64,
    /// Errors that leave it running, and come again and again.
    pub(super) repeats: Repeats,
    /// Messages that may be recorded.
    pub(super) messages: Allowance,
    /// Second of module time, and messages passed on in it.
    pub(super) spoken: (u64, u32),
    /// Held by an operator: also a successor that becomes ready meanwhile.
    pub(super) held: bool,
    pub(super) figures: Figures,
    /// The executive ends its process in the place of a signal.
    pub(super) in_place_of: Option<InPlaceOf>,
    /// A fault that is to end or stop its process.
    pub(super) ordered: Option<Ordered>,
}

/// Messages of one partition that are passed on in a second of module time.
const MESSAGES_A_SECOND: u32 = 20;

impl Watched {
    /// The pages of its processes: of the one that has the windows, and of the one that stands by.
    pub(super) fn pages(&self) -> impl Iterator<Item = &ControlPage> {
        let standby = self.standby.iter().map(|standby| &standby.sandbox);
        std::iter::once(&self.sandbox).chain(standby).map(|sandbox| &*sandbox.control.page)
    }

    pub(super) fn new(mut sandbox: Sandbox, process: Spawned) -> Self {
        let standby = sandbox.standby.take().map(|sandbox| Standby::new(*sandbox));
        let behind = standby.as_ref().map(|standby| standby.sandbox.control.clone());
        Self {
            pair: Arc::new(RedundantPair::new(sandbox.control.clone(), behind)),
            standby,
            sandbox,
            life: Life::Starting(process, now_ns()),
            generation: 0,
            admitted_ns: 0,
            had_window: false,
            start_failed: false,
            next_start: StartCondition::NormalStart,
            restarts: Vec::new(),
            fault: None,
            reports_seen: 0,
            unclosed: 0,
            spell: None,
            starved: 0,
            repeats: Repeats::default(),
            messages: Allowance::default(),
            spoken: (0, 0),
            held: false,
            figures: Figures::new(),
            in_place_of: None,
            ordered: None,
        }
    }

    /// Whether a message is passed on: a babbling partition must not drown the others.
    pub(super) fn may_speak(&mut self, module_ns: u64) -> bool {
        let second = module_ns / 1_000_000_000;
        if self.spoken.0 != second {
            self.spoken = (second, 0);
        }
        self.spoken.1 += 1;
        self.spoken.1 <= MESSAGES_A_SECOND
    }

    /// Takes notice of a partition that has become ready; an error where it never will.
    pub(super) fn look_at_start(&mut self, plan: &Plan, module_ns: u64) -> Result<(), String> {
        let Life::Starting(process, since_ns) = &self.life else { return Ok(()) };
        if Mode::from_number(self.sandbox.control.page.mode.load(Acquire)) == Some(Mode::Normal) {
            self.sandbox.admit(process);
            self.admitted_ns = module_ns;
            self.unclosed = 0;
            self.start_failed = false;
            if let Life::Starting(process, _) = std::mem::replace(&mut self.life, Life::Gone) {
                self.life = Life::Running(process);
            }
            match self.held {
                true => self.sandbox.control.hold(),
                false => self.sandbox.control.set_readiness(Readiness::Ready),
            }
            return Ok(());
        }
        let name = self.sandbox.name.clone();
        if is_readable(process.pidfd.as_fd()) {
            let (pid, status) = (process.pid, ended(process));
            self.died(pid);
            let words = self.sandbox.last_words();
            let found = status
                .and_then(|status| error_of(status, words.as_deref()))
                .map_or_else(|| "ended by itself".into(), |(_, detail)| detail);
            let words = words.unwrap_or_else(|| "it said nothing".into());
            let words = self.sandbox.lack_of_memory(self.starved).unwrap_or(words);
            return Err(format!("partition {name} {found}: {words}"));
        }
        let limit_ns = plan[self.sandbox.id].startup_timeout_ns;
        if is_overdue(process.pid, *since_ns, limit_ns) {
            let why =
                self.sandbox.lack_of_memory(self.starved).map(|why| format!(": {why}")).unwrap_or_default();
            return Err(format!(
                "partition {name} was not ready after {} ms (startup_timeout){why}",
                limit_ns / 1_000_000
            ));
        }
        Ok(())
    }

    /// What it is at, or was when it died. `has_handler`: the plan says that it has one; only then is it believed that its
    /// handler runs.
    pub(super) fn state(&self, has_handler: bool) -> PartitionState {
        if self.start_failed || matches!(self.life, Life::Starting(..)) {
            PartitionState::Start
        } else if has_handler && self.sandbox.control.page.handling.load(Acquire) != 0 {
            PartitionState::Handler
        } else {
            PartitionState::Normal
        }
    }

    pub(super) fn is_alive(&self) -> bool {
        matches!(self.life, Life::Running(_) | Life::Starting(..))
    }

    /// A successor is on its way, or waits for its predecessor's cleanup, or for the machine.
    pub(super) fn is_coming(&self) -> bool {
        matches!(self.life, Life::Starting(..) | Life::Dead(_, Then::Successor) | Life::Unstarted(_))
    }

    /// It has threads or children that nobody knew of.
    pub(super) fn finds_company(&self) -> bool {
        match &self.life {
            Life::Running(process) if self.runs() => self.sandbox.finds_company(process),
            _ => false,
        }
    }

    /// Whether the kernel has ended a process of the partition for want of memory since the last look.
    pub(super) fn has_starved(&mut self) -> bool {
        let so_far = self.sandbox.out_of_memory_kills();
        std::mem::replace(&mut self.starved, so_far) < so_far
    }

    /// It takes windows and has not ended, as far as the kernel knows.
    pub(super) fn runs(&self) -> bool {
        matches!(&self.life, Life::Running(process) if !is_readable(process.pidfd.as_fd()))
    }

    /// Its process is reaped: children that it left go too, its windows pass.
    pub(super) fn died(&mut self, pid: i32) {
        self.sandbox.control.set_readiness(Readiness::Absent);
        self.sandbox.kill(None);
        self.ordered = None;
        self.life = Life::Dead(pid, Then::Rest);
    }

    /// Makes sure that no process is left.
    pub(super) fn put_an_end(&mut self) {
        self.sandbox.control.set_readiness(Readiness::Absent);
        if let Life::Starting(process, _) | Life::Running(process) = &self.life {
            self.sandbox.kill(Some(process));
            await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
            let pid = process.pid;
            self.sandbox.control.lose_process(); // before its number may be given to another process
            let _ = ended(process); // reaps it
            self.ordered = None;
            self.life = Life::Dead(pid, Then::Rest);
        }
    }

    /// Its windows pass from now on, until an operator starts it, or a change of schedule where `until` says so.
    pub(super) fn rest(&mut self, until: Until) {
        match &mut self.life {
            Life::Dead(_, then) => *then = Then::Rest,
            life => *life = Life::Gone,
        }
        self.sandbox.control.set_readiness(match until {
            Until::Change => Readiness::Idle,
            Until::Started => Readiness::Stopped,
        });
    }

    /// Its process, unless it has ended: then it is reaped.
    pub(super) fn not_gone(&mut self) -> Option<BorrowedFd<'_>> {
        if let Life::Starting(process, _) | Life::Running(process) = &self.life
            && ended(process).is_some()
        {
            self.life = Life::Gone;
        }
        match &self.life {
            Life::Starting(process, _) | Life::Running(process) => Some(process.pidfd.as_fd()),
            Life::Dead(..) | Life::Unstarted(_) | Life::Gone => None,
        }
    }
}

/// Whether a window that was granted at `granted_ns` is one of the process that was found ready at `admitted_ns`: one
/// that its predecessor left open closes after the predecessor's death, and says nothing about the successor.
pub(super) fn is_own(granted_ns: Option<u64>, admitted_ns: u64) -> bool {
    granted_ns.is_some_and(|granted_ns| granted_ns >= admitted_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn window_that_the_dead_one_left_open_is_not_its_successors() {
        assert!(!is_own(Some(99), 100), "granted before the successor was ready, closed after");
        assert!(is_own(Some(100), 100));
        assert!(!is_own(None, 0), "not granted at all");
    }
}
