//! Whole flight folders: known ones, damaged ones, empty ones.
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests count as no tests for the lints

mod synthetic;

use bateleur_recording::{self as log, Ending};
use bateleur_report::chains::ChainBound;
use bateleur_report::html::SCRIPT;
use bateleur_report::reasons::Reason;
use bateleur_report::run::Clock;
use bateleur_report::{Flight, Inputs, Judge, ReportError, beside, compare, summary, text, write};
use bateleur_simulator::truth::TruthRecord;
use std::path::Path;

fn page(dir: &Path) -> String {
    std::fs::read_to_string(dir.join("report.html")).unwrap()
}

/// Every element that is opened is closed, in order; nothing that is no number got in; nothing is fetched from elsewhere; the page's
/// own script is the only one.
fn check_page(page: &str) {
    assert!(page.len() <= 2 << 20, "{} bytes", page.len());
    let page = &page.replacen(&format!("<script>\n{SCRIPT}</script>"), "", 1);
    let body = page.strip_prefix("<!DOCTYPE html>\n").unwrap();
    let mut open: Vec<&str> = Vec::new();
    for piece in body.split('<').skip(1) {
        let (tag, _) = piece.split_once('>').unwrap_or_else(|| panic!("unfinished tag: {piece:.40}"));
        let name = tag.split([' ', '/']).find(|name| !name.is_empty()).unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "in {piece:.60}");
        } else if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert_eq!(open, Vec::<&str>::new());
    for link in page.split("href=\"#").skip(1) {
        let (anchor, _) = link.split_once('"').unwrap();
        assert!(page.contains(&format!(r#"id="{anchor}""#)), "nothing is at #{anchor}");
    }
    for bad in ["NaN", "inf\"", " inf", "http:", "https:", "<script", "<link", "<img"] {
        assert!(!page.contains(bad), "{bad} is in the page");
    }
}

#[test]
fn known_flight_scores_what_it_was_made_with() {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("known-flight");
    std::fs::create_dir_all(&dir).unwrap();
    synthetic::write(&dir, synthetic::whole_s());
    let chain = ChainBound {
        name: "gyro to elevator".into(),
        partitions: ["imu", "estimator", "controller", "servo"].map(String::from).to_vec(),
        computed_ns: 4_200_000,
        allowed_ns: 25_000_000,
    };
    let summary = write(&dir, &Inputs { chains: vec![chain], ..Inputs::default() }).unwrap();
    assert!(summary.completed && summary.notes.is_empty(), "{:?} {:?}", summary.failure, summary.notes);
    assert_eq!(summary.waypoints.join(" "), "WP0 WP1 WP2 WP3 WP0 WP1 WP2 WP3 WP0");
    assert_eq!((summary.laps, summary.restarts, summary.unverified_waypoints.len()), (2, 1, 0));
    let near = |found: Option<f64>, wanted: f64| {
        assert!((found.unwrap() - wanted).abs() < 0.02, "{found:?} instead of {wanted}");
    };
    let scores = &summary.scores;
    near(scores.cross_track_rms_m, synthetic::BESIDE_M);
    near(scores.straight_cross_track_rms_m, synthetic::BESIDE_M);
    near(scores.altitude_rms_m, synthetic::ABOVE_M);
    near(scores.altitude_true_rms_m, synthetic::GROWN_BIAS_M - synthetic::ABOVE_M);
    near(scores.airspeed_rms_mps, 0.2 / 2f64.sqrt());
    assert!(scores.cross_track_true_rms_m.unwrap() > 2.5);
    near(summary.estimator.position_rms_m, 0.0);
    assert!(summary.estimator.position_true_rms_m.unwrap() > 5.0);
    let chain = summary.chain_execution_us.unwrap();
    assert!((chain.p50 - 4450.0).abs() < 10.0, "{chain:?}");
    // From imu's opening to servo's close; the Estimator's three dead windows made it three periods older.
    let age = &summary.chain_ages[0];
    let measured = age.measured_us.unwrap();
    assert!((measured.p50 - 3850.0).abs() < 10.0 && (measured.max - 63_850.0).abs() < 20.0, "{age:?}");
    assert_eq!(age.too_old, 2);
    assert!(page(&dir).contains("gyro to elevator"));
    assert!(summary.window_start_lateness_us.unwrap().max < 20.0);
    assert_eq!((summary.clock, summary.skipped_windows), (Some(Clock::Wall), 3));
    assert!((summary.faults[0].recovery_ms.unwrap() - 64.4).abs() < 1e-6);
    let text = std::fs::read_to_string(dir.join("summary.json")).unwrap();
    let read: summary::Summary = serde_json::from_str(&text).unwrap();
    // The last digit of a number may differ once it was read.
    assert_eq!(
        (read.digest, read.waypoints, read.guarantees),
        (summary.digest.clone(), summary.waypoints.clone(), summary.guarantees.clone())
    );
    check_page(&page(&dir));
    assert!(text::table(&summary).lines().all(|line| line.chars().count() <= text::WIDTH));
}

#[test]
fn faults_and_late_windows_lead_to_their_reasons() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), synthetic::whole_s());
    std::fs::create_dir(dir.path().join("crashes")).unwrap();
    let crash = r#"{"partition":"estimator","generation":0,"time_ns":100000000000,"signal":"SIGSEGV"}"#;
    std::fs::write(dir.path().join("crashes/estimator-1.json"), crash).unwrap();
    std::fs::write(dir.path().join("crashes/imu-1.json"), "{").unwrap();
    let reason = |time_s, partition: &str| Reason {
        time_s,
        partition: partition.into(),
        frame: 4_998,
        sentence: format!("{partition} <waited>"),
    };
    let reasons = vec![reason(99.98, "estimator"), reason(150.0, "gps")];
    write(dir.path(), &Inputs { reasons, ..Inputs::default() }).unwrap();
    let page = page(dir.path());
    check_page(&page);
    let entry = concat!(
        r#"<tr id="fault-0"><td>100.00</td><td>estimator</td><td>killed</td><td>warm_restart</td><td>64.4</td><td>SIGKILL; "#,
        r#"<a href="crashes/estimator-1.json">crash report</a>"#,
    );
    assert!(page.contains(entry) && page.contains(r##"<a href="#why-0">who had the processor</a>"##));
    assert!(page.contains(r#"<tr id="why-1"><td>150.000 s</td><td>gps &lt;waited&gt;</td></tr>"#));
    assert!(page.contains(r##"<a href="#fault-0"><circle"##) && page.contains(r##"<a href="#late">0 late"##));
    assert!(page.contains("written down only: window_overrun: 1") && page.contains("crashes/imu-1.json"));
}

#[test]
fn altitude_error_is_drawn_from_the_first_capture_on() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), synthetic::whole_s());
    // Far below until a minute has passed: a slow climb.
    let late_climb = |record: &mut TruthRecord| {
        if record.time_ns < 60_000_000_000 {
            record.position_ned_m[2] += 50.0;
        }
    };
    synthetic::write_truth(dir.path(), synthetic::whole_s(), late_climb);
    write(dir.path(), &Inputs::default()).unwrap();
    let begins = r#"aria-label="Altitude error" data-axis="module time, s" data-x="60 "#;
    assert!(page(dir.path()).contains(begins));
}

#[test]
fn two_flights_are_drawn_over_one_another() {
    let dir = tempfile::tempdir().unwrap();
    let folders = ["a", "b"].map(|name| dir.path().join(name));
    for folder in &folders {
        std::fs::create_dir(folder).unwrap();
        synthetic::write(folder, synthetic::whole_s());
    }
    std::fs::write(folders[1].join("health.jsonl"), "").unwrap();
    let flights = folders.each_ref().map(|folder| Flight::load(folder, &Inputs::default()).unwrap());
    let logs = folders.each_ref().map(|folder| folder.join("ports.mcap"));
    let compared = compare::compare(&logs[0], &logs[1], &compare::Options::default()).unwrap();
    let page = beside::page([&flights[0], &flights[1]], &compared);
    check_page(&page);
    assert!(page.contains("All their messages are equal.") && page.contains("A estimator</text>"));
    assert!(page.contains("<tr><td>altitude, RMS</td><td>0.50 m</td><td>0.50 m</td><td>0.00 m</td></tr>"));
    assert!(page.contains("<tr><td>A</td><td>100.00</td><td>estimator</td>"));
    let charts = page.matches(r#"data-name="A""#).count();
    assert_eq!((charts, page.matches(r#"data-name="B""#).count()), (11, 11));
    // One of them failed before anything was logged.
    let nothing = Flight::default();
    check_page(&beside::page([&nothing, &flights[1]], &compared));
    check_page(&beside::page([&nothing, &nothing], &compared));
}

#[test]
fn flight_that_ended_after_three_seconds_is_reported_as_such() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), 3.0);
    let run = r#"{"clock":"virtual","mission":{"completed":false,"failure":"the simulator went away"}}"#;
    std::fs::write(dir.path().join("run.json"), run).unwrap();
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert!(!summary.completed);
    assert_eq!(summary.failure.as_deref(), Some("the simulator went away"));
    assert_eq!((summary.scores.cross_track_rms_m, summary.window_start_lateness_us), (None, None));
    assert!(summary.chain_execution_us.is_some() && summary.digest.is_some());
    check_page(&page(dir.path()));
}

#[test]
fn success_is_not_taken_from_the_aircrafts_word() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), synthetic::whole_s());
    synthetic::write_truth(dir.path(), synthetic::whole_s(), |record| record.position_ned_m[0] -= 200.0);
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert!(!summary.completed && summary.laps == 0);
    assert!(summary.failure.unwrap().contains("confirms 0 of 9"));
    assert!(text::table(&summary::make(dir.path(), &Inputs::default()).unwrap()).contains("WP0?"));
}

