//! The wall clock: windows at their instants, one dispatcher thread on each partitioned core.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use rtrb::Producer;

use crate::change::Changes;
use crate::dispatcher::{Ending, Gate, Meanwhile, Occurrence, Pace};
use crate::freeze_worker::FreezeWorker;
use crate::partition_control::{PartitionControl, Readiness, grant_of};
use crate::redundant_pair::RedundantPair;
use crate::run_page::Heartbeat;
use crate::stall::Stall;
use crate::window_record::{Missed, WindowRecord};
use bateleur_plan::TimelineWindow;
use bateleur_system::time::{now_ns, sleep_until_ns, spin_until_ns};

/// How early the dispatcher wakes when the processor is free, ns. Longer than nearly every wake-up is late (p99.9 of a
/// quiet machine), so that the window itself starts on time; on a busy core it would be taken from a partition.
const EARLY_NS: u64 = 50_000;

/// As above, where the next partition is frozen: the freeze worker's wake-up on another processor, and a write of some 20 µs. And where a
/// process of the module starts: on a kernel that does not preempt itself its system calls hold the processor for as long.
const LONG_LEAD_NS: u64 = 200_000;

/// For how long at most the dispatcher holds the processor in slack, so that a partition whose window has ended does not run on before the
/// freeze worker, on another processor, has come to it, ns. That takes some 50 us, and more than a millisecond where the host has to wake that
/// processor.
const FREEZE_NS: u64 = 1_000_000;

/// How often the dispatcher lets itself be woken within a window. A partition closes its window once; one that wakes its
/// dispatcher more often is slept through.
const WAITS: u32 = 4;

/// Time passes by itself.
#[derive(Debug)]
pub struct WallPace {
    origin_ns: u64,
    spun_ns: Arc<AtomicU64>,
    beat: Heartbeat,
}

impl WallPace {
    /// Module time 0 is at `origin_ns` of CLOCK_MONOTONIC. `spun_ns` counts the time for which the processor was held in
    /// slack, so as to be awake at the instant. `beat` tells of each switch.
    #[must_use]
    pub fn new(origin_ns: u64, spun_ns: Arc<AtomicU64>, beat: Heartbeat) -> Self {
        Self { origin_ns, spun_ns, beat }
    }

    fn spin(&self, until_ns: u64) {
        let begun_ns = now_ns();
        spin_until_ns(until_ns);
        self.spun_ns.fetch_add(until_ns.saturating_sub(begun_ns), Relaxed);
    }

    /// See [`FREEZE_NS`].
    fn spin_while_it_may_run_on(&self, meanwhile: &dyn Meanwhile, until_ns: u64) {
        if meanwhile.may_run_on() {
            let begun_ns = now_ns();
            // Half of the slack at most: whoever holds the kernel's lock may need this processor to let go of it.
            let most_ns = FREEZE_NS.min(until_ns.saturating_sub(begun_ns) / 2);
            while meanwhile.may_run_on() && now_ns() < begun_ns + most_ns {
                std::hint::spin_loop();
            }
            self.spun_ns.fetch_add(now_ns().saturating_sub(begun_ns), Relaxed);
        }
    }
}

impl Pace for WallPace {
    fn reach(&mut self, instant_ns: u64, meanwhile: &mut dyn Meanwhile) -> u64 {
        let target_ns = self.origin_ns + instant_ns;
        // Woken when the window is closed, or at the instant: whoever uses all of his window pays for one wake-up, not two.
        for _ in 0..WAITS {
            if meanwhile.has_slack() || now_ns() >= target_ns {
                break;
            }
            meanwhile.await_close(target_ns);
        }
        if meanwhile.has_slack() {
            let awake_ns = target_ns.saturating_sub(meanwhile.lead_ns().max(EARLY_NS));
            self.spin_while_it_may_run_on(meanwhile, awake_ns);
            sleep_if_ahead(awake_ns);
            meanwhile.prepare();
            self.spin(target_ns);
        } else {
            sleep_if_ahead(target_ns);
        }
        let now_ns = now_ns();
        self.beat.beat_at(now_ns);
        now_ns.saturating_sub(target_ns)
    }
}

/// Most often the instant has passed, and the kernel need not be asked.
fn sleep_if_ahead(instant_ns: u64) {
    if now_ns() < instant_ns {
        sleep_until_ns(instant_ns);
    }
}

/// How late another core's dispatcher may make a window's start, ns. Two that wake at one instant are some 10 us apart; on a machine
/// whose processors are held up by its host, some 100.
const HANDOVER_NS: u64 = 500_000;

/// One of a partition's controls: the partition's place in the plan, and the number among its [`RedundantPair`].
type PairMember = (usize, usize);

