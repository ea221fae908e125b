//! Partitions that misbehave: what they do stays in their own windows.

use std::time::{Duration, Instant};

use bateleur_system::sched;
use bateleur_tests::{
    Ended, Process, Sketch, Window, alone, among_others, bateleur, children_of, process_named, quantile,
};

fn run(sketch: &Sketch, clock: &[&str], seconds: u32) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let schedule = sketch.write(folder.path());
    let until = seconds.to_string();
    let mut arguments = vec!["run", "--schedule", &schedule, "--until", &until];
    arguments.extend(clock);
    bateleur(&arguments).end()
}

fn of<'a>(windows: &'a [Window], partition: &'a str) -> impl Iterator<Item = &'a Window> {
    windows.iter().filter(move |window| window.partition == partition)
}

/// Two that behave around one that may not.
fn between_counters(middle: &str, keys: &str) -> Sketch {
    Sketch::new()
        .table("[[channel]]\nsource = \"before.count\"\ndestinations = [\"after.heard\"]")
        .partition(
            "before",
            "counter",
            1000,
            "[partition.before.port]\ncount = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }",
        )
        .partition("middle", middle, 3000, keys)
        .partition(
            "after",
            "counter",
            1000,
            "[partition.after.port]\nheard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"60ms\" }",
        )
}

/// That the two that behave had every window, closed each, and that their windows began about as they do without harm.
fn assert_undisturbed(harmed: &Ended, quiet: &Ended) {
    let (harmed, quiet) = (harmed.windows(), quiet.windows());
    for name in ["before", "after"] {
        // Where the machine held the dispatcher itself up, nobody in the module is to blame.
        let on_time = || of(&harmed, name).filter(|window| !window.late);
        let all = on_time().count();
        let ungranted = on_time().filter(|window| window.granted_ns.is_none()).count();
        assert_eq!(ungranted, 0, "of {all} windows of {name} that the dispatcher reached on time");
        let overruns = on_time().filter(|window| window.is_overrun()).count();
        let quiet_overruns = of(&quiet, name).filter(|window| window.is_overrun()).count();
        assert!(overruns <= quiet_overruns + all / 10, "{overruns} of {all} windows of {name} overran");
        let median = |windows: &[Window]| quantile(of(windows, name).filter_map(Window::lateness_ns), 0.5);
        let (with, without) = (median(&harmed), median(&quiet));
        assert!(
            with <= 3 * without + 200_000,
            "windows of {name} begin late: median {with} ns against {without} ns without the fault"
        );
    }
}

#[test]
fn loop_that_waits_for_module_time_ends_on_the_virtual_clock() {
    let _turn = among_others();
    let run = |busy_us: u32| {
        let keys = format!("attributes = {{ busy_us = {busy_us} }}");
        run(&between_counters("counter", &keys), &["--fast"], 3).expect_code(0)
    };
    let within = run(2500);
    assert_eq!(within.faults().iter().filter(|fault| fault.partition == "middle").count(), 0);
    assert!(within.windows().iter().all(|window| window.closed_ns.is_some()));
    // Past the end of its window of 3 ms: held there, and going on in the next one, where the plan's supervision ends it.
    let beyond = run(3500);
    let windows = beyond.windows();
    let of_middle: Vec<_> = of(&windows, "middle").collect();
    assert!(of_middle[..25].iter().all(|window| window.is_overrun()));
    let faults = beyond.faults();
    let of_middle: Vec<_> = faults.iter().filter(|fault| fault.partition == "middle").collect();
    assert!(of_middle.iter().any(|fault| fault.error == "window_overrun"), "{faults:#?}");
    assert!(of_middle.iter().any(|fault| fault.error == "silence"), "{faults:#?}");
    let others = windows.iter().filter(|window| window.partition != "middle");
    assert!(others.clone().count() > 250 && others.clone().all(|window| window.closed_ns.is_some()));
    assert_eq!(run(3500).faults(), faults);
}

