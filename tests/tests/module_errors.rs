//! Errors of the module itself: what `[health.module]` says is done, on either clock, and stands in every log.

use bateleur_tests::{Ended, Fault, Sketch, alone, among_others, bateleur};
use rustix::process::Signal;

/// Two partitions that say at each start why they were started, under these health tables.
fn warm_pair(folder: &std::path::Path, health: &str, of_first: &str) -> String {
    let keys = "retained = \"4KiB\"\nrestart = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }\n";
    let sketch = Sketch::new().table(health).partition("first", "warm", 1000, &format!("{keys}{of_first}"));
    sketch.partition("second", "warm", 1000, keys).write(folder)
}

/// Errors of the module of that name. A busy machine may add late dispatchers.
fn of_module(ended: &Ended, error: &str) -> Vec<Fault> {
    let of_module = |fault: &Fault| fault.partition.is_empty() && fault.error == error;
    ended.faults().into_iter().filter(of_module).collect()
}

#[track_caller]
fn assert_logged(fault: &Fault, error: &str, action: &str) {
    assert_eq!((fault.error.as_str(), fault.action.as_str()), (error, action), "{fault:?}");
}

const RESET_ONCE: &str = "[health]\nreset = { budget = 1, within = \"60s\", startup = \"300ms\" }\n\
     [health.module]\npartition_stopped = \"reset\"\n";
const STOPS: &str = "health = { killed = \"stop\" }";

#[test]
fn hmt_02_reset_module_begins_with_frame_0_and_that_start_condition_and_shuts_down_beyond_its_budget() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let schedule = warm_pair(scratch.path(), RESET_ONCE, STOPS);
    let kills = ["--kill", "first@1", "--kill", "second@2", "--kill", "first@3"];
    let run = ["run", "--fast", "--until", "10", "--schedule", &schedule];
    let ended = bateleur(&[&run[..], &kills[..]].concat()).end().expect_code(1).expect_words(&[
        "first: NormalStart found None",
        "1.000 s  module: partition_stopped (partition first is stopped (killed)) -> reset",
        "1.300 s  module: frame 0 again after 300.0 ms",
        "first: HmModuleRestart found None",
        "second: HmModuleRestart found None",
        // A warm restart after it finds the windows since then.
        "second: HmPartitionWarmRestart found Some(35)",
        "3.000 s  module: partition_stopped (partition first is stopped (killed)) -> shutdown",
        "stopped after 3.00 s: partition first is stopped (killed)",
    ]);
    let module = of_module(&ended, "partition_stopped");
    assert_eq!(module.len(), 2, "{module:?}");
    assert_logged(&module[0], "partition_stopped", "reset");
    assert_eq!((module[0].time_ns, module[0].recovered_ns), (1_000_000_000, Some(1_300_000_000)));
    assert_logged(&module[1], "partition_stopped", "shutdown");
    let windows = ended.windows();
    let first_again = windows.iter().find(|window| window.planned_start_ns >= 1_000_000_000).unwrap();
    assert_eq!((first_again.frame, first_again.planned_start_ns), (0, 1_300_200_000));
    assert!(windows.windows(2).all(|pair| pair[0].planned_end_ns <= pair[1].planned_start_ns));
    let log = bateleur(&["health", ended.folder().to_str().unwrap()]).end().expect_code(0);
    for line in [
        "module: partition_stopped (partition first is stopped (killed)) -> reset",
        "after reset 1",
        "module: recovered (after 300.0 ms)",
        "module: partition_stopped (partition first is stopped (killed)) -> shutdown",
        "module: module_stop",
    ] {
        assert!(log.stdout.contains(line), "{line:?} is not in\n{}", log.stdout);
    }
}

#[test]
fn ignored_stop_of_a_partition_is_logged_and_the_others_go_on() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let schedule = warm_pair(scratch.path(), "", STOPS);
    let ended = bateleur(&["run", "--fast", "--until", "3", "--schedule", &schedule, "--kill", "first@1"]);
    let ended = ended.end().expect_code(0);
    assert_logged(&of_module(&ended, "partition_stopped")[0], "partition_stopped", "ignore");
    assert_eq!(ended.windows().iter().filter(|window| window.granted_ns.is_some()).count(), 50 + 150);
}

