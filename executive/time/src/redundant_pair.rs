//! A partition as the dispatchers see it: one partition control, or two of which one is active. The other has a process that stands
//! by, or a dead one, or none.
//!
//! Made before frame 0, never moved. The monitor hands over between two windows or in the middle of one; a dispatcher
//! looks once, at a window's start, who is active, and closes the window on that very partition control. So it can not hold the
//! successor for what its predecessor owed, and neither of them ever waits for the other.

use std::sync::Arc;

use crate::partition_control::PartitionControl;
use crate::sync::AtomicU32;
use crate::sync::Ordering::{Acquire, Release};

/// See the module's head.
#[derive(Debug)]
pub struct RedundantPair<C = PartitionControl> {
    controls: Vec<Arc<C>>,
    active: AtomicU32,
}

impl<C> RedundantPair<C> {
    /// `first` is active; `behind` stands by.
    #[must_use]
    pub fn new(first: Arc<C>, behind: Option<Arc<C>>) -> Self {
        Self { controls: std::iter::once(first).chain(behind).collect(), active: AtomicU32::new(0) }
    }

    /// Number of the active member, for [`RedundantPair::control`].
    pub fn active_member(&self) -> usize {
        self.active.load(Acquire) as usize
    }

    /// The member with this number, or the first.
    pub fn control(&self, member: usize) -> &C {
        &self.controls[if member < self.controls.len() { member } else { 0 }]
    }

    /// The active member.
    pub fn active(&self) -> &Arc<C> {
        &self.controls[self.active_member() % self.controls.len()]
    }

    /// Both.
    pub fn all(&self) -> impl Iterator<Item = &C> {
        self.controls.iter().map(AsRef::as_ref)
    }

