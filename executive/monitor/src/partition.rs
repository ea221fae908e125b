//! A partition as the monitor sees it: its sandboxes, the processes in them, where it is in its life, and what is remembered of its windows.
//!
//! Here is what concerns one partition alone. It must never decide what follows from what it finds.

use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd};
use std::process::ExitStatus;
use std::sync::Arc;
use std::sync::atomic::Ordering::Acquire;

use bateleur_contract::page::{self, WindowGrant};
use bateleur_contract::process_table::{HANDLER_NAME, HANDLER_PLACE};
use bateleur_contract::{Clock, ControlPage, Mode, ReportKind, StartCondition, Takeover, exit};

use crate::figures::Figures;
use crate::health::decision::{Decision, error_of};
use crate::health::log::Fault;
use crate::health::record::Level;
use crate::lifecycle::{Cause, Lifecycle, PairMember, Phase, StandbyEvent, StandbyState, noun};
use crate::process_log::Spans;
use crate::provoke::{InPlaceOf, Ordered};
use crate::repeats::{Allowance, Repeats};
use crate::unclosed::Unclosed;
use bateleur_host::partition::Sandbox;
use bateleur_plan::{PartitionError, Plan, Standby};
use bateleur_system::cpu_starvation;
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};
use bateleur_time::partition_control::Readiness;
use bateleur_time::redundant_pair::RedundantPair;

/// Messages of one partition that are passed on in a second of module time.
const MESSAGES_A_SECOND: u32 = 20;

/// What most starts take, ns.
const READY_SOON_NS: u64 = 50_000_000;

/// A sandbox and the process in it.
#[derive(Debug)]
pub(crate) struct Sandboxed {
    pub(crate) sandbox: Sandbox,
    pub(crate) process: Option<Spawned>,
    /// When it was launched, CLOCK_MONOTONIC, ns.
    pub(crate) since_ns: u64,
    /// A dead process whose places in shared memory are not free yet.
    pub(crate) remains: Option<i32>,
    /// The process that it has or had last is a spare that has not begun.
    pub(crate) waits: bool,
    pub(crate) reports_seen: u32,
    /// Errors told to a handler among its processes that were looked at.
    handled_seen: u32,
    /// Who has run in its windows, where it may have several processes.
    pub(crate) spans: Spans,
}

impl Sandboxed {
    fn new(sandbox: Sandbox) -> Self {
        Self {
            sandbox,
            process: None,
            since_ns: 0,
            remains: None,
            waits: false,
            reports_seen: 0,
            handled_seen: 0,
            spans: Spans::default(),
        }
    }

    pub(crate) fn launch(&mut self, generation: u32, condition: StartCondition) -> std::io::Result<()> {
        self.skip_reports();
        let process = self.sandbox.launch(generation, condition)?;
        self.has_launched(process, false);
        Ok(())
    }

    pub(crate) fn launch_standby(&mut self, generation: u32, kind: Standby) -> std::io::Result<()> {
        self.skip_reports();
        let process = self.sandbox.launch_standby(generation, kind)?;
        self.has_launched(process, kind == Standby::Spare);
        Ok(())
    }

    fn has_launched(&mut self, process: Spawned, waits: bool) {
        self.since_ns = now_ns();
        self.waits = waits;
        self.process = Some(process);
    }

    /// What was reported so far is not looked at. Before a launch, not after it: the new process may report at once.
    pub(crate) fn skip_reports(&mut self) {
        self.reports_seen = self.sandbox.control.page.reports_so_far();
        if let Some(table) = &self.sandbox.table {
            self.spans.begin(table);
            self.handled_seen = table.errors_told();
        }
    }

    /// The next error that an error handler among its processes was told of, and whose it is.
    pub(crate) fn next_handled(&mut self) -> Option<(ReportKind, String)> {
        let table = self.sandbox.table.as_ref()?;
        // What was lost is in the processes' counts of errors.
        let told = table.error_since(&mut self.handled_seen, &mut 0)?;
        let whose = match told.place {
            0 => "the main process".to_owned(),
            HANDLER_PLACE => format!("the {HANDLER_NAME}"),
            place => format!("process {}", table.name_at(place).unwrap_or_else(|| place.to_string())),
        };
        Some((told.kind, whose))
    }

