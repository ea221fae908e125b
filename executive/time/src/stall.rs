//! An ordered fault of the dispatcher: it does nothing for a while.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_system::time::{now_ns, sleep_until_ns};

/// Time for which the next dispatcher that opens a window does nothing. Shared with the dispatchers: one word, so that
/// looking at it costs nothing.
#[derive(Debug, Default)]
pub struct Stall(AtomicU64);

impl Stall {
    /// Orders one.
    pub fn order(&self, stall_ns: u64) {
        self.0.store(stall_ns, Relaxed);
    }

    /// Does nothing for as long as was ordered, once.
    pub fn apply(&self) {
        if self.0.load(Relaxed) == 0 {
            return;
        }
        let stall_ns = self.0.swap(0, Relaxed);
        sleep_until_ns(now_ns() + stall_ns);
    }
}
