//! Exports of a small run are what other people's tools expect, also where the run was cut off.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod by_hand;
mod trace_check;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use bateleur_messages::{ActuatorCommand, State, find};
use bateleur_recording::{Ending, PortLog, for_each, topic};
use bateleur_report::export::{self, Encoding, ExportError};
use bateleur_report::windows;
use by_hand::{channel, message, message_behind, record, schema};
use serde_json::{Value, json};
use trace_check::assert_trace;
use zerocopy::IntoBytes;

/// Two minor frames of an Estimator and a Controller, a fault, a change of schedule, three messages.
fn run() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let lines = [
        &format!("{},slack_ns,schedule", windows::HEADER),
        "0,0,1,estimator,1000000,3000000,1000000,1002000,2000000,,1000000,flight",
        "0,0,1,controller,3000000,4000000,3250000,3260000,,LO,,flight",
        "1,0,1,estimator,21000000,23000000,,,,S,,landing",
        "",
    ];
    fs::write(folder.path().join("windows.csv"), lines.join("\n")).unwrap();
    let fault = r#"{"time_ns":4000000,"partition":"controller","generation":1,"error":"killed","action":"warm_restart","detail":"ended by SIGKILL","recovered_ns":23000000}"#;
    fs::write(folder.path().join("health.jsonl"), format!("{fault}\n")).unwrap();
    let mut log = PortLog::create(folder.path().join("ports.mcap")).unwrap();
    let states = log.add_channel(&topic("estimator", "state"), find("State").unwrap()).unwrap();
    let commands =
        log.add_channel(&topic("controller", "command"), find("ActuatorCommand").unwrap()).unwrap();
    let state = State { valid_ns: 7, status: 3, position_ned_m: [1.5, -2.0, -160.25], ..State::default() };
    log.write(states, 1, 1_500_000, state.as_bytes()).unwrap();
    log.write(commands, 1, 3_500_000, ActuatorCommand { throttle: 0.5, ..Default::default() }.as_bytes())
        .unwrap();
    log.write(states, 2, 21_500_000, state.as_bytes()).unwrap();
    log.finish().unwrap();
    folder
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap()
}

#[test]
fn trace_shows_cores_partitions_faults_messages_and_the_change_of_schedule() {
    let run = run();
    let path = run.path().join("trace.json");
    let exported = export::chrome(run.path(), &path).unwrap();
    assert_eq!((exported.records, exported.notes.len()), (7, 0), "{exported:?}");
    let pinned = r#"{"displayTimeUnit":"ns","traceEvents":[
{"name":"process_name","ph":"M","pid":1,"tid":0,"args":{"name":"cores"}},
{"name":"process_name","ph":"M","pid":2,"tid":0,"args":{"name":"partitions"}},
{"name":"schedule flight","ph":"i","pid":2,"tid":0,"ts":1000.0,"s":"g"},
{"name":"thread_name","ph":"M","pid":1,"tid":1,"args":{"name":"core 1"}},
{"name":"thread_name","ph":"M","pid":2,"tid":1,"args":{"name":"estimator"}},
{"name":"estimator","ph":"X","pid":1,"tid":1,"ts":1000.0,"dur":2000.0,"args":{"flags":"","frame":0,"minor":0}},
{"name":"use","ph":"X","pid":2,"tid":1,"ts":1002.0,"dur":998.0,"args":{"flags":"","frame":0,"minor":0}},
{"name":"slack","ph":"X","pid":2,"tid":1,"ts":2000.0,"dur":1000.0,"args":{}},
{"name":"thread_name","ph":"M","pid":2,"tid":2,"args":{"name":"controller"}},
{"name":"controller","ph":"X","pid":1,"tid":1,"ts":3250.0,"dur":750.0,"args":{"flags":"LO","frame":0,"minor":0}},
{"name":"overrun","ph":"X","pid":2,"tid":2,"ts":3260.0,"dur":740.0,"args":{"flags":"LO","frame":0,"minor":0}},
{"name":"schedule landing","ph":"i","pid":2,"tid":0,"ts":21000.0,"s":"g"},
{"name":"estimator (not granted)","ph":"X","pid":1,"tid":1,"ts":21000.0,"dur":2000.0,"args":{"flags":"S","frame":1,"minor":0}},
{"name":"killed → warm_restart","ph":"i","pid":2,"tid":2,"ts":4000.0,"s":"t","args":{"action":"warm_restart","detail":"ended by SIGKILL","generation":1}},
{"name":"back","ph":"i","pid":2,"tid":2,"ts":23000.0,"s":"t"},
{"name":"state","ph":"i","pid":2,"tid":1,"ts":1500.0,"s":"t","args":{"message":"State","sequence":1}},
{"name":"command","ph":"i","pid":2,"tid":2,"ts":3500.0,"s":"t","args":{"message":"ActuatorCommand","sequence":1}},
{"name":"state","ph":"i","pid":2,"tid":1,"ts":21500.0,"s":"t","args":{"message":"State","sequence":2}}
]}
"#;
    assert_eq!(read(&path), pinned);
    let parsed: Value = serde_json::from_str(&read(&path)).unwrap();
    assert_eq!(parsed["traceEvents"].as_array().unwrap().len(), 18);
}

