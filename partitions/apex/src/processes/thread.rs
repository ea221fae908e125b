//! The thread of one process: it sleeps until it has the baton, runs from the entry point, and begins again when the process does.
#![allow(unsafe_code)] // a signal's handler, and the calls that go with it

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::ptr::null;
use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard};
use std::time::Duration;

use bateleur_processes::standard::ErrorCode;

use super::baton::Baton;
use super::interrupted;
use super::kernel::{HANDLER, Kernel, MAIN, Passed, State};
use super::process::{Body, Process};
use super::{alternate_stack, c_library, current, foreign};
use crate::signals::set as set_handler;

/// Asks a thread to look who runs. Ignored by programs that know nothing of it, and seldom used for anything else.
const SIGNAL: libc::c_int = libc::SIGURG;

thread_local! {
    /// The partition that this thread belongs to; null for every other thread.
    static KERNEL: Cell<*const Kernel> = const { Cell::new(null()) };
    static PLACE: Cell<usize> = const { Cell::new(0) };
    /// The thread is in a service, where the signal changes nothing.
    static SERVING: Cell<bool> = const { Cell::new(false) };
    /// The signal came meanwhile.
    static PENDING: Cell<bool> = const { Cell::new(false) };
    /// The lower end of the thread's stack; 0: not known.
    static STACK_LOW: Cell<usize> = const { Cell::new(0) };
    /// The name of the thread's process, and its bytes; the thread's own stack holds it.
    static NAME: Cell<(*const u8, usize)> = const { Cell::new((null(), 0)) };
}

/// Between two looks at another thread. Not by giving way: the main thread is above the others, which would never run.
const A_MOMENT: Duration = Duration::from_micros(20);

/// What a thread unwinds with whose process was stopped, and begins again.
struct Stopped;

/// Makes a thread with its baton, for the process at `place`.
///
/// # Errors
/// The machine gives no thread.
pub(crate) fn spawn(kernel: &Arc<Kernel>, place: usize, body: Body) -> std::io::Result<Arc<Baton>> {
    let baton = Arc::new(Baton::default());
    let (kernel, own) = (kernel.clone(), baton.clone());
    let thread = std::thread::Builder::new().name(body.name.clone()).stack_size(body.stack);
    thread.spawn(move || run(&kernel, place, &own, &body))?;
    // A thread that has begun has everything that the C library and the executive give it.
    while baton.thread.load(Ordering::Acquire) == 0 {
        std::thread::sleep(A_MOMENT);
    }
    Ok(baton)
}

fn run(kernel: &Arc<Kernel>, place: usize, baton: &Baton, body: &Body) {
    KERNEL.set(Arc::as_ptr(kernel));
    PLACE.set(place);
    NAME.set((body.name.as_ptr(), body.name.len()));
    SERVING.set(true);
    alternate_stack::install();
    let thread = rustix::thread::gettid().as_raw_nonzero().get();
    STACK_LOW.set(baton.stack.note_own());
    baton.thread.store(thread, Ordering::Release);
    let process = Process::new(kernel.clone());
    current::enter(Process::new(kernel.clone()));
    let mut has_baton = false;
    loop {
        if !has_baton && !baton.take() {
            return;
        }
        let life = baton.life.load(Ordering::Relaxed);
        leave_service();
        let ended = catch_unwind(AssertUnwindSafe(|| (body.run)(&process)));
        SERVING.set(true);
        has_baton = match ended {
            Err(payload) if payload.is::<Stopped>() => true,
            Err(payload) => after_panic(kernel, place, baton, life, &*payload),
            Ok(result) => {
                let mut state = kernel.lock();
                if let Err(code) = result {
                    let text = format!("{code}");
                    // At most the 128 bytes that are allowed.
                    let _ =
                        state.partition.raise_application_error(ErrorCode::ApplicationError, text.as_bytes());
                }
                stop(kernel, state, place, life)
            }
        };
    }
}

/// The process has come to its end. True: it has the baton for another start.
fn stop<'k>(kernel: &'k Kernel, mut state: MutexGuard<'k, State>, place: usize, life: u32) -> bool {
    // An error that it raised last comes before its end.
    while kernel.pass(&mut state, place) == Passed::Away {
        let baton = state.batons[place].clone();
        drop(state);
        if !baton.take() {
            return false;
        }
        if baton.life.load(Ordering::Relaxed) != life {
            return true;
        }
        state = kernel.lock();
    }
    state.partition.stop_self();
    kernel.tick(&mut state, super::SERVICE_NS);
    kernel.pass(&mut state, place) == Passed::Kept
}

