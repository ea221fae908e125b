//! The supervisor of an executive: where the plan says `executive_died = "reset"` or `executive_hung = "reset"`, it starts another one
//! in place of one that has died or hangs.
//!
//! Responsible for: what the next executive can not find by itself: the retained memories, memory blocks and logbooks, the time of module time 0, and how often one
//! has died. It must know nothing of partitions, channels and frames. Before an executive is started again, everything that
//! the one before had started has ended and its guard has cleaned up.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bateleur_contract::Mapped;
use bateleur_host::instance::sweep_traces;
use bateleur_host::partition::shared_memory;
use bateleur_host::{logbooks, memory_blocks};
use bateleur_monitor::health::decision::decide_module;
use bateleur_monitor::inject::Aim;
use bateleur_monitor::planned::PlannedAct;
use bateleur_monitor::run_order::{DeadExecutive, RunOrder, Supervised};
use bateleur_plan::{ModuleAction, ModuleError, ModuleView, Plan};
use bateleur_system::handed_over::{self, copy_of_inherited, inherited};
use bateleur_system::service_manager::ServiceManager;
use bateleur_system::time::now_ns;
use bateleur_time::run_page::RunPage;
use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitOptions, getppid};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::module::module_of;
use crate::watched_executive::WatchedExecutive;
use crate::{SIGPWR, WRONG, say};

/// Between two looks at the executive, ns. Its end is seen at once.
const LOOK_NS: u64 = 20_000_000;
/// How long the executive may be stopped by a signal: a shell stops its supervisor together with it.
const STOPPED_NS: u64 = 100_000_000;
/// How much longer than the longest major frame a dispatcher may not be seen, ns.
const DISPATCHER_SILENCE_NS: u64 = 400_000_000;
/// How long the monitor may not be seen, ns: it is ordinary work, and partitions may have the processors for 0.95 s of a second.
const MONITOR_SILENCE_NS: u64 = 1_100_000_000;
/// How long the thread that writes the persistent log may not be seen, ns, its waits for the disk apart. No window depends on it.
const HEALTH_LOG_SILENCE_NS: u64 = 5_000_000_000;
/// How long what a dead executive had started may take to end.
const ENDS_NS: u64 = 10_000_000_000;

/// Whether the plan asks for a supervisor.
#[must_use]
pub fn is_wanted(plan: &Plan, order: &RunOrder) -> bool {
    let resets = |error| plan.health.module.action(error) == ModuleAction::Reset;
    let aimed = |act: &PlannedAct| act.aim(plan) == Ok(Aim::Executive);
    order.supervised.as_ref().is_none_or(|supervised| supervised.executive_fd.is_some())
        // On the virtual clock nothing ends it but what is planned.
        && (!order.fast || order.acts.iter().any(aimed))
        && (resets(ModuleError::ExecutiveDied) || resets(ModuleError::ExecutiveHung))
}

/// Runs executives until one has ended by itself, or the budget of resets is used up; the exit code.
///
/// # Errors
/// The machine has no memory or no process for it.
pub fn run(plan: &Plan, compiled: &[u8], order: &RunOrder) -> Result<u8, String> {
    let result = supervise(plan, compiled, order);
    sweep_traces();
    result
}

fn supervise(plan: &Plan, compiled: &[u8], order: &RunOrder) -> Result<u8, String> {
    let parent = getppid().unwrap_or(Pid::INIT);
    let view = module_of(plan, &order.module).map_err(|error| error.to_string())?;
    let cannot = |error: io::Error| format!("cannot supervise the executive: {error}");
    let mut found = order.supervised.as_ref().and_then(|supervised| supervised.executive_fd);
    let mut supervisor = Supervisor::new(plan, &view, compiled, order.clone()).map_err(cannot)?;
    let _ = rustix::thread::set_name(c"supervisor"); // a name is a comfort
    // Whatever an executive leaves becomes a child of this process: its end is seen here.
    rustix::process::set_child_subreaper(Pid::from_raw(1)).map_err(|error| cannot(error.into()))?;
    loop {
        let executive = match found.take() {
            // The process that has started this one, or, where that has ended meanwhile, another one whose number says nothing.
            Some(number) => WatchedExecutive::found(parent, inherited(number)?),
            None => supervisor.start().map_err(cannot)?,
        };
        let end = supervisor.see_out(executive).map_err(cannot)?;
        let (error, detail, at_ns) = match end {
            End::Orderly(code) => return Ok(code),
            End::Fault(error, detail, at_ns) => (error, detail, at_ns),
        };
        if !supervisor.goes_on(error, &detail, at_ns) {
            return Ok(WRONG);
        }
        if supervisor.is_asked_to_stop() {
            say("bateleur: it was asked to stop, and is not started again");
            return Ok(WRONG);
        }
    }
}

