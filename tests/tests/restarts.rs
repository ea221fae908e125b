//! Partitions that are killed in flight: they come back, and the flight goes on.

use std::path::Path;

use bateleur_tests::{
    Ended, NINE, Sketch, TWO_LAPS, alone, among_others, bateleur, edited, executive_of, flight_schedule,
    small_mission,
};
use serde_json::Value;

fn fly_schedule(schedule: &Path, options: &[&str], kills: &[String]) -> Ended {
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(options);
    kills.iter().for_each(|kill| arguments.extend(["--kill", kill]));
    bateleur(&arguments).end()
}

fn fly(kills: &[String]) -> Ended {
    fly_schedule(&flight_schedule(), &[], kills)
}

/// A flight that is over sooner.
fn fly_small(kills: &[String]) -> Ended {
    fly_schedule(&flight_schedule(), &["--mission", small_mission().to_str().unwrap()], kills)
}

fn assert_completed(ended: &Ended) {
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
}

/// That `summary` tells of one fault, the kill of `partition` at `time_s`, and of its recovery.
fn assert_tells_of(summary: &Value, partition: &str, time_s: f64) {
    let faults = summary["faults"].as_array().unwrap();
    let told = faults.iter().find(|fault| fault["partition"] == partition).expect(partition);
    assert_eq!(told["error"], "killed", "{told}");
    assert!((told["time_s"].as_f64().unwrap() - time_s).abs() < 0.1, "{told}");
    let recovery_ms = told["recovery_ms"].as_f64().expect("a recovery");
    assert!((0.0..1000.0).contains(&recovery_ms), "{told}");
}

fn assert_comes_back(partition: &str) {
    let _turn = among_others();
    let ended = fly_small(&[format!("{partition}@40")]);
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    assert_tells_of(&summary, partition, 40.0);
    assert_eq!(summary["restarts"], 1);
    assert_eq!(summary["faults"].as_array().unwrap().len(), 1, "{}", summary["faults"]);
    let ended = ended.expect_code(0);
    let logged: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
    assert_eq!(logged.len(), 1, "{logged:?}");
    assert_eq!((logged[0].partition.as_str(), logged[0].recovered_ns.is_some()), (partition, true));
}

#[test]
fn killed_rate_generator_comes_back_and_the_flight_completes() {
    assert_comes_back("rate_generator");
}

#[test]
fn killed_hil_interface_comes_back_and_the_flight_completes() {
    assert_comes_back("hil_interface");
}

#[test]
fn killed_gps_comes_back_and_the_flight_completes() {
    assert_comes_back("gps");
}

#[test]
fn killed_imu_comes_back_and_the_flight_completes() {
    assert_comes_back("imu");
}

#[test]
fn killed_estimator_comes_back_and_the_flight_completes() {
    assert_comes_back("estimator");
}

#[test]
fn killed_controller_comes_back_and_the_flight_completes() {
    assert_comes_back("controller");
}

#[test]
fn killed_servo_comes_back_and_the_flight_completes() {
    assert_comes_back("servo");
}

#[test]
fn killed_onboard_computer_comes_back_and_the_flight_completes() {
    assert_comes_back("onboard_computer");
}

#[test]
fn killed_command_comes_back_and_the_flight_completes() {
    assert_comes_back("command");
}

fn each_in_turn() -> Vec<String> {
    NINE.iter().zip(0..).map(|(partition, place)| format!("{partition}@{}", 60 + 10 * place)).collect()
}

#[test]
fn all_nine_killed_one_after_the_other_come_back_and_the_flight_completes() {
    let _turn = among_others();
    let ended = fly(&each_in_turn()).expect_code(0);
    assert_completed(&ended);
    let summary = ended.summary();
    assert_eq!(summary["restarts"], 9);
    for (partition, place) in NINE.iter().zip(0..) {
        assert_tells_of(&summary, partition, f64::from(60 + 10 * place));
    }
}