#[test]
fn trace_is_one_of_the_trace_event_format() {
    let run = run();
    let path = run.path().join("trace.json");
    export::chrome(run.path(), &path).unwrap();
    let phases = assert_trace(&read(&path));
    assert_eq!(phases, BTreeMap::from([("M".into(), 5), ("X".into(), 6), ("i".into(), 7)]));
}

#[test]
fn table_of_each_port_has_a_column_for_each_value() {
    let run = run();
    let into = run.path().join("tables");
    let exported = export::tables(run.path(), &into).unwrap();
    assert_eq!((exported.records, exported.notes.len()), (3, 0), "{exported:?}");
    let state = read(&into.join("estimator.state.csv"));
    let rows: Vec<Vec<&str>> = state.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!((rows.len(), rows[0][0], rows[0][1]), (3, "time_ns", "sequence"));
    assert!(rows.iter().all(|row| row.len() == rows[0].len()));
    let value = |row: usize, name: &str| {
        let column = rows[0].iter().position(|column| *column == name).unwrap();
        rows[row][column]
    };
    assert_eq!((value(1, "time_ns"), value(2, "sequence"), value(1, "valid_ns")), ("1500000", "2", "7"));
    assert_eq!((value(1, "position_ned_m[1]"), value(1, "position_ned_m[2]")), ("-2", "-160.25"));
    assert!(into.join("controller.command.csv").is_file());
}

/// Every message of an MCAP file as a generic reader sees it: topic, encoding, schema's encoding, time, payload.
fn generic(path: &Path) -> Vec<(String, String, String, u64, Vec<u8>)> {
    let bytes = fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    assert!(!summary.chunk_indexes.is_empty());
    let of = |message: mcap::Message<'_>| {
        let schema = message.channel.schema.as_ref().expect("a schema");
        let (topic, kind) = (message.channel.topic.clone(), message.channel.message_encoding.clone());
        (topic, kind, schema.encoding.clone(), message.log_time, message.data.to_vec())
    };
    mcap::MessageStream::new(&bytes).unwrap().map(|message| of(message.unwrap())).collect()
}

