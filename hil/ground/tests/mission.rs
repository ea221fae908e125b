//! The scripted ground station against a fake aircraft at the other end of the line.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

use bateleur_ground::{Link, Mission, MissionPlan, Outcome, Phase, Pilot, Progress, Severity};
use bateleur_messages::frame::{self, Decoder, Frame};
use bateleur_messages::ground::{BEAT, EstimatorOrder, Order};
use bateleur_messages::hil::{PILOT_TAKE_OFF, PilotOrder};
use bateleur_messages::telemetry::*;
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;

const STEP_NS: u64 = 100_000_000;
const SECOND_NS: u64 = 1_000_000_000;
/// The fake Controller reaches a way-point every so many steps.
const LEG_STEPS: u64 = 40;

#[derive(Default)]
struct FakePilot {
    orders: u32,
    deaf: u32,
}

impl Pilot for FakePilot {
    fn order(&mut self, order: PilotOrder) {
        assert_eq!(order.order, PILOT_TAKE_OFF);
        self.orders += 1;
    }

    fn confirmed(&mut self) -> bool {
        self.orders > self.deaf
    }
}

/// Functions that lose their memory when they are restarted cold.
#[derive(Default)]
struct Functions {
    hil: bool,
    estimator_since: Option<u64>,
    waypoints: BTreeMap<u8, u8>,
    navigation: bool,
    controller: bool,
    servo: bool,
    reached: u32,
    leg: u64,
    /// As the ground has set them; those of the plan otherwise.
    laps: Option<u32>,
}

/// Laps in the plan of the fake.
const PLANNED_LAPS: u32 = 2;

impl Functions {
    fn to_reach(&self) -> u32 {
        4 * self.laps.unwrap_or(PLANNED_LAPS) + 1
    }
}

struct Aircraft {
    stream: UnixStream,
    decoder: Decoder,
    functions: Functions,
    step: u64,
    sensors_step: u64,
    height_m: f64,
    /// It lies where it is, in a wind of 10 m/s.
    stands: bool,
    /// Its Estimator knows nothing yet: it says so, and zeros.
    aligns: bool,
    heard: BTreeMap<u8, u32>,
    /// Ignore one order in so many.
    deaf_every: Option<u32>,
    refuse_navigation: bool,
    silent_from: Option<u64>,
    /// Steps in which the Estimator says nothing.
    estimator_silent: std::ops::Range<u64>,
    /// No sensors come, whatever HIL mode is.
    simulator_is_away: bool,
    /// What the Estimator's host has to be added to its clock to have the module's, ns.
    estimator_began_ns: u64,
}

impl Aircraft {
    fn new() -> (Self, Link) {
        let (ours, theirs) = UnixStream::pair().unwrap();
        theirs.set_nonblocking(true).unwrap();
        let aircraft = Self {
            stream: theirs,
            decoder: Decoder::new(),
            functions: Functions::default(),
            step: 0,
            sensors_step: 0,
            height_m: 0.0,
            stands: false,
            aligns: false,
            heard: BTreeMap::new(),
            deaf_every: None,
            refuse_navigation: false,
            silent_from: None,
            estimator_silent: 0..0,
            simulator_is_away: false,
            estimator_began_ns: 0,
        };
        (aircraft, Link::new(ours).unwrap())
    }

    fn now_ns(&self) -> u64 {
        self.step * STEP_NS
    }

    fn tell(&mut self, telemetry: &Telemetry) {
        if self.silent_from.is_some_and(|from| self.step >= from) {
            return;
        }
        let (letter, data) = telemetry.parts();
        let mut bytes = Vec::new();
        frame::encode(letter, data, &mut bytes);
        self.stream.write_all(&bytes).unwrap();
    }

    fn heard(&self, letter: u8) -> u32 {
        self.heard.get(&letter).copied().unwrap_or(0)
    }

    fn live(&mut self, taken_off: bool) {
        self.step += 1;
        for frame in self.frames().into_iter().filter(|frame| frame.letter != BEAT) {
            let total: u32 = self.heard.values().sum();
            *self.heard.entry(frame.letter).or_default() += 1;
            if self.deaf_every.is_none_or(|every| !(total + 1).is_multiple_of(every)) {
                self.obey(&frame);
            }
        }
        self.fly(taken_off);
        self.report();
    }

