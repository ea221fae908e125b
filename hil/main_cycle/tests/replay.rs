//! Recordings that are made up, replayed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use bateleur_main_cycle::{
    Given, Instants, OUTPUTS, ReplayError, Replayed, Settings, Topics, Validity, replay,
};
use bateleur_messages::{Custom, Message, RawAnalog, RawGps, ServoTimers, find};
use bateleur_recording::{PortLog, read, topic};
use zerocopy::IntoBytes;

const PERIOD_NS: u64 = 20_000_000;
const CYCLES: u64 = 200;

fn settings_with(controller: Given) -> Result<Settings, bateleur_apex::StartError> {
    let instants = Instants {
        gps_ns: 3_200_000,
        imu_ns: 3_800_000,
        estimator_ns: 4_400_000,
        controller_ns: 6_500_000,
        servo_ns: 7_600_000,
        period_ns: PERIOD_NS,
    };
    let short = 40_000_000;
    let validity = Validity {
        gps_raw_ns: 500_000_000,
        imu_raw_ns: short,
        estimator_gps_ns: [500_000_000; 2],
        estimator_imu_ns: [short; 4],
        estimator_command_ns: Some(short),
        controller_ns: [short; 4],
        controller_range_ns: Some(short),
        servo_ns: [short, 100_000_000],
    };
    let none = BTreeMap::new;
    Settings::read([none(), none(), none(), controller, none()], instants, validity)
}

fn topics() -> Topics {
    let of = |port: &str| topic("hil_interface", port);
    let order = |to: &str| topic("command", to);
    Topics {
        sensors: [of("raw_gps"), of("raw_analog"), of("custom")],
        range: Some(of("range")),
        orders: [order("to_imu"), order("to_estimator"), order("to_controller"), order("to_servo")],
        outputs: OUTPUTS.map(|(partition, port)| topic(partition, port)),
    }
}

/// What the safety pilot's elevator stick says in cycle `n`.
fn stick(n: u64) -> u16 {
    1400 + n as u16
}

/// A recording of an aircraft that stands on the runway, with its sticks moved; `timers` is what its Servo gave in each cycle.
fn record(path: &Path, timers: impl Fn(u64) -> Option<ServoTimers>, sensors: bool) {
    record_at(path, timers, sensors, |time_ns| time_ns);
}

/// As [`record`]; `written` is the time that a message of this time carries.
fn record_at(
    path: &Path,
    timers: impl Fn(u64) -> Option<ServoTimers>,
    sensors: bool,
    written: impl Fn(u64) -> u64,
) {
    let mut log = PortLog::create(path).unwrap();
    let topics = topics();
    let mut channel = |topic: &str, message: &str| log.add_channel(topic, find(message).unwrap()).unwrap();
    let raw = channel(&topics.sensors[1], RawAnalog::NAME);
    let sticks = channel(&topics.sensors[2], Custom::NAME);
    let fixes = channel(&topics.sensors[0], RawGps::NAME);
    let servo = channel(&topics.outputs[8], ServoTimers::NAME);
    for n in 0..CYCLES {
        let start_ns = n * PERIOD_NS;
        let analog = RawAnalog {
            measured_ns: start_ns,
            interval_ns: PERIOD_NS,
            specific_force_mps2: [0.0, 0.0, -9.81],
            static_pressure_pa: 101_325.0,
            ..RawAnalog::default()
        };
        let custom = Custom {
            measured_ns: start_ns,
            pilot_aileron_us: 1500,
            pilot_elevator_us: stick(n),
            pilot_rudder_us: 1500,
            pilot_throttle_us: 1000,
            ..Custom::default()
        };
        if sensors {
            log.write(raw, n, written(start_ns + 400_000), analog.as_bytes()).unwrap();
            log.write(sticks, n, written(start_ns + 500_000), custom.as_bytes()).unwrap();
            log.write(fixes, n, written(start_ns + 500_000), RawGps::default().as_bytes()).unwrap();
        }
        if let Some(timers) = timers(n) {
            log.write(servo, n, written(start_ns + 7_600_000), timers.as_bytes()).unwrap();
        }
    }
    log.finish().unwrap();
}

/// What the safety pilot flies, with the autopilot off.
fn by_hand(n: u64) -> Option<ServoTimers> {
    Some(ServoTimers {
        aileron_left_us: 1500,
        aileron_right_us: 1500,
        elevator_us: stick(n),
        rudder_us: 1500,
        throttle_us: 1000,
        autopilot: 0,
        cycle: n as u32 + 1,
    })
}

fn replayed(timers: impl Fn(u64) -> Option<ServoTimers>) -> Replayed {
    let folder = tempfile::tempdir().unwrap();
    let (log, own) = files(folder.path());
    record(&log, timers, true);
    replay(&log, settings_with(Given::new()).unwrap(), &topics(), &own).unwrap()
}