/// Opens and closes windows of real processes. Nothing here blocks, allocates or writes to a file.
pub struct WallGate {
    pair: Vec<Option<Arc<RedundantPair>>>,
    origin_ns: u64,
    records: Producer<WindowRecord>,
    /// Module time at which the open window was granted, or why it was not.
    granted: Result<u64, Missed>,
    lost: Arc<AtomicU64>,
    changes: Arc<Changes>,
    /// The plan's core whose dispatcher this is, and the processor that stands for it.
    core: u32,
    processor: u32,
    /// The partition control that is this core's: no other core may open or close a window of it.
    owns: Option<PairMember>,
    /// That of the next window, where this core has got ready for it while another one was still open.
    prepared: Option<PairMember>,
    /// The partition control on which the open window was opened, whoever is active by now.
    opened: usize,
    /// See [`WallGate::beside`].
    worker: Option<Arc<FreezeWorker>>,
    stall: Arc<Stall>,
}

impl WallGate {
    /// A gate to `seats` (by place in the plan) that leaves its records in a ring and counts those that find no room.
    #[must_use]
    pub fn new(
        pair: Vec<Option<Arc<RedundantPair>>>,
        origin_ns: u64,
        records: Producer<WindowRecord>,
        lost: Arc<AtomicU64>,
        changes: Arc<Changes>,
        (core, processor): (u32, u32),
        stall: Arc<Stall>,
    ) -> Self {
        let granted = Err(Missed::NoPartition);
        Self {
            pair,
            origin_ns,
            records,
            granted,
            lost,
            changes,
            core,
            processor,
            owns: None,
            prepared: None,
            opened: 0,
            worker: None,
            stall,
        }
    }

    /// With a freeze worker that works while this dispatcher holds its own processor.
    #[must_use]
    pub fn beside(mut self, worker: Option<Arc<FreezeWorker>>) -> Self {
        self.worker = worker;
        self
    }

    fn try_open(&mut self, occurrence: &Occurrence) -> Result<u64, Missed> {
        let partition = occurrence.window.partition.index();
        let pair = self.pair[partition].as_deref().ok_or(Missed::NoPartition)?;
        self.opened = pair.active_member();
        let member = (partition, self.opened);
        let control = pair.control(self.opened);
        // Somebody else has taken over since this core got ready.
        if let Some(before) = self.owns.take_if(|owned| owned.0 == partition && *owned != member) {
            self.let_go(before, true);
        }
        if let Some(action) = self.changes.action_due(occurrence, control) {
            return Err(Missed::Changed(action));
        }
        if control.readiness() != Readiness::Ready {
            return Err(Missed::NoPartition);
        }
        // The dispatcher was held up for longer than the window lasts: the window is lost and says so.
        let length_ns = occurrence.window.duration_ns();
        if occurrence.late_ns >= length_ns {
            return Err(Missed::TooLate);
        }
        if !await_own(control, self.core, (length_ns / 4).min(HANDOVER_NS)) {
            return Err(Missed::OtherCore);
        }
        self.owns = Some(member);
        // Once more: an operator may have found that no core has the partition, and have stopped it.
        if control.readiness() != Readiness::Ready {
            return Err(Missed::NoPartition);
        }
        control.place(self.processor);
        let now = now_ns();
        control.grant(&grant_of(occurrence, self.changes.next()), now);
        Ok(now.saturating_sub(self.origin_ns))
    }

    /// Ends the window of a control that is this core's, and leaves it to whoever has the next one.
    fn let_go(&self, member: PairMember, overrun: bool) {
        if let Some(control) = self.control(member) {
            control.end_window(overrun);
            control.disown(self.core);
        }
    }

    fn control(&self, (partition, member): PairMember) -> Option<&PartitionControl> {
        self.pair[partition].as_deref().map(|pair| pair.control(member))
    }
}

impl Gate for WallGate {
    fn minor_frame(&mut self, _: u64) -> bool {
        true
    }

    fn may_run_on(&self) -> bool {
        self.worker.as_deref().is_some_and(FreezeWorker::is_behind)
    }

    fn lead_ns(&self, window: &TimelineWindow) -> u64 {
        let pair = self.pair[window.partition.index()].as_deref();
        let thaws = |pair: &RedundantPair| {
            let guard = pair.active().guard();
            guard.holds() && !guard.settles_at_once()
        };
        let starts = |pair: &Option<Arc<RedundantPair>>| {
            pair.as_deref().is_some_and(|pair| pair.active().readiness() == Readiness::Absent)
        };
        if pair.is_some_and(thaws) || self.pair.iter().any(starts) { LONG_LEAD_NS } else { EARLY_NS }
    }

    fn prepare(&mut self, window: &TimelineWindow) {
        let partition = window.partition.index();
        let Some(pair) = self.pair[partition].as_deref() else { return };
        let member = pair.active_member();
        let control = pair.control(member);
        if control.readiness() == Readiness::Ready && control.try_own(self.core) {
            self.prepared = Some((partition, member));
            control.place(self.processor);
            control.thaw();
        }
    }

