//! What an executive tells its supervisor: when module time 0 was, and that its threads are alive.
//!
//! Every word is an atomic with one writer. Nothing waits.
#![allow(unsafe_code)] // one `unsafe impl`, a promise about this type

use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::SeqCst;

use bateleur_contract::{Mapped, SharedMemory};
use bateleur_system::time::now_ns;

/// Threads that are watched, most: the monitor, dispatchers, the freeze worker, and the one that writes the persistent log.
const MOST: usize = 115;
/// Places of those that are no dispatchers.
const MONITOR: usize = 0;
const FREEZE_WORKER: usize = MOST - 2;
const HEALTH_LOG: usize = MOST - 1;
/// Counts that an executive leaves to the next one.
const COUNTS: usize = 6;

/// The page. All zeros is one that nobody has written.
#[derive(Debug)]
#[repr(C, align(1024))]
pub struct RunPage {
    /// CLOCK_MONOTONIC instant of module time 0, ns; 0: no frame has begun.
    origin_ns: AtomicU64,
    /// Resets of the module so far.
    resets: AtomicU64,
    /// What the monitor has counted, in an order of its own.
    counts: [AtomicU64; COUNTS],
    /// Virtual clock: the module time that has been reached, ns.
    reached_ns: AtomicU64,
    /// Virtual clock: what has gone over the line to the companion, and is to come.
    line_counts: [AtomicU64; 3],
    /// The exit code that the executive is about to give, plus one; 0: it gives none yet.
    ends: AtomicU64,
    /// When each thread was seen last, CLOCK_MONOTONIC ns; 0: it is not to be seen.
    seen_ns: [AtomicU64; MOST],
}

const _: () = assert!(size_of::<RunPage>() == 1024);

// SAFETY: every field is an atomic or an array of atomics, for which every bit pattern is a value.
unsafe impl SharedMemory for RunPage {}

impl RunPage {
    /// Frames begin, after so many resets. Module time 0 was, or is, at this instant of CLOCK_MONOTONIC.
    pub fn begin(&self, origin_ns: u64, resets: u32) {
        self.resets.store(resets.into(), SeqCst);
        self.origin_ns.store(origin_ns, SeqCst);
    }

    /// Resets of the module so far.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.resets.load(SeqCst) as u32 // written from one
    }

    /// That instant; `None` if no frame has begun.
    #[must_use]
    pub fn origin_ns(&self) -> Option<u64> {
        Some(self.origin_ns.load(SeqCst)).filter(|origin_ns| *origin_ns != 0)
    }

    /// Leaves counts to the executive that may follow.
    pub fn keep_counts(&self, counts: [u64; COUNTS]) {
        self.counts.iter().zip(counts).for_each(|(kept, count)| kept.store(count, SeqCst));
    }

    /// The counts of the executive before; zeros if there was none.
    #[must_use]
    pub fn counts(&self) -> [u64; COUNTS] {
        std::array::from_fn(|place| self.counts[place].load(SeqCst))
    }

    /// Virtual clock: module time, ns, and the counts of the line to the companion, if somebody counts there.
    pub fn reach(&self, module_ns: u64, line_counts: Option<[u64; 3]>) {
        self.reached_ns.store(module_ns, SeqCst);
        let counts = line_counts.into_iter().flatten();
        self.line_counts.iter().zip(counts).for_each(|(kept, count)| kept.store(count, SeqCst));
    }

    /// What [`RunPage::reach`] has left.
    #[must_use]
    pub fn reached(&self) -> (u64, [u64; 3]) {
        let counts = std::array::from_fn(|place| self.line_counts[place].load(SeqCst));
        (self.reached_ns.load(SeqCst), counts)
    }

    /// The executive ends by itself, with this exit code.
    pub fn end(&self, code: u8) {
        self.ends.store(u64::from(code) + 1, SeqCst);
    }

    /// The exit code of an executive that has ended; `None` if it did not end by itself.
    #[must_use]
    pub fn ended(&self) -> Option<u8> {
        Some(self.ends.load(SeqCst)).and_then(|ends| u8::try_from(ends.checked_sub(1)?).ok())
    }

    /// For how long the monitor has not been seen, ns; `None` if it is not to be seen.
    #[must_use]
    pub fn monitor_silence_ns(&self, now_ns: u64) -> Option<u64> {
        longest_silence_ns(&self.seen_ns[MONITOR..=MONITOR], now_ns)
    }

    /// For how long the freeze worker has not been seen, ns; `None` if it is not to be seen.
    #[must_use]
    pub fn freeze_worker_silence_ns(&self, now_ns: u64) -> Option<u64> {
        longest_silence_ns(&self.seen_ns[FREEZE_WORKER..=FREEZE_WORKER], now_ns)
    }

    /// For how long the thread that writes the persistent log has not been seen, ns; `None` if it is not to be seen, or waits for the disk.
    #[must_use]
    pub fn health_log_silence_ns(&self, now_ns: u64) -> Option<u64> {
        longest_silence_ns(&self.seen_ns[HEALTH_LOG..=HEALTH_LOG], now_ns)
    }

    /// The longest time for which a dispatcher has not been seen, ns; `None` if none is to be seen.
    #[must_use]
    pub fn dispatcher_silence_ns(&self, now_ns: u64) -> Option<u64> {
        longest_silence_ns(&self.seen_ns[MONITOR + 1..FREEZE_WORKER], now_ns)
    }

    /// Another executive begins: nobody is to be seen yet.
    pub fn forget_executive(&self) {
        self.ends.store(0, SeqCst);
        self.seen_ns.iter().for_each(|seen_ns| seen_ns.store(0, SeqCst));
    }
}

