//! The dispatcher: grants windows at their instants, on the wall clock or on the virtual one, by the same logic.
//!
//! Responsible for: walking the switch instants of the major frame, for ever, from the origin, changing to another
//! schedule at the start of a major frame, and moving its end where the module follows another one's frames. It must never wait for a partition on the wall clock, allocate, log, or shift
//! a window because an earlier one was late.
//!
//! How time passes is a [`Pace`], how a window is opened and closed is a [`Gate`]; both are traits, so that the logic
//! is tested without processes and without time.

use std::sync::Arc;

use crate::schedule_switch::{FrameDecision, ScheduleSwitch};
use bateleur_plan::{Timeline, TimelineWindow};

/// A switch that comes later than this is counted as late, ns. A fiftieth of the shortest sensible window period
/// (10 ms): later than that, a control loop notices. Too small a value would count the noise of the machine.
pub const LATE_NS: u64 = 200_000;

/// How time passes.
pub trait Pace {
    /// Returns at `instant_ns` of module time, or as soon after as it can; gives how late, ns.
    fn reach(&mut self, instant_ns: u64, meanwhile: &mut dyn Meanwhile) -> u64;
    /// As [`Pace::reach`], for an instant at which windows end and nothing begins.
    fn pass(&mut self, instant_ns: u64, meanwhile: &mut dyn Meanwhile) -> u64 {
        self.reach(instant_ns, meanwhile)
    }
}

/// What can be done with the time until the next switch.
pub trait Meanwhile {
    /// Whether the processor is free: the window before was closed early.
    fn has_slack(&mut self) -> bool;
    /// Sleeps until the open window is closed, or until this instant of CLOCK_MONOTONIC, ns; may return before either.
    fn await_close(&mut self, until_ns: u64);
    /// Whether a partition whose window has ended could run on in slack, because the kernel does not know yet that it is to be stopped.
    fn may_run_on(&self) -> bool {
        false
    }
    /// How long before the switch the window that opens there, if one does, is to be prepared, ns.
    fn lead_ns(&self) -> u64;
    /// Gets ready for the window that opens at the switch, if one does.
    fn prepare(&mut self);
}

/// How windows open and close.
pub trait Gate {
    /// A minor frame begins; false: the module stops here.
    fn minor_frame(&mut self, instant_ns: u64) -> bool;
    /// See [`Meanwhile::may_run_on`].
    fn may_run_on(&self) -> bool {
        false
    }
    /// See [`Meanwhile::lead_ns`].
    fn lead_ns(&self, _window: &TimelineWindow) -> u64 {
        0
    }
    /// Gets ready to open `window`, ahead of its instant.
    fn prepare(&mut self, window: &TimelineWindow);
    /// Whether the partition of an open window is done with it.
    fn is_done(&mut self, window: &TimelineWindow) -> bool;
    /// Sleeps until the partition closes an open window, or until this instant of CLOCK_MONOTONIC, ns; may return before
    /// either, and does where windows take no time.
    fn await_close(&mut self, _window: &TimelineWindow, _until_ns: u64) {}
    /// Opens a window.
    fn open(&mut self, occurrence: &Occurrence);
    /// Closes it.
    fn close(&mut self, occurrence: &Occurrence, ending: Ending);
}

/// One window of one major frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Occurrence {
    /// The window in the timeline.
    pub window: TimelineWindow,
    /// The core.
    pub core: u32,
    /// The rule of the schedule that the window belongs to.
    pub epoch: ScheduleEpoch,
    /// Major frames before this one.
    pub major_frame: u64,
    /// Minor frames since frame 0.
    pub minor_frames: u64,
    /// The length of a minor frame, ns.
    pub minor_frame_ns: u64,
    /// Its planned start, module time, ns.
    pub start_ns: u64,
    /// Its planned end, module time, ns.
    pub end_ns: u64,
    /// How late the dispatcher itself was at the start, ns.
    pub late_ns: u64,
}

impl Occurrence {
    /// When its major frame began, module time, ns.
    #[must_use]
    pub fn major_frame_ns(&self) -> u64 {
        self.start_ns - self.window.start_ns
    }
}