/// The process has faulted. When it is resumed, nothing is left that could go on: it ends. True: it has the baton for another start.
fn after_panic(kernel: &Kernel, place: usize, baton: &Baton, life: u32, payload: &(dyn Any + Send)) -> bool {
    let mut state = kernel.lock();
    state.partition.fault(code_of(payload), 0);
    let passed = kernel.pass(&mut state, place);
    drop(state);
    if passed == Passed::Away && !baton.take() {
        return false;
    }
    // Somebody has handled it, and the partition lives.
    crate::crash::forget();
    if baton.life.load(Ordering::Relaxed) != life {
        return true;
    }
    stop(kernel, kernel.lock(), place, life)
}

/// Rust says of arithmetic what was attempted.
fn code_of(payload: &(dyn Any + Send)) -> ErrorCode {
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or_default();
    if text.starts_with("attempt to ") { ErrorCode::NumericError } else { ErrorCode::IllegalRequest }
}

/// Enters a service; false if the thread is in one, or is about to end.
pub(crate) fn enter_service() -> bool {
    !std::thread::panicking() && !SERVING.replace(true)
}

/// Leaves it, and does what was put off meanwhile.
pub(crate) fn leave_service() {
    SERVING.set(false);
    if PENDING.replace(false) {
        look(false);
    }
}

/// The name of this thread's process: where it lies, and its bytes; none of another thread.
pub(crate) fn own_name() -> (*const u8, usize) {
    NAME.get()
}

/// The place of this thread's process.
pub(crate) fn own_place() -> usize {
    PLACE.get()
}

/// What a service costs whoever runs here under the virtual clock, ns: before NORMAL nothing.
pub(crate) fn service_ns() -> i64 {
    if own_place() == MAIN { 0 } else { super::SERVICE_NS }
}

/// The lower end of this thread's stack, if it is a process's; below it lies the guard page.
pub(crate) fn stack_low() -> Option<u64> {
    Some(STACK_LOW.get() as u64).filter(|low| *low != 0)
}

/// The thread that the program began with.
pub(crate) fn is_first() -> bool {
    rustix::thread::gettid() == rustix::process::getpid()
}

/// Unwinds to where the process begins.
pub(crate) fn begin_again() -> ! {
    resume_unwind(Box::new(Stopped))
}

/// Sleeps until the thread has the baton again, inside of a service; goes back to where its process begins if that has begun anew
/// meanwhile.
pub(crate) fn sleep(baton: &Baton, life: u32) {
    if !baton.take() || baton.life.load(Ordering::Relaxed) != life {
        foreign::leave();
        begin_again();
    }
}

/// Asks the thread that has this baton to look who runs.
pub(crate) fn interrupt(baton: &Baton) {
    signal(baton, SIGNAL);
}

/// Sends a signal to the thread that has this baton; 0 looks whether it is there. Not 0: it has ended.
fn signal(baton: &Baton, signal: libc::c_int) -> libc::c_long {
    let thread = baton.thread.load(Ordering::Acquire);
    let own = rustix::process::getpid().as_raw_nonzero().get();
    // SAFETY: a signal to a thread of this process whose handler is installed; if the thread has ended, nothing happens.
    unsafe { libc::syscall(libc::SYS_tgkill, own, thread, signal) }
}

/// Installs the handlers, before any thread of a process exists.
pub(crate) fn install() {
    c_library::find();
    set_handler(SIGNAL, on_signal as *const () as usize, libc::SA_RESTART | libc::SA_SIGINFO);
    crate::signals::install_traps();
}

/// Takes a lock that this thread does not hold and that nobody holds while being stopped, computes, and sleeps on a futex: no memory is
/// taken, and nothing of the interrupted code is called. Code of the C library runs on, because it may hold the lock of its memory,
/// which other processes need: the main thread asks again. Who sleeps in the kernel holds no such lock.
extern "C" fn on_signal(_: libc::c_int, _: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: the C library gives every thread its own errno; the interrupted code finds it as it was.
    unsafe {
        let errno = libc::__errno_location();
        let before = *errno;
        let sleeps = interrupted::sleeps(context.cast());
        if SERVING.get() {
            PENDING.set(true);
        } else if sleeps || !c_library::contains(interrupted::instruction(context.cast())) {
            look(sleeps);
        }
        *errno = before;
    }
}

