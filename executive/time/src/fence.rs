//! The fence: holds every process of a partition between its windows, whatever it forked or detached.
//!
//! Responsible for: taking real-time priority from the partition's threads, freezing its control group, looking once
//! afterwards whether that took, and undoing all of it. It must never wait for the partition: a thread deep in the
//! kernel stops when it comes out, and until then merely gives way. What it does to processes is a [`ProcessControl`], a trait,
//! so that the order of things is tested without any.

use std::io;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64};

use bateleur_system::cgroup::Freezer;
use bateleur_system::sched;
use bateleur_system::time::now_ns;

/// Up to so many real-time threads are demoted before the freeze, at about a microsecond each. With more, the freeze
/// alone has to do, and the look afterwards.
const FEW: usize = 8;
/// Threads of one partition that are known; what a partition may have at most.
const MOST: usize = 128;
/// A freeze that takes longer is held up by somebody else's making of control groups, which share one lock, ns. The next
/// one would be too: for [`SHUN_NS`] signals do its work.
const SLOW_NS: u64 = 200_000;
/// See [`SLOW_NS`], ns.
const SHUN_NS: u64 = 1_000_000_000;
/// What a partition may still compute after its window's end when it had closed it: its way to sleep, and what the machine
/// takes for itself meanwhile, ns.
const STRAY_NS: u64 = 200_000;
/// In one of so many windows the processor time is noted: two more system calls in every switch would cost more than they tell, because
/// a partition that computes on takes nobody's time until it is found.
const LOOKED_AT: u32 = 8;
/// No processor time was noted.
const NOT_NOTED: u64 = u64::MAX;
/// From a freeze to the look whether it took, ns. Threads that are not deep in the kernel have stopped by then.
pub const LOOK_NS: u64 = 40_000;

/// What can be done to the processes of a partition. Nothing here allocates or waits.
pub trait ProcessControl: Send + Sync + std::fmt::Debug {
    /// Freezes all of them; an error where there is no group.
    fn freeze(&self) -> io::Result<()>;
    /// Lets them go on.
    fn thaw(&self);
    /// Whether all have stopped.
    fn is_frozen(&self) -> bool;
    /// Stops every process by a signal; `main` is the partition's first.
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
pub struct Fence {
    processes: Box<dyn ProcessControl>,
    /// Real-time priority in windows; `None` if it runs as ordinary work.
    priority: Option<u8>,
    /// See [`Fence::timeless`].
    timeless: bool,
    /// See [`Fence::calm`].
    calmed: AtomicBool,
    threads: Threads,
    demoted: AtomicBool,
    frozen: AtomicBool,
    stopped: AtomicBool,
    /// The look after the freeze found something that had not stopped.
    unsettled: AtomicBool,
    shun_until_ns: AtomicU64,
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

impl Fence {
    /// Nobody is behind it yet.
    #[must_use]
    pub fn new(processes: Box<dyn ProcessControl>, priority: Option<u8>) -> Self {
        Self {
            processes,
            priority,
            timeless: false,
            calmed: AtomicBool::new(false),
            threads: Threads::new(),
            demoted: AtomicBool::new(false),
            frozen: AtomicBool::new(false),
            stopped: AtomicBool::new(false),
            unsettled: AtomicBool::new(false),
            shun_until_ns: AtomicU64::new(0),
            ran_on: AtomicU32::new(0),
            stuck: AtomicU32::new(0),
            strayed: AtomicU32::new(0),
            used_ns: AtomicU64::new(NOT_NOTED),
            closed: AtomicU32::new(0),
            core: AtomicU32::new(0),
        }
    }

    /// For the virtual clock, where there is nobody's time to take: a partition that says it is done keeps its priority, until
    /// [`Fence::calm`], and a freeze may take as long as it likes, because signals would undo a planned SIGSTOP.
    #[must_use]
    pub fn timeless(self) -> Self {
        Self { timeless: true, ..self }
    }

    /// A process is about to start behind it: it is born free, even where its predecessor was killed while frozen.
    pub fn reset(&self) {
        self.forget();
        self.stopped.store(false, Relaxed);
        self.demoted.store(false, Relaxed);
        self.calmed.store(false, Relaxed);
        self.unsettled.store(false, Relaxed);
        self.used_ns.store(NOT_NOTED, Relaxed);
        self.core.store(0, Relaxed);
        self.frozen.store(false, Relaxed);
        let _ = self.take_escapes(); // its predecessor's
        // Whatever the flag said: a dispatcher may be freezing right now (it looks again afterwards).
        self.processes.thaw();
    }

    /// The threads that there are: those of the first process, which run at real-time priority in their windows, and all
    /// others. New ones get their priority with the next window.
    pub fn set_threads(&self, main: &[i32], others: &[i32]) {
        self.threads.set(main, others);
    }