/// The time of one schedule, from one change to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScheduleEpoch {
    /// Changes before it.
    pub number: u32,
    /// The place of its schedule in the plan.
    pub schedule: usize,
    /// The place of the schedule before; `None` if the module has not changed yet.
    pub after: Option<usize>,
    /// Its start, module time, ns.
    pub since_ns: u64,
}

/// How the dispatcher came to a window's end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Ending {
    /// How late it was, ns.
    pub late_ns: u64,
    /// The next window begins at the same instant: one switch, which that window's start counts.
    pub shared: bool,
}

/// What happens at one instant of the major frame on one core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Switch {
    at_ns: u64,
    /// Place of the core in the list.
    lane: usize,
    closes: bool,
    opens: Option<TimelineWindow>,
    minor_frame: bool,
    /// A window or a minor frame begins at this instant, on whichever core.
    begins: bool,
}

/// The switch instants of one schedule over its major frame.
#[derive(Debug, Clone)]
struct Table {
    switches: Vec<Switch>,
    major_frame_ns: u64,
    minor_frame_ns: u64,
}

/// The major frame that runs.
#[derive(Debug, Clone, Copy)]
struct Frame {
    number: u64,
    start_ns: u64,
    /// By how much its end is moved, ns.
    shift_ns: i64,
    /// Minor frames before it.
    minor_frames: u64,
    epoch: ScheduleEpoch,
}

/// What all cores agree on for a major frame.
enum Decided {
    /// It runs like this.
    Runs(Frame),
    /// The module has ended with the frame before.
    Ends,
    /// This core was away for too long to know.
    Forgotten,
}

/// The switch instants of some cores, for every schedule of the plan.
#[derive(Debug)]
pub struct Dispatcher {
    tables: Vec<Table>,
    schedule_switch: Arc<ScheduleSwitch>,
    cores: Vec<u32>,
    open: Vec<Option<Occurrence>>,
    begin_ns: u64,
}

impl Dispatcher {
    /// A dispatcher for the cores that `wanted` picks. `timelines`: one for each schedule of the plan, of one module.
    /// `minor_frames`: whether the gate is told about each minor frame.
    #[must_use]
    pub fn new(
        timelines: &[Timeline],
        schedule_switch: Arc<ScheduleSwitch>,
        minor_frames: bool,
        wanted: impl Fn(u32) -> bool,
    ) -> Self {
        let lines = timelines.first().into_iter().flat_map(|timeline| &timeline.cores);
        let cores: Vec<u32> = lines.map(|line| line.core).filter(|core| wanted(*core)).collect();
        let tables = timelines.iter().map(|timeline| Table::of(timeline, &cores, minor_frames)).collect();
        Self { tables, schedule_switch, open: vec![None; cores.len()], cores, begin_ns: 0 }
    }

    /// Frame 0 is at `begin_ns` of module time: that of a module that was reset.
    #[must_use]
    pub fn beginning_at(self, begin_ns: u64) -> Self {
        Self { begin_ns, ..self }
    }

    /// Runs major frames until the gate says that the module stops, or `stop` says so of the start of a major frame, module
    /// time, ns, to the first core that comes to it. False: this core was away for too long to know what runs.
    pub fn run(&mut self, pace: &mut dyn Pace, gate: &mut dyn Gate, stop: &dyn Fn(u64) -> bool) -> bool {
        let mut orderly = true;
        let schedule = self.schedule_switch.current();
        let epoch = ScheduleEpoch { number: 0, schedule, after: None, since_ns: self.begin_ns };
        let mut next =
            Some(Frame { number: 0, start_ns: self.begin_ns, shift_ns: 0, minor_frames: 0, epoch });
        while let Some(before) = next.take() {
            let late_ns = self.reach_frame(&before, pace, gate);
            // Only now, at its very start, is it decided what the frame runs, or whether the module ends with the one before.
            let frame = match self.decided(before, stop) {
                Decided::Runs(frame) => frame,
                Decided::Ends => break,
                Decided::Forgotten => {
                    orderly = false;
                    break;
                }
            };
            self.close_all(&frame, late_ns, gate);
            if self.major_frame(&frame, late_ns, pace, gate) {
                next = Some(self.following(&frame));
            }
        }
        for open in self.open.iter_mut().filter_map(Option::take) {
            gate.close(&open, Ending::default());
        }
        orderly
    }

