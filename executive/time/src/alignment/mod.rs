//! The major frames of a module that follows another one, or the machine's disciplined clock: when to move the end of a frame,
//! and by how much.
//!
//! Module time itself is the machine's monotonic clock and is never corrected; frames are moved on it. What is measured speaks
//! of a frame that has begun; a correction is decided for the end of one that has not. So every correction between the two
//! is known and counted, and none is made twice. Nothing here waits or asks a clock: it is stepped by the monitor, and every
//! dispatcher finds the correction in the [`ScheduleSwitch`].

use std::collections::VecDeque;

use bateleur_contract::AlignmentTold;

use crate::schedule_switch::ScheduleSwitch;
use bateleur_plan::{ModuleClock, ModuleId, Plan, Timeline};
pub use law::{Law, Taken, nearest};
pub use realtime::{Realtime, Sample};

mod law;
mod realtime;
#[cfg(test)]
mod tests;

/// The most that the end of a frame is moved, as a share of its length: a thousandth …
const SHARE: u64 = 1_000;
/// … and not more than this, ns.
const MOST_NS: u64 = 100_000;
/// So many frames that have passed can still be spoken of.
const PAST: usize = 64;
/// A phase of more than so many of the largest corrections is taken in one piece, where that is allowed.
const COARSE: f64 = 10.0;
/// Measurements before that.
const COARSE_AFTER: u64 = 4;
/// For how long after frame 0 that is allowed, module time, ns: later an aircraft may be flying.
const COARSE_WITHIN_NS: u64 = 10_000_000_000;
/// How long the first alignment may take, module time, ns, before it counts as lost.
const PATIENCE_NS: u64 = 10_000_000_000;
/// For how many frames an error must hold before it is one, and must be gone before it is none.
const FRAMES: u32 = 3;

/// What the major frames of a module follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Following {
    /// Whom.
    pub reference: Reference,
    /// A larger error means that it is lost, ns.
    pub within_ns: u64,
    /// After so long without a measurement it is lost, ns.
    pub lost_after_ns: u64,
    /// A clock that is known worse than this, for as long, is lost too, ns.
    pub known_within_ns: u64,
}

/// Whom a module's frames can follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reference {
    /// Another module, by name: its relay measures.
    Module(String),
    /// The machine's CLOCK_REALTIME: frames begin at its multiples of the major frame.
    Realtime,
}

impl Reference {
    /// In words.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Module(name) => name,
            Self::Realtime => "realtime",
        }
    }
}

/// For how long CLOCK_REALTIME may be unsynchronised until that counts, ns: a daemon that is started again takes a while.
const REALTIME_LOST_AFTER_NS: u64 = 5_000_000_000;
/// How well CLOCK_REALTIME has to be kept, ns, where the plan does not allow more: what the kernel believes of it grows by half a
/// millisecond each second since a daemon has spoken last, and some speak once a second.
const REALTIME_KNOWN_WITHIN_NS: u64 = 1_000_000;
/// Frames without a measurement after which it counts as lost at the earliest: a link may be silent for a moment.
const SILENT_FRAMES: u64 = 10;

impl Following {
    /// As the plan says; `None` if the module follows nobody.
    #[must_use]
    pub fn of(plan: &Plan, module: ModuleId) -> Option<Self> {
        if plan[module].clock == ModuleClock::Realtime {
            let (within_ns, lost_after_ns) = (plan[module].follows_within_ns, REALTIME_LOST_AFTER_NS);
            let known_within_ns = within_ns.max(REALTIME_KNOWN_WITHIN_NS);
            return Some(Self { reference: Reference::Realtime, within_ns, lost_after_ns, known_within_ns });
        }
        let leader = plan[module].follows?;
        let joins = |link: &&bateleur_plan::Link| link.peer_of(module) == Some(leader);
        let silence_ns = plan.links.iter().find(joins).map_or(0, |link| link.lost_after_ns);
        let frame_ns = plan.schedules.iter().map(|schedule| schedule.major_frame_ns).max().unwrap_or(0);
        Some(Self {
            reference: Reference::Module(plan[leader].name.clone()),
            within_ns: plan[module].follows_within_ns,
            known_within_ns: plan[module].follows_within_ns,
            lost_after_ns: silence_ns.max(SILENT_FRAMES * frame_ns),
        })
    }
}

