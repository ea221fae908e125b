//! `bateleur_foxglove` as Foxglove sees it: a client of its protocol that somebody else wrote, which decodes what comes with somebody else's
//! decoder. The program has a workspace of its own; it is tested where it was built.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use bateleur_recording::PORTS_FILE;
use bateleur_tests::{Peer, Started, alone, bateleur, flight_schedule, other, repository};
use rustix::process::Signal;
use serde_json::Value;

/// How long the flight is watched.
const WATCHED: Duration = Duration::from_secs(10);

/// Whether two values are the same, but for how their last digit is read.
fn is_same(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Array(one), Value::Array(other)) => {
            one.len() == other.len() && one.iter().zip(other).all(|(one, other)| is_same(one, other))
        }
        _ => match (one.as_f64(), other.as_f64()) {
            (Some(one), Some(other)) => (one - other).abs() <= 1e-14 * one.abs(),
            _ => one == other,
        },
    }
}

/// A server for a module, and its address. `None` without Python, which has been said: nobody could read from it.
pub(crate) fn serve(module: &str) -> Option<(Started, String)> {
    let program = repository().join("hil/foxglove/target/release/bateleur_foxglove");
    assert!(program.is_file(), "{} is not built", program.display());
    bateleur_tests::python()?;
    let mut server = other(&program, &["--module", module, "--listen", "127.0.0.1:0"]);
    server.await_words("foxglove: ws://");
    let said = server.said();
    let address = said.lines().find_map(|line| line.strip_prefix("foxglove: ")).unwrap();
    Some((server, address.to_owned()))
}

/// Every message that was recorded between the first and the last that the client has of a topic reached it; how many those are.
#[track_caller]
pub(crate) fn assert_nothing_lost(topics: &Value, recording: &Path) -> usize {
    let mut recorded: BTreeMap<String, Vec<u64>> = BTreeMap::new();
    bateleur_recording::for_each(recording, |entry| {
        recorded.entry(entry.topic.to_owned()).or_default().push(entry.time_ns);
    })
    .unwrap();
    let mut compared = 0;
    for (topic, times) in &recorded {
        let Some(heard) = topics.get(topic).filter(|heard| heard["count"].as_u64() > Some(1)) else {
            continue;
        };
        let [first, last] = ["first_ns", "last_ns"].map(|what| heard[what].as_u64().unwrap());
        let expected = times.iter().filter(|time| (first..=last).contains(*time)).count();
        assert_eq!(heard["count"].as_u64().unwrap() as usize, expected, "{topic} lost some: {heard}");
        compared += expected;
    }
    compared
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    #[ignore = "needs a program of another workspace: cargo build --release --manifest-path hil/foxglove/Cargo.toml, or `cargo verify`"]
    fn every_message_of_every_port_of_a_flight_reaches_a_client_of_foxgloves_protocol_and_a_fault_does() {
        let _turn = alone();
        let schedule = flight_schedule();
        let flight = bateleur(&["fly", "--schedule", schedule.to_str().unwrap()]);
        let module = flight.module();
        let listed =
            bateleur(&["ports", "list", "--format", "json", "--module", &module]).end().expect_code(0);
        let ports: Value = serde_json::from_str(&listed.stdout).unwrap();
        let Some((server, address)) = serve(&module) else { return };
        let peer = Peer::start("foxglove.py", &[&address]).unwrap();
        assert_eq!(peer.ready["server"]["name"], "bateleur fcu");
        assert_eq!(peer.ready["server"]["capabilities"], serde_json::json!(["time"]), "it takes no orders");
        std::thread::sleep(WATCHED / 2);
        bateleur(&["kill", "gps", "--module", &module]).end().expect_code(0);
        std::thread::sleep(WATCHED / 2);
        // One who comes late is told of the fault, too.
        let late = Peer::start("foxglove.py", &[&address]).unwrap();
        std::thread::sleep(Duration::from_secs(2));
        let (heard, heard_late) = (peer.finish(), late.finish());
        flight.signal(Signal::INT);
        let flown = flight.end();
        let closing = server.end().expect_code(0);
        closing.expect_words(&["messages handed on, 0 not seen"]);

        let topics = heard["topics"].as_object().unwrap();
        for port in ports.as_array().unwrap() {
            let topic = format!("/{}", port["source"].as_str().unwrap().replace('.', "/"));
            assert!(topics.contains_key(&topic), "{topic} is not offered: {:?}", topics.keys());
        }
        assert!(heard["times"].as_u64().unwrap() > 50, "module time is told");
        for heard in [&heard, &heard_late] {
            // On a busy machine the log also tells of windows that were late.
            let entries = heard["topics"]["/health"]["all"].as_array().unwrap();
            let is_kill = |fault: &&Value| fault["partition"] == "gps" && fault["error"] == "killed";
            assert_eq!(entries.iter().filter(is_kill).count(), 1, "{entries:#?}");
        }
        assert_eq!(topics["/module"]["last"]["module"], "fcu");

        // The recorder's log says what there was.
        let recording = flown.folder().join(PORTS_FILE);
        let compared = assert_nothing_lost(&heard["topics"], &recording);
        assert!(compared > 2000, "{compared} messages were compared");
        let mut states = BTreeMap::new();
        bateleur_recording::for_each(recording, |entry| {
            if entry.topic == "/estimator/state" {
                states.insert(entry.time_ns, entry.layout.and_then(|layout| layout.json(entry.bytes)));
            }
        })
        .unwrap();
        let state = &topics["/estimator/state"];
        let written = states[&state["last_ns"].as_u64().unwrap()].as_ref().unwrap();
        for field in ["valid_ns", "position_ned_m", "quaternion", "status"] {
            assert!(is_same(&state["last"][field], &written[field]), "{field}: {state} and {written:?}");
        }
    }
}
