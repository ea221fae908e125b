//! The life of a partition of several processes: the main thread takes windows and lets processes run in them.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::{AcqRel, Acquire, Relaxed, Release};

use bateleur_contract::page::OWN_REQUEST;
use bateleur_contract::{
    Clock, ControlPage, Description, Mapped, Mode, PlannedProcess, ProcessPlan, ProcessTable, ReportKind,
    StartCondition, exit,
};
use bateleur_processes::logbooks::PlannedLogbook;
use bateleur_processes::standard::{
    self, ErrorCode, MAIN_PROCESS_ID, MAX_PROCESSES, MemoryBlockMode, MemoryBlockStatus, Name, OperatingMode,
    ProcessId, SapAddress, SystemTime,
};
use bateleur_processes::{
    End as Ended, HealthTable, Level, Notice, Partition, PartitionAction, PeriodGrid, Settings, Verdict,
};
use rustix::thread::futex;

use super::initialisation::{Initialisation, complete};
use super::kernel::{HANDLER, Kernel, Periods, State};
use super::process::Process;
use super::shown::Shown;
use super::{alternate_stack, current, thread};
use crate::context::{Context, StartError, Started};
use crate::logbook::Logbook;
use crate::memory_block::MemoryBlock;
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
    crate::crash::prepare(&description);
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
    let table = crate::run::process_table(&description)
        .map_err(|error| End { code: exit::NO_CONTRACT, reason: error.to_string() })?;
    let taken = taken(&description);
    let starting = if condition.is_warm() { Mode::WarmStart } else { Mode::ColdStart };
    page.mode.store(starting as u32, Release);
    let time = Time::new(Rc::new(page), clock);
    let context = Context::new(description, time, retained).map_err(refuse)?;
    let mut settings = settings(condition, &context.process_plan(), &taken);
    settings.memory_blocks = context.memory_blocks().iter().filter_map(memory_block).collect();
    settings.logbooks = context.logbooks().iter().filter_map(logbook).collect();
    settings.name_services = name_services(&context);
    let kernel = kernel(shared, clock, settings, table);
    let _ = kernel.schedules.set(context.schedules()); // nobody has asked for them before
    kernel.lock().periods = Periods::of(&context);
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
        self.complete().map_err(refuse)?;
        let started = self.context.finish().map_err(refuse)?;
        lock_memory();
        self.kernel.page.mode.store(Mode::Normal as u32, Release);
        windows(&self.kernel, started)
    }
}

impl Beginning {
    /// Every process is there: they are shown, and compared with what the plan says of them.
    fn complete(&self) -> Result<(), StartError> {
        let state = &mut *self.kernel.lock();
        complete(state)?;
        state.shown.prepare(&state.partition);
        let differs =
            self.context.planned_processes().iter().filter_map(|planned| differs(planned, &state.partition));
        let differs: Vec<String> = differs.collect();
        // A report holds one line; the first are worth more than the last.
        differs
            .iter()
            .take(MOST_DIFFERENCES)
            .for_each(|text| self.kernel.page.report(ReportKind::Message, text));
        Ok(())
    }
}

/// Differences between the plan and the program that are told: reports wait for the executive in a ring.
const MOST_DIFFERENCES: usize = 6;

/// What the plan says of a process and the program does not do, with both; `None`: it does.
fn differs(planned: &PlannedProcess, partition: &Partition) -> Option<String> {
    let name = &planned.name;
    let status = partition.get_process_id(name).and_then(|id| partition.get_process_status(id));
    let Ok(status) = status else {
        return Some(format!("process {name} of the plan is not created by the program"));
    };
    let attributes = &status.attributes;
    let span = |time: SystemTime| u64::try_from(time).ok().map(|ns| ns as f64 / 1e6);
    let said = |ns: Option<u64>| ns.map(|ns| ns as f64 / 1e6);
    let word = |ms: Option<f64>| ms.map_or_else(|| "none".to_owned(), |ms| format!("{ms} ms"));
    let mut found = Vec::new();
    if i32::from(planned.priority) != attributes.base_priority {
        found.push(format!("priority {} and not {}", attributes.base_priority, planned.priority));
    }
    for (what, has, wants) in [
        ("period", span(attributes.period), said(planned.period_ns)),
        ("deadline", span(attributes.time_capacity), said(planned.deadline_ns)),
    ] {
        if has != wants {
            found.push(format!("{what} {} and not {}", word(has), word(wants)));
        }
    }
    (!found.is_empty()).then(|| format!("process {name} has {} as in the plan", found.join(", ")))
}

