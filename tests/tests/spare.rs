//! Partitions behind which a spare waits: the next process, which has not begun. Killed, they come back as without one, only sooner.

use std::time::Duration;

use bateleur_tests::{
    Ended, NINE, Sketch, Traces, alone, among_others, await_some, bateleur, children_of, edited, executive_of,
};
use rustix::process::Signal;
use serde_json::Value;

const KEPT: &str = "retained = \"4KiB\"\n\
                    restart = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }\n";
const SPARE: &str = "standby = \"spare\"\n";

/// Runs `kept`, which counts its windows in retained memory, and what `more` says.
fn run(keys: &str, more: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new()
        .partition("kept", "warm", 500, keys)
        .partition("other", "counter", 500, "")
        .write(folder.path());
    bateleur(&[&["run", "--schedule", &schedule][..], more].concat()).end().expect_code(0)
}

fn actions(ended: &Ended) -> Vec<String> {
    ended.faults().into_iter().map(|fault| fault.action).collect()
}

/// What module time decides of a run: windows, faults and what was said, a line each.
fn fates(ended: &Ended) -> Vec<String> {
    let window = |window: bateleur_tests::Window| {
        format!("{} at {}: {:?}", window.partition, window.planned_start_ns, window.granted_ns)
    };
    let fault = |fault: bateleur_tests::Fault| {
        let recovered = fault.recovered_ns;
        format!("{} of {} at {}: {recovered:?}", fault.action, fault.generation, fault.time_ns)
    };
    let said = ended.stderr.lines().filter(|line| line.contains("found ")).map(str::to_owned);
    let windows = ended.windows().into_iter().map(window);
    windows.chain(ended.faults().into_iter().map(fault)).chain(said).collect()
}

#[test]
fn on_the_virtual_clock_deaths_have_the_same_consequences_with_a_spare_as_without() {
    let _turn = among_others();
    for start in ["warm", "cold"] {
        let keys = KEPT.replace("warm", start);
        let faults = [
            "--fast",
            "--until",
            "5",
            "--kill",
            "kept@1",
            "--kill",
            "kept@1.06",
            "--inject",
            "kept:null-write@2",
            "--inject",
            "kept:panic@3",
            "--stop",
            "kept@4",
            "--start",
            "kept@4.2",
            "--kill",
            "kept@4.5",
        ];
        let with = run(&format!("{SPARE}{keys}"), &faults);
        assert!(fates(&with) == fates(&run(&keys, &faults)), "{start}: {}", with.stderr);
        assert_eq!(with.faults().len(), 5, "{:?}", with.faults());
        let found = if start == "warm" {
            "HmPartitionWarmRestart found Some(50)"
        } else {
            "HmPartitionColdRestart found None"
        };
        assert!(with.stderr.contains(found), "{}", with.stderr);
    }
}

#[test]
fn spare_that_dies_alone_is_replaced_and_its_partition_notices_nothing() {
    let _turn = among_others();
    let kills = ["--fast", "--until", "3", "--kill", "kept.standby@1", "--kill", "kept@2"];
    let ended = run(&format!("{SPARE}{KEPT}"), &kills);
    assert_eq!(actions(&ended), ["new_standby", "warm_restart"]);
    assert!(ended.stderr.contains("its spare ended by SIGKILL, and is replaced"), "{}", ended.stderr);
}

#[test]
fn partition_killed_together_with_its_spare_is_started_anew() {
    let _turn = among_others();
    let kills =
        ["--fast", "--until", "3", "--kill", "kept.standby@1", "--kill", "kept@1", "--kill", "kept@2"];
    let ended = run(&format!("{SPARE}{KEPT}"), &kills);
    assert_eq!(actions(&ended), ["new_standby", "warm_restart", "warm_restart"]);
    assert!(ended.faults().iter().skip(1).all(|fault| fault.recovered_ns.is_some()), "{:?}", ended.faults());
}

#[test]
fn partition_of_several_processes_has_a_spare() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new()
        .partition("own", "processes", 2000, &format!("threads = 3\n{SPARE}"))
        .write(folder.path());
    let run = |kills: &[&str]| {
        bateleur(&[&["run", "--schedule", &schedule, "--fast", "--until", "2"][..], kills].concat())
            .end()
            .expect_code(0)
    };
    let ended = run(&["--kill", "own@1"]);
    assert_eq!(actions(&ended), ["cold_restart"], "{}", ended.stderr);
    assert!(ended.faults()[0].recovered_ns.is_some(), "{}", ended.stderr);
}