    /// The start of a major frame.
    fn reach_frame(&self, frame: &Frame, pace: &mut dyn Pace, gate: &mut dyn Gate) -> u64 {
        // With one schedule it is known before what comes first; with several, nobody is thawed whose window may not come.
        let first = match self.tables.as_slice() {
            [only] => only.first().find_map(|switch| switch.opens),
            _ => None,
        };
        pace.reach(frame.start_ns, &mut Between { gate, open: &self.open, opens: first })
    }

    /// Ends the windows that last until the end of the frame before.
    fn close_all(&mut self, frame: &Frame, late_ns: u64, gate: &mut dyn Gate) {
        let table = &self.tables[frame.epoch.schedule];
        for (lane, open) in self.open.iter_mut().enumerate() {
            let Some(open) = open.take() else { continue };
            let shared = table.first().any(|switch| switch.lane == lane && switch.opens.is_some());
            gate.close(&open, Ending { late_ns, shared });
        }
    }

    /// The frame with the schedule that all cores agree on.
    fn decided(&self, frame: Frame, stop: &dyn Fn(u64) -> bool) -> Decided {
        let before = frame.epoch;
        let stop = || stop(frame.start_ns);
        let schedule = match self.schedule_switch.decide(frame.number, frame.start_ns, before.schedule, stop)
        {
            Some(FrameDecision::Run(schedule)) => schedule,
            Some(FrameDecision::End) => return Decided::Ends,
            None => return Decided::Forgotten,
        };
        let Some(shift_ns) = self.schedule_switch.shift(frame.number) else { return Decided::Forgotten };
        let frame = Frame { shift_ns, ..frame };
        if schedule == before.schedule {
            return Decided::Runs(frame);
        }
        let epoch = ScheduleEpoch {
            number: before.number + 1,
            schedule,
            after: Some(before.schedule),
            since_ns: frame.start_ns,
        };
        Decided::Runs(Frame { epoch, ..frame })
    }

    fn following(&self, frame: &Frame) -> Frame {
        let table = &self.tables[frame.epoch.schedule];
        Frame {
            number: frame.number + 1,
            start_ns: self.end_ns(frame),
            shift_ns: 0,
            minor_frames: frame.minor_frames + table.major_frame_ns / table.minor_frame_ns,
            epoch: frame.epoch,
        }
    }

    /// When a frame ends, module time, ns.
    fn end_ns(&self, frame: &Frame) -> u64 {
        (frame.start_ns + self.tables[frame.epoch.schedule].major_frame_ns)
            .saturating_add_signed(frame.shift_ns)
    }

    fn major_frame(&mut self, frame: &Frame, late_ns: u64, pace: &mut dyn Pace, gate: &mut dyn Gate) -> bool {
        let (mut reached_ns, mut late_ns) = (frame.start_ns, late_ns);
        let frame_end_ns = self.end_ns(frame);
        for index in 0..self.tables[frame.epoch.schedule].switches.len() {
            let switch = self.tables[frame.epoch.schedule].switches[index];
            // A frame whose end is moved ahead ends its last window with it.
            let instant_ns = (frame.start_ns + switch.at_ns).min(frame_end_ns);
            if instant_ns != reached_ns {
                late_ns = self.reach(instant_ns, &switch, pace, gate);
                reached_ns = instant_ns;
            }
            if switch.minor_frame && !gate.minor_frame(instant_ns) {
                return false;
            }
            if switch.closes
                && let Some(open) = self.open[switch.lane].take()
            {
                gate.close(&open, Ending { late_ns, shared: switch.opens.is_some() });
            }
            if let Some(window) = switch.opens {
                let occurrence = self.occurrence(frame, window, switch.lane, late_ns);
                gate.open(&occurrence);
                self.open[switch.lane] = Some(occurrence);
            }
        }
        true
    }

