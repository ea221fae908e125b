//! A satellite receiver as pyubx2 encodes it, on a serial line and behind a TCP port, instead of the simulator's.

use bateleur_messages::{GpsPosition, GpsVelocity, Message, RawGps};
use bateleur_recording as log;
use bateleur_tests::{Ended, Peer, Started, among_others, bateleur, edited};
use rustix::process::Signal;
use serde_json::json;

/// The flight's schedule with the driver in the place of the simulator's receiver; `keys` are the driver's own.
/// What a receiver behind a converter may use.
const TCP: &str = "network = true\nsystem_calls = [\"tcp\"]";

fn run(keys: &str, attributes: &str) -> Started {
    let window = "{ partition = \"gps\",              offset = \"3.2ms\", duration = \"500us\" },";
    let driver = format!(
        "[partition.receiver]\nprogram = \"receiver\"\nmodule = \"fcu\"\nmemory = \"32MiB\"\n{keys}\n\
         restart = {{ start = \"cold\", budget = 5, within = \"10s\", then = \"idle\" }}\nattributes = {{ {attributes} }}\n\n\
         [partition.receiver.port]\nraw = {{ direction = \"source\", kind = \"sampling\", message = \"RawGps\" }}\n\n\
         # Turns what the receiver says"
    );
    let text = edited(&[
        (
            window,
            &format!(
                "{window}\n    {{ partition = \"receiver\", offset = \"15.2ms\", duration = \"500us\" }},"
            ),
        ),
        ("# Turns what the receiver says", &driver),
        ("source       = \"hil_interface.raw_gps\"", "source       = \"receiver.raw\""),
    ]);
    let folder = tempfile::tempdir().unwrap().keep();
    let schedule = folder.join("schedule.toml");
    std::fs::write(&schedule, text).unwrap();
    bateleur(&["run", "--schedule", schedule.to_str().unwrap(), "--record", "--until", "100"])
}

/// Ends it as a terminal's Ctrl-C does.
fn ended(module: Started) -> Ended {
    module.signal(Signal::INT);
    module.end()
}

fn messages<T: Message>(ended: &Ended, topic: &str) -> Vec<T> {
    let recording = log::read(ended.folder().join("ports.mcap"), |_| true).unwrap();
    let track =
        recording.track(topic, T::NAME).unwrap_or_else(|| panic!("nothing of {topic}:\n{}", ended.stderr));
    track.typed().into_iter().map(|(_, message)| message).collect()
}

/// What the peer says where it is.
#[track_caller]
fn assert_is_the_place(position: &GpsPosition) {
    assert!((position.latitude_rad.to_degrees() + 34.046605).abs() < 1e-9, "{position:?}");
    assert!((position.longitude_rad.to_degrees() - 18.7402978).abs() < 1e-9, "{position:?}");
    assert!((position.altitude_m - 160.25).abs() < 1e-9, "{position:?}");
    assert!((position.horizontal_accuracy_m - 1.5).abs() < 1e-9, "{position:?}");
}

#[test]
fn receiver_on_a_serial_line_is_set_up_heard_and_its_silence_noticed() {
    let Some(mut peer) = Peer::start("receiver.py", &["serial"]) else { return };
    let _turn = among_others();
    let device = peer.address().to_owned();
    let mut module =
        run(&format!("devices = [\"{device}\"]"), &format!("device = \"{device}\", period = \"100ms\""));
    module.await_words("partitions are ready");
    peer.say(&json!({ "noise": true }));
    std::thread::sleep(std::time::Duration::from_secs(4));
    peer.say(&json!({ "silent": true }));
    module.await_words("says no solution");
    peer.say(&json!({ "silent": false, "fix": 0 }));
    std::thread::sleep(std::time::Duration::from_secs(2));
    let ended = ended(module);
    let told = peer.finish();
    assert_eq!((&told["asked"], &told["period"]), (&json!(["CFG-MSG", "CFG-RATE"]), &json!(0.1)), "{told}");

    let raw: Vec<RawGps> = messages(&ended, "/receiver/raw");
    let times: Vec<u64> = raw.iter().map(|raw| raw.measured_ns).collect();
    assert!(times.len() > 10 && times.is_sorted(), "{times:?}");
    assert!(raw.iter().any(|raw| raw.fix == 3) && raw.iter().any(|raw| raw.fix == 0));
    let positions: Vec<GpsPosition> = messages(&ended, "/gps/position");
    let fixes = raw.iter().filter(|raw| raw.fix == 3).count();
    // Beside other tests windows are lost.
    assert!(positions.len() > 5 && positions.len() <= fixes, "{} of {fixes}", positions.len());
    positions.iter().for_each(assert_is_the_place);
    let velocities: Vec<GpsVelocity> = messages(&ended, "/gps/velocity");
    assert!(velocities.iter().all(|velocity| (velocity.velocity_ned_mps[0] - 21.9).abs() < 1e-9));
}

