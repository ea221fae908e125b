//! Whether a partition's processes are to be stopped, and whether the kernel knows it.
//!
//! Dispatchers and the monitor ask with one word: no system call, no lock. Telling the kernel takes the lock of its control
//! groups, which others may hold for milliseconds. One thread at a time does that, whichever it is, and looks again
//! afterwards whether something else was asked for meanwhile: so the last request is always carried out.

use crate::sync::Ordering::SeqCst;
use crate::sync::{AtomicBool, AtomicU32, fence};

/// See the module's head.
#[derive(Debug)]
pub(crate) struct HoldRequest {
    /// Number of the newest request. Odd: the processes are to be stopped.
    newest: AtomicU32,
    /// Number of the request that the kernel was told of last.
    told: AtomicU32,
    /// A thread tells the kernel at this moment.
    telling: AtomicBool,
}

/// Whether the request of this number is one to stop.
const fn is_stop(number: u32) -> bool {
    number % 2 == 1
}

impl HoldRequest {
    /// Nothing is stopped, and nothing is to be.
    pub(crate) fn new() -> Self {
        Self { newest: AtomicU32::new(0), told: AtomicU32::new(0), telling: AtomicBool::new(false) }
    }

    /// Asks for a stop; the request's number. `None` if that is asked for already.
    pub(crate) fn stop(&self) -> Option<u32> {
        self.turn(false)
    }

    /// Asks that everything runs again; the request's number. `None` if nothing is stopped.
    pub(crate) fn release(&self) -> Option<u32> {
        self.turn(true)
    }

    /// Takes a stop back, unless something else was asked for since.
    pub(crate) fn withdraw(&self, number: u32) {
        let _ = self.newest.compare_exchange(number, number.wrapping_add(1), SeqCst, SeqCst); // the newer one counts
    }

    /// Whether a stop is asked for.
    pub(crate) fn is_stop_asked(&self) -> bool {
        is_stop(self.newest.load(SeqCst))
    }

    /// Everything is to run again, and the kernel does not know it yet.
    pub(crate) fn release_is_pending(&self) -> bool {
        !self.is_stop_asked() && is_stop(self.told.load(SeqCst))
    }

    /// Tells the kernel by `tell` (true: stop) until it knows the newest request. Returns at once where another thread does so.
    pub(crate) fn settle(&self, tell: &mut dyn FnMut(bool)) {
        while self.told.load(SeqCst) != self.newest.load(SeqCst) {
            fence(SeqCst); // before the question: whoever tells finds the caller's request when it looks again
            if self.telling.compare_exchange(false, true, SeqCst, SeqCst).is_err() {
                return;
            }
            let newest = self.newest.load(SeqCst);
            if is_stop(newest) != is_stop(self.told.load(SeqCst)) {
                tell(is_stop(newest));
            }
            self.told.store(newest, SeqCst);
            self.telling.store(false, SeqCst);
            fence(SeqCst); // before the next look, as above
        }
    }

