//! Partitions behind which a second process stands by: killed, they have their next window all the same.

use bateleur_tests::{
    Ended, Sketch, TWO_LAPS, Window, alone, among_others, await_some, bateleur, children_of, edited,
};
use serde_json::Value;

const KEPT: &str = "standby = \"hot\"\nretained = \"4KiB\"\n\
                    restart = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }\n";

/// Runs `kept`, which counts its windows in retained memory, with a standby, and what `more` says.
fn run(keys: &str, more: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new()
        .partition("kept", "warm", 500, keys)
        .partition("other", "counter", 500, "")
        .write(folder.path());
    bateleur(&[&["run", "--schedule", &schedule][..], more].concat()).end().expect_code(0)
}

fn windows_of(ended: &Ended, partition: &str) -> Vec<Window> {
    ended.windows().into_iter().filter(|window| window.partition == partition).collect()
}

fn actions(ended: &Ended) -> Vec<String> {
    ended.faults().into_iter().map(|fault| fault.action).collect()
}

/// Windows of `kept` that were not granted.
fn missed(ended: &Ended) -> usize {
    windows_of(ended, "kept").iter().filter(|window| window.granted_ns.is_none()).count()
}

#[test]
fn partition_killed_between_windows_twice_five_seconds_apart_loses_none() {
    let _turn = among_others();
    let ended = run(KEPT, &["--fast", "--until", "8", "--kill", "kept@1", "--kill", "kept@6"]);
    assert_eq!(actions(&ended), ["takeover", "takeover"]);
    assert_eq!(missed(&ended), 0);
    for count in ["took over Some(50)", "took over Some(300)"] {
        assert!(ended.stderr.contains(count), "{count}: {}", ended.stderr);
    }
}

#[test]
fn partition_killed_together_with_its_standby_is_started_anew_and_gets_another_standby() {
    let _turn = among_others();
    let kills = ["--kill", "kept.standby@1", "--kill", "kept@1", "--kill", "kept@2"];
    let ended = run(KEPT, &[&["--fast", "--until", "3"][..], &kills].concat());
    assert_eq!(actions(&ended), ["new_standby", "warm_restart", "takeover"]);
    assert_eq!(missed(&ended), 1, "what the ordinary restart takes");
    assert!(ended.stderr.contains("HmPartitionWarmRestart found Some(50)"), "{}", ended.stderr);
}

#[test]
fn partition_killed_while_no_standby_is_ready_is_started_anew() {
    let _turn = among_others();
    let ended = run(KEPT, &["--fast", "--until", "3", "--kill", "kept@1", "--kill", "kept@1.02"]);
    assert_eq!(actions(&ended), ["takeover", "warm_restart"]);
    assert!(ended.faults().iter().all(|fault| fault.recovered_ns.is_some()));
}

#[test]
fn cold_partition_whose_standby_takes_over_finds_nothing_kept() {
    let _turn = among_others();
    let keys = KEPT.replace("warm", "cold");
    let ended = run(&keys, &["--fast", "--until", "3", "--kill", "kept@1"]);
    assert_eq!((actions(&ended), missed(&ended)), (vec!["takeover".to_owned()], 0));
    assert!(ended.stderr.contains("HmPartitionColdRestart took over None"), "{}", ended.stderr);
}

#[test]
fn standby_that_dies_alone_is_replaced_and_its_partition_notices_nothing() {
    let _turn = among_others();
    let ended = run(KEPT, &["--fast", "--until", "3", "--kill", "kept.standby@1", "--kill", "kept@2"]);
    assert_eq!(actions(&ended), ["new_standby", "takeover"]);
    // The persistent log has it too.
    let kept = bateleur(&["health", ended.folder().to_str().unwrap()]).end().expect_code(0);
    assert!(kept.stdout.contains("new_standby") && kept.stdout.contains("takeover"), "{}", kept.stdout);
    assert!(windows_of(&ended, "kept").iter().all(|window| window.closed_ns.is_some()));
}

#[test]
fn same_takeovers_give_the_same_windows() {
    let _turn = among_others();
    let fates = || {
        let ended = run(
            KEPT,
            &[
                "--fast",
                "--until",
                "4",
                "--inject",
                "kept:null-write@1",
                "--kill",
                "kept@1.06",
                "--kill",
                "kept@3",
            ],
        );
        let granted: Vec<_> =
            ended.windows().iter().map(|window| (window.planned_start_ns, window.granted_ns)).collect();
        let faults: Vec<_> = ended
            .faults()
            .iter()
            .map(|fault| (fault.time_ns, fault.action.clone(), fault.recovered_ns))
            .collect();
        (granted, faults)
    };
    assert_eq!(fates(), fates());
}

/// The flight's schedule with hot standby behind the Estimator and the Controller.
fn hot_flight() -> String {
    let key = |name: &str| format!("[partition.{name}]\nprogram    = \"{name}\"\n");
    let (estimator, controller) = (key("estimator"), key("controller"));
    let with = |key: &str| format!("{key}standby    = \"hot\"\n");
    edited(&[(&estimator, &with(&estimator)), (&controller, &with(&controller))])
}

