//! The time guard: what a partition may compute outside of its windows, whatever it forked or detached.
//!
//! Responsible for: taking real-time priority from the partition's threads at a window's end, and asking that its control group
//! be frozen where more is needed. The dispatcher changes priorities only: a thread without one never keeps a neighbour's window
//! from its processor. Freezing and thawing take a lock of the kernel, and are written by the freeze worker (see
//! [`crate::freeze_worker`]), or by the caller where there is none. It must never wait for the partition: a thread deep in the
//! kernel stops when it comes out, and until then merely gives way. What it does to processes is a [`ProcessControl`], a trait,
//! so that the order of things is tested without any.

use std::io;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64};
use std::sync::{Arc, OnceLock};

use bateleur_system::cgroup::Freezer;
use bateleur_system::time::now_ns;
use bateleur_system::{sched, wait};

use crate::freeze_worker::FreezeWorker;
use crate::hold_request::HoldRequest;

/// Threads of one partition that are known; what a partition may have at most.
const MOST: usize = bateleur_plan::bounds::MOST_THREADS as usize;
/// What a partition may still compute after its window's end when it had closed it: its way to sleep, and what the machine
/// takes for itself meanwhile, ns.
const STRAY_NS: u64 = 200_000;
/// In one of so many windows the processor time is noted: two more system calls in every switch would cost more than they tell, because
/// a partition that computes on takes nobody's time until it is found.
const LOOKED_AT: u32 = 8;
/// No processor time was noted.
const NOT_NOTED: u64 = u64::MAX;
/// From a freeze to the look whether it took, ns. Threads that are not deep in the kernel have stopped by then.
const LOOK_NS: u64 = 40_000;

/// What can be done to the processes of a partition. Nothing here allocates or waits.
pub trait ProcessControl: Send + Sync + std::fmt::Debug {
    /// Freezes all of them; an error where there is no group.
    fn freeze(&self) -> io::Result<()>;
    /// Lets them go on.
    fn thaw(&self);
    /// Whether all have stopped.
    fn is_frozen(&self) -> bool;
    /// Whether `main`, the partition's first process, is stopped by a signal.
    fn is_stopped(&self, main: i32) -> bool;
    /// Stops every process by a signal.
    fn stop(&self, main: i32);
    /// Undoes that.
    fn go_on(&self, main: i32);
    /// Gives `each` every thread.
    fn each_thread(&self, each: &mut dyn FnMut(i32));
    /// Gives a thread real-time priority.
    fn promote(&self, tid: i32, priority: u8);
    /// Takes it; false: it had none.
    fn demote(&self, tid: i32) -> bool;
    /// Takes it, whether it had one or not: one question less.
    fn lower(&self, tid: i32) {
        self.demote(tid);
    }
    /// Moves a thread to a processor.
    fn place(&self, tid: i32, core: u32);
    /// Processor time that the partition's first process has used, ns; `None` if it has ended.
    fn used_ns(&self, main: i32) -> Option<u64>;
    /// CLOCK_MONOTONIC, ns.
    fn now_ns(&self) -> u64;
}

/// Real processes.
#[derive(Debug)]
pub struct Processes(pub Option<Freezer>);

impl Processes {
    /// A signal to every process, or to the first one's group where there is no control group.
    fn signal(&self, main: i32, signal: rustix::process::Signal) {
        use rustix::process::{Pid, kill_process, kill_process_group};
        let mut any = false;
        if let Some(freezer) = &self.0 {
            freezer.each_process(&mut |pid| {
                any = true;
                let _ = Pid::from_raw(pid).map(|pid| kill_process(pid, signal)); // it has ended
            });
        }
        if !any && let Some(main) = Pid::from_raw(main) {
            let _ = kill_process_group(main, signal); // as above
            let _ = kill_process(main, signal);
        }
    }
}

impl ProcessControl for Processes {
    fn freeze(&self) -> io::Result<()> {
        self.0.as_ref().map_or_else(|| Err(io::ErrorKind::Unsupported.into()), Freezer::freeze)
    }
    fn thaw(&self) {
        if let Some(freezer) = &self.0 {
            let _ = freezer.thaw(); // the partition is found silent, which is an error of its own
        }
    }
    fn is_frozen(&self) -> bool {
        self.0.as_ref().is_none_or(Freezer::is_frozen)
    }
    fn is_stopped(&self, main: i32) -> bool {
        wait::is_stopped(main)
    }
    fn stop(&self, main: i32) {
        self.signal(main, rustix::process::Signal::STOP);
    }
    fn go_on(&self, main: i32) {
        self.signal(main, rustix::process::Signal::CONT);
    }
    fn each_thread(&self, each: &mut dyn FnMut(i32)) {
        if let Some(freezer) = &self.0 {
            freezer.each_thread(each);
        }
    }
    fn promote(&self, tid: i32, priority: u8) {
        let _ = sched::fifo(tid, priority); // it has ended, or there is no right to: said at the start
    }
    fn demote(&self, tid: i32) -> bool {
        sched::is_real_time(tid) && sched::ordinary(tid).is_ok()
    }
    fn lower(&self, tid: i32) {
        let _ = sched::ordinary(tid); // it has ended
    }
    fn place(&self, tid: i32, core: u32) {
        let _ = sched::bind(tid, &[core]); // it has ended
    }
    fn used_ns(&self, main: i32) -> Option<u64> {
        sched::used_ns(main)
    }
    fn now_ns(&self) -> u64 {
        now_ns()
    }
}