#[test]
fn newer_receiver_behind_a_converter_is_found_again_after_the_connection_broke() {
    let Some(mut peer) = Peer::start("receiver.py", &["tcp", "newer"]) else { return };
    let _turn = among_others();
    let device = peer.address().to_owned();
    let mut module = run(TCP, &format!("device = \"{device}\""));
    module.await_words("partitions are ready");
    std::thread::sleep(std::time::Duration::from_secs(3));
    peer.say(&json!({ "hang_up": true }));
    module.await_words("is not there");
    module.await_words("is there");
    std::thread::sleep(std::time::Duration::from_secs(3));
    let ended = ended(module);
    let told = peer.finish();
    assert_eq!((&told["asked"][2], &told["period"]), (&json!("CFG-VALSET"), &json!(0.2)), "{told}");
    let positions: Vec<GpsPosition> = messages(&ended, "/gps/position");
    positions.iter().for_each(assert_is_the_place);
    assert!(positions.len() > 8, "{}", positions.len());
}

#[test]
fn converter_that_vanishes_without_a_word_is_dialled_anew_and_its_solutions_come_again() {
    let Some(mut peer) = Peer::start("receiver.py", &["tcp"]) else { return };
    let _turn = among_others();
    let device = peer.address().to_owned();
    let mut module = run(TCP, &format!("device = \"{device}\""));
    module.await_words("partitions are ready");
    std::thread::sleep(std::time::Duration::from_secs(2));
    peer.say(&json!({ "vanish": true }));
    module.await_words("not one byte in 10 s; it is dialled anew");
    module.await_words("is there");
    let begun = std::time::Instant::now();
    std::thread::sleep(std::time::Duration::from_secs(3));
    let after_s = begun.elapsed().as_secs_f64();
    let ended = ended(module);
    peer.finish();
    let raw: Vec<RawGps> = messages(&ended, "/receiver/raw");
    let times: Vec<u64> = raw.iter().map(|raw| raw.measured_ns).collect();
    let gap_ns = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(gap_ns > 8_000_000_000, "a gap of {gap_ns} ns is none");
    let (last_ns, gap_at) =
        (times.last().unwrap(), times.windows(2).position(|pair| pair[1] - pair[0] == gap_ns));
    let came = times.len() - 1 - gap_at.unwrap();
    assert!(came > 3, "{came} solutions came in {after_s} s after it was back, the last at {last_ns} ns");
}

#[test]
fn receiver_that_is_not_there_is_said_once_and_the_module_goes_on() {
    let _turn = among_others();
    let mut module = run(TCP, "device = \"tcp:127.0.0.1:9\"");
    module.await_words("receiver tcp:127.0.0.1:9 is not there");
    std::thread::sleep(std::time::Duration::from_secs(3));
    let ended = ended(module);
    assert_eq!(ended.stderr.matches("is not there").count(), 1, "{}", ended.stderr);
    let mut faults = ended.faults();
    // A machine that is held up by others may take a window from it on the wall clock.
    faults.retain(|fault| fault.partition == "receiver" && fault.error != "window_overrun");
    assert!(faults.iter().all(|fault| fault.error == "application_error"), "{faults:#?}");
}

#[test]
fn device_that_is_no_place_is_refused_with_an_example() {
    let _turn = among_others();
    let ended = run(TCP, "device = \"tcp:converter\"").end();
    assert!(ended.stderr.contains("such as \"tcp:192.168.1.20:4001\""), "{}", ended.stderr);
}
