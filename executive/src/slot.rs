//! A partition as the dispatcher sees it: a control page, a freezing file and a state. Made before frame 0, never moved;
//! the process behind it comes and goes.

use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64};

use bateleur_contract::page::NOT_COUNTED;
use bateleur_contract::{ControlPage, Mapped, Takeover};
use rustix::thread::futex;

use crate::dispatcher::Occurrence;
use crate::fence::{Escapes, Fence};
use crate::line_counts::LineCounts;
use crate::plan::ChangeAction;
use crate::system::time::now_ns;

/// Whether a partition takes windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Readiness {
    /// No process, or one that still initialises: its windows pass unused.
    Absent = 0,
    /// Takes windows.
    Ready = 1,
    /// A change of schedule has made it idle: its windows pass, until another change brings it back.
    Idle = 2,
    /// Is held by an operator: its windows pass, and nothing of it runs.
    Held = 3,
    /// Has been stopped, by an operator, by its health table or by itself: its windows pass, whatever the schedule.
    Stopped = 4,
}

/// What the partition made of its window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Use {
    /// When it took the window, CLOCK_MONOTONIC ns; none: not at all.
    pub opened_ns: Option<u64>,
    /// When it closed it; none: it had not when the window ended.
    pub closed_ns: Option<u64>,
}

/// What a partition is told with a window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Grant {
    /// Its start, module time, ns.
    pub start_ns: u64,
    /// Its end, module time, ns; 0: no window, but the last call before frame 0.
    pub end_ns: u64,
    /// Minor frames since module time 0.
    pub minor_frames: u64,
    /// The length of a minor frame, ns.
    pub minor_frame_ns: u64,
    /// Major frames since frame 0.
    pub major_frame: u64,
    /// When its major frame began, module time, ns.
    pub major_frame_ns: u64,
    /// The number of its schedule.
    pub schedule: usize,
    /// When that took effect, module time, ns.
    pub since_ns: u64,
    /// The number of the schedule of the next major frame, as far as is known.
    pub next_schedule: usize,
}

impl Grant {
    /// The grant of a window. `next_schedule`: the schedule of the next major frame, as far as is known.
    #[must_use]
    pub fn of(occurrence: &Occurrence, next_schedule: usize) -> Self {
        Self {
            start_ns: occurrence.start_ns,
            end_ns: occurrence.end_ns,
            minor_frames: occurrence.minor_frames,
            minor_frame_ns: occurrence.minor_frame_ns,
            major_frame: occurrence.major_frame,
            major_frame_ns: occurrence.major_frame_ns(),
            schedule: occurrence.reign.schedule,
            // 0 until the module changes, also where it was reset and frame 0 was later than that.
            since_ns: occurrence.reign.after.map_or(0, |_| occurrence.reign.since_ns),
            next_schedule,
        }
    }
}

/// What a change of schedule can owe a partition.
const OWED: [ChangeAction; 3] = [ChangeAction::ColdRestart, ChangeAction::WarmRestart, ChangeAction::Idle];

/// Owns a slot in place of a core, see [`Slot::alone`].
const MONITOR: u32 = u32::MAX;

/// Woken by every wake.
const ANYBODY: std::num::NonZeroU32 = std::num::NonZeroU32::MAX;

/// See the module's head.
#[derive(Debug)]
pub struct Slot {
    /// Shared with the partition; nothing read from its lower half is trusted.
    pub page: Mapped<ControlPage>,
    fence: Fence,
    /// The core that has a window of the partition open, plus one; 0: none has.
    owner: AtomicU32,
    /// The partition is held between windows even when it closed its window in time: it has several threads, or no
    /// real-time priority keeps what it left running out of the others' windows.
    always_freeze: AtomicBool,
    granted: AtomicU32,
    granted_ns: AtomicU64,
    readiness: AtomicU32,
    tid: AtomicI32,
    /// An operator holds the partition: whatever a dispatcher had begun, its next fence stops it.
    held: AtomicBool,
    not_before_ns: AtomicU64,
    /// The process has started from nothing and had no window yet.
    fresh: AtomicBool,
    /// The reign of the partition's last window, whichever of its slots that was on.
    reign: Arc<AtomicU32>,
    /// What a change of schedule means for the partition and is not done yet: the place in [`OWED`] plus one, and the
    /// schedule; 0: nothing.
    owed: AtomicU32,
    /// Requests for a schedule that were taken from the page.
    schedule_requests: AtomicU32,
    /// What stands in the executive's half of the page for a whole run: a partition that wrote over it must not do so
    /// for its successors.
    clock: AtomicU32,
    origin_ns: AtomicU64,
    device_expected: AtomicU64,
    /// What is believed of the partition's own counts of its device.
    line: LineCounts,
}