    fn await_close(&mut self, window: &TimelineWindow, until_ns: u64) {
        if let Some(control) = self.control((window.partition.index(), self.opened)) {
            control.await_close(until_ns);
        }
    }

    fn is_done(&mut self, window: &TimelineWindow) -> bool {
        let open = (window.partition.index(), self.opened);
        let control = self.control(open).filter(|control| control.readiness() == Readiness::Ready);
        self.granted.is_err() || control.is_none_or(PartitionControl::is_done)
    }

    fn open(&mut self, occurrence: &Occurrence) {
        self.stall.apply();
        // A window of the same partition may have ended since, and let it go.
        let (prepared, core) = (self.prepared.take(), self.core);
        self.owns =
            prepared.filter(|member| self.control(*member).is_some_and(|control| control.try_own(core)));
        self.granted = self.try_open(occurrence);
    }

    fn close(&mut self, occurrence: &Occurrence, ending: Ending) {
        let granted = std::mem::replace(&mut self.granted, Err(Missed::NoPartition));
        let partition = occurrence.window.partition.index();
        let member = (partition, self.opened);
        let control = self.control(member);
        let granted = granted.and_then(|granted_ns| match control {
            Some(control) if control.awaits_thaw() => Err(Missed::StillFrozen),
            _ => Ok(granted_ns),
        });
        let granted_ns = granted.ok();
        let usage = granted_ns.and(control).map(PartitionControl::usage);
        let requested =
            granted_ns.and(control).and_then(|control| self.changes.take_request(occurrence, control));
        if let Some(control) = control
            && self.owns == Some(member)
        {
            // Also where it was not granted: it may have been thawed ahead of its window.
            let overrun = usage.map_or_else(|| !control.is_done(), |usage| usage.closed_ns.is_none());
            self.let_go(member, overrun);
        }
        self.owns = None;
        let module = |stamp: Option<u64>| stamp.map(|stamp| stamp.saturating_sub(self.origin_ns));
        let record = WindowRecord {
            occurrence: *occurrence,
            member: self.opened,
            ending,
            missed: granted.err(),
            requested,
            granted_ns,
            opened_ns: module(usage.and_then(|usage| usage.opened_ns)),
            closed_ns: module(usage.and_then(|usage| usage.closed_ns)),
        };
        if self.records.push(record).is_err() {
            self.lost.fetch_add(1, Relaxed);
        }
    }
}

/// Whoever is open or was thawed ahead of a window that does not come would have its priority for ever: where it shares the processor with the
/// executive, nothing could end it.
impl Drop for WallGate {
    fn drop(&mut self) {
        for member in [self.owns, self.prepared].into_iter().flatten() {
            // Another core may have its window by now.
            if self.control(member).is_some_and(|control| control.try_own(self.core)) {
                self.let_go(member, true);
            }
        }
    }
}

/// Waits for another core's dispatcher, whose window of the same partition has ended by the schedule, to close it; never for a
/// partition. `most_ns`: as long as the start may be late for it.
fn await_own(control: &PartitionControl, core: u32, most_ns: u64) -> bool {
    if control.try_own(core) {
        return true;
    }
    let limit_ns = now_ns() + most_ns;
    while now_ns() < limit_ns {
        if control.try_own(core) {
            return true;
        }
        std::hint::spin_loop();
    }
    false
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Slack in which somebody may run on until it was asked so often.
    struct Slack {
        asks_left: Cell<u32>,
        prepared_with: Option<u32>,
    }

    impl Meanwhile for Slack {
        fn has_slack(&mut self) -> bool {
            true
        }
        fn await_close(&mut self, _: u64) {}
        fn may_run_on(&self) -> bool {
            self.asks_left.set(self.asks_left.get().saturating_sub(1));
            self.asks_left.get() > 0
        }
        fn lead_ns(&self) -> u64 {
            0
        }
        fn prepare(&mut self) {
            self.prepared_with = Some(self.asks_left.get());
        }
    }

    #[test]
    fn processor_is_held_in_slack_while_somebody_may_run_on_and_not_for_ever() {
        for asks in [0, 5, u32::MAX] {
            let spun_ns = Arc::new(AtomicU64::new(0));
            let mut pace = WallPace::new(now_ns(), spun_ns.clone(), Heartbeat::of_freeze_worker(None));
            let mut slack = Slack { asks_left: Cell::new(asks), prepared_with: None };
            pace.reach(5 * FREEZE_NS, &mut slack);
            let left = slack.prepared_with.expect("got ready for the next window");
            let was_held = spun_ns.load(Relaxed) >= FREEZE_NS;
            assert!(left == 0 || was_held, "{asks}: let go while it may run on, {left} left");
            assert!(left > 0 || asks < u32::MAX);
        }
    }
}
