//! Several schedules: the module changes at the end of a major frame, and partitions find what the plan says.

use bateleur_tests::{Ended, Window, alone, among_others, bateleur, compile_c, program};

const MS: u64 = 1_000_000;

/// Three partitions in `one` (100 ms); in `two` (60 ms) `third` does not run and `second` has other windows.
fn schedules(second: &str, third: &str, actions_of_one: &str, actions_of_two: &str) -> String {
    let partition = |name: &str, keys: &str| {
        let (runs, keys) = keys.split_once('|').unwrap();
        let path = program(runs);
        format!(
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"test\"\nmemory = \"32MiB\"\n{keys}\n",
            path.display()
        )
    };
    format!(
        "[module.test]\ncores = [1]\n{}{}{}
[schedule.one]
major_frame = \"100ms\"
minor_frame = \"20ms\"
initial = true
window = [
    {{ partition = \"first\", offset = \"1ms\", duration = \"1ms\" }},
    {{ partition = \"second\", offset = \"4ms\", duration = \"1ms\" }},
    {{ partition = \"third\", offset = \"7ms\", duration = \"1ms\" }},
]
change_action = {{ {actions_of_one} }}
[schedule.two]
major_frame = \"60ms\"
minor_frame = \"20ms\"
window = [
    {{ partition = \"first\", offset = \"1ms\", duration = \"1ms\" }},
    {{ partition = \"second\", offset = \"10ms\", duration = \"1ms\", minor = [0] }},
]
change_action = {{ {actions_of_two} }}
",
        partition("first", "counter|"),
        partition("second", second),
        partition("third", third),
    )
}

fn run(text: &str, arguments: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("schedules.toml");
    std::fs::write(&path, text).unwrap();
    let run = ["run", "--schedule", path.to_str().unwrap()];
    bateleur(&[&run[..], arguments].concat()).end().expect_code(0)
}

fn of<'a>(windows: &'a [Window], partition: &'a str) -> impl Iterator<Item = &'a Window> {
    windows.iter().filter(move |window| window.partition == partition)
}

/// The windows of the schedule `two` begin at the end of a major frame of `one`, and so back; each lies where its
/// schedule has it, none is missing.
fn assert_changed(ended: &Ended, from_ms: u64, to_ms: u64) {
    let windows = ended.windows();
    let (from, to) = (from_ms * MS, to_ms * MS);
    for window in &windows {
        let start = window.planned_start_ns;
        let expected = if (from..to).contains(&start) { "two" } else { "one" };
        assert_eq!(window.schedule, expected, "{window:?}");
    }
    let starts = |name: &str| of(&windows, name).map(|window| window.planned_start_ns).collect::<Vec<_>>();
    let end = starts("first").last().unwrap() + 1;
    let ones = |offset: u64| {
        let instants = (0..).map(move |minor| minor * 20 * MS + offset).take_while(move |at| *at < end);
        instants.filter(move |at| *at < from || (*at >= to)).collect::<Vec<_>>()
    };
    let twos = (from..to).step_by(60 * MS as usize).map(|major| major + 10 * MS);
    let mut second: Vec<u64> = ones(4 * MS).into_iter().chain(twos).collect();
    second.sort_unstable();
    let found: Vec<u64> = starts("second").into_iter().filter(|at| *at < end).collect();
    assert_eq!(found, second);
    assert!(starts("third").iter().all(|at| *at < from || *at >= to));
}

#[test]
fn mms_01_module_changes_its_schedule_at_the_end_of_the_major_frame_on_the_virtual_clock() {
    let _turn = among_others();
    let text = schedules("counter|", "counter|", "", "");
    let asks = ["--schedule-at", "two@0.21", "--schedule-at", "one@0.45", "--until", "1"];
    let ended = run(&text, &[&["--fast"][..], &asks].concat());
    // 0.3 s is the end of the third major frame of 100 ms; three of 60 ms later it is 0.48 s.
    assert_changed(&ended, 300, 480);
    let ended = ended.expect_words(&["0.300 s  schedule two after one", "0.480 s  schedule one after two"]);
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
}

#[test]
fn scn_32_the_last_of_two_changes_in_a_frame_is_made() {
    let _turn = among_others();
    let text = schedules("counter|", "counter|", "", "");
    let asks = ["--schedule-at", "two@0.21", "--schedule-at", "one@0.25", "--until", "0.6"];
    let windows = run(&text, &[&["--fast"][..], &asks].concat()).windows();
    assert!(windows.iter().all(|window| window.schedule == "one"), "{windows:?}");
    let asks = ["--schedule-at", "one@0.21", "--schedule-at", "two@0.25", "--until", "0.6"];
    assert_changed(&run(&text, &[&["--fast"][..], &asks].concat()), 300, 600);
}

#[test]
fn mms_06_partition_that_was_not_scheduled_starts_cold_when_it_is_scheduled_again() {
    let _turn = among_others();
    let text = schedules("counter|", "warm|retained = \"4KiB\"\nrestart = { start = \"warm\" }", "", "");
    let asks = ["--fast", "--schedule-at", "two@0.21", "--schedule-at", "one@0.45", "--until", "1"];
    let ended = run(&text, &asks)
        .expect_words(&["third: cold_restart with schedule one", "third: HmPartitionColdRestart found None"]);
    let windows = ended.windows();
    let kept_back: Vec<u64> = of(&windows, "third")
        .filter(|window| window.flags.contains('C'))
        .map(|window| window.planned_start_ns)
        .collect();
    assert_eq!(kept_back, [487 * MS], "its first window in the new schedule");
    // A restart takes 20 ms on the virtual clock: the next window is the successor's.
    let next = of(&windows, "third").find(|window| window.planned_start_ns == 507 * MS).unwrap();
    assert!(next.granted_ns.is_some(), "{next:?}");
    assert!(of(&windows, "first").all(|window| window.closed_ns.is_some()), "nobody else loses a window");
    assert!(of(&windows, "second").all(|window| window.closed_ns.is_some()), "nobody else loses a window");
}

#[test]
fn mms_03_change_actions_make_a_partition_idle_and_bring_it_back_warm() {
    let _turn = among_others();
    let warm = "warm|retained = \"4KiB\"\nrestart = { start = \"warm\" }";
    let text = schedules(warm, "counter|", "second = \"warm_restart\"", "second = \"idle\"");
    let asks = ["--fast", "--schedule-at", "two@0.21", "--schedule-at", "one@0.45", "--until", "1"];
    let ended = run(&text, &asks).expect_words(&[
        "second: idle with schedule two",
        "second: warm_restart with schedule one",
        "second: HmPartitionWarmRestart found Some(15)",
    ]);
    let windows = ended.windows();
    assert!(
        of(&windows, "second")
            .filter(|window| window.schedule == "two")
            .all(|window| window.granted_ns.is_none())
    );
    let last = of(&windows, "second").last().unwrap();
    assert!(last.granted_ns.is_some(), "it runs at the end: {last:?}");
    assert!(ended.faults().is_empty(), "a change of schedule is no fault: {:?}", ended.faults());
}

#[test]
fn mms_04_action_is_taken_at_the_first_window_of_the_partition_in_the_new_schedule() {
    let _turn = among_others();
    let text = schedules("counter|", "counter|", "", "second = \"cold_restart\"");
    let ended = run(&text, &["--fast", "--schedule-at", "two@0.21", "--until", "0.6"]);
    let ended = ended.expect_words(&["second: cold_restart with schedule two"]);
    let windows = ended.windows();
    let kept_back = of(&windows, "second").filter(|window| window.flags.contains('C'));
    let kept_back: Vec<u64> = kept_back.map(|window| window.planned_start_ns).collect();
    assert_eq!(kept_back, [310 * MS], "the change is at 300 ms");
}

#[test]
fn mms_05_partition_without_windows_keeps_its_state() {
    let _turn = among_others();
    let block = "[memory_block.count]\nsize = \"64B\"\nread_write = [\"third\"]\n";
    let text = schedules("counter|", "blocks|", "third = \"ignore\"", "") + block;
    let asks = ["--fast", "--schedule-at", "two@0.21", "--schedule-at", "one@0.45", "--until", "1"];
    let ended = run(&text, &asks);
    let windows = ended.windows();
    assert!(of(&windows, "third").all(|window| window.granted_ns.is_some()), "it goes on where it stood");
    assert!(of(&windows, "third").all(|window| !(300 * MS..480 * MS).contains(&window.planned_start_ns)));
    assert_eq!(ended.stderr.matches("third: ").count(), 1, "it has started once: {}", ended.stderr);
}

#[test]
fn change_of_schedule_brings_back_nobody_who_was_stopped_by_the_operator_or_given_up_by_its_budget() {
    let _turn = among_others();
    let budget = "counter|restart = { start = \"cold\", budget = 1, within = \"10s\", then = \"idle\" }";
    let cold = "second = \"cold_restart\", third = \"cold_restart\"";
    let text = schedules("counter|", budget, cold, "second = \"cold_restart\"");
    let asks = ["--fast", "--schedule-at", "two@0.61", "--schedule-at", "one@0.85", "--until", "1.6"];
    let ends =
        ["--stop", "second@0.2", "--kill", "third@0.2", "--kill", "third@0.3", "--start", "second@1.3"];
    let ended = run(&text, &[&asks[..], &ends].concat());
    let windows = ended.windows();
    let back = windows.iter().find(|window| window.schedule == "two").unwrap();
    let one_again = windows
        .iter()
        .find(|window| window.schedule == "one" && window.planned_start_ns > back.planned_start_ns);
    assert!(
        one_again.unwrap().planned_start_ns < 1_100 * MS,
        "it changes twice before the operator starts one"
    );
    let granted = |partition, from, to| {
        of(&windows, partition)
            .filter(|window| {
                (from..to).contains(&(window.planned_start_ns / MS)) && window.granted_ns.is_some()
            })
            .count()
    };
    assert_eq!(granted("second", 200, 1_300), 0, "stopped until the operator starts it");
    assert!(granted("second", 1_300, 1_600) > 10, "and then it runs");
    assert_eq!(granted("third", 320, 1_600), 0, "given up");
    assert!(ended.stderr.lines().all(|line| !line.contains("with schedule")), "{}", ended.stderr);
}

#[test]
fn mms_02_partition_with_permission_changes_the_schedule_and_sees_the_instant_of_the_change() {
    let _turn = among_others();
    let switcher = "switcher|may_set_schedule = [\"one\"]\nattributes = { at = 3, wants = \"two\" }";
    let ended = run(&schedules(switcher, "counter|", "", ""), &["--fast", "--until", "0.4"]);
    // Its fourth window is at 64 ms.
    ended.expect_words(&[
        "second: 0 then 0 since 0",
        "second: two: Ok(())",
        "second: asks for schedule two",
        "second: 0 then 1 since 0",
        "0.100 s  schedule two after one",
        "second: 1 then 1 since 100",
    ]);
}

/// A partition in C that runs each 20 ms in `fast`, and each 40 ms, for longer, in `slow`.
fn of_two_periods(folder: &std::path::Path) -> String {
    let program = compile_c("periods", folder, "watcher", &[]);
    format!(
        "[module.test]\ncores = [1]\n[partition.watcher]\nprogram = \"{}\"\nmodule = \"test\"\nmemory = \"32MiB\"\nthreads = 3\nmay_set_schedule = true\n\
         port.out = {{ direction = \"source\", kind = \"sampling\", max_size = 8 }}\n\
         [schedule.fast]\ninitial = true\nmajor_frame = \"40ms\"\nminor_frame = \"20ms\"\nwindow = [{{ partition = \"watcher\", offset = \"2ms\", duration = \"1ms\" }}]\n\
         [schedule.slow]\nmajor_frame = \"40ms\"\nminor_frame = \"40ms\"\nwindow = [{{ partition = \"watcher\", offset = \"5ms\", duration = \"3ms\" }}]\n",
        program.display()
    )
}

#[test]
fn mms_08_period_and_duration_are_those_of_the_schedule_that_runs() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let ended = run(&of_two_periods(folder.path()), &["--fast", "--until", "2"]);
    let said =
        ended.stderr.lines().filter_map(|line| line.split_once("watcher: period ").map(|(_, rest)| rest));
    let said: Vec<&str> = said.take(3).collect();
    assert_eq!(said, ["20 ms, duration 1000 us", "40 ms, duration 3000 us", "20 ms, duration 1000 us"]);
}

#[test]
fn mms_07_ports_memory_and_permission_stay() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let ended = run(&of_two_periods(folder.path()), &["--fast", "--until", "2"]);
    assert!(ended.stderr.contains("watcher: done"), "it has counted over three changes: {}", ended.stderr);
    assert!(!ended.stderr.contains("FAILED") && ended.faults().is_empty(), "{}", ended.stderr);
}

#[test]
fn mms_09_period_that_does_not_fit_a_schedule_is_an_error_of_the_plan() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("schedules.toml");
    let fixed = of_two_periods(folder.path()).replace("threads = 3", "threads = 3\nperiod = \"20ms\"");
    for (text, words) in [
        (fixed.clone(), "`watcher` has no window in its period from"),
        (
            fixed.replace("\"20ms\"\nmay", "\"30ms\"\nmay"),
            "the major frame of `slow`, 40ms, is no multiple of the period of `watcher`, 30ms",
        ),
    ] {
        std::fs::write(&path, text).unwrap();
        let ended = bateleur(&["check", path.to_str().unwrap()]).end();
        assert!(ended.stdout.contains(words), "{}", ended.stdout);
    }
}

#[test]
fn partition_without_permission_is_refused_and_the_schedule_stays() {
    let _turn = among_others();
    let switcher = "switcher|may_set_schedule = [\"two\"]\nattributes = { at = 3, wants = \"two\" }";
    let ended = run(&schedules(switcher, "counter|", "", ""), &["--fast", "--until", "0.4"]);
    let ended = ended.expect_words(&["second: two: Err(InvalidConfig)"]);
    assert!(ended.windows().iter().all(|window| window.schedule == "one"));
}

#[test]
fn unknown_schedule_is_refused_before_anything_starts() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("schedules.toml");
    std::fs::write(&path, schedules("counter|", "counter|", "", "")).unwrap();
    let run = ["run", "--fast", "--schedule", path.to_str().unwrap(), "--schedule-at", "tow@1"];
    bateleur(&run).end().expect_code(2).expect_words(&["no schedule \"tow\"", "one, two"]);
}

#[test]
fn partition_that_is_being_restarted_when_the_schedule_changes_becomes_what_the_plan_says() {
    let _turn = among_others();
    let warm = "warm|retained = \"4KiB\"\nrestart = { start = \"warm\", startup = \"40ms\" }";
    for (action, expected) in
        [("idle", None), ("cold_restart", Some("second: HmPartitionColdRestart found None"))]
    {
        let text = schedules(warm, "counter|", "", &format!("second = \"{action}\""));
        // The change is at 0.3 s: deaths before and at that instant.
        for kill_ms in (240..=300).step_by(6) {
            let kill = format!("second@{:.3}", f64::from(kill_ms) / 1e3);
            let asks = ["--fast", "--kill", &kill, "--schedule-at", "two@0.21", "--until", "0.7"];
            let ended = run(&text, &asks);
            let windows = ended.windows();
            let in_two = of(&windows, "second").filter(|window| window.schedule == "two");
            let granted = in_two.filter(|window| window.granted_ns.is_some()).count();
            match expected {
                None => assert_eq!(granted, 0, "killed at {kill}, it is to be idle: {}", ended.stderr),
                Some(words) => {
                    assert!(
                        granted > 0 && ended.stderr.contains(words),
                        "killed at {kill}: {}",
                        ended.stderr
                    );
                }
            }
        }
    }
}

/// Windows that `second` was granted in schedule `two`.
fn granted_in_two(ended: &Ended) -> usize {
    let windows = ended.windows();
    of(&windows, "second").filter(|window| window.schedule == "two" && window.granted_ns.is_some()).count()
}

#[test]
fn partition_that_an_operator_holds_over_a_change_of_schedule_becomes_what_the_plan_says_when_it_is_thawed() {
    let _turn = among_others();
    let warm = "warm|retained = \"4KiB\"\nrestart = { start = \"warm\", startup = \"40ms\" }";
    // The change is at 0.3 s. Held while it runs, while it is being restarted, and after the change before its action is done.
    let held = [
        &["--freeze", "second@0.25"][..],
        &["--kill", "second@0.27", "--freeze", "second@0.281"],
        &["--kill", "second@0.29", "--freeze", "second@0.3"],
        &["--freeze", "second@0.3"],
    ];
    for orders in held {
        for action in ["idle", "cold_restart"] {
            let text = schedules(warm, "counter|", "", &format!("second = \"{action}\""));
            let asks = ["--fast", "--schedule-at", "two@0.21", "--thaw", "second@0.6", "--until", "1"];
            let ended = run(&text, &[&asks[..], orders].concat());
            let told = format!("second: {action} with schedule two");
            let found = ended.stderr.contains("second: HmPartitionColdRestart found None");
            let granted = granted_in_two(&ended);
            assert!(ended.stderr.contains(&told), "{orders:?}: {}", ended.stderr);
            assert_eq!(
                (granted > 0, found),
                (action != "idle", action != "idle"),
                "{orders:?}: {}",
                ended.stderr
            );
        }
    }
}

#[test]
fn idle_partition_that_an_operator_holds_while_a_change_brings_it_back_comes_back_when_it_is_thawed() {
    let _turn = among_others();
    let warm = "warm|retained = \"4KiB\"\nrestart = { start = \"warm\" }";
    let text = schedules(warm, "counter|", "second = \"warm_restart\"", "second = \"idle\"");
    let changes = ["--fast", "--schedule-at", "two@0.21", "--schedule-at", "one@0.45", "--until", "1.2"];
    let ended = run(&text, &[&changes[..], &["--freeze", "second@0.4", "--thaw", "second@0.8"]].concat());
    let windows = ended.windows();
    let granted: Vec<u64> = of(&windows, "second")
        .filter(|window| window.granted_ns.is_some())
        .map(|window| window.planned_start_ns / MS)
        .collect();
    assert_eq!(granted.iter().filter(|start_ms| (300..800).contains(*start_ms)).count(), 0, "{granted:?}");
    assert!(granted.iter().any(|start_ms| *start_ms > 800), "{}", ended.stderr);
    assert!(ended.stderr.contains("second: HmPartitionWarmRestart found Some(15)"), "{}", ended.stderr);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn bug_21_module_changes_its_schedule_at_the_end_of_the_major_frame_on_the_wall_clock() {
        let _turn = alone();
        let text = schedules("counter|", "counter|", "", "");
        let ended = run(&text, &["--schedule-at", "two@0.21", "--until", "1"]);
        let windows = ended.windows();
        // A machine that holds the monitor up asks a major frame later.
        let change = windows.iter().find(|window| window.schedule == "two").unwrap().planned_start_ns - MS;
        assert!(change.is_multiple_of(100 * MS) && change >= 300 * MS, "{change}");
        assert!(of(&windows, "third").all(|window| window.planned_start_ns < change));
        let after: Vec<&Window> = windows.iter().filter(|window| window.planned_start_ns > change).collect();
        assert!(after.iter().all(|window| window.schedule == "two"), "it stays");
        let first = after.iter().filter(|window| window.partition == "first");
        assert!(first.clone().count() > 5);
        for (number, window) in first.enumerate() {
            assert_eq!(
                window.planned_start_ns,
                change + MS + number as u64 * 20 * MS,
                "no window is left out"
            );
        }
    }
}
