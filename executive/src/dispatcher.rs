//! The dispatcher: grants windows at their instants, on the wall clock or on the virtual one, by the same logic.
//!
//! Responsible for: walking the switch instants of the major frame, for ever, from the origin. It must never wait for
//! a partition on the wall clock, allocate, log, or shift a window because an earlier one was late.
//!
//! How time passes is a [`Pace`], how a window is opened and closed is a [`Gate`]; both are traits, so that the logic
//! is tested without processes and without time.

use crate::plan::{Timeline, TimelineWindow};

/// A window start that comes later than this is counted as late, ns. A fiftieth of the shortest sensible window period
/// (10 ms): later than that, a control loop notices. Too small a value would count the noise of the machine.
pub const LATE_NS: u64 = 200_000;

/// How time passes.
pub trait Pace {
    /// Returns at `instant_ns` of module time, or as soon after as it can; gives how late, ns. `slack` says whether the
    /// processor is free (the window before was closed early); `prepare` may be called ahead of the instant then.
    fn reach(&mut self, instant_ns: u64, slack: &mut dyn FnMut() -> bool, prepare: &mut dyn FnMut()) -> u64;
}

/// How windows open and close.
pub trait Gate {
    /// A minor frame begins; false: the module stops here. Called on the first core only.
    fn minor_frame(&mut self, instant_ns: u64) -> bool;
    /// Gets ready to open `window`, ahead of its instant.
    fn prepare(&mut self, window: &TimelineWindow);
    /// Whether the partition of an open window is done with it.
    fn is_done(&mut self, window: &TimelineWindow) -> bool;
    /// Opens a window.
    fn open(&mut self, occurrence: &Occurrence);
    /// Closes it.
    fn close(&mut self, occurrence: &Occurrence);
}

/// One window of one major frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Occurrence {
    /// The window in the timeline.
    pub window: TimelineWindow,
    /// The core.
    pub core: u32,
    /// Major frames before this one.
    pub major_frame: u64,
    /// Minor frames since module time 0.
    pub minor_frames: u64,
    /// Its planned start, module time, ns.
    pub start_ns: u64,
    /// Its planned end, module time, ns.
    pub end_ns: u64,
    /// How late the dispatcher itself was at the start, ns.
    pub late_ns: u64,
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
}

/// The switch instants of some cores over the major frame.
#[derive(Debug, Clone)]
pub struct Dispatcher {
    switches: Vec<Switch>,
    cores: Vec<u32>,
    open: Vec<Option<Occurrence>>,
    major_frame_ns: u64,
    minor_frame_ns: u64,
}

impl Dispatcher {
    /// A dispatcher for the cores of `timeline` that `wanted` picks. The one that has the first core announces minor
    /// frames.
    #[must_use]
    pub fn new(timeline: &Timeline, wanted: impl Fn(u32) -> bool) -> Self {
        let cores: Vec<u32> =
            timeline.cores.iter().map(|line| line.core).filter(|core| wanted(*core)).collect();
        let mut switches = Vec::new();
        for (lane, core) in cores.iter().enumerate() {
            let line = timeline.cores.iter().find(|line| line.core == *core);
            switches.extend(line.into_iter().flat_map(|line| lane_switches(lane, &line.windows)));
        }
        if cores.first() == timeline.cores.first().map(|line| &line.core) {
            mark_minor_frames(&mut switches, timeline);
        }
        // At one instant: the frame is announced, then ends come before starts, then the order of the cores.
        switches
            .sort_by_key(|switch| (switch.at_ns, !switch.minor_frame, switch.opens.is_some(), switch.lane));
        Self {
            switches,
            open: vec![None; cores.len()],
            cores,
            major_frame_ns: timeline.major_frame_ns,
            minor_frame_ns: timeline.minor_frame_ns,
        }
    }

    /// Runs major frames until the gate says that the module stops, or `stop` says so at a major frame's end.
    pub fn run(&mut self, pace: &mut dyn Pace, gate: &mut dyn Gate, stop: &dyn Fn() -> bool) {
        for major_frame in 0.. {
            if stop() || !self.major_frame(major_frame, pace, gate) {
                break;
            }
        }
        for open in self.open.iter_mut().filter_map(Option::take) {
            gate.close(&open);
        }
    }

    fn major_frame(&mut self, major_frame: u64, pace: &mut dyn Pace, gate: &mut dyn Gate) -> bool {
        let origin_ns = major_frame * self.major_frame_ns;
        for index in 0..self.switches.len() {
            let switch = self.switches[index];
            let instant_ns = origin_ns + switch.at_ns;
            let late_ns = self.reach(instant_ns, &switch, pace, gate);
            if switch.minor_frame && !gate.minor_frame(instant_ns) {
                return false;
            }
            if switch.closes
                && let Some(open) = self.open[switch.lane].take()
            {
                gate.close(&open);
            }
            if let Some(window) = switch.opens {
                let occurrence = self.occurrence(window, switch.lane, major_frame, late_ns);
                gate.open(&occurrence);
                self.open[switch.lane] = Some(occurrence);
            }
        }
        true
    }

