//! For any schedules, any lateness and any changes: every window opens once, where its schedule has it, and no other does.
//!
//! What is expected is computed here from the numbers that the schedule file is written from, not from the timeline.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../../test_support.rs"]
mod test_support;

use std::fmt::Write;
use std::sync::Arc;

use bateleur_checker::check_with_warnings;
use bateleur_plan::{Timeline, TimelineWindow};
use bateleur_time::dispatcher::{Dispatcher, Ending, Gate, Meanwhile, Occurrence, Pace};
use bateleur_time::schedule_switch::{Requested, ScheduleSwitch};
use proptest::prelude::*;
use test_support::NoMessages;

const US: u64 = 1000;

/// A window as the file has it.
#[derive(Debug, Clone)]
struct Drawn {
    core: u32,
    partition: usize,
    offset_us: u64,
    duration_us: u64,
    minor: Vec<u64>,
}

#[derive(Debug, Clone)]
struct DrawnSchedule {
    minor_us: u64,
    minors: u64,
    windows: Vec<Drawn>,
}

impl DrawnSchedule {
    fn major_ns(&self) -> u64 {
        self.minor_us * self.minors * US
    }

    /// Start, end, core and partition of every window of a major frame, from its start, ns.
    fn expected(&self) -> Vec<(u64, u64, u32, usize)> {
        let mut all = Vec::new();
        for window in &self.windows {
            for minor in &window.minor {
                let start_us = minor * self.minor_us + window.offset_us;
                let end_us = start_us + window.duration_us;
                all.push((start_us * US, end_us * US, window.core, window.partition));
            }
        }
        all.sort_unstable();
        all
    }
}

/// Gaps and lengths in units of 100 us, and which minor frames have the window.
fn lane() -> impl Strategy<Value = Vec<(u64, u64, u8)>> {
    prop::collection::vec((0_u64..4, 1_u64..8, 0_u8..16), 0..4)
}

fn schedule() -> impl Strategy<Value = DrawnSchedule> {
    (20_u64..60, 1_u64..5, prop::collection::vec(lane(), 2)).prop_map(|(minor, minors, lanes)| {
        let mut windows = Vec::new();
        for (core, lane) in lanes.iter().enumerate() {
            let mut at = 0;
            for (place, (gap, length, mask)) in lane.iter().enumerate() {
                let offset_us = (at + gap) * 100;
                at += gap + length;
                if at > minor {
                    break;
                }
                let minor: Vec<u64> = (0..minors).filter(|minor| mask & (1 << minor) != 0).collect();
                let minor = if minor.is_empty() { vec![0] } else { minor };
                let (core, partition) = (core as u32, core * 10 + place);
                windows.push(Drawn { core, partition, offset_us, duration_us: length * 100, minor });
            }
        }
        DrawnSchedule { minor_us: minor * 100, minors, windows }
    })
}

/// The file with these schedules, and for each partition of the plan its number here.
fn file(schedules: &[DrawnSchedule]) -> (String, Vec<usize>) {
    let windows = schedules.iter().flat_map(|schedule| &schedule.windows);
    let mut numbers: Vec<usize> = windows.map(|window| window.partition).collect();
    numbers.sort_unstable();
    numbers.dedup();
    if numbers.is_empty() {
        return (String::new(), numbers);
    }
    let mut text = "[module.m]\ncores = [0, 1]\n".to_owned();
    for number in &numbers {
        writeln!(text, "[partition.p{number}]\nprogram = \"p\"\nmodule = \"m\"\nmemory = \"1MiB\"").unwrap();
    }
    for (place, schedule) in schedules.iter().enumerate() {
        let (major, minor) = (schedule.minor_us * schedule.minors, schedule.minor_us);
        let initial = place == 0;
        writeln!(
            text,
            "[schedule.s{place}]\nmajor_frame = \"{major}us\"\nminor_frame = \"{minor}us\"\ninitial = {initial}"
        )
        .unwrap();
        for window in &schedule.windows {
            let Drawn { core, partition, offset_us, duration_us, minor } = window;
            writeln!(
                text,
                "[[schedule.s{place}.window]]\npartition = \"p{partition}\"\noffset = \"{offset_us}us\"\n\
                 duration = \"{duration_us}us\"\ncore = {core}\nminor = {minor:?}"
            )
            .unwrap();
        }
    }
    (text, numbers)
}

