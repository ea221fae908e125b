//! Threads that hand each other the processor by a futex each: what any switch between threads of one core is held against.

use std::sync::atomic::{AtomicU32, Ordering};

use rustix::thread::futex;

/// A ring of threads, of which one has the turn.
pub(crate) struct Ring(Vec<AtomicU32>);

impl Ring {
    /// The thread that is number 0 has the turn.
    pub(crate) fn new(threads: u32) -> Self {
        Self((0..threads).map(|number| AtomicU32::new(u32::from(number == 0))).collect())
    }

    /// The thread `own` waits for its turn, and hands it on, `rounds` times.
    pub(crate) fn take_turns(&self, own: usize, rounds: u32) {
        (0..rounds).for_each(|_| self.take_turn(own));
    }

    /// Waits for the turn of the thread `own`, and hands it on.
    pub(crate) fn take_turn(&self, own: usize) {
        let (word, next) = (&self.0[own], &self.0[(own + 1) % self.0.len()]);
        while word.swap(0, Ordering::Acquire) == 0 {
            let _ = futex::wait(word, futex::Flags::PRIVATE, 0, None); // any end: look again
        }
        next.store(1, Ordering::Release);
        let _ = futex::wake(next, futex::Flags::PRIVATE, 1); // nobody asleep yet: it looks before it sleeps
    }
}