/// A partition's word that it is done with its window must not decide who has the processor.
fn assert_impostor_takes_no_window(keys: &str) {
    let _turn = alone();
    let quiet = run(&between_counters("counter", ""), &[], 3).expect_code(0);
    let harmed = run(&between_counters("impostor", keys), &[], 3).expect_code(0);
    assert_undisturbed(&harmed, &quiet);
    let faults = harmed.faults();
    let named = |fault: &&bateleur_tests::Fault| {
        fault.partition == "middle" && fault.error == "window_overrun" && fault.detail.contains("computed on")
    };
    assert_eq!(faults.iter().filter(named).count(), 1, "told once, and held from then on: {faults:#?}");
}

/// Whether this machine lets the executive hold every process of a partition.
fn can_hold_children(said: &str) -> bool {
    let lacks = said.contains("not guaranteed here: a window's end holds every process of a partition");
    if lacks {
        eprintln!("skipped: no control group of version 2 can be made here, so children escape");
    }
    !lacks
}

/// Processor time that the children of a forker used, over the time that passed.
fn share_of_children(keys: &str, least: usize) -> Option<(f64, Ended)> {
    let folder = tempfile::tempdir().unwrap();
    let schedule = between_counters("forker", keys).write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "5"]);
    module.await_words("partitions are ready");
    if !can_hold_children(&module.said()) {
        return None;
    }
    let forker = process_named(module.pid(), "middle");
    let children = bateleur_tests::await_some(Duration::from_secs(3), || {
        Some(children_of(forker.pid)).filter(|children| children.len() >= least)
    });
    let children = children.expect("its children");
    let begun = Instant::now();
    std::thread::sleep(Duration::from_secs(2));
    let now: Vec<Process> = children.iter().filter_map(Process::again).collect();
    let elapsed_s = begun.elapsed().as_secs_f64();
    assert_eq!(now.len(), children.len(), "they still run: {children:?}");
    let used: u64 =
        children.iter().zip(&now).map(|(before, after)| after.used_ticks - before.used_ticks).sum();
    let ended = module.end();
    for child in &children {
        assert!(!child.is_alive(), "a child of a partition outlives the module: {child:?}");
    }
    Some((used as f64 * 0.01 / elapsed_s, ended))
}

/// How many windows of the two that behave were lost while the dispatcher was on time, and how many of them in all.
fn lost_windows(ended: &Ended) -> (usize, usize) {
    let windows = ended.windows();
    let on_time = windows.iter().filter(|window| window.partition != "middle" && !window.late);
    let lost = on_time.clone().filter(|window| window.closed_ns.is_none()).count();
    (lost, on_time.count())
}

fn assert_crowd_takes_no_window(keys: &str) {
    let _turn = alone();
    let quiet = run(&between_counters("counter", ""), &[], 2).expect_code(0);
    // Four threads and a child: both count towards the limit.
    let keys = format!("threads = 5\n{keys}");
    let harmed = run(&between_counters("crowd", &keys), &[], 4).expect_code(0);
    if !can_hold_children(&harmed.stderr) {
        return;
    }
    let ((quiet_lost, quiet_all), (lost, all)) = (lost_windows(&quiet), lost_windows(&harmed));
    assert!(all > 200, "{all}");
    // A machine that others use takes a window now and then, with the crowd or without.
    let allowed = quiet_lost * all / quiet_all + all / 20;
    assert!(
        lost <= allowed,
        "{lost} of {all} windows were lost, {quiet_lost} of {quiet_all} without the crowd"
    );
    let windows = harmed.windows();
    assert!(of(&windows, "middle").filter(|window| window.granted_ns.is_some()).count() > 100);
}