/// How it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// It was not aligned yet.
    Seeking,
    /// Its frames begin with the others'.
    Locked,
    /// They did, or should have.
    Lost,
}

impl State {
    /// Its word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Seeking => "seeking",
            Self::Locked => "locked",
            Self::Lost => "lost",
        }
    }
}

/// What has changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// The frames are aligned, for the first time or again.
    Locked,
    /// They are not any more, and why.
    Lost(String),
}

/// How far a frame's end may be moved, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Ahead.
    pub early_ns: u64,
    /// Back.
    pub late_ns: u64,
    /// The length of the frame.
    pub length_ns: u64,
}

impl Limits {
    /// Of a schedule: no window loses more than half of itself at the frame's end.
    #[must_use]
    pub fn of(timeline: &Timeline) -> Self {
        let length_ns = timeline.major_frame_ns;
        let late_ns = (length_ns / SHARE).min(MOST_NS);
        let last = timeline.cores.iter().filter_map(|line| line.windows.last());
        let room = last.map(|last| length_ns.saturating_sub(last.start_ns + last.duration_ns() / 2));
        Self { early_ns: room.min().unwrap_or(late_ns).min(late_ns), late_ns, length_ns }
    }
}

/// A measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The own frame that it speaks of.
    pub frame: u64,
    /// How much later the other one begins, ns; whole frames more or less say the same.
    pub phase_ns: f64,
    /// The truth lies no further away, ns.
    pub uncertainty_ns: f64,
    /// How far the other side's clock itself may be off, with that, ns.
    pub known_within_ns: f64,
}

/// See the module's head.
#[derive(Debug)]
pub struct Aligner {
    following: Following,
    law: Law,
    /// Of each schedule of the plan.
    limits: Vec<Limits>,
    /// The place of the schedule of the last step.
    schedule: usize,
    /// The first frame whose end is not decided yet; the law speaks of its start.
    next: u64,
    /// Of the frames before it, the latest last: how their ends were moved, ns.
    past: VecDeque<i64>,
    begun_ns: Option<u64>,
    coarse_done: bool,
    /// When something was measured that counted, module time, ns.
    measured_ns: Option<u64>,
    /// When something did that was known well enough, module time, ns.
    certain_ns: Option<u64>,
    state: State,
    /// Frames for which the state should be another one.
    otherwise: u32,
    exchanges: Option<u32>,
    /// Why nothing is measured, where that is known.
    silence: Option<String>,
    figures: Figures,
}

/// How the alignment is, for whoever asks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figures {
    /// The last measured phase, ns.
    pub measured_ns: Option<f64>,
    /// Its uncertainty, ns.
    pub uncertainty_ns: f64,
    /// The last correction, ns.
    pub shift_ns: i64,
    /// Measurements that counted.
    pub measurements: u64,
    /// Measurements that were not believed.
    pub refused: u64,
    /// How often it was lost.
    pub lost: u64,
}

impl Aligner {
    /// `timelines`: one for each schedule of the plan.
    #[must_use]
    pub fn new(following: Following, timelines: &[Timeline]) -> Self {
        Self {
            following,
            law: Law::default(),
            limits: timelines.iter().map(Limits::of).collect(),
            schedule: 0,
            next: 0,
            past: VecDeque::with_capacity(PAST),
            begun_ns: None,
            coarse_done: false,
            measured_ns: None,
            certain_ns: None,
            state: State::Seeking,
            otherwise: 0,
            exchanges: None,
            silence: None,
            figures: Figures::default(),
        }
    }

    /// Whom it follows.
    #[must_use]
    pub fn following(&self) -> &Following {
        &self.following
    }

    /// How it stands.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// What is known of phase and drift.
    #[must_use]
    pub fn law(&self) -> &Law {
        &self.law
    }

    /// See [`Figures`].
    #[must_use]
    pub fn figures(&self) -> Figures {
        self.figures
    }