    /// The threads are ordinary work until their next window.
    pub fn admit(&self) {
        self.demoted.store(true, Relaxed);
    }

    /// Nobody is behind it any more.
    pub fn forget(&self) {
        self.threads.count.store(0, Release);
    }

    /// Holds everything; `main`: the first process. True: a look is due in [`LOOK_NS`].
    pub fn hold(&self, main: i32) -> bool {
        if self.frozen.load(SeqCst) {
            return false; // since an earlier window's end: nothing of it has run
        }
        let few = self.threads.real_time().take(FEW + 1).count() <= FEW;
        if few {
            // Before the freeze: a thread deep inside the kernel is not frozen at once, but then at least gives way.
            self.demote_known();
        }
        let begun_ns = self.processes.now_ns();
        let tried = begun_ns >= self.shun_until_ns.load(Relaxed);
        let frozen = tried && self.processes.freeze().is_ok();
        self.frozen.store(frozen, SeqCst);
        let slow = frozen && !self.timeless && self.processes.now_ns() - begun_ns > SLOW_NS;
        if slow {
            self.shun_until_ns.store(begun_ns + SHUN_NS, Relaxed);
        }
        if !frozen || slow {
            self.stopped.store(true, SeqCst);
            self.processes.stop(main);
            self.demote_known();
        }
        self.unsettled.store(false, Relaxed);
        frozen && !slow
    }

    /// Takes the priority of a partition that says it is done, until its next window: its word decides whether it is
    /// stopped, never whether it can take others' time. What it uses from now on is noted and found in [`Fence::let_go`].
    pub fn give_way(&self, main: i32) {
        if self.priority.is_some() && !self.timeless && main != 0 {
            self.demote_known();
            if self.closed.fetch_add(1, Relaxed).is_multiple_of(LOOKED_AT) {
                self.used_ns.store(self.processes.used_ns(main).unwrap_or(NOT_NOTED), Relaxed);
            }
        }
    }

    /// Looks once whether the freeze took. What had not stopped and is still real-time is demoted and counted; what is
    /// ordinary by now may only be waiting for the processor in order to stop.
    pub fn look(&self) {
        if !self.frozen.load(SeqCst) || self.processes.is_frozen() {
            return;
        }
        self.unsettled.store(true, Relaxed);
        let mut ran_on = false;
        self.processes.each_thread(&mut |tid| ran_on |= self.processes.demote(tid));
        if ran_on {
            self.demoted.store(true, Relaxed);
            self.ran_on.fetch_add(1, Relaxed);
        }
    }

    /// Whether anything holds the partition.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.frozen.load(SeqCst) || self.stopped.load(SeqCst)
    }

    /// Lets everything run again.
    pub fn let_go(&self, main: i32) {
        if self.unsettled.swap(false, Relaxed) && !self.processes.is_frozen() {
            self.stuck.fetch_add(1, Relaxed);
        }
        if self.frozen.swap(false, SeqCst) {
            self.processes.thaw();
        }
        if self.stopped.swap(false, SeqCst) {
            self.processes.go_on(main);
        }
        let noted_ns = self.used_ns.swap(NOT_NOTED, Relaxed);
        if noted_ns != NOT_NOTED
            && self.processes.used_ns(main).is_some_and(|used_ns| used_ns > noted_ns.saturating_add(STRAY_NS))
        {
            self.strayed.fetch_add(1, Relaxed);
        }
        if let Some(priority) = self.priority
            && !self.calmed.load(Relaxed)
            && self.demoted.swap(false, Relaxed)
        {
            // The main thread of several decides which of them runs, and has to be able to stop the others.
            let several = self.threads.real_time().nth(1).is_some();
            let level = |tid| if several && tid == main { priority + 1 } else { priority };
            self.threads.real_time().for_each(|tid| self.processes.promote(tid, level(tid)));
        }
    }

    /// Lets everything run again as ordinary work: it has no window.
    pub fn let_run(&self, main: i32) {
        if self.frozen.swap(false, SeqCst) {
            self.processes.thaw();
        }
        if self.stopped.swap(false, SeqCst) {
            self.processes.go_on(main);
        }
    }

    /// Whether there is anything for [`Fence::relieve`].
    #[must_use]
    pub fn awaits_relief(&self) -> bool {
        self.stopped.load(SeqCst) && self.frozen.load(SeqCst)
    }

    /// Thaws, off the time-critical path, what signals hold by now: a window's start must not meet the slow lock again.
    pub fn relieve(&self) {
        if self.stopped.load(SeqCst) && self.frozen.swap(false, SeqCst) {
            self.processes.thaw();
        }
    }