#[test]
fn all_nine_killed_and_restarted_cold_are_armed_again_by_the_ground_and_the_flight_completes() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = folder.path().join("cold.toml");
    std::fs::write(&schedule, edited(&[("start = \"warm\"", "start = \"cold\"")])).unwrap();
    let ended = fly_schedule(&schedule, &[], &each_in_turn()).expect_code(0);
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    // A Controller that has forgotten all begins its laps anew: what counts are the last two.
    let waypoints = summary["waypoints"].as_array().unwrap();
    let last: Vec<&str> = waypoints[waypoints.len() - 9..].iter().filter_map(Value::as_str).collect();
    assert_eq!(last, TWO_LAPS);
    assert_eq!(summary["restarts"], 9);
    let faults = summary["faults"].as_array().unwrap();
    assert!(faults.iter().all(|fault| fault["action"] == "cold_restart"), "{faults:?}");
}

#[test]
fn estimator_killed_beyond_its_budget_is_idle_and_the_flight_fails_and_says_so() {
    let _turn = among_others();
    let kills: Vec<String> = (40..46).map(|second| format!("estimator@{second}")).collect();
    let ended = fly_small(&kills).expect_code(1);
    let summary = ended.summary();
    assert_eq!(summary["completed"], false);
    assert!(summary["failure"].as_str().is_some_and(|why| !why.is_empty()), "{}", summary["failure"]);
    assert_eq!(summary["restarts"], 5);
    let faults = ended.faults();
    assert_eq!(
        faults.last().map(|fault| (fault.partition.as_str(), fault.action.as_str())),
        Some(("estimator", "idle"))
    );
    let after_ns = 46_000_000_000;
    let windows = ended.windows();
    let granted = |name: &str| {
        windows
            .iter()
            .filter(|window| {
                window.partition == name && window.planned_start_ns > after_ns && window.granted_ns.is_some()
            })
            .count()
    };
    assert_eq!(granted("estimator"), 0, "an idle partition gets no windows");
    assert!(granted("controller") > 50, "the others go on");
    let report = std::fs::read_to_string(ended.folder().join("report.html")).unwrap();
    assert!(report.contains("idle") && report.contains("estimator"), "the report tells of it");
}

#[test]
fn onboard_computer_beyond_its_budget_is_idle_and_the_flight_completes_without_it() {
    let _turn = among_others();
    let kills: Vec<String> = (40..46).map(|second| format!("onboard_computer@{second}")).collect();
    let ended = fly_small(&kills);
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "nothing that flies depends on it: {}", summary["failure"]);
    let its_last = ended.faults().into_iter().rfind(|fault| fault.partition == "onboard_computer");
    assert_eq!(its_last.map(|fault| fault.action), Some("idle".into()));
}

#[test]
fn partition_beyond_its_budget_that_shall_stop_the_module_stops_it_with_code_1() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = "restart = { start = \"cold\", budget = 1, within = \"10s\", then = \"stop\" }";
    let schedule = Sketch::new()
        .partition("other", "counter", 500, "")
        .partition("victim", "counter", 500, keys)
        .write(folder.path());
    let text = std::fs::read_to_string(&schedule).unwrap();
    std::fs::write(&schedule, text + "\n[health.module]\npartition_stopped = \"shutdown\"\n").unwrap();
    let run = [
        "run",
        "--fast",
        "--schedule",
        &schedule,
        "--until",
        "20",
        "--kill",
        "victim@1",
        "--kill",
        "victim@2",
    ];
    let ended = bateleur(&run).end().expect_code(1).expect_words(&["victim"]);
    let actions: Vec<String> = ended.faults().into_iter().map(|fault| fault.action).collect();
    assert!(
        actions.ends_with(&["stop".into(), "shutdown".into()]),
        "the partition, then the module: {actions:?}"
    );
    let last_ns = ended.windows().last().unwrap().planned_start_ns;
    assert!(last_ns < 3_000_000_000, "the module went on to {last_ns} ns");
}

