//! Executives that die or hang while their module runs, where the plan has them started again.

use std::time::Duration;

use bateleur_tests::{
    Ended, Fault, Process, Sketch, Started, Traces, alone, among_others, bateleur, children_of, executive_of,
    flight_schedule, is_long, small_mission,
};
use rustix::process::Signal;

/// Two partitions that count their windows in retained memory, and a module that starts again `budget` times.
fn schedule(folder: &std::path::Path, budget: u32) -> String {
    let health = format!(
        "[health]\nreset = {{ budget = {budget}, within = \"60s\" }}\n\
         [health.module]\nexecutive_died = \"reset\"\nexecutive_hung = \"reset\"\n"
    );
    let keys = "retained = \"4KiB\"\nrestart = { start = \"warm\", budget = 9, within = \"10s\", then = \"idle\" }\n";
    let sketch = Sketch::new().table(&health).partition("first", "warm", 1000, keys);
    sketch.partition("second", "warm", 1000, keys).write(folder)
}

fn started(schedule: &str, options: &[&str]) -> Started {
    bateleur(&[&["run", "--schedule", schedule][..], options].concat())
}

/// Waits until frames have begun `count` times after a reset.
fn await_frames(run: &mut Started, count: usize) {
    let begun = bateleur_tests::await_some(Duration::from_secs(60), || {
        (run.said().matches("frame 0 again").count() >= count || run.has_ended()).then_some(())
    });
    assert!(begun.is_some() && !run.has_ended(), "frames did not begin again:\n{}", run.said());
}

fn of_executive(ended: &Ended) -> Vec<Fault> {
    ended.faults().into_iter().filter(|fault| fault.error.starts_with("executive_")).collect()
}

/// A SplitMix64 number.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed ^ (mixed >> 27)
}