    /// Reaches the instant of a switch.
    fn reach(&self, instant_ns: u64, switch: &Switch, pace: &mut dyn Pace, gate: &mut dyn Gate) -> u64 {
        let open = &self.open[switch.lane..=switch.lane];
        let mut between = Between { gate, open, opens: switch.opens };
        match switch.begins {
            true => pace.reach(instant_ns, &mut between),
            false => pace.pass(instant_ns, &mut between),
        }
    }

    fn occurrence(&self, frame: &Frame, window: TimelineWindow, lane: usize, late_ns: u64) -> Occurrence {
        let Table { minor_frame_ns, major_frame_ns, .. } = self.tables[frame.epoch.schedule];
        let frame_end_ns = self.end_ns(frame);
        let until_its_end = window.end_ns == major_frame_ns;
        let end_ns =
            if until_its_end { frame_end_ns } else { frame_end_ns.min(frame.start_ns + window.end_ns) };
        Occurrence {
            window,
            core: self.cores[lane],
            epoch: frame.epoch,
            major_frame: frame.number,
            minor_frames: frame.minor_frames + window.start_ns / minor_frame_ns,
            minor_frame_ns,
            start_ns: frame.start_ns + window.start_ns,
            end_ns,
            late_ns,
        }
    }
}

/// The time between two switches.
struct Between<'a> {
    gate: &'a mut dyn Gate,
    open: &'a [Option<Occurrence>],
    opens: Option<TimelineWindow>,
}

impl Meanwhile for Between<'_> {
    fn has_slack(&mut self) -> bool {
        self.open.iter().flatten().all(|open| self.gate.is_done(&open.window))
    }

    fn await_close(&mut self, until_ns: u64) {
        // On the wall clock a dispatcher has one core: one window.
        if let Some(open) = self.open.iter().flatten().next() {
            self.gate.await_close(&open.window, until_ns);
        }
    }

    fn may_run_on(&self) -> bool {
        self.gate.may_run_on()
    }

    fn lead_ns(&self) -> u64 {
        self.opens.as_ref().map_or(0, |window| self.gate.lead_ns(window))
    }

    fn prepare(&mut self) {
        if let Some(window) = &self.opens {
            self.gate.prepare(window);
        }
    }
}

impl Table {
    fn of(timeline: &Timeline, cores: &[u32], minor_frames: bool) -> Self {
        let mut switches = Vec::new();
        for (lane, core) in cores.iter().enumerate() {
            let line = timeline.cores.iter().find(|line| line.core == *core);
            let windows = line.map_or(&[][..], |line| &line.windows);
            lane_switches(lane, windows, timeline.major_frame_ns, &mut switches);
        }
        if minor_frames {
            mark_minor_frames(&mut switches, timeline);
        }
        // At one instant: the frame is announced, then ends come before starts, then the order of the cores.
        switches
            .sort_by_key(|switch| (switch.at_ns, !switch.minor_frame, switch.opens.is_some(), switch.lane));
        let begins = |switch: &Switch| switch.opens.is_some() || switch.minor_frame;
        for at in switches.chunk_by_mut(|one, next| one.at_ns == next.at_ns) {
            let any = at.iter().any(begins);
            at.iter_mut().for_each(|switch| switch.begins = any);
        }
        Self { switches, major_frame_ns: timeline.major_frame_ns, minor_frame_ns: timeline.minor_frame_ns }
    }

    /// What happens at the very start of the major frame.
    fn first(&self) -> impl Iterator<Item = &Switch> {
        self.switches.iter().take_while(|switch| switch.at_ns == 0)
    }
}

/// A switch at each start and each end; one where a window touches the next, none at the end of the major frame, where
/// every window is closed.
fn lane_switches(lane: usize, windows: &[TimelineWindow], major_frame_ns: u64, switches: &mut Vec<Switch>) {
    for (index, window) in windows.iter().enumerate() {
        let closes = index > 0 && windows[index - 1].end_ns == window.start_ns;
        let opens = Some(*window);
        switches.push(Switch {
            at_ns: window.start_ns,
            lane,
            closes,
            opens,
            minor_frame: false,
            begins: true,
        });
        let next_ns = windows.get(index + 1).map_or(major_frame_ns, |next| next.start_ns);
        if next_ns != window.end_ns {
            let (closes, opens) = (true, None);
            switches.push(Switch {
                at_ns: window.end_ns,
                lane,
                closes,
                opens,
                minor_frame: false,
                begins: false,
            });
        }
    }
}