    fn turn(&self, from_stop: bool) -> Option<u32> {
        fence(SeqCst); // what the caller has said before is seen by whoever is asked later
        let mut seen = self.newest.load(SeqCst);
        while is_stop(seen) == from_stop {
            let next = seen.wrapping_add(1);
            match self.newest.compare_exchange(seen, next, SeqCst, SeqCst) {
                Ok(_) => {
                    fence(SeqCst); // what the caller looks at next is not older than its request
                    return Some(next);
                }
                Err(newer) => seen = newer,
            }
        }
        None
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use super::*;

    fn told(request: &HoldRequest) -> Vec<bool> {
        let mut told = Vec::new();
        request.settle(&mut |stop| told.push(stop));
        told
    }

    #[test]
    fn kernel_is_told_once_of_each_change_and_of_nothing_that_was_taken_back() {
        let request = HoldRequest::new();
        assert!(told(&request).is_empty());
        let number = request.stop().unwrap();
        assert_eq!((request.stop(), request.is_stop_asked()), (None, true));
        assert_eq!((told(&request), told(&request)), (vec![true], Vec::new()));
        assert!(request.release().is_some() && request.release_is_pending());
        assert_eq!((request.release(), told(&request)), (None, vec![false]));
        assert!(!request.release_is_pending());
        let second = request.stop().unwrap();
        request.withdraw(number);
        assert!(request.is_stop_asked(), "an older request is not taken back in place of the newest");
        request.withdraw(second);
        assert_eq!((request.is_stop_asked(), told(&request)), (false, Vec::new()));
    }

    #[test]
    fn what_is_asked_for_while_the_kernel_is_told_is_told_afterwards_by_the_same_thread() {
        let request = HoldRequest::new();
        request.stop();
        let mut told = Vec::new();
        request.settle(&mut |stop| {
            told.push(stop);
            if stop {
                request.release();
                request.settle(&mut |_| panic!("two threads tell the kernel at once"));
            }
        });
        assert_eq!(told, [true, false]);
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::sync::Arc;
    use loom::thread;

    use super::*;
    use crate::sync::explore;

    /// What the kernel was told, and whether a thread is just telling it.
    struct Kernel {
        stopped: AtomicBool,
        busy: AtomicBool,
    }

    fn settle(request: &HoldRequest, kernel: &Kernel) {
        request.settle(&mut |stop| {
            assert!(!kernel.busy.swap(true, SeqCst), "two threads tell the kernel at once");
            kernel.stopped.store(stop, SeqCst);
            kernel.busy.store(false, SeqCst);
        });
    }

    fn both() -> Arc<(HoldRequest, Kernel)> {
        let kernel = Kernel { stopped: AtomicBool::new(false), busy: AtomicBool::new(false) };
        Arc::new((HoldRequest::new(), kernel))
    }

    #[test]
    fn model_hold_request_the_last_request_reaches_the_kernel_whoever_tells_it() {
        explore(|| {
            let shared = both();
            let dispatcher = {
                let shared = shared.clone();
                thread::spawn(move || {
                    shared.0.stop();
                    settle(&shared.0, &shared.1);
                    shared.0.release();
                    settle(&shared.0, &shared.1);
                })
            };
            settle(&shared.0, &shared.1);
            dispatcher.join().unwrap();
            assert!(!shared.1.stopped.load(SeqCst), "left stopped with nobody who knows it");
        });
    }

    #[test]
    fn model_hold_request_a_stop_of_two_threads_at_once_is_carried_out() {
        explore(|| {
            let shared = both();
            let other = {
                let shared = shared.clone();
                thread::spawn(move || {
                    shared.0.stop();
                    settle(&shared.0, &shared.1);
                })
            };
            shared.0.stop();
            settle(&shared.0, &shared.1);
            other.join().unwrap();
            assert!(shared.1.stopped.load(SeqCst), "left running");
        });
    }

    /// The end of a window meets the death of its process: the successor must not be born stopped.
    #[test]
    fn model_hold_request_a_stop_meant_for_the_predecessor_does_not_stay_on_the_successor() {
        explore(|| {
            let shared = both();
            let process = Arc::new(AtomicU32::new(5));
            let dispatcher = {
                let (shared, process) = (shared.clone(), process.clone());
                thread::spawn(move || {
                    let seen = process.load(SeqCst);
                    if seen == 5
                        && let Some(number) = shared.0.stop()
                    {
                        if process.load(SeqCst) != seen {
                            shared.0.withdraw(number);
                        }
                        settle(&shared.0, &shared.1);
                    }
                })
            };
            process.store(0, SeqCst);
            shared.0.release();
            settle(&shared.0, &shared.1);
            process.store(7, SeqCst);
            dispatcher.join().unwrap();
            assert!(!shared.1.stopped.load(SeqCst));
        });
    }
}