/// The threads of a partition, as the monitor saw them last. Read by dispatchers while it changes: an entry that was just
/// written over is met twice or not at all, which does no harm.
#[derive(Debug)]
struct Threads {
    /// Number of the thread; the highest bit says that it is real-time in its windows.
    entries: [AtomicU32; MOST],
    count: AtomicU32,
}

/// See [`Threads::entries`].
const REAL_TIME: u32 = 1 << 31;

impl Threads {
    fn new() -> Self {
        Self { entries: [const { AtomicU32::new(0) }; MOST], count: AtomicU32::new(0) }
    }

    fn set(&self, main: &[i32], others: &[i32]) {
        let own = main.iter().map(|tid| *tid as u32 | REAL_TIME);
        let all = own.chain(others.iter().map(|tid| *tid as u32));
        let mut count = 0;
        for (entry, tid) in self.entries.iter().zip(all) {
            entry.store(tid, Relaxed);
            count += 1;
        }
        self.count.store(count, Release);
    }

    fn iter(&self) -> impl Iterator<Item = u32> {
        let count = self.count.load(Acquire) as usize;
        self.entries.iter().take(count).map(|entry| entry.load(Relaxed))
    }

    /// Whether there is no thread but one.
    fn is_one(&self) -> bool {
        self.count.load(Acquire) == 1
    }

    fn real_time(&self) -> impl Iterator<Item = i32> {
        self.iter().filter(|tid| tid & REAL_TIME != 0).map(|tid| (tid & !REAL_TIME) as i32)
    }

    fn all(&self) -> impl Iterator<Item = i32> {
        self.iter().map(|tid| (tid & !REAL_TIME) as i32)
    }
}

/// Threads that were not held when they had to be, since the last question.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Escapes {
    /// Times that real-time threads ran on after the freeze, and were demoted then.
    pub ran_on: u32,
    /// Times that something was still not frozen when the partition's next window came.
    pub stuck: u32,
    /// Times that the partition computed on after it had said that it was done with its window.
    pub strayed: u32,
}

/// See the module's head.
#[derive(Debug)]
pub struct TimeGuard {
    processes: Box<dyn ProcessControl>,
    /// Real-time priority in windows; `None` if it runs as ordinary work.
    priority: Option<u8>,
    /// See [`TimeGuard::timeless`].
    timeless: bool,
    /// See [`TimeGuard::of_one_thread`].
    one_thread: bool,
    /// See [`TimeGuard::calm`].
    calmed: AtomicBool,
    /// The partition's first process; 0: there is none.
    main: AtomicI32,
    threads: Threads,
    demoted: AtomicBool,
    request: HoldRequest,
    /// Freezes and thaws. `None`: whoever asks does it.
    worker: OnceLock<Arc<FreezeWorker>>,
    /// The control group was frozen.
    frozen: AtomicBool,
    /// Processes were stopped by signals.
    signalled: AtomicBool,
    /// When it is to be looked at whether the freeze took, ns of [`ProcessControl::now_ns`]; 0: not at all.
    look_at_ns: AtomicU64,
    ran_on: AtomicU32,
    stuck: AtomicU32,
    strayed: AtomicU32,
    /// Processor time of the first process at the end of its last window, or [`NOT_NOTED`].
    used_ns: AtomicU64,
    /// Windows that ended with the partition's word.
    closed: AtomicU32,
    /// The processor that the threads are on, plus one; 0: not yet placed.
    core: AtomicU32,
}