fn mark_minor_frames(switches: &mut Vec<Switch>, timeline: &Timeline) {
    let minor_frames = timeline.major_frame_ns / timeline.minor_frame_ns;
    switches.extend((0..minor_frames).map(|minor| Switch {
        at_ns: minor * timeline.minor_frame_ns,
        lane: 0,
        closes: false,
        opens: None,
        minor_frame: true,
        begins: true,
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::plan_of;
    use bateleur_plan::Plan;

    const TWO: &str = r#"
        [module.m]
        cores = [0]
        [partition.a]
        program = "a"
        module = "m"
        memory = "1MiB"
        [partition.b]
        program = "b"
        module = "m"
        memory = "1MiB"
        [schedule.s]
        major_frame = "40ms"
        minor_frame = "20ms"
        initial = true
        [[schedule.s.window]]
        partition = "a"
        offset = "0ms"
        duration = "2ms"
        [[schedule.s.window]]
        partition = "b"
        offset = "2ms"
        duration = "1ms"
        minor = [1]
    "#;

    fn dispatcher() -> Dispatcher {
        let plan = plan_of(TWO);
        dispatcher_of(&plan)
    }

    fn dispatcher_of(plan: &Plan) -> Dispatcher {
        let timelines = Timeline::all(plan, plan.module("m").unwrap().id());
        let schedule_switch = Arc::new(ScheduleSwitch::new(plan.initial_schedule().index()));
        Dispatcher::new(&timelines, schedule_switch, true, |_| true)
    }

    /// Time jumps; at one instant it is late.
    struct Jump {
        late_at_ns: u64,
        reached: Vec<u64>,
    }

    impl Pace for Jump {
        fn reach(&mut self, instant_ns: u64, meanwhile: &mut dyn Meanwhile) -> u64 {
            meanwhile.prepare();
            self.reached.push(instant_ns);
            if instant_ns == self.late_at_ns { 3_000_000 } else { 0 }
        }
    }

    #[derive(Default)]
    struct Notes {
        lines: Vec<String>,
        frames: u64,
    }

    impl Gate for Notes {
        fn minor_frame(&mut self, instant_ns: u64) -> bool {
            self.frames += 1;
            self.lines.push(format!("frame {}", instant_ns / 1_000_000));
            self.frames <= 4
        }
        fn prepare(&mut self, _: &TimelineWindow) {}
        fn is_done(&mut self, _: &TimelineWindow) -> bool {
            true
        }
        fn open(&mut self, occurrence: &Occurrence) {
            let late = if occurrence.late_ns > LATE_NS { " late" } else { "" };
            self.lines.push(format!(
                "open {} {}{late}",
                occurrence.window.partition.index(),
                occurrence.start_ns / 1_000_000
            ));
        }
        fn close(&mut self, occurrence: &Occurrence, _: Ending) {
            self.lines.push(format!("close {}", occurrence.window.partition.index()));
        }
    }

    #[test]
    fn windows_open_and_close_in_order_and_touching_ones_switch_at_one_instant() {
        let (mut pace, mut notes) = (Jump { late_at_ns: u64::MAX, reached: Vec::new() }, Notes::default());
        dispatcher().run(&mut pace, &mut notes, &|_| false);
        let first_major =
            ["frame 0", "open 0 0", "close 0", "frame 20", "open 0 20", "close 0", "open 1 22", "close 1"];
        assert_eq!(notes.lines[..8], first_major);
        assert_eq!(notes.lines[8..10], ["frame 40", "open 0 40"]);
    }

    /// A window that lasts until the end of the frame, and one before it.
    const FULL: &str = r#"
        [module.m]
        cores = [0]
        [partition.a]
        program = "a"
        module = "m"
        memory = "1MiB"
        [partition.b]
        program = "b"
        module = "m"
        memory = "1MiB"
        [schedule.s]
        major_frame = "20ms"
        minor_frame = "20ms"
        window = [
            { partition = "a", offset = "1ms", duration = "2ms" },
            { partition = "b", offset = "19ms", duration = "1ms" },
        ]
    "#;

    /// Where windows lie, ns.
    #[derive(Default)]
    struct Places(Vec<(usize, u64, u64)>, u64);

    impl Gate for Places {
        fn minor_frame(&mut self, _: u64) -> bool {
            self.1 += 1;
            self.1 <= 4
        }
        fn prepare(&mut self, _: &TimelineWindow) {}
        fn is_done(&mut self, _: &TimelineWindow) -> bool {
            true
        }
        fn open(&mut self, at: &Occurrence) {
            self.0.push((at.window.partition.index(), at.start_ns, at.end_ns));
        }
        fn close(&mut self, _: &Occurrence, _: Ending) {}
    }

    #[test]
    fn end_of_a_frame_is_moved_and_nothing_within_it_but_the_last_windows_end() {
        let plan = plan_of(FULL);
        let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
        let schedule_switch = Arc::new(ScheduleSwitch::new(0));
        assert!(schedule_switch.propose_shift(1, -20_000) && schedule_switch.propose_shift(2, 7_000_000));
        let mut pace = Jump { late_at_ns: u64::MAX, reached: Vec::new() };
        let mut places = Places::default();
        Dispatcher::new(&timelines, schedule_switch, true, |_| true).run(&mut pace, &mut places, &|_| false);
        assert!(pace.reached.is_sorted());
        let us = |us: u64| us * 1_000;
        let frame = |start: u64, length: u64| {
            [(0, us(start + 1_000), us(start + 3_000)), (1, us(start + 19_000), us(start + length))]
        };
        let frames = [(0, 20_000), (20_000, 19_980), (39_980, 27_000), (66_980, 20_000)];
        assert_eq!(places.0, frames.map(|(start, length)| frame(start, length)).concat());
    }

    #[test]
    fn a_late_switch_is_marked_and_no_later_window_moves() {
        let (mut pace, mut notes) = (Jump { late_at_ns: 20_000_000, reached: Vec::new() }, Notes::default());
        dispatcher().run(&mut pace, &mut notes, &|_| false);
        assert!(notes.lines.contains(&"open 0 20 late".to_owned()));
        assert!(notes.lines.contains(&"open 1 22".to_owned()));
        assert!(pace.reached.contains(&40_000_000) && pace.reached.contains(&60_000_000));
    }

    #[test]
    fn a_module_stops_at_the_end_of_a_major_frame() {
        let (mut pace, mut notes) = (Jump { late_at_ns: u64::MAX, reached: Vec::new() }, Notes::default());
        let asked = std::cell::Cell::new(0);
        dispatcher().run(&mut pace, &mut notes, &|_| {
            asked.set(asked.get() + 1);
            asked.get() > 1
        });
        assert_eq!(notes.frames, 2);
        assert_eq!(notes.lines.last().unwrap(), "close 1");
    }

    const SCHEDULES: &str = r#"
        [module.m]
        cores = [0, 1]
        [partition.a]
        program = "a"
        module = "m"
        memory = "1MiB"
        [partition.b]
        program = "b"
        module = "m"
        memory = "1MiB"
        [schedule.long]
        major_frame = "40ms"
        minor_frame = "20ms"
        initial = true
        window = [
            { partition = "a", offset = "0ms", duration = "2ms" },
            { partition = "b", offset = "10ms", duration = "10ms", minor = [1] },
        ]
        [schedule.short]
        major_frame = "10ms"
        minor_frame = "10ms"
        window = [
            { partition = "b", offset = "0ms", duration = "2ms" },
            { partition = "a", offset = "3ms", duration = "2ms", core = 1 },
        ]
    "#;

    /// Asks for schedules in its minor frames, and stops after a few.
    struct Asks {
        notes: Notes,
        schedule_switch: Arc<ScheduleSwitch>,
        /// Minor frame and schedule.
        asks: Vec<(u64, usize)>,
        epochs: Vec<(u64, ScheduleEpoch)>,
    }

    impl Gate for Asks {
        fn minor_frame(&mut self, instant_ns: u64) -> bool {
            let frame = self.notes.frames;
            for (_, schedule) in self.asks.iter().filter(|(at, _)| *at == frame) {
                self.schedule_switch.request(*schedule);
            }
            self.notes.minor_frame(instant_ns);
            self.notes.frames <= 9
        }
        fn prepare(&mut self, _: &TimelineWindow) {}
        fn is_done(&mut self, _: &TimelineWindow) -> bool {
            true
        }
        fn open(&mut self, occurrence: &Occurrence) {
            self.epochs.push((occurrence.minor_frames, occurrence.epoch));
            self.notes.open(occurrence);
        }
        fn close(&mut self, occurrence: &Occurrence, ending: Ending) {
            self.notes.close(occurrence, ending);
        }
    }

    fn run_asking(asks: &[(u64, usize)]) -> Asks {
        let plan = plan_of(SCHEDULES);
        let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
        let schedule_switch = Arc::new(ScheduleSwitch::new(0));
        let mut dispatcher = Dispatcher::new(&timelines, schedule_switch.clone(), true, |_| true);
        let mut gate =
            Asks { notes: Notes::default(), schedule_switch, asks: asks.to_vec(), epochs: Vec::new() };
        let mut pace = Jump { late_at_ns: u64::MAX, reached: Vec::new() };
        dispatcher.run(&mut pace, &mut gate, &|_| false);
        assert!(pace.reached.is_sorted());
        gate
    }

    #[test]
    fn a_change_of_schedule_takes_effect_at_the_end_of_the_major_frame_and_counts_on() {
        // Asked for in minor frame 0, and back in the fourth minor frame of the other one.
        let gate = run_asking(&[(0, 1), (5, 0)]);
        let lines: Vec<&str> = gate.notes.lines.iter().map(String::as_str).collect();
        let expected = [
            "frame 0",
            "open 0 0",
            "close 0",
            "frame 20",
            "open 0 20",
            "close 0",
            "open 1 30",
            "close 1",
            "frame 40",
            "open 1 40",
            "close 1",
            "open 0 43",
            "close 0",
            "frame 50",
            "open 1 50",
            "close 1",
            "open 0 53",
            "close 0",
            "frame 60",
            "open 1 60",
            "close 1",
            "open 0 63",
            "close 0",
            "frame 70",
            "open 1 70",
            "close 1",
            "open 0 73",
            "close 0",
            "frame 80",
            "open 0 80",
            "close 0",
            "frame 100",
            "open 0 100",
            "close 0",
            "open 1 110",
            "close 1",
            "frame 120",
            "open 0 120",
            "close 0",
            "frame 140",
        ];
        assert_eq!(lines, expected);
        let frames: Vec<u64> = gate.epochs.iter().map(|(frames, _)| *frames).collect();
        assert_eq!(frames, [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 7, 7, 8]);
        let last = gate.epochs.last().unwrap().1;
        assert_eq!(last, ScheduleEpoch { number: 2, schedule: 0, after: Some(1), since_ns: 80_000_000 });
    }

    #[test]
    fn a_core_without_windows_waits_for_every_major_frame() {
        let plan = plan_of(SCHEDULES);
        let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
        let schedule_switch = Arc::new(ScheduleSwitch::new(0));
        let mut dispatcher = Dispatcher::new(&timelines, schedule_switch, false, |core| core == 1);
        let mut pace = Jump { late_at_ns: u64::MAX, reached: Vec::new() };
        let asked = std::cell::Cell::new(0);
        dispatcher.run(&mut pace, &mut Notes::default(), &|_| {
            asked.set(asked.get() + 1);
            asked.get() > 3
        });
        assert_eq!(pace.reached, [0, 40_000_000, 80_000_000, 120_000_000]);
    }

    #[test]
    fn a_window_that_lasts_until_the_end_of_the_major_frame_ends_with_it_and_before_the_next() {
        let gate = run_asking(&[]);
        let at = gate.notes.lines.iter().position(|line| line == "open 1 30").unwrap();
        assert_eq!(gate.notes.lines[at + 1..at + 3], ["close 1", "frame 40"]);
    }
}