#[test]
fn somebody_elses_simulator_leaves_no_truth_and_the_aircrafts_count_has_to_do() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), synthetic::whole_s());
    std::fs::remove_file(dir.path().join("truth.bin")).unwrap();
    let own = write(dir.path(), &Inputs::default()).unwrap();
    assert!(!own.completed, "a truth of ours that is lost proves nothing");
    let path = dir.path().join("run.json");
    let mut run: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    run["foreign_simulator"] = true.into();
    std::fs::write(&path, run.to_string()).unwrap();
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert_eq!((summary.completed, summary.judged_by, summary.laps), (true, Judge::Aircraft, 2));
    assert!(summary.scores.straight_cross_track_rms_m.is_none(), "no truth, no score");
    assert_ne!(summary.digest, None, "of the Controller's commands");
    assert!(summary.notes.iter().all(|note| !note.contains("truth")), "{:?}", summary.notes);
    let text = text::table(&summary::make(dir.path(), &Inputs::default()).unwrap());
    assert!(text.contains("by the aircraft's own count") && !text.contains("WP0?"), "{text}");
    assert!(text.contains("not known") && !text.contains("cross-track"), "no rows of dashes: {text}");
    check_page(&page(dir.path()));
}

#[test]
fn empty_folder_gives_a_report_and_no_folder_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert!(!summary.completed && summary.notes.len() == 5, "{:?}", summary.notes);
    check_page(&page(dir.path()));
    let missing = write(dir.path().join("nowhere"), &Inputs::default());
    assert!(matches!(missing, Err(ReportError::NoFlight(_))));
}