/// How an executive ended.
enum End {
    /// By itself, with this exit code.
    Orderly(u8),
    /// It was not to end: the error, its description, and when that was seen, CLOCK_MONOTONIC ns.
    Fault(ModuleError, String, u64),
}

struct Supervisor<'a> {
    plan: &'a Plan,
    compiled: &'a [u8],
    order: RunOrder,
    page: Arc<Mapped<RunPage>>,
    /// Kept open for the executives.
    _handed: Vec<OwnedFd>,
    /// Signals that are passed on.
    signals: Vec<(i32, Arc<AtomicBool>)>,
    /// One that ends a run was passed on.
    asked: bool,
    /// When executives have died, CLOCK_MONOTONIC ns.
    deaths: Vec<u64>,
    /// The longest time between two switches of a core, ns.
    frame_ns: u64,
    /// To the manager of services the supervisor is the service.
    service_manager: ServiceManager,
}

impl<'a> Supervisor<'a> {
    fn new(
        plan: &'a Plan,
        view: &ModuleView<'_>,
        compiled: &'a [u8],
        mut order: RunOrder,
    ) -> io::Result<Self> {
        let mut handed = Vec::new();
        let supervised = match order.supervised.take() {
            // What was handed over stays open under its number.
            Some(before) => Supervised { executive_fd: None, ..before },
            None => begin(view, &mut handed)?,
        };
        let page = copy_of_inherited(supervised.page_fd).map_err(io::Error::other)?;
        let page = Arc::new(Mapped::new(page).map_err(io::Error::other)?);
        order.supervised = Some(supervised);
        let signals = [SIGINT, SIGTERM, SIGHUP, SIGPWR].map(|signal| {
            let flag = Arc::new(AtomicBool::new(false));
            signal_hook::flag::register(signal, flag.clone()).map(|_| (signal, flag))
        });
        Ok(Self {
            plan,
            compiled,
            order,
            page,
            _handed: handed,
            signals: signals.into_iter().collect::<io::Result<_>>()?,
            asked: false,
            deaths: Vec::new(),
            frame_ns: plan.schedules.iter().map(|schedule| schedule.major_frame_ns).max().unwrap_or(0),
            service_manager: ServiceManager::from_environment(),
        })
    }

    /// The next executive.
    fn start(&self) -> io::Result<WatchedExecutive> {
        self.page.forget_executive();
        let plan = handed_over::text("plan", self.compiled)?;
        let order = handed_over::text("order", &serde_json::to_vec(&self.order)?)?;
        let descriptor = |file: &OwnedFd| format!("fd:{}", file.as_raw_fd());
        let arguments = [descriptor(&plan), descriptor(&order)];
        WatchedExecutive::started(Command::new(std::env::current_exe()?).args(arguments).spawn()?)
    }

    /// Watches an executive until everything that it has started has ended.
    fn see_out(&mut self, mut executive: WatchedExecutive) -> io::Result<End> {
        let hung = self.watch(&executive);
        let (error, detail) = match (executive.end(self.page.ended())?, hung) {
            (Ok(code), None) => return Ok(End::Orderly(code)),
            (_, Some(why)) => (ModuleError::ExecutiveHung, why),
            (Err(how), None) => (ModuleError::ExecutiveDied, how),
        };
        let at_ns = now_ns();
        executive.await_guard(ENDS_NS);
        await_children();
        Ok(End::Fault(error, detail, at_ns))
    }

    /// Waits for its end, or ends it because it hangs; how it hung.
    fn watch(&mut self, executive: &WatchedExecutive) -> Option<String> {
        let (mut hung, mut stopped_ns) = (None, None);
        while !executive.await_end(LOOK_NS) {
            match self.page.origin_ns() {
                Some(_) => self.service_manager.lives(now_ns()),
                None => self.service_manager.waits(now_ns()), // no frame has begun
            }
            for (signal, flag) in &self.signals {
                if flag.swap(false, Ordering::AcqRel) {
                    if *signal != SIGPWR {
                        self.asked = true;
                        self.service_manager.ends();
                    }
                    executive.signal(Signal::from_named_raw(*signal).unwrap_or(Signal::TERM));
                }
            }
            if executive.is_stopped() {
                stopped_ns.get_or_insert_with(now_ns);
            } else {
                stopped_ns = None;
            }
            if hung.is_none()
                && let Some(why) = self.hangs(stopped_ns)
            {
                hung = Some(why);
                executive.signal(Signal::KILL);
            }
        }
        hung
    }

    /// Whether a signal that ends a run has come and no executive has got it, or the last one before it could heed it.
    fn is_asked_to_stop(&self) -> bool {
        self.asked
            || self.signals.iter().any(|(signal, flag)| *signal != SIGPWR && flag.load(Ordering::Acquire))
    }

