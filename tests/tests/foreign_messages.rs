//! Message types in a folder beside the schedule file, which `bateleur` was not built with.

use std::fs;
use std::path::Path;

use bateleur_recording::read;
use bateleur_tests::{Sketch, among_others, bateleur, channel_between, repository};
use serde_json::{Value, json};

const TRACK: &str = "messages/acme/Track.msg";

/// A schedule of a radar and of who sees its tracks, in `folder`, with the messages that both were built with beside it.
fn schedule(folder: &Path) -> String {
    for file in [TRACK, "messages/acme/Echo.msg"] {
        let to = folder.join(file);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(repository().join("tests").join(file), to).unwrap();
    }
    let keys = |port: &str| {
        format!("restart = {{ start = \"cold\", budget = 0, within = \"10s\", then = \"idle\" }}\n{port}")
    };
    let track = "[partition.radar.port]\ntrack = { direction = \"source\", kind = \"sampling\", message = \"acme/Track\" }";
    let seen = "[partition.screen.port]\nseen = { direction = \"destination\", kind = \"sampling\", message = \"acme/Track\", refresh = \"1s\" }";
    Sketch::new()
        .table(&channel_between("radar.track", "screen.seen"))
        .partition("radar", "radar", 1000, &keys(track))
        .partition("screen", "radar", 1000, &keys(seen))
        .write(folder)
}

/// Changes a file of the schedule's folder.
fn change(folder: &Path, file: &str, from: &str, to: &str) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} has no {from:?}");
    fs::write(path, text.replace(from, to)).unwrap();
}

#[test]
fn foreign_type_is_recorded_and_exported_by_the_names_of_its_fields() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let ended = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "1", "--record"]).end();
    let ended = ended.expect_code(0).expect_words(&["saw something at 2.5 m"]);
    let run = ended.folder();
    let log = read(run.join("ports.mcap"), |_| true).unwrap();
    let track = log.track("/radar/track", "acme/Track").expect("it is in the log");
    assert!(track.samples.len() >= 49, "{}", track.samples.len());
    let (tables, viewer) = (folder.path().join("tables"), folder.path().join("viewer.mcap"));
    let out = [run.to_str().unwrap(), tables.to_str().unwrap(), viewer.to_str().unwrap()];
    bateleur(&["export", out[0], "--csv", out[1], "--mcap", out[2], "--json"]).end().expect_code(0);
    let table =
        fs::read_dir(&tables).unwrap().map(|entry| fs::read_to_string(entry.unwrap().path()).unwrap());
    let table = table.into_iter().find(|table| table.contains("echoes[1].range")).expect("a table of tracks");
    let head = "time_ns,sequence,measured_ns,mode,sweeps,echoes[0].range,echoes[0].closing,echoes[0].strong";
    assert!(table.starts_with(head), "{table}");
    let third = table.lines().nth(3).unwrap();
    assert!(third.contains(",7,3,1.5,-40,false,0,2.5,-40,false,0"), "{third}");
    let viewed = String::from_utf8_lossy(&fs::read(viewer).unwrap()).into_owned();
    assert!(viewed.contains("acme/msg/Track") && viewed.contains(r#""closing":-40"#));
}

#[test]
fn foreign_type_is_echoed_by_the_names_of_its_fields_and_recorded_from_outside() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "60"]);
    module.await_words("2 partitions are ready");
    let pid = module.pid().to_string();
    let echo = ["ports", "echo", "screen.seen", "--count", "2", "--module", &pid];
    let said = bateleur(&echo).end().expect_code(0).stdout;
    for line in [
        "mode: 7 (SWEEP)\n",
        "echoes[0].range: 1.5 m\n",
        "echoes[1].closing: -40 cm/s\n",
        "echoes[1].strong: false\n",
    ] {
        assert!(said.contains(line), "{said}");
    }
    let said = bateleur(&[&echo[..], &["--format", "json"]].concat()).end().expect_code(0);
    let one: Value = serde_json::from_str(said.stdout.lines().next().unwrap()).unwrap();
    let echoed = json!({ "range": 2.5, "closing": -40, "strong": false, "reserved": 0 });
    assert_eq!(one["values"]["echoes"][1], echoed);
    let log = folder.path().join("outside.mcap");
    let record = ["record", "--for", "1", "--output", log.to_str().unwrap(), "--module", &pid];
    bateleur(&record).end().expect_code(0);
    let log = read(log, |_| false).unwrap();
    assert!(log.counts["/radar/track"] > 0, "{:?}", log.counts);
}

/// A table for the CAN bus in which the fields of a track lie in frames of classic length.
const TRACK_TABLE: &str = r#"
[port.track]
message = "acme/Track"
stamp = "measured_ns"

[port.track.fields]
mode = { constant = 7 }
sweeps = { frame = "201", start = 0, bits = 32 }
"echoes[0].range" = { frame = "201", start = 32, bits = 32, float = true }
"echoes[0].closing" = { frame = "202", start = 0, bits = 16, signed = true }
"echoes[1].range" = { frame = "202", start = 16, bits = 16, scale = 0.01 }
"echoes[1].closing" = { frame = "202", start = 32, bits = 16, signed = true }
"#;