    /// What a relay has told; nothing of it is believed that can not be. News is only what rests on another exchange.
    #[must_use]
    pub fn heard(&mut self, told: &AlignmentTold, newest_frame: u64) -> Option<Measured> {
        if self.exchanges.replace(told.report.exchanges) == Some(told.report.exchanges) {
            return None;
        }
        (told.major_frame <= newest_frame).then(|| Measured {
            frame: told.major_frame,
            phase_ns: told.report.peer_minus_own_ns as f64,
            uncertainty_ns: f64::from(told.report.uncertainty_ns),
            known_within_ns: f64::from(told.report.uncertainty_ns),
        })
    }

    /// What a look at the disciplined clock says of a frame that began at `start_ns` of the monotonic clock.
    #[must_use]
    pub fn read(&self, frame: u64, start_ns: u64, sample: &Sample) -> Option<Measured> {
        let length_ns = self.limits.get(self.schedule)?.length_ns;
        let phase_ns = realtime::phase_ns(start_ns, sample.offset_ns, length_ns);
        let uncertainty_ns = sample.uncertainty_ns as f64;
        // That the machine's clock is off makes its frames no less steady.
        let known_within_ns = uncertainty_ns + sample.error_ns as f64;
        Some(Measured { frame, phase_ns, uncertainty_ns, known_within_ns })
    }

    /// Why nothing is measured, for the words of an error.
    pub fn silent(&mut self, why: Option<String>) {
        self.silence = why;
    }

    /// Takes what was measured since the last step, decides about the end of the next frame, and says what has changed.
    pub fn step(
        &mut self,
        schedule_switch: &ScheduleSwitch,
        module_ns: u64,
        measured: Option<Measured>,
    ) -> Option<Change> {
        let begun_ns = *self.begun_ns.get_or_insert(module_ns);
        let (newest, schedule) = (schedule_switch.newest_frame(), schedule_switch.current());
        let limits = *self.limits.get(schedule)?;
        self.schedule = schedule;
        self.settle(schedule_switch, newest, limits.length_ns);
        if let Some(measured) = measured {
            self.take(&measured, limits.length_ns, module_ns);
        }
        if self.next > newest + 1 {
            return None; // the next frame's end is decided
        }
        let shift_ns = self.wanted_ns(&limits, module_ns.saturating_sub(begun_ns));
        if !schedule_switch.propose_shift(self.next, shift_ns) {
            return None; // it has just begun: settled in the next step
        }
        if shift_ns > limits.late_ns as i64 {
            self.coarse_done = true;
        }
        self.figures.shift_ns = shift_ns;
        self.pass(shift_ns, limits.length_ns);
        self.judge(&limits, module_ns, begun_ns)
    }

    /// Frames that have begun can not be changed any more.
    fn settle(&mut self, schedule_switch: &ScheduleSwitch, newest: u64, length_ns: u64) {
        if newest.saturating_sub(self.next) > PAST as u64 {
            // The monitor was held up for longer than anybody speaks of: what is known of the phase is what is measured next.
            self.past.clear();
            self.next = newest;
        }
        while self.next <= newest {
            let shift_ns = schedule_switch.shift(self.next).unwrap_or(0);
            self.pass(shift_ns, length_ns);
        }
    }

    fn pass(&mut self, shift_ns: i64, length_ns: u64) {
        self.law.pass(length_ns, shift_ns);
        if self.past.len() == PAST {
            self.past.pop_front();
        }
        self.past.push_back(shift_ns);
        self.next += 1;
    }

    fn take(&mut self, measured: &Measured, length_ns: u64, module_ns: u64) {
        let Some(back) = self.next.checked_sub(measured.frame).map(|back| back as usize) else { return };
        if back > self.past.len() {
            return;
        }
        let moved_ns: i64 = self.past.iter().rev().take(back).sum();
        let drifted_ns = self.law.drift_ppb() * (length_ns as f64 / 1e9) * back as f64;
        let phase_ns = measured.phase_ns + drifted_ns - moved_ns as f64;
        match self.law.measure(phase_ns, measured.uncertainty_ns, length_ns) {
            Taken::Refused => self.figures.refused += 1,
            Taken::Yes | Taken::Anew => {
                self.figures.measurements += 1;
                self.measured_ns = Some(module_ns);
                if measured.known_within_ns <= self.following.known_within_ns as f64 {
                    self.certain_ns = Some(module_ns);
                }
            }
        }
        self.figures.measured_ns = Some(nearest(measured.phase_ns, length_ns));
        self.figures.uncertainty_ns = measured.known_within_ns;
    }