    /// Whether the executive gives no sign of life, in words; never, where the plan ignores that.
    fn hangs(&self, stopped_ns: Option<u64>) -> Option<String> {
        if self.plan.health.module.action(ModuleError::ExecutiveHung) == ModuleAction::Ignore {
            return None;
        }
        let now_ns = now_ns();
        if stopped_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) >= STOPPED_NS) {
            return Some("a signal had stopped it".into());
        }
        if self.order.fast {
            return None; // module time waits for whoever is late
        }
        let dispatcher =
            ("a dispatcher", self.page.dispatcher_silence_ns(now_ns), self.frame_ns + DISPATCHER_SILENCE_NS);
        let monitor = ("the monitor", self.page.monitor_silence_ns(now_ns), MONITOR_SILENCE_NS);
        let freeze_worker =
            ("the freeze worker", self.page.freeze_worker_silence_ns(now_ns), MONITOR_SILENCE_NS);
        let log = ("the health log", self.page.health_log_silence_ns(now_ns), HEALTH_LOG_SILENCE_NS);
        [dispatcher, monitor, freeze_worker, log].into_iter().find_map(|(who, silent_ns, most_ns)| {
            let silent_ns = silent_ns.filter(|silent_ns| *silent_ns > most_ns)?;
            Some(format!("{who} gave no sign of life for {} ms", silent_ns / 1_000_000))
        })
    }

    /// Whether another executive is started after a fault. Notes what that one is told.
    fn goes_on(&mut self, error: ModuleError, detail: &str, at_ns: u64) -> bool {
        let health = &self.plan.health;
        // On the virtual clock everything is at an instant of module time.
        let at_ns = if self.order.fast { self.page.reached().0 } else { at_ns };
        self.deaths.retain(|before_ns| at_ns.saturating_sub(*before_ns) < health.reset.within_ns);
        let action = decide_module(error, &health.module, &health.reset, false, self.deaths.len() as u32);
        let goes_on = action == ModuleAction::Reset;
        let what = if goes_on { "it is started again" } else { "the module ends" };
        say(&format!("bateleur: {error}: {detail}; {what}"));
        self.service_manager.is_at(&format!("{error}: {detail}; {what}"));
        let Some(supervised) = &mut self.order.supervised else { return false };
        let resets = supervised.after.as_ref().map_or(0, |dead| dead.resets);
        supervised.after = Some(DeadExecutive {
            error,
            detail: detail.to_owned(),
            at_ns: match self.page.origin_ns() {
                _ if self.order.fast => at_ns,
                origin_ns => origin_ns.map_or(0, |origin_ns| at_ns.saturating_sub(origin_ns)),
            },
            resets: resets.max(self.page.resets()) + 1,
        });
        self.deaths.push(at_ns);
        goes_on
    }
}

/// What executives that follow each other have in common, made for the first of them.
fn begin(view: &ModuleView<'_>, handed: &mut Vec<OwnedFd>) -> io::Result<Supervised> {
    let page = handed_over::memory("run", size_of::<RunPage>() as u64)?;
    let page_fd = page.as_raw_fd();
    handed.push(page);
    let mut retained_fds = BTreeMap::new();
    let partitions = view.partitions().map(|id| &view.plan()[id]);
    for partition in partitions.filter(|partition| partition.retained_bytes > 0) {
        let memory = shared_memory(&partition.name, partition.retained_bytes)?;
        let memory = handed_over::copy(memory)?;
        retained_fds.insert(partition.name.clone(), memory.as_raw_fd());
        handed.push(memory);
    }
    let mut memory_block_fds = BTreeMap::new();
    for block in memory_blocks::of_module(view).filter(|block| !block.read_write.is_empty()) {
        let memory = handed_over::copy(memory_blocks::make(block).map_err(io::Error::other)?)?;
        memory_block_fds.insert(block.name.clone(), memory.as_raw_fd());
        handed.push(memory);
    }
    for (path, logbook) in logbooks::of_module(view) {
        let memory = handed_over::copy(logbooks::make(&path, logbook)?)?;
        memory_block_fds.insert(path, memory.as_raw_fd());
        handed.push(memory);
    }
    Ok(Supervised { page_fd, retained_fds, memory_block_fds, after: None, executive_fd: None })
}

/// Waits until all that a dead executive had started has ended, its guard among it.
fn await_children() {
    let end_ns = now_ns() + ENDS_NS;
    while now_ns() < end_ns {
        match rustix::process::wait(WaitOptions::NOHANG) {
            Err(Errno::CHILD) => return,
            Ok(Some(_)) | Err(_) => {}
            Ok(None) => std::thread::sleep(std::time::Duration::from_millis(1)),
        }
    }
}
