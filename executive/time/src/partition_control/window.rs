//! A window is granted, used and waited for.
//!
//! The partition writes its half of the page as it likes: its word that it is done counts for the very grant that it was given
//! last, and its stamps inside that window alone.

use bateleur_contract::page::WindowGrant;
use std::sync::atomic::Ordering::{Acquire, Relaxed};

use rustix::thread::futex;

use super::{PartitionControl, Use};
use bateleur_system::time::{now_ns, timespec};

/// Woken by every wake.
const ANYBODY: std::num::NonZeroU32 = std::num::NonZeroU32::MAX;

impl PartitionControl {
    /// Windows that start before this instant of module time pass unused (the virtual clock's restart).
    pub fn set_not_before_ns(&self, instant_ns: u64) {
        self.not_before_ns.store(instant_ns, Relaxed);
    }

    /// See [`PartitionControl::set_not_before_ns`].
    pub fn not_before_ns(&self) -> u64 {
        self.not_before_ns.load(Relaxed)
    }

    /// Grants a window.
    pub fn grant(&self, grant: &WindowGrant, now_ns: u64) {
        self.thaw();
        self.hand_out(grant, now_ns);
    }

    pub(super) fn hand_out(&self, grant: &WindowGrant, now_ns: u64) {
        self.page.now_ns.store(grant.start_ns, Relaxed);
        self.window_start_ns.store(grant.start_ns, Relaxed);
        if grant.end_ns != 0 && self.fresh.load(Relaxed) {
            self.fresh.store(false, Relaxed);
        }
        self.granted_ns.store(now_ns, Relaxed);
        let number = self.granted.load(Relaxed).wrapping_add(1);
        self.granted.store(number, Relaxed);
        self.page.publish_grant(number, grant);
        let _ = futex::wake(&self.page.grant, futex::Flags::empty(), 1); // nobody asleep: it is still busy
    }

    /// Whether the partition has closed the window that it was granted last.
    pub fn is_done(&self) -> bool {
        self.page.done.load(Acquire) == self.granted.load(Relaxed)
    }

    /// What the partition made of its last window. Its own stamps are believed only inside the window.
    pub fn usage(&self) -> Use {
        let granted_ns = self.granted_ns.load(Relaxed);
        let done = self.is_done();
        let now = now_ns();
        let inside = |stamp: u64| (granted_ns..=now).contains(&stamp).then_some(stamp);
        Use {
            opened_ns: inside(self.page.opened_ns.load(Relaxed)),
            closed_ns: if done { inside(self.page.closed_ns.load(Relaxed)) } else { None },
        }
    }

    /// Sleeps until the partition's `done` differs from what it was, at most `nanoseconds`.
    pub fn await_change(&self, nanoseconds: u64) {
        let limit = timespec(nanoseconds);
        self.sleep_on_done(|seen| {
            let _ = futex::wait(&self.page.done, futex::Flags::empty(), seen, Some(&limit)); // any end: the caller looks
        });
    }

    /// Sleeps until the partition closes its window, or until `until_ns` of CLOCK_MONOTONIC. May return before either: the
    /// word belongs to the partition.
    pub fn await_close(&self, until_ns: u64) {
        let until = timespec(until_ns);
        self.sleep_on_done(|seen| {
            // The only futex call whose limit is an instant.
            let _ = futex::wait_bitset(&self.page.done, futex::Flags::empty(), seen, Some(&until), ANYBODY);
        });
    }

    fn sleep_on_done(&self, sleep: impl FnOnce(u32)) {
        if self.is_done() {
            return;
        }
        let seen = self.page.await_close();
        if seen != self.granted.load(Relaxed) {
            sleep(seen);
        }
        self.page.awake();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering::Release;

    use super::super::fixture::{WINDOW, close, control};
    use super::*;

    #[test]
    fn a_window_is_done_when_this_very_grant_was_used_up() {
        let control = control();
        control.grant(&WINDOW, now_ns());
        assert!(!control.is_done());
        close(&control, now_ns(), now_ns());
        assert!(control.is_done() && control.usage().closed_ns.is_some());
        control.grant(&WINDOW, now_ns());
        assert!(!control.is_done());
    }

    #[test]
    fn a_partition_that_writes_over_its_grant_does_not_close_its_window() {
        let control = control();
        control.grant(&WINDOW, now_ns());
        control.page.grant.store(77, Release);
        control.page.done.store(77, Release);
        assert!(!control.is_done());
    }

    #[test]
    fn stamps_before_the_grant_or_in_the_future_are_not_believed() {
        let control = control();
        let granted_ns = now_ns();
        control.grant(&WINDOW, granted_ns);
        close(&control, granted_ns - 1, now_ns() + 1_000_000_000_000);
        assert_eq!(control.usage(), Use { opened_ns: None, closed_ns: None });
    }

    #[test]
    fn a_count_of_grants_that_wraps_around_goes_on() {
        let control = control();
        control.granted.store(u32::MAX, Relaxed);
        control.grant(&WINDOW, now_ns());
        assert_eq!(control.page.grant.load(Acquire), 0);
        close(&control, now_ns(), now_ns());
        assert!(control.is_done());
    }
}
