//! Errors at the level of a process, which the partition's own handler deals with, and at that of the module.

use bateleur_tests::{Ended, Fault, Sketch, alone, among_others, bateleur};

const RESTART: &str =
    "retained = \"4KiB\"\nrestart = { start = \"warm\", budget = 2, within = \"10s\", then = \"idle\" }\n";

/// Runs `own`, which raises an error in its 50th window and answers to it with `response`, beside another partition.
fn run(response: &str, health: &str, more: &[&str]) -> Ended {
    let scratch = tempfile::tempdir().unwrap();
    let attributes =
        format!("attributes = {{ raise_at = 50, response = \"{response}\" }}\nerror_handler = true\n");
    let sketch = Sketch::new()
        .table(health)
        .partition("own", "handler", 1000, &format!("{RESTART}{attributes}"))
        .partition("other", "counter", 1000, "");
    let schedule = sketch.write(scratch.path());
    bateleur(&[&["run", "--fast", "--until", "4", "--schedule", &schedule], more].concat()).end()
}

fn of_own(ended: &Ended) -> Vec<(String, String, String)> {
    let faults = ended.faults().into_iter().filter(|fault| fault.partition == "own");
    faults.map(|Fault { level, error, action, .. }| (level, error, action)).collect()
}

fn entry(level: &str, error: &str, action: &str) -> (String, String, String) {
    (level.to_owned(), error.to_owned(), action.to_owned())
}

fn granted(ended: &Ended, partition: &str) -> usize {
    let windows = ended.windows();
    windows.iter().filter(|window| window.partition == partition && window.granted_ns.is_some()).count()
}

#[test]
fn raised_error_is_handed_to_the_handler_in_the_next_window_and_the_partition_goes_on() {
    let _turn = among_others();
    let ended = run("go_on", "", &[]).expect_code(0);
    assert_eq!(of_own(&ended), [entry("process", "application_error", "error_handler")]);
    assert_eq!(granted(&ended, "own"), 200);
    // Raised in window 49 of 20 ms; found at the next minor frame and handed over in the window that begins there.
    ended.expect_words(&["1.020 s  own: the handler is told of ApplicationError: what it is"]);
}

#[test]
fn handler_restarts_its_partition_warm_or_cold_within_its_budget_or_makes_it_idle() {
    let _turn = among_others();
    let warm = run("warm", "", &[])
        .expect_code(0)
        .expect_words(&["own: NormalStart found None", "own: PartitionWarmRestart found Some(50)"]);
    let handed = entry("process", "application_error", "error_handler");
    assert_eq!(of_own(&warm), [handed.clone(), entry("partition", "own_request", "warm_restart")]);
    // One that starts from nothing raises its error again, and its budget is 2.
    let cold = run("cold", "", &[]).expect_code(0).expect_words(&["own: PartitionRestart found None"]);
    let asked = |action| entry("partition", "own_request", action);
    let restarted = [handed.clone(), asked("cold_restart")];
    let expected = [&restarted[..], &restarted, &[handed.clone(), asked("idle")]].concat();
    assert_eq!(of_own(&cold), expected, "{}", cold.stderr);
    let idle = run("idle", "", &[]).expect_code(0).expect_words(&["own: own_request", "-> idle"]);
    assert_eq!(of_own(&idle), [handed, asked("idle")], "what it has asked for is in the log");
    // The window in which it decided so was its own still.
    assert_eq!((granted(&idle, "own"), granted(&idle, "other")), (51, 200));
}

#[test]
fn code_of_a_request_is_an_ordinary_exit_while_the_handler_is_not_at_work() {
    let _turn = among_others();
    for code in [66, 70, 71] {
        let scratch = tempfile::tempdir().unwrap();
        let keys = format!(
            "{RESTART}attributes = {{ exit_at = 50, exit_code = {code} }}\nerror_handler = true\n\
             health = {{ exit = \"stop\" }}\n"
        );
        let schedule = Sketch::new().partition("own", "handler", 1000, &keys).write(scratch.path());
        let ended =
            bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(0);
        assert_eq!(of_own(&ended), [entry("partition", "exit", "stop")], "code {code}");
    }
}

#[test]
fn error_inside_the_handler_is_one_of_the_partition() {
    let _turn = among_others();
    let table = "[health.partition]\napplication_error = \"cold_restart\"\nexit = \"idle\"\nwindow_overrun = \"ignore\"\n";
    let raised = run("raise", table, &[]).expect_code(0);
    let first = entry("process", "application_error", "error_handler");
    assert_eq!(
        of_own(&raised)[..2],
        [first.clone(), entry("partition", "application_error", "cold_restart")],
        "{}",
        raised.stderr
    );
    let died = run("die", table, &[]).expect_code(0);
    assert_eq!(of_own(&died), [first, entry("partition", "exit", "idle")]);
}