impl TimeGuard {
    /// Nobody is behind it yet.
    #[must_use]
    pub fn new(processes: Box<dyn ProcessControl>, priority: Option<u8>) -> Self {
        Self {
            processes,
            priority,
            timeless: false,
            one_thread: false,
            calmed: AtomicBool::new(false),
            main: AtomicI32::new(0),
            threads: Threads::new(),
            demoted: AtomicBool::new(false),
            request: HoldRequest::new(),
            worker: OnceLock::new(),
            frozen: AtomicBool::new(false),
            signalled: AtomicBool::new(false),
            look_at_ns: AtomicU64::new(0),
            ran_on: AtomicU32::new(0),
            stuck: AtomicU32::new(0),
            strayed: AtomicU32::new(0),
            used_ns: AtomicU64::new(NOT_NOTED),
            closed: AtomicU32::new(0),
            core: AtomicU32::new(0),
        }
    }

    /// For the virtual clock, where there is nobody's time to take: a partition that says it is done keeps its priority, until
    /// [`TimeGuard::calm`], and what a freeze has not stopped is no error.
    #[must_use]
    pub fn timeless(self) -> Self {
        Self { timeless: true, ..self }
    }

    /// For a partition that the filter of system calls keeps from making threads and processes. Where priority keeps it from others' time
    /// anyway, it is stopped by a signal, at once and by whoever asks: a signal takes no lock of the machine.
    #[must_use]
    pub fn of_one_thread(self) -> Self {
        Self { one_thread: true, ..self }
    }

    /// From now on `worker` freezes and thaws, as long as it runs. Nothing where priorities do not keep the partition from others'
    /// time: there the dispatcher itself has to stop it at its window's end.
    pub(crate) fn leave_to(&self, worker: &Arc<FreezeWorker>) {
        if self.priority.is_some() && !self.timeless {
            let _ = self.worker.set(worker.clone()); // it has one
        }
    }

    /// The partition's first process; 0: there is none.
    #[must_use]
    pub fn main(&self) -> i32 {
        self.main.load(SeqCst)
    }

    /// A process is about to start behind it: it is born free, even where its predecessor was killed while frozen.
    pub fn reset(&self) {
        self.forget();
        self.demoted.store(false, Relaxed);
        self.calmed.store(false, Relaxed);
        self.used_ns.store(NOT_NOTED, Relaxed);
        self.core.store(0, Relaxed);
        let _ = self.take_escapes(); // its predecessor's
        self.let_run();
    }

    /// The process that is behind it from now on, and its threads, see [`TimeGuard::set_threads`].
    pub fn set_process(&self, pid: i32, main: &[i32], others: &[i32]) {
        self.threads.set(main, others);
        self.main.store(pid, SeqCst);
    }

    /// The threads that there are: those of the first process, which run at real-time priority in their windows, and all
    /// others. New ones get their priority with the next window.
    pub fn set_threads(&self, main: &[i32], others: &[i32]) {
        if self.main() != 0 {
            self.threads.set(main, others);
        }
    }

    /// The threads are ordinary work until their next window.
    pub fn admit(&self) {
        self.demoted.store(true, Relaxed);
    }

    /// Nobody is behind it any more: the process' number may be given to another one.
    pub fn forget(&self) {
        self.main.store(0, SeqCst);
        self.threads.count.store(0, Release);
    }

    /// Takes priority at once, and has everything stopped.
    pub fn hold(&self) {
        let main = self.main();
        if main == 0 || self.request.is_stop_asked() {
            return; // since an earlier window's end: nothing of it has run
        }
        self.demote_known();
        let Some(number) = self.request.stop() else { return };
        // The process was replaced meanwhile: its successor must not be born stopped.
        if self.main() != main {
            self.request.withdraw(number);
        }
        self.carry_out();
    }

    /// Takes the priority of a partition that says it is done, until its next window: its word decides whether it is
    /// stopped, never whether it can take others' time. What it uses from now on is noted and found in [`TimeGuard::let_go`].
    pub fn give_way(&self) {
        let main = self.main();
        if self.priority.is_some() && !self.timeless && main != 0 {
            self.demote_known();
            if self.closed.fetch_add(1, Relaxed).is_multiple_of(LOOKED_AT) {
                self.used_ns.store(self.processes.used_ns(main).unwrap_or(NOT_NOTED), Relaxed);
            }
        }
    }

