//! Channels whose memory a partition has written over: they are found, made anew, and everybody is there again. A partition
//! that fails by itself costs its peers nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use bateleur_recording::{Ending, for_each};
use bateleur_tests::{Ended, NINE, Sketch, alone, among_others, await_some, bateleur, edited, process_named};
use rustix::process::Signal;

/// When the run ends, s.
const END_S: u64 = 12;

/// The flight's module, one of whose partitions writes over its channels at an instant; nobody flies.
fn damaged(partition: &str, at_s: &str, clock: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = folder.path().join("schedule.toml");
    std::fs::write(&schedule, edited(&[])).unwrap();
    let fault = format!("{partition}:wild-ports@{at_s}");
    let until = END_S.to_string();
    let device = "command.device=/dev/nowhere";
    let fixed = ["run", "--record", "--until", &until, "--set", device, "--inject", &fault, "--schedule"];
    bateleur(&[&fixed[..], &[schedule.to_str().unwrap()], clock].concat()).end().expect_code(0)
}

/// Every partition has the windows of the last second, and nothing is wrong any more.
fn assert_all_are_there(ended: &Ended, about: &str) {
    let from_ns = (END_S - 1) * 1_000_000_000;
    let windows = ended.windows();
    for partition in NINE {
        let own: Vec<_> = windows
            .iter()
            .filter(|window| window.partition == partition && window.planned_start_ns >= from_ns)
            .collect();
        assert!(own.len() > 40, "{about}: {partition} has {} windows", own.len());
        let missed = own.iter().filter(|window| window.granted_ns.is_none() && !window.late).count();
        assert_eq!(missed, 0, "{about}: {partition} is not there\n{}", ended.stderr);
    }
    // That the machine held the dispatcher up is nobody's fault in the module.
    let others = ["application_error", "window_overrun", "late_dispatcher", "processor_taken"];
    let wrong = |error: &str| !others.contains(&error);
    let late: Vec<_> =
        ended.faults().into_iter().filter(|fault| fault.time_ns >= from_ns && wrong(&fault.error)).collect();
    assert!(late.is_empty(), "{about}: {late:?}");
}

#[test]
fn partitions_that_write_over_their_channels_leave_a_module_with_all_its_partitions() {
    let _turn = among_others();
    for (partition, at_s) in [("estimator", "3"), ("imu", "3.1"), ("command", "3"), ("controller", "3.7")] {
        let ended = damaged(partition, at_s, &["--fast"]);
        assert!(ended.stderr.contains("channels made anew"), "{}", ended.stderr);
        assert_all_are_there(&ended, &format!("{partition} at {at_s} s"));
    }
}

#[test]
fn successor_that_fails_by_itself_costs_its_peers_nothing() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let late = "startup_timeout = \"200ms\"\nattributes = { again_ms = 5000 }\n";
    let schedule = Sketch::new()
        .partition("late", "late_starter", 500, late)
        .partition("peer", "counter", 500, "")
        .table("[partition.late.port]\nout = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }")
        .table(
            "[partition.peer.port]\nheard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"1s\" }",
        )
        .table("[[channel]]\nsource = \"late.out\"\ndestinations = [\"peer.heard\"]")
        .write(folder.path());
    let kill = ["run", "--fast", "--until", "3", "--kill", "late@1", "--schedule", &schedule];
    let ended = bateleur(&kill).end().expect_code(0);
    let faults = ended.faults();
    assert!(faults.len() > 2 && faults.iter().all(|fault| fault.partition == "late"), "{faults:?}");
    assert!(!ended.stderr.contains("made anew"), "{}", ended.stderr);
    let peers: Vec<_> = ended.windows().into_iter().filter(|window| window.partition == "peer").collect();
    assert!(peers.len() > 100 && peers.iter().all(|window| window.closed_ns.is_some()));
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn channels_are_made_anew_while_dispatchers_run_on_the_wall_clock() {
        let _turn = alone();
        let ended = damaged("servo", "3.003", &[]);
        assert!(ended.stderr.contains("channels made anew"), "{}", ended.stderr);
        assert_all_are_there(&ended, "servo");
        // Whether the recorder has ended of it or not, the log goes on: of the damaged channels too, once they are new.
        let mut last: BTreeMap<String, u64> = BTreeMap::new();
        for_each(ended.folder().join("ports.mcap"), |entry| {
            last.insert(entry.topic.to_owned(), entry.time_ns);
        })
        .unwrap();
        for topic in ["/servo/timers", "/rate_generator/rate"] {
            let last_ns = last.get(topic).copied().unwrap_or_default();
            assert!(last_ns > (END_S - 1) * 1_000_000_000, "{topic} ends at {last_ns} ns: {}", ended.stderr);
        }
    }

    /// What a recorder ends of when it reads what a partition has written over; here it is made certain.
    #[test]
    fn a_recorder_that_ends_of_what_it_reads_is_followed_and_the_log_goes_on_in_its_next_part() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = folder.path().join("schedule.toml");
        std::fs::write(&schedule, edited(&[])).unwrap();
        let fixed = ["run", "--record", "--until", "6", "--set", "command.device=/dev/nowhere", "--schedule"];
        let module = bateleur(&[&fixed[..], &[schedule.to_str().unwrap()]].concat());
        let first = process_named(module.pid(), "recorder");
        let runs = || module.said().contains("partitions are ready");
        assert!(await_some(Duration::from_secs(20), || runs().then_some(())).is_some(), "{}", module.said());
        std::thread::sleep(Duration::from_secs(1));
        first.signal(Signal::KILL);
        let ended = module.end().expect_code(0);
        let told = "ports.mcap ends: the recorder has ended; another one goes on in ports.part-1.mcap";
        assert!(ended.stderr.contains(told), "{}", ended.stderr);
        assert!(ended.faults().iter().all(|fault| fault.error != "port_error"), "nobody else notices");
        // Read as one log, it holds messages of the end, of every partition; its gap is no longer than the log says.
        let mut last: BTreeMap<String, u64> = BTreeMap::new();
        let ending = for_each(ended.folder().join("ports.mcap"), |entry| {
            last.insert(entry.topic.to_owned(), entry.time_ns);
        });
        assert!(matches!(ending.unwrap(), Ending::Cut(_)), "the verdict says that it was cut");
        for topic in ["/rate_generator/rate", "/hil_interface/status", "/servo/timers"] {
            let last_ns = last.get(topic).copied().unwrap_or_default();
            assert!(last_ns > 5_500_000_000, "{topic} ends at {last_ns} ns: {last:?}");
        }
    }
}