    /// The other member is active from now on: windows that are open are closed where they were opened. Nothing where
    /// there is no other.
    pub fn hand_over(&self) {
        let next = (self.active_member() + 1) % self.controls.len();
        self.active.store(next as u32, Release);
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering::Relaxed;

    use bateleur_contract::Takeover;
    use bateleur_contract::page::WindowGrant;

    use super::*;
    use crate::change::Changes;
    use crate::dispatcher::{Ending, Gate, Occurrence, ScheduleEpoch};
    use crate::freeze_worker::FreezeWorker;
    use crate::partition_control::Readiness;
    use crate::partition_control::fixture::{self, Obedient, controlled};
    use crate::run_page::Heartbeat;
    use crate::schedule_switch::ScheduleSwitch;
    use crate::stall::Stall;
    use crate::wall::WallGate;
    use crate::window_record::{Missed, WindowRecord};
    use bateleur_system::time::now_ns;

    /// A partition with a process active and one that stands by.
    fn pair() -> (Arc<RedundantPair>, Obedient, Obedient) {
        let (old, new) = (Obedient::default(), Obedient::default());
        let first = controlled(&old, Some(40), true);
        let behind = controlled(&new, Some(40), true).beside(&first);
        first.admit(1, &[1], &[]);
        first.set_readiness(Readiness::Ready);
        behind.stand_by(2, &[2], &[]);
        (Arc::new(RedundantPair::new(Arc::new(first), Some(Arc::new(behind)))), old, new)
    }

    const CALL: WindowGrant = WindowGrant {
        start_ns: 7,
        end_ns: 0,
        minor_frames: 0,
        minor_frame_ns: 1,
        major_frame: 0,
        major_frame_ns: 0,
        schedule: 0,
        schedule_since_ns: 0,
        next_schedule: 0,
    };

    /// What the monitor does when the process active has died.
    fn take_over(pair: &RedundantPair) {
        let (old, new) = (pair.control(0), pair.control(1));
        old.set_readiness(Readiness::Absent);
        old.lose_process();
        new.call(Takeover::Warm, old, &CALL, now_ns());
        new.page.done.store(new.page.grant.load(Relaxed), Relaxed);
        new.admit(2, &[2], &[]);
        pair.hand_over();
        new.set_readiness(Readiness::Ready);
    }

    /// The gate of one core, and a window of the partition.
    fn gate(pair: &Arc<RedundantPair>) -> (WallGate, rtrb::Consumer<WindowRecord>, Occurrence) {
        gate_of(pair, 0)
    }

    fn gate_of(pair: &Arc<RedundantPair>, core: u32) -> (WallGate, rtrb::Consumer<WindowRecord>, Occurrence) {
        let changes = Arc::new(Changes::of(&fixture::plan(), Arc::new(ScheduleSwitch::new(0))));
        let (producer, consumer) = rtrb::RingBuffer::new(16);
        let gate = WallGate::new(
            vec![Some(pair.clone())],
            0,
            producer,
            Arc::default(),
            changes,
            (core, core),
            Arc::new(Stall::default()),
        );
        let epoch = ScheduleEpoch { number: 0, schedule: 0, after: None, since_ns: 0 };
        let occurrence = Occurrence { core, ..fixture::occurrence(epoch) };
        (gate, consumer, occurrence)
    }

    #[test]
    fn one_that_stands_by_is_held_and_is_called_without_priority() {
        let (pair, _, new) = pair();
        assert!(new.is_held());
        new.said();
        pair.control(0).page.device_received.store(5, Relaxed);
        pair.control(0).look_at_line();
        pair.control(0).page.device_sent.store(u64::MAX / 2, Relaxed); // it has written wildly, and died of it
        pair.control(1).call(Takeover::Cold, pair.control(0), &CALL, now_ns());
        assert_eq!(new.said(), ["thaw"], "no priority outside of its windows");
        let page = &pair.control(1).page;
        assert_eq!(page.take_over.load(Relaxed), Takeover::Cold as u32);
        assert_eq!((page.device_received.load(Relaxed), page.now_ns.load(Relaxed)), (5, 7));
        assert_eq!(page.device_sent.load(Relaxed), 0, "what can not be is not handed on");
        assert!(pair.control(1).is_fresh() && !pair.control(1).is_done());
    }

    #[test]
    fn one_member_alone_stays_active() {
        let pair = RedundantPair::new(Arc::new(controlled(&Obedient::default(), Some(40), true)), None);
        pair.hand_over();
        assert_eq!((pair.active_member(), pair.all().count()), (0, 1));
    }

    #[test]
    fn at_whatever_point_of_a_window_another_member_is_made_active_the_successor_has_the_next_one_and_is_not_held_in_it()
     {
        // Before each of: prepare, open, close, prepare, open, close.
        for point in 0..6 {
            let (pair, _, new) = pair();
            let (mut gate, mut records, occurrence) = gate(&pair);
            for step in 0..6 {
                if step == point {
                    take_over(&pair);
                }
                match step % 3 {
                    0 => gate.prepare(&occurrence.window),
                    1 => gate.open(&occurrence),
                    _ => gate.close(&occurrence, Ending::default()),
                }
                let opened = step % 3 == 1 && step > point;
                assert!(!opened || !new.is_held(), "held in its window: {point} {step}");
            }
            assert!(new.is_held(), "held after its window, or before its first: {point}");
            let seen: Vec<_> = std::iter::from_fn(|| records.pop().ok())
                .map(|record| (record.member, record.missed))
                .collect();
            let first = usize::from(point <= 1);
            let second = usize::from(point <= 4);
            assert_eq!(seen, [(first, None), (second, None)], "{point}");
            for control in pair.all() {
                assert!(control.try_own(3), "nobody owns it for ever: {point}");
            }
        }
    }

    /// A core that got ready for a window of the partition, and has ended one of the same partition since, does not have it any more.
    #[test]
    fn core_that_got_ready_too_early_neither_takes_nor_ends_the_window_of_another_core() {
        let (pair, old, _) = pair();
        let (mut first, mut records, window) = gate(&pair);
        let (mut second, _, other_window) = gate_of(&pair, 1);
        first.open(&window);
        first.prepare(&window.window); // the next one, which begins when this one ends
        first.close(&window, Ending::default());
        second.open(&other_window);
        first.open(&window);
        assert!(!old.is_held());
        first.close(&window, Ending::default());
        assert!(!old.is_held(), "held in the window that it has on the other core");
        let missed: Vec<_> = std::iter::from_fn(|| records.pop().ok()).map(|record| record.missed).collect();
        assert_eq!(missed, [None, Some(Missed::OtherCore)]);
        second.close(&other_window, Ending::default());
        assert!(old.is_held() && pair.control(0).try_own(7), "held after it, and nobody owns it for ever");
    }

    #[test]
    fn partition_whose_dispatcher_ends_before_its_window_or_within_it_is_held() {
        for is_opened in [false, true] {
            let (pair, old, _) = pair();
            let (mut gate, _, window) = gate(&pair);
            gate.prepare(&window.window);
            if is_opened {
                gate.open(&window);
            }
            assert!(!old.is_held());
            old.said();
            drop(gate);
            assert_eq!(old.said(), ["freeze"], "opened: {is_opened}");
            assert!(pair.control(0).try_own(7), "and nobody owns it for ever");
        }
    }

    #[test]
    fn dispatcher_that_ends_does_not_hold_a_partition_in_its_window_on_another_core() {
        let (pair, old, _) = pair();
        let (mut first, _, window) = gate(&pair);
        let (mut second, _, other_window) = gate_of(&pair, 1);
        first.open(&window);
        first.prepare(&window.window); // that of the next frame, which does not come
        first.close(&window, Ending::default());
        second.open(&other_window);
        drop(first);
        assert!(!old.is_held());
        second.close(&other_window, Ending::default());
        assert!(old.is_held());
    }

    #[test]
    fn dispatcher_wakes_earlier_while_a_process_starts_on_its_processor() {
        let pair = Arc::new(RedundantPair::new(Arc::new(fixture::control()), None));
        let (gate, _, window) = gate(&pair);
        pair.control(0).set_readiness(Readiness::Ready);
        let usual = gate.lead_ns(&window.window);
        pair.control(0).set_readiness(Readiness::Absent);
        assert!(gate.lead_ns(&window.window) > 2 * usual);
        pair.control(0).set_readiness(Readiness::Stopped);
        assert_eq!(gate.lead_ns(&window.window), usual, "it has no process");
    }

    #[test]
    fn window_in_which_the_kernel_had_not_thawed_the_partition_is_lost_and_no_overrun() {
        let (pair, old, _) = pair();
        let (mut gate, mut records, window) = gate(&pair);
        gate.open(&window);
        gate.close(&window, Ending::default());
        assert!(old.is_held());
        let worker = FreezeWorker::new(); // which does not come to it
        pair.control(0).guard().leave_to(&worker);
        gate.open(&window);
        gate.close(&window, Ending::default());
        assert!(old.is_held());
        let records: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
        assert_eq!(records[1].missed, Some(Missed::StillFrozen));
        assert!(records[1].is_lost() && !records[1].is_overrun());
        worker.end();
    }

    #[test]
    fn dispatcher_knows_of_all_that_the_freeze_worker_beside_it_has_not_come_to() {
        for is_apart in [true, false] {
            let worker = FreezeWorker::new();
            let pairs = [(); 2].map(|()| pair().0);
            let mut gates = pairs.each_ref().map(|pair| {
                let (gate, _, window) = gate(pair);
                (gate.beside(is_apart.then(|| worker.clone())), window)
            });
            for (gate, window) in &mut gates {
                gate.open(window);
            }
            pairs.iter().for_each(|pair| pair.control(0).guard().leave_to(&worker)); // who does not come to them
            for (gate, window) in &mut gates {
                gate.close(window, Ending::default());
                assert_eq!(gate.may_run_on(), is_apart, "one on the same processor is not waited for");
            }
            worker.end();
            worker.run(&pairs, &Heartbeat::of_freeze_worker(None));
            assert!(gates.iter().all(|(gate, _)| !gate.may_run_on()), "it has come to all");
            assert!(pairs.iter().all(|pair| pair.control(0).guard().holds()));
        }
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::thread;

    use super::*;
    use crate::sync::Ordering::{Relaxed, SeqCst};
    use crate::sync::{AtomicBool, explore};
    use crate::window_owner::WindowOwner;

    /// A partition control: what the dispatchers and the monitor make of it.
    struct Member {
        owner: WindowOwner,
        ready: AtomicBool,
        /// Its process was told all that it needs. Nothing but the hand-over says that to the dispatchers.
        admitted: AtomicBool,
        stopped: AtomicBool,
        /// Windows that are open.
        open: AtomicU32,
    }

    impl Member {
        fn new(runs: bool) -> Arc<Self> {
            Arc::new(Self {
                owner: WindowOwner::new(),
                ready: AtomicBool::new(runs),
                admitted: AtomicBool::new(runs),
                stopped: AtomicBool::new(!runs),
                open: AtomicU32::new(0),
            })
        }

        fn disown(&self, core: u32) {
            while self.owner.disown(core, || self.stopped.load(SeqCst)) {
                self.stopped.store(true, SeqCst);
            }
        }
    }

    type Pair = RedundantPair<Member>;

    fn pair() -> Arc<Pair> {
        Arc::new(RedundantPair::new(Member::new(true), Some(Member::new(false))))
    }

    /// One window as the gate on the wall clock opens and closes it; which member had it.
    fn window(pair: &Pair, core: u32) -> Option<usize> {
        let early = pair.active_member();
        let is_prepared = pair.control(early).ready.load(Acquire) && pair.control(early).owner.try_own(core);
        let member = pair.active_member();
        if is_prepared && member != early {
            pair.control(early).disown(core);
        }
        let control = pair.control(member);
        let has_it = control.ready.load(Acquire) && control.owner.try_own(core);
        let is_granted = has_it && control.ready.load(Acquire);
        if is_granted {
            assert!(control.admitted.load(Relaxed), "a window of a process that was not admitted");
            if !control.owner.is_held() {
                control.stopped.store(false, SeqCst);
            }
            assert_eq!(control.open.fetch_add(1, SeqCst), 0, "two windows of one process at once");
            control.open.fetch_sub(1, SeqCst);
            if control.owner.is_held() {
                control.stopped.store(true, SeqCst);
            }
        }
        // Closed where it was opened, whoever is active by now.
        control.disown(core);
        is_granted.then_some(member)
    }

    /// The monitor, when the active process has died.
    fn take_over(pair: &Pair, is_held: bool) {
        let new = pair.control(1);
        pair.control(0).ready.store(false, Release);
        new.admitted.store(true, Relaxed);
        pair.hand_over();
        if !is_held {
            return new.ready.store(true, Release);
        }
        if new.owner.hold() {
            new.stopped.store(true, SeqCst);
        }
    }

    /// What two cores do while the standby takes over; then what `after` says of the pair.
    fn while_it_takes_over(is_held: bool, after: fn(&Pair)) {
        explore(move || {
            let pair = pair();
            let cores = [0, 1].map(|core| {
                let pair = pair.clone();
                thread::spawn(move || {
                    window(&pair, core);
                })
            });
            take_over(&pair, is_held);
            cores.into_iter().for_each(|core| core.join().unwrap());
            after(&pair);
            for control in pair.all() {
                assert!(control.owner.try_own(7), "nobody has it for ever");
            }
        });
    }

    #[test]
    fn model_redundant_pair_whatever_dispatchers_had_begun_the_next_window_is_that_of_the_standby() {
        while_it_takes_over(false, |pair| {
            assert_eq!(window(pair, 0), Some(1));
        });
    }

    #[test]
    fn model_redundant_pair_standby_of_a_held_partition_takes_over_and_has_no_window() {
        while_it_takes_over(true, |pair| {
            assert_eq!(window(pair, 0), None);
            assert!(pair.control(1).stopped.load(SeqCst), "runs though an operator holds it");
        });
    }
}
