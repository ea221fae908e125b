//! Which core has a window of a partition open, and whether an operator holds the partition.
//!
//! A window of one core may follow one of another core without a gap: the later core takes the partition when the earlier one has
//! let it go. An operator's hold is carried out by whoever has the partition, at its window's end, or by the monitor where
//! nobody has it. Nobody keeps the partition over a system call that waits.

use crate::sync::Ordering::SeqCst;
use crate::sync::{AtomicBool, AtomicU32, fence};

/// See the module's head.
#[derive(Debug)]
pub(crate) struct WindowOwner {
    /// The core that has the partition, plus one; 0: none has.
    core: AtomicU32,
    /// An operator holds the partition.
    held: AtomicBool,
}

impl WindowOwner {
    pub(crate) fn new() -> Self {
        Self { core: AtomicU32::new(0), held: AtomicBool::new(false) }
    }

    /// Whether `core` has the partition from now on, or had it already.
    pub(crate) fn try_own(&self, core: u32) -> bool {
        let own = core + 1;
        let taken = self.core.compare_exchange(0, own, SeqCst, SeqCst);
        fence(SeqCst); // before the caller looks whether the partition is held
        taken.is_ok() || taken == Err(own)
    }

    /// `core` lets the partition go; nothing where another core has it. True: a hold was asked for, the core has the partition again, and
    /// must carry the hold out.
    #[must_use]
    pub(crate) fn disown(&self, core: u32, is_stopped: impl Fn() -> bool) -> bool {
        let let_go = self.core.compare_exchange(core + 1, 0, SeqCst, SeqCst).is_ok();
        fence(SeqCst);
        // After letting go, as the monitor asks after it has said that the partition is held: one of the two sees the other.
        let_go && self.is_held() && !is_stopped() && self.try_own(core)
    }

    /// Whether an operator holds the partition.
    pub(crate) fn is_held(&self) -> bool {
        self.held.load(SeqCst)
    }

    /// An operator holds the partition from now on. True: no core has it, so the caller must stop it. Readiness must say so before: a core that
    /// takes the partition after this grants nothing.
    #[must_use]
    pub(crate) fn hold(&self) -> bool {
        self.held.store(true, SeqCst);
        fence(SeqCst);
        self.core.load(SeqCst) == 0
    }

    /// The operator does not hold the partition any more.
    pub(crate) fn release(&self) {
        self.held.store(false, SeqCst);
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::sync::Arc;
    use loom::thread;

    use super::*;
    use crate::sync::explore;

    /// A partition: what the dispatchers and the monitor make of it.
    struct Partition {
        owner: WindowOwner,
        ready: AtomicBool,
        stopped: AtomicBool,
        /// Windows that are open.
        open: AtomicU32,
    }

    impl Partition {
        fn new() -> Arc<Self> {
            Arc::new(Self {
                owner: WindowOwner::new(),
                ready: AtomicBool::new(true),
                stopped: AtomicBool::new(false),
                open: AtomicU32::new(0),
            })
        }

        /// One window, as a dispatcher opens and closes it; false: it was not granted.
        fn window(&self, core: u32) -> bool {
            if !self.owner.try_own(core) {
                return false;
            }
            let granted = self.ready.load(SeqCst);
            if granted {
                if !self.owner.is_held() {
                    self.stopped.store(false, SeqCst);
                }
                assert_eq!(self.open.fetch_add(1, SeqCst), 0, "two windows of one partition at once");
                self.open.fetch_sub(1, SeqCst);
            }
            if self.owner.is_held() {
                self.stopped.store(true, SeqCst);
            }
            while self.owner.disown(core, || self.stopped.load(SeqCst)) {
                self.stopped.store(true, SeqCst);
            }
            granted
        }

        /// An operator's order.
        fn hold(&self) {
            self.ready.store(false, SeqCst);
            if self.owner.hold() {
                self.stopped.store(true, SeqCst);
            }
        }
    }

    #[test]
    fn model_window_owner_two_cores_never_have_a_window_of_one_partition_open_at_once() {
        explore(|| {
            let partition = Partition::new();
            let other = {
                let partition = partition.clone();
                thread::spawn(move || partition.window(1))
            };
            let first = partition.window(0);
            let second = other.join().unwrap();
            assert!(first || second, "both gave their window away");
            assert!(partition.owner.try_own(7), "nobody has it for ever");
        });
    }

    #[test]
    fn model_window_owner_whoever_is_held_is_stopped_whatever_a_dispatcher_had_begun() {
        explore(|| {
            let partition = Partition::new();
            let dispatcher = {
                let partition = partition.clone();
                thread::spawn(move || {
                    partition.window(1);
                })
            };
            partition.hold();
            dispatcher.join().unwrap();
            assert!(partition.stopped.load(SeqCst), "runs on though an operator holds it");
            assert!(partition.owner.try_own(7), "nobody has it for ever");
        });
    }

    #[test]
    fn model_window_owner_whoever_is_held_is_stopped_between_windows_of_two_cores() {
        explore(|| {
            let partition = Partition::new();
            let cores = [0, 1].map(|core| {
                let partition = partition.clone();
                thread::spawn(move || {
                    partition.window(core);
                })
            });
            partition.hold();
            cores.into_iter().for_each(|core| core.join().unwrap());
            assert!(partition.stopped.load(SeqCst), "runs on though an operator holds it");
            assert!(partition.owner.try_own(7), "nobody has it for ever");
        });
    }
}
