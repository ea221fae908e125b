//! The life of a partition of several processes: the main thread takes windows and lets processes run in them.

use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};

use bateleur_contract::{Clock, ControlPage, Mapped, Mode, ReportKind, StartCondition, exit};
use bateleur_processes::standard::{self, ErrorCode, OperatingMode, SystemTime};
use bateleur_processes::{
    End as Ended, HealthTable, Notice, Partition, PartitionAction, PeriodGrid, Settings, Verdict,
};
use rustix::thread::futex;

use super::initialisation::{Initialisation, complete};
use super::kernel::{Kernel, State};
use super::thread;
use crate::context::{Context, StartError, Started};
use crate::run::{End, await_grant, lock_memory, name_process, report_end, take_over};
use crate::time::{Time, monotonic_ns};

/// The partition's period where its attribute `period` does not say another one, ns.
const PERIOD_NS: u64 = 20_000_000;

/// Runs a partition of several processes until the executive asks it to stop: the whole of its `main`. `initialise` is its main process;
/// the partition enters NORMAL with its first window.
///
/// The plan's `threads` counts one thread for each process, one for the error handler, and one more. The attribute `period` says the
/// partition's period where that is not 20 ms.
pub fn run_processes(initialise: impl FnOnce(&mut Initialisation<'_>) -> Result<(), StartError>) -> ExitCode {
    report_end(live(initialise))
}

fn live(initialise: impl FnOnce(&mut Initialisation<'_>) -> Result<(), StartError>) -> Result<(), End> {
    let (control, page, description) =
        take_over().map_err(|reason| End { code: exit::NO_CONTRACT, reason })?;
    crate::signals::install();
    name_process(&description.partition);
    let refuse = |error: StartError| End { code: exit::START_REFUSED, reason: error.to_string() };
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
    let mut context = Context::new(description, time, retained).map_err(refuse)?;
    let period_ns = context.duration_ns("period", PERIOD_NS).map_err(refuse)?;
    let kernel = kernel(shared, clock, condition, period_ns);
    initialise(&mut Initialisation { context: &mut context, kernel: &kernel }).map_err(refuse)?;
    complete(&mut kernel.lock()).map_err(refuse)?;
    let started = context.finish().map_err(refuse)?;
    lock_memory();
    kernel.page.mode.store(Mode::Normal as u32, Release);
    windows(&kernel, started)
}

/// The partition before its main process.
pub(crate) fn kernel(
    page: Mapped<ControlPage>,
    clock: Clock,
    condition: StartCondition,
    period_ns: u64,
) -> Arc<Kernel> {
    thread::install();
    Arc::new(Kernel::new(page, clock, Partition::new(settings(condition, period_ns))))
}

fn settings(condition: StartCondition, period_ns: u64) -> Settings {
    let period = SystemTime::try_from(period_ns).unwrap_or(SystemTime::MAX).max(1);
    let mut settings = Settings::every(period);
    settings.grid = PeriodGrid { origin: 0, period };
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
    let mut last = 0;
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
    while let Some(notice) = state.partition.take_notice() {
        tell(page, &notice);
    }
    let (code, reason) = match state.ended() {
        None => return Ok(()),
        Some(Ended::Idle) => (exit::IDLE, "it has made itself idle"),
        Some(Ended::Restart { mode: OperatingMode::WarmStart, .. }) => (exit::WARM_START, "it restarts warm"),
        Some(Ended::Restart { .. }) => (exit::COLD_START, "it restarts cold"),
    };
    Err(End { code, reason: reason.into() })
}

fn tell(page: &ControlPage, notice: &Notice) {
    match notice {
        Notice::Report { text, .. } => {
            page.report(ReportKind::Message, &String::from_utf8_lossy(text.as_bytes()));
        }
        Notice::Error { verdict: Verdict::Process, .. } => {}
        Notice::Error { process, code, verdict: Verdict::Lost, .. } => {
            let text =
                format!("process {}: {code:?} is lost, too many errors wait for the handler", process.0);
            page.report(ReportKind::Message, &text);
        }
        Notice::Error { process, code, .. } => {
            page.report(ReportKind::ApplicationError, &format!("process {}: {code:?}", process.0));
        }
        Notice::SameNameButCase { name } => {
            page.report(ReportKind::Message, &format!("{name:?} exists, with other upper and lower case"));
        }
    }
}