/// Numbers without a pattern, the same at every run.
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }
}

/// Time jumps, and now and then comes late.
struct Jumps(Random);

impl Pace for Jumps {
    fn reach(&mut self, _: u64, meanwhile: &mut dyn Meanwhile) -> u64 {
        if self.0.below(2) == 0 {
            meanwhile.prepare();
        }
        match self.0.below(10) {
            0 => self.0.below(50_000_000),
            _ => 0,
        }
    }
}

/// Compares every major frame with what is expected of it.
struct Judge<'a> {
    schedules: &'a [DrawnSchedule],
    expected: Vec<Vec<(u64, u64, u32, usize)>>,
    numbers: &'a [usize],
    schedule_switch: Arc<ScheduleSwitch>,
    random: Random,
    /// One minor frame in so many asks for a schedule.
    asks: u64,
    frames_left: u64,
    current: usize,
    pending: Option<usize>,
    start_ns: u64,
    next_ns: u64,
    minor_frames: u64,
    seen: Vec<(u64, u64, u32, usize)>,
    open: [Option<u64>; 2],
    changes: u64,
}

impl<'a> Judge<'a> {
    fn new(
        schedules: &'a [DrawnSchedule],
        numbers: &'a [usize],
        schedule_switch: Arc<ScheduleSwitch>,
        frames: u64,
        random: Random,
    ) -> Self {
        Self {
            expected: schedules.iter().map(DrawnSchedule::expected).collect(),
            schedules,
            numbers,
            schedule_switch,
            random,
            asks: 7,
            frames_left: frames,
            current: 0,
            pending: None,
            start_ns: 0,
            next_ns: 0,
            minor_frames: 0,
            seen: Vec::new(),
            open: [None; 2],
            changes: 0,
        }
    }

    fn begin_major_frame(&mut self, instant_ns: u64) {
        if instant_ns > 0 {
            self.seen.sort_unstable();
            assert_eq!(self.seen, self.expected[self.current], "the major frame at {}", self.start_ns);
            self.seen.clear();
        }
        if let Some(schedule) = self.pending.take() {
            self.changes += u64::from(schedule != self.current);
            self.current = schedule;
        }
        self.start_ns = instant_ns;
        self.next_ns = instant_ns + self.schedules[self.current].major_ns();
        self.frames_left -= 1;
    }
}

impl Gate for Judge<'_> {
    fn minor_frame(&mut self, instant_ns: u64) -> bool {
        if instant_ns == self.next_ns {
            self.begin_major_frame(instant_ns);
        }
        let into_ns = instant_ns - self.start_ns;
        assert!(
            into_ns.is_multiple_of(self.schedules[self.current].minor_us * US) && instant_ns < self.next_ns
        );
        self.minor_frames += 1;
        if self.random.below(self.asks) == 0 {
            let wanted = self.random.below(self.schedules.len() as u64) as usize;
            if self.schedule_switch.request(wanted) == Requested::Pending {
                self.pending = Some(wanted);
            }
        }
        self.frames_left > 0
    }

    fn prepare(&mut self, _: &TimelineWindow) {}

    fn is_done(&mut self, _: &TimelineWindow) -> bool {
        true
    }

    fn open(&mut self, occurrence: &Occurrence) {
        let lane = &mut self.open[occurrence.core as usize];
        assert_eq!(lane.replace(occurrence.start_ns), None, "two windows at once on a core: {occurrence:?}");
        assert_eq!(occurrence.epoch.schedule, self.current);
        assert_eq!(occurrence.minor_frames + 1, self.minor_frames, "minor frames count on");
        let number = self.numbers[occurrence.window.partition.index()];
        let (start_ns, end_ns) = (occurrence.start_ns - self.start_ns, occurrence.end_ns - self.start_ns);
        self.seen.push((start_ns, end_ns, occurrence.core, number));
    }

    fn close(&mut self, occurrence: &Occurrence, _: Ending) {
        assert_eq!(self.open[occurrence.core as usize].take(), Some(occurrence.start_ns), "closed once");
    }
}

