//! The life of a partition process.
#![allow(unsafe_code)] // takes over the descriptors that the executive left open

use std::fs::File;
use std::os::fd::{FromRawFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};

use bateleur_contract::{
    CONTROL_FD, ControlPage, DESCRIPTION_FD, Description, ENVIRONMENT, Mapped, MappingError, Mode,
    ProcessTable, RETAINED_FD, StartCondition, Takeover as Order, exit, page,
};
use rustix::thread::futex;

use crate::context::{Context, StartError, Started};
use crate::errors::{HealthError, Response};
use crate::takeover::Takeover;
use crate::time::{Time, monotonic_ns};
use crate::window::Window;

/// A partition: state that is made once and a computation that runs once in each window.
pub trait Partition: Sized {
    /// Creates ports, reads attributes, takes up retained memory. Runs before the first window, without a time limit
    /// but the plan's `startup_timeout`.
    fn start(context: &mut Context) -> Result<Self, StartError>;

    /// One that stood by takes over: its predecessor has ended, its first window comes next. Here it takes up retained
    /// memory as it is now, as `start` did long ago. Not part of a window, and to be done within milliseconds. Called
    /// once, and only where the plan has a `standby`.
    fn take_over(&mut self, takeover: &Takeover) {
        let _ = takeover;
    }

    /// The partition has an [`Partition::error_handler`] (CREATE_ERROR_HANDLER). The plan has to count on it too, with
    /// `error_handler = true`.
    const ERROR_HANDLER: bool = false;

    /// An error that the plan leaves to the partition itself: called at the beginning of the next window, once for each,
    /// oldest first. An error in here is none of the partition's own any more: its health table answers.
    fn error_handler(&mut self, error: &HealthError, window: &Window) -> Response {
        let _ = (error, window);
        Response::GoOn
    }

    /// Computes one window. Returning closes it; the rest of the window is slack.
    fn window(&mut self, window: &Window);
}

/// Runs partition `P` until the executive asks it to stop: the whole of its `main`.
pub fn run<P: Partition>() -> ExitCode {
    report_end(live::<P>())
}

/// Says why it has ended, if not because it was asked to.
pub(crate) fn report_end(result: Result<(), End>) -> ExitCode {
    ExitCode::from(u8::try_from(report(result)).unwrap_or(u8::MAX))
}

/// As above, as a number.
pub(crate) fn report(result: Result<(), End>) -> i32 {
    match result {
        Ok(()) => exit::STOPPED,
        Err(End { code, reason }) => {
            eprintln!("{}: {reason}", program());
            code
        }
    }
}

/// Why a partition process ends by itself.
pub(crate) struct End {
    pub(crate) code: i32,
    pub(crate) reason: String,
}

impl Response {
    fn carry_out(self) -> Result<(), End> {
        let (code, reason) = match self {
            Self::GoOn => return Ok(()),
            Self::WarmRestart => (exit::WARM_START, "its error handler restarts it warm"),
            Self::ColdRestart => (exit::COLD_START, "its error handler restarts it cold"),
            Self::Idle => (exit::IDLE, "its error handler makes it idle"),
        };
        Err(End { code, reason: reason.into() })
    }
}

fn live<P: Partition>() -> Result<(), End> {
    let (_, page, description) = take_over().map_err(|reason| End { code: exit::NO_CONTRACT, reason })?;
    crate::crash::prepare(&description);
    crate::signals::install();
    let (name, stands_by) = (description.partition.clone(), description.standby);
    name_process(&if stands_by { format!("{STANDBY_MARK}{name}") } else { name.clone() });
    if description.error_handler && !P::ERROR_HANDLER {
        return Err(End { code: exit::START_REFUSED, reason: NO_HANDLER.into() });
    }
    let starting = match description.start_condition.is_warm() {
        true => Mode::WarmStart,
        false => Mode::ColdStart,
    };
    page.mode.store(starting as u32, Release);
    let time = Time::new(Rc::new(page), description.clock);
    let refuse = |error: StartError| End { code: exit::START_REFUSED, reason: error.to_string() };
    let retained = retained(&description);
    let mut context = Context::new(description, time.clone(), retained).map_err(refuse)?;
    let partition = P::start(&mut context).map_err(refuse)?;
    let started = context.finish().map_err(refuse)?;
    if stands_by {
        started.connect();
    }
    lock_memory();
    time.page().mode.store(Mode::Normal as u32, Release);
    let errors_seen = time.page().errors_so_far();
    let mut life = Life { partition, time, started, errors_seen, stands_by: stands_by.then_some(name) };
    life.windows()
}

