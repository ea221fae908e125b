//! What an operator may do to a partition: stop, start, freeze and thaw, planned by module time.

use std::time::Duration;

use bateleur_tests::{Ended, Sketch, alone, among_others, await_some, bateleur, process_named};

fn run(sketch: &Sketch, acts: &[&str], until_s: &str) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = sketch.write(folder.path());
    let mut arguments = vec!["run", "--fast", "--schedule", &schedule, "--until", until_s];
    arguments.extend(acts);
    bateleur(&arguments).end().expect_code(0)
}

fn two() -> Sketch {
    Sketch::new().partition("other", "counter", 500, "").partition("one", "counter", 500, "")
}

/// Windows of `partition` that were granted from one second to another.
fn granted(ended: &Ended, partition: &str, from_s: u64, to_s: u64) -> usize {
    let inside = from_s * 1_000_000_000..to_s * 1_000_000_000;
    let windows = ended.windows();
    let of = windows.iter().filter(|window| window.partition == partition && window.granted_ns.is_some());
    of.filter(|window| inside.contains(&window.planned_start_ns)).count()
}

#[test]
fn stopped_partition_gets_no_window_until_it_is_started_and_the_other_keeps_all_of_its_own() {
    let _turn = among_others();
    let ended = run(&two(), &["--stop", "one@1", "--start", "one@3"], "5");
    assert_eq!((granted(&ended, "one", 0, 1), granted(&ended, "one", 1, 3)), (50, 0));
    // The successor is ready 20 ms of module time after its start.
    assert_eq!(granted(&ended, "one", 3, 5), 99);
    assert_eq!(granted(&ended, "other", 0, 5), 250);
    assert!(ended.faults().is_empty(), "an order is no fault: {:?}", ended.faults());
    ended.expect_words(&["one: stopped by the operator", "one: started by the operator"]);
}

#[test]
fn partition_beyond_its_budget_is_started_by_the_operator_with_a_new_budget() {
    let _turn = among_others();
    let keys = "restart = { start = \"cold\", budget = 1, within = \"10s\", then = \"idle\" }";
    let sketch = Sketch::new().partition("one", "counter", 500, keys);
    let acts = ["--kill", "one@1", "--kill", "one@2", "--start", "one@4", "--kill", "one@6"];
    let ended = run(&sketch, &acts, "8");
    assert_eq!(granted(&ended, "one", 2, 4), 0);
    assert_eq!(granted(&ended, "one", 4, 6), 99);
    let actions: Vec<String> = ended.faults().into_iter().map(|fault| fault.action).collect();
    assert_eq!(actions, ["cold_restart", "idle", "cold_restart"]);
    assert_eq!(granted(&ended, "one", 7, 8), 50);
}

#[test]
fn starting_a_partition_that_runs_or_stopping_one_that_is_stopped_changes_nothing() {
    let _turn = among_others();
    let ended = run(&two(), &["--start", "one@1", "--stop", "one@2", "--stop", "one@3"], "4");
    assert_eq!(granted(&ended, "one", 0, 2), 100);
    assert_eq!(ended.stderr.matches("by the operator").count(), 1, "{}", ended.stderr);
    let told = [
        "start was planned, and nothing was done: runs, or is about to",
        "stop, as planned",
        "stop was planned, and nothing was done: is not running",
    ];
    assert_eq!(ended.orders(), told, "or a test of faults tests nothing and does not say so");
}

#[test]
fn frozen_partition_gets_no_window_and_goes_on_where_it_was_when_it_is_thawed() {
    let _turn = among_others();
    let keys = "retained = \"4KiB\"\nrestart = { start = \"warm\" }";
    let sketch = Sketch::new().partition("kept", "warm", 500, keys).partition("other", "counter", 500, "");
    let ended = run(&sketch, &["--freeze", "kept@1", "--thaw", "kept@3", "--kill", "kept@4"], "5");
    assert_eq!((granted(&ended, "kept", 1, 3), granted(&ended, "kept", 3, 4)), (0, 50));
    assert_eq!(granted(&ended, "other", 0, 5), 250);
    // It is the same process: started twice in all, with the windows of one second and one second counted.
    let ended = ended.expect_words(&["HmPartitionWarmRestart found Some(100)"]);
    assert_eq!(ended.stderr.matches(" found ").count(), 2, "{}", ended.stderr);
}

#[test]
fn successor_of_a_partition_that_is_killed_while_it_is_frozen_is_held_until_it_is_thawed() {
    let _turn = among_others();
    let ended = run(&two(), &["--freeze", "one@1", "--kill", "one@2", "--thaw", "one@3"], "4");
    assert_eq!((granted(&ended, "one", 1, 3), granted(&ended, "one", 3, 4)), (0, 50));
    assert_eq!(ended.faults().len(), 1);
}

fn talking() -> Sketch {
    let out = "[partition.talker.port]\nout = { direction = \"source\", kind = \"queuing\", message = \"GroundMessage\" }";
    let into = "restart = { budget = 1, then = \"idle\" }\n[partition.listener.port]\n\
                in = { direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 4 }";
    Sketch::new()
        .table("[[channel]]\nsource = \"talker.out\"\ndestinations = [\"listener.in\"]")
        .partition("talker", "queuer", 500, out)
        .partition("listener", "queuer", 500, into)
}

#[test]
fn queue_of_a_stopped_partition_does_not_stay_full_for_its_peer() {
    let _turn = among_others();
    let ended = run(&talking(), &["--stop", "listener@1", "--start", "listener@2"], "3");
    assert!(!ended.stderr.contains("refused"), "{}", ended.stderr);
    assert!(
        ended.stderr.matches("heard 1\n").count() == 2,
        "it hears after its start too:\n{}",
        ended.stderr
    );
}

#[test]
fn queue_of_a_partition_without_a_budget_does_not_stay_full_for_its_peer() {
    let _turn = among_others();
    let ended = run(&talking(), &["--kill", "listener@1", "--kill", "listener@2"], "4");
    assert_eq!(ended.faults().last().unwrap().action, "idle");
    assert!(!ended.stderr.contains("refused"), "{}", ended.stderr);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn frozen_spinner_uses_no_processor_on_the_wall_clock_and_goes_on_when_it_is_thawed() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("mill", "hanger", 5_000, "").write(folder.path());
        let acts = ["--freeze", "mill@1", "--thaw", "mill@4", "--until", "8"];
        let mut module = bateleur(&[&["run", "--schedule", &schedule], &acts[..]].concat());
        module.await_words("frozen by the operator");
        let frozen = process_named(module.pid(), "mill");
        std::thread::sleep(Duration::from_millis(1500));
        let later = frozen.again().expect("it lives");
        assert!(later.used_ticks <= frozen.used_ticks + 1, "{frozen:?} {later:?}");
        module.await_words("thawed by the operator");
        let went_on = await_some(Duration::from_secs(3), || {
            frozen.again().filter(|now| now.used_ticks > later.used_ticks + 10)
        });
        assert!(went_on.is_some(), "{:?}", frozen.again());
        module.end().expect_code(0);
    }
}