#[test]
fn error_of_a_partition_without_a_handler_is_answered_by_its_table() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let attributes = "attributes = { raise_at = 50 }\nhealth = { application_error = \"warm_restart\" }\n";
    let sketch = Sketch::new().partition("own", "handler", 1000, &format!("{RESTART}{attributes}"));
    let schedule = sketch.write(scratch.path());
    let ended = bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(0);
    assert_eq!(of_own(&ended), [entry("partition", "application_error", "warm_restart")]);
}

/// Runs `own` for 4 s, which raises an error in each window, with or without a handler.
fn raise_in_a_loop(handler: bool) -> Ended {
    let scratch = tempfile::tempdir().unwrap();
    let keys = format!(
        "retained = \"4KiB\"\nattributes = {{ raise_at = 1, raise_times = 1000 }}\nerror_handler = {handler}\n"
    );
    let schedule = Sketch::new().partition("own", "handler", 1000, &keys).write(scratch.path());
    bateleur(&["run", "--fast", "--until", "4", "--schedule", &schedule]).end().expect_code(0)
}

#[test]
fn error_that_is_raised_in_a_loop_has_one_entry_a_second_and_each_is_counted() {
    let _turn = among_others();
    for (handler, action) in [(false, "ignore"), (true, "error_handler")] {
        let ended = raise_in_a_loop(handler);
        let faults = ended.faults();
        assert!((4..=6).contains(&faults.len()), "{faults:?}");
        assert!(faults.iter().all(|fault| fault.error == "application_error" && fault.action == action));
        assert_eq!(faults[0].detail, "what it is");
        let more = |fault: &Fault| {
            let (count, words) = fault.detail.split_once(' ').unwrap();
            assert!(words.ends_with("the last: what it is"), "{fault:?}");
            count.parse::<usize>().unwrap()
        };
        // What the last window raises is not looked at any more.
        let counted = 1 + faults[1..].iter().map(more).sum::<usize>();
        assert!((199..=200).contains(&counted), "{counted} of 200: {faults:?}");
    }
}

#[test]
fn what_a_partition_says_stands_in_the_persistent_log_and_raises_no_error() {
    let _turn = among_others();
    let ended = run("go_on", "", &[]).expect_code(0);
    let folder = ended.folder();
    let read =
        bateleur(&["health", folder.to_str().unwrap(), "--partition", "own", "--format", "json"]).end();
    let told = read.expect_code(0).summary();
    let entries: Vec<[&str; 3]> = told["entries"]
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| ["error", "action", "detail"].map(|key| entry[key].as_str().unwrap()))
        .collect();
    let expected = [
        ["message", "", "NormalStart found None"],
        ["application_error", "error_handler", "what it is"],
        ["message", "", "the handler is told of ApplicationError: what it is"],
    ];
    assert_eq!(entries, expected);
    assert!(ended.faults().iter().all(|fault| fault.error != "message"), "it is no fault");
}

#[test]
fn program_without_a_handler_is_refused_where_the_plan_counts_on_one() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let sketch = Sketch::new().partition("own", "counter", 1000, "error_handler = true\n");
    let schedule = sketch.write(scratch.path());
    let ended = bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(2);
    ended.expect_words(&["the plan says `error_handler = true`, but this program has no error handler"]);
}

#[test]
fn error_at_the_level_of_the_module_resets_it_or_leaves_the_partition_idle() {
    let _turn = among_others();
    let tables = |action: &str| {
        format!("[health.level]\nkilled = \"module\"\n[health.module]\npartition_error = \"{action}\"\n")
    };
    let reset = run("go_on", &tables("reset"), &["--kill", "other@0.5"]).expect_code(0).expect_words(&[
        "module: partition_error (killed of partition other (ended by SIGKILL)) -> reset",
        "own: HmModuleRestart found None",
    ]);
    let faults = reset.faults();
    let told = |fault: &&Fault| fault.level == "module";
    let told: Vec<_> = faults.iter().filter(told).map(|fault| fault.action.as_str()).collect();
    assert_eq!(told, ["module", "reset"], "{faults:?}");
    let ignored = run("go_on", &tables("ignore"), &["--kill", "other@0.5"]).expect_code(0);
    assert_eq!((granted(&ignored, "other"), granted(&ignored, "own")), (25, 200));
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn hmt_12_handler_that_hangs_is_an_overrun_of_the_partition_and_not_handed_to_itself() {
        let _turn = alone();
        let table = "[health.partition]\nwindow_overrun = \"idle\"\n";
        let ended = run("hang", table, &[]).expect_code(0);
        let first = entry("process", "application_error", "error_handler");
        assert_eq!(of_own(&ended), [first, entry("partition", "window_overrun", "idle")]);
    }
}