fn words_of_warm(start: &str) -> String {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = format!(
        "retained = \"4KiB\"\nrestart = {{ start = \"{start}\", budget = 5, within = \"10s\", then = \"idle\" }}"
    );
    let schedule = Sketch::new().partition("kept", "warm", 500, &keys).write(folder.path());
    let run = ["run", "--fast", "--schedule", &schedule, "--until", "3", "--kill", "kept@2"];
    bateleur(&run).end().expect_code(0).stderr
}

#[test]
fn retained_memory_is_there_after_a_warm_restart() {
    let said = words_of_warm("warm");
    assert!(said.contains("NormalStart found None"), "{said}");
    assert!(said.contains("HmPartitionWarmRestart found Some(100)"), "100 windows in 2 s:\n{said}");
}

#[test]
fn retained_memory_is_empty_after_a_cold_restart() {
    let said = words_of_warm("cold");
    assert!(said.contains("HmPartitionColdRestart found None"), "{said}");
}

#[test]
fn partition_killed_by_a_stranger_comes_back_too() {
    let _turn = among_others();
    let schedule = flight_schedule();
    let mut flight =
        bateleur(&["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()]);
    flight.await_words("1 of 9 way-points");
    let victim = bateleur_tests::process_named(executive_of(flight.pid()).pid, "controller");
    victim.signal(rustix::process::Signal::KILL);
    let ended = flight.end().expect_code(0);
    assert_completed(&ended);
    let summary = ended.summary();
    assert_eq!(summary["restarts"], 1);
    assert_eq!(summary["faults"][0]["partition"], "controller");
}

/// What is told of partitions' deaths and starts. That a machine which holds processes up makes windows late or too short is
/// nobody's fault in the module.
fn told(ended: &Ended) -> Vec<(String, String)> {
    let is_the_machines =
        |error: &str| ["late_dispatcher", "window_overrun", "processor_taken"].contains(&error);
    let faults = ended.faults().into_iter().filter(|fault| !is_the_machines(&fault.error));
    faults.map(|fault| (fault.error, fault.action)).collect()
}

fn all(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
    pairs.iter().map(|(error, action)| ((*error).to_owned(), (*action).to_owned())).collect()
}

#[test]
fn successor_that_dies_of_what_it_has_retained_is_started_from_nothing_and_the_partition_goes_on() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = "retained = \"4KiB\"\nattributes = { after = 20 }\n\
                restart = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }";
    let schedule = Sketch::new().partition("own", "poisoned", 500, keys).write(folder.path());
    let ended = bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(0);
    assert_eq!(told(&ended), all(&[("exit", "warm_restart"), ("startup_timeout", "cold_restart")]));
    let faults = ended.faults();
    assert!(faults[1].detail.contains("what it has retained is spoilt"), "{faults:?}");
    // A restart takes 20 ms of module time each, one that fails too.
    let (died_ns, failed_ns) = (faults[0].time_ns, faults[1].time_ns);
    assert!(failed_ns >= died_ns + 20_000_000, "{faults:?}");
    assert!(faults[1].recovered_ns.is_some_and(|back_ns| back_ns >= failed_ns + 20_000_000), "{faults:?}");
}

/// `victim` and `other`; the program of `victim` is a file of its own, which is given.
fn with_a_program_of_its_own(folder: &std::path::Path, budget: u32) -> (String, std::path::PathBuf) {
    let program = folder.join("victim");
    let keys =
        format!("restart = {{ start = \"cold\", budget = {budget}, within = \"60s\", then = \"idle\" }}");
    let sketch = Sketch::new().partition("victim", "counter", 500, &keys);
    let text = sketch.partition("other", "counter", 500, "").text();
    let counter = bateleur_tests::program("counter");
    std::fs::copy(&counter, &program).unwrap();
    let text = text.replacen(counter.to_str().unwrap(), program.to_str().unwrap(), 1);
    let schedule = folder.join("test.toml");
    std::fs::write(&schedule, text).unwrap();
    (schedule.to_str().unwrap().to_owned(), program)
}

#[test]
fn restart_that_the_machine_can_not_do_just_now_is_tried_again_until_it_can() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let (schedule, program) = with_a_program_of_its_own(folder.path(), 50);
    let mut run = bateleur(&["run", "--schedule", &schedule, "--until", "20", "--kill", "victim@2"]);
    run.await_words("2 partitions are ready");
    let away = folder.path().join("away");
    std::fs::rename(&program, &away).unwrap();
    run.await_words("victim: not_started");
    std::fs::rename(&away, &program).unwrap();
    run.await_words("victim: back after");
    run.signal(rustix::process::Signal::INT);
    let ended = run.end().expect_code(0);
    let told = told(&ended);
    assert_eq!(told[0], ("killed".into(), "cold_restart".into()));
    assert!(
        told.len() > 1
            && told[1..].iter().all(|(error, action)| error == "not_started" && action == "cold_restart")
    );
    let on_time = |window: &bateleur_tests::Window| window.partition == "victim" && !window.late;
    let last = ended.windows().into_iter().rfind(on_time).unwrap();
    assert!(last.granted_ns.is_some(), "{last:?}");
}