/// Errors of processes that an error handler of theirs does not decide about.
fn taken(description: &Description) -> Vec<ErrorCode> {
    let code = |name: &String| match name.as_str() {
        "deadline_missed" => Some(ErrorCode::DeadlineMissed),
        "application_error" => Some(ErrorCode::ApplicationError),
        "numeric_error" => Some(ErrorCode::NumericError),
        "illegal_request" => Some(ErrorCode::IllegalRequest),
        "stack_overflow" => Some(ErrorCode::StackOverflow),
        "memory_violation" => Some(ErrorCode::MemoryViolation),
        "hardware_fault" => Some(ErrorCode::HardwareFault),
        _ => None, // none of a process
    };
    description.taken_errors.iter().filter_map(code).collect()
}

/// What the executive is told when the partition ends before its first window.
pub(crate) fn end_of(kernel: &Kernel) -> Result<(), End> {
    after_window(&kernel.page, &mut kernel.lock())
}

/// A memory block as the services know it; `None`: no service can say its name.
fn memory_block(block: &MemoryBlock) -> Option<(Name, MemoryBlockStatus)> {
    let mode = if block.is_writable() { MemoryBlockMode::ReadWrite } else { MemoryBlockMode::Read };
    let size = i32::try_from(block.len()).unwrap_or(i32::MAX);
    Some((Name::new(block.name())?, MemoryBlockStatus { address: block.address() as usize, mode, size }))
}

/// A logbook as the services know it; `None`: no service can say its name.
fn logbook(logbook: &Logbook) -> Option<PlannedLogbook> {
    Some(PlannedLogbook { name: Name::new(logbook.name())?, memory: Arc::new(logbook.clone()) })
}

/// The name services as the services know them, without those whose name no service can say.
fn name_services(context: &Context) -> Vec<(Name, Vec<(String, SapAddress)>)> {
    let service = |(name, addresses): (&String, &BTreeMap<String, SapAddress>)| {
        let addresses = addresses.iter().map(|(point, address)| (point.clone(), *address));
        Some((Name::new(name)?, addresses.collect()))
    };
    context.name_services().iter().filter_map(service).collect()
}

/// The partition before its main process.
pub(crate) fn kernel(
    page: Mapped<ControlPage>,
    clock: Clock,
    settings: Settings,
    table: Option<Mapped<ProcessTable>>,
) -> Arc<Kernel> {
    thread::install();
    Arc::new(Kernel::new(page, clock, Partition::new(settings), Shown::new(table)))
}

/// `taken`: errors that no handler of its processes decides about.
pub(crate) fn settings(condition: StartCondition, plan: &ProcessPlan, taken: &[ErrorCode]) -> Settings {
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
    for code in taken {
        settings.health.level[*code as usize] = Level::Module;
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
                let mut state = kernel.lock();
                state.follow_schedule(&window);
                started.begin_window(page, window.start_ns);
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
    state.shown.show(&state.partition, &state.batons, state.bodies[HANDLER].is_some());
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
        if let Notice::Error { process, .. } = &notice {
            state.shown.count_error(*process);
        }
        match &notice {
            Notice::Error { process, code, verdict: Verdict::Process, .. } => {
                state.shown.tell_error(kind_of(*code), *process);
            }
            _ => tell(page, &notice, &state.partition),
        }
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

/// What an error of a process is to the executive.
fn kind_of(code: ErrorCode) -> ReportKind {
    match code {
        ErrorCode::DeadlineMissed => ReportKind::DeadlineMissed,
        ErrorCode::NumericError => ReportKind::NumericError,
        ErrorCode::IllegalRequest => ReportKind::IllegalRequest,
        ErrorCode::StackOverflow => ReportKind::StackOverflow,
        ErrorCode::MemoryViolation => ReportKind::MemoryViolation,
        ErrorCode::HardwareFault => ReportKind::HardwareFault,
        ErrorCode::ApplicationError | ErrorCode::PowerFail => ReportKind::ApplicationError,
    }
}

fn tell(page: &ControlPage, notice: &Notice, partition: &Partition) {
    match notice {
        Notice::Report { text, .. } => {
            page.report(ReportKind::Message, &String::from_utf8_lossy(text.as_bytes()));
        }
        Notice::Error { process, code, verdict: Verdict::Lost, .. } => {
            let who = called(*process, partition);
            let text = format!("{who}: {code:?} is lost, too many errors wait for the handler");
            page.report(ReportKind::Message, &text);
        }
        // The plan leaves it to the module.
        Notice::Error { process, code, verdict: Verdict::Module, .. } => {
            page.report(kind_of(*code), &called(*process, partition));
        }
        Notice::Error { process, code: ErrorCode::DeadlineMissed, .. } => {
            page.report(ReportKind::DeadlineMissed, &called(*process, partition));
        }
        // What ends the partition is told again by its end.
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