#[test]
fn flight_whose_estimator_and_controller_are_killed_in_turn_loses_no_window_and_completes() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = folder.path().join("hot.toml");
    std::fs::write(&schedule, hot_flight()).unwrap();
    let fly = || {
        let kills = [60, 80, 100]
            .map(|second| [format!("estimator@{second}"), format!("controller@{}", second + 10)]);
        let mut arguments = vec![
            "fly",
            "--fast",
            "--seed",
            "7",
            "--format",
            "json",
            "--schedule",
            schedule.to_str().unwrap(),
        ];
        kills.iter().flatten().for_each(|kill| arguments.extend(["--kill", kill]));
        bateleur(&arguments).end().expect_code(0)
    };
    let ended = fly();
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
    assert_eq!(ended.faults().iter().filter(|fault| fault.action == "takeover").count(), 6);
    assert_eq!(summary["restarts"], 6);
    for partition in ["estimator", "controller"] {
        assert!(windows_of(&ended, partition).iter().all(|window| window.closed_ns.is_some()), "{partition}");
    }
    assert_eq!(summary["digest"], fly().summary()["digest"], "the same seed, the same flight");
}

#[test]
fn standby_that_was_given_up_stands_by_again_when_the_operator_starts_the_partition_anew() {
    let _turn = among_others();
    let keys = KEPT.replace("budget = 5", "budget = 1").replace("10s", "60s");
    let lose = ["--kill", "kept.standby@1", "--kill", "kept.standby@2"];
    let anew = ["--stop", "kept@3", "--start", "kept@4", "--kill", "kept@5"];
    let ended = run(&keys, &[&["--fast", "--until", "6"][..], &lose, &anew].concat());
    assert_eq!(actions(&ended), ["new_standby", "ignore", "takeover"], "{}", ended.stderr);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_that_dies_in_its_window_loses_that_one_alone() {
        let _turn = among_others();
        let ended = run(KEPT, &["--fast", "--until", "3", "--inject", "kept:panic@1"]);
        let windows = windows_of(&ended, "kept");
        let died = windows.iter().position(Window::is_overrun).unwrap();
        assert_eq!(windows[died].planned_start_ns / 1_000_000, 1_000);
        assert!(windows.iter().all(|window| window.granted_ns.is_some()));
        assert_eq!(windows.iter().filter(|window| window.closed_ns.is_none()).count(), 1);
        let faults = ended.faults();
        assert_eq!((faults.len(), faults[0].action.as_str()), (1, "takeover"), "{faults:?}");
        assert_eq!(faults[0].recovered_ns, Some(windows[died + 1].planned_start_ns));
        // Fifty windows were closed before, and the successor knows of each.
        assert!(ended.stderr.contains("HmPartitionWarmRestart took over Some(50)"), "{}", ended.stderr);
        assert!(windows_of(&ended, "other").iter().all(|window| window.closed_ns.is_some()));
    }

    #[test]
    fn order_and_death_in_the_log_are_of_one_incarnation() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("kept", "warm", 500, KEPT).write(folder.path());
        let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "60"]);
        module.await_words("1 partition is ready");
        let pid = module.pid().to_string();
        for (number, target) in ["kept", "kept", "kept.standby"].into_iter().enumerate() {
            let standby_is_ready = || {
                let said =
                    bateleur(&["ps", "--format", "json", "--module", &pid]).end().expect_code(0).stdout;
                said.contains("\"standby\": \"ready\"").then_some(())
            };
            await_some(std::time::Duration::from_secs(20), standby_is_ready).expect("a standby");
            bateleur(&["kill", target, "--module", &pid]).end().expect_code(0);
            let deaths = || {
                let log = std::fs::read_to_string(module.folder().join("health.jsonl")).unwrap_or_default();
                (log.matches("ended by SIGKILL").count() > number).then_some(())
            };
            await_some(std::time::Duration::from_secs(20), deaths).expect("its death");
        }
        module.signal(rustix::process::Signal::TERM);
        let ended = module.end().expect_code(0);
        let log = std::fs::read_to_string(ended.folder().join("health.jsonl")).unwrap();
        let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let of = |error: &str| -> Vec<(u64, u64)> {
            let these = lines.iter().filter(|line| line["error"] == error);
            these
                .map(|line| (line["time_ns"].as_u64().unwrap(), line["generation"].as_u64().unwrap()))
                .collect()
        };
        assert_eq!(of("order").len(), 3, "{log}");
        assert_eq!(of("order"), of("killed"), "{log}");
    }

    #[test]
    fn partition_killed_from_outside_on_the_wall_clock_misses_two_windows_at_most_each_time() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("kept", "warm", 500, KEPT).write(folder.path());
        let mut running = bateleur(&["run", "--schedule", &schedule, "--until", "8"]);
        running.await_words("1 partition is ready");
        for kill in 1..=3 {
            std::thread::sleep(std::time::Duration::from_millis(1_500));
            let find =
                |name: &str| children_of(running.pid()).into_iter().find(|process| process.name == name);
            let sleeper = await_some(std::time::Duration::from_secs(5), || find("+kept")).expect("a standby");
            find("kept").expect("the partition").signal(rustix::process::Signal::KILL);
            // The very process that stood by has the office now.
            let risen = await_some(std::time::Duration::from_secs(5), || {
                sleeper.again().filter(|process| process.name == "kept")
            });
            assert!(risen.is_some(), "takeover {kill}");
        }
        let ended = running.end().expect_code(0);
        let faults: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
        assert_eq!(faults.len(), 3, "{faults:?}");
        let windows = windows_of(&ended, "kept");
        for fault in &faults {
            assert_eq!(fault.action, "takeover", "{fault:?}");
            let back_ns = fault.recovered_ns.expect("the successor's first window");
            // Windows that the machine itself lost are not the takeover's.
            let gone = windows.iter().filter(|window| {
                let after = window.planned_start_ns > fault.time_ns && window.planned_start_ns < back_ns;
                after && window.granted_ns.is_none() && !window.flags.contains('M')
            });
            assert!(gone.count() <= 1, "{fault:?}");
        }
    }
}
