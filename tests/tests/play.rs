//! A recording drives the inputs of a module, and what comes out is compared with what is in it.

use std::fs;
use std::path::{Path, PathBuf};

use bateleur_recording::{LogReader, read};
use bateleur_tests::{
    Ended, Sketch, alone, among_others, bateleur, channel_between, flight_schedule, program, repository,
};
use rustix::process::Signal;
use serde_json::Value;

const SOURCE: &str =
    "count = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }\n";
const HEARD: &str = "heard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"15ms\" }\n";

/// Three that count: each says how often what it heard of the one before was too old. A queue leads back to the first.
fn row(folder: &Path, refresh: &str, isolation: &str) -> String {
    let channel = |source: &str, destination: &str| channel_between(source, destination) + isolation;
    let ports =
        |name: &str, ports: &str| format!("[partition.{name}.port]\n{ports}").replace("15ms", refresh);
    let queue = "{ direction = \"source\", kind = \"queuing\", message = \"GroundMessage\" }";
    let hears = "{ direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 2 }";
    Sketch::new()
        .table(&channel("first.count", "second.heard"))
        .table(&channel("second.count", "third.heard"))
        .table(&channel("sender.out", "taker.in"))
        .partition("third", "counter", 1000, &ports("third", &format!("{HEARD}{SOURCE}")))
        .partition("taker", "queuer", 1000, &ports("taker", &format!("in = {hears}\n")))
        .partition("first", "counter", 1000, &ports("first", SOURCE))
        .partition("sender", "queuer", 1000, &ports("sender", &format!("out = {queue}\n")))
        .partition("second", "counter", 1000, &ports("second", &format!("{HEARD}{SOURCE}")))
        .write(folder)
}

fn record(schedule: &str, options: &[&str]) -> Ended {
    bateleur(&[&["run", "--fast", "--record", "--until", "3", "--schedule", schedule], options].concat())
        .end()
        .expect_code(0)
}

fn play(recording: &Path, schedule: &str, options: &[&str], code: i32) -> Ended {
    let recording = recording.to_str().unwrap();
    let play = ["play", recording, "--schedule", schedule, "--format", "json"];
    bateleur(&[&play[..], options].concat()).end().expect_code(code)
}

fn port<'a>(result: &'a Value, name: &str) -> &'a Value {
    let ports = result["ports"].as_array().unwrap();
    ports
        .iter()
        .find(|port| port["port"] == name)
        .unwrap_or_else(|| panic!("{name} was not compared: {result}"))
}

/// Numbers that look drawn, the same in every run.
fn drawn(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut state = seed;
    move |below| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    }
}

#[test]
fn module_on_the_inputs_of_its_own_recording_gives_the_same_whoever_is_replaced() {
    let _turn = among_others();
    for (seed, isolation) in [(1, ""), (2, "isolation = \"sealed\"\n"), (3, "isolation = \"checked\"\n")] {
        let (folder, mut draw) = (tempfile::tempdir().unwrap(), drawn(seed));
        let schedule = row(folder.path(), "15ms", isolation);
        // What is missing of the first for a while is heard by the others.
        let kill = format!("first@{}.{:02}", 1 + draw(2), 2 * draw(50));
        let recorded = record(&schedule, &["--kill", &kill]);
        for replaced in [&["first", "sender"][..], &["second", "first"], &["sender", "first", "third"]] {
            let mut options = Vec::new();
            for name in replaced {
                options.extend(["--in-place-of", name]);
            }
            let played = play(&recorded.folder(), &schedule, &options, 0);
            let ready = format!("{} partitions are ready", 5 - replaced.len());
            assert!(played.stderr.contains(&ready), "{replaced:?}: {}", played.stderr);
            let result = played.summary();
            assert_eq!(result["equal"], true, "{seed} {kill} {replaced:?}: {}", result["first"]);
            for (name, least) in [("second.count", 140), ("first.count", 100), ("sender.out", 100)] {
                let compared = port(&result, name)["compared"].as_u64().unwrap();
                assert!(compared >= least, "{seed} {kill} {replaced:?}: {compared} messages of {name}");
            }
        }
    }
}