    fn wanted_ns(&self, limits: &Limits, age_ns: u64) -> i64 {
        let Some(phase_ns) = self.law.phase_ns() else { return 0 };
        let coarse = !self.coarse_done
            && self.state == State::Seeking
            && age_ns < COARSE_WITHIN_NS
            && phase_ns.abs() > COARSE * limits.late_ns as f64;
        if !coarse {
            return self.law.shift_ns(limits.length_ns, limits.early_ns, limits.late_ns);
        }
        if self.law.measured() < COARSE_AFTER {
            return 0;
        }
        // A frame is made longer, never shorter: nobody loses a window by it.
        let later = if phase_ns > 0.0 { phase_ns } else { phase_ns + limits.length_ns as f64 };
        later.round() as i64
    }

    /// Whether it is aligned, frame by frame.
    fn judge(&mut self, limits: &Limits, module_ns: u64, begun_ns: u64) -> Option<Change> {
        let silent_ns = module_ns.saturating_sub(self.measured_ns.unwrap_or(begun_ns));
        let silent = silent_ns > self.following.lost_after_ns;
        let within = self.following.within_ns as f64;
        let error_ns = self.law.phase_ns().map_or(f64::INFINITY, f64::abs);
        let doubtful_ns = module_ns.saturating_sub(self.certain_ns.unwrap_or(begun_ns));
        let certain = self.certain_ns.is_some() && doubtful_ns <= self.following.lost_after_ns;
        let good = !silent && certain && error_ns <= within && self.law.deviation_ns() <= within;
        let (other, reached) = match self.state {
            State::Locked => (!good, State::Lost),
            State::Lost => (good && error_ns <= within / 2.0, State::Locked),
            State::Seeking if good => (error_ns <= within / 2.0, State::Locked),
            State::Seeking => (module_ns.saturating_sub(begun_ns) > PATIENCE_NS, State::Lost),
        };
        self.otherwise = if other { self.otherwise + 1 } else { 0 };
        if self.otherwise < FRAMES {
            return None;
        }
        self.otherwise = 0;
        self.state = reached;
        if reached == State::Locked {
            return Some(Change::Locked);
        }
        self.figures.lost += 1;
        let doubtful_ns = (!certain).then_some(doubtful_ns);
        Some(Change::Lost(self.why_lost((silent.then_some(silent_ns), doubtful_ns), error_ns, limits)))
    }

    fn why_lost(
        &self,
        (silent_ns, doubtful_ns): (Option<u64>, Option<u64>),
        error_ns: f64,
        limits: &Limits,
    ) -> String {
        let whom = self.following.reference.name();
        let because = self.silence.as_ref().map(|why| format!(": {why}")).unwrap_or_default();
        match (silent_ns, self.measured_ns) {
            (Some(_), None) => format!("nothing was heard of {whom} since frame 0{because}"),
            (Some(silent_ns), Some(_)) => {
                let bound_us = self.law.deviation_ns() * 3.0 / 1e3;
                format!(
                    "nothing was heard of {whom} for {:.1} s{because}; its frames go on with the last drift, {:.2} ppm, \
                     {bound_us:.0} us off by now at most",
                    silent_ns as f64 / 1e9,
                    self.law.drift_ppb() / 1e3
                )
            }
            (None, _) if doubtful_ns.is_some() => format!(
                "the clock of {whom} has not been known to {:.0} us for {:.1} s, but to {:.0} us",
                self.following.known_within_ns as f64 / 1e3,
                doubtful_ns.unwrap_or_default() as f64 / 1e9,
                self.figures.uncertainty_ns / 1e3
            ),
            (None, _) => format!(
                "frames begin {:.0} us beside those of {whom}, more than {:.0} us; each is moved by {:.0} us at most",
                error_ns / 1e3,
                self.following.within_ns as f64 / 1e3,
                limits.late_ns as f64 / 1e3
            ),
        }
    }
}
