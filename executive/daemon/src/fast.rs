//! The virtual clock: module time jumps to the next switch as soon as a window is closed. Everything happens in one
//! thread and in the order of module time, so that a run with the same inputs is the same run, bit for bit.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;

use bateleur_monitor::Monitor;
use bateleur_plan::TimelineWindow;
use bateleur_system::cpu_starvation::Spell;
use bateleur_system::time::now_ns;
use bateleur_time::change::Changes;
use bateleur_time::dispatcher::{Ending, Gate, Meanwhile, Occurrence, Pace};
use bateleur_time::partition_control::{PartitionControl, Readiness, grant_of};
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::window_record::{Missed, WindowRecord};

/// Real time after which a window that is not closed counts as overrun, without the time for which the partition waited for a
/// processor: what others compute on this machine must not change a flight. Longer than a partition may wait for its device (two
/// seconds, and again in the same window for a simulator that pauses: three were too few), far longer than any computation: it is met
/// by a partition that hangs, and by no other.
const PATIENCE_NS: u64 = 5_000_000_000;
/// As above, whatever it waited for: a machine that lets nobody run for so long is not flown on.
const STARVED_PATIENCE_NS: u64 = 120_000_000_000;
/// As above, for a partition that is known to hang: it must not hold up the others at every window.
const HANGING_PATIENCE_NS: u64 = 2_000_000;
/// Real time after which a window costs its partition the priority that lets it run at once. Only a partition that computes and
/// computes makes this thread, which has none, wait so long.
const TRUST_NS: u64 = 500_000_000;
/// Between two looks whether the partition still lives.
const LOOK_NS: u64 = 20_000_000;

/// Window records on their way from the gate to the monitor.
pub type Records = Rc<RefCell<VecDeque<WindowRecord>>>;

/// Time passes when it is told to.
#[derive(Debug, Default)]
pub struct VirtualPace;

impl Pace for VirtualPace {
    fn reach(&mut self, _: u64, _: &mut dyn Meanwhile) -> u64 {
        0
    }
}

/// What else lives in virtual time: the ground station at the other end of a line, a recorder, planned faults.
pub trait World {
    /// A minor frame begins; false: the run shall end here.
    fn minor_frame(&mut self, module_ns: u64, monitor: &mut Monitor) -> bool;

    /// A window is about to be opened, whether its partition runs or not.
    fn window(&mut self, occurrence: &Occurrence);

    /// A window is over, and what follows from it has not begun: no successor of a partition that died in it.
    fn window_closed(&mut self);
}

/// Opens windows and waits until they are closed.
pub struct VirtualGate<'a> {
    monitor: &'a mut Monitor,
    world: &'a mut dyn World,
    pair: Vec<Option<Arc<RedundantPair>>>,
    /// By partition, the partition control on which its last window was opened.
    opened: Vec<usize>,
    hanging: Vec<bool>,
    records: Records,
    granted: Result<(), Missed>,
    changes: Arc<Changes>,
}

impl<'a> VirtualGate<'a> {
    /// A gate that hands everything else to `monitor` and `world`.
    pub fn new(
        monitor: &'a mut Monitor,
        world: &'a mut dyn World,
        records: Records,
        changes: Arc<Changes>,
    ) -> Self {
        let pair = monitor.pair();
        let granted = Err(Missed::NoPartition);
        Self {
            hanging: vec![false; pair.len()],
            opened: vec![0; pair.len()],
            pair,
            monitor,
            world,
            records,
            granted,
            changes,
        }
    }