#[test]
fn change_of_the_module_is_found_with_port_and_field() {
    let _turn = among_others();
    let (folder, changed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let schedule = row(folder.path(), "15ms", "");
    let recorded = record(&schedule, &["--kill", "first@1"]);
    // One that takes older values: it refuses fewer of them.
    let changed = row(changed.path(), "10s", "");
    let options = ["--in-place-of", "first", "--in-place-of", "sender"];
    let result = play(&recorded.folder(), &changed, &options, 1).summary();
    let first = &result["first"];
    assert_eq!(first["port"], "second.count", "{first}");
    assert_eq!(first["fields"][0]["field"], "refused", "{first}");
    assert_eq!(port(&result, "first.count")["different"], 0, "the input itself is as it was");
    // As far as that it is the same; and with a tolerance that allows it.
    play(&recorded.folder(), &changed, &[&options[..], &["--until", "0.9"]].concat(), 0);
    let tolerance = ["--tolerance", "second.count.refused=1000"];
    play(&recorded.folder(), &changed, &[&options[..], &tolerance].concat(), 0);
}

/// The first and the third of a row on one host, the second on another one.
fn two_hosts(folder: &Path) -> String {
    let counter = program("counter").display().to_string();
    let partition = |name: &str, module: &str, ports: &str| {
        format!(
            "[partition.{name}]\nprogram = \"{counter}\"\nmodule = \"{module}\"\nmemory = \"96MiB\"\n\n\
             [partition.{name}.port]\n{ports}\n"
        )
    };
    let window = |name: &str, offset_us: u32| {
        format!("    {{ partition = \"{name}\", offset = \"{offset_us}us\", duration = \"1ms\" }},\n")
    };
    let windows: String =
        [("first", 200), ("relay_one", 2000), ("relay_two", 6000), ("second", 8000), ("third", 10000)]
            .map(|(name, offset_us)| window(name, offset_us))
            .concat();
    let text = [
        "[network.a]\nrate = \"100Mbit/s\"\n\n",
        "[module.one]\ncores = [1]\naddresses = { a = \"10.99.0.1:15300\" }\n\n",
        "[module.two]\ncores = [1]\naddresses = { a = \"10.99.0.2:15300\" }\nfollows = \"one\"\n\n",
        "[link.tracks]\nmodules = [\"one\", \"two\"]\nkey = \"tracks.key\"\ngap = \"2ms\"\n\n",
        "[schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\nwindow = [\n",
        &windows,
        "]\n\n",
        &partition("first", "one", SOURCE),
        &partition("second", "two", &format!("{HEARD}{SOURCE}")),
        &partition("third", "two", HEARD),
        &channel_between("first.count", "second.heard"),
        &channel_between("second.count", "third.heard"),
    ];
    let path = folder.join("two.toml");
    fs::write(&path, text.concat()).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn module_of_several_is_driven_in_place_of_its_relay_without_keys() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = two_hosts(folder.path());
    let run = ["run", "--hosts", "--fast", "--record", "--until", "3", "--schedule", &schedule];
    let recorded = bateleur(&[&run[..], &["--kill", "first@1.5"]].concat()).end().expect_code(0);
    assert!(!folder.path().join("tracks.key").exists());
    let two = recorded.folder().join("hosts/two");
    let result = play(&two, &schedule, &["--module", "two"], 0).summary();
    assert_eq!(result["equal"], true, "{}", result["first"]);
    assert!(port(&result, "second.count")["compared"].as_u64().unwrap() > 140);
    assert!(port(&result, "relay_two.first.count")["compared"].as_u64().unwrap() > 100);
    play(&two, &schedule, &[], 2).expect_words(&["several modules", "one, two"]);
}

fn by_hand(folder: &Path) -> String {
    let operators = SOURCE.replace(" }", ", operator = true }");
    Sketch::new()
        .table(&channel_between("hand.count", "second.heard"))
        .table(&channel_between("second.count", "third.heard"))
        .partition("hand", "counter", 1000, &format!("[partition.hand.port]\n{operators}"))
        .partition(
            "second",
            "counter",
            1000,
            &format!("[partition.second.port]\n{}{SOURCE}", HEARD.replace("15ms", "100ms")),
        )
        .partition("third", "counter", 1000, &format!("[partition.third.port]\n{HEARD}"))
        .write(folder)
}

#[test]
fn what_can_not_be_played_is_refused_before_it_begins() {
    let _turn = among_others();
    let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let schedule = row(folder.path(), "15ms", "");
    let kept = record(&schedule, &[]);
    let recorded = kept.folder();
    let refused = |recording: &Path, schedule: &str, options: &[&str], words: &[&str]| {
        let ended = play(recording, schedule, options, 2).expect_words(words);
        assert!(!ended.stderr.contains("are ready"), "it began: {}", ended.stderr);
    };
    refused(&recorded, &schedule, &[], &["nothing comes into module test from outside", "--in-place-of"]);
    let misspelt = ["--in-place-of", "fisrt"];
    refused(&recorded, &schedule, &misspelt, &["no partition \"fisrt\"", "did you mean `first`?"]);
    let all = ["first", "second", "third", "sender"].map(|name| ["--in-place-of", name]).concat();
    refused(&recorded, &schedule, &all, &["there is nothing to compare"]);
    refused(&recorded, &by_hand(other.path()), &[], &["nothing of hand.count"]);
    // A type of this name with other fields.
    let text = fs::read_to_string(&schedule).unwrap();
    let text = text.replace("\"FunctionStatus\"", "\"Rate\"");
    let changed = folder.path().join("changed.toml");
    fs::write(&changed, text).unwrap();
    let first = ["--in-place-of", "first"];
    let words = ["first.count is Rate in the plan and FunctionStatus"];
    refused(&recorded, changed.to_str().unwrap(), &first, &words);
    let no_log: PathBuf = repository().join("README.md");
    refused(&no_log, &schedule, &first, &["README.md"]);
    let used = recorded.to_str().unwrap();
    refused(&recorded, &schedule, &[&first[..], &["--output", used]].concat(), &["holds a run already"]);
    // A recording that was cut off is played as far as it goes, which is said.
    let bytes = fs::read(recorded.join("ports.mcap")).unwrap();
    let cut = folder.path().join("cut.mcap");
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    assert!(LogReader::open(&cut).is_ok());
    let played = ["play", cut.to_str().unwrap(), "--schedule", &schedule];
    let ended =
        bateleur(&[&played[..], &["--in-place-of", "first", "--in-place-of", "sender"]].concat()).end();
    // Its last frame may be there in part, which is a difference.
    assert!(ended.code != Some(2) && ended.stderr.contains("was cut short"), "{}", ended.stderr);
}

#[test]
fn flight_is_played_without_its_lines_bit_for_bit() {
    let _turn = among_others();
    let schedule = flight_schedule();
    let schedule = schedule.to_str().unwrap();
    let weather = ["--seed", "11", "--wind", "5", "--turbulence", "moderate"];
    let fly = ["fly", "--fast", "--format", "json", "--schedule", schedule];
    let flown = bateleur(&[&fly[..], &weather].concat()).end().expect_code(0);
    let folder = flown.folder();
    // The two that have a line to the outside; telemetry goes to one of them, and nobody takes it.
    let mut arguments = vec!["play", folder.to_str().unwrap(), "--format", "json"];
    arguments.extend(["--in-place-of", "hil_interface", "--in-place-of", "command"]);
    let ignored = ["imu", "estimator", "controller", "onboard_computer", "servo", "gps"];
    let ignored = ignored.map(|name| format!("{name}.telemetry"));
    for port in &ignored {
        arguments.extend(["--ignore", port]);
    }
    let played = bateleur(&arguments).end().expect_code(0);
    assert!(played.stderr.contains("7 partitions are ready"), "{}", played.stderr);
    let result = played.summary();
    assert_eq!(result["equal"], true, "{}", result["first"]);
    assert!(port(&result, "servo.timers")["compared"].as_u64().unwrap() > 5_000);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn what_an_operator_wrote_on_the_wall_clock_is_played_on_the_virtual_one() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = by_hand(folder.path());
        let mut module = bateleur(&["run", "--schedule", &schedule, "--record"]);
        module.await_words("3 partitions are ready");
        let pid = module.pid().to_string();
        let publish =
            ["ports", "pub", "--module", &pid, "hand.count", "accepted=9", "--rate", "50", "--count", "40"];
        bateleur(&publish).end().expect_code(0);
        module.signal(Signal::INT);
        let recorded = module.end().expect_code(0);
        let log = read(recorded.folder().join("ports.mcap"), |_| true).unwrap();
        let sent = &log.track("/hand/count", "FunctionStatus").unwrap().samples;
        assert_eq!(sent.len(), 40);
        let output = folder.path().join("played");
        let keep = ["--output", output.to_str().unwrap(), "--time-tolerance", "0.02"];
        let recording = recorded.folder();
        let arguments = ["play", recording.to_str().unwrap(), "--schedule", &schedule, "--format", "json"];
        let ended = bateleur(&[&arguments[..], &keep].concat()).end();
        // How many windows a busy machine lost is not the matter here.
        assert!(ended.code != Some(2), "{}", ended.stderr);
        let again = read(output.join("ports.mcap"), |_| true).unwrap();
        let played = &again.track("/hand/count", "FunctionStatus").unwrap().samples;
        assert!(played == sent, "each with its time: {} messages", played.len());
        // It was heard: while messages came, none was too old.
        let between = |log: &bateleur_recording::Recording| -> Vec<u64> {
            let (from_ns, to_ns) = (sent[1].0, sent[38].0);
            let status = &log.track("/second/count", "FunctionStatus").unwrap().samples;
            let during = status.iter().filter(|(time_ns, _)| (from_ns..to_ns).contains(time_ns));
            during.map(|(_, bytes)| u64::from_le_bytes(bytes[16..24].try_into().unwrap())).collect()
        };
        let refused = between(&again);
        assert!(refused.len() > 20 && refused.last().unwrap() - refused[0] <= 3, "{refused:?}");
    }
}