    fn frames(&mut self) -> Vec<Frame> {
        let mut bytes = [0; 4096];
        match self.stream.read(&mut bytes) {
            Ok(length) => self.decoder.extend(&bytes[..length]).collect(),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Vec::new(),
            Err(error) => panic!("{error}"),
        }
    }

    fn obey(&mut self, frame: &Frame) {
        let order = Order::parse(frame.letter, &frame.data).unwrap();
        let step = self.step;
        let functions = &mut self.functions;
        let answers: &[(u8, u8)] = match order {
            Order::Hil { on } => {
                functions.hil = on;
                &[(FROM_HIL_INTERFACE, ACCEPTED)]
            }
            Order::InitialiseSensors { .. } => &[(FROM_IMU, REFUSED)],
            Order::Estimator(EstimatorOrder::Initialise { .. }) => {
                functions.estimator_since = Some(step);
                &[(FROM_ESTIMATOR, ACCEPTED)]
            }
            Order::Waypoint(point) => {
                functions.waypoints.insert(point.index, point.count);
                &[(FROM_CONTROLLER, ACCEPTED)]
            }
            Order::Navigation { .. } if self.refuse_navigation => &[(FROM_CONTROLLER, REFUSED)],
            Order::Navigation { on } => {
                (functions.navigation, functions.reached, functions.leg) = (on, 0, 0);
                &[(FROM_CONTROLLER, ACCEPTED)]
            }
            Order::Autopilot { on } => {
                (functions.controller, functions.servo) = (on, on);
                &[(FROM_CONTROLLER, ACCEPTED), (FROM_SERVO, ACCEPTED)]
            }
            Order::SetParameter(setting) => {
                assert_eq!(&setting.name[..9], b"CTL_LAPS\0");
                functions.laps = Some(setting.value as u32);
                &[(FROM_CONTROLLER, ACCEPTED)]
            }
            other => panic!("the script never sends {other:?}"),
        };
        let (now_ns, letter, first) = (self.now_ns(), frame.letter, frame.data[0]);
        for &(from, result) in answers {
            let time_ns = if from == FROM_ESTIMATOR { now_ns - self.estimator_began_ns } else { now_ns };
            self.tell(&Telemetry::Acknowledge(Acknowledge {
                time_ns,
                letter,
                first,
                from,
                result,
                reason: if result == REFUSED { Refusal::NoWaypoints as u32 } else { 0 },
            }));
        }
    }

    fn fly(&mut self, taken_off: bool) {
        let functions = &mut self.functions;
        if functions.hil && !self.simulator_is_away {
            self.sensors_step = self.step;
        }
        if taken_off && self.height_m < 160.0 {
            self.height_m += 1.0;
        }
        let complete = functions.waypoints.len() == 4;
        if functions.controller && functions.servo && functions.navigation && complete {
            functions.leg += 1;
            functions.reached = (functions.leg / LEG_STEPS).min(u64::from(functions.to_reach())) as u32;
        }
    }

    fn report(&mut self) {
        let due = |every: u64| self.step.is_multiple_of(every);
        let (half, one, two) = (due(5), due(10), due(20));
        if half {
            self.tell(&Telemetry::Imu(self.imu()));
            if !self.estimator_silent.contains(&self.step) {
                self.tell(&Telemetry::State(self.state()));
            }
        }
        if one {
            let autopilot = u16::from(self.functions.servo);
            let time_ns = self.now_ns();
            self.tell(&Telemetry::Servo(ServoTelemetry { time_ns, autopilot, ..Default::default() }));
        }
        if two {
            self.tell(&Telemetry::Primary(self.primary()));
            self.tell(&Telemetry::Navigation(self.navigation()));
        }
    }

    fn imu(&self) -> ImuTelemetry {
        let airspeed_mps = if self.stands {
            10.0
        } else if self.height_m > 0.0 {
            22.0
        } else {
            0.0
        };
        ImuTelemetry { measured_ns: self.sensors_step * STEP_NS, airspeed_mps, ..Default::default() }
    }