#[test]
fn indexed_log_holds_all_ports_and_the_faults() {
    let run = run();
    let path = run.path().join("viewer.mcap");
    assert_eq!(export::mcap(run.path(), &path, Encoding::Cdr).unwrap().records, 4);
    let read = generic(&path);
    let of = |topic: &str| read.iter().filter(|message| message.0 == topic).collect::<Vec<_>>();
    assert_eq!(
        (of("/estimator/state").len(), of("/controller/command").len(), of("/health").len()),
        (2, 1, 1)
    );
    assert_eq!(
        (of("/estimator/state")[0].1.as_str(), of("/estimator/state")[0].2.as_str()),
        ("cdr", "ros2msg")
    );
    let fault: Value = serde_json::from_slice(&of("/health")[0].4).unwrap();
    assert_eq!((fault["partition"].as_str(), of("/health")[0].3), (Some("controller"), 4_000_000));
    // It is a run's log again.
    let counted = bateleur_recording::read(&path, |_| true).unwrap();
    assert_eq!(counted.tracks["/estimator/state"].typed::<State>()[1].0, 21_500_000);
}

#[test]
fn log_in_json_names_every_value_and_its_schema() {
    let run = run();
    let path = run.path().join("viewer.mcap");
    export::mcap(run.path(), &path, Encoding::Json).unwrap();
    let read = generic(&path);
    let (_, kind, schema, time_ns, payload) =
        read.iter().find(|message| message.0 == "/estimator/state").unwrap();
    assert_eq!((kind.as_str(), schema.as_str(), *time_ns), ("json", "jsonschema", 1_500_000));
    let state: Value = serde_json::from_slice(payload).unwrap();
    assert_eq!(state["position_ned_m"], json!([1.5, -2.0, -160.25]));
    let bytes = fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let schema = summary.schemas.values().find(|schema| schema.name.ends_with("State")).unwrap();
    let schema: Value = serde_json::from_slice(&schema.data).unwrap();
    assert_eq!(schema["properties"]["position_ned_m"]["maxItems"], 3);
}

#[test]
fn damaged_and_cut_off_inputs_give_what_they_hold_and_say_what_was_lost() {
    let run = run();
    let (windows, ports) = (run.path().join("windows.csv"), run.path().join("ports.mcap"));
    fs::write(&windows, read(&windows) + "2,0,1,estim").unwrap();
    let bytes = fs::read(&ports).unwrap();
    fs::write(&ports, &bytes[..bytes.len() - 60]).unwrap();
    fs::remove_file(run.path().join("health.jsonl")).unwrap();
    let trace = run.path().join("trace.json");
    let exported = export::chrome(run.path(), &trace).unwrap();
    assert_eq!(exported.notes.len(), 3, "{exported:?}");
    for word in ["windows.csv: 1 lines are damaged", "health.jsonl", "ports.mcap: was cut short"] {
        assert!(exported.notes.iter().any(|note| note.contains(word)), "{word}: {exported:?}");
    }
    assert_trace(&read(&trace)); // it is whole all the same
    assert!(exported.records >= 3, "{exported:?}");
}

#[test]
fn bytes_that_were_changed_in_a_log_are_noticed_by_their_checksum_and_the_rest_is_exported() {
    let run = run();
    let ports = run.path().join("ports.mcap");
    let whole = export::tables(run.path(), &run.path().join("whole")).unwrap();
    let mut bytes = fs::read(&ports).unwrap();
    // The last byte of a message's value, in front of the next record.
    let header = bytes.windows(4).position(|window| window == [0, 1, 0, 0]).unwrap();
    bytes[header + 8..header + 11].fill(0xff);
    fs::write(&ports, bytes).unwrap();
    let exported = export::tables(run.path(), &run.path().join("changed")).unwrap();
    let [note] = &exported.notes[..] else { panic!("{exported:?}") };
    assert!(note.contains("ports.mcap: is damaged (the checksum of 1 of its pieces"), "{note}");
    assert_eq!(exported.records, whole.records);
}