/// A radar whose tracks go over CAN gateways to another partition's screen, by the table.
fn over_can(folder: &Path, table: &str) -> String {
    schedule(folder);
    fs::write(folder.join("track.toml"), table).unwrap();
    let sockets = [(); 2].map(|()| std::net::UdpSocket::bind("127.0.0.1:0").unwrap());
    let [first, second] = sockets.map(|socket| socket.local_addr().unwrap());
    let table = folder.join("track.toml");
    let keys = |listen, peer, direction: &str| {
        format!(
            "network = true\nrestart = {{ start = \"warm\", budget = 0, within = \"10s\", then = \"idle\" }}\nretained = \"16KiB\"\n\
             attributes = {{ table = \"{}\", listen = \"{listen}\", peers = [\"{peer}\"] }}\nport.track = {{ {direction}, kind = \"sampling\", message = \"acme/Track\" }}\n\
             port.rate = {{ direction = \"destination\", kind = \"sampling\", message = \"Rate\", refresh = \"40ms\" }}\n\
             port.status = {{ direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }}\n\
             port.ground = {{ direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 8 }}\n\
             port.telemetry = {{ direction = \"source\", kind = \"queuing\", message = \"TelemetryMessage\" }}",
            table.display()
        )
    };
    let track = "[partition.radar.port]\ntrack = { direction = \"source\", kind = \"sampling\", message = \"acme/Track\" }";
    let seen = "[partition.screen.port]\nseen = { direction = \"destination\", kind = \"sampling\", message = \"acme/Track\", refresh = \"1s\" }";
    let channels =
        channel_between("radar.track", "sends.track") + &channel_between("hears.track", "screen.seen");
    Sketch::new()
        .table(&channels)
        .partition("radar", "radar", 1000, track)
        .partition(
            "sends",
            "can_interface",
            3000,
            &keys(first, second, "direction = \"destination\", refresh = \"1s\""),
        )
        .partition("hears", "can_interface", 3000, &keys(second, first, "direction = \"source\""))
        .partition("screen", "radar", 1000, seen)
        .write(folder)
}

#[test]
fn foreign_type_crosses_a_can_bus_by_the_names_of_its_fields() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = over_can(folder.path(), TRACK_TABLE);
    let ended = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "4", "--record"]).end();
    let ended = ended.expect_code(0).expect_words(&["screen: saw something at 2.5 m"]);
    let log = read(ended.folder().join("ports.mcap"), |_| true).unwrap();
    let track = log.track("/hears/track", "acme/Track").expect("it is in the log");
    assert!(track.samples.len() > 50, "{}", track.samples.len());
}

#[test]
fn table_and_plan_that_say_different_things_of_a_foreign_port_are_refused_with_the_mend() {
    for (from, to, words) in [
        (
            "[port.track",
            "[port.tracks",
            "there is no port \"tracks\": give the partition a sampling port of that name",
        ),
        ("acme/Track", "Custom", "Custom has no field echoes"),
        ("acme/Track", "acme/Trick", "there is no message acme/Trick; did you mean acme/Track?"),
        ("sweeps = ", "sweps = ", "did you mean sweeps?"),
    ] {
        let _turn = among_others();
        let folder = tempfile::tempdir().unwrap();
        let schedule = over_can(folder.path(), &TRACK_TABLE.replace(from, to));
        let ended = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "1"]).end();
        assert!(ended.stderr.contains(words), "{to}: {}", ended.stderr);
    }
}

#[test]
fn partition_that_was_built_with_other_fields_is_refused_with_both_layouts() {
    for (from, to, difference) in [
        ("uint32 sweeps ", "uint32 turns ", "the plan has `12 uint32 turns` where it has `12 uint32 sweeps`"),
        (
            "[ns] Module",
            "[us] Module",
            "the plan has `0 uint64 measured_ns [us]` where it has `0 uint64 measured_ns [ns]`",
        ),
        (
            "Echo[2] echoes",
            "Echo[3] echoes",
            "the plan has `32 float32 echoes[2].range [m]` where it has nothing more",
        ),
    ] {
        let _turn = among_others();
        let folder = tempfile::tempdir().unwrap();
        let schedule = schedule(folder.path());
        change(folder.path(), TRACK, from, to);
        let ended = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "1"]).end();
        assert!(ended.stderr.contains(difference), "{}", ended.stderr);
        let log = fs::read_to_string(ended.folder().join("partitions/radar.log")).unwrap();
        for table in
            ["acme/Track in the plan", "acme/Track in this program", "     16  float32 echoes[0].range [m]"]
        {
            assert!(log.contains(table), "{log}");
        }
    }
}

#[test]
fn type_that_can_not_be_read_is_refused_by_its_line_before_anything_starts() {
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    change(folder.path(), TRACK, "uint32 sweeps ", "string sweeps ");
    let check = || bateleur(&["check", &schedule]).end().expect_code(2).stdout;
    let said = check();
    assert!(said.contains("N09-messages-unusable"), "{said}");
    assert!(said.contains("Track.msg:7:1: `string` has no fixed length"), "{said}");
    assert!(!said.contains("there is no message type"), "one fault is told once: {said}");
    let run = ["run", "--fast", "--schedule", &schedule, "--until", "1"];
    bateleur(&run).end().expect_code(2).expect_words(&["Track.msg:7:1"]);
    // A type that nobody describes.
    fs::remove_file(folder.path().join(TRACK)).unwrap();
    let said = check();
    assert!(said.contains("there is no message type `acme/Track`"), "{said}");
}

#[test]
fn messages_of_a_foreign_type_are_dropped_and_damaged_by_order() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let samples = |inject: &[&str]| {
        let run = ["run", "--fast", "--schedule", &schedule, "--until", "1", "--record"];
        let ended = bateleur(&[&run[..], inject].concat()).end().expect_code(0);
        let log = read(ended.folder().join("ports.mcap"), |_| true).unwrap();
        log.track("/radar/track", "acme/Track").unwrap().samples.clone()
    };
    let whole = samples(&[]);
    let dropped = samples(&["--inject", "radar.track:drop=2@0.5"]);
    assert_eq!(dropped.len(), whole.len() - 2);
    let damaged = samples(&["--inject", "radar.track:corrupt=3@0.5"]);
    assert_eq!(damaged.iter().zip(&whole).filter(|(one, other)| one != other).count(), 3);
}