    /// Whether the partition is held, or is to be.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.request.is_stop_asked()
    }

    /// The partition is to run, and is still stopped because whoever thaws has not come to it.
    #[must_use]
    pub fn awaits_thaw(&self) -> bool {
        self.request.release_is_pending()
    }

    /// Its window begins: lets everything run again, with real-time priority.
    pub fn let_go(&self) {
        self.let_run();
        let noted_ns = self.used_ns.swap(NOT_NOTED, Relaxed);
        if noted_ns != NOT_NOTED
            && self
                .processes
                .used_ns(self.main())
                .is_some_and(|used_ns| used_ns > noted_ns.saturating_add(STRAY_NS))
        {
            self.strayed.fetch_add(1, Relaxed);
        }
        if let Some(priority) = self.priority
            && !self.calmed.load(Relaxed)
            && self.demoted.swap(false, Relaxed)
        {
            // The main thread of several decides which of them runs, and has to be able to stop the others.
            let several = self.threads.real_time().nth(1).is_some();
            let level = |tid| if several && tid == self.main() { priority + 1 } else { priority };
            self.threads.real_time().for_each(|tid| self.processes.promote(tid, level(tid)));
        }
    }

    /// Lets everything run again as ordinary work: it has no window.
    pub fn let_run(&self) {
        if self.request.release().is_some() {
            self.carry_out();
        }
    }

    /// Has the newest request carried out, by the worker where there is one and a lock of the kernel is needed.
    fn carry_out(&self) {
        if self.settles_at_once() || !self.worker.get().is_some_and(|worker| worker.call()) {
            self.settle();
        }
    }

    /// Whether requests are carried out by signals, which wait for nobody.
    pub(crate) fn settles_at_once(&self) -> bool {
        self.stops_by_signal() && !self.frozen.load(Relaxed)
    }

    fn stops_by_signal(&self) -> bool {
        self.one_thread && !self.timeless && self.priority.is_some() && self.threads.is_one()
    }

    /// Carries out what was asked for. The caller may have to wait for the kernel.
    pub(crate) fn settle(&self) {
        self.request.settle(&mut |stop| if stop { self.stop_all() } else { self.start_all() });
    }

    fn stop_all(&self) {
        let main = self.main();
        if self.stops_by_signal() {
            // One that somebody else has stopped stays stopped when its window comes.
            if !self.processes.is_stopped(main) {
                self.signalled.store(true, Relaxed);
                self.processes.stop(main);
            }
        } else if self.processes.freeze().is_ok() {
            let look_at_ns = if self.timeless { 0 } else { self.processes.now_ns() + LOOK_NS };
            self.look_at_ns.store(look_at_ns, Relaxed);
            self.frozen.store(true, Relaxed);
        } else {
            self.signalled.store(true, Relaxed);
            self.processes.stop(main);
        }
    }

    fn start_all(&self) {
        let (main, is_frozen) = (self.main(), self.frozen.swap(false, Relaxed));
        self.look_at_ns.store(0, Relaxed);
        let signalled = self.signalled.swap(false, Relaxed);
        let took = if is_frozen {
            self.processes.is_frozen()
        } else {
            !signalled || self.processes.is_stopped(main)
        };
        if !took && !self.timeless && main != 0 {
            self.stuck.fetch_add(1, Relaxed);
        }
        if is_frozen {
            self.processes.thaw();
        }
        if signalled {
            self.processes.go_on(main);
        }
    }

    /// When [`TimeGuard::look`] is due, ns of CLOCK_MONOTONIC; `None` if there is nothing to look at.
    pub(crate) fn look_at_ns(&self) -> Option<u64> {
        Some(self.look_at_ns.load(Relaxed)).filter(|look_at_ns| *look_at_ns != 0)
    }

    /// Looks once whether the freeze took. What had not stopped and is still real-time is demoted and counted; what is
    /// ordinary by now may only be waiting for the processor in order to stop.
    pub(crate) fn look(&self) {
        self.look_at_ns.store(0, Relaxed);
        if !self.request.is_stop_asked() || self.processes.is_frozen() {
            return;
        }
        let mut ran_on = false;
        self.processes.each_thread(&mut |tid| {
            // A window that begins meanwhile gives priority: what is taken after that is given back with the next one.
            ran_on |= self.request.is_stop_asked() && self.processes.demote(tid);
        });
        self.ran_on.fetch_add(u32::from(ran_on), Relaxed);
    }

    /// From now on it is ordinary work, in its windows too, until a successor is behind the guard.
    pub fn calm(&self) {
        self.calmed.store(true, Relaxed);
        self.demote_known();
    }

    /// Moves every thread to a processor, if it is on another one.
    pub fn place(&self, core: u32) {
        if self.core.load(Relaxed) != core + 1 {
            self.core.store(core + 1, Relaxed);
            self.threads.all().for_each(|tid| self.processes.place(tid, core));
        }
    }

    /// What was not held since the last question.
    pub fn take_escapes(&self) -> Escapes {
        let taken = |count: &AtomicU32| count.swap(0, Relaxed);
        Escapes { ran_on: taken(&self.ran_on), stuck: taken(&self.stuck), strayed: taken(&self.strayed) }
    }

    fn demote_known(&self) {
        if self.priority.is_some() && !self.demoted.swap(true, Relaxed) {
            self.threads.real_time().for_each(|tid| self.processes.lower(tid));
        }
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests;