    /// From now on it is ordinary work, in its windows too, until a successor is behind the fence.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    /// Processes that are written down.
    #[derive(Debug, Default)]
    struct World {
        said: Vec<String>,
        now_ns: u64,
        freeze_takes_ns: u64,
        freeze_fails: bool,
        in_kernel: bool,
        frozen: bool,
        real_time: Vec<i32>,
        threads: Vec<i32>,
        used_ns: u64,
    }

    #[derive(Debug, Default, Clone)]
    struct Fake(Arc<Mutex<World>>);

    impl Fake {
        fn world(&self) -> std::sync::MutexGuard<'_, World> {
            self.0.lock().unwrap()
        }
        fn said(&self) -> String {
            std::mem::take(&mut self.world().said).join(", ")
        }
    }

    impl ProcessControl for Fake {
        fn freeze(&self) -> io::Result<()> {
            let mut world = self.world();
            world.said.push("freeze".into());
            world.now_ns += world.freeze_takes_ns;
            if world.freeze_fails {
                return Err(io::ErrorKind::Other.into());
            }
            world.frozen = true;
            Ok(())
        }
        fn thaw(&self) {
            let mut world = self.world();
            world.said.push("thaw".into());
            world.frozen = false;
        }
        fn is_frozen(&self) -> bool {
            self.world().frozen && !self.world().in_kernel
        }
        fn stop(&self, main: i32) {
            self.world().said.push(format!("stop {main}"));
        }
        fn go_on(&self, main: i32) {
            self.world().said.push(format!("go on {main}"));
        }
        fn each_thread(&self, each: &mut dyn FnMut(i32)) {
            let threads = self.world().threads.clone();
            threads.into_iter().for_each(each);
        }
        fn promote(&self, tid: i32, priority: u8) {
            let level = if priority == 40 { String::new() } else { format!(" to {priority}") };
            self.world().said.push(format!("promote {tid}{level}"));
            self.world().real_time.push(tid);
        }
        fn demote(&self, tid: i32) -> bool {
            let mut world = self.world();
            let was = world.real_time.contains(&tid);
            world.real_time.retain(|other| *other != tid);
            if was {
                world.said.push(format!("demote {tid}"));
            }
            was
        }
        fn place(&self, tid: i32, core: u32) {
            self.world().said.push(format!("{tid} to {core}"));
        }
        fn used_ns(&self, _: i32) -> Option<u64> {
            Some(self.world().used_ns)
        }
        fn now_ns(&self) -> u64 {
            self.world().now_ns
        }
    }

    /// A partition of `count` threads from 10 on, and a child 5, in its window.
    fn in_window(count: i32) -> (Fake, Fence) {
        let fake = Fake::default();
        let fence = Fence::new(Box::new(fake.clone()), Some(40));
        let main: Vec<i32> = (10..10 + count).collect();
        fake.world().threads = main.iter().copied().chain([5]).collect();
        fence.set_threads(&main, &[5]);
        fence.admit();
        fence.let_go(10);
        fake.said();
        (fake, fence)
    }

    #[test]
    fn few_threads_are_demoted_before_the_freeze_and_promoted_after_the_thaw() {
        let (fake, fence) = in_window(2);
        assert!(fence.hold(10));
        assert_eq!(fake.said(), "demote 10, demote 11, freeze");
        fence.look();
        fence.let_go(10);
        assert_eq!(fake.said(), "thaw, promote 10 to 41, promote 11");
        assert_eq!(fence.take_escapes(), Escapes::default());
    }

    #[test]
    fn on_the_virtual_clock_a_partition_keeps_its_priority_after_its_word_and_a_slow_freeze_is_waited_for() {
        let (fake, fence) = in_window(1);
        let fence = fence.timeless();
        fence.give_way(10);
        fence.let_go(10);
        assert_eq!(fake.said(), "", "as it was");
        fake.world().freeze_takes_ns = 10 * SLOW_NS;
        fence.hold(10);
        fence.let_go(10);
        assert_eq!(fake.said(), "demote 10, freeze, thaw, promote 10");
    }

    #[test]
    fn a_calmed_partition_is_ordinary_work_in_its_windows_too_until_a_successor_comes() {
        let (fake, fence) = in_window(1);
        let fence = fence.timeless();
        fence.calm();
        assert_eq!(fake.said(), "demote 10");
        fence.hold(10);
        fence.let_go(10);
        fence.calm();
        assert_eq!(fake.said(), "freeze, thaw");
        fence.reset();
        fence.set_threads(&[20], &[]);
        fence.admit();
        fence.let_go(20);
        assert_eq!(fake.said(), "thaw, promote 20");
    }