#[test]
fn restart_that_the_machine_can_never_do_uses_up_the_budget_and_then_the_module_is_told() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let (schedule, program) = with_a_program_of_its_own(folder.path(), 3);
    let mut run = bateleur(&["run", "--schedule", &schedule, "--until", "20", "--kill", "victim@2"]);
    run.await_words("2 partitions are ready");
    std::fs::remove_file(&program).unwrap();
    run.await_words("config_error");
    run.signal(rustix::process::Signal::INT);
    let ended = run.end().expect_code(0);
    let expected = [
        ("killed", "cold_restart"),
        ("not_started", "cold_restart"),
        ("not_started", "cold_restart"),
        ("not_started", "idle"),
        ("config_error", "ignore"),
    ];
    assert_eq!(told(&ended), all(&expected));
    let faults = ended.faults();
    let why = &faults.iter().find(|fault| fault.error == "not_started").unwrap().detail;
    assert!(why.contains(program.to_str().unwrap()) && why.contains("No such file"), "{why}");
    // Where the machine held the dispatcher up, nobody in the module is to blame.
    let had = |window: &bateleur_tests::Window| window.granted_ns.is_some() || window.late;
    assert!(ended.windows().iter().all(|window| window.partition != "other" || had(window)));
}

#[test]
fn exit_code_of_a_partition_without_an_error_handler_asks_for_nothing() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    for code in ["66", "70", "71"] {
        let keys = format!("attributes = {{ how = \"{code}\", after = 10 }}");
        let schedule = Sketch::new().partition("victim", "crasher", 500, &keys).write(folder.path());
        let ended =
            bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "0.4"]).end().expect_code(0);
        let faults = ended.faults();
        let first = faults.first().unwrap_or_else(|| panic!("no fault:\n{}", ended.stderr));
        assert_eq!((first.error.as_str(), first.action.as_str()), ("exit", "cold_restart"), "{first:?}");
        assert!(first.detail.contains(code), "{first:?}");
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_whose_log_has_lost_its_folder_comes_back_without_a_log_and_that_is_said_once() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("victim", "counter", 500, "").write(folder.path());
        let kills = ["--kill", "victim@2", "--kill", "victim@3"];
        let run = ["run", "--schedule", &schedule, "--until", "5"];
        let mut run = bateleur(&[&run[..], &kills].concat());
        run.await_words("1 partition is ready");
        std::fs::remove_dir_all(run.folder().join("partitions")).unwrap();
        let ended = run.end().expect_code(1);
        assert_eq!(told(&ended), all(&[("killed", "cold_restart"), ("killed", "cold_restart")]));
        let is_back =
            |fault: &bateleur_tests::Fault| fault.action == "ignore" || fault.recovered_ns.is_some();
        assert!(ended.faults().iter().all(is_back), "{}", ended.stderr);
        let words = "partitions/victim.log can not be written any more: No such file or directory";
        assert_eq!(ended.stderr.matches(words).count(), 1, "{}", ended.stderr);
    }
}