/// Lets whoever is to run now run, or somebody else if the thread `sleeps`; comes back when it is this thread's turn.
fn look(sleeps: bool) {
    // SAFETY: the thread's own stack holds the partition as long as the thread runs.
    let Some(kernel) = (unsafe { KERNEL.get().as_ref() }) else { return };
    SERVING.set(true);
    let mut state = kernel.lock();
    if state.holder == PLACE.get() {
        kernel.tick(&mut state, 0);
        if sleeps && state.is_holders_turn() {
            state.lend();
        }
        stop_here(kernel, state);
    } else {
        drop(state);
    }
    SERVING.set(false);
}

/// Ends this thread alone. Its frames are abandoned: nobody can say where they are.
fn end_here() {
    // SAFETY: takes a number; what the thread has stays, as the frames do.
    unsafe { libc::syscall(libc::SYS_exit, 0) };
}

/// Sleeps in the midst of the process's own code until it is its turn again; ends the thread if the process has begun anew meanwhile.
fn stop_here(kernel: &Kernel, mut state: MutexGuard<'_, State>) {
    let place = PLACE.get();
    // SAFETY: its thread's stack holds the baton too. No count of owners is touched here: the interrupted code may be about to.
    let baton = unsafe { &*Arc::as_ptr(&state.batons[place]) };
    let life = baton.life.load(Ordering::Relaxed);
    baton.preempted.store(true, Ordering::Relaxed);
    let passed = kernel.pass(&mut state, place);
    drop(state);
    if passed == Passed::Away && (!baton.take() || baton.life.load(Ordering::Relaxed) != life) {
        end_here();
    }
    baton.preempted.store(false, Ordering::Relaxed);
}

/// A fault in the code of this thread's process: it is FAULTED, and sleeps until somebody resumes it or starts it again. False if nobody
/// could go on after it: no process runs here, it is in a service or in the C library, or there is no error handler but perhaps itself.
///
/// # Safety
/// `context` is the kernel's, of a signal's handler that this thread is in.
pub(crate) unsafe fn fault(code: ErrorCode, address: u64, context: *const libc::ucontext_t) -> bool {
    // SAFETY: as in `look`, and the caller's.
    let (kernel, instruction) = unsafe { (KERNEL.get().as_ref(), interrupted::instruction(context)) };
    let Some(kernel) = kernel.filter(|_| !SERVING.get() && !c_library::contains(instruction)) else {
        return false;
    };
    let place = PLACE.get();
    SERVING.set(true);
    let mut state = kernel.lock();
    if state.holder != place || place == HANDLER || state.bodies[HANDLER].is_none() {
        return false;
    }
    state.partition.fault(code, address as usize);
    stop_here(kernel, state);
    SERVING.set(false);
    true
}

/// Waits until a thread that was dismissed is none of the threads that the plan counts. It has nothing to do but to end.
fn await_end(baton: &Baton) {
    for _ in 0..AWAITED {
        if signal(baton, 0) != 0 {
            return;
        }
        std::thread::sleep(A_MOMENT);
    }
}

/// How often that is looked for: 100 ms altogether, and longer where the machine does other things.
const AWAITED: u32 = 5000;

/// Gives a process a new thread whose old one was stopped in its own code (the main thread).
pub(crate) fn adopt(kernel: &Arc<Kernel>, state: &mut State) {
    let Some(place) = state.orphan.take() else { return };
    let Some(body) = state.bodies[place].clone() else { return };
    state.batons[place].stack.forget();
    state.batons[place].dismiss();
    await_end(&state.batons[place]);
    match spawn(kernel, place, body) {
        Ok(baton) => state.batons[place] = baton,
        Err(error) => {
            eprintln!("no new thread for a process that starts again: {error}; the partition starts again");
            let _ =
                state.partition.set_partition_mode(bateleur_processes::standard::OperatingMode::ColdStart);
        }
    }
}
