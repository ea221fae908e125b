//! Which schedule each major frame runs, agreed between the dispatchers of all cores without a lock.
//!
//! Whoever asks leaves one word. The first dispatcher that reaches the start of a major frame decides from it what that
//! frame runs and writes the decision down; every other one, however late it comes, finds it there. So all cores change
//! together and at the same instant, whatever happens between them. It must never wait for anybody.
//!
//! As long as a frame has not begun, it can also be proposed that its end be moved (a module that follows another one's
//! frames, see [`crate::alignment`]). Whoever is first writes the frame's cell: the proposal, or a dispatcher that begins
//! the frame and finds none.

use crate::sync::AtomicU64;
use crate::sync::Ordering::{AcqRel, Acquire, Relaxed, Release};

/// Major frames whose decision is kept: a dispatcher that was held up for longer than all of them can not know what the
/// others went through. At the shortest sensible major frame (1 ms) that is four seconds.
#[cfg(not(feature = "model"))]
const HISTORY: usize = 4096;
/// As above: as few as a model of two frames needs.
#[cfg(feature = "model")]
const HISTORY: usize = 4;
/// A cell that holds no decision yet.
const EMPTY: u64 = u64::MAX;
/// Bits of a word that name the schedule; the others count.
const SCHEDULE_BITS: u32 = 16;
/// Stands for a schedule where the module ends. The checker allows no plan of so many.
const END: usize = (1 << SCHEDULE_BITS) - 1;
/// Bits of a shift's word that count the frame; the others are the shift, ns: nine minutes either way.
const FRAME_BITS: u32 = 24;
/// The largest shift that a word holds, ns. The checker allows no frame that could be moved further.
const MOST_SHIFT_NS: i64 = i64::MAX >> FRAME_BITS;

/// See the module's head.
#[derive(Debug)]
pub struct ScheduleSwitch {
    /// The decision about each of the last major frames: its number and its schedule.
    decisions: Box<[AtomicU64]>,
    /// By how much the end of each of the last major frames is moved: its number and the shift.
    shifts: Box<[AtomicU64]>,
    /// When the newest major frame began, module time, ns.
    newest_ns: AtomicU64,
    /// What is asked for: the number of the request and the schedule; 0: nothing.
    request: AtomicU64,
    requests: AtomicU64,
    /// The newest decision.
    newest: AtomicU64,
    /// When the newest change took effect, or the first frame began, module time, ns.
    changed_ns: AtomicU64,
}

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Requested {
    /// It takes effect at the start of the next major frame.
    Pending,
    /// The schedule runs already, and no other is asked for.
    Already,
}

impl ScheduleSwitch {
    /// The module starts with the schedule at place `initial` of the plan.
    #[must_use]
    pub fn new(initial: usize) -> Self {
        let decisions: Box<[AtomicU64]> = (0..HISTORY).map(|_| AtomicU64::new(EMPTY)).collect();
        let first = word(0, initial);
        Self {
            decisions,
            shifts: (0..HISTORY).map(|_| AtomicU64::new(EMPTY)).collect(),
            newest_ns: AtomicU64::new(0),
            request: AtomicU64::new(0),
            requests: AtomicU64::new(0),
            newest: AtomicU64::new(first),
            changed_ns: AtomicU64::new(0),
        }
    }

    /// Frame 0 is at `begin_ns` of module time: later than 0 where the module was reset.
    pub fn begin(&self, begin_ns: u64) {
        self.newest_ns.store(begin_ns, Release);
    }

    /// Asks for a schedule from the next major frame on. The last request wins, also over one that is pending.
    pub fn request(&self, schedule: usize) -> Requested {
        if self.pending().is_none() && self.current() == schedule {
            return Requested::Already;
        }
        // Numbered, so that a request is never taken for an older one of the same schedule.
        let number = self.requests.fetch_add(1, Relaxed) + 1;
        self.request.store(word(number, schedule), Release);
        Requested::Pending
    }

    /// The schedule of the newest major frame that any core has begun.
    #[must_use]
    pub fn current(&self) -> usize {
        schedule_of(self.newest.load(Acquire))
    }