    #[test]
    fn many_threads_are_frozen_and_those_that_run_on_are_demoted_at_the_look_and_counted() {
        let (fake, fence) = in_window(9);
        fake.world().in_kernel = true;
        assert!(fence.hold(10));
        assert_eq!(fake.said(), "freeze");
        fence.look();
        assert!(fake.world().real_time.is_empty(), "{:?}", fake.world());
        assert_eq!(fence.take_escapes(), Escapes { ran_on: 1, ..Escapes::default() });
        fake.said();
        fake.world().in_kernel = false;
        fence.let_go(10);
        assert!(fake.said().ends_with("promote 17, promote 18"));
        assert_eq!(fence.take_escapes(), Escapes::default());
    }

    #[test]
    fn a_demoted_thread_that_waits_for_the_processor_is_no_escape_unless_it_lasts_until_its_next_window() {
        let (fake, fence) = in_window(1);
        fake.world().in_kernel = true;
        fence.hold(10);
        fence.look();
        assert_eq!(fence.take_escapes(), Escapes::default());
        fence.let_go(10);
        assert_eq!(fence.take_escapes(), Escapes { stuck: 1, ..Escapes::default() });
    }

    #[test]
    fn a_partition_that_says_it_is_done_loses_its_priority_until_its_next_window() {
        let (fake, fence) = in_window(1);
        fence.give_way(10);
        assert_eq!(fake.said(), "demote 10");
        fake.world().used_ns += STRAY_NS;
        fence.let_go(10);
        assert_eq!(fake.said(), "promote 10");
        assert_eq!(fence.take_escapes(), Escapes::default(), "its way to sleep is its own");
    }

    #[test]
    fn a_partition_that_computes_on_after_it_said_it_was_done_is_found_before_its_next_window() {
        let (fake, fence) = in_window(1);
        fence.give_way(10);
        fake.world().used_ns += STRAY_NS + 1;
        fence.let_go(10);
        assert_eq!(fence.take_escapes(), Escapes { strayed: 1, ..Escapes::default() });
        fake.world().used_ns += 1_000_000; // in its window
        fence.give_way(10);
        fence.let_go(10);
        assert_eq!(fence.take_escapes(), Escapes::default());
    }

    #[test]
    fn what_a_predecessor_did_outside_its_windows_is_not_held_against_its_successor() {
        let (fake, fence) = in_window(1);
        fence.give_way(10);
        fake.world().used_ns += STRAY_NS + 1;
        fence.let_go(10);
        fence.reset();
        assert_eq!(fence.take_escapes(), Escapes::default());
    }

    #[test]
    fn a_freeze_that_fails_is_followed_by_signals() {
        let (fake, fence) = in_window(1);
        fake.world().freeze_fails = true;
        assert!(!fence.hold(10), "there is nothing to look at");
        assert_eq!(fake.said(), "demote 10, freeze, stop 10");
        fence.look();
        fence.let_go(10);
        assert_eq!(fake.said(), "go on 10, promote 10");
    }

    #[test]
    fn a_slow_freeze_is_followed_by_signals_and_shunned_for_a_second() {
        let (fake, fence) = in_window(1);
        fake.world().freeze_takes_ns = SLOW_NS + 1;
        assert!(!fence.hold(10));
        assert_eq!(fake.said(), "demote 10, freeze, stop 10");
        fence.relieve();
        fence.relieve();
        assert_eq!(fake.said(), "thaw");
        fence.let_go(10);
        assert_eq!(fake.said(), "go on 10, promote 10");
        fence.hold(10);
        assert_eq!(fake.said(), "demote 10, stop 10");
        fence.let_go(10);
        fake.said();
        fake.world().now_ns += SHUN_NS;
        fake.world().freeze_takes_ns = 0;
        assert!(fence.hold(10));
        assert_eq!(fake.said(), "demote 10, freeze");
    }

    #[test]
    fn a_thread_that_came_during_the_window_is_promoted_with_the_next_one() {
        let (fake, fence) = in_window(1);
        fence.set_threads(&[10, 11], &[5]);
        fence.hold(10);
        assert_eq!(fake.said(), "demote 10, freeze");
        fence.let_go(10);
        assert_eq!(fake.said(), "thaw, promote 10 to 41, promote 11");
    }

    #[test]
    fn a_successor_is_born_free_and_ordinary() {
        let (fake, fence) = in_window(1);
        fence.hold(10);
        fake.said();
        fence.reset();
        assert_eq!((fake.said().as_str(), fake.world().frozen), ("thaw", false));
        fence.let_go(0);
        assert_eq!(fake.said(), "", "nobody is promoted, not even the caller");
    }

    #[test]
    fn every_thread_is_moved_once_for_each_change_of_core() {
        let (fake, fence) = in_window(1);
        fence.place(1);
        fence.place(1);
        assert_eq!(fake.said(), "10 to 1, 5 to 1");
        fence.place(0);
        assert_eq!(fake.said(), "10 to 0, 5 to 0");
    }
}
