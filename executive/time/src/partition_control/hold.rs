//! Which core has the partition, and when nothing of the partition runs.
//!
//! Dispatchers of several cores and the monitor meet here. Nobody waits for the monitor: it asks, and whoever ends the partition's
//! window carries it out.

use std::sync::atomic::Ordering::Relaxed;

use super::{PartitionControl, Readiness};
use crate::time_guard::Escapes;

impl PartitionControl {
    /// Whether the window of `core` may be opened: no other core has one of this partition open, and none can open one
    /// until [`PartitionControl::disown`].
    pub fn try_own(&self, core: u32) -> bool {
        self.owner.try_own(core)
    }

    /// The window of `core` is over, see [`PartitionControl::end_window`]; nothing where another core owns the partition.
    pub fn disown(&self, core: u32) {
        let is_stopped = || self.guard.holds() || self.guard.main() == 0;
        while self.owner.disown(core, is_stopped) {
            self.guard.hold(); // asked for while the window was being closed
        }
    }

    /// Ends the window: holds what may still run, and takes the priority of what says that it is done. `overrun`: the
    /// partition was not.
    pub fn end_window(&self, overrun: bool) {
        if overrun || self.always_freeze.load(Relaxed) || self.owner.is_held() {
            self.guard.hold();
        } else {
            self.guard.give_way();
        }
    }

    /// From now on the process has no real-time priority, in its windows neither.
    pub fn calm(&self) {
        self.guard.calm();
    }

    /// What was not held since the last question.
    pub fn take_escapes(&self) -> Escapes {
        self.guard.take_escapes()
    }

    /// The partition has a window and is still stopped, because whoever thaws has not come to it.
    pub fn awaits_thaw(&self) -> bool {
        self.guard.awaits_thaw()
    }

    /// From now on the partition is held between its windows; false: it was already.
    pub fn always_freeze(&self) -> bool {
        !self.always_freeze.swap(true, Relaxed)
    }

    /// Moves the partition's threads to a processor, if they are on another one.
    pub fn place(&self, core: u32) {
        self.guard.place(core);
    }

    /// Lets the partition's threads run again, where they were held. On a shared core nothing of it runs before the
    /// dispatcher sleeps, so this may happen ahead of the window.
    pub fn thaw(&self) {
        if !self.owner.is_held() {
            self.guard.let_go();
        }
    }

    /// Holds the partition until [`PartitionControl::release`]: no window is granted, nothing of it runs.
    pub fn hold(&self) {
        // First: a dispatcher that comes now grants nothing, and one that has just granted a window holds it at the end.
        self.set_readiness(Readiness::Held);
        if self.owner.hold() {
            self.guard.hold();
        }
    }

    /// Ends [`PartitionControl::hold`]: with its next window it goes on, or when the monitor has done what a change of schedule has
    /// meant for it meanwhile. Nothing of it runs before: this instant is somebody else's.
    pub fn release(&self) {
        self.owner.release();
        self.set_readiness(if self.owes() { Readiness::Absent } else { Readiness::Ready });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU32;
    use std::sync::atomic::Ordering::SeqCst;

    use super::super::fixture::{WINDOW, close, control};
    use super::*;
    use bateleur_system::time::now_ns;

    #[test]
    fn a_held_partition_is_not_thawed_by_a_dispatcher_that_had_begun_to_open_its_window() {
        let control = control();
        control.admit(1, &[1], &[]);
        control.set_readiness(Readiness::Ready);
        control.hold();
        control.thaw();
        assert_eq!((control.readiness(), control.guard.holds()), (Readiness::Held, true));
        control.release();
        assert_eq!(
            (control.readiness(), control.guard.holds()),
            (Readiness::Ready, true),
            "until its window"
        );
        control.grant(&WINDOW, now_ns());
        assert!(!control.guard.holds());
    }

    #[test]
    fn a_partition_that_is_to_be_held_in_its_window_is_stopped_by_its_dispatcher_at_the_end() {
        let control = control();
        control.admit(1, &[1], &[]);
        control.set_readiness(Readiness::Ready);
        assert!(control.try_own(3));
        control.grant(&WINDOW, now_ns());
        control.hold();
        assert!(!control.guard.holds(), "the window is the dispatcher's");
        close(&control, now_ns(), now_ns());
        control.end_window(false);
        control.disown(3);
        assert!(control.guard.holds());
    }

    #[test]
    fn a_partition_whose_dispatcher_has_just_closed_its_window_is_held_when_that_lets_it_go() {
        let control = control();
        control.admit(1, &[1], &[]);
        assert!(control.try_own(3));
        control.end_window(false);
        control.hold();
        control.disown(3);
        assert!(control.guard.holds() && control.try_own(4), "and nobody owns it for that");
    }

    #[test]
    fn what_is_always_held_is_held_from_its_admission_until_its_first_window() {
        let control = control();
        control.always_freeze();
        control.admit(1, &[1, 2], &[]);
        assert!(control.guard.holds());
        control.grant(&WINDOW, now_ns());
        assert!(!control.guard.holds());
        close(&control, now_ns(), now_ns());
        control.end_window(false);
        assert!(control.guard.holds());
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
        fn perform(&mut self, what: Move, control: &PartitionControl) {
            match what {
                Move::Prepare => {
                    self.owns = control.try_own(self.number);
                    if self.owns {
                        control.thaw();
                    }
                }
                Move::Open => {
                    self.owns = control.try_own(self.number);
                    if self.owns {
                        control.grant(&WINDOW, now_ns());
                        self.granted = true;
                    }
                }
                Move::Close => {
                    if self.owns {
                        control.end_window(!control.is_done());
                        control.disown(self.number);
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
            let control = control();
            control.admit(1, &[1, 2], &[]);
            control.always_freeze();
            control.set_readiness(Readiness::Ready);
            let mut cores = [0, 1].map(|number| Core { number, owns: false, granted: false });
            for (core, what) in &order {
                cores[*core].perform(*what, &control);
                assert!(cores.iter().filter(|core| core.granted).count() <= 1, "{order:?}");
                let open = cores.iter().any(|core| core.granted);
                assert!(
                    !open || !control.guard.holds(),
                    "the other core's close held an open window: {order:?}"
                );
                lost += usize::from(*what == Move::Open && !cores[*core].granted);
                let idle = cores.iter().all(|core| !core.owns);
                let used = control.granted.load(Relaxed) > 0;
                assert!(!(idle && used) || control.guard.holds(), "left running between windows: {order:?}");
            }
            assert!(control.try_own(7), "nobody owns it for ever: {order:?}");
        }
        assert!(lost > 0, "there are orders in which the other core still has it");
    }

    #[test]
    fn two_threads_never_own_a_partition_at_once() {
        let control = std::sync::Arc::new(control());
        let inside = std::sync::Arc::new(AtomicU32::new(0));
        let threads = [0, 1].map(|core| {
            let (control, inside) = (control.clone(), inside.clone());
            std::thread::spawn(move || {
                let mut owned = 0;
                // So often, however long that takes: the other one may lose its processor while it owns the partition control.
                while owned < 10_000 {
                    if control.try_own(core) {
                        assert_eq!(inside.fetch_add(1, SeqCst), 0);
                        owned += 1;
                        inside.fetch_sub(1, SeqCst);
                        control.disown(core);
                    } else {
                        std::thread::yield_now();
                    }
                    control.disown(1 - core + 2); // of a core that does not own it: nothing
                }
            })
        });
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    }
}
