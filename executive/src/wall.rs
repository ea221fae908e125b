//! The wall clock: windows at their instants, one dispatcher thread on each partitioned core.

use std::sync::Arc;

use rtrb::Producer;

use crate::change::Changes;
use crate::dispatcher::{Ending, Gate, Meanwhile, Occurrence, Pace};
use crate::health::log::{Missed, WindowRecord};
use crate::plan::TimelineWindow;
use crate::slot::{Grant, Readiness, Slot};
use crate::system::time::{now_ns, sleep_until_ns, spin_until_ns};

/// How early the dispatcher wakes when the processor is free, ns. Longer than nearly every wake-up is late (p99.9 of a
/// quiet machine), so that the window itself starts on time; on a busy core it would be taken from a partition.
const EARLY_NS: u64 = 50_000;

/// Time passes by itself.
#[derive(Debug)]
pub struct WallPace {
    origin_ns: u64,
}

impl WallPace {
    /// Module time 0 is at `origin_ns` of CLOCK_MONOTONIC.
    #[must_use]
    pub fn new(origin_ns: u64) -> Self {
        Self { origin_ns }
    }
}

impl Pace for WallPace {
    fn reach(&mut self, instant_ns: u64, meanwhile: &mut dyn Meanwhile) -> u64 {
        let target_ns = self.origin_ns + instant_ns;
        sleep_until_ns(target_ns - EARLY_NS);
        if meanwhile.has_slack() {
            meanwhile.prepare();
            spin_until_ns(target_ns);
        } else {
            sleep_until_ns(target_ns);
        }
        now_ns().saturating_sub(target_ns)
    }
}

/// Opens and closes windows of real processes. Nothing here blocks, allocates or writes to a file but the freezer's.
pub struct WallGate {
    slots: Vec<Option<Arc<Slot>>>,
    origin_ns: u64,
    records: Producer<WindowRecord>,
    /// Module time at which the open window was granted, or why it was not.
    granted: Result<u64, Missed>,
    lost: Arc<std::sync::atomic::AtomicU64>,
    changes: Arc<Changes>,
}

impl WallGate {
    /// A gate to `slots` (by place in the plan) that leaves its records in a ring and counts those that find no room.
    #[must_use]
    pub fn new(
        slots: Vec<Option<Arc<Slot>>>,
        origin_ns: u64,
        records: Producer<WindowRecord>,
        lost: Arc<std::sync::atomic::AtomicU64>,
        changes: Arc<Changes>,
    ) -> Self {
        Self { slots, origin_ns, records, granted: Err(Missed::NoPartition), lost, changes }
    }

    fn try_open(&self, occurrence: &Occurrence) -> Result<u64, Missed> {
        let slot = self.slots[occurrence.window.partition.index()].as_deref().ok_or(Missed::NoPartition)?;
        if let Some(action) = self.changes.action_due(occurrence, slot) {
            return Err(Missed::Changed(action));
        }
        if slot.readiness() != Readiness::Ready {
            return Err(Missed::NoPartition);
        }
        // The dispatcher was held up for longer than the window lasts: the window is lost and says so.
        if occurrence.late_ns >= occurrence.window.duration_ns() {
            return Err(Missed::TooLate);
        }
        let now = now_ns();
        slot.grant(&Grant::of(occurrence, self.changes.next()), now);
        Ok(now.saturating_sub(self.origin_ns))
    }

    fn slot(&self, window: &TimelineWindow) -> Option<&Slot> {
        self.slots[window.partition.index()].as_deref().filter(|slot| slot.readiness() == Readiness::Ready)
    }
}

impl Gate for WallGate {
    fn minor_frame(&mut self, _: u64) -> bool {
        true
    }

    fn prepare(&mut self, window: &TimelineWindow) {
        if let Some(slot) = self.slot(window) {
            slot.thaw();
        }
    }

    fn is_done(&mut self, window: &TimelineWindow) -> bool {
        self.slot(window).is_none_or(Slot::is_done)
    }

    fn open(&mut self, occurrence: &Occurrence) {
        self.granted = self.try_open(occurrence);
    }

    fn close(&mut self, occurrence: &Occurrence, ending: Ending) {
        let granted = std::mem::replace(&mut self.granted, Err(Missed::NoPartition));
        let granted_ns = granted.ok();
        let slot = self.slots[occurrence.window.partition.index()].as_deref();
        let usage = granted_ns.and(slot).map(Slot::usage);
        if let Some(slot) = slot {
            // Also where it was not granted: it may have been thawed ahead of its window.
            slot.fence(usage.is_some_and(|usage| usage.closed_ns.is_none()));
        }
        let requested = granted_ns.and(slot).and_then(|slot| self.changes.take_request(occurrence, slot));
        let module = |stamp: Option<u64>| stamp.map(|stamp| stamp.saturating_sub(self.origin_ns));
        let record = WindowRecord {
            occurrence: *occurrence,
            ending,
            missed: granted.err(),
            requested,
            granted_ns,
            opened_ns: module(usage.and_then(|usage| usage.opened_ns)),
            closed_ns: module(usage.and_then(|usage| usage.closed_ns)),
        };
        if self.records.push(record).is_err() {
            self.lost.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
    }
}