#[test]
fn folder_without_a_run_and_an_output_that_is_the_input_are_refused() {
    let run = run();
    let empty = tempfile::tempdir().unwrap();
    let out = empty.path().join("trace.json");
    assert!(
        matches!(export::chrome(empty.path(), &out), Err(ExportError::Nothing(notes)) if notes.len() == 3)
    );
    assert!(matches!(export::tables(Path::new("/nowhere"), &out), Err(ExportError::NoFolder(_))));
    let input = run.path().join("ports.mcap");
    let before = fs::read(&input).unwrap();
    let refused = export::mcap(run.path(), &run.path().join(".").join("ports.mcap"), Encoding::Json);
    assert!(matches!(refused, Err(ExportError::OwnInput(_))));
    assert_eq!(fs::read(&input).unwrap(), before);
    let unwritable = export::chrome(run.path(), Path::new("/nowhere/trace.json"));
    assert!(matches!(unwritable, Err(ExportError::Write { .. })));
}

/// The sequences that are read of a log, and how it ends.
fn sequences(log: &Path) -> (Vec<u32>, Ending) {
    let mut all = Vec::new();
    let ending = for_each(log, |entry| all.push(entry.sequence)).unwrap();
    (all, ending)
}

#[test]
fn record_that_can_not_be_read_is_left_out_and_counted_and_the_log_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ports.mcap");
    // An index whose length is wrong, half a schema, a chunk whose opcode has become one that is not in use.
    let index = record(7, &[1, 0, 0, 0, 0, 0x40]);
    let chunk = record(0x46, &[0; 40]);
    for (broken, count) in [(vec![index.clone()], 1), (vec![index, record(3, &[1]), chunk], 3)] {
        let usual = [schema("uint8 x\n"), channel(1, "/a/b"), message(1, 1, 5, &[1])];
        let records: Vec<_> = usual.into_iter().chain(broken).chain([message(1, 2, 6, &[2])]).collect();
        by_hand::write(&path, &records);
        let (all, ending) = sequences(&path);
        assert_eq!(all, [1, 2]);
        let words = format!("{count} of its records can not be read and are left out");
        assert_eq!(ending, Ending::Damaged(words));
    }
    // An attachment that is too short for its own end.
    by_hand::write(
        &path,
        &[schema("uint8 x\n"), record(9, &[0; 32]), channel(1, "/a/b"), message(1, 1, 5, &[1])],
    );
    assert_eq!(sequences(&path).0, [1]);
}

#[test]
fn messages_of_no_port_and_of_another_encoding_are_left_out_with_their_number() {
    let folder = tempfile::tempdir().unwrap();
    let records = [
        schema("uint8 x\n"),
        channel(1, "/a/b"),
        message(1, 1, 5, &[1]),
        message_behind(&[0; 4], 1, 2, 6, &[2]),
        message(9, 3, 7, &[3]),
        message(9, 4, 8, &[3]),
    ];
    by_hand::write(&folder.path().join("ports.mcap"), &records);
    let exported = export::tables(folder.path(), &folder.path().join("tables")).unwrap();
    let [note] = &exported.notes[..] else { panic!("{exported:?}") };
    assert!(note.contains("2 of its messages are of no port that it names"), "{note}");
    assert!(note.contains("1 of its messages are not encoded as it says"), "{note}");
    assert_eq!(exported.records, 1);
}

#[test]
fn ports_that_would_share_a_table_get_one_each() {
    let folder = tempfile::tempdir().unwrap();
    let records = [
        schema("uint8 x\n"),
        channel(1, "/a/b.c"),
        channel(2, "/a/b_c"),
        message(1, 1, 5, &[1]),
        message(2, 2, 6, &[2]),
        message(1, 3, 7, &[3]),
    ];
    by_hand::write(&folder.path().join("ports.mcap"), &records);
    let into = folder.path().join("tables");
    assert_eq!(export::tables(folder.path(), &into).unwrap().notes, Vec::<String>::new());
    assert_eq!(read(&into.join("a.b_c.csv")), "time_ns,sequence,x\n5,1,1\n7,3,3\n");
    assert_eq!(read(&into.join("a.b_c.2.csv")), "time_ns,sequence,x\n6,2,2\n");
}