fn run(schedules: &[DrawnSchedule], frames: u64, seed: u64) -> u64 {
    let (text, numbers) = file(schedules);
    if numbers.is_empty() {
        return 0;
    }
    let (plan, _) =
        check_with_warnings("drawn.toml", &text, &NoMessages).unwrap_or_else(|report| panic!("{report}"));
    let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
    let schedule_switch = Arc::new(ScheduleSwitch::new(0));
    let mut judge = Judge::new(schedules, &numbers, schedule_switch.clone(), frames, Random(seed));
    let mut dispatcher = Dispatcher::new(&timelines, schedule_switch, true, |_| true);
    dispatcher.run(&mut Jumps(Random(seed ^ 0x5555_5555)), &mut judge, &|_| false);
    assert_eq!(judge.frames_left, 0);
    judge.changes
}

/// Notes what a core of its own does, while another asks for schedules.
struct Notes {
    seen: Vec<(u64, usize, u64)>,
    schedule_switch: Arc<ScheduleSwitch>,
    random: Random,
    schedules: u64,
}

impl Gate for Notes {
    fn minor_frame(&mut self, _: u64) -> bool {
        true
    }
    fn prepare(&mut self, _: &TimelineWindow) {}
    fn is_done(&mut self, _: &TimelineWindow) -> bool {
        true
    }
    fn open(&mut self, at: &Occurrence) {
        self.seen.push((at.major_frame, at.epoch.schedule, at.start_ns - at.window.start_ns));
        if self.random.below(5) == 0 {
            self.schedule_switch.request(self.random.below(self.schedules) as usize);
        }
    }
    fn close(&mut self, _: &Occurrence, _: Ending) {}
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_window_opens_once_at_its_origin_whatever_is_late_and_whoever_asks(
        schedules in prop::collection::vec(schedule(), 1..4),
        seed in 1_u64..u64::MAX,
    ) {
        run(&schedules, 40, seed);
    }

    #[test]
    fn cores_that_run_by_themselves_go_through_the_same_schedules_at_the_same_instants(
        schedules in prop::collection::vec(schedule(), 2..4),
        seed in 1_u64..u64::MAX,
    ) {
        let (text, numbers) = file(&schedules);
        prop_assume!(!numbers.is_empty());
        let (plan, _) = check_with_warnings("drawn.toml", &text, &NoMessages).unwrap();
        let timelines = Timeline::all(&plan, plan.module("m").unwrap().id());
        let schedule_switch = Arc::new(ScheduleSwitch::new(0));
        let threads = [0_u32, 1].map(|core| {
            let (timelines, schedule_switch, count) = (timelines.clone(), schedule_switch.clone(), schedules.len() as u64);
            std::thread::spawn(move || {
                let random = Random(seed ^ u64::from(core));
                let mut notes = Notes { seen: Vec::new(), schedule_switch: schedule_switch.clone(), random, schedules: count };
                let mut dispatcher = Dispatcher::new(&timelines, schedule_switch.clone(), false, |own| own == core);
                let stop = |_| schedule_switch.newest_frame() >= 50;
                assert!(dispatcher.run(&mut Jumps(Random(seed)), &mut notes, &stop), "it lost its way");
                notes.seen
            })
        });
        let [first, second] = threads.map(|thread| thread.join().unwrap());
        for (frame, schedule, start_ns) in &first {
            for (_, other, other_ns) in second.iter().filter(|(other, ..)| other == frame) {
                prop_assert_eq!((schedule, start_ns), (other, other_ns));
            }
        }
    }
}

#[test]
fn a_million_major_frames_with_changes_and_lateness_drift_by_nothing() {
    let window = |core, partition, offset_us, duration_us, minor: &[u64]| Drawn {
        core,
        partition,
        offset_us,
        duration_us,
        minor: minor.to_vec(),
    };
    let schedules = [
        DrawnSchedule {
            minor_us: 20_000,
            minors: 2,
            windows: vec![
                window(0, 0, 0, 5000, &[0, 1]),
                window(0, 1, 5000, 15_000, &[1]),
                window(1, 10, 3000, 400, &[0]),
            ],
        },
        DrawnSchedule {
            minor_us: 7_000,
            minors: 3,
            windows: vec![window(0, 1, 100, 200, &[0, 1, 2]), window(1, 11, 6000, 1000, &[2])],
        },
        DrawnSchedule { minor_us: 1_000, minors: 1, windows: vec![window(1, 10, 0, 1000, &[0])] },
    ];
    let changes = run(&schedules, 1_000_000, 653);
    assert!(changes > 10_000, "{changes}");
}