    fn state(&self) -> StateTelemetry {
        let status = match self.functions.estimator_since {
            None => 0,
            Some(since) if self.step < since + 20 => 1,
            Some(_) => 3,
        };
        if self.aligns {
            return StateTelemetry { valid_ns: self.sensors_step * STEP_NS, status: 1, ..Default::default() };
        }
        StateTelemetry {
            valid_ns: self.sensors_step * STEP_NS,
            position_ned_m: [0.0, 0.0, -self.height_m],
            velocity_ned_mps: [
                if self.stands { 0.1 } else { 22.0 },
                0.0,
                if self.height_m < 160.0 { -3.0 } else { 0.0 },
            ],
            status,
            ..Default::default()
        }
    }

    fn primary(&self) -> Primary {
        let functions = &self.functions;
        Primary {
            time_ns: self.now_ns(),
            autopilot: u8::from(functions.servo),
            controller: u8::from(functions.controller),
            estimator_enabled: u8::from(functions.estimator_since.is_some()),
            hil: u8::from(functions.hil),
            ..Default::default()
        }
    }

    fn navigation(&self) -> Navigation {
        let functions = &self.functions;
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        Navigation {
            time_ns: self.now_ns(),
            waypoints_reached: functions.reached,
            waypoint_count: functions.waypoints.len() as u32,
            flags: flag(functions.controller, NAVIGATION_AUTOPILOT)
                | flag(functions.navigation, NAVIGATION_ON)
                | flag(functions.reached == functions.to_reach(), NAVIGATION_FINISHED),
            ..Default::default()
        }
    }
}

struct Flight {
    aircraft: Aircraft,
    pilot: FakePilot,
    last: Progress,
    texts: Vec<(Severity, String)>,
}

/// Flies until the mission is over, with `meddle` called before each step.
fn fly(mut meddle: impl FnMut(&mut Aircraft, Phase)) -> Flight {
    fly_with(FakePilot::default(), &mut meddle)
}

fn fly_with(pilot: FakePilot, meddle: &mut dyn FnMut(&mut Aircraft, Phase)) -> Flight {
    fly_mission(Mission::new(MissionPlan::thesis()), pilot, meddle)
}

/// Three laps, by the script alone: the aircraft's plan knows nothing of them.
fn fly_three_laps(meddle: &mut dyn FnMut(&mut Aircraft, Phase)) -> Flight {
    let plan = MissionPlan { laps: 3, ..MissionPlan::thesis() };
    fly_mission(Mission::new(plan).setting_laps(), FakePilot::default(), meddle)
}

fn fly_mission(
    mut mission: Mission,
    mut pilot: FakePilot,
    meddle: &mut dyn FnMut(&mut Aircraft, Phase),
) -> Flight {
    let (mut aircraft, mut link) = Aircraft::new();
    let (mut texts, mut phase) = (Vec::new(), Phase::EnableHil);
    for step in 0..10_000 {
        meddle(&mut aircraft, phase);
        aircraft.live(pilot.confirmed());
        let last = mission.step(step * STEP_NS, &mut link, &mut pilot);
        phase = last.phase;
        texts.extend(last.events.iter().map(|event| (event.severity, event.text.clone())));
        if last.is_over() {
            return Flight { aircraft, pilot, last, texts };
        }
    }
    panic!("the mission never ended: {texts:?}");
}

fn failure(flight: &Flight) -> &str {
    match &flight.last.outcome {
        Outcome::Failed(text) => text,
        other => panic!("{other:?}"),
    }
}

#[test]
fn healthy_aircraft_flies_its_laps_and_each_order_goes_out_once() {
    let flight = fly(|_, _| ());
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    assert_eq!((flight.last.waypoints_reached, flight.last.rearmed, flight.pilot.orders), (9, 0, 1));
    let sendings: Vec<u32> = b"HIEWNA".iter().map(|&letter| flight.aircraft.heard(letter)).collect();
    assert_eq!(sendings, [1, 1, 1, 4, 1, 1]);
    let before_take_off = 5 * SECOND_NS;
    let climb_and_laps = 7 * SECOND_NS + 9 * LEG_STEPS * STEP_NS;
    assert!(flight.last.time_ns < before_take_off + climb_and_laps + 6 * SECOND_NS, "{:?}", flight.last);
}

#[test]
fn orders_that_get_lost_are_sent_again() {
    let flight = fly(|aircraft, _| aircraft.deaf_every = Some(2));
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
}