/// The flight's schedule with a spare behind each of the nine.
fn spare_flight(folder: &std::path::Path) -> String {
    let keys = NINE.map(|name| {
        let key = format!("[partition.{name}]\n");
        (key.clone(), format!("{key}{SPARE}"))
    });
    let changes: Vec<(&str, &str)> = keys.iter().map(|(old, new)| (old.as_str(), new.as_str())).collect();
    let path = folder.join("spare.toml");
    std::fs::write(&path, edited(&changes)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn flight_with_spares_behind_all_is_the_same_to_the_bit_whoever_is_killed() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let spare = spare_flight(folder.path());
    let plain = bateleur_tests::flight_schedule();
    let kills: Vec<String> =
        (0..).zip(NINE).map(|(number, name)| format!("{name}@{}.{number}", 30 + 15 * number)).collect();
    let fly = |schedule: &str| {
        let mut arguments = vec!["fly", "--fast", "--seed", "7", "--format", "json", "--schedule", schedule];
        kills.iter().for_each(|kill| arguments.extend(["--kill", kill]));
        bateleur(&arguments).end().expect_code(0).summary()
    };
    let (with, without) = (fly(&spare), fly(plain.to_str().unwrap()));
    assert_eq!((&with["completed"], &with["restarts"]), (&Value::from(true), &Value::from(9)));
    assert_eq!(with["digest"], without["digest"]);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn on_the_wall_clock_the_very_process_that_waited_has_the_windows_after_each_kill() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule =
            Sketch::new().partition("kept", "warm", 500, &format!("{SPARE}{KEPT}")).write(folder.path());
        let mut running = bateleur(&["run", "--schedule", &schedule, "--until", "8"]);
        running.await_words("1 partition is ready");
        for kill in 1..=4 {
            std::thread::sleep(Duration::from_millis(700));
            let find =
                |name: &str| children_of(running.pid()).into_iter().find(|process| process.name == name);
            let spare = await_some(Duration::from_secs(10), || find("+kept")).expect("a spare");
            // It has come to where it waits: whoever is killed before that is started anew.
            std::thread::sleep(Duration::from_millis(300));
            find("kept").expect("the partition").signal(Signal::KILL);
            let risen = await_some(Duration::from_secs(10), || {
                spare.again().filter(|process| process.name == "kept")
            });
            assert!(risen.is_some(), "restart {kill}");
        }
        let ended = running.end().expect_code(0);
        let faults: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
        assert_eq!(faults.len(), 4, "{faults:?}");
        for (number, fault) in faults.iter().enumerate() {
            assert_eq!(
                (fault.action.as_str(), fault.generation),
                ("warm_restart", number as u64),
                "{fault:?}"
            );
            assert!(fault.recovered_ns.is_some(), "{fault:?}");
        }
        let counts: Vec<u64> = ended
            .stderr
            .lines()
            .filter_map(|line| {
                line.split_once("HmPartitionWarmRestart found Some(")?.1.split(')').next()?.parse().ok()
            })
            .collect();
        assert!(
            counts.len() == 4 && counts.is_sorted() && counts[0] > 20,
            "each has found what was kept: {counts:?}"
        );
    }

    #[test]
    fn nine_with_spares_come_back_from_kills_at_random_on_the_wall_clock_and_nothing_is_left() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = spare_flight(folder.path());
        for isolation in ["shared", "sealed"] {
            let text = std::fs::read_to_string(&schedule).unwrap();
            let path = folder.path().join(format!("{isolation}.toml"));
            std::fs::write(&path, format!("isolation = \"{isolation}\"\n{text}")).unwrap();
            let set = "command.device=/dev/nowhere";
            let mut running = bateleur(&[
                "run",
                "--record",
                "--until",
                "14",
                "--set",
                set,
                "--schedule",
                path.to_str().unwrap(),
            ]);
            running.await_words("9 partitions are ready");
            let executive = executive_of(running.pid());
            let traces = Traces::of(executive.pid);
            let mut kills = Vec::new();
            for (number, name) in (0..).zip(NINE) {
                std::thread::sleep(Duration::from_millis(500 + 37 * number));
                if let Some(process) =
                    children_of(executive.pid).into_iter().find(|process| process.name == name)
                {
                    process.signal(Signal::KILL);
                    kills.push(name);
                }
            }
            let ended = running.end().expect_code(0);
            traces.expect_gone();
            let windows = ended.windows();
            for partition in NINE {
                let last = windows.iter().filter(|window| {
                    window.partition == partition && window.planned_start_ns >= 13_000_000_000
                });
                let closed = last.filter(|window| window.closed_ns.is_some()).count();
                assert!(
                    closed > 40,
                    "{isolation}: {partition} has closed {closed} of its last second: {}",
                    ended.stderr
                );
            }
            let restarts: Vec<_> =
                ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
            assert!(restarts.len() >= 7 && kills.len() >= 7, "{isolation}: {kills:?} {restarts:?}");
            assert!(restarts.iter().all(|fault| fault.recovered_ns.is_some()), "{isolation}: {restarts:?}");
            assert!(!ended.stderr.contains("made anew"), "{isolation}: {}", ended.stderr);
        }
    }

    #[test]
    fn module_with_spares_outlives_its_executive() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let health = "[health.module]\nexecutive_died = \"reset\"\nexecutive_hung = \"reset\"\n";
        let schedule = Sketch::new()
            .table(health)
            .partition("kept", "warm", 500, &format!("{SPARE}{KEPT}"))
            .write(folder.path());
        let mut running = bateleur(&["run", "--schedule", &schedule, "--until", "6"]);
        running.await_words("1 partition is ready");
        std::thread::sleep(Duration::from_secs(1));
        let executive = executive_of(running.pid());
        let traces = Traces::of(executive.pid);
        executive.signal(Signal::KILL);
        running.await_words("frame 0 again");
        traces.expect_gone();
        std::thread::sleep(Duration::from_secs(1));
        let find = |name: &str| {
            children_of(executive_of(running.pid()).pid).into_iter().find(|process| process.name == name)
        };
        find("+kept").expect("the next executive has started a spare");
        find("kept").expect("the partition").signal(Signal::KILL);
        let ended = running.end().expect_code(0);
        let killed: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
        assert_eq!(killed.len(), 1, "{killed:?}");
        assert!(killed[0].recovered_ns.is_some(), "{killed:?}");
    }
}
