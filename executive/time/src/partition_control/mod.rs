//! A partition as the dispatcher sees it: a control page, a freezing file and a state. Made before frame 0, never moved;
//! the process behind it comes and goes.
//!
//! - `grant`: what a partition is told with a window, and what it made of it;
//! - `process`: the process behind the page, and what it finds there;
//! - `window`: a window is granted, used, waited for;
//! - `hold`: which core has the partition, and when nothing of it runs;
//! - `change`: what a change of schedule leaves to be done.

use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Release};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64};

use bateleur_contract::page::NOT_COUNTED;
use bateleur_contract::{ControlPage, Mapped};

use crate::line_counts::LineCounts;
use crate::time_guard::TimeGuard;
use crate::window_owner::WindowOwner;
pub use grant::{Use, grant_of};

mod change;
mod grant;
mod hold;
mod process;
mod window;

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

/// See the module's head.
#[derive(Debug)]
pub struct PartitionControl {
    /// Shared with the partition; nothing read from its lower half is trusted.
    pub page: Mapped<ControlPage>,
    guard: TimeGuard,
    owner: WindowOwner,
    /// The partition is held between windows even when it closed its window in time: it has several threads, or no
    /// real-time priority keeps what it left running out of the others' windows.
    always_freeze: AtomicBool,
    granted: AtomicU32,
    granted_ns: AtomicU64,
    /// Module time of the last grant, ns.
    window_start_ns: AtomicU64,
    readiness: AtomicU32,
    not_before_ns: AtomicU64,
    /// The process has started from nothing and had no window yet.
    fresh: AtomicBool,
    /// The epoch of the partition's last window, whichever of its partition controls that was on.
    epoch: Arc<AtomicU32>,
    /// What a change of schedule means for the partition and is not done yet: the place in [`OWED`] plus one, and the
    /// schedule; 0: nothing. Shared as the epoch is.
    owed: Arc<AtomicU32>,
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

impl PartitionControl {
    /// A partition control without a process.
    #[must_use]
    pub fn new(page: Mapped<ControlPage>, guard: TimeGuard, always_freeze: bool) -> Self {
        page.initialise();
        Self {
            page,
            guard,
            owner: WindowOwner::new(),
            always_freeze: AtomicBool::new(always_freeze),
            granted: AtomicU32::new(0),
            granted_ns: AtomicU64::new(0),
            window_start_ns: AtomicU64::new(0),
            readiness: AtomicU32::new(Readiness::Absent as u32),
            not_before_ns: AtomicU64::new(0),
            fresh: AtomicBool::new(false),
            epoch: Arc::default(),
            owed: Arc::default(),
            schedule_requests: AtomicU32::new(0),
            clock: AtomicU32::new(0),
            origin_ns: AtomicU64::new(0),
            device_expected: AtomicU64::new(NOT_COUNTED),
            line: LineCounts::default(),
        }
    }

    /// The partition control of another process of the same partition as `first`.
    #[must_use]
    pub fn beside(self, first: &Self) -> Self {
        Self { epoch: first.epoch.clone(), owed: first.owed.clone(), ..self }
    }

    /// What holds the partition outside of its windows.
    pub(crate) fn guard(&self) -> &TimeGuard {
        &self.guard
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
}

#[cfg(test)]
pub(crate) mod fixture {
    //! A partition control without a dispatcher, and a window without a timeline, for the tests of each part.

    use std::sync::atomic::AtomicBool;
    use std::sync::atomic::Ordering::{Relaxed, SeqCst};
    use std::sync::{Arc, Mutex};

    use bateleur_contract::page::WindowGrant;

    use bateleur_plan::{Plan, Timeline};

    use super::*;
    use crate::dispatcher::{Occurrence, ScheduleEpoch};
    use crate::time_guard::ProcessControl;

    /// A plan of one partition with one window.
    pub(crate) fn plan() -> Plan {
        crate::test_support::plan_of(
            "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n",
        )
    }

    /// That window, in an epoch of the schedule.
    pub(crate) fn occurrence(epoch: ScheduleEpoch) -> Occurrence {
        let plan = plan();
        let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
        Occurrence {
            window: timelines[0].cores[0].windows[0],
            core: 0,
            epoch,
            major_frame: 0,
            minor_frames: 0,
            minor_frame_ns: 20_000_000,
            start_ns: epoch.since_ns,
            end_ns: epoch.since_ns + 2_000_000,
            late_ns: 0,
        }
    }

    /// Processes that do what they are told, at once: whether they are frozen, and what they were told.
    #[derive(Debug, Clone, Default)]
    pub(crate) struct Obedient(Arc<(AtomicBool, Mutex<Vec<&'static str>>)>);

    impl Obedient {
        pub(crate) fn is_held(&self) -> bool {
            self.0.0.load(SeqCst)
        }
        pub(crate) fn said(&self) -> Vec<&'static str> {
            std::mem::take(&mut self.0.1.lock().unwrap())
        }
        fn say(&self, what: &'static str) {
            self.0.1.lock().unwrap().push(what);
        }
    }

    impl ProcessControl for Obedient {
        fn freeze(&self) -> std::io::Result<()> {
            self.0.0.store(true, SeqCst);
            self.say("freeze");
            Ok(())
        }
        fn thaw(&self) {
            self.0.0.store(false, SeqCst);
            self.say("thaw");
        }
        fn is_frozen(&self) -> bool {
            self.is_held()
        }
        fn is_stopped(&self, _: i32) -> bool {
            true
        }
        fn stop(&self, _: i32) {}
        fn go_on(&self, _: i32) {}
        fn each_thread(&self, _: &mut dyn FnMut(i32)) {}
        fn promote(&self, _: i32, _: u8) {
            self.say("promote");
        }
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

    pub(crate) fn control() -> PartitionControl {
        controlled(&Obedient::default(), None, false)
    }

    /// `priority`: what its processes are given in windows.
    pub(crate) fn controlled(
        processes: &Obedient,
        priority: Option<u8>,
        always_freeze: bool,
    ) -> PartitionControl {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        let guard = TimeGuard::new(Box::new(processes.clone()), priority);
        PartitionControl::new(Mapped::new(file).unwrap(), guard, always_freeze)
    }

    pub(super) const WINDOW: WindowGrant = WindowGrant {
        start_ns: 0,
        end_ns: 1,
        minor_frames: 0,
        minor_frame_ns: 1,
        major_frame: 0,
        major_frame_ns: 0,
        schedule: 0,
        schedule_since_ns: 0,
        next_schedule: 0,
    };

    pub(super) fn close(control: &PartitionControl, opened_ns: u64, closed_ns: u64) {
        control.page.opened_ns.store(opened_ns, Relaxed);
        control.page.closed_ns.store(closed_ns, Relaxed);
        control.page.done.store(control.page.grant.load(Acquire), Release);
    }
}
