//! Simulators: ours over every protocol, and one that somebody could have written from docs/src/hil.md alone, on a library
//! that is not ours (`tests/peers/simulator.py`, pymavlink).

use bateleur_messages::{Custom, GpsPosition, Rates, RawAnalog, SimulatorLink, State};
use bateleur_recording::{self as log, Recording};
use bateleur_tests::{Ended, Peer, TWO_LAPS, alone, among_others, bateleur, flight_schedule};
use serde_json::Value;

/// Mode of a module in HIL mode whose safety pilot flies: armed, manual, HIL.
const MANUAL: u64 = 128 + 64 + 32;

fn fly(protocol: &str, choices: &[&str]) -> Value {
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--protocol", protocol, "--schedule"];
    arguments.push(schedule.to_str().unwrap());
    arguments.extend(choices);
    bateleur(&arguments).end().expect_code(0).summary()
}

fn assert_two_laps(summary: &Value) {
    assert_eq!(summary["completed"], true, "{}", summary["failure"]);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
    for (score, bound) in [("altitude_rms_m", 1.5), ("straight_cross_track_rms_m", 2.0)] {
        assert!(summary[score].as_f64().unwrap() <= bound, "{score} = {}", summary[score]);
    }
}

#[test]
fn two_laps_over_mavlink_and_the_same_seed_is_the_same_flight() {
    let _turn = among_others();
    let gusty = ["--seed", "5", "--wind", "5", "--wind-from", "200", "--turbulence", "light"];
    let flights = [fly("mavlink", &gusty), fly("mavlink", &gusty)];
    flights.iter().for_each(assert_two_laps);
    assert_eq!(flights[0]["digest"], flights[1]["digest"]);
}

#[test]
fn two_laps_over_mavlink_on_tcp() {
    let _turn = among_others();
    assert_two_laps(&fly("mavlink-tcp", &["--seed", "6"]));
}

/// What the module left, and what the peer saw of it.
struct Exchange {
    seen: Value,
    log: Recording,
}

impl Exchange {
    fn last<T: zerocopy::FromBytes + Copy>(&self, topic: &str) -> T {
        self.all(topic).last().copied().unwrap_or_else(|| panic!("nothing came through {topic}")).1
    }

    fn all<T: zerocopy::FromBytes>(&self, topic: &str) -> Vec<(u64, T)> {
        self.log.tracks.get(topic).map(log::Track::typed).unwrap_or_default()
    }

    fn link(&self) -> SimulatorLink {
        self.last("/hil_interface/link")
    }
}

/// The module and the peer, for some seconds of module time. `None` if there is no Python to run the peer with.
fn exchange(clock: &[&str], transport: &str, peer: &[&str], more: &[&str]) -> Option<Exchange> {
    let mut choices = vec!["--transport", transport];
    choices.extend(peer);
    let peer = Peer::start("simulator.py", &choices)?;
    let protocol = if transport == "tcp" { "mavlink-tcp" } else { "mavlink" };
    let set = |attribute: &str, value: &str| ["--set".into(), format!("{attribute}={value}")];
    let schedule = flight_schedule();
    let mut arguments: Vec<String> =
        ["run", "--record", "--schedule", schedule.to_str().unwrap()].map(str::to_owned).to_vec();
    arguments.extend(clock.iter().map(|word| (*word).to_owned()));
    arguments.extend(set("hil_interface.protocol", protocol));
    arguments.extend(set("hil_interface.simulator", peer.address()));
    arguments.extend(set("hil_interface.hil_mode", "true"));
    arguments.extend(set("command.device", "/dev/nowhere"));
    more.iter().for_each(|choice| {
        arguments
            .extend(set("hil_interface", choice).map(|word| word.replace("hil_interface=", "hil_interface.")))
    });
    let ended: Ended = bateleur(&arguments).end().expect_code(0);
    let seen = peer.finish();
    let log = log::read(ended.folder().join("ports.mcap"), |_| true).unwrap();
    eprintln!("{seen}");
    let exchange = Exchange { seen, log };
    eprintln!("{:?}", exchange.link());
    Some(exchange)
}