/// The retained memory, if the plan grants some. Asked for once.
pub(crate) fn retained(description: &Description) -> Option<File> {
    // SAFETY: the executive left this descriptor open when it says so, and nobody else in the process knows it.
    (description.retained_bytes > 0).then(|| unsafe { File::from_raw_fd(RETAINED_FD) })
}

/// The process table, if the executive keeps one. Asked for once.
pub(crate) fn process_table(description: &Description) -> Result<Option<Mapped<ProcessTable>>, MappingError> {
    // SAFETY: as above, and a number of a descriptor that nobody has would refuse to be mapped.
    let file = description.process_table.map(|at| unsafe { OwnedFd::from_raw_fd(at) });
    file.map(Mapped::new).transpose()
}

/// Why a partition does not start whose plan expects more of it.
const NO_HANDLER: &str = "the plan says `error_handler = true`, but this program has no error handler: take the key out of the plan, or \
     write the handler";

/// A partition that has initialised.
struct Life<P> {
    partition: P,
    time: Time,
    started: Started,
    /// Errors that the handler was told of.
    errors_seen: u32,
    /// Its name, as long as it stands by.
    stands_by: Option<String>,
}

impl<P: Partition> Life<P> {
    /// Takes windows until it is asked to stop.
    fn windows(&mut self) -> Result<(), End> {
        let time = self.time.clone();
        let page = time.page();
        // Grants go on from one process to the next: this one answers for none before its own.
        let mut last = page.done.load(Acquire);
        loop {
            await_grant(page, last);
            if page.stop.load(Acquire) != 0 {
                return Ok(());
            }
            page.opened_ns.store(monotonic_ns(), Relaxed);
            let window;
            (last, window) = Window::granted(&time);
            if window.end_ns() == 0 {
                self.called()
                    .map_err(|error| End { code: exit::START_REFUSED, reason: error.to_string() })?;
            } else {
                self.started.begin_window(page, window.start_ns());
                self.handle_errors(&window)?;
                self.partition.window(&window);
            }
            page.closed_ns.store(monotonic_ns(), Relaxed);
            if page.close(last) {
                let _ = futex::wake(&page.done, futex::Flags::empty(), 1); // woken by the clock meanwhile: fine
            }
            self.started.faults.after_window();
        }
    }

    /// Hands the errors since the last window to the handler, and does what it decides.
    fn handle_errors(&mut self, window: &Window) -> Result<(), End> {
        let time = self.time.clone();
        let page = time.page();
        while let Some((code, message)) = page.next_error(&mut self.errors_seen) {
            page.handling.store(1, Release);
            let response = self.partition.error_handler(&HealthError { code, message }, window);
            // What it asks for by its exit code is believed only while the page says that the handler is at work.
            response.carry_out()?;
            page.handling.store(0, Release);
        }
        Ok(())
    }

    /// The executive's last call before frame 0, when every peer is there, or before the first window of one that takes
    /// over.
    fn called(&mut self) -> Result<(), StartError> {
        let order = Order::from_number(self.time.page().take_over.load(Relaxed));
        let Some((name, order)) = self.stands_by.take_if(|_| order.is_some()).zip(order) else {
            self.started.connect();
            return Ok(());
        };
        name_process(&name);
        self.started.attach()?;
        self.started.connect();
        self.partition.take_over(&Takeover::new(order, self.time.now_ns()));
        lock_memory(); // also what came with the queues
        Ok(())
    }
}