#[test]
fn children_that_left_their_session_die_with_their_partition() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule =
        between_counters("forker", "threads = 8\nattributes = { closes = true }").write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "60"]);
    module.await_words("partitions are ready");
    if !can_hold_children(&module.said()) {
        return;
    }
    let forker = process_named(module.pid(), "middle");
    let children = bateleur_tests::await_some(Duration::from_secs(5), || {
        Some(children_of(forker.pid)).filter(|children| children.len() >= 4)
    });
    let children = children.expect("two children and a child of each");
    forker.signal(rustix::process::Signal::KILL);
    let gone = bateleur_tests::await_some(Duration::from_secs(5), || {
        children.iter().all(|child| !child.is_alive()).then_some(())
    });
    assert!(gone.is_some(), "children of a dead incarnation still run: {children:?}");
    module.signal(rustix::process::Signal::TERM);
    module.end().expect_code(0);
}

fn assert_crash_is_called(how: &str, error: &str, detail: &str) {
    let _turn = among_others();
    // Damage of the machine's memory is played by a signal with a value.
    let keys = format!("system_calls = [\"queued_signals\"]\nattributes = {{ how = \"{how}\", after = 10 }}");
    let ended = run(&between_counters("crasher", &keys), &["--fast"], 1).expect_code(0);
    let faults = ended.faults();
    let first = faults.first().expect("a fault");
    assert_eq!((first.partition.as_str(), first.error.as_str()), ("middle", error), "{first:?}");
    assert!(first.detail.contains(detail), "{detail:?} is missing in {first:?}");
    assert!(first.recovered_ns.is_some(), "{first:?}");
    assert!(faults.iter().all(|fault| fault.partition == "middle"), "{faults:?}");
    let windows = ended.windows();
    assert!(of(&windows, "before").chain(of(&windows, "after")).all(|window| window.closed_ns.is_some()));
}

#[test]
fn write_to_nowhere_is_a_memory_violation() {
    assert_crash_is_called("segv", "memory_violation", "SIGSEGV");
}

#[test]
fn division_by_zero_is_a_numeric_error() {
    assert_crash_is_called("fpe", "numeric_error", "SIGFPE");
}

#[test]
fn panic_is_an_exit_with_its_words() {
    assert_crash_is_called("panic", "exit", "panicked");
}

#[test]
fn abort_is_an_exit_and_no_memory_violation() {
    assert_crash_is_called("abort", "exit", "aborted");
}

#[test]
fn endless_recursion_is_a_stack_overflow() {
    assert_crash_is_called("stack", "stack_overflow", "stack");
}

#[test]
fn request_for_more_memory_than_there_is_meets_the_memory_limit() {
    assert_crash_is_called("memory", "memory_limit", "memory allocation of");
}

#[test]
fn division_that_rust_catches_is_a_numeric_error_too() {
    assert_crash_is_called("divide", "numeric_error", "divide by zero");
}

#[test]
fn damaged_memory_is_a_hardware_fault() {
    assert_crash_is_called("damage", "hardware_fault", "damaged memory");
}

#[test]
fn forbidden_system_call_is_an_illegal_request() {
    assert_crash_is_called("call", "illegal_request", "SIGSYS");
}

/// The kernel's log can be read, and its process numbers are those here.
fn kernel_tells() -> bool {
    let first =
        std::fs::read_link("/proc/self/ns/pid").is_ok_and(|link| link.as_os_str() == "pid:[4026531836]");
    first && std::fs::File::open("/dev/kmsg").is_ok()
}

#[test]
fn window_that_is_never_closed_misses_its_deadline_in_virtual_time_too() {
    let _turn = among_others();
    let keys =
        "deadline = \"400us\"\nattributes = { after = 40 }\nhealth = { deadline_missed = \"cold_restart\" }";
    let ended = run(&between_counters("hanger", keys), &["--fast"], 1).expect_code(0);
    let faults = ended.faults();
    let first = faults.iter().find(|fault| fault.error == "deadline_missed").expect("a missed deadline");
    assert_eq!((first.partition.as_str(), first.action.as_str()), ("middle", "cold_restart"));
    assert!(first.recovered_ns.is_some(), "{first:?}");
}