    /// Waits until the window is closed, its partition has ended, or patience has.
    fn settle(&mut self, partition: usize, control: &PartitionControl) {
        let begun_ns = now_ns();
        let patience_ns = if self.hanging[partition] { HANGING_PATIENCE_NS } else { PATIENCE_NS };
        let mut spell = None;
        while !control.is_done() {
            control.await_change(LOOK_NS.min(patience_ns));
            if control.is_done() || self.monitor.has_ended(partition) {
                break;
            }
            // From the first look on: few windows take so long, and only these are worth the question.
            let spell = spell.get_or_insert_with(|| Spell::begin(control.process()));
            let elapsed_ns = now_ns() - begun_ns;
            if elapsed_ns > TRUST_NS {
                control.calm();
            }
            let starved = || !self.hanging[partition] && spell.used_ns(elapsed_ns) <= patience_ns;
            if elapsed_ns > patience_ns && (elapsed_ns > STARVED_PATIENCE_NS || !starved()) {
                self.hanging[partition] = true;
                return;
            }
        }
        self.hanging[partition] = false;
        // It may be what kept this thread from running, in its window or by computing on afterwards.
        if now_ns() - begun_ns > TRUST_NS {
            control.calm();
        }
    }
}

impl Gate for VirtualGate<'_> {
    fn minor_frame(&mut self, instant_ns: u64) -> bool {
        self.monitor.step(instant_ns);
        self.world.minor_frame(instant_ns, self.monitor) && self.monitor.stop_asked().is_none()
    }

    fn prepare(&mut self, _: &TimelineWindow) {}

    fn is_done(&mut self, _: &TimelineWindow) -> bool {
        true
    }

    fn open(&mut self, occurrence: &Occurrence) {
        let partition = occurrence.window.partition.index();
        self.granted = Err(Missed::NoPartition);
        self.world.window(occurrence);
        let Some(pair) = self.pair[partition].clone() else { return };
        if std::mem::replace(&mut self.opened[partition], pair.active_member()) != pair.active_member() {
            self.hanging[partition] = false; // somebody else has taken over
        }
        let mut control = pair.active();
        if let Some(action) = self.changes.action_due(occurrence, control) {
            self.granted = Err(Missed::Changed(action));
            return;
        }
        if control.readiness() == Readiness::Absent {
            self.hanging[partition] = false; // its successor has shown nothing yet
        }
        if control.readiness() == Readiness::Absent && occurrence.start_ns >= control.not_before_ns() {
            self.monitor.await_successor(partition, occurrence.start_ns);
            // A successor that was a spare has a partition control of its own.
            self.opened[partition] = pair.active_member();
            control = pair.active();
        }
        if control.readiness() == Readiness::Ready && occurrence.start_ns >= control.not_before_ns() {
            control.grant(&grant_of(occurrence, self.changes.next()), now_ns());
            self.granted = Ok(());
            self.settle(partition, control);
        }
    }

    fn close(&mut self, occurrence: &Occurrence, ending: Ending) {
        let partition = occurrence.window.partition.index();
        let mut record = WindowRecord {
            occurrence: *occurrence,
            member: self.opened[partition],
            ending,
            missed: self.granted.err(),
            requested: None,
            granted_ns: None,
            opened_ns: None,
            closed_ns: None,
        };
        if self.granted.is_ok()
            && let Some(pair) = &self.pair[partition]
        {
            let control = pair.control(self.opened[partition]);
            record.requested = self.changes.take_request(occurrence, control);
            let usage = control.usage();
            control.end_window(usage.closed_ns.is_none());
            // Module time stands still in a window; what the processor took is laid after its start.
            record.granted_ns = Some(occurrence.start_ns);
            record.opened_ns = usage.opened_ns.map(|_| occurrence.start_ns);
            let took_ns =
                usage.closed_ns.zip(usage.opened_ns).map(|(closed, opened)| closed.saturating_sub(opened));
            record.closed_ns = took_ns.map(|took| occurrence.start_ns + took);
        }
        self.granted = Err(Missed::NoPartition);
        self.world.window_closed();
        self.records.borrow_mut().push_back(record);
        // What is done about it begins at this instant of module time.
        let changed = matches!(record.missed, Some(Missed::Changed(_)));
        if changed || record.is_overrun() && self.monitor.has_ended(partition) {
            self.monitor.step(occurrence.start_ns);
        }
    }
}