fn files(folder: &Path) -> (PathBuf, PathBuf) {
    (folder.join("ports.mcap"), folder.join("loop.mcap"))
}

#[test]
fn words_of_the_safety_pilot_are_those_of_his_sticks_in_every_cycle() {
    let result = replayed(by_hand);
    assert_eq!((result.cycles, result.words.compared, result.words.different), (CYCLES, 6 * CYCLES, 0));
    assert_eq!((result.words.absent_cycles, result.too_late, result.flaw), (0, 0, None));
}

#[test]
fn one_word_that_is_off_by_one_is_found_with_its_cycle_and_name() {
    let off = |n: u64| {
        let timers = by_hand(n).unwrap();
        Some(if n == 77 { ServoTimers { rudder_us: 1501, ..timers } } else { timers })
    };
    let words = replayed(off).words;
    assert_eq!(
        (words.different, words.first_ns, words.last_ns),
        (1, Some(1_547_600_000), Some(1_547_600_000))
    );
    assert_eq!(words.greatest, BTreeMap::from([("rudder_us", 1)]));
}

#[test]
fn cycle_without_words_is_counted_and_the_others_are_compared() {
    let words = replayed(|n| by_hand(n).filter(|_| n != 50 && n != 51)).words;
    assert_eq!((words.different, words.absent_cycles, words.compared), (0, 2, 6 * (CYCLES - 2)));
}

#[test]
fn the_loops_own_log_has_every_port_with_the_times_of_its_turn() {
    let folder = tempfile::tempdir().unwrap();
    let (log, own) = files(folder.path());
    record(&log, by_hand, true);
    replay(&log, settings_with(Given::new()).unwrap(), &topics(), &own).unwrap();
    let recording = read(&own, |_| true).unwrap();
    let timers = recording.track("/servo/timers", ServoTimers::NAME).unwrap();
    assert_eq!(timers.samples.len() as u64, CYCLES);
    assert_eq!(timers.samples[10].0, 10 * PERIOD_NS + 7_600_000);
    assert_eq!(recording.counts["/estimator/state"], CYCLES);
}

#[test]
fn log_without_sensors_is_refused_by_the_name_of_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let (log, own) = files(folder.path());
    record(&log, by_hand, false);
    let error = replay(&log, settings_with(Given::new()).unwrap(), &topics(), &own).unwrap_err();
    assert!(matches!(error, ReplayError::Missing(_)), "{error}");
    assert!(error.to_string().contains("hil_interface.raw_analog"), "{error}");
}

#[test]
fn attributes_that_the_partition_would_refuse_are_refused() {
    let refused = |name: &str, value: serde_json::Value| {
        settings_with(Given::from([(name.to_owned(), value)])).unwrap_err().to_string()
    };
    assert!(refused("path", "square".into()).contains("attribute path = \"square\""));
    assert!(refused("lap", 3.into()).contains("did you mean laps?"));
}

#[test]
fn message_with_a_time_far_ahead_is_left_out_and_said_and_the_rest_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let (log, own) = files(folder.path());
    // Sensors of one cycle, a day, some seconds and all of time ahead; the sticks are as they were.
    for ahead_ns in [17_592_000_000_000, 5_000_000_000, u64::MAX / 2] {
        let astray = 77 * PERIOD_NS + 400_000;
        record_at(
            &log,
            by_hand,
            true,
            |time_ns| if time_ns == astray { time_ns + ahead_ns } else { time_ns },
        );
        let result = replay(&log, settings_with(Given::new()).unwrap(), &topics(), &own).unwrap();
        assert_eq!((result.cycles, result.words.compared, result.words.different), (CYCLES, 6 * CYCLES, 0));
        assert_eq!((result.words.absent_cycles, result.too_late), (0, 0));
        let flaw = "has messages with a time more than 2 s ahead of all others: 1 left out";
        assert_eq!(result.flaw.as_deref(), Some(flaw), "{ahead_ns}");
    }
}

#[test]
fn recording_with_a_gap_of_minutes_is_replayed_behind_it_too() {
    let folder = tempfile::tempdir().unwrap();
    let (log, own) = files(folder.path());
    let gap_cycles = 120 * 50;
    let from_ns = 100 * PERIOD_NS;
    let written = |time_ns| if time_ns < from_ns { time_ns } else { time_ns + gap_cycles * PERIOD_NS };
    record_at(&log, by_hand, true, written);
    let result = replay(&log, settings_with(Given::new()).unwrap(), &topics(), &own).unwrap();
    assert_eq!((result.cycles, result.words.absent_cycles), (CYCLES + gap_cycles, gap_cycles));
    assert_eq!((result.words.compared, result.words.different), (6 * CYCLES, 0));
    assert_eq!((result.too_late, result.flaw), (0, None));
}