    /// Tells the end of its process; `None` if it has none.
    pub(crate) fn end(&self) -> Option<BorrowedFd<'_>> {
        self.process.as_ref().map(|process| process.pidfd.as_fd())
    }

    /// Whether its process has ended, as far as the kernel knows.
    pub(crate) fn has_ended(&self) -> bool {
        self.end().is_some_and(is_readable)
    }

    /// Whether its process has come as far as it may before its first window; a spare: before it begins.
    pub(crate) fn has_initialised(&self) -> bool {
        if self.waits {
            return self.sandbox.control.waits();
        }
        Mode::from_number(self.sandbox.control.page.mode.load(Acquire)) == Some(Mode::Normal)
    }

    /// Whether its process, which initialises, is not ready in `limit_ns`, its waits for a processor apart.
    pub(crate) fn is_overdue(&self, limit_ns: u64) -> bool {
        let most_ns = limit_ns.saturating_add(cpu_starvation::STARVED_PATIENCE_NS);
        let elapsed_ns = now_ns().saturating_sub(self.since_ns);
        self.process
            .as_ref()
            .is_some_and(|process| cpu_starvation::has_had(process.pid, elapsed_ns, limit_ns, most_ns))
    }

    /// Reaps the process, which has ended; its number and how it ended.
    pub(crate) fn reap(&mut self) -> Option<(i32, Option<ExitStatus>)> {
        let process = self.process.take()?;
        self.sandbox.control.lose_process(); // before its number may be given to another process
        self.remains = Some(process.pid);
        Some((process.pid, ended(&process)))
    }

    /// Ends and reaps the process, and ends what it has started.
    pub(crate) fn kill(&mut self) {
        let Some(process) = &self.process else { return };
        self.sandbox.kill(Some(process));
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        let _ = self.reap();
    }
}

/// What was found of a process that initialises.
pub(crate) enum Start {
    /// Nothing yet.
    UnderWay,
    Ready,
    /// It has ended and was reaped, and why.
    Ended(String),
    /// It takes too long, and why.
    Overdue(String),
}

/// See the module's head.
#[derive(Debug)]
pub(crate) struct Partition {
    /// That of the process which has the windows.
    pub(crate) active: Sandboxed,
    /// That of the process which stands by.
    pub(crate) standby: Option<Sandboxed>,
    /// Shared with the dispatchers: the partition control of `active` is the active one.
    pub(crate) pair: Arc<RedundantPair>,
    pub(crate) life: Lifecycle,
    /// The last fault that had a restart, until the successor has its first window.
    pub(crate) fault: Option<Fault>,
    /// Channels that could not be cleared of its last dead process.
    pub(crate) damaged: Vec<String>,
    /// Since when its process may have windows, module time, ns.
    pub(crate) admitted_ns: u64,
    /// Granted windows in a row that were not closed.
    pub(crate) unclosed: Unclosed,
    /// Processes that the kernel had ended for want of memory, at the last look.
    pub(crate) memory_kills: u64,
    /// Errors that leave it running, and come again and again.
    pub(crate) repeats: Repeats,
    /// Messages that may be recorded.
    pub(crate) messages: Allowance,
    /// Second of module time, and messages passed on in it.
    spoken: (u64, u32),
    pub(crate) figures: Figures,
    /// The executive ends its process in the place of a signal.
    pub(crate) in_place_of: Option<InPlaceOf>,
    /// What its last process ended with by itself.
    pub(crate) exit_code: Option<i32>,
    /// A fault that is to end or stop its process.
    pub(crate) ordered: Option<Ordered>,
}

