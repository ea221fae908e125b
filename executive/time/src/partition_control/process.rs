//! The process behind the page: what it finds there, when it may take windows, and when it is gone.
//!
//! A predecessor may have written anything over the page: whatever a successor relies on is put there anew. Nothing of a process
//! may be real-time before it is admitted or called.

use bateleur_contract::page::WindowGrant;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};

use bateleur_contract::{StartCondition, Takeover};
use rustix::thread::futex;

use super::{PartitionControl, Readiness};
use crate::line_counts::LineCounts;

impl PartitionControl {
    /// Empties the page for a process that is about to start: it has seen no grant yet.
    /// `cold`: it finds nothing of its predecessor.
    pub fn take_in(&self, cold: bool) {
        self.look_at_line();
        self.line.tell(&self.page);
        self.page.initialise();
        self.page.clock.store(self.clock.load(Relaxed), Relaxed);
        self.page.origin_ns.store(self.origin_ns.load(Relaxed), Relaxed);
        self.page.device_expected.store(self.device_expected.load(Relaxed), Relaxed);
        self.fresh.store(cold, Relaxed);
        self.page.forget_schedule_request();
        self.schedule_requests.store(0, Relaxed);
        self.page.forget_grants(self.granted.load(Relaxed));
        self.page.awake();
        self.page.stop.store(0, Relaxed);
        self.page.take_over.store(0, Relaxed);
        self.page.begin.store(0, Relaxed);
        self.page.waits.store(0, Relaxed);
        self.page.mode.store(0, Relaxed);
        self.page.handling.store(0, Relaxed);
        self.owner.release();
        self.guard.reset();
    }

    /// Its number; 0: there is none.
    pub fn process(&self) -> i32 {
        self.guard.main()
    }

    /// Says which clock module time follows: 0 the wall clock, 1 the virtual one.
    pub fn set_clock(&self, clock: u32) {
        self.clock.store(clock, Relaxed);
        self.page.clock.store(clock, Relaxed);
    }

    /// Says when module time 0 is, CLOCK_MONOTONIC ns.
    pub fn set_origin_ns(&self, origin_ns: u64) {
        self.origin_ns.store(origin_ns, Relaxed);
        self.page.origin_ns.store(origin_ns, Release);
    }

    /// Says how many bytes the world has sent to the partition's device so far.
    pub fn expect_of_device(&self, bytes: u64) {
        self.device_expected.store(bytes, Relaxed);
        self.page.device_expected.store(bytes, Relaxed);
    }

    /// Goes on with what a partition's device has sent and received, and is to receive, in a module that was reset.
    pub fn carry_on_line(&self, [sent, received, expected]: [u64; 3]) {
        self.line.follow(&LineCounts::of(sent, received));
        self.line.tell(&self.page);
        self.expect_of_device(expected);
    }

    /// Takes notice of how much has passed the partition's device.
    pub fn look_at_line(&self) {
        self.line.look(&self.page, self.device_expected.load(Relaxed));
    }

    /// Bytes that the partition's device has sent and received, as far as that is believed, and is to receive.
    #[must_use]
    pub fn line_counts(&self) -> [u64; 3] {
        [self.line.sent(), self.line.received(), self.device_expected.load(Relaxed)]
    }

    /// The process behind the page, once it may take windows. Until the first of them nothing of it is real-time, and
    /// what is always held between windows is held.
    pub fn admit(&self, pid: i32, main: &[i32], others: &[i32]) {
        self.guard.admit();
        self.guard.set_process(pid, main, others);
        if self.always_freeze.load(Relaxed) {
            self.guard.hold();
        }
    }

    /// A process that has initialised stands by: nothing of it runs until [`PartitionControl::call`].
    pub fn stand_by(&self, pid: i32, main: &[i32], others: &[i32]) {
        self.guard.set_process(pid, main, others);
        self.guard.hold();
    }

    /// Calls the process that stands by, as ordinary work and without a window: it takes over from that of `before`, whose
    /// counts it carries on. Done when [`PartitionControl::is_done`] says so.
    pub fn call(&self, order: Takeover, before: &Self, grant: &WindowGrant, now_ns: u64) {
        let (own, old) = (&self.page, &before.page);
        before.look_at_line();
        self.line.follow(&before.line);
        self.line.tell(own);
        own.port_refusals.store(old.port_refusals.load(Relaxed), Relaxed);
        self.fresh.store(order == Takeover::Cold, Relaxed);
        own.take_over.store(order as u32, Relaxed);
        self.grant_without_window(grant, now_ns);
    }

    /// Hands out a grant that is used up as ordinary work: the process has no window.
    pub fn grant_without_window(&self, grant: &WindowGrant, now_ns: u64) {
        self.guard.let_run();
        self.hand_out(grant, now_ns);
    }

