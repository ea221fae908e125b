//! Two threads that hand each other the processor by a futex: what any switch between threads of one core is held against.

use std::sync::atomic::{AtomicU32, Ordering};

use rustix::thread::futex;

/// Waits for the turns of `own`, 0 or 1, and hands each on, `rounds` times.
pub(crate) fn take_turns(word: &AtomicU32, own: u32, rounds: u32) {
    (0..rounds).for_each(|round| take_turn(word, 2 * round + own));
}

/// Waits for this turn, and hands it on.
pub(crate) fn take_turn(word: &AtomicU32, turn: u32) {
    loop {
        let now = word.load(Ordering::Acquire);
        if now == turn {
            break;
        }
        let _ = futex::wait(word, futex::Flags::PRIVATE, now, None); // any end: look again
    }
    word.store(turn + 1, Ordering::Release);
    let _ = futex::wake(word, futex::Flags::PRIVATE, 1); // nobody asleep yet: it looks before it sleeps
}
