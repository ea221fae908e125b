//! The least dispatcher that a machine allows: the steps of a switch between two threads of its own process, without an executive,
//! control groups, filters and logs.

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicI32, AtomicU32, AtomicU64, Ordering};

use anyhow::Result;
use bateleur_system::sched;
use bateleur_system::time::{now_ns, sleep_until_ns, spin_until_ns, timespec};
use rustix::thread::futex;

use super::probe::{DISPATCHER, PARTITION, on_core, own_time_us};

/// Each window touches the next one, and is closed so long before its end, ns: as in the module that it is compared with.
const WINDOW_NS: u64 = 1_000_000;
const MARGIN_NS: u64 = 5_000;
/// Whoever waits is woken.
const ANYBODY: NonZeroU32 = NonZeroU32::MAX;
/// Words to a worker.
const WAIT: u32 = 0;
const GO: u32 = 1;
const END: u32 = 2;

/// A thread that has every other window.
#[derive(Default)]
struct Worker {
    tid: AtomicI32,
    word: AtomicU32,
    end_ns: AtomicU64,
    done: AtomicU32,
}

impl Worker {
    fn run(&self, core: u32) {
        let _ = sched::bind(0, &[core]); // the dispatcher could, too
        self.tid.store(rustix::thread::gettid().as_raw_nonzero().get(), Ordering::Release);
        loop {
            match self.word.swap(WAIT, Ordering::Acquire) {
                GO => {
                    spin_until_ns(self.end_ns.load(Ordering::Relaxed) - MARGIN_NS);
                    self.done.store(1, Ordering::Release);
                    let _ = futex::wake(&self.done, futex::Flags::PRIVATE, 1); // nobody waits: it looks
                }
                END => return,
                _ => {
                    let _ = futex::wait(&self.word, futex::Flags::PRIVATE, WAIT, None); // any end: look again
                }
            }
        }
    }

    fn tell(&self, word: u32) {
        self.word.store(word, Ordering::Release);
        let _ = futex::wake(&self.word, futex::Flags::PRIVATE, 1); // as above
    }

    fn await_done(&self, until_ns: u64) {
        let until = timespec(until_ns);
        while self.done.load(Ordering::Acquire) == 0 && now_ns() < until_ns {
            let _ = futex::wait_bitset(&self.done, futex::Flags::PRIVATE, 0, Some(&until), ANYBODY); // as above
        }
    }
}

/// Processor time of the dispatcher for each switch, us, what it spins until the instant taken off: a wait for the end of a window or its
/// instant, real-time priority for the next thread and none for the last one, a wake.
pub(super) fn switch_us(core: u32, rounds: u32) -> Result<f64> {
    on_core(core, DISPATCHER, move || {
        let workers = [Worker::default(), Worker::default()];
        std::thread::scope(|scope| {
            for worker in &workers {
                scope.spawn(|| worker.run(core));
            }
            let tid = |worker: &Worker| worker.tid.load(Ordering::Acquire);
            while workers.iter().any(|worker| tid(worker) == 0) {
                sleep_until_ns(now_ns() + 1_000_000);
            }
            let origin_ns = now_ns() + WINDOW_NS;
            sleep_until_ns(origin_ns);
            let (begun_us, mut spun_ns) = (own_time_us(), 0);
            for round in 0..rounds {
                let instant_ns = origin_ns + u64::from(round) * WINDOW_NS;
                let (next, last) = (&workers[round as usize % 2], &workers[(round as usize + 1) % 2]);
                if round > 0 {
                    last.await_done(instant_ns);
                }
                let _ = sched::fifo(tid(next), PARTITION); // the dispatcher has more
                let ready_ns = now_ns();
                spin_until_ns(instant_ns);
                spun_ns += instant_ns.saturating_sub(ready_ns);
                let _ = sched::ordinary(tid(last)); // as above
                next.done.store(0, Ordering::Relaxed);
                next.end_ns.store(instant_ns + WINDOW_NS, Ordering::Relaxed);
                next.tell(GO);
            }
            let used_us = own_time_us() - begun_us - spun_ns as f64 / 1e3;
            workers.iter().for_each(|worker| worker.tell(END));
            used_us / f64::from(rounds)
        })
    })
}