impl Partition {
    /// Launches its first process.
    ///
    /// # Errors
    /// Its program can not be started.
    pub(crate) fn launch(
        mut sandbox: Sandbox,
        plan: &Plan,
        clock: Clock,
        condition: StartCondition,
    ) -> std::io::Result<Self> {
        let standby = sandbox.standby.take().map(|sandbox| Sandboxed::new(*sandbox));
        let behind = standby.as_ref().map(|standby| standby.sandbox.control.clone());
        let kind = plan[sandbox.id].standby.filter(|_| standby.is_some());
        let life = Lifecycle::new(plan[sandbox.id].restart.clone(), clock, kind);
        let mut active = Sandboxed::new(sandbox);
        active.launch(0, condition).or_else(|error| match error.kind() {
            // What kept it from its program may pass, such as a lock of the kernel that somebody else on the machine holds.
            ErrorKind::TimedOut => active.launch(0, condition),
            _ => Err(error),
        })?;
        Ok(Self {
            pair: Arc::new(RedundantPair::new(active.sandbox.control.clone(), behind)),
            active,
            standby,
            life,
            fault: None,
            damaged: Vec::new(),
            admitted_ns: 0,
            unclosed: Unclosed::default(),
            memory_kills: 0,
            repeats: Repeats::default(),
            messages: Allowance::default(),
            spoken: (0, 0),
            figures: Figures::new(),
            in_place_of: None,
            exit_code: None,
            ordered: None,
        })
    }

    pub(crate) fn name(&self) -> &str {
        &self.active.sandbox.name
    }