    fn reach(&self, instant_ns: u64, switch: &Switch, pace: &mut dyn Pace, gate: &mut dyn Gate) -> u64 {
        let open = self.open[switch.lane].map(|open| open.window);
        // Both closures use the gate, one after the other.
        let gate = std::cell::RefCell::new(gate);
        pace.reach(
            instant_ns,
            &mut || open.is_none_or(|window| gate.borrow_mut().is_done(&window)),
            &mut || switch.opens.iter().for_each(|window| gate.borrow_mut().prepare(window)),
        )
    }

    fn occurrence(&self, window: TimelineWindow, lane: usize, major_frame: u64, late_ns: u64) -> Occurrence {
        let origin_ns = major_frame * self.major_frame_ns;
        Occurrence {
            window,
            core: self.cores[lane],
            major_frame,
            minor_frames: (origin_ns + window.start_ns) / self.minor_frame_ns,
            start_ns: origin_ns + window.start_ns,
            end_ns: origin_ns + window.end_ns,
            late_ns,
        }
    }
}

/// A switch at each start and each end; one where a window touches the next.
fn lane_switches(lane: usize, windows: &[TimelineWindow]) -> Vec<Switch> {
    let mut switches = Vec::with_capacity(2 * windows.len());
    for (index, window) in windows.iter().enumerate() {
        let touches = index > 0 && windows[index - 1].end_ns == window.start_ns;
        switches.push(Switch {
            at_ns: window.start_ns,
            lane,
            closes: touches,
            opens: Some(*window),
            minor_frame: false,
        });
        if windows.get(index + 1).is_none_or(|next| next.start_ns != window.end_ns) {
            switches.push(Switch {
                at_ns: window.end_ns,
                lane,
                closes: true,
                opens: None,
                minor_frame: false,
            });
        }
    }
    switches
}

fn mark_minor_frames(switches: &mut Vec<Switch>, timeline: &Timeline) {
    let minor_frames = timeline.major_frame_ns / timeline.minor_frame_ns;
    switches.extend((0..minor_frames).map(|minor| Switch {
        at_ns: minor * timeline.minor_frame_ns,
        lane: 0,
        closes: false,
        opens: None,
        minor_frame: true,
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{MessageCatalogue, check};

    struct NoMessages;
    impl MessageCatalogue for NoMessages {
        fn size_of(&self, _: &str) -> Option<usize> {
            None
        }
        fn names(&self) -> Vec<&str> {
            Vec::new()
        }
    }

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
        let plan = check("two.toml", TWO, &NoMessages).unwrap();
        let timeline = Timeline::of(&plan, plan.module("m").unwrap().id(), plan.initial_schedule());
        Dispatcher::new(&timeline, |_| true)
    }

    /// Time jumps; at one instant it is late.
    struct Jump {
        late_at_ns: u64,
        reached: Vec<u64>,
    }

    impl Pace for Jump {
        fn reach(&mut self, instant_ns: u64, _: &mut dyn FnMut() -> bool, prepare: &mut dyn FnMut()) -> u64 {
            prepare();
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
        fn close(&mut self, occurrence: &Occurrence) {
            self.lines.push(format!("close {}", occurrence.window.partition.index()));
        }
    }

    #[test]
    fn windows_open_and_close_in_order_and_touching_ones_switch_at_one_instant() {
        let (mut pace, mut notes) = (Jump { late_at_ns: u64::MAX, reached: Vec::new() }, Notes::default());
        dispatcher().run(&mut pace, &mut notes, &|| false);
        let first_major =
            ["frame 0", "open 0 0", "close 0", "frame 20", "open 0 20", "close 0", "open 1 22", "close 1"];
        assert_eq!(notes.lines[..8], first_major);
        assert_eq!(notes.lines[8..10], ["frame 40", "open 0 40"]);
    }

    #[test]
    fn a_late_switch_is_marked_and_no_later_window_moves() {
        let (mut pace, mut notes) = (Jump { late_at_ns: 20_000_000, reached: Vec::new() }, Notes::default());
        dispatcher().run(&mut pace, &mut notes, &|| false);
        assert!(notes.lines.contains(&"open 0 20 late".to_owned()));
        assert!(notes.lines.contains(&"open 1 22".to_owned()));
        assert!(pace.reached.contains(&40_000_000) && pace.reached.contains(&60_000_000));
    }

    #[test]
    fn a_module_stops_at_the_end_of_a_major_frame() {
        let (mut pace, mut notes) = (Jump { late_at_ns: u64::MAX, reached: Vec::new() }, Notes::default());
        let asked = std::cell::Cell::new(0);
        dispatcher().run(&mut pace, &mut notes, &|| {
            asked.set(asked.get() + 1);
            asked.get() > 1
        });
        assert_eq!(notes.frames, 2);
        assert_eq!(notes.lines.last().unwrap(), "close 1");
    }
}