impl Slot {
    /// A slot without a process.
    #[must_use]
    pub fn new(page: Mapped<ControlPage>, fence: Fence, always_freeze: bool) -> Self {
        page.initialise();
        Self {
            page,
            fence,
            owner: AtomicU32::new(0),
            always_freeze: AtomicBool::new(always_freeze),
            granted: AtomicU32::new(0),
            granted_ns: AtomicU64::new(0),
            readiness: AtomicU32::new(Readiness::Absent as u32),
            tid: AtomicI32::new(0),
            held: AtomicBool::new(false),
            not_before_ns: AtomicU64::new(0),
            fresh: AtomicBool::new(false),
            reign: Arc::default(),
            owed: AtomicU32::new(0),
            schedule_requests: AtomicU32::new(0),
            clock: AtomicU32::new(0),
            origin_ns: AtomicU64::new(0),
            device_expected: AtomicU64::new(NOT_COUNTED),
            line: LineCounts::default(),
        }
    }

    /// The slot of another process of the same partition as `first`.
    #[must_use]
    pub fn beside(self, first: &Self) -> Self {
        Self { reign: first.reign.clone(), ..self }
    }

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
        self.tid.store(0, SeqCst);
        self.granted.store(0, Relaxed);
        self.page.grant.store(0, Relaxed);
        self.page.done.store(0, Relaxed);
        self.page.awake();
        self.page.stop.store(0, Relaxed);
        self.page.take_over.store(0, Relaxed);
        self.page.mode.store(0, Relaxed);
        self.page.handling.store(0, Relaxed);
        self.held.store(false, Relaxed);
        self.fence.reset();
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
        self.fence.set_threads(main, others);
        self.fence.admit();
        self.tid.store(pid, Release);
        if self.always_freeze.load(Relaxed) {
            self.stop_running();
        }
    }

    /// A process that has initialised stands by: nothing of it runs until [`Slot::call`].
    pub fn stand_by(&self, pid: i32, main: &[i32], others: &[i32]) {
        self.fence.set_threads(main, others);
        self.tid.store(pid, Release);
        self.stop_running();
    }

    /// Calls the process that stands by, as ordinary work and without a window: it takes over from that of `before`, whose
    /// counts it carries on. Done when [`Slot::is_done`] says so.
    pub fn call(&self, order: Takeover, before: &Self, grant: &Grant, now_ns: u64) {
        let (own, old) = (&self.page, &before.page);
        before.look_at_line();
        self.line.follow(&before.line);
        self.line.tell(own);
        own.port_refusals.store(old.port_refusals.load(Relaxed), Relaxed);
        self.fresh.store(order == Takeover::Cold, Relaxed);
        own.take_over.store(order as u32, Relaxed);
        self.fence.let_run(self.tid.load(Relaxed));
        self.hand_out(grant, now_ns);
    }

    /// The process is gone; its number may be given to another one.
    pub fn lose_process(&self) {
        self.tid.store(0, Release);
        self.fence.forget();
    }

    /// The partition's threads as they are now: those of its first process, and all others.
    pub fn set_threads(&self, main: &[i32], others: &[i32]) {
        if self.tid.load(Acquire) != 0 {
            self.fence.set_threads(main, others);
        }
    }

    /// What the fence did not hold since the last question, and its work that need not be done in a window's switch.
    pub fn look_after_fence(&self) -> Escapes {
        if self.fence.awaits_relief() {
            self.alone(|| self.fence.relieve());
        }
        if self.held.load(SeqCst) && !self.fence.holds() {
            self.stop_held(); // its dispatcher was just closing a window when it was to be held
        }
        self.fence.take_escapes()
    }

    /// Whether the window of `core` may be opened: no other core has one of this partition open, and none can open one
    /// until [`Slot::disown`].
    pub fn try_own(&self, core: u32) -> bool {
        let own = core + 1;
        match self.owner.compare_exchange(0, own, SeqCst, SeqCst) {
            Ok(_) => true,
            Err(other) => other == own,
        }
    }

    /// The window of `core` is closed and fenced; nothing where another core owns the partition.
    pub fn disown(&self, core: u32) {
        let _ = self.owner.compare_exchange(core + 1, 0, SeqCst, SeqCst);
    }

    /// Moves the partition's threads to a processor, if they are on another one.
    pub fn place(&self, core: u32) {
        self.fence.place(core);
    }

    /// From now on the partition is held between its windows; false: it was already.
    pub fn always_freeze(&self) -> bool {
        !self.always_freeze.swap(true, Relaxed)
    }

    /// Whether the partition takes windows.
    pub fn readiness(&self) -> Readiness {
        match self.readiness.load(Acquire) {
            1 => Readiness::Ready,
            2 => Readiness::Idle,
            3 => Readiness::Held,
            4 => Readiness::Stopped,
            _ => Readiness::Absent,
        }
    }

    /// Says whether the partition takes windows.
    pub fn set_readiness(&self, readiness: Readiness) {
        self.readiness.store(readiness as u32, Release);
    }

    /// Holds the partition until [`Slot::release`]: no window is granted, nothing of it runs.
    pub fn hold(&self) {
        // In this order: a dispatcher that is just opening a window fences it at its end whatever became of it, and then
        // sees that the partition is held.
        self.set_readiness(Readiness::Held);
        self.held.store(true, SeqCst);
        self.stop_held();
    }

    /// Stops what is to be held, unless a dispatcher has it: that one stops it at the window's end. Two that work on one
    /// fence could leave it open and taken for shut.
    fn stop_held(&self) {
        self.alone(|| {
            if self.held.load(SeqCst) {
                self.stop_running();
            }
        });
    }

    /// Does `what` unless a dispatcher owns the partition. Only for what is rare: a window that opens meanwhile is lost.
    fn alone(&self, what: impl FnOnce()) {
        if self.owner.compare_exchange(0, MONITOR, SeqCst, SeqCst).is_ok() {
            what();
            self.owner.store(0, SeqCst);
        }
    }

    /// Ends [`Slot::hold`]: with its next window it goes on. Nothing of it runs before: this instant is somebody else's.
    pub fn release(&self) {
        self.held.store(false, SeqCst);
        self.set_readiness(Readiness::Ready);
    }

    /// Whether this is the partition's first window in the reign of that number.
    pub fn enters_reign(&self, number: u32) -> bool {
        // A dispatcher that comes late, from before another one's change, turns nothing back.
        self.reign.load(Relaxed) < number && self.reign.fetch_max(number, Relaxed) < number
    }

    /// Whether the process has started from nothing and had no window yet.
    pub fn is_fresh(&self) -> bool {
        self.fresh.load(Relaxed)
    }

    /// Keeps the partition's windows back until the monitor has done what a change of schedule means for it; false: it
    /// is not there to have anything done. `revive`: also one that a change has made idle.
    pub fn withhold(&self, revive: bool) -> bool {
        let from = |readiness: Readiness| {
            let (from, to) = (readiness as u32, Readiness::Absent as u32);
            self.readiness.compare_exchange(from, to, SeqCst, Relaxed).is_ok()
        };
        from(Readiness::Ready) || (revive && from(Readiness::Idle))
    }

    /// Leaves to the monitor what a change to `schedule` means for the partition: not in the window's record alone, for
    /// which there may be no room.
    pub fn owe(&self, action: ChangeAction, schedule: usize) {
        let place = OWED.iter().position(|owed| *owed == action).map_or(0, |place| place + 1);
        self.owed.store((schedule as u32) << 2 | place as u32, Release);
    }

    /// Takes what is owed.
    pub fn take_owed(&self) -> Option<(ChangeAction, usize)> {
        if self.owed.load(Relaxed) == 0 {
            return None;
        }
        let owed = self.owed.swap(0, Acquire);
        let place = (owed & 3).checked_sub(1)? as usize;
        Some((OWED[place], (owed >> 2) as usize))
    }

    /// The schedule that the partition has asked for since the last look, whether it may or not.
    pub fn take_schedule_request(&self) -> Option<u32> {
        let (number, schedule) = self.page.schedule_requested();
        let seen = self.schedule_requests.load(Relaxed);
        (number != seen).then(|| {
            self.schedule_requests.store(number, Relaxed);
            schedule
        })
    }

    /// Windows that start before this instant of module time pass unused (the virtual clock's restart).
    pub fn set_not_before_ns(&self, instant_ns: u64) {
        self.not_before_ns.store(instant_ns, Relaxed);
    }

    /// See [`Slot::set_not_before_ns`].
    pub fn not_before_ns(&self) -> u64 {
        self.not_before_ns.load(Relaxed)
    }

    /// Lets the partition's threads run again, where they were held. On a shared core nothing of it runs before the
    /// dispatcher sleeps, so this may happen ahead of the window.
    pub fn thaw(&self) {
        if self.held.load(SeqCst) {
            return;
        }
        self.fence.let_go(self.tid.load(Relaxed));
    }

    /// Grants a window.
    pub fn grant(&self, grant: &Grant, now_ns: u64) {
        self.thaw();
        self.hand_out(grant, now_ns);
    }

    fn hand_out(&self, grant: &Grant, now_ns: u64) {
        self.page.now_ns.store(grant.start_ns, Relaxed);
        self.page.window_start_ns.store(grant.start_ns, Relaxed);
        self.page.window_end_ns.store(grant.end_ns, Relaxed);
        self.page.minor_frames.store(grant.minor_frames, Relaxed);
        self.page.minor_frame_ns.store(grant.minor_frame_ns, Relaxed);
        self.page.major_frame.store(grant.major_frame, Relaxed);
        self.page.major_frame_ns.store(grant.major_frame_ns, Relaxed);
        self.page.schedule.store(grant.schedule as u32, Relaxed);
        self.page.next_schedule.store(grant.next_schedule as u32, Relaxed);
        self.page.schedule_since_ns.store(grant.since_ns, Relaxed);
        if grant.end_ns != 0 && self.fresh.load(Relaxed) {
            self.fresh.store(false, Relaxed);
        }
        self.granted_ns.store(now_ns, Relaxed);
        let number = self.granted.load(Relaxed).wrapping_add(1);
        self.granted.store(number, Relaxed);
        self.page.grant.store(number, Release);
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

    /// Ends the window: holds what may still run, and takes the priority of what says that it is done. `overrun`: the
    /// partition was not. True: a look whether it took is due, see [`Slot::look`].
    pub fn fence(&self, overrun: bool) -> bool {
        if overrun || self.always_freeze.load(Relaxed) || self.held.load(SeqCst) {
            return self.stop_running();
        }
        self.fence.give_way(self.tid.load(Relaxed));
        false
    }

    /// Looks once whether the last fence took.
    pub fn look(&self) {
        self.fence.look();
    }

    fn stop_running(&self) -> bool {
        let tid = self.tid.load(Relaxed);
        if tid == 0 {
            return false;
        }
        let look = self.fence.hold(tid);
        // The process was replaced meanwhile: its successor must not be born frozen, for nobody would thaw it.
        if self.tid.load(SeqCst) != tid {
            self.fence.let_run(self.tid.load(SeqCst));
            return false;
        }
        look
    }

    /// Sleeps until the partition's `done` differs from what it was, at most `nanoseconds`.
    pub fn await_change(&self, nanoseconds: u64) {
        let limit = rustix::time::Timespec { tv_sec: 0, tv_nsec: nanoseconds.min(999_999_999) as i64 };
        self.sleep_on_done(|seen| {
            let _ = futex::wait(&self.page.done, futex::Flags::empty(), seen, Some(&limit)); // any end: the caller looks
        });
    }

    /// Sleeps until the partition closes its window, or until `until_ns` of CLOCK_MONOTONIC. May return before either: the
    /// word belongs to the partition.
    pub fn await_close(&self, until_ns: u64) {
        let until = rustix::time::Timespec {
            tv_sec: (until_ns / 1_000_000_000) as i64,
            tv_nsec: (until_ns % 1_000_000_000) as i64,
        };
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

    /// Asks the partition to end instead of taking another window.
    pub fn ask_to_stop(&self) {
        self.held.store(false, SeqCst);
        self.thaw();
        self.page.stop.store(1, Release);
        self.page.grant.store(self.granted.load(Relaxed).wrapping_add(1), Release);
        let _ = futex::wake(&self.page.grant, futex::Flags::empty(), 1); // not asleep: it looks before it sleeps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fence::Grip;

    /// Processes that do what they are told, at once.
    #[derive(Debug)]
    struct Obedient;

    impl Grip for Obedient {
        fn freeze(&self) -> std::io::Result<()> {
            Ok(())
        }
        fn thaw(&self) {}
        fn is_frozen(&self) -> bool {
            true
        }
        fn stop(&self, _: i32) {}
        fn go_on(&self, _: i32) {}
        fn each_thread(&self, _: &mut dyn FnMut(i32)) {}
        fn promote(&self, _: i32, _: u8) {}
        fn demote(&self, _: i32) -> bool {
            false
        }
        fn place(&self, _: i32, _: u32) {}
        fn used_ns(&self, _: i32) -> Option<u64> {
            None
        }
        fn now_ns(&self) -> u64 {
            0
        }
    }

    fn slot() -> Slot {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        let fence = Fence::new(Box::new(Obedient), None);
        Slot::new(Mapped::new(file).unwrap(), fence, false)
    }

    const WINDOW: Grant = Grant {
        start_ns: 0,
        end_ns: 1,
        minor_frames: 0,
        minor_frame_ns: 1,
        major_frame: 0,
        major_frame_ns: 0,
        schedule: 0,
        since_ns: 0,
        next_schedule: 0,
    };

    #[test]
    fn module_that_was_reset_has_not_changed_its_schedule_yet() {
        let text = "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";
        let plan = crate::test_support::plan_of(text);
        let timelines = crate::plan::Timeline::all(&plan, plan.module("m").unwrap().id());
        let reign =
            |after| crate::dispatcher::Reign { number: 0, schedule: 0, after, since_ns: 5_000_000_000 };
        let occurrence = |after| Occurrence {
            window: timelines[0].cores[0].windows[0],
            core: 0,
            reign: reign(after),
            major_frame: 0,
            minor_frames: 0,
            minor_frame_ns: 20_000_000,
            start_ns: 5_000_000_000,
            end_ns: 5_002_000_000,
            late_ns: 0,
        };
        assert_eq!(Grant::of(&occurrence(None), 0).since_ns, 0, "frame 0 is no change of schedule");
        assert_eq!(Grant::of(&occurrence(Some(1)), 0).since_ns, 5_000_000_000);
    }

    #[test]
    fn counts_of_a_device_that_were_written_over_are_those_that_were_believed_for_the_successor() {
        let slot = slot();
        slot.expect_of_device(300);
        slot.page.device_sent.store(1_000, Relaxed);
        slot.page.device_received.store(300, Relaxed);
        slot.look_at_line();
        for wild in [0, 299, 5_000_000, u64::MAX] {
            slot.page.device_sent.store(wild, Relaxed);
            slot.page.device_received.store(wild, Relaxed);
            slot.look_at_line();
            assert_eq!(slot.line_counts(), [1_000, 300, 300], "{wild} is not believed");
            slot.take_in(true);
            let (sent, received) = (&slot.page.device_sent, &slot.page.device_received);
            assert_eq!((sent.load(Relaxed), received.load(Relaxed)), (1_000, 300), "{wild}");
        }
    }

    #[test]
    fn change_of_schedule_revives_what_a_change_made_idle_and_nothing_that_was_stopped() {
        let slot = slot();
        slot.set_readiness(Readiness::Stopped);
        assert!(!slot.withhold(true));
        assert_eq!(slot.readiness(), Readiness::Stopped);
        slot.set_readiness(Readiness::Idle);
        assert!(!slot.withhold(false) && slot.withhold(true));
        assert_eq!(slot.readiness(), Readiness::Absent);
    }

    fn close(slot: &Slot, opened_ns: u64, closed_ns: u64) {
        slot.page.opened_ns.store(opened_ns, Relaxed);
        slot.page.closed_ns.store(closed_ns, Relaxed);
        slot.page.done.store(slot.page.grant.load(Acquire), Release);
    }

    #[test]
    fn a_window_is_done_when_this_very_grant_was_used_up() {
        let slot = slot();
        slot.grant(&WINDOW, now_ns());
        assert!(!slot.is_done());
        close(&slot, now_ns(), now_ns());
        assert!(slot.is_done() && slot.usage().closed_ns.is_some());
        slot.grant(&WINDOW, now_ns());
        assert!(!slot.is_done());
    }

    #[test]
    fn a_partition_that_writes_over_its_grant_does_not_close_its_window() {
        let slot = slot();
        slot.grant(&WINDOW, now_ns());
        slot.page.grant.store(77, Release);
        slot.page.done.store(77, Release);
        assert!(!slot.is_done());
    }

    #[test]
    fn stamps_before_the_grant_or_in_the_future_are_not_believed() {
        let slot = slot();
        let granted_ns = now_ns();
        slot.grant(&WINDOW, granted_ns);
        close(&slot, granted_ns - 1, now_ns() + 1_000_000_000_000);
        assert_eq!(slot.usage(), Use { opened_ns: None, closed_ns: None });
    }

    #[test]
    fn a_page_that_was_written_over_is_whole_again_for_the_successor() {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        let slot = Slot::new(Mapped::new(&file).unwrap(), Fence::new(Box::new(Obedient), None), false);
        slot.set_clock(1);
        slot.set_origin_ns(1234);
        slot.expect_of_device(77);
        // As a partition may do.
        std::os::unix::fs::FileExt::write_all_at(&std::fs::File::from(file), &[0xff; 4096], 0).unwrap();
        assert!(!slot.page.is_valid());
        slot.take_in(true);
        assert!(slot.page.is_valid());
        assert_eq!(slot.page.origin_ns.load(Relaxed), 1234);
        assert_eq!(slot.page.clock.load(Relaxed), 1);
        assert_eq!(slot.page.device_expected.load(Relaxed), 77);
        assert_eq!((slot.page.stop.load(Relaxed), slot.page.grant.load(Relaxed)), (0, 0));
    }

    #[test]
    fn a_successor_is_not_taken_for_one_that_owes_a_window() {
        let slot = slot();
        slot.grant(&WINDOW, now_ns());
        slot.take_in(true);
        assert!(slot.is_done());
        slot.fence(true); // no process: nobody is stopped, not even the caller
    }

    #[test]
    fn a_held_partition_is_not_thawed_by_a_dispatcher_that_had_begun_to_open_its_window() {
        let slot = slot();
        slot.admit(1, &[1], &[]);
        slot.set_readiness(Readiness::Ready);
        slot.hold();
        slot.thaw();
        assert_eq!((slot.readiness(), slot.fence.holds()), (Readiness::Held, true));
        slot.release();
        assert_eq!((slot.readiness(), slot.fence.holds()), (Readiness::Ready, true), "until its window");
        slot.grant(&WINDOW, now_ns());
        assert!(!slot.fence.holds());
    }

    #[test]
    fn a_partition_that_is_to_be_held_in_its_window_is_stopped_by_its_dispatcher_at_the_end() {
        let slot = slot();
        slot.admit(1, &[1], &[]);
        slot.set_readiness(Readiness::Ready);
        assert!(slot.try_own(3));
        slot.grant(&WINDOW, now_ns());
        slot.hold();
        assert!(!slot.fence.holds(), "the fence is the dispatcher's now");
        close(&slot, now_ns(), now_ns());
        slot.fence(false);
        slot.disown(3);
        assert!(slot.fence.holds());
    }

    #[test]
    fn a_partition_whose_dispatcher_had_just_closed_its_window_is_held_at_the_next_look() {
        let slot = slot();
        slot.admit(1, &[1], &[]);
        assert!(slot.try_own(3));
        slot.fence(false);
        slot.hold();
        slot.disown(3);
        assert!(!slot.fence.holds());
        slot.look_after_fence();
        assert!(slot.fence.holds() && slot.try_own(3), "and nobody owns it for that");
    }

    #[test]
    fn what_a_change_of_schedule_owes_is_taken_once_and_whole() {
        let slot = slot();
        assert_eq!(slot.take_owed(), None);
        for action in OWED {
            slot.owe(action, 65_535);
            assert_eq!((slot.take_owed(), slot.take_owed()), (Some((action, 65_535)), None));
        }
    }

    #[test]
    fn a_dispatcher_from_before_a_change_turns_it_not_back() {
        let slot = slot();
        assert!(slot.enters_reign(2));
        assert!(!slot.enters_reign(1) && !slot.enters_reign(2) && slot.enters_reign(3));
    }

    #[test]
    fn a_successor_is_not_held_while_it_initialises() {
        let slot = slot();
        slot.admit(1, &[1], &[]);
        slot.hold();
        slot.take_in(true);
        assert!(!slot.fence.holds());
    }

    #[test]
    fn what_is_always_held_is_held_from_its_admission_until_its_first_window() {
        let slot = slot();
        slot.always_freeze();
        slot.admit(1, &[1, 2], &[]);
        assert!(slot.fence.holds());
        slot.grant(&WINDOW, now_ns());
        assert!(!slot.fence.holds());
        close(&slot, now_ns(), now_ns());
        assert!(slot.fence(false) && slot.fence.holds());
    }

    /// What a dispatcher does for one window.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum Move {
        Prepare,
        Open,
        Close,
    }

    /// A dispatcher's half of the handover, as the gate on the wall clock has it.
    struct Core {
        number: u32,
        owns: bool,
        granted: bool,
    }

    impl Core {
        fn perform(&mut self, what: Move, slot: &Slot) {
            match what {
                Move::Prepare => {
                    self.owns = slot.try_own(self.number);
                    if self.owns {
                        slot.thaw();
                    }
                }
                Move::Open => {
                    self.owns = slot.try_own(self.number);
                    if self.owns {
                        slot.grant(&WINDOW, now_ns());
                        self.granted = true;
                    }
                }
                Move::Close => {
                    if self.owns {
                        slot.fence(!slot.is_done());
                        slot.disown(self.number);
                    }
                    (self.owns, self.granted) = (false, false);
                }
            }
        }
    }

    /// Every order in which two sequences can be done, each in its own order.
    fn interleavings(left: &[Move], right: &[Move]) -> Vec<Vec<(usize, Move)>> {
        let mut all = Vec::new();
        for (core, (first, others)) in [(0, (left, right)), (1, (right, left))] {
            let Some((head, tail)) = first.split_first() else { continue };
            let rest = if core == 0 { interleavings(tail, others) } else { interleavings(others, tail) };
            all.extend(rest.into_iter().map(|rest| {
                let mut order = vec![(core, *head)];
                order.extend(rest);
                order
            }));
        }
        if all.is_empty() { vec![Vec::new()] } else { all }
    }

    #[test]
    fn however_late_two_cores_come_only_one_has_the_partition_and_no_close_touches_the_others_window() {
        let two = [Move::Prepare, Move::Open, Move::Close, Move::Open, Move::Close];
        let orders = interleavings(&two, &two);
        assert_eq!(orders.len(), 252);
        let mut lost = 0;
        for order in orders {
            let slot = slot();
            slot.admit(1, &[1, 2], &[]);
            slot.always_freeze();
            slot.set_readiness(Readiness::Ready);
            let mut cores = [0, 1].map(|number| Core { number, owns: false, granted: false });
            for (core, what) in &order {
                cores[*core].perform(*what, &slot);
                assert!(cores.iter().filter(|core| core.granted).count() <= 1, "{order:?}");
                let open = cores.iter().any(|core| core.granted);
                assert!(
                    !open || !slot.fence.holds(),
                    "the other core's close held an open window: {order:?}"
                );
                lost += usize::from(*what == Move::Open && !cores[*core].granted);
                let idle = cores.iter().all(|core| !core.owns);
                let used = slot.granted.load(Relaxed) > 0;
                assert!(!(idle && used) || slot.fence.holds(), "left running between windows: {order:?}");
            }
            assert!(slot.try_own(7), "nobody owns it for ever: {order:?}");
        }
        assert!(lost > 0, "there are orders in which the other core still has it");
    }

    #[test]
    fn two_threads_never_own_a_partition_at_once() {
        let slot = std::sync::Arc::new(slot());
        let inside = std::sync::Arc::new(AtomicU32::new(0));
        let threads = [0, 1].map(|core| {
            let (slot, inside) = (slot.clone(), inside.clone());
            std::thread::spawn(move || {
                let mut owned = 0;
                // So often, however long that takes: the other one may lose its processor while it owns the slot.
                while owned < 10_000 {
                    if slot.try_own(core) {
                        assert_eq!(inside.fetch_add(1, SeqCst), 0);
                        owned += 1;
                        inside.fetch_sub(1, SeqCst);
                        slot.disown(core);
                    } else {
                        std::thread::yield_now();
                    }
                    slot.disown(1 - core + 2); // of a core that does not own it: nothing
                }
            })
        });
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    }

    #[test]
    fn a_count_of_grants_that_wraps_around_goes_on() {
        let slot = slot();
        slot.granted.store(u32::MAX, Relaxed);
        slot.grant(&WINDOW, now_ns());
        assert_eq!(slot.page.grant.load(Acquire), 0);
        close(&slot, now_ns(), now_ns());
        assert!(slot.is_done());
    }
}