#[test]
fn module_that_can_not_start_is_tried_again_as_often_as_its_budget_allows() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let health = "[health]\nreset = { budget = 2 }\n[health.module]\nconfig_error = \"reset\"\n";
    let schedule = warm_pair(scratch.path(), health, "attributes = { nonsense = 1 }");
    let ended = bateleur(&["run", "--fast", "--until", "3", "--schedule", &schedule]).end().expect_code(2);
    let refused = "partition first refused to start: warm: unknown attribute nonsense";
    assert_eq!(ended.stderr.matches(&format!("config_error ({refused}")).count(), 2, "{}", ended.stderr);
    let module = of_module(&ended, "config_error");
    let actions: Vec<&str> = module.iter().map(|fault| fault.action.as_str()).collect();
    assert_eq!(actions, ["reset", "reset", "shutdown"]);
    assert!(module.iter().all(|fault| fault.detail.contains(refused)), "{module:?}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_whose_program_is_gone_when_it_is_to_start_again_is_a_config_error() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let program = scratch.path().join("copy");
        std::fs::copy(bateleur_tests::program("warm"), &program).unwrap();
        let text = std::fs::read_to_string(warm_pair(scratch.path(), "", "")).unwrap();
        let own = bateleur_tests::program("warm").display().to_string();
        let schedule = scratch.path().join("gone.toml");
        std::fs::write(&schedule, text.replacen(&own, program.to_str().unwrap(), 1)).unwrap();
        let schedule = schedule.to_str().unwrap();
        let mut run = bateleur(&["run", "--schedule", schedule, "--until", "4", "--kill", "first@2"]);
        run.await_words("2 partitions are ready");
        std::fs::remove_file(&program).unwrap();
        let ended = run.end().expect_code(0);
        let module = of_module(&ended, "config_error");
        assert_eq!(module.len(), 1, "{}", ended.stderr);
        assert_logged(&module[0], "config_error", "ignore");
        assert!(module[0].detail.contains("partition first can not be started again"), "{module:?}");
    }

    #[test]
    fn dispatcher_that_comes_too_late_is_told_once_a_second_and_ends_the_module_where_it_shall() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let late = |action: &str| {
            let health =
                format!("[health]\nlate_after = \"40ms\"\n[health.module]\nlate_dispatcher = \"{action}\"\n");
            let schedule = warm_pair(scratch.path(), &health, "");
            let stalls = ["--inject", "dispatcher:stall=90ms@1", "--inject", "dispatcher:stall=90ms@1.3"];
            let run = ["run", "--until", "2.2", "--schedule", &schedule];
            bateleur(&[&run[..], &stalls[..]].concat()).end()
        };
        let ignored = late("ignore").expect_code(0);
        let module = of_module(&ignored, "late_dispatcher");
        assert!(!module.is_empty(), "{}", ignored.stderr);
        module.iter().for_each(|fault| assert_logged(fault, "late_dispatcher", "ignore"));
        assert!(
            module.windows(2).all(|pair| pair[1].time_ns - pair[0].time_ns >= 1_000_000_000),
            "{module:?}"
        );
        assert!(module[0].detail.contains("the dispatcher of core 1 came"), "{module:?}");
        let shut = late("shutdown").expect_code(1).expect_words(&["stopped after", "late_dispatcher"]);
        assert_logged(of_module(&shut, "late_dispatcher").last().unwrap(), "late_dispatcher", "shutdown");
    }

    #[test]
    fn reset_on_the_wall_clock_lets_module_time_go_on_and_power_fail_shuts_down() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let schedule = warm_pair(scratch.path(), RESET_ONCE, STOPS);
        let mut run = bateleur(&["run", "--schedule", &schedule, "--kill", "first@1"]);
        run.await_words("frame 0 again after");
        run.await_words("first: HmModuleRestart found None");
        run.signal(Signal::POWER);
        let ended = run.end().expect_code(1).expect_words(&["module: power_fail", "SIGPWR", "-> shutdown"]);
        let module = of_module(&ended, "partition_stopped");
        assert_logged(&module[0], "partition_stopped", "reset");
        assert!(module[0].recovered_ns.is_some_and(|again| again > module[0].time_ns), "{module:?}");
        assert_logged(&of_module(&ended, "power_fail")[0], "power_fail", "shutdown");
        let windows = ended.windows();
        assert!(windows.windows(2).all(|pair| pair[0].planned_end_ns <= pair[1].planned_start_ns));
        assert_eq!(
            windows.iter().filter(|window| window.frame == 0).count(),
            4,
            "two starts of two partitions"
        );
    }
}
