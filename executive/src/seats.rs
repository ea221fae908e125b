//! A partition as the dispatchers see it: one slot, or two of which one is in office. The other has a process that stands
//! by, or a dead one, or none.
//!
//! Made before frame 0, never moved. The monitor hands over between two windows or in the middle of one; a dispatcher
//! looks once, at a window's start, who is in office, and closes the window on that very slot. So it can not hold the
//! successor for what its predecessor owed, and neither of them ever waits for the other.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::{Acquire, Release};

use crate::slot::Slot;

/// See the module's head.
#[derive(Debug)]
pub struct Seats {
    slots: Vec<Arc<Slot>>,
    office: AtomicUsize,
}

impl Seats {
    /// The slot that is in office first, and one behind it where a process stands by.
    #[must_use]
    pub fn new(first: Arc<Slot>, behind: Option<Arc<Slot>>) -> Self {
        Self { slots: std::iter::once(first).chain(behind).collect(), office: AtomicUsize::new(0) }
    }

    /// Number of the slot in office, for [`Seats::slot`].
    pub fn office(&self) -> usize {
        self.office.load(Acquire)
    }

    /// The slot with this number, or the first.
    pub fn slot(&self, seat: usize) -> &Slot {
        &self.slots[if seat < self.slots.len() { seat } else { 0 }]
    }

    /// The slot in office.
    pub fn in_office(&self) -> &Arc<Slot> {
        &self.slots[self.office() % self.slots.len()]
    }

    /// Both.
    pub fn all(&self) -> impl Iterator<Item = &Slot> {
        self.slots.iter().map(AsRef::as_ref)
    }

    /// The other slot is in office from now on: windows that are open are closed where they were opened. Nothing where
    /// there is no other.
    pub fn hand_over(&self) {
        let next = (self.office() + 1) % self.slots.len();
        self.office.store(next, Release);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::AtomicBool;
    use std::sync::atomic::Ordering::{Relaxed, SeqCst};

    use bateleur_contract::{Mapped, Takeover};

    use super::*;
    use crate::agenda::Agenda;
    use crate::change::Changes;
    use crate::dispatcher::{Ending, Gate, Occurrence, Reign};
    use crate::fence::{Fence, Grip};
    use crate::health::log::WindowRecord;
    use crate::inject::Stall;
    use crate::plan::Timeline;
    use crate::slot::{Grant, Readiness};
    use crate::system::time::now_ns;
    use crate::wall::WallGate;

    /// Processes of one slot: whether they are frozen, and what priority they were given.
    #[derive(Debug, Clone, Default)]
    struct Process(Arc<(AtomicBool, Mutex<Vec<&'static str>>)>);

    impl Process {
        fn is_held(&self) -> bool {
            self.0.0.load(SeqCst)
        }
        fn say(&self, what: &'static str) {
            self.0.1.lock().unwrap().push(what);
        }
        fn said(&self) -> Vec<&'static str> {
            std::mem::take(&mut self.0.1.lock().unwrap())
        }
    }

    impl Grip for Process {
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

    fn slot(process: &Process) -> Slot {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        Slot::new(Mapped::new(file).unwrap(), Fence::new(Box::new(process.clone()), Some(40)), true)
    }

    /// A partition with a process in office and one that stands by.
    fn pair() -> (Arc<Seats>, Process, Process) {
        let (old, new) = (Process::default(), Process::default());
        let first = slot(&old);
        let behind = slot(&new).beside(&first);
        first.admit(1, &[1], &[]);
        first.set_readiness(Readiness::Ready);
        behind.stand_by(2, &[2], &[]);
        (Arc::new(Seats::new(Arc::new(first), Some(Arc::new(behind)))), old, new)
    }

    const CALL: Grant = Grant {
        start_ns: 7,
        end_ns: 0,
        minor_frames: 0,
        minor_frame_ns: 1,
        major_frame: 0,
        major_frame_ns: 0,
        schedule: 0,
        since_ns: 0,
        next_schedule: 0,
    };

    /// What the monitor does when the process in office has died.
    fn take_over(seats: &Seats) {
        let (old, new) = (seats.slot(0), seats.slot(1));
        old.set_readiness(Readiness::Absent);
        old.lose_process();
        new.call(Takeover::Warm, old, &CALL, now_ns());
        new.page.done.store(new.page.grant.load(Relaxed), Relaxed);
        new.admit(2, &[2], &[]);
        seats.hand_over();
        new.set_readiness(Readiness::Ready);
    }

    const PLAN: &str = "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
         [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
         [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";

    /// The gate of one core, and a window of the partition.
    fn gate(seats: &Arc<Seats>) -> (WallGate, rtrb::Consumer<WindowRecord>, Occurrence) {
        let plan = crate::test_support::plan_of(PLAN);
        let window =
            Timeline::of(&plan, plan.module("m").unwrap().id(), plan.initial_schedule()).cores[0].windows[0];
        let changes = Arc::new(Changes::of(&plan, Arc::new(Agenda::new(0))));
        let (producer, consumer) = rtrb::RingBuffer::new(16);
        let gate = WallGate::new(
            vec![Some(seats.clone())],
            0,
            producer,
            Arc::default(),
            changes,
            (0, 0),
            Arc::new(Stall::default()),
        );
        let occurrence = Occurrence {
            window,
            core: 0,
            reign: Reign { number: 0, schedule: 0, after: None, since_ns: 0 },
            major_frame: 0,
            minor_frames: 0,
            minor_frame_ns: 20_000_000,
            start_ns: 0,
            end_ns: 2_000_000,
            late_ns: 0,
        };
        (gate, consumer, occurrence)
    }

    #[test]
    fn one_that_stands_by_is_held_and_is_called_without_priority() {
        let (seats, _, new) = pair();
        assert!(new.is_held());
        new.said();
        seats.slot(0).page.device_received.store(5, Relaxed);
        seats.slot(0).look_at_line();
        seats.slot(0).page.device_sent.store(u64::MAX / 2, Relaxed); // it has written wildly, and died of it
        seats.slot(1).call(Takeover::Cold, seats.slot(0), &CALL, now_ns());
        assert_eq!(new.said(), ["thaw"], "no priority outside of its windows");
        let page = &seats.slot(1).page;
        assert_eq!(page.take_over.load(Relaxed), Takeover::Cold as u32);
        assert_eq!((page.device_received.load(Relaxed), page.now_ns.load(Relaxed)), (5, 7));
        assert_eq!(page.device_sent.load(Relaxed), 0, "what can not be is not handed on");
        assert!(seats.slot(1).is_fresh() && !seats.slot(1).is_done());
    }

    #[test]
    fn one_slot_alone_stays_in_office() {
        let seats = Seats::new(Arc::new(slot(&Process::default())), None);
        seats.hand_over();
        assert_eq!((seats.office(), seats.all().count()), (0, 1));
    }

    #[test]
    fn at_whatever_point_of_a_window_the_office_changes_the_successor_has_the_next_one_and_is_not_held_in_it()
    {
        // Before each of: prepare, open, close, prepare, open, close.
        for point in 0..6 {
            let (seats, _, new) = pair();
            let (mut gate, mut records, occurrence) = gate(&seats);
            for step in 0..6 {
                if step == point {
                    take_over(&seats);
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
                .map(|record| (record.seat, record.missed))
                .collect();
            let first = usize::from(point <= 1);
            let second = usize::from(point <= 4);
            assert_eq!(seen, [(first, None), (second, None)], "{point}");
            for slot in seats.all() {
                assert!(slot.try_own(3), "nobody owns it for ever: {point}");
            }
        }
    }
}