#[test]
fn overruns_of_an_incarnation_that_hung_are_told_as_its_own_before_its_successor_begins() {
    let _turn = among_others();
    let keys = "attributes = { how = \"sleep\", after = 5 }";
    let faults = run(&between_counters("hanger", keys), &["--fast"], 2).expect_code(0).faults();
    let silence = faults.iter().find(|fault| fault.error == "silence").expect("a silence");
    let counted =
        |fault: &&bateleur_tests::Fault| fault.error == "window_overrun" && fault.detail.contains("more in");
    let first = faults.iter().find(counted).expect("overruns that were counted");
    assert_eq!((first.generation, first.time_ns), (0, silence.time_ns), "{faults:#?}");
}

#[test]
fn exit_is_an_exit_with_its_code() {
    assert_crash_is_called("exit", "exit", "code 3");
}

#[test]
fn spinner_in_virtual_time_ends_idle_and_the_run_ends() {
    let _turn = among_others();
    let keys = "restart = { start = \"cold\", budget = 1, within = \"60s\", then = \"idle\" }";
    let ended = run(&between_counters("hanger", keys), &["--fast"], 3).expect_code(0);
    let silences = ended.faults().into_iter().filter(|fault| fault.error == "silence");
    assert_eq!(silences.map(|fault| fault.action).collect::<Vec<_>>(), ["cold_restart", "idle"]);
    let windows = ended.windows();
    assert!(of(&windows, "before").chain(of(&windows, "after")).all(|window| window.closed_ns.is_some()));
}

/// There it has a priority that the dispatcher has not, until it is seen to use it.
#[test]
fn impostor_that_never_stops_computing_in_virtual_time_holds_up_nobody_for_long() {
    let _turn = among_others();
    let keys = "attributes = { computes_ms = 600000 }
restart = { start = \"cold\", budget = 1, within = \"60s\", then = \"idle\" }";
    let ended = run(&between_counters("impostor", keys), &["--fast"], 3).expect_code(0);
    let silences = ended.faults().into_iter().filter(|fault| fault.error == "silence");
    assert_eq!(silences.map(|fault| fault.action).collect::<Vec<_>>(), ["cold_restart", "idle"]);
    let windows = ended.windows();
    assert!(of(&windows, "before").chain(of(&windows, "after")).all(|window| window.closed_ns.is_some()));
}

#[test]
fn sleeper_in_virtual_time_does_not_hang_the_run() {
    let _turn = among_others();
    let ended =
        run(&between_counters("hanger", "attributes = { how = \"sleep\", after = 5 }\nrestart = { start = \"cold\", budget = 1, within = \"60s\", then = \"idle\" }"), &["--fast"], 2).expect_code(0);
    assert!(ended.faults().iter().any(|fault| fault.error == "silence"));
    let windows = ended.windows();
    assert!(of(&windows, "after").all(|window| window.closed_ns.is_some()));
}

#[test]
fn partition_that_takes_too_long_to_start_is_an_error_with_its_name() {
    let _turn = among_others();
    let keys = "startup_timeout = \"300ms\"\nattributes = { takes_ms = 5000 }";
    let ended = run(&between_counters("late_starter", keys), &["--fast"], 1).expect_code(2);
    let ended = ended.expect_words(&["middle", "300 ms", "startup_timeout"]);
    assert!(ended.stderr.lines().all(|line| !line.contains("panicked")), "{}", ended.stderr);
}

#[test]
fn module_that_is_asked_to_end_while_its_partitions_initialise_ends() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = "startup_timeout = \"60min\"\nattributes = { takes_ms = 3000000 }";
    let schedule = between_counters("late_starter", keys).write(folder.path());
    for clock in [&["--fast"][..], &[]] {
        let module = bateleur(&[&["run", "--schedule", &schedule][..], clock].concat());
        process_named(module.pid(), "middle");
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0).expect_words(&["it was asked to stop"]);
    }
}