/// Flown twice with the same faults at the same random instants.
#[test]
fn flight_on_the_virtual_clock_outlives_executives_that_end_at_any_instant_and_is_the_same_flight_again() {
    let _turn = among_others();
    let small = small_mission();
    // Deaths before the end of the mission, ms.
    let (mission, until_ms) = match is_long() {
        true => (vec![], 190_000),
        false => (vec!["--mission", small.to_str().unwrap()], 65_000),
    };
    let mut seed = 77;
    for ways in [["sigkill", "sigsegv"], ["sigstop", "sigkill"], ["sigabrt", "sigbus"]] {
        let at = |seed: &mut u64| random(seed) % until_ms;
        let aimed = ways.map(|way| format!("executive:{way}@{}", at(&mut seed) as f64 / 1e3));
        let partition = format!("estimator@{}", at(&mut seed) as f64 / 1e3);
        let schedule = flight_schedule();
        let arguments = ["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
        let faults = ["--inject", &aimed[0], "--inject", &aimed[1], "--kill", &partition];
        let flown =
            [(); 2].map(|()| bateleur(&[&arguments[..], &mission, &faults].concat()).end().expect_code(0));
        let [first, second] = flown.each_ref().map(Ended::summary);
        assert_eq!(first["digest"], second["digest"], "{faults:?}");
        assert_eq!(
            (&first["completed"], &first["windows"]),
            (&true.into(), &second["windows"]),
            "{faults:?}"
        );
        let [first, second] = flown.each_ref().map(of_executive);
        assert_eq!(first, second, "{faults:?}");
        let hung = ways.iter().filter(|way| **way == "sigstop").count();
        assert_eq!(first.len(), 2, "{faults:?}: {first:?}");
        assert_eq!(first.iter().filter(|fault| fault.error == "executive_hung").count(), hung, "{first:?}");
        let killed = flown[0].faults().into_iter().filter(|fault| fault.error == "killed").count();
        assert_eq!(killed, 1, "what an earlier executive has done is not done again: {faults:?}");
    }
}

/// Waits for a supervisor that the executive has started.
fn supervisor_below(executive: &Process, not: &[i32]) -> Process {
    let found = bateleur_tests::await_some(Duration::from_secs(20), || {
        let children = children_of(executive.pid).into_iter();
        children.into_iter().find(|child| child.name == "supervisor" && !not.contains(&child.pid))
    });
    found.unwrap_or_else(|| panic!("no supervisor below {executive:?}"))
}

fn process(pid: i32) -> Process {
    Process::read(pid).unwrap_or_else(|| panic!("process {pid} has ended"))
}

#[test]
fn flight_on_sealed_channels_outlives_its_executives_as_one_on_shared_channels_does() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(flight_schedule()).unwrap();
    let mut seed = 19;
    let faults: Vec<String> = ["sigkill", "sigstop"]
        .map(|way| format!("executive:{way}@{}", (random(&mut seed) % 190_000) as f64 / 1e3))
        .into();
    let flown = ["shared", "sealed", "checked"].map(|isolation| {
        let schedule = scratch.path().join(format!("{isolation}.toml"));
        std::fs::write(&schedule, format!("isolation = \"{isolation}\"\n{text}")).unwrap();
        let mut arguments =
            vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
        faults.iter().for_each(|fault| arguments.extend(["--inject", fault]));
        bateleur(&arguments).end().expect_code(0)
    });
    for ended in &flown {
        assert_eq!(of_executive(ended).len(), 2, "{faults:?}: {:?}", ended.faults());
        assert_eq!(ended.summary()["completed"], true, "{faults:?}: {}", ended.stderr);
        assert_eq!(ended.summary()["digest"], flown[0].summary()["digest"], "{faults:?}");
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn executive_that_is_stopped_is_left_alone_where_the_plan_ignores_that() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let path = schedule(scratch.path(), 3);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("executive_hung = \"reset\"", "executive_hung = \"ignore\""))
            .unwrap();
        let mut run = started(&path, &["--until", "3"]);
        run.await_words("2 partitions are ready");
        let executive = executive_of(run.pid());
        executive.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(800));
        executive.signal(Signal::CONT);
        let ended = run.end_within(Duration::from_secs(60)).expect_code(0);
        assert!(of_executive(&ended).is_empty(), "{:?}", ended.faults());
    }

    #[test]
    fn module_goes_on_after_its_executive_was_killed_or_stopped_at_any_instant() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let schedule = schedule(scratch.path(), 20);
        let mut run = started(&schedule, &["--until", "12", "--kill", "first@0.4"]);
        run.await_words("2 partitions are ready");
        let (mut seed, mut traces) = (7, Vec::new());
        let ways = [Signal::KILL, Signal::ABORT, Signal::STOP, Signal::KILL, Signal::FPE];
        for (number, signal) in ways.into_iter().enumerate() {
            std::thread::sleep(Duration::from_millis(if number == 0 {
                900
            } else {
                random(&mut seed) % 400
            }));
            let executive = executive_of(run.pid());
            traces.push(Traces::of(executive.pid));
            executive.signal(signal);
            await_frames(&mut run, number + 1);
        }
        let ended = run.end_within(Duration::from_secs(60)).expect_code(0);
        traces.iter().for_each(Traces::expect_gone);
        let faults = of_executive(&ended);
        let errors: Vec<&str> = faults.iter().map(|fault| fault.error.as_str()).collect();
        let (died, hung) = ("executive_died", "executive_hung");
        assert_eq!(errors, [died, died, hung, died, died], "{faults:?}");
        for (number, fault) in faults.iter().enumerate() {
            assert_eq!((fault.action.as_str(), fault.generation), ("reset", number as u64), "{fault:?}");
            assert!(fault.recovered_ns.is_some_and(|recovered_ns| recovered_ns > fault.time_ns), "{fault:?}");
        }
        let kills = ended.faults().into_iter().filter(|fault| fault.error == "killed").count();
        assert_eq!(kills, 1, "what an earlier executive has done is not done again");
        let windows = ended.windows();
        assert!(
            windows.windows(2).all(|pair| pair[0].planned_start_ns <= pair[1].planned_start_ns),
            "time goes on"
        );
        assert!(windows.last().unwrap().planned_start_ns > 11_000_000_000, "until its end");
        // What an executive had not handed to the disk when it died is lost: a few windows.
        assert!(
            windows[0].planned_start_ns < 100_000_000 && windows.len() > 800,
            "{} windows",
            windows.len()
        );
        let begins = windows.windows(2).filter(|pair| pair[1].frame < pair[0].frame).count();
        assert!((3..=5).contains(&begins), "frames begin with 0 each time: {begins}");
        let found: Vec<u64> = ended
            .stderr
            .lines()
            .filter_map(|line| {
                line.split_once("second: HmPartitionWarmRestart found Some(")?.1.split(')').next()
            })
            .map(|count| count.parse().unwrap())
            .collect();
        assert_eq!(found.len(), 5, "{}", ended.stderr);
        assert!(found[0] > 20 && found.is_sorted(), "retained memory outlives the executive: {found:?}");
    }

    #[test]
    fn executive_that_an_operator_has_provoked_answers_him_first() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let mut run = started(&schedule(scratch.path(), 9), &["--until", "30"]);
        run.await_words("2 partitions are ready");
        let ways = [
            ("executive", "sigkill"),
            ("executive", "sigsegv"),
            ("monitor", "stall=5s"),
            ("executive", "sigstop"),
        ];
        for (number, (target, fault)) in ways.into_iter().enumerate() {
            std::thread::sleep(Duration::from_millis(300));
            let module = executive_of(run.pid()).pid.to_string();
            let answer = bateleur(&["inject", target, fault, "--module", &module]).end();
            assert_eq!(answer.code, Some(0), "{target} {fault}: {}", answer.stderr);
            await_frames(&mut run, number + 1);
        }
        run.signal(Signal::INT);
        let errors: Vec<_> = of_executive(&run.end()).into_iter().map(|fault| fault.error).collect();
        let (died, hung) = ("executive_died", "executive_hung");
        assert_eq!(errors, [died, died, hung, hung]);
    }

    #[test]
    fn executive_whose_dispatcher_hangs_is_ended_and_another_one_goes_on() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let run =
            started(&schedule(scratch.path(), 3), &["--until", "4", "--inject", "dispatcher:stall=9s@1"]);
        let ended = run.end_within(Duration::from_secs(60)).expect_code(0);
        let faults = of_executive(&ended);
        assert!(
            matches!(&faults[..], [fault] if fault.error == "executive_hung" && fault.action == "reset"),
            "{faults:?}"
        );
        assert!(faults[0].detail.contains("no sign of life"), "{faults:?}");
    }

    #[test]
    fn budget_of_resets_bounds_how_often_an_executive_is_started_again() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let mut run = started(&schedule(scratch.path(), 1), &["--until", "30"]);
        run.await_words("2 partitions are ready");
        let first = executive_of(run.pid());
        first.signal(Signal::KILL);
        await_frames(&mut run, 1);
        let second = executive_of(run.pid());
        let traces = Traces::of(second.pid);
        second.signal(Signal::KILL);
        run.end().expect_code(1).expect_words(&["executive_died: ended by signal 9; the module ends"]);
        traces.expect_gone();
    }

    #[test]
    fn supervised_module_ends_as_it_is_asked_to_also_while_an_executive_follows_a_dead_one() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let schedule = schedule(scratch.path(), 3);
        for dies_before in [false, true] {
            let mut run = started(&schedule, &[]);
            run.await_words("2 partitions are ready");
            let executive = executive_of(run.pid());
            let traces = Traces::of(executive.pid);
            if dies_before {
                executive.signal(Signal::KILL);
                run.await_words("executive_died");
            }
            run.signal(Signal::TERM);
            let ended = run.end().expect_words(&["it was asked to stop"]);
            // Whether another one was there already is a matter of luck.
            assert!(ended.code == Some(0) || dies_before && ended.code == Some(1), "{ended:?}");
            traces.expect_gone();
        }
    }

    #[test]
    fn supervisor_that_is_killed_is_followed_and_the_module_outlives_supervisors_and_executives_by_turns() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let mut seed = 19;
        let mut run = started(&schedule(scratch.path(), 9), &["--until", "6"]);
        run.await_words("2 partitions are ready");
        let mut executive = executive_of(run.pid());
        let mut traces = vec![Traces::of(run.pid())];
        let mut supervisors = vec![run.pid()];
        for turn in 1..=3 {
            std::thread::sleep(Duration::from_micros(random(&mut seed) % 300_000));
            process(*supervisors.last().unwrap()).signal(Signal::KILL);
            let supervisor = supervisor_below(&executive, &supervisors);
            supervisors.push(supervisor.pid);
            std::thread::sleep(Duration::from_micros(random(&mut seed) % 300_000));
            executive.signal(Signal::KILL);
            let begun = bateleur_tests::await_some(Duration::from_secs(20), || {
                (run.said().matches("frame 0 again").count() >= turn).then_some(())
            });
            assert!(begun.is_some(), "turn {turn}: {}", run.said());
            executive = executive_of(supervisor.pid);
            traces.push(Traces::of(supervisor.pid));
        }
        let ended = bateleur_tests::await_some(Duration::from_secs(20), || {
            run.said().contains("stopped after 6.0").then_some(())
        });
        assert!(ended.is_some(), "{}", run.said());
        traces.iter().for_each(Traces::expect_gone);
        let ended = run.end();
        let faults = of_executive(&ended);
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(faults.iter().all(|fault| fault.error == "executive_died" && fault.action == "reset"));
        for partition in ["first", "second"] {
            let warm = ended.faults().into_iter().filter(|fault| fault.partition == partition).count();
            assert_eq!(warm, 0, "{partition} has failed by itself: {:?}", ended.faults());
        }
    }

    #[test]
    fn module_on_sealed_channels_goes_on_after_its_executive_was_killed_and_leaves_nothing() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let schedule = scratch.path().join("sealed.toml");
        let text = std::fs::read_to_string(flight_schedule()).unwrap();
        std::fs::write(&schedule, format!("isolation = \"sealed\"\n{text}")).unwrap();
        let set = ["--set", "command.device=/dev/nowhere", "--record", "--until", "9"];
        let mut run = started(schedule.to_str().unwrap(), &set);
        run.await_words("9 partitions are ready");
        let mut traces = Vec::new();
        for (number, signal) in [Signal::KILL, Signal::STOP].into_iter().enumerate() {
            std::thread::sleep(Duration::from_millis(1_200));
            let executive = executive_of(run.pid());
            traces.push(Traces::of(executive.pid));
            executive.signal(signal);
            await_frames(&mut run, number + 1);
        }
        let ended = run.end_within(Duration::from_secs(60)).expect_code(0);
        traces.iter().for_each(Traces::expect_gone);
        assert_eq!(of_executive(&ended).len(), 2, "{:?}", ended.faults());
        let last = ended.windows().into_iter().filter(|window| window.planned_start_ns > 8_000_000_000);
        let (closed, all) = last.fold((0, 0), |(closed, all), window| {
            (closed + usize::from(window.closed_ns.is_some()), all + 1)
        });
        assert!(
            all > 300 && closed * 10 > all * 9,
            "{closed} of {all} windows of the last second were closed: {}",
            ended.stderr
        );
    }
}