    /// What stands by for it, in words.
    pub(crate) fn noun(&self) -> &'static str {
        noun(if self.life.has_spare() { Standby::Spare } else { Standby::Hot })
    }

    /// The sandbox of `member` and its process.
    pub(crate) fn member(&mut self, member: PairMember) -> Option<&mut Sandboxed> {
        match member {
            PairMember::Active => Some(&mut self.active),
            PairMember::Standby => self.standby.as_mut(),
        }
    }

    /// The control pages of its processes.
    pub(crate) fn pages(&self) -> impl Iterator<Item = &ControlPage> {
        std::iter::once(&self.active).chain(&self.standby).map(|member| &*member.sandbox.control.page)
    }

    /// Descriptors that tell the end of its processes.
    pub(crate) fn ends(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        std::iter::once(&self.active).chain(&self.standby).filter_map(Sandboxed::end)
    }

    /// Whether a message is passed on: a babbling partition must not drown the others.
    pub(crate) fn may_speak(&mut self, module_ns: u64) -> bool {
        let second = module_ns / 1_000_000_000;
        if self.spoken.0 != second {
            self.spoken = (second, 0);
        }
        self.spoken.1 += 1;
        self.spoken.1 <= MESSAGES_A_SECOND
    }

    /// Looks at its process, which initialises and has `limit_ns` for it.
    pub(crate) fn look_at_start(&mut self, limit_ns: u64) -> Start {
        if self.life.phase() != Phase::Starting {
            return Start::UnderWay;
        }
        if self.active.has_initialised() {
            return Start::Ready;
        }
        let name = self.active.sandbox.name.clone();
        if self.active.has_ended() {
            let status = self.active.reap().and_then(|(_, status)| status);
            let words = self.active.sandbox.last_words();
            let found = status
                .and_then(|status| error_of(status, words.as_deref()))
                .map_or_else(|| "ended by itself".into(), |(_, detail)| detail);
            let words = words.unwrap_or_else(|| "it said nothing".into());
            let words = self.active.sandbox.lack_of_memory(self.memory_kills).unwrap_or(words);
            return Start::Ended(format!("partition {name} {found}: {words}"));
        }
        if self.active.is_overdue(limit_ns) {
            let lack = self.active.sandbox.lack_of_memory(self.memory_kills);
            let why = lack.map(|why| format!(": {why}")).unwrap_or_default();
            let limit_ms = limit_ns / 1_000_000;
            return Start::Overdue(format!(
                "partition {name} was not ready after {limit_ms} ms (startup_timeout){why}"
            ));
        }
        Start::UnderWay
    }

    /// Its process may have windows from `module_ns` on, or is held.
    pub(crate) fn admit(&mut self, held: bool, module_ns: u64) {
        self.admitted_ns = module_ns;
        self.unclosed.end(self.active.process.as_ref().map(|process| process.pid), module_ns);
        if let Some(process) = &self.active.process {
            self.active.sandbox.admit(process);
        }
        self.let_run(held);
    }

    /// Has its process take windows, unless it is `held`.
    pub(crate) fn let_run(&self, held: bool) {
        match held {
            true => self.active.sandbox.control.hold(),
            false => self.active.sandbox.control.set_readiness(Readiness::Ready),
        }
    }

    /// Its windows pass, and what its dead process has started ends.
    pub(crate) fn end_remains(&mut self) {
        self.active.sandbox.control.set_readiness(Readiness::Absent);
        self.active.sandbox.kill(None);
        self.ordered = None;
    }

    /// Its windows pass, and its process ends with what it has started.
    pub(crate) fn end_process(&mut self) {
        self.active.sandbox.control.set_readiness(Readiness::Absent);
        self.active.kill();
        self.ordered = None;
    }

    /// Its process, where it runs, has ended: how, as if no signal had been sent in the place of another.
    pub(crate) fn reap(&mut self) -> (i32, Option<ExitStatus>) {
        let (pid, status) = self.active.reap().unwrap_or_default();
        let in_place_of = self.in_place_of.take();
        self.exit_code = status.and_then(|status| status.code());
        (pid, status.map(|status| in_place_of.map_or(status, |end| end.status(pid, status))))
    }

    /// The process that stood by is in the dead one's place from now on.
    pub(crate) fn exchange(&mut self, held: bool, module_ns: u64) {
        let Some(standby) = &mut self.standby else { return };
        self.active.sandbox.control.lose_process();
        std::mem::swap(&mut self.active, standby);
        self.memory_kills = self.active.sandbox.out_of_memory_kills();
        if let Some(process) = &self.active.process {
            self.active.sandbox.admit(process);
        }
        self.unclosed.end(self.active.process.as_ref().map(|process| process.pid), module_ns);
        self.admitted_ns = module_ns;
        self.active.sandbox.control.set_not_before_ns(0);
        // Only now: until here a dispatcher finds that nobody is there.
        self.pair.hand_over();
        self.let_run(held);
    }

    /// The spare is in the place of the one before, of whom something may be left, and begins; false: it can not.
    pub(crate) fn begin_spare(&mut self, condition: StartCondition, told: &WindowGrant) -> bool {
        let Some(spare) = self.standby.as_mut().filter(|spare| spare.waits && !spare.has_ended()) else {
            return false;
        };
        if !condition.is_warm() && spare.sandbox.forget().is_err() {
            return false;
        }
        self.active.sandbox.control.lose_process();
        std::mem::swap(&mut self.active, spare);
        (self.active.waits, self.active.since_ns) = (false, now_ns());
        self.memory_kills = self.active.sandbox.out_of_memory_kills();
        self.active.sandbox.control.begin(condition, &spare.sandbox.control, told);
        self.pair.hand_over();
        true
    }

    /// It has threads or children that nobody knew of.
    pub(crate) fn finds_company(&self) -> bool {
        self.runs()
            && self.active.process.as_ref().is_some_and(|process| self.active.sandbox.finds_company(process))
    }

    /// Whether the kernel has ended a process of the partition for want of memory since the last look.
    pub(crate) fn has_lacked_memory(&mut self) -> bool {
        let so_far = self.active.sandbox.out_of_memory_kills();
        std::mem::replace(&mut self.memory_kills, so_far) < so_far
    }

    /// Its process initialises since a moment ago.
    pub(crate) fn is_ready_soon(&self) -> bool {
        self.life.phase() == Phase::Starting && now_ns().saturating_sub(self.active.since_ns) < READY_SOON_NS
    }

    /// It takes windows and has not ended, as far as the kernel knows.
    pub(crate) fn runs(&self) -> bool {
        self.life.phase() == Phase::Running && !self.active.has_ended()
    }

    /// The process that stands by could take over now, as far as the kernel knows.
    pub(crate) fn can_take_over(&self, module_ns: u64) -> bool {
        self.life.can_take_over(module_ns)
            && self.standby.as_ref().is_some_and(|standby| !standby.has_ended())
    }

    /// What has become of the process that stands by and has `limit_ns` to initialise, and the error that it is.
    pub(crate) fn look_at_standby(
        &mut self,
        limit_ns: u64,
    ) -> Option<(StandbyEvent, Option<(PartitionError, String)>)> {
        let state = self.life.standby()?;
        let standby = self.standby.as_mut()?;
        if standby.has_ended() {
            let status = standby.reap().and_then(|(_, status)| status);
            let words = standby.sandbox.last_words();
            let found = status.and_then(|status| error_of(status, words.as_deref()));
            let found = found.unwrap_or_else(|| (PartitionError::Exit, "ended by itself".into()));
            return Some((StandbyEvent::Died, Some(found)));
        }
        if state != StandbyState::Starting {
            return None;
        }
        if standby.has_initialised() {
            return Some((StandbyEvent::Ready, None));
        }
        standby.is_overdue(limit_ns).then(|| {
            let detail = format!("was not ready after {} ms (startup_timeout)", limit_ns / 1_000_000);
            (StandbyEvent::Overdue, Some((PartitionError::StartupTimeout, detail)))
        })
    }

    /// Calls the standby, with retained memory if `warm`; true: it has taken over what the dead one had.
    pub(crate) fn call_standby(&self, warm: bool, grant: &WindowGrant, patience_ns: u64) -> bool {
        let Some(standby) = &self.standby else { return false };
        if !warm && standby.sandbox.forget().is_err() {
            return false;
        }
        let control = &standby.sandbox.control;
        let begun_ns = now_ns();
        let order = if warm { Takeover::Warm } else { Takeover::Cold };
        control.call(order, &self.active.sandbox.control, grant, begun_ns);
        while !control.is_done() && !standby.has_ended() && now_ns() - begun_ns < patience_ns {
            control.await_change(1_000_000);
        }
        control.is_done() && !standby.has_ended()
    }

    /// Whether its control page says that its error handler is at work.
    pub(crate) fn is_in_handler(&self) -> bool {
        self.active.sandbox.control.page.handling.load(Acquire) != 0
    }

    /// What it asked for by the code that its process ended with, and who of it; `None` if the code is none of those. A code is a request
    /// only where the control page says so: of an error handler that is at work and that the plan counts on, or of the partition itself.
    pub(crate) fn asked_for(&self, plan: &Plan, code: Option<i32>) -> Option<(Mode, Cause)> {
        let cause = match self.active.sandbox.control.page.handling.load(Acquire) {
            0 => return None,
            page::OWN_REQUEST => Cause::Partition,
            _ => Some(Cause::Handler).filter(|_| plan[self.active.sandbox.id].error_handler)?,
        };
        let mode = match code? {
            exit::IDLE => Mode::Idle,
            exit::WARM_START => Mode::WarmStart,
            exit::COLD_START => Mode::ColdStart,
            _ => return None,
        };
        Some((mode, cause))
    }

    /// What the log says of an error of it.
    pub(crate) fn entry(&self, error: &str, decision: Decision, detail: String, module_ns: u64) -> Fault {
        Fault {
            time_ns: module_ns,
            level: match decision {
                Decision::Handler => Level::Process,
                Decision::Module => Level::Module,
                _ => Level::Partition,
            },
            partition: Some(self.name().to_owned()),
            generation: self.life.generation(),
            error: error.into(),
            action: decision.name().into(),
            detail,
            recovered_ns: None,
        }
    }
}

/// Whether a window that was granted at `granted_ns` is one of the process that was found ready at `admitted_ns`: one
/// that its predecessor left open closes after the predecessor's death, and says nothing about the successor.
pub(crate) fn is_own(granted_ns: Option<u64>, admitted_ns: u64) -> bool {
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