#[test]
fn successor_that_takes_too_long_to_start_is_started_again_until_its_budget_ends() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = "startup_timeout = \"300ms\"\nattributes = { again_ms = 5000 }\n\
                restart = { start = \"cold\", budget = 2, within = \"60s\", then = \"idle\" }";
    let schedule = between_counters("late_starter", keys).write(folder.path());
    let run = ["run", "--fast", "--schedule", &schedule, "--until", "2", "--kill", "middle@1"];
    let ended = bateleur(&run).end().expect_code(0);
    let told: Vec<_> = ended.faults().into_iter().map(|fault| (fault.error, fault.action)).collect();
    let expected =
        [("killed", "cold_restart"), ("startup_timeout", "cold_restart"), ("startup_timeout", "idle")];
    assert_eq!(told, expected.map(|(error, action)| (error.to_owned(), action.to_owned())));
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn spinner_on_the_wall_clock_takes_no_window_from_others_is_restarted_and_ends_idle() {
        let _turn = alone();
        let quiet = run(&between_counters("counter", ""), &[], 5).expect_code(0);
        let keys = "restart = { start = \"cold\", budget = 3, within = \"60s\", then = \"idle\" }";
        let harmed = run(&between_counters("hanger", keys), &[], 5).expect_code(0);
        assert_undisturbed(&harmed, &quiet);
        let mut faults = harmed.faults();
        // The machine may hold the dispatcher itself up: that is nobody's fault in the module.
        faults.retain(|fault| !["late_dispatcher", "processor_taken"].contains(&fault.error.as_str()));
        // How many windows of others may be open at their end was judged above: a few are the machine's.
        let is_judged = |error: &str| error == "window_overrun";
        assert!(
            faults.iter().all(|fault| fault.partition == "middle" || is_judged(&fault.error)),
            "{faults:#?}"
        );
        let silences: Vec<_> = faults.iter().filter(|fault| fault.error == "silence").collect();
        let actions: Vec<_> = silences.iter().map(|fault| fault.action.as_str()).collect();
        assert_eq!(actions, ["cold_restart", "cold_restart", "cold_restart", "idle"], "{faults:#?}");
        assert!(faults.iter().any(|fault| fault.error == "window_overrun"), "{faults:#?}");
        let windows = harmed.windows();
        let overruns = of(&windows, "middle").filter(|window| window.is_overrun()).count();
        assert!((90..=110).contains(&overruns), "25 for each of 4 incarnations: {overruns}");
        assert!(of(&windows, "middle").last().unwrap().granted_ns.is_none(), "idle at the end");
    }

    #[test]
    fn sleeper_on_the_wall_clock_takes_no_window_from_others_and_is_restarted() {
        let _turn = alone();
        let quiet = run(&between_counters("counter", ""), &[], 2).expect_code(0);
        let harmed =
            run(&between_counters("hanger", "attributes = { how = \"sleep\" }"), &[], 2).expect_code(0);
        assert_undisturbed(&harmed, &quiet);
        assert!(harmed.faults().iter().any(|fault| fault.error == "silence" && fault.partition == "middle"));
    }

    #[test]
    fn partition_that_says_it_is_done_and_computes_on_takes_no_window_from_others_and_is_named() {
        assert_impostor_takes_no_window("");
    }

    #[test]
    fn partition_that_says_it_is_done_and_wakes_in_another_window_takes_none_and_is_named() {
        assert_impostor_takes_no_window("attributes = { pause_us = 3500 }");
    }

    #[test]
    fn children_of_a_partition_that_overruns_are_held_between_its_windows() {
        let _turn = alone();
        // So many restarts would hide it: silence is put far away.
        let Some((share, ended)) = share_of_children(
            "threads = 8\nattributes = { closes = false }\nhealth = { silence = \"ignore\" }",
            2,
        ) else {
            return;
        };
        // Its window is 3 ms of 20: 15 % of one processor.
        assert!(share < 0.3, "children use {share} of a processor");
        let quiet = run(&between_counters("counter", ""), &[], 2).expect_code(0);
        assert_undisturbed(&ended, &quiet);
    }

    #[test]
    fn children_of_a_partition_that_closes_its_windows_are_held_between_them() {
        let _turn = alone();
        let Some((share, ended)) = share_of_children("threads = 8\nattributes = { closes = true }", 4) else {
            return;
        };
        assert!(share < 0.3, "children use {share} of a processor");
        let quiet = run(&between_counters("counter", ""), &[], 2).expect_code(0);
        assert_undisturbed(&ended, &quiet);
    }

    /// Nothing of the executive runs beside it, or after a window for which no dispatcher is left.
    #[test]
    fn crowd_that_spins_on_the_only_processor_ends_with_its_module() {
        let _turn = alone();
        let keys = "attributes = { closes = false }\nhealth = { silence = \"ignore\" }";
        let sketch =
            Sketch::new().partition("crowd", "crowd", 1200, keys).partition("after", "counter", 500, "");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("one.toml");
        let often = sketch.text().replace("\"200us\"", "\"0us\"").replace("20ms", "3ms");
        std::fs::write(&path, often).unwrap();
        let given = sched::allowed_cores();
        for until in ["0.25", "0.31", "0.5"] {
            sched::bind(0, &given[..1]).unwrap();
            let module = bateleur(&["run", "--schedule", path.to_str().unwrap(), "--until", until]);
            sched::bind(0, &given).unwrap();
            let ended = module.end_within(Duration::from_secs(15)).expect_code(0);
            let closed = |window: &Window| window.partition == "after" && window.closed_ns.is_some();
            assert!(ended.windows().iter().filter(|window| closed(window)).count() > 40, "{}", ended.stderr);
        }
    }

    #[test]
    fn crowd_that_closes_its_windows_takes_none_from_others() {
        assert_crowd_takes_no_window("attributes = { closes = true }");
    }

    #[test]
    fn crowd_that_spins_on_takes_no_window_from_others() {
        assert_crowd_takes_no_window("attributes = { closes = false }\nhealth = { silence = \"ignore\" }");
    }

    #[test]
    fn forbidden_system_call_is_named_where_the_kernel_tells() {
        let _turn = alone();
        if !kernel_tells() {
            return eprintln!("not tried: the kernel's log can not be read here");
        }
        // The kernel drops records where there are many, such as those of tests before this one.
        for _ in 0..4 {
            let keys = "attributes = { how = \"call\", after = 10 }";
            let ended = run(&between_counters("crasher", keys), &["--fast"], 1).expect_code(0);
            let faults = ended.faults();
            let first =
                faults.iter().find(|fault| fault.error == "illegal_request").expect("an illegal request");
            if first.detail.contains("SIGSYS: system call ") {
                return assert!(first.detail.contains("(personality)"), "{first:?}");
            }
            std::thread::sleep(std::time::Duration::from_secs(6));
        }
        panic!("no call was named in four runs");
    }

    #[test]
    fn window_that_is_closed_after_its_deadline_is_told_once_a_second_and_is_no_overrun() {
        let _turn = alone();
        let sketch = Sketch::new()
            .partition("slow", "counter", 6_000, "deadline = \"500us\"\nattributes = { busy_us = 1500 }")
            .partition("quick", "counter", 6_000, "deadline = \"6ms\"");
        let ended = run(&sketch, &[], 3).expect_code(0);
        // A window of the other one that the machine itself has held up is not closed at all: that is not meant here.
        let missed: Vec<_> = ended
            .faults()
            .into_iter()
            .filter(|fault| fault.error == "deadline_missed" && !fault.detail.contains("not at all"))
            .collect();
        assert!(missed.iter().all(|fault| fault.partition == "slow"), "{missed:?}");
        assert!((2..=5).contains(&missed.len()), "{missed:?}");
        let counts = missed.iter().skip(1).all(|fault| fault.detail.contains(" more in "));
        assert!(counts, "none is left out of the count: {missed:?}");
        assert!(
            missed.iter().all(|fault| fault.action == "ignore" && fault.detail.contains("us after")),
            "{missed:?}"
        );
    }
}
