//! What is believed of the bytes that a partition says have passed its device.
//!
//! The companion of the virtual clock waits for them, and a successor goes on counting there. The words are the
//! partition's: one that has written over them must not hold up a run. So the executive remembers the last counts that
//! could be true, and puts them back.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::ControlPage;
use bateleur_contract::page::NOT_COUNTED;

/// Bytes that can have passed a device between two looks, most. They are a minor frame apart: no line is as fast.
const MOST: u64 = 1 << 20;

/// See the module's head.
#[derive(Debug, Default)]
pub struct LineCounts {
    sent: AtomicU64,
    received: AtomicU64,
}

impl LineCounts {
    /// Counts that are known.
    #[must_use]
    pub fn of(sent: u64, received: u64) -> Self {
        Self { sent: AtomicU64::new(sent), received: AtomicU64::new(received) }
    }

    /// Takes notice of what the page says. `expected`: bytes that the world has sent so far, or [`NOT_COUNTED`].
    pub fn look(&self, page: &ControlPage, expected: u64) {
        let sent = self.sent();
        self.sent.store(believed(sent, page.device_sent.load(Relaxed), MOST), Relaxed);
        let received = self.received();
        let most = if expected == NOT_COUNTED { MOST } else { expected.saturating_sub(received) };
        self.received.store(believed(received, page.device_received.load(Relaxed), most), Relaxed);
    }

    /// Goes on with the counts of another process of the partition.
    pub fn follow(&self, before: &Self) {
        self.sent.store(before.sent(), Relaxed);
        self.received.store(before.received(), Relaxed);
    }

    /// Writes what is believed into the page of a process that is about to begin.
    pub fn tell(&self, page: &ControlPage) {
        page.device_sent.store(self.sent(), Relaxed);
        page.device_received.store(self.received(), Relaxed);
    }

    /// Bytes written to the device so far.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent.load(Relaxed)
    }

    /// Bytes read from the device so far.
    #[must_use]
    pub fn received(&self) -> u64 {
        self.received.load(Relaxed)
    }
}

/// `told`, where it is at most `most` more than what was believed `before`.
fn believed(before: u64, told: u64, most: u64) -> u64 {
    if told.checked_sub(before).is_some_and(|more| more <= most) { told } else { before }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn count_that_goes_back_or_leaps_is_not_believed() {
        assert_eq!(believed(100, 100, 50), 100);
        assert_eq!(believed(100, 150, 50), 150);
        assert_eq!(believed(100, 151, 50), 100);
        assert_eq!(believed(100, 99, 50), 100);
        assert_eq!(believed(100, u64::MAX, 50), 100);
        assert_eq!(believed(u64::MAX, 0, u64::MAX), u64::MAX);
    }
}
