//! Sealed channels in whole modules: what a partition writes over its port memory harms nobody else, and everything else is as on shared ones.

use std::path::Path;

use bateleur_recording::{Ending, for_each};
use bateleur_tests::{Ended, NINE, Sketch, TWO_LAPS, alone, among_others, bateleur, channel_between, edited};

/// The flight's schedule with a key that holds for all of its channels, in `folder`.
fn schedule(folder: &Path, isolation: &str) -> String {
    let path = folder.join("schedule.toml");
    std::fs::write(&path, format!("isolation = \"{isolation}\"\n{}", edited(&[]))).unwrap();
    path.to_str().unwrap().to_owned()
}

fn flight(isolation: &str, options: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path(), isolation);
    bateleur(&[&["fly", "--fast", "--format", "json", "--schedule", &schedule], options].concat()).end()
}

/// A small generator (xorshift), the same for the same seed.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }
}

/// Wild writes of each of the nine, five times 2000 bytes, at random instants.
fn wild(seed: u64) -> Vec<String> {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let faults = NINE.iter().flat_map(|partition| std::iter::repeat_n(partition, 5));
    let fault = |partition: &&str| {
        let at_ms = 5_000 + random.below(190_000);
        ["--inject".to_owned(), format!("{partition}:wild-ports@{}.{:03}", at_ms / 1000, at_ms % 1000)]
    };
    faults.flat_map(fault).collect()
}

#[test]
fn flight_is_the_same_on_shared_sealed_and_checked_channels() {
    let _turn = among_others();
    let digests = ["shared", "sealed", "checked"]
        .map(|isolation| flight(isolation, &[]).expect_code(0).summary()["digest"].clone());
    assert!(digests.iter().all(|digest| *digest == digests[0]), "{digests:?}");
}

#[test]
fn wild_writes_of_all_partitions_over_all_that_they_map_harm_nobody_else() {
    let _turn = among_others();
    for (seed, isolation) in [(1, "sealed"), (2, "checked"), (3, "sealed"), (4, "checked")] {
        let faults = wild(seed);
        let faults: Vec<&str> = faults.iter().map(String::as_str).collect();
        let ended = flight(isolation, &faults);
        let about = format!("seed {seed}, {isolation}: {}", ended.stderr);
        // What is written over a message that waits is a message yet, unless messages have a checksum: figures may be wrong then.
        if isolation == "checked" {
            let summary = ended.summary();
            assert_eq!(summary["waypoints"], serde_json::Value::from(TWO_LAPS.to_vec()), "{about}");
            assert_eq!(summary["failure"], serde_json::Value::Null, "{about}");
        }
        assert!(!ended.stderr.contains("made anew"), "a sealed channel is never damaged: {about}");
        for fault in ended.faults() {
            let own = ["port_error", "application_error"].contains(&fault.error.as_str());
            assert!(own, "{fault:?} ended somebody: {about}");
        }
        let ending = for_each(ended.folder().join("ports.mcap"), |_| {}).unwrap();
        assert!(matches!(ending, Ending::Complete), "the recorder ended: {about}");
    }
}

fn sealed(source: &str, destination: &str) -> String {
    format!("{}\nisolation = \"sealed\"", channel_between(source, destination))
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partitions_that_are_killed_come_back_to_their_sealed_channels() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = schedule(folder.path(), "sealed");
        let mut random = Random(0x5ea1_ed01);
        let mut options: Vec<String> =
            ["run", "--record", "--until", "12", "--set", "command.device=/dev/nowhere"]
                .map(str::to_owned)
                .to_vec();
        options.extend(["--schedule".to_owned(), schedule]);
        for partition in NINE {
            let at_ms = 2_000 + random.below(7_000);
            options
                .extend(["--kill".to_owned(), format!("{partition}@{}.{:03}", at_ms / 1000, at_ms % 1000)]);
        }
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        let ended = bateleur(&options).end().expect_code(0);
        let killed: Vec<String> = ended
            .faults()
            .into_iter()
            .filter(|fault| fault.error == "killed")
            .map(|fault| fault.partition)
            .collect();
        assert_eq!(killed.len(), NINE.len(), "{}", ended.stderr);
        let windows = ended.windows();
        for partition in NINE {
            let last = windows
                .iter()
                .filter(|window| window.partition == partition && window.planned_start_ns >= 11_000_000_000);
            let closed = last.filter(|window| window.closed_ns.is_some()).count();
            assert!(
                closed > 40,
                "{partition} has closed {closed} windows of the last second: {}",
                ended.stderr
            );
        }
    }

    #[test]
    fn operator_and_observers_reach_sealed_channels() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new()
        .table(&sealed("hand.out", "queuer.in"))
        .table(&sealed("hand.rate", "reader.rate"))
        .table(&sealed("reader.other", "reader.back"))
        .partition("hand", "counter", 1000, "[partition.hand.port]\n\
            out = { direction = \"source\", kind = \"queuing\", message = \"GroundMessage\", operator = true }\n\
            rate = { direction = \"source\", kind = \"sampling\", message = \"Rate\", operator = true }\n")
        .partition("queuer", "queuer", 1000, "[partition.queuer.port]\n\
            in = { direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 4 }\n")
        .partition("reader", "untyped", 1000, "[partition.reader.port]\n\
            rate = { direction = \"destination\", kind = \"sampling\", message = \"Rate\", refresh = \"1s\" }\n\
            other = { direction = \"source\", kind = \"sampling\", message = \"Rate\" }\n\
            back = { direction = \"destination\", kind = \"sampling\", message = \"Rate\", refresh = \"1s\" }\n")
        .write(folder.path());
        let mut module = bateleur(&["run", "--record", "--schedule", &schedule, "--until", "60"]);
        module.await_words("3 partitions are ready");
        let pid = module.pid().to_string();
        for number in 1..=12 {
            let message = format!("letter={number}");
            bateleur(&["ports", "pub", "--module", &pid, "hand.out", &message]).end().expect_code(0);
            module.await_words(&format!("queuer: heard {number}"));
        }
        let seen = bateleur(&["ports", "echo", "--module", &pid, "reader.other", "--count", "3"]).end();
        assert!(seen.expect_code(0).stdout.lines().count() >= 3);
        module.signal(rustix::process::Signal::INT);
        let ended = module.end().expect_code(0);
        assert!(ended.faults().is_empty(), "{:?}", ended.faults());
        let log = bateleur_recording::read(ended.folder().join("ports.mcap"), |_| true).unwrap();
        let recorded = log.track("/hand/out", "GroundMessage").map_or(0, |track| track.samples.len());
        assert_eq!(recorded, 12);
    }
}