    /// Lets the spare begin, as ordinary work: it follows the process of `before`, whose counts it carries on. It finds what that one was told
    /// last: the time of its last window, and of `told` the schedule.
    pub fn begin(&self, condition: StartCondition, before: &Self, told: &WindowGrant) {
        before.look_at_line();
        self.line.follow(&before.line);
        self.line.tell(&self.page);
        self.page.port_refusals.store(before.page.port_refusals.load(Relaxed), Relaxed);
        self.fresh.store(!condition.is_warm(), Relaxed);
        self.set_not_before_ns(before.not_before_ns());
        self.set_readiness(Readiness::Absent);
        let start_ns = before.window_start_ns.load(Relaxed);
        self.window_start_ns.store(start_ns, Relaxed);
        self.page.now_ns.store(start_ns, Relaxed);
        // No grant: the number is the one that it has used up.
        self.page.publish_grant(self.granted.load(Relaxed), &WindowGrant { start_ns, end_ns: 0, ..*told });
        self.guard.let_run();
        self.page.begin.store(condition.number(), Release);
        let _ = futex::wake(&self.page.begin, futex::Flags::empty(), 1); // it looks before it sleeps
    }

    /// Whether a spare has come as far as it may.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.page.waits.load(Acquire) != 0
    }

    /// The partition's threads as they are now: those of its first process, and all others.
    pub fn set_threads(&self, main: &[i32], others: &[i32]) {
        self.guard.set_threads(main, others);
    }

    /// Asks the partition to end, as ordinary work, instead of taking another window.
    pub fn ask_to_stop(&self) {
        self.owner.release();
        self.guard.let_run();
        self.page.stop.store(1, Release);
        self.page.grant.store(self.granted.load(Relaxed).wrapping_add(1), Release);
        let _ = futex::wake(&self.page.grant, futex::Flags::empty(), 1); // not asleep: it looks before it sleeps
    }

    /// The process is gone; its number may be given to another one.
    pub fn lose_process(&self) {
        self.guard.forget();
    }
}

#[cfg(test)]
mod tests {
    use bateleur_contract::Mapped;

    use super::super::fixture::{Obedient, WINDOW, control};
    use super::*;
    use crate::time_guard::TimeGuard;
    use bateleur_system::time::now_ns;

    #[test]
    fn counts_of_a_device_that_were_written_over_are_those_that_were_believed_for_the_successor() {
        let control = control();
        control.expect_of_device(300);
        control.page.device_sent.store(1_000, Relaxed);
        control.page.device_received.store(300, Relaxed);
        control.look_at_line();
        for wild in [0, 299, 5_000_000, u64::MAX] {
            control.page.device_sent.store(wild, Relaxed);
            control.page.device_received.store(wild, Relaxed);
            control.look_at_line();
            assert_eq!(control.line_counts(), [1_000, 300, 300], "{wild} is not believed");
            control.take_in(true);
            let (sent, received) = (&control.page.device_sent, &control.page.device_received);
            assert_eq!((sent.load(Relaxed), received.load(Relaxed)), (1_000, 300), "{wild}");
        }
    }

    #[test]
    fn a_page_that_was_written_over_is_whole_again_for_the_successor() {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        let control = PartitionControl::new(
            Mapped::new(&file).unwrap(),
            TimeGuard::new(Box::new(Obedient::default()), None),
            false,
        );
        control.set_clock(1);
        control.set_origin_ns(1234);
        control.expect_of_device(77);
        // As a partition may do.
        std::os::unix::fs::FileExt::write_all_at(&std::fs::File::from(file), &[0xff; 4096], 0).unwrap();
        assert!(!control.page.is_valid());
        control.take_in(true);
        assert!(control.page.is_valid());
        assert_eq!(control.page.origin_ns.load(Relaxed), 1234);
        assert_eq!(control.page.clock.load(Relaxed), 1);
        assert_eq!(control.page.device_expected.load(Relaxed), 77);
        assert_eq!((control.page.stop.load(Relaxed), control.page.grant.load(Relaxed)), (0, 0));
    }

    #[test]
    fn a_successor_is_not_taken_for_one_that_owes_a_window() {
        let control = control();
        control.grant(&WINDOW, now_ns());
        control.take_in(true);
        assert!(control.is_done());
        control.end_window(true); // no process: nobody is stopped, not even the caller
    }

    #[test]
    fn a_successor_is_not_held_while_it_initialises() {
        let control = control();
        control.admit(1, &[1], &[]);
        control.hold();
        control.take_in(true);
        assert!(!control.guard.holds());
    }
}
