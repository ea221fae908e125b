//! The life of a partition of several processes: the main thread takes windows and lets processes run in them.

use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::{AcqRel, Acquire, Relaxed, Release};

use bateleur_contract::page::OWN_REQUEST;
use bateleur_contract::{Clock, ControlPage, Mapped, Mode, ProcessPlan, ReportKind, StartCondition, exit};
use bateleur_processes::standard::{
    self, ErrorCode, MAIN_PROCESS_ID, MAX_PROCESSES, OperatingMode, ProcessId, SystemTime,
};
use bateleur_processes::{
    End as Ended, HealthTable, Notice, Partition, PartitionAction, PeriodGrid, Settings, Verdict,
};
use rustix::thread::futex;

use super::initialisation::{Initialisation, complete};
use super::kernel::{Kernel, State};
use super::process::Process;
use super::{alternate_stack, current, thread};
use crate::context::{Context, StartError, Started};
use crate::run::{End, await_grant, lock_memory, name_process, report_end, take_over};
use crate::time::{Time, monotonic_ns};

/// Runs a partition of several processes until the executive asks it to stop: the whole of its `main`. `initialise` is its main process;
/// the partition enters NORMAL with its first window.
///
/// What the partition is told of itself (GET_PARTITION_STATUS), how many processes it may create and how much stack they may have is in
/// the plan: `identifier`, `period`, `duration`, `processes`, `stacks`.
pub fn run_processes(initialise: impl FnOnce(&mut Initialisation<'_>) -> Result<(), StartError>) -> ExitCode {
    report_end(live(initialise))
}

fn live(initialise: impl FnOnce(&mut Initialisation<'_>) -> Result<(), StartError>) -> Result<(), End> {
    let Some(mut main) = begin()? else {
        return Err(End { code: exit::START_REFUSED, reason: "`run_processes` is called twice".into() });
    };
    let initialised = initialise(&mut main.initialisation());
    tell_all(&main.kernel.page, &mut main.kernel.lock());
    initialised.map_err(refuse)?;
    main.run()
}

fn refuse(error: StartError) -> End {
    End { code: exit::START_REFUSED, reason: error.to_string() }
}

/// A partition of several processes before NORMAL, on its main process's thread.
pub(crate) struct Beginning {
    pub(crate) context: Context,
    pub(crate) kernel: Arc<Kernel>,
}

/// The program has taken over what the executive handed it.
static BEGUN: AtomicBool = AtomicBool::new(false);

/// Takes over what the executive handed the program, once. `None`: that was done before.
pub(crate) fn begin() -> Result<Option<Beginning>, End> {
    if BEGUN.swap(true, AcqRel) {
        return Ok(None);
    }
    let (control, page, description) =
        take_over().map_err(|reason| End { code: exit::NO_CONTRACT, reason })?;
    alternate_stack::install();
    crate::signals::install();
    name_process(&description.partition);
    if description.standby {
        return Err(refuse(StartError::Other(
            "a partition of several processes can not stand by: take `standby` out of the plan".into(),
        )));
    }
    let shared = Mapped::<ControlPage>::new(&control)
        .map_err(|error| End { code: exit::NO_CONTRACT, reason: error.to_string() })?;
    let retained = crate::run::retained(&description);
    let (clock, condition) = (description.clock, description.start_condition);
    let starting = if condition.is_warm() { Mode::WarmStart } else { Mode::ColdStart };
    page.mode.store(starting as u32, Release);
    let time = Time::new(Rc::new(page), clock);
    let context = Context::new(description, time, retained).map_err(refuse)?;
    let kernel = kernel(shared, clock, condition, &context.process_plan());
    kernel.begin_at(context.time().now_ns() as SystemTime);
    current::enter(Process::new(kernel.clone()));
    Ok(Some(Beginning { context, kernel }))
}

impl Beginning {
    pub(crate) fn initialisation(&mut self) -> Initialisation<'_> {
        Initialisation { context: &mut self.context, kernel: &self.kernel }
    }

    /// The main process has ended: the partition runs until it is asked to stop.
    pub(crate) fn run(self) -> Result<(), End> {
        complete(&mut self.kernel.lock()).map_err(refuse)?;
        let started = self.context.finish().map_err(refuse)?;
        lock_memory();
        self.kernel.page.mode.store(Mode::Normal as u32, Release);
        windows(&self.kernel, started)
    }
}

/// What the executive is told when the partition ends before its first window.
pub(crate) fn end_of(kernel: &Kernel) -> Result<(), End> {
    after_window(&kernel.page, &mut kernel.lock())
}

/// The partition before its main process.
pub(crate) fn kernel(
    page: Mapped<ControlPage>,
    clock: Clock,
    condition: StartCondition,
    plan: &ProcessPlan,
) -> Arc<Kernel> {
    thread::install();
    Arc::new(Kernel::new(page, clock, Partition::new(settings(condition, plan))))
}

fn settings(condition: StartCondition, plan: &ProcessPlan) -> Settings {
    let time = |ns: u64| SystemTime::try_from(ns).unwrap_or(SystemTime::MAX);
    let period = time(plan.period_ns).max(1);
    let mut settings = Settings::every(period);
    settings.identifier = i32::try_from(plan.identifier).unwrap_or(i32::MAX);
    settings.grid = PeriodGrid { origin: time(plan.release_ns), period };
    settings.duration = time(plan.duration_ns);
    settings.limits.processes = (plan.most as usize).min(MAX_PROCESSES);
    settings.limits.stack_memory = plan.stacks_bytes;
    settings.mode = if condition.is_warm() { OperatingMode::WarmStart } else { OperatingMode::ColdStart };
    settings.condition = match condition {
        StartCondition::NormalStart => standard::StartCondition::NormalStart,
        StartCondition::PartitionRestart | StartCondition::PartitionWarmRestart => {
            standard::StartCondition::PartitionRestart
        }
        StartCondition::HmModuleRestart => standard::StartCondition::HmModuleRestart,
        StartCondition::HmPartitionWarmRestart | StartCondition::HmPartitionColdRestart => {
            standard::StartCondition::HmPartitionRestart
        }
    };
    // Programs ask for as few as 8000 bytes; a thread has more than it is asked for.
    settings.limits.stack = (4 << 10)..=*settings.limits.stack.end();
    settings.health = HealthTable::default();
    // Without an error handler these two are told to the executive, whose table decides. A fault leaves nothing that could go on.
    for code in [ErrorCode::DeadlineMissed, ErrorCode::ApplicationError] {
        settings.health.action[code as usize] = PartitionAction::Ignore;
    }
    settings
}

/// Takes windows until it is asked to stop.
fn windows(kernel: &Arc<Kernel>, mut started: Started) -> Result<(), End> {
    let page = &kernel.page;
    // Numbers of grants go on from the process before.
    let mut last = page.done.load(Acquire);
    loop {
        await_grant(page, last);
        if page.stop.load(Acquire) != 0 {
            // No process may use a port that is being closed.
            std::mem::forget(kernel.lock());
            return Ok(());
        }
        page.opened_ns.store(monotonic_ns(), Relaxed);
        let (number, window) = page.granted_window();
        last = number;
        if window.end_ns == 0 {
            started.connect();
        } else {
            {
                let _lock = kernel.lock();
                started.faults.carry_out(page);
                started.outlets.iter().for_each(|outlet| outlet.catch_up(window.start_ns));
            }
            kernel.window(window.start_ns, window.end_ns);
            after_window(page, &mut kernel.lock())?;
        }
        page.closed_ns.store(monotonic_ns(), Relaxed);
        if page.close(last) {
            let _ = futex::wake(&page.done, futex::Flags::empty(), 1); // woken by the clock meanwhile: fine
        }
        started.faults.after_window();
    }
}

/// Tells the executive what happened in a window; the end of the partition, if it has come.
fn after_window(page: &ControlPage, state: &mut State) -> Result<(), End> {
    tell_all(page, state);
    let ended = state.ended();
    let (code, reason) = match ended {
        None => return Ok(()),
        Some(Ended::Idle) => (exit::IDLE, "it has made itself idle"),
        Some(Ended::Restart { mode: OperatingMode::WarmStart, .. }) => (exit::WARM_START, "it restarts warm"),
        Some(Ended::Restart { .. }) => (exit::COLD_START, "it restarts cold"),
    };
    let condition = standard::StartCondition::HmPartitionRestart;
    if !matches!(ended, Some(Ended::Restart { condition: of_error, .. }) if of_error == condition) {
        page.handling.store(OWN_REQUEST, Release);
    }
    Err(End { code, reason: reason.into() })
}

fn tell_all(page: &ControlPage, state: &mut State) {
    while let Some(notice) = state.partition.take_notice() {
        tell(page, &notice, &state.partition);
    }
}

/// How a process is called in the health log.
fn called(process: ProcessId, partition: &Partition) -> String {
    match partition.get_process_status(process) {
        Ok(status) => format!("process {}", String::from_utf8_lossy(status.attributes.name.as_bytes())),
        Err(_) if process == MAIN_PROCESS_ID => "the main process".into(),
        Err(_) => "the error handler".into(),
    }
}

fn tell(page: &ControlPage, notice: &Notice, partition: &Partition) {
    match notice {
        Notice::Report { text, .. } => {
            page.report(ReportKind::Message, &String::from_utf8_lossy(text.as_bytes()));
        }
        Notice::Error { verdict: Verdict::Process, .. } => {}
        Notice::Error { process, code, verdict: Verdict::Lost, .. } => {
            let who = called(*process, partition);
            let text = format!("{who}: {code:?} is lost, too many errors wait for the handler");
            page.report(ReportKind::Message, &text);
        }
        Notice::Error { process, code, .. } => {
            page.report(ReportKind::ApplicationError, &format!("{}: {code:?}", called(*process, partition)));
        }
        Notice::Refused { limit } => {
            page.report(ReportKind::Message, &format!("CREATE_PROCESS is refused: {limit}"))
        }
        Notice::SameNameButCase { name } => {
            page.report(ReportKind::Message, &format!("{name:?} exists, with other upper and lower case"));
        }
    }
}