/// The aircraft of the peer stands on the runway and looks east: every unit and sign that is wrong shows here.
fn assert_stands_looking_east(exchange: &Exchange) {
    let state: State = exchange.last("/estimator/state");
    let degrees = state.euler_rad.map(f64::to_degrees);
    assert!(state.status >= 2, "{state:?}");
    assert!(
        degrees[0].abs() < 1.5 && degrees[1].abs() < 1.5 && (degrees[2] - 90.0).abs() < 4.0,
        "{degrees:?}"
    );
    assert!(state.position_ned_m.iter().all(|metres| metres.abs() < 4.0), "{:?}", state.position_ned_m);
    assert!(state.velocity_ned_mps.iter().all(|speed| speed.abs() < 0.3), "{:?}", state.velocity_ned_mps);
}

fn assert_right_questions(seen: &Value) {
    assert_eq!(seen["systems"], serde_json::json!([[1, 1]]));
    assert_eq!(seen["modes"], serde_json::json!([MANUAL]));
    assert_eq!(seen["finite"], true);
    assert_eq!((&seen["bad"], &seen["other"]), (&Value::from(0), &Value::from(0)));
    // The safety pilot's sticks come back as controls: aileron, elevator, throttle, rudder.
    assert_eq!(seen["controls"], serde_json::json!([0.04, -0.04, 0.1, 0.02, 0.0]));
    assert_eq!(seen["used"], serde_json::json!([0, 1, 2, 3]));
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap()
}

#[test]
fn simulator_by_others_exchanges_in_lockstep_on_the_virtual_clock() {
    let _turn = among_others();
    for transport in ["udp", "tcp"] {
        let Some(exchange) = exchange(&["--fast", "--until", "40"], transport, &[], &[]) else { return };
        let seen = &exchange.seen;
        assert_right_questions(seen);
        assert_eq!(seen["flags"], serde_json::json!([1]));
        assert_eq!((number(&seen["repeated"]), number(&seen["questions"])), (0, 2_000));
        assert_eq!(seen["steps_us"], serde_json::json!({ "20000": 1_999 }), "every cycle, without a gap");
        assert_eq!(number(&seen["heartbeats"]), 40);
        assert_stands_looking_east(&exchange);
        let link = exchange.link();
        assert_eq!((link.accepted + link.missing, link.missing), (2_000, 0), "{transport}");
        assert_eq!((link.refused, link.invalid, link.stale, link.lost, link.strangers), (0, 0, 0, 0, 0));
        let raw: RawAnalog = exchange.last("/hil_interface/raw_analog");
        assert_eq!(raw.interval_ns, 20_000_000);
        assert!(
            (raw.static_pressure_pa - 101_325.0).abs() < 0.01 && (raw.temperature_k - 288.15).abs() < 0.001
        );
        let fix: GpsPosition = exchange.last("/gps/position");
        assert!(fix.position_ned_m.iter().all(|metres| metres.abs() < 1.0), "{fix:?}");
        assert_eq!(fix.horizontal_accuracy_m, 1.5);
        let custom: Custom = exchange.last("/hil_interface/custom");
        assert_eq!((custom.pilot_aileron_us, custom.pilot_throttle_us), (1520, 1100));
    }
}

#[test]
fn lossy_link_costs_questions_and_no_sensors_on_the_virtual_clock() {
    let _turn = among_others();
    let Some(exchange) = exchange(&["--fast", "--until", "8"], "udp", &["--lose", "0.05"], &[]) else {
        return;
    };
    assert_right_questions(&exchange.seen);
    let link = exchange.link();
    assert!(link.repeated >= 10 && number(&exchange.seen["repeated"]) >= 10, "{link:?}");
    assert_eq!(link.missing, 0, "{link:?}");
    assert_eq!(link.lost, 0, "an answer that was lost came again, with the same number: {link:?}");
}

#[test]
fn what_must_not_be_believed_is_counted_and_reaches_nobody() {
    let _turn = among_others();
    let Some(exchange) = exchange(&["--fast", "--until", "40"], "udp", &["--hostile"], &[]) else { return };
    assert_right_questions(&exchange.seen);
    assert_stands_looking_east(&exchange);
    let rates: Vec<(u64, Rates)> = exchange.all("/imu/orientation");
    assert!(rates.len() > 1_900, "{}", rates.len());
    assert!(rates.iter().all(|(_, rates)| rates.rates_radps.iter().all(|rate| rate.abs() < 0.01)));
    let link = exchange.link();
    for (name, count) in [
        ("refused", link.refused),
        ("invalid", link.invalid),
        ("stale", link.stale),
        ("strangers", link.strangers),
        ("unused", link.unused),
    ] {
        assert!(count > 50, "{name}: {link:?}");
    }
}

