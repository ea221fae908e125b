//! Partitions of several ARINC 653 processes, under the executive.

use bateleur_tests::{Ended, Sketch, alone, among_others, bateleur, is_long};

/// Runs partition `own` of several processes beside another one, for two seconds where `more` says nothing else.
fn run(keys: &str, more: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let sketch =
        Sketch::new().partition("own", "processes", 2000, keys).partition("other", "counter", 1000, "");
    let schedule = sketch.write(folder.path());
    let until = if more.contains(&"--until") { &[][..] } else { &["--until", "2"] };
    bateleur(&[&["run", "--schedule", &schedule], until, more].concat()).end()
}

/// What `own` has reported.
fn said(ended: &Ended) -> Vec<String> {
    said_by(ended, "own")
}

#[test]
fn processes_take_turns_in_windows_and_two_runs_on_the_virtual_clock_are_the_same() {
    let _turn = among_others();
    let first = run("threads = 3", &["--fast"]).expect_code(0);
    let reports = said(&first);
    // NORMAL is entered at 0.2 ms, in the first window; the window that begins there is that of the release at 20 ms.
    assert_eq!(reports[..3], ["fast 0 at 20201000", "slow has 0", "fast 10 at 220201000"], "{reports:#?}");
    assert_eq!(reports.iter().filter(|line| line.starts_with("slow")).count(), 4);
    assert_eq!(said(&run("threads = 3", &["--fast"])), reports);
    assert!(first.faults().is_empty(), "{:?}", first.faults());
}

#[test]
fn panic_of_one_process_is_its_error_handlers_and_the_others_go_on() {
    let _turn = among_others();
    let ended = run("threads = 5\nattributes = { fails = true }", &["--fast"]).expect_code(0);
    let reports = said(&ended);
    let logged = "illegal_request (process fails) -> error_handler";
    let expected = ["life 0", "IllegalRequest of process 3", "life 1", logged];
    assert_eq!(reports[..4], expected, "{reports:#?}");
    assert!(reports.contains(&"fast 90 at 1820201000".to_owned()), "{reports:#?}");
}

#[test]
fn partition_is_told_what_the_plan_says_of_it() {
    let _turn = among_others();
    let keys =
        "identifier = 7\nperiod = \"20ms\"\nduration = \"2ms\"\nprocesses = 2\nattributes = { tells = true }";
    let reports = said(&run(keys, &["--fast"]).expect_code(0));
    assert_eq!(reports[..2], ["number 7, 2000 us in each 20000 us", "fast 0 at 20201000"], "{reports:#?}");
    let reports = said(&run("processes = 2\nattributes = { tells = true }", &["--fast"]).expect_code(0));
    assert_eq!(reports[0], "number 1, 2000 us in each 20000 us", "as its windows are");
}

#[test]
fn process_that_the_plan_does_not_allow_is_refused_and_told_why() {
    let _turn = among_others();
    for (keys, why) in [
        ("processes = 1", "the plan's `processes` allows 1"),
        ("threads = 2", "the plan's `processes` allows 1"),
        ("processes = 2\nstacks = \"100KiB\"", "the plan's `stacks` allows 102400 bytes together"),
    ] {
        let ended = run(keys, &["--fast"]);
        let refused = ended.stderr.lines().find(|line| line.contains("process \"slow\": INVALID_CONFIG"));
        assert!(refused.is_some_and(|line| line.ends_with(why)), "{keys}: {}", ended.stderr);
    }
}

#[test]
fn partition_that_sets_its_mode_is_started_again_beyond_its_budget_and_is_told_so() {
    let _turn = among_others();
    for mode in ["cold", "warm"] {
        let restart = "restart = { start = \"warm\", budget = 2, within = \"10s\", then = \"idle\" }";
        let keys = format!("threads = 4\n{restart}\nattributes = {{ again = \"{mode}\" }}");
        let ended = run(&keys, &["--fast"]).expect_code(0);
        let found: Vec<String> =
            said(&ended).into_iter().filter(|line| line.starts_with("generation")).collect();
        let expected: Vec<String> = (0..=8)
            .map(|generation| match generation {
                0 => "generation 0: NormalStart".to_owned(),
                _ => format!("generation {generation}: PartitionRestart"),
            })
            .collect();
        assert_eq!(found, expected, "{mode}: {}", ended.stderr);
        let actions: Vec<String> = ended.faults().iter().map(|fault| fault.action.clone()).collect();
        assert_eq!(actions, vec![format!("{mode}_restart"); 8]);
    }
}