#[test]
fn deaf_pilot_is_called_again() {
    let flight = fly_with(FakePilot { orders: 0, deaf: 3 }, &mut |_, _| ());
    assert_eq!((flight.last.outcome, flight.pilot.orders), (Outcome::Finished, 4));
}

/// The Controller has nothing left of what it was told.
fn restart_controller_cold(aircraft: &mut Aircraft) {
    let Functions { hil, estimator_since, servo, .. } = std::mem::take(&mut aircraft.functions);
    aircraft.functions = Functions { hil, estimator_since, servo, ..Functions::default() };
}

#[test]
fn controller_restarted_cold_gets_way_points_navigation_and_autopilot_again() {
    let mut killed = false;
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached == 3 && !killed {
            killed = true;
            restart_controller_cold(aircraft);
        }
    });
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    let sendings: Vec<u32> = b"WNA".iter().map(|&letter| flight.aircraft.heard(letter)).collect();
    assert_eq!((sendings, flight.last.rearmed), (vec![8, 2, 2], 3), "{:?}", flight.texts);
}

#[test]
fn script_sets_the_laps_of_its_mission_and_flies_all_of_them() {
    let flight = fly_three_laps(&mut |_, _| ());
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    assert_eq!((flight.last.waypoints_reached, flight.aircraft.heard(b'Y')), (13, 1));
}

#[test]
fn laps_that_a_cold_controller_has_lost_are_set_again_with_its_way_points() {
    let mut killed = false;
    let flight = fly_three_laps(&mut |aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached == 3 && !killed {
            killed = true;
            restart_controller_cold(aircraft);
        }
    });
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    assert_eq!((flight.last.waypoints_reached, flight.aircraft.heard(b'Y')), (13, 2));
}

#[test]
fn controller_that_finishes_before_all_laps_fails_the_script_and_what_to_set_is_named() {
    let flight = fly_three_laps(&mut |aircraft, phase| {
        if phase == Phase::Watch {
            aircraft.functions.laps = None;
        }
    });
    let why = failure(&flight);
    assert!(why.contains("after 9 of 13 way-points") && why.contains("set CTL_LAPS=3"), "{why}");
}

#[test]
fn aircraft_that_nobody_takes_off_fails_with_a_word_about_the_pilot() {
    let flight = fly(|aircraft, _| aircraft.height_m = 0.0);
    let why = failure(&flight);
    assert!(why.contains("safety pilot at the sticks") && why.contains("take_off = \"autopilot\""), "{why}");
}

#[test]
fn servo_hil_and_estimator_restarted_cold_are_armed_again() {
    for subject in [b'A', b'H', b'E'] {
        let mut killed = false;
        let flight = fly(|aircraft, phase| {
            if phase != Phase::Watch || aircraft.functions.reached < 3 || killed {
                return;
            }
            killed = true;
            match subject {
                b'A' => aircraft.functions.servo = false,
                b'H' => aircraft.functions.hil = false,
                _ => aircraft.functions.estimator_since = None,
            }
        });
        assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
        assert_eq!((flight.aircraft.heard(subject), flight.last.rearmed), (2, 1), "{:?}", flight.texts);
    }
}

#[test]
fn lost_hil_mode_is_noticed_within_two_imu_messages() {
    let (mut lost_at, mut back_at) = (None, None);
    fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached == 1 && lost_at.is_none() {
            aircraft.functions.hil = false;
            lost_at = Some(aircraft.step);
        } else if lost_at.is_some() && back_at.is_none() && aircraft.functions.hil {
            back_at = Some(aircraft.step);
        }
    });
    assert!(back_at.unwrap() - lost_at.unwrap() <= 12, "{lost_at:?} to {back_at:?}");
}

#[test]
fn simulator_that_is_away_is_no_lost_hil_mode_and_is_told_once() {
    let mut since = None;
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached == 1 {
            since.get_or_insert(aircraft.step);
        }
        aircraft.simulator_is_away = since.is_some_and(|since| (since..since + 40).contains(&aircraft.step));
    });
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    let told = |text: &str| flight.texts.iter().filter(|(_, told)| told.contains(text)).count();
    assert_eq!((told("HIL mode is lost"), told("no sensors come")), (0, 1), "{:?}", flight.texts);
    assert_eq!(flight.aircraft.heard(b'H'), 2);
}

