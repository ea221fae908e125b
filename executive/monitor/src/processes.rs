//! What becomes of processes: those that start, those that take windows, and those that stand by.

use std::os::unix::process::ExitStatusExt;

use bateleur_contract::{Clock, Mode};

use crate::faults::OWN_REQUEST;
use crate::health::decision::{Decision, decide_restart, error_of};
use crate::health::log::Fault;
use crate::lifecycle::{Cause, Event, PairMember, Phase, StandbyState};
use crate::monitor::Monitor;
use crate::partition::Start;
use bateleur_plan::{Closed, PartitionError};

/// A filter has ended the process.
const SIGSYS: i32 = 31;
/// What the log says about a process that stood by and is gone.
const NEW_STANDBY: &str = "new_standby";

impl Monitor {
    pub(crate) fn look_at_process(&mut self, place: usize, module_ns: u64) {
        if matches!(self.partitions[place].life.phase(), Phase::Retrying(_)) {
            self.feed(place, Event::Look, module_ns);
        }
        let limit_ns = self.plan[self.partitions[place].active.sandbox.id].startup_timeout_ns;
        let (event, detail) = match self.partitions[place].look_at_start(limit_ns) {
            Start::UnderWay => return self.look_for_death(place, module_ns),
            Start::Ready => {
                self.feed(place, Event::Ready, module_ns);
                return self.look_for_death(place, module_ns);
            }
            Start::Ended(detail) => (Event::Died, detail),
            Start::Overdue(detail) => (Event::Overdue, detail),
        };
        self.feed(place, event, module_ns);
        self.fault(place, PartitionError::StartupTimeout, detail, module_ns);
    }

    fn look_for_death(&mut self, place: usize, module_ns: u64) {
        let partition = &mut self.partitions[place];
        if partition.life.phase() != Phase::Running || !partition.active.has_ended() {
            return;
        }
        let (pid, status) = partition.reap();
        self.feed(place, Event::Died, module_ns);
        let partition = &mut self.partitions[place];
        let words = partition.active.sandbox.last_words();
        let code = status.and_then(|status| status.code());
        if let Some((mode, cause)) = partition.asked_for(&self.plan, code) {
            return self.do_as_asked(place, mode, cause, module_ns);
        }
        let found = status.and_then(|status| error_of(status, words.as_deref()));
        let (error, mut detail) = found.unwrap_or((PartitionError::Exit, "ended by itself".into()));
        if error == PartitionError::Killed && self.partitions[place].has_lacked_memory() {
            detail = "ended by the kernel: the partition had no memory left".into();
            return self.fault(place, PartitionError::MemoryLimit, detail, module_ns);
        }
        if status.and_then(|status| status.signal()) == Some(SIGSYS)
            && let Some(call) = self.kernel_log.call_that_ended(pid)
        {
            detail = format!("{detail}: {call}");
        } else if error != PartitionError::Killed
            && let Some(words) = words
        {
            detail = format!("{detail}: {words}");
        }
        self.fault(place, error, detail, module_ns);
    }

    /// A partition has ended itself to be started again or to be idle. Its budget counts what its error handler answers to errors, and its
    /// own wish where that comes too often.
    fn do_as_asked(&mut self, place: usize, mode: Mode, cause: Cause, module_ns: u64) {
        let partition = &self.partitions[place];
        let restart = &self.plan[partition.active.sandbox.id].restart;
        let warm = mode == Mode::WarmStart;
        let too_often = cause == Cause::Partition && partition.life.restarts_itself_too_often(module_ns);
        let cause = if too_often { Cause::Handler } else { cause };
        let decision = match (mode, cause) {
            (Mode::Idle, _) => Decision::Idle,
            (_, Cause::Partition) => Decision::Restart { warm },
            _ => decide_restart(restart, warm, partition.life.recent_restarts(module_ns)),
        };
        let detail = match cause {
            _ if too_often => "it has set its mode (SET_PARTITION_MODE) more than 20 times in 10 s",
            Cause::Partition => "it has set its mode (SET_PARTITION_MODE)",
            _ => "its error handler asked for it",
        };
        self.decided(place, OWN_REQUEST, (decision, cause), detail.into(), false, module_ns);
    }

    /// Looks at the process that stands by, and has one started where it is time to.
    pub(crate) fn tend_standby(&mut self, place: usize, module_ns: u64) {
        if self.partitions[place].standby.is_none() {
            return;
        }
        self.look_at_standby(place, module_ns);
        if self.partitions[place].life.phase() == Phase::Running {
            self.feed(place, Event::Look, module_ns);
        }
        // On the virtual clock everything that peers can notice happens at an instant of module time.
        while self.clock == Clock::Virtual
            && self.partitions[place].life.standby() == Some(StandbyState::Starting)
        {
            self.look_at_standby(place, module_ns);
            self.pause(200_000);
        }
    }

    pub(crate) fn look_at_standby(&mut self, place: usize, module_ns: u64) {
        let partition = &mut self.partitions[place];
        let limit_ns = self.plan[partition.active.sandbox.id].startup_timeout_ns;
        let Some((event, found)) = partition.look_at_standby(limit_ns) else { return };
        if let Some((error, detail)) = found {
            self.record_standby_loss(place, error, &detail, module_ns);
            self.collect_crash(place, PairMember::Standby, (error, &detail), module_ns);
        }
        self.feed(place, Event::Standby(event), module_ns);
    }

    /// The process that stood by is lost, which is no health error of the partition.
    fn record_standby_loss(&mut self, place: usize, error: PartitionError, detail: &str, module_ns: u64) {
        let partition = &self.partitions[place];
        let standby = partition.standby.as_ref().filter(|_| error != PartitionError::Killed);
        let words = standby.and_then(|standby| standby.sandbox.last_words());
        let detail = words.map_or_else(|| detail.to_owned(), |words| format!("{detail}: {words}"));
        let (action, next) = match partition.life.gives_standby_up(module_ns) {
            true => ("ignore", "and is given up"),
            false => (NEW_STANDBY, "and is replaced"),
        };
        let noun = partition.noun();
        let entry = Fault {
            generation: partition.life.generation() + 1,
            action: action.into(),
            ..partition.entry(error.name(), Decision::Ignore, format!("the {noun} {detail}"), module_ns)
        };
        self.kept.enter(&entry);
        self.say(place, format!("its {noun} {detail}, {next}"), module_ns);
    }
}