fn longest_silence_ns(seen_ns: &[AtomicU64], now_ns: u64) -> Option<u64> {
    let seen = seen_ns.iter().map(|seen_ns| seen_ns.load(SeqCst)).filter(|seen_ns| *seen_ns != 0);
    seen.map(|seen_ns| now_ns.saturating_sub(seen_ns)).max()
}

/// A thread's sign of life. It is to be seen from the first one until this is dropped. Costs a store.
#[derive(Debug)]
pub struct Heartbeat(Option<(Arc<Mapped<RunPage>>, usize)>);

impl Heartbeat {
    /// The monitor's. Nobody watches where there is no page.
    #[must_use]
    pub fn of_monitor(page: Option<&Arc<Mapped<RunPage>>>) -> Self {
        Self(page.map(|page| (page.clone(), MONITOR)))
    }

    /// That of dispatcher number `dispatcher`. Nobody watches where there is no page, or no place for it.
    #[must_use]
    pub fn of_dispatcher(page: Option<&Arc<Mapped<RunPage>>>, dispatcher: usize) -> Self {
        let place = MONITOR + 1 + dispatcher;
        Self(page.filter(|_| place < FREEZE_WORKER).map(|page| (page.clone(), place)))
    }

    /// The freeze worker's. Nobody watches where there is no page.
    #[must_use]
    pub fn of_freeze_worker(page: Option<&Arc<Mapped<RunPage>>>) -> Self {
        Self(page.map(|page| (page.clone(), FREEZE_WORKER)))
    }

    /// That of the thread which writes the persistent log. Nobody watches where there is no page.
    #[must_use]
    pub fn of_health_log(page: Option<&Arc<Mapped<RunPage>>>) -> Self {
        Self(page.map(|page| (page.clone(), HEALTH_LOG)))
    }

    /// Somebody else takes its time now, such as a disk: it is not to be seen until its next sign of life.
    pub fn rest(&self) {
        if let Some((page, place)) = &self.0 {
            page.seen_ns[*place].store(0, SeqCst);
        }
    }

    /// It is alive.
    pub fn beat(&self) {
        self.beat_at(now_ns());
    }

    /// It is alive at this instant of CLOCK_MONOTONIC, ns.
    pub(crate) fn beat_at(&self, now_ns: u64) {
        if let Some((page, place)) = &self.0 {
            page.seen_ns[*place].store(now_ns, SeqCst);
        }
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.rest();
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use super::*;

    fn page() -> Arc<Mapped<RunPage>> {
        let file = rustix::fs::memfd_create("run", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, size_of::<RunPage>() as u64).unwrap();
        Arc::new(Mapped::new(file).unwrap())
    }

    #[test]
    fn thread_is_missed_from_its_first_sign_of_life_until_it_has_ended() {
        let page = page();
        let monitor = Heartbeat::of_monitor(Some(&page));
        let dispatchers = [0, FREEZE_WORKER - 2].map(|number| Heartbeat::of_dispatcher(Some(&page), number));
        assert_eq!(
            (page.monitor_silence_ns(9), page.dispatcher_silence_ns(9)),
            (None, None),
            "none has begun"
        );
        monitor.beat_at(10);
        dispatchers[0].beat_at(20);
        dispatchers[1].beat_at(30);
        assert_eq!((page.monitor_silence_ns(100), page.dispatcher_silence_ns(100)), (Some(90), Some(80)));
        dispatchers[0].beat_at(40);
        assert_eq!(page.dispatcher_silence_ns(100), Some(70), "whoever is silent longest counts");
        drop(dispatchers);
        assert_eq!((page.monitor_silence_ns(100), page.dispatcher_silence_ns(100)), (Some(90), None));
        page.end(0);
        assert_eq!(page.ended(), Some(0));
        page.forget_executive();
        assert_eq!((page.monitor_silence_ns(100), page.ended()), (None, None));
    }

    #[test]
    fn each_thread_is_missed_by_itself_and_not_while_it_waits_for_a_disk() {
        let page = page();
        let silences = || {
            [
                page.monitor_silence_ns(100),
                page.dispatcher_silence_ns(100),
                page.freeze_worker_silence_ns(100),
                page.health_log_silence_ns(100),
            ]
        };
        let worker = Heartbeat::of_freeze_worker(Some(&page));
        let log = Heartbeat::of_health_log(Some(&page));
        worker.beat_at(40);
        log.beat_at(70);
        assert_eq!(silences(), [None, None, Some(60), Some(30)]);
        log.rest();
        assert_eq!(silences(), [None, None, Some(60), None]);
        log.beat_at(90);
        drop(worker);
        assert_eq!(silences(), [None, None, None, Some(10)]);
    }

    #[test]
    fn thread_that_has_no_place_is_not_watched() {
        let page = page();
        Heartbeat::of_dispatcher(Some(&page), FREEZE_WORKER - 1).beat();
        Heartbeat::of_monitor(None).beat();
        assert_eq!((page.dispatcher_silence_ns(u64::MAX), page.origin_ns()), (None, None));
    }
}