#[test]
fn estimators_host_that_began_anew_is_no_new_clock_of_the_module_and_is_initialised_once() {
    let mut killed = false;
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached == 3 && !killed {
            killed = true;
            aircraft.functions.estimator_since = None;
            aircraft.estimator_began_ns = aircraft.now_ns();
        }
    });
    assert_eq!(flight.last.outcome, Outcome::Finished, "{:?}", flight.texts);
    let told = |text: &str| flight.texts.iter().filter(|(_, told)| told.contains(text)).count();
    assert_eq!((told("initialising it again"), told("clock began anew")), (1, 0), "{:?}", flight.texts);
    assert_eq!(flight.aircraft.heard(b'E'), 2);
}

#[test]
fn silent_line_fails_with_the_likely_reason() {
    let flight = fly(|aircraft, _| aircraft.silent_from = Some(0));
    assert!(failure(&flight).contains("is it the right line"), "{}", failure(&flight));
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Climb {
            aircraft.silent_from.get_or_insert(aircraft.step);
        }
    });
    assert!(failure(&flight).contains("no telemetry for 30 s while climbing"), "{}", failure(&flight));
    assert!(flight.texts.iter().any(|(_, text)| text == "no telemetry for 5 s"));
}

#[test]
fn silent_estimator_is_told_once_and_its_last_height_is_not_shown_as_if_it_were_of_now() {
    let (mut aircraft, mut link) = Aircraft::new();
    let mut mission = Mission::new(MissionPlan::thesis());
    let mut pilot = FakePilot::default();
    let (mut texts, mut shown) = (Vec::new(), Vec::new());
    for step in 0..700 {
        aircraft.estimator_silent = 300..400; // 30 s to 40 s
        aircraft.live(pilot.confirmed());
        let progress = mission.step(step * STEP_NS, &mut link, &mut pilot);
        texts.extend(progress.events.iter().map(|event| event.text.clone()));
        shown.push((progress.altitude_m.is_some(), progress.estimator_silent_ns.is_some()));
    }
    assert_eq!((shown[320], shown[380], shown[450]), ((true, false), (false, true), (true, false)));
    let told = |text: &str| texts.iter().filter(|told| told.contains(text)).count();
    assert_eq!((told("Estimator has been silent"), told("Estimator is back")), (1, 1), "{texts:?}");
}

#[test]
fn refusal_is_named_when_time_is_over_with_its_reason() {
    let flight = fly(|aircraft, _| aircraft.refuse_navigation = true);
    let why = failure(&flight);
    assert!(why.contains("Controller refuses the order: it has no way-points"), "{why}");
}

#[test]
fn aircraft_on_the_ground_ends_the_mission() {
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached >= 2 {
            aircraft.height_m = -1.0;
        }
    });
    assert!(failure(&flight).contains("came down"), "{}", failure(&flight));
}

#[test]
fn wreck_in_the_wind_ends_the_mission() {
    let flight = fly(|aircraft, phase| {
        if phase == Phase::Watch && aircraft.functions.reached >= 2 {
            (aircraft.height_m, aircraft.stands) = (-1.0, true);
        }
    });
    assert!(failure(&flight).contains("came down"), "{}", failure(&flight));
}

#[test]
fn estimator_that_is_aligned_in_flight_is_no_wreck() {
    let mut steps = 0;
    let flight = fly(|aircraft, phase| {
        steps += u32::from(phase == Phase::Watch && aircraft.functions.reached >= 2);
        aircraft.aligns = (1..100).contains(&steps);
    });
    assert!(steps > 100, "ten seconds and more, and it flies on: {:?}", flight.last.outcome);
    assert_eq!(flight.last.outcome, Outcome::Finished);
}

#[test]
fn line_that_is_closed_ends_the_mission() {
    let (aircraft, mut link) = Aircraft::new();
    drop(aircraft);
    let last = Mission::new(MissionPlan::thesis()).step(0, &mut link, &mut FakePilot::default());
    assert_eq!(
        last.outcome,
        Outcome::Failed("enabling HIL mode: the line was closed by the other end".into())
    );
}
