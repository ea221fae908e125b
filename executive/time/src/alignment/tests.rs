use super::*;
use crate::schedule_switch::FrameDecision;
use crate::schedule_switch::ScheduleSwitch;
use crate::test_support::plan_of;

const MS: f64 = 1e6;
const FRAME_NS: u64 = 100_000_000;

const PLAN: &str = r#"
    [module.m]
    cores = [0]
    [partition.a]
    program = "a"
    module = "m"
    memory = "1MiB"
    [schedule.s]
    major_frame = "100ms"
    minor_frame = "100ms"
    window = [{ partition = "a", offset = "1ms", duration = "2ms" }]
"#;

fn timelines(text: &str) -> Vec<Timeline> {
    let plan = plan_of(text);
    Timeline::all(&plan, plan.module("m").unwrap().id())
}

fn following() -> Following {
    Following {
        reference: Reference::Module("b".into()),
        within_ns: 1_000_000,
        lost_after_ns: 1_000_000_000,
        known_within_ns: 1_000_000,
    }
}

/// The next number of a SplitMix64 sequence, 0 to 1.
fn chance(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut mixed = *state;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

/// Two modules in one time: the leader's frames begin at multiples of 100 ms of its clock, the follower's where its schedule switch puts them.
struct World {
    seed: u64,
    schedule_switch: ScheduleSwitch,
    aligner: Aligner,
    frame: u64,
    /// When the follower's frame began, its own clock, ns.
    start_ns: u64,
    /// When it did, on the leader's clock, ns.
    leader_ns: f64,
    /// How fast the leader's clock runs beside the own one, ns a second.
    drift: f64,
    wanders: bool,
    exchanges: u32,
    changes: Vec<(u64, Change)>,
    /// The largest change of a frame's length but for one that is made in one piece, ns.
    jerk_ns: i64,
    coarse: bool,
}

/// What the network does.
#[derive(Clone, Copy)]
struct Weather {
    /// Share of frames without an exchange.
    loss: f64,
    /// Half of the way there and back, ns.
    way_ns: f64,
    /// By how much the way differs, at most, ns.
    jitter_ns: f64,
    /// Share of exchanges that take milliseconds longer.
    spikes: f64,
}

const FAIR: Weather = Weather { loss: 0.0, way_ns: 30_000.0, jitter_ns: 20_000.0, spikes: 0.0 };
const FOUL: Weather = Weather { loss: 0.9, way_ns: 50_000.0, jitter_ns: 40_000.0, spikes: 0.1 };
const GONE: Weather = Weather { loss: 1.0, ..FAIR };

impl World {
    fn new(seed: u64, phase_ns: f64) -> Self {
        let mut seed = seed;
        let drift = (chance(&mut seed) - 0.5) * 100_000.0; // 50 parts in a million either way
        Self {
            seed,
            schedule_switch: ScheduleSwitch::new(0),
            aligner: Aligner::new(following(), &timelines(PLAN)),
            frame: 0,
            start_ns: 0,
            leader_ns: 7.0e9 - phase_ns,
            drift,
            wanders: true,
            exchanges: 0,
            changes: Vec::new(),
            jerk_ns: 0,
            coarse: false,
        }
    }

    /// How much later the leader's frame begins than the present one, ns.
    fn phase_ns(&self) -> f64 {
        nearest(-self.leader_ns, FRAME_NS)
    }

    /// One major frame, with its exchange.
    fn step(&mut self, weather: Weather) {
        let told = (chance(&mut self.seed) >= weather.loss).then(|| {
            let mut way_ns = weather.way_ns + chance(&mut self.seed) * weather.jitter_ns;
            if chance(&mut self.seed) < weather.spikes {
                way_ns += chance(&mut self.seed) * 5.0 * MS;
            }
            // The two ways are not equally long: the truth lies anywhere within.
            let wrong_ns = (chance(&mut self.seed) - 0.5) * 2.0 * way_ns * 0.5;
            self.exchanges += 1;
            let report = bateleur_contract::AlignmentReport {
                peer_minus_own_ns: (self.phase_ns() + wrong_ns) as i64,
                uncertainty_ns: way_ns as u32,
                exchanges: self.exchanges,
            };
            AlignmentTold { report, major_frame: self.frame }
        });
        // The monitor comes some time after the relay's window, before the frame's end.
        let now_ns = self.start_ns + FRAME_NS / 2;
        let measured = told.and_then(|told| self.aligner.heard(&told, self.frame));
        let change = self.aligner.step(&self.schedule_switch, now_ns, measured);
        self.changes.extend(change.map(|change| (self.frame, change)));
        // The end of this frame was decided when it began.
        let shift_ns = self.schedule_switch.shift(self.frame).unwrap();
        match self.coarse {
            false if shift_ns > 1_000_000 => self.coarse = true,
            _ => self.jerk_ns = self.jerk_ns.max(shift_ns.abs()),
        }
        if self.wanders {
            self.drift += (chance(&mut self.seed) - 0.5) * 60.0;
            self.drift = self.drift.clamp(-50_000.0, 50_000.0);
        }
        let length_ns = FRAME_NS.saturating_add_signed(shift_ns);
        self.start_ns += length_ns;
        self.leader_ns += length_ns as f64 * (1.0 + self.drift / 1e9);
        self.frame += 1;
        assert_eq!(
            self.schedule_switch.decide(self.frame, self.start_ns, 0, || false),
            Some(FrameDecision::Run(0))
        );
        let _ = self.schedule_switch.shift(self.frame);
    }

    /// Largest phase over some frames, ns.
    fn fly(&mut self, frames: u64, weather: Weather) -> f64 {
        (0..frames).fold(0.0_f64, |worst, _| {
            self.step(weather);
            worst.max(self.phase_ns().abs())
        })
    }

    fn is(&self, state: State) -> bool {
        self.aligner.state() == state
    }
}

#[test]
fn frames_that_begin_anywhere_are_locked_within_seconds_and_stay_with_the_leaders() {
    for seed in 0..40 {
        let mut world = World::new(seed, (seed as f64 - 20.0) * 2.4 * MS);
        world.fly(150, FAIR);
        assert!(world.is(State::Locked), "seed {seed}: {:?}", world.changes);
        let worst = world.fly(2_000, FAIR);
        assert!(worst < 20_000.0, "seed {seed}: {worst} ns");
        assert_eq!(world.changes.len(), 1, "locked once: {:?}", world.changes);
        assert!(world.jerk_ns <= 100_000, "{}", world.jerk_ns);
    }
}

#[test]
fn nine_of_ten_exchanges_lost_and_spikes_of_milliseconds_unlock_nothing() {
    for seed in 0..40 {
        let mut world = World::new(seed, -40.0 * MS);
        world.aligner.following.lost_after_ns = 20_000_000_000;
        world.fly(1_000, FOUL);
        assert!(world.is(State::Locked), "seed {seed}: {:?}", world.changes);
        let worst = world.fly(3_000, FOUL);
        assert!(worst < 150_000.0, "seed {seed}: {worst} ns");
        assert_eq!(world.changes.len(), 1, "{:?}", world.changes);
    }
}

#[test]
fn drift_is_learned_so_that_corrections_become_steady() {
    let mut world = World::new(5, 0.0);
    (world.wanders, world.drift) = (false, 37_000.0);
    world.fly(600, FAIR);
    // A leader that runs ahead by 37 ppm is met by frames that are shorter by it.
    let drift = world.aligner.law().drift_ppb();
    assert!((drift + 37_000.0).abs() < 500.0, "{drift}");
}

#[test]
fn leader_that_is_gone_is_lost_after_the_time_that_was_said_and_its_frames_are_held() {
    for seed in 0..20 {
        let mut world = World::new(seed, 10.0 * MS);
        world.fly(600, FAIR);
        assert!(world.is(State::Locked));
        world.changes.clear();
        let gone = world.frame;
        let worst = world.fly(600, GONE);
        assert!(world.is(State::Lost));
        assert_eq!(world.changes.len(), 1, "told once");
        let (at, Change::Lost(why)) = &world.changes[0] else { panic!("{:?}", world.changes) };
        assert!((gone + 10..gone + 15).contains(at), "{at} after {gone}");
        assert!(why.contains("nothing was heard of b"), "{why}");
        // A minute on its own: without what was learned of the drift it would be up to 3 ms.
        assert!(worst < 200_000.0, "seed {seed}: {worst} ns");
        let bound_ns = world.aligner.law().deviation_ns() * 3.0;
        assert!(world.phase_ns().abs() < bound_ns + 50_000.0, "{} of {bound_ns}", world.phase_ns());
        world.fly(100, FAIR);
        assert!(world.is(State::Locked));
        assert_eq!(world.changes.last().unwrap().1, Change::Locked);
    }
}

#[test]
fn leader_that_begins_anew_with_another_phase_is_followed_by_small_steps() {
    let mut world = World::new(3, 0.0);
    world.fly(300, FAIR);
    world.changes.clear();
    world.leader_ns += 20.0 * MS;
    (world.jerk_ns, world.coarse) = (0, true);
    world.fly(20, FAIR);
    assert!(
        matches!(&world.changes[..], [(_, Change::Lost(why))] if why.contains("beside those of b")),
        "{:?}",
        world.changes
    );
    assert!(world.jerk_ns <= 100_000, "no window is lost for it");
    // 20 ms by 100 us a frame.
    world.fly(230, FAIR);
    assert!(world.is(State::Locked), "{} ns", world.phase_ns());
    assert!(world.fly(100, FAIR) < 40_000.0);
}

#[test]
fn leader_whose_clock_is_not_known_well_enough_any_more_is_lost_until_it_is() {
    let mut world = World::new(4, 0.0);
    world.fly(300, FAIR);
    world.changes.clear();
    // A detour of 1.5 ms each way: the exchanges come, and say less than is asked.
    let detour = Weather { way_ns: 1.5 * MS, ..FAIR };
    let begun = world.frame;
    world.fly(9, detour);
    assert!(world.is(State::Locked), "not for a moment of it");
    world.fly(10, detour);
    let [(at, Change::Lost(why))] = &world.changes[..] else { panic!("{:?}", world.changes) };
    assert!((begun + 10..begun + 16).contains(at), "{at} after {begun}");
    assert!(why.contains("the clock of b has not been known to 1000 us"), "{why}");
    world.fly(20, FAIR);
    assert!(world.is(State::Locked));
}

#[test]
fn leader_that_was_never_known_well_enough_is_not_locked_to() {
    let mut world = World::new(4, 0.0);
    world.fly(150, Weather { way_ns: 1.5 * MS, ..FAIR });
    assert!(
        matches!(&world.changes[..], [(at, Change::Lost(why))] if (100..110).contains(at) && why.contains("been known to")),
        "{:?}",
        world.changes
    );
}

/// A module on the disciplined clock of its machine, which is read in each frame.
struct OnRealtime {
    schedule_switch: ScheduleSwitch,
    aligner: Aligner,
    frame: u64,
    /// When the frame began, CLOCK_MONOTONIC, ns.
    start_ns: u64,
    /// CLOCK_REALTIME less CLOCK_MONOTONIC, ns.
    offset_ns: i128,
    /// What the kernel says: the clock's error, or why there is none.
    said: Result<u64, String>,
    changes: Vec<Change>,
}

impl OnRealtime {
    fn new(offset_ns: i128) -> Self {
        let following = Following {
            reference: Reference::Realtime,
            within_ns: 200_000,
            lost_after_ns: REALTIME_LOST_AFTER_NS,
            known_within_ns: REALTIME_KNOWN_WITHIN_NS,
        };
        Self {
            schedule_switch: ScheduleSwitch::new(0),
            aligner: Aligner::new(following, &timelines(PLAN)),
            frame: 0,
            start_ns: 0,
            offset_ns,
            said: Ok(20_000),
            changes: Vec::new(),
        }
    }

    /// How far from a multiple of 100 ms of CLOCK_REALTIME the frame has begun, ns.
    fn beside_ns(&self) -> u64 {
        let into = (i128::from(self.start_ns) + self.offset_ns).rem_euclid(i128::from(FRAME_NS)) as u64;
        into.min(FRAME_NS - into)
    }

    /// Largest distance over some frames, ns.
    fn fly(&mut self, frames: u64) -> u64 {
        let mut worst_ns = 0;
        for _ in 0..frames {
            let measured = match &self.said {
                Ok(error_ns) => {
                    self.aligner.silent(None);
                    let (offset_ns, error_ns) = (self.offset_ns, *error_ns);
                    let sample = Sample { offset_ns, uncertainty_ns: 500, error_ns };
                    self.aligner.read(self.frame, self.start_ns, &sample)
                }
                Err(why) => {
                    self.aligner.silent(Some(why.clone()));
                    None
                }
            };
            self.changes.extend(self.aligner.step(
                &self.schedule_switch,
                self.start_ns + FRAME_NS / 2,
                measured,
            ));
            self.start_ns += FRAME_NS.saturating_add_signed(self.schedule_switch.shift(self.frame).unwrap());
            self.frame += 1;
            assert_eq!(
                self.schedule_switch.decide(self.frame, self.start_ns, 0, || false),
                Some(FrameDecision::Run(0))
            );
            let _ = self.schedule_switch.shift(self.frame);
            worst_ns = worst_ns.max(self.beside_ns());
        }
        worst_ns
    }
}

#[test]
fn frames_on_the_disciplined_clock_are_locked_to_its_multiples_and_stay_there() {
    for offset_ns in [0, 37 * 1_000_000, 1_700_000_000_073_456_789, -12_345_678] {
        let mut module = OnRealtime::new(offset_ns);
        module.fly(50);
        assert_eq!(module.changes, [Change::Locked], "{offset_ns}");
        assert!(module.fly(100) < 2_000, "{offset_ns}");
        assert_eq!(module.changes.len(), 1, "{:?}", module.changes);
    }
}

#[test]
fn disciplined_clock_that_is_set_or_kept_badly_or_by_nobody_is_lost_and_found_again() {
    let mut module = OnRealtime::new(0);
    module.fly(100);
    module.changes.clear();
    module.offset_ns += 3_000_000; // somebody sets it
    module.fly(30);
    assert!(matches!(&module.changes[..], [Change::Lost(why)] if why.contains("beside those of realtime")));
    module.fly(100);
    assert_eq!(module.changes.last(), Some(&Change::Locked));
    module.changes.clear();
    module.said = Ok(4_000_000);
    module.fly(70);
    assert!(
        matches!(&module.changes[..], [Change::Lost(why)] if why.contains("but to 40") && why.contains("known to 1000 us")),
        "{:?}",
        module.changes
    );
    module.said = Ok(20_000);
    module.fly(20);
    assert_eq!(module.changes.last(), Some(&Change::Locked));
    module.changes.clear();
    module.said = Err("CLOCK_REALTIME is not synchronised".into());
    module.fly(70);
    assert!(
        matches!(&module.changes[..], [Change::Lost(why)] if why.contains("not synchronised")),
        "{:?}",
        module.changes
    );
}

#[test]
fn leader_that_never_comes_is_lost_after_ten_seconds_and_no_frame_is_moved() {
    let mut world = World::new(1, 30.0 * MS);
    world.fly(300, GONE);
    assert!(
        matches!(&world.changes[..], [(at, Change::Lost(why))] if (100..110).contains(at) && why.contains("since frame 0"))
    );
    assert_eq!(world.start_ns, 300 * FRAME_NS);
    // It comes late: an aircraft may be flying, and its windows are not stopped for it.
    world.coarse = true;
    world.fly(400, FAIR);
    assert!(world.is(State::Locked));
    assert!(world.jerk_ns <= 100_000);
    assert!(world.start_ns.abs_diff(700 * FRAME_NS) < FRAME_NS / 2 + 10_000_000);
}

#[test]
fn monitor_that_is_held_up_misses_frames_and_makes_no_correction_twice() {
    let mut world = World::new(8, 3.0 * MS);
    world.fly(400, FAIR);
    for pause in [1, 2, 5, 30, 200] {
        // Frames pass that nobody looks at.
        for _ in 0..pause {
            let length_ns = FRAME_NS.saturating_add_signed(world.schedule_switch.shift(world.frame).unwrap());
            world.start_ns += length_ns;
            world.leader_ns += length_ns as f64 * (1.0 + world.drift / 1e9);
            world.frame += 1;
            world.schedule_switch.decide(world.frame, world.start_ns, 0, || false);
            let _ = world.schedule_switch.shift(world.frame);
        }
        world.fly(80, FAIR);
        assert!(world.fly(50, FAIR) < 20_000.0, "after {pause}");
    }
}

#[test]
fn old_reports_and_those_of_frames_that_never_were_are_not_taken() {
    let mut world = World::new(2, 0.0);
    world.fly(100, FAIR);
    let report =
        |exchanges| bateleur_contract::AlignmentReport { peer_minus_own_ns: 0, uncertainty_ns: 1, exchanges };
    let told = |major_frame, exchanges| AlignmentTold { report: report(exchanges), major_frame };
    assert_eq!(world.aligner.heard(&told(world.frame + 1, 900), world.frame), None);
    assert!(world.aligner.heard(&told(world.frame, 901), world.frame).is_some());
    assert_eq!(world.aligner.heard(&told(world.frame, 901), world.frame), None, "no other exchange");
    let before = *world.aligner.law();
    let ancient = Measured { frame: 3, phase_ns: 9e6, uncertainty_ns: 1.0, known_within_ns: 1.0 };
    world.aligner.take(&ancient, FRAME_NS, 0);
    assert_eq!(*world.aligner.law(), before);
}

#[test]
fn no_window_loses_more_than_half_at_a_frame_that_is_made_shorter() {
    let until_end = PLAN.replace("\"1ms\", duration = \"2ms\"", "\"99.95ms\", duration = \"50us\"");
    let limits = |text: &str| Limits::of(&timelines(text)[0]);
    assert_eq!(limits(PLAN), Limits { early_ns: 100_000, late_ns: 100_000, length_ns: FRAME_NS });
    assert_eq!(limits(&until_end), Limits { early_ns: 25_000, late_ns: 100_000, length_ns: FRAME_NS });
    let short = PLAN.replace("100ms", "20ms");
    assert_eq!(limits(&short).late_ns, 20_000, "a thousandth");
}
