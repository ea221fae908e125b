//! What one thread sleeps on until it is its turn.

use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering};

use rustix::thread::futex::{self, Timespec};

use super::stack;

/// Not its turn.
const WAIT: u32 = 0;
/// Its turn.
const GO: u32 = 1;
/// It shall end, because its process begins again in another thread.
const LEAVE: u32 = 2;

/// One thread's side of the baton.
#[derive(Debug, Default)]
pub(crate) struct Baton {
    word: AtomicU32,
    /// The start of the process that it was given for last.
    pub(crate) life: AtomicU32,
    /// The thread's number in the kernel; 0: it has not begun.
    pub(crate) thread: AtomicI32,
    /// The thread was stopped by the signal, somewhere in its own code.
    pub(crate) preempted: AtomicBool,
    pub(crate) stack: stack::Place,
}

impl Baton {
    pub(crate) fn give(&self, life: u32) {
        self.life.store(life, Ordering::Relaxed);
        self.order(GO);
    }

    /// The thread shall look at the partition's state: the main thread, which goes by that and not by whose turn it is.
    pub(crate) fn nudge(&self) {
        self.order(GO);
    }

    /// The thread shall end.
    pub(crate) fn dismiss(&self) {
        self.order(LEAVE);
    }

    fn order(&self, order: u32) {
        self.word.store(order, Ordering::Release);
        let _ = futex::wake(&self.word, futex::Flags::PRIVATE, 1); // it has not slept yet: fine
    }

    /// Sleeps until it is the thread's turn. False: it shall end.
    pub(crate) fn take(&self) -> bool {
        loop {
            match self.word.swap(WAIT, Ordering::Acquire) {
                GO => return true,
                LEAVE => return false,
                _ => {
                    let _ = futex::wait(&self.word, futex::Flags::PRIVATE, WAIT, None); // interrupted: look again
                }
            }
        }
    }

    /// Sleeps for `span_ns` at the longest; true: it is the thread's turn.
    pub(crate) fn take_within(&self, span_ns: u64) -> bool {
        if self.word.swap(WAIT, Ordering::Acquire) != WAIT {
            return true;
        }
        let span =
            Timespec { tv_sec: (span_ns / 1_000_000_000) as i64, tv_nsec: (span_ns % 1_000_000_000) as i64 };
        let _ = futex::wait(&self.word, futex::Flags::PRIVATE, WAIT, Some(&span)); // whyever it ends: look
        self.word.swap(WAIT, Ordering::Acquire) != WAIT
    }
}