#[test]
fn partition_that_starts_itself_anew_without_end_comes_to_the_end_of_its_budget() {
    let _turn = among_others();
    let restart = "restart = { start = \"warm\", budget = 3, within = \"60s\", then = \"idle\" }";
    let keys = format!("threads = 4\n{restart}\nattributes = {{ again = \"without end\" }}");
    let ended = run(&keys, &["--fast", "--until", "6"]).expect_code(0);
    let actions: Vec<String> = ended.faults().iter().map(|fault| fault.action.clone()).collect();
    // Twenty in ten seconds are its own affair, three its budget's.
    assert_eq!(actions.len(), 24, "{actions:?}");
    assert!(actions[..23].iter().all(|action| action == "cold_restart"), "{actions:?}");
    assert_eq!(actions[23], "idle");
    let details: Vec<_> = ended.faults().into_iter().map(|fault| fault.detail).collect();
    assert!(
        !details[19].contains("20 times") && details[20].contains("more than 20 times in 10 s"),
        "{details:?}"
    );
}

/// What can be seen of a partition of twenty processes that act at random, panic, and start their partition again.
fn seen_of_a_hive() -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let keys =
        "threads = 22\nrestart = { start = \"warm\", budget = 100, within = \"10s\", then = \"idle\" }";
    let sketch = Sketch::new().partition("own", "hive", 4000, keys).partition("other", "counter", 1000, "");
    let schedule = sketch.write(folder.path());
    let ended = bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(0);
    // How long a window takes the machine is the machine's.
    let windows = ended.windows().into_iter();
    let windows =
        windows.map(|window| format!("{} {:?} {}", window.partition, window.granted_ns, window.flags));
    let faults = ended.faults().into_iter().map(|fault| format!("{fault:?}"));
    said(&ended).into_iter().chain(windows).chain(faults).collect()
}

#[test]
fn runs_of_many_processes_with_crashes_and_restarts_are_the_same_on_the_virtual_clock() {
    let _turn = among_others();
    let first = seen_of_a_hive();
    let of = |what: &str| first.iter().filter(|line| line.contains(what)).count();
    assert!(of(" step ") > 30 && of("own_request") >= 2, "{} {}", of(" step "), of("own_request"));
    for run in 1..if is_long() { 20 } else { 6 } {
        let again = seen_of_a_hive();
        let differs = first.iter().zip(&again).find(|(one, other)| one != other);
        assert!(first == again, "run {run}: {differs:?}, {} and {} lines", first.len(), again.len());
    }
}

#[test]
fn scn_33_idle_partition_moves_no_window_of_another() {
    let _turn = among_others();
    let others = |ended: &Ended| -> Vec<(u64, Option<u64>)> {
        let windows = ended.windows();
        let others = windows.iter().filter(|window| window.partition == "other");
        others.map(|window| (window.planned_start_ns, window.granted_ns)).collect()
    };
    let idle = run("threads = 4\nattributes = { again = \"idle\" }", &["--fast"]).expect_code(0);
    let both = run("threads = 3", &["--fast"]).expect_code(0);
    let own = |window: &&bateleur_tests::Window| window.partition == "own" && window.granted_ns.is_some();
    assert_eq!(idle.windows().iter().filter(own).count(), 1);
    assert_eq!(others(&idle), others(&both));
}

#[test]
fn partition_of_several_processes_can_not_stand_by() {
    let _turn = among_others();
    let ended = run("threads = 3\nstandby = \"hot\"", &["--fast"]);
    assert!(ended.stderr.contains("can not stand by: take `standby` out of the plan"), "{}", ended.stderr);
}