#[test]
fn damaged_files_give_what_they_still_hold() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write(dir.path(), 60.0);
    for file in ["truth.bin", "ports.mcap", "windows.csv", "health.jsonl", "run.json"] {
        let path = dir.path().join(file);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() * 2 / 3 - 5]).unwrap();
    }
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert_eq!(summary.waypoints, ["WP0"]);
    assert!(summary.scores.cross_track_rms_m.is_some() && summary.windows > 15_000);
    assert!(
        summary.notes.iter().any(|note| note.contains("ports.mcap was cut short")),
        "{:?}",
        summary.notes
    );
    check_page(&page(dir.path()));
    for file in ["truth.bin", "ports.mcap", "windows.csv", "health.jsonl", "run.json"] {
        std::fs::write(dir.path().join(file), [0xff, 0, 0x80, b'\n', 7].repeat(99)).unwrap();
    }
    let summary = write(dir.path(), &Inputs::default()).unwrap();
    assert!(!summary.completed && summary.notes.len() >= 4, "{:?}", summary.notes);
    check_page(&page(dir.path()));
}

#[test]
fn log_cut_at_any_byte_is_readable_up_to_there() {
    let dir = tempfile::tempdir().unwrap();
    synthetic::write_ports(dir.path(), 2.0);
    let path = dir.path().join("ports.mcap");
    let bytes = std::fs::read(&path).unwrap();
    let whole = count(&path);
    assert_eq!(whole, (101 + 101 + 11, Ending::Complete));
    let mut last = 0;
    for length in (0..bytes.len()).step_by(997) {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let (messages, ending) = count(&path);
        assert!(matches!(ending, Ending::Cut(_)) && messages >= last && messages <= whole.0);
        last = messages;
    }
    assert_eq!(last, whole.0);
}

fn count(path: &Path) -> (usize, Ending) {
    let mut messages = 0;
    let ending = log::for_each(path, |_| messages += 1).unwrap();
    (messages, ending)
}