/// Stack that a start may use, bytes. What the kernel maps for a new process (132 KiB) is too little for the Controller's with its libraries.
const START_STACK: usize = 256 << 10;

/// Before the name of a process that stands by, for `ps` and whoever reads it.
const STANDBY_MARK: char = '+';

/// Sleeps until there is a grant after `last`.
pub(crate) fn await_grant(page: &ControlPage, last: u32) {
    while page.grant.load(Acquire) == last {
        // Interrupted, woken or changed meanwhile: look again.
        let _ = futex::wait(&page.grant, futex::Flags::empty(), last, None);
    }
}

/// The control page, with its descriptor, and the description; of a spare, when it is to begin. Called once.
pub(crate) fn take_over() -> Result<(OwnedFd, Mapped<ControlPage>, Description), String> {
    let by_hand = "this program is a partition: an executive starts it (see `bateleur run --help`)";
    let version = std::env::var(ENVIRONMENT).map_err(|_| by_hand.to_owned())?;
    if version != page::VERSION.to_string() {
        return Err(format!(
            "built for contract {}, started by an executive of contract {version}: build both from one tree",
            page::VERSION
        ));
    }
    // SAFETY: the environment says that an executive started this process; it left these two open, and they are
    // taken over once, before anything else opens a file.
    let (control, description) =
        unsafe { (OwnedFd::from_raw_fd(CONTROL_FD), File::from(OwnedFd::from_raw_fd(DESCRIPTION_FD))) };
    let page = Mapped::<ControlPage>::new(&control).map_err(|error| format!("{by_hand}; {error}"))?;
    if !page.is_valid() {
        return Err("the control page is not one of this contract".into());
    }
    let length = description.metadata().map_err(|error| error.to_string())?.len();
    let mut json = vec![0; length.min(1 << 20) as usize];
    description
        .read_exact_at(&mut json, 0)
        .map_err(|error| format!("cannot read the description: {error}"))?;
    let mut description: Description =
        serde_json::from_slice(&json).map_err(|error| format!("the description is damaged: {error}"))?;
    if description.spare {
        name_process(&format!("{STANDBY_MARK}{}", description.partition));
        // What is mapped now is not waited for when it begins.
        grow_stack();
        lock_memory();
        description.start_condition = await_begin(&page);
    }
    Ok((control, page, description))
}

/// Has the kernel map the stack that a start may use. It grows by itself, but not beyond what may be locked once it is locked.
#[inline(never)]
fn grow_stack() {
    let mut pages = [0_u8; START_STACK];
    std::hint::black_box(&mut pages);
}

/// A spare sleeps until it is to begin: why it does.
fn await_begin(page: &ControlPage) -> StartCondition {
    page.waits.store(1, Release);
    loop {
        match StartCondition::from_number(page.begin.load(Acquire)) {
            Some(condition) => return condition,
            // Interrupted, woken or changed meanwhile: look again.
            None => drop(futex::wait(&page.begin, futex::Flags::empty(), 0, None)),
        }
    }
}

/// What `ps` shows: the partition, not the path of its program.
pub(crate) fn name_process(name: &str) {
    let short: Vec<u8> = name.bytes().filter(|byte| *byte != 0).take(15).collect();
    if let Ok(short) = std::ffi::CString::new(short) {
        let _ = rustix::thread::set_name(&short); // a name is a comfort
    }
}

/// A page fault in a window costs more than many windows last. Refused where the limit is low: the executive says so.
pub(crate) fn lock_memory() {
    let _ = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT);
}

fn program() -> String {
    let path = std::env::args().next().unwrap_or_default();
    path.rsplit('/').next().unwrap_or("partition").to_owned()
}