    /// The schedule of the next major frame, as far as is known now.
    #[must_use]
    pub fn next(&self) -> usize {
        self.pending().unwrap_or_else(|| self.current())
    }

    /// When the newest change took effect, or the first frame began, module time, ns.
    #[must_use]
    pub fn changed_ns(&self) -> u64 {
        self.changed_ns.load(Acquire)
    }

    /// The newest major frame that any core has begun.
    #[must_use]
    pub fn newest_frame(&self) -> u64 {
        count_of(self.newest.load(Acquire))
    }

    /// When it began, module time, ns.
    #[must_use]
    pub fn newest_frame_ns(&self) -> u64 {
        self.newest_ns.load(Acquire)
    }

    /// Proposes to move the end of a major frame that has not begun by `shift_ns`, less than nine minutes. False: it has begun,
    /// or it was proposed already.
    pub fn propose_shift(&self, frame: u64, shift_ns: i64) -> bool {
        let cell = &self.shifts[(frame % HISTORY as u64) as usize];
        let seen = cell.load(Acquire);
        let free = !is_of(seen, frame) && frame > self.newest_frame();
        free && cell.compare_exchange(seen, shift_word(frame, shift_ns), AcqRel, Acquire).is_ok()
    }

    /// By how much the end of a major frame that begins, or has begun, is moved, ns. `None` if the caller was held up for so
    /// long that nobody remembers.
    #[must_use]
    pub fn shift(&self, frame: u64) -> Option<i64> {
        let cell = &self.shifts[(frame % HISTORY as u64) as usize];
        loop {
            let seen = cell.load(Acquire);
            if is_of(seen, frame) {
                return Some(seen.cast_signed() >> FRAME_BITS);
            }
            if seen != EMPTY && is_after(seen, frame) {
                return None;
            }
            // Nobody has proposed anything: from now on nobody can.
            let _ = cell.compare_exchange(seen, shift_word(frame, 0), AcqRel, Acquire);
        }
    }

    fn pending(&self) -> Option<usize> {
        match self.request.load(Acquire) {
            0 => None,
            request => Some(schedule_of(request)),
        }
    }

    /// What major frame `frame` runs, which starts at `start_ns` after one that ran `current`. The first core that asks decides for
    /// all, also whether the module has ended: it asks `stop`. `None` if the caller was held up for so long that nobody remembers.
    pub fn decide(
        &self,
        frame: u64,
        start_ns: u64,
        current: usize,
        stop: impl Fn() -> bool,
    ) -> Option<FrameDecision> {
        let cell = &self.decisions[(frame % HISTORY as u64) as usize];
        loop {
            let seen = cell.load(Acquire);
            if seen != EMPTY && count_of(seen) == frame {
                return Some(FrameDecision::of(seen));
            }
            if seen != EMPTY && count_of(seen) > frame {
                return None;
            }
            // Frame 0 runs what the module starts with.
            let request = if frame == 0 { 0 } else { self.request.load(Acquire) };
            let choice = match request {
                _ if stop() => END,
                0 => current,
                request => schedule_of(request),
            };
            if cell.compare_exchange(seen, word(frame, choice), AcqRel, Acquire).is_err() {
                continue; // another core was first: its decision counts
            }
            if choice != END {
                self.note_begun(frame, start_ns, choice, choice != current);
                if request != 0 {
                    // Fails where somebody has asked for another one meanwhile: that is the next frame's.
                    let _ = self.request.compare_exchange(request, 0, AcqRel, Relaxed);
                }
            }
            return Some(FrameDecision::of(word(frame, choice)));
        }
    }

    fn note_begun(&self, frame: u64, start_ns: u64, schedule: usize, is_change: bool) {
        if is_change {
            self.changed_ns.fetch_max(start_ns, AcqRel);
        }
        self.newest_ns.fetch_max(start_ns, AcqRel);
        self.newest.fetch_max(word(frame, schedule), AcqRel);
    }
}

/// What was decided about a major frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameDecision {
    /// It runs the schedule at this place of the plan.
    Run(usize),
    /// The module has ended with the frame before.
    End,
}