#[test]
fn log_of_a_killed_recorder_holds_all_but_the_last_half_second() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("ports.mcap");
    let mut writer = log::PortLog::create(&path).unwrap();
    let rate = bateleur_messages::find("Rate").unwrap();
    let channel = writer.add_channel(&log::topic("rate_generator", "rate"), rate).unwrap();
    for cycle in 0..200_u64 {
        writer.write(channel, cycle, cycle * 20_000_000, &[1; 56]).unwrap();
    }
    // Never finished, never dropped.
    std::mem::forget(writer);
    let recording = log::read(&path, |_| true).unwrap();
    assert!(matches!(recording.ending, Ending::Cut(_)));
    let track = recording.track("/rate_generator/rate", "Rate").unwrap();
    assert!(track.samples.len() >= 200 - 26 && track.samples[3] == (60_000_000, vec![1; 56]));
}

#[test]
fn parts_of_a_log_whose_recorders_were_killed_are_read_as_one_and_said_to_be_cut() {
    let dir = tempfile::tempdir().unwrap();
    let rate = bateleur_messages::find("Rate").unwrap();
    for (name, cycles, ends_well) in [
        ("ports.mcap", 0..200, false),
        ("ports.part-1.mcap", 0..0, false),
        ("ports.part-2.mcap", 300..400, true),
    ] {
        let mut writer = log::PortLog::create(dir.path().join(name)).unwrap();
        let channel = writer.add_channel(&log::topic("rate_generator", "rate"), rate).unwrap();
        for cycle in cycles {
            writer.write(channel, cycle, cycle * 20_000_000, &[1; 56]).unwrap();
        }
        match ends_well {
            true => writer.finish().unwrap(),
            false => std::mem::forget(writer),
        }
    }
    let recording = log::read(dir.path().join("ports.mcap"), |_| true).unwrap();
    assert!(matches!(recording.ending, Ending::Cut(_)));
    let samples = &recording.track("/rate_generator/rate", "Rate").unwrap().samples;
    assert!(samples.len() >= 300 - 26, "{} messages", samples.len());
    assert_eq!(samples.last(), Some(&(399 * 20_000_000, vec![1; 56])));
}

#[test]
fn log_of_a_module_that_was_reset_is_read_through_its_resets() {
    let dir = tempfile::tempdir().unwrap();
    let rate = bateleur_messages::find("Rate").unwrap();
    for (name, cycles) in [
        ("ports.mcap", 0..10),
        ("ports.part-1.mcap", 10..20),
        ("ports.reset-1.mcap", 30..40),
        ("ports.reset-1.part-1.mcap", 40..50),
        ("ports.reset-2.mcap", 60..70),
        ("ports.reset-4.mcap", 90..95), // of another run: there is no third
    ] {
        let mut writer = log::PortLog::create(dir.path().join(name)).unwrap();
        let channel = writer.add_channel(&log::topic("rate_generator", "rate"), rate).unwrap();
        for cycle in cycles {
            writer.write(channel, cycle % 30, cycle * 20_000_000, &[1; 56]).unwrap();
        }
        writer.finish().unwrap();
    }
    let times = |file: &str| -> Vec<u64> {
        let recording = log::read(dir.path().join(file), |_| true).unwrap();
        assert_eq!(recording.ending, Ending::Complete);
        let track = recording.track("/rate_generator/rate", "Rate").unwrap();
        track.samples.iter().map(|(time_ns, _)| time_ns / 20_000_000).collect()
    };
    assert_eq!(times("ports.mcap"), [0..20, 30..50, 60..70].into_iter().flatten().collect::<Vec<_>>());
    assert_eq!(times("ports.reset-1.mcap"), (30..50).collect::<Vec<_>>(), "asked for by its name: it alone");
}

#[test]
fn writer_refuses_what_readers_could_not_read() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = log::PortLog::create(dir.path().join("a.mcap")).unwrap();
    for message in bateleur_messages::catalogue().types() {
        let channel = writer.add_channel(&log::topic("p", message.name()), message).unwrap();
        writer.write(channel, 0, 0, &vec![0; message.size()]).unwrap();
        let error = writer.write(channel, 0, 0, &[0; 3]).unwrap_err();
        assert!(error.to_string().contains("has 3 bytes where"), "{error}");
    }
    assert!(log::PortLog::create(dir.path().join("no/such/folder.mcap")).is_err());
}
