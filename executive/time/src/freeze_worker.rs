//! The thread that freezes and thaws partitions, so that no dispatcher waits for the kernel's lock of control groups.
//!
//! It runs beside the dispatchers, on the processors that are left for other work where there are some. Where there are none, it
//! runs below the partitions: it takes time from slack only, and a thaw that comes late is counted as a lost window.

use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, atomic::AtomicBool};

use bateleur_system::time::{now_ns, timespec};
use rustix::thread::futex;

use crate::redundant_pair::RedundantPair;
use crate::run_page::Heartbeat;

/// Between two signs of life of a worker of whom nothing is asked, ns.
const BEAT_NS: u64 = 200_000_000;

/// See the module's head.
#[derive(Debug)]
pub struct FreezeWorker {
    /// Calls so far; the worker sleeps on it.
    calls: AtomicU32,
    /// Calls that were carried out.
    served: AtomicU32,
    /// Whether it takes calls.
    serves: AtomicBool,
}

impl FreezeWorker {
    /// A worker that takes calls from now on: [`FreezeWorker::run`] it.
    #[must_use]
    pub fn new() -> Arc<Self> {
        Arc::new(Self { calls: AtomicU32::new(0), served: AtomicU32::new(0), serves: AtomicBool::new(true) })
    }

    /// Something was asked for; false: it takes no calls any more.
    pub(crate) fn call(&self) -> bool {
        if !self.serves.load(SeqCst) {
            return false;
        }
        self.wake();
        true
    }

    /// Whether something was asked for that the kernel does not know yet.
    pub(crate) fn is_behind(&self) -> bool {
        self.served.load(SeqCst) != self.calls.load(SeqCst)
    }

    /// Carries out what is asked for the partitions in `pairs`, until [`FreezeWorker::end`].
    pub fn run(self: &Arc<Self>, pairs: &[Arc<RedundantPair>], beat: &Heartbeat) {
        let controls = || pairs.iter().flat_map(|pair| pair.all());
        controls().for_each(|control| control.guard().leave_to(self));
        loop {
            beat.beat();
            let seen = self.calls.load(SeqCst);
            let serves = self.serves.load(SeqCst);
            controls().for_each(|control| control.guard().settle());
            self.served.store(seen, SeqCst);
            if !serves {
                return;
            }
            let now = now_ns();
            let due = |look_at_ns: &u64| *look_at_ns <= now;
            controls()
                .filter(|control| control.guard().look_at_ns().as_ref().is_some_and(due))
                .for_each(|control| control.guard().look());
            let next = controls().filter_map(|control| control.guard().look_at_ns()).min();
            let sleep_ns = next.map_or(BEAT_NS, |next| next.saturating_sub(now).min(BEAT_NS));
            let limit = timespec(sleep_ns);
            let _ = futex::wait(&self.calls, futex::Flags::PRIVATE, seen, Some(&limit)); // any end: it looks
        }
    }

    /// It carries out what was asked for before, and returns from [`FreezeWorker::run`]. Whoever asks from now on does it himself.
    pub fn end(&self) {
        self.serves.store(false, SeqCst);
        self.wake();
    }

    fn wake(&self) {
        self.calls.fetch_add(1, SeqCst);
        let _ = futex::wake(&self.calls, futex::Flags::PRIVATE, 1); // it is awake
    }
}