impl FrameDecision {
    fn of(word: u64) -> Self {
        match schedule_of(word) {
            END => Self::End,
            schedule => Self::Run(schedule),
        }
    }
}

fn shift_word(frame: u64, shift_ns: i64) -> u64 {
    // What does not fit would come out of it with another sign.
    let shift_ns = shift_ns.clamp(-MOST_SHIFT_NS, MOST_SHIFT_NS);
    (shift_ns << FRAME_BITS).cast_unsigned() | low(frame)
}

/// Cells are written anew every [`HISTORY`] frames: a number that has come round is never met.
fn is_of(word: u64, frame: u64) -> bool {
    word != EMPTY && word & ((1 << FRAME_BITS) - 1) == low(frame)
}

/// Whether the word is that of a later frame.
fn is_after(word: u64, frame: u64) -> bool {
    low(word.wrapping_sub(frame)) < 1 << (FRAME_BITS - 1)
}

fn low(frame: u64) -> u64 {
    frame & ((1 << FRAME_BITS) - 1)
}

fn word(count: u64, schedule: usize) -> u64 {
    count << SCHEDULE_BITS | schedule as u64
}

fn count_of(word: u64) -> u64 {
    word >> SCHEDULE_BITS
}

fn schedule_of(word: u64) -> usize {
    (word & ((1 << SCHEDULE_BITS) - 1)) as usize
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use super::*;

    /// The schedule of a frame of a module that goes on.
    fn run(schedule_switch: &ScheduleSwitch, frame: u64, start_ns: u64, current: usize) -> Option<usize> {
        match schedule_switch.decide(frame, start_ns, current, || false)? {
            FrameDecision::Run(schedule) => Some(schedule),
            FrameDecision::End => panic!("nobody has asked for an end"),
        }
    }

    #[test]
    fn a_frame_that_one_core_has_begun_is_run_by_all_and_one_that_a_core_has_ended_by_none() {
        for frame in [0, 1, 77] {
            let schedule_switch = ScheduleSwitch::new(0);
            assert_eq!(run(&schedule_switch, frame, 10, 0), Some(0));
            let late = schedule_switch.decide(frame, 10, 0, || true);
            assert_eq!(
                late,
                Some(FrameDecision::Run(0)),
                "a core that saw the stop first would leave the other alone"
            );
            assert_eq!(schedule_switch.decide(frame + 1, 20, 0, || true), Some(FrameDecision::End));
            let early = schedule_switch.decide(frame + 1, 20, 0, || false);
            assert_eq!(early, Some(FrameDecision::End), "a core that looked before the stop would run alone");
            assert_eq!(schedule_switch.newest_frame(), frame);
        }
    }

    #[test]
    fn a_request_before_frame_0_takes_effect_with_frame_1() {
        let schedule_switch = ScheduleSwitch::new(0);
        schedule_switch.request(1);
        assert_eq!(run(&schedule_switch, 0, 0, 0), Some(0));
        assert_eq!(run(&schedule_switch, 1, 10, 0), Some(1));
    }

    #[test]
    fn a_request_takes_effect_at_the_next_frame_and_once() {
        let schedule_switch = ScheduleSwitch::new(0);
        assert_eq!(run(&schedule_switch, 1, 10, 0), Some(0));
        assert_eq!(schedule_switch.request(2), Requested::Pending);
        assert_eq!(
            (schedule_switch.current(), schedule_switch.next(), schedule_switch.changed_ns()),
            (0, 2, 0)
        );
        assert_eq!(run(&schedule_switch, 2, 20, 0), Some(2));
        assert_eq!(
            (schedule_switch.current(), schedule_switch.next(), schedule_switch.changed_ns()),
            (2, 2, 20)
        );
        assert_eq!(run(&schedule_switch, 3, 30, 2), Some(2));
        assert_eq!(schedule_switch.changed_ns(), 20);
    }

    #[test]
    fn the_last_request_wins_and_the_current_schedule_calls_a_pending_one_off() {
        let schedule_switch = ScheduleSwitch::new(0);
        schedule_switch.request(1);
        schedule_switch.request(2);
        assert_eq!(run(&schedule_switch, 1, 10, 0), Some(2));
        schedule_switch.request(1);
        assert_eq!(schedule_switch.request(2), Requested::Pending);
        assert_eq!(run(&schedule_switch, 2, 20, 2), Some(2));
        assert_eq!((schedule_switch.changed_ns(), schedule_switch.request(2)), (10, Requested::Already));
    }

    #[test]
    fn a_core_that_comes_late_finds_what_the_first_one_decided() {
        let schedule_switch = ScheduleSwitch::new(0);
        assert_eq!(run(&schedule_switch, 1, 10, 0), Some(0));
        schedule_switch.request(1);
        // The other core is late for frame 1: the request came after that was decided.
        assert_eq!(run(&schedule_switch, 2, 20, 0), Some(1));
        assert_eq!(run(&schedule_switch, 1, 10, 0), Some(0));
        assert_eq!(run(&schedule_switch, 2, 20, 0), Some(1));
    }

    #[test]
    fn a_core_that_was_away_for_longer_than_anybody_remembers_is_told_so() {
        let schedule_switch = ScheduleSwitch::new(0);
        for frame in 1..=HISTORY as u64 + 1 {
            assert_eq!(run(&schedule_switch, frame, frame, 0), Some(0));
        }
        assert_eq!(run(&schedule_switch, 1, 1, 0), None);
        assert_eq!(run(&schedule_switch, 2, 2, 0), Some(0));
    }

    #[test]
    fn the_end_of_a_frame_is_moved_as_was_proposed_before_it_began_and_else_not() {
        let schedule_switch = ScheduleSwitch::new(0);
        assert_eq!(schedule_switch.shift(0), Some(0));
        assert!(
            schedule_switch.propose_shift(1, -37) && !schedule_switch.propose_shift(1, 5),
            "the first counts"
        );
        run(&schedule_switch, 1, 10, 0);
        assert_eq!(
            (schedule_switch.shift(1), schedule_switch.newest_frame(), schedule_switch.newest_frame_ns()),
            (Some(-37), 1, 10)
        );
        run(&schedule_switch, 2, 20, 0);
        assert_eq!(schedule_switch.shift(2), Some(0));
        assert!(!schedule_switch.propose_shift(2, 9), "it has begun");
        assert_eq!((schedule_switch.shift(2), schedule_switch.shift(1)), (Some(0), Some(-37)));
        assert!(schedule_switch.propose_shift(3, 99_000_000_000));
        assert_eq!(schedule_switch.shift(3), Some(99_000_000_000));
    }

    #[test]
    fn a_shift_that_no_word_holds_is_the_longest_one_and_never_one_backwards() {
        let schedule_switch = ScheduleSwitch::new(0);
        assert!(
            schedule_switch.propose_shift(1, 600_000_000_000) && schedule_switch.propose_shift(2, i64::MIN)
        );
        run(&schedule_switch, 1, 10, 0);
        assert_eq!(schedule_switch.shift(1), Some(MOST_SHIFT_NS));
        run(&schedule_switch, 2, 20, 0);
        assert_eq!(schedule_switch.shift(2), Some(-MOST_SHIFT_NS));
        const { assert!(MOST_SHIFT_NS > 9 * 60 * 1_000_000_000) };
    }

    #[test]
    fn shifts_are_found_for_as_long_as_decisions() {
        let schedule_switch = ScheduleSwitch::new(0);
        for frame in 1..=2 * HISTORY as u64 {
            schedule_switch.propose_shift(frame, frame as i64);
            run(&schedule_switch, frame, frame, 0);
            assert_eq!(schedule_switch.shift(frame), Some(frame as i64));
        }
        assert_eq!(schedule_switch.shift(HISTORY as u64), None);
        assert_eq!(schedule_switch.shift(HISTORY as u64 + 1), Some(HISTORY as i64 + 1));
    }

    #[test]
    fn cores_and_proposals_at_once_agree_on_the_end_of_every_frame() {
        let schedule_switch = std::sync::Arc::new(ScheduleSwitch::new(0));
        let walk = || {
            let schedule_switch = schedule_switch.clone();
            std::thread::spawn(move || {
                let frames = 1..3000;
                let ends = frames.map(|frame| {
                    run(&schedule_switch, frame, frame, 0);
                    schedule_switch.shift(frame).unwrap()
                });
                ends.collect::<Vec<_>>()
            })
        };
        let (one, other) = (walk(), walk());
        let mut taken = vec![0; 3001];
        while schedule_switch.newest_frame() < 2999 {
            let frame = schedule_switch.newest_frame() + 1;
            if schedule_switch.propose_shift(frame, frame as i64) {
                taken[frame as usize] = frame as i64;
            }
        }
        let ends = one.join().unwrap();
        assert_eq!(ends, other.join().unwrap());
        assert_eq!(ends, taken[1..3000]);
    }

    #[test]
    fn cores_that_decide_at_once_agree_on_every_frame() {
        let schedule_switch = std::sync::Arc::new(ScheduleSwitch::new(0));
        let walk = |schedule_switch: std::sync::Arc<ScheduleSwitch>| {
            move || {
                let mut current = 0;
                let frames = 1..3000;
                frames
                    .map(|frame| {
                        current = run(&schedule_switch, frame, frame, current).unwrap();
                        schedule_switch.request((frame % 5) as usize);
                        current
                    })
                    .collect::<Vec<usize>>()
            }
        };
        let threads: Vec<_> = (0..3).map(|_| std::thread::spawn(walk(schedule_switch.clone()))).collect();
        let seen: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
        assert!(seen.windows(2).all(|pair| pair[0] == pair[1]));
        assert!(seen[0].iter().any(|schedule| *schedule != 0));
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::sync::Arc;
    use loom::thread;

    use super::*;
    use crate::sync::Ordering::SeqCst;
    use crate::sync::{AtomicBool, explore};

    /// What a core runs in the frames from 1 on, until the module ends.
    fn core(switch: &ScheduleSwitch, stop: &AtomicBool) -> Vec<usize> {
        let (mut ran, mut current) = (Vec::new(), 0);
        for frame in 1..3 {
            match switch.decide(frame, frame * 10, current, || stop.load(SeqCst)) {
                Some(FrameDecision::Run(schedule)) => current = schedule,
                _ => break,
            }
            ran.push(current);
        }
        ran
    }

    /// Two cores, and a third party that does `what`: both cores run the same.
    fn agree(what: fn(&ScheduleSwitch, &AtomicBool)) {
        explore(move || {
            let shared = Arc::new((ScheduleSwitch::new(0), AtomicBool::new(false)));
            let other = {
                let shared = shared.clone();
                thread::spawn(move || core(&shared.0, &shared.1))
            };
            let operator = {
                let shared = shared.clone();
                thread::spawn(move || what(&shared.0, &shared.1))
            };
            let own = core(&shared.0, &shared.1);
            operator.join().unwrap();
            assert_eq!(own, other.join().unwrap());
        });
    }

    #[test]
    fn model_schedule_switch_cores_change_together_whenever_it_is_asked_for() {
        agree(|switch, _| {
            switch.request(1);
        });
    }

    #[test]
    fn model_schedule_switch_cores_end_together_whenever_the_stop_comes() {
        agree(|_, stop| stop.store(true, SeqCst));
    }

    #[test]
    fn model_schedule_switch_a_frame_is_moved_for_both_cores_or_for_none() {
        explore(|| {
            let switch = Arc::new(ScheduleSwitch::new(0));
            let cores = [(); 2].map(|()| {
                let switch = switch.clone();
                thread::spawn(move || {
                    let _ = switch.decide(1, 10, 0, || false);
                    switch.shift(1)
                })
            });
            let taken = switch.propose_shift(1, 5);
            let [one, other] = cores.map(|core| core.join().unwrap());
            assert_eq!(one, other);
            assert_eq!(one, Some(if taken { 5 } else { 0 }));
        });
    }
}