#[test]
fn simulator_with_steps_and_a_clock_of_its_own_is_walked_to_the_modules_time() {
    let _turn = among_others();
    for transport in ["udp", "tcp"] {
        let Some(exchange) = exchange(&["--fast", "--until", "40"], transport, &["--own-steps-ms", "4"], &[])
        else {
            return;
        };
        assert_stands_looking_east(&exchange);
        let link = exchange.link();
        assert_eq!((link.missing, link.clock_ties), (0, 1), "{link:?}");
        let raw: Vec<(u64, RawAnalog)> = exchange.all("/hil_interface/raw_analog");
        assert!(raw[1..].iter().all(|(_, raw)| raw.interval_ns == 20_000_000));
        let questions = number(&exchange.seen["questions"]);
        assert!((9_990..=10_000).contains(&questions), "five steps a cycle: {questions}");
    }
}

#[test]
fn older_version_of_the_protocol_is_understood() {
    let _turn = among_others();
    let Some(exchange) = exchange(&["--fast", "--until", "40"], "udp", &["--version", "1"], &[]) else {
        return;
    };
    assert_stands_looking_east(&exchange);
    assert_eq!(exchange.link().missing, 0);
}

#[test]
fn connection_that_is_closed_is_made_again_within_a_second_of_module_time() {
    let _turn = among_others();
    let Some(exchange) = exchange(&["--fast", "--until", "10"], "tcp", &["--hang-up-after", "100"], &[])
    else {
        return;
    };
    let link = exchange.link();
    assert_eq!((link.connections, number(&exchange.seen["connections"])), (2, 2), "{link:?}");
    assert!(link.errors > 0 && link.accepted >= 440 && link.missing <= 60, "{link:?}");
}

#[test]
fn sensor_that_is_never_updated_is_never_measured() {
    let _turn = among_others();
    // The magnetometer, bits 6 to 8.
    let Some(exchange) = exchange(&["--fast", "--until", "5"], "udp", &["--without", "0x1C0"], &[]) else {
        return;
    };
    let raw: Vec<(u64, RawAnalog)> = exchange.all("/hil_interface/raw_analog");
    assert!(raw.len() > 200 && raw.iter().all(|(_, raw)| raw.field_gauss.iter().all(|value| value.is_nan())));
    assert!(exchange.all::<Rates>("/imu/orientation").len() > 200);
    assert!(exchange.all::<bateleur_messages::Magnetization>("/imu/magnetization").is_empty());
}

#[test]
fn word_that_is_no_protocol_is_refused_with_those_that_are() {
    let schedule = flight_schedule();
    let set = "hil_interface.protocol=telnet";
    let run = ["run", "--fast", "--schedule", schedule.to_str().unwrap(), "--set", set, "--until", "1"];
    let ended = bateleur(&run).end().expect_code(2);
    ended.expect_words(&["telnet", "mavlink-tcp"]);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn simulator_by_others_is_flown_on_the_wall_clock() {
        let _turn = alone();
        for transport in ["udp", "tcp"] {
            let Some(exchange) = exchange(&["--until", "8"], transport, &[], &[]) else { return };
            assert_right_questions(&exchange.seen);
            let link = exchange.link();
            // How quickly the other program answers on a busy machine is not judged here.
            assert!(link.accepted >= 200, "{link:?}");
            assert_eq!((link.refused, link.invalid, link.strangers), (0, 0, 0), "{link:?}");
        }
    }

    #[test]
    fn free_running_module_on_the_wall_clock_says_so_and_takes_what_is_newest() {
        let _turn = alone();
        let Some(exchange) = exchange(&["--until", "5"], "udp", &[], &["lockstep=false"]) else { return };
        assert_eq!(exchange.seen["flags"], serde_json::json!([0]));
        assert_eq!(number(&exchange.seen["repeated"]), 0);
        let link = exchange.link();
        assert!(link.accepted > 100 && link.lockstep == 0, "{link:?}");
    }
}