fn assert_windows_are_given_back(keys: &str) {
    let ended = run(keys, &[]).expect_code(0);
    let windows = ended.windows();
    let granted = windows.iter().filter(|window| window.partition == "own" && window.granted_ns.is_some());
    let (granted, closed) = granted.fold((0, 0), |(granted, closed), window| {
        (granted + 1, closed + usize::from(window.closed_ns.is_some()))
    });
    assert!(closed * 2 > granted, "{closed} of {granted} windows were closed");
    assert!(said(&ended).contains(&"slow has 75".to_owned()), "{:#?}", said(&ended));
}

/// One partition sends and the other receives, for two seconds.
fn correspond(more: &[&str]) -> Ended {
    let ports = |lines: &str| format!("threads = 3\n{lines}");
    let sender = ports(
        "attributes = { sends = true }\n[partition.own.port]\n\
         out = { direction = \"source\", kind = \"queuing\", max_size = 64 }\n\
         told = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }",
    );
    let receiver = ports(
        "[partition.other.port]\n\
         in = { direction = \"destination\", kind = \"queuing\", max_size = 64, depth = 2 }\n\
         silent = { direction = \"destination\", kind = \"queuing\", max_size = 64, depth = 2 }\n\
         heard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"100ms\" }",
    );
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new()
        .table(&bateleur_tests::channel_between("own.out", "other.in"))
        .table(&bateleur_tests::channel_between("own.told", "other.heard"))
        .partition("own", "correspondent", 3000, &sender)
        .partition("other", "correspondent", 3000, &receiver);
    let schedule = sketch.write(folder.path());
    bateleur(&[&["run", "--until", "2", "--schedule", &schedule], more].concat()).end().expect_code(0)
}

/// What a partition has reported.
fn said_by(ended: &Ended, partition: &str) -> Vec<String> {
    let lines = ended.stderr.lines().chain(ended.stdout.lines());
    lines.filter_map(|line| Some(line.split_once(&format!("{partition}: "))?.1.to_owned())).collect()
}

#[test]
fn messages_between_two_partitions_wait_for_room_and_arrive_whole_and_in_order_on_the_virtual_clock() {
    let _turn = among_others();
    let ended = correspond(&["--fast"]);
    assert_eq!(said_by(&ended, "own"), ["full: Err(NotAvailable)"]);
    let received = said_by(&ended, "other");
    let messages = received.iter().filter(|line| line.contains("messages at")).count();
    assert!(messages >= 3 && !received.iter().any(|line| line.contains(" is [")), "{received:#?}");
    assert!(received.contains(&"20. Err(TimedOut), heard true".to_owned()), "{received:#?}");
    assert_eq!(said_by(&correspond(&["--fast"]), "other"), received, "another run");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn on_the_wall_clock_a_process_that_computes_without_end_gives_every_window_back() {
        let _turn = alone();
        assert_windows_are_given_back("threads = 4\nattributes = { computes = true }");
    }

    #[test]
    fn on_the_wall_clock_a_dozen_processes_that_compute_without_end_give_every_window_back() {
        let _turn = alone();
        assert_windows_are_given_back("threads = 15\nattributes = { many = 12 }");
    }

    #[test]
    fn messages_between_two_partitions_wait_for_room_and_arrive_whole_and_in_order_on_the_wall_clock() {
        let _turn = alone();
        let ended = correspond(&[]);
        let sent = said_by(&ended, "own");
        assert!(sent.contains(&"full: Err(NotAvailable)".to_owned()), "{sent:#?}");
        let received = said_by(&ended, "other");
        let messages = received.iter().filter(|line| line.contains("messages at")).count();
        assert!(messages >= 2 && !received.iter().any(|line| line.contains(" is [")), "{received:#?}");
        assert!(received.contains(&"20. Err(TimedOut), heard true".to_owned()), "{received:#?}");
    }
}
