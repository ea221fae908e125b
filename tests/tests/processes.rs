//! Partitions of several ARINC 653 processes, under the executive.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use bateleur_tests::{Ended, Sketch, alone, among_others, bateleur};

/// Runs partition `own` of several processes beside another one, for two seconds.
fn run(keys: &str, more: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let sketch =
        Sketch::new().partition("own", "processes", 2000, keys).partition("other", "counter", 1000, "");
    let schedule = sketch.write(folder.path());
    bateleur(&[&["run", "--until", "2", "--schedule", &schedule], more].concat()).end()
}

/// What `own` has reported.
fn said(ended: &Ended) -> Vec<String> {
    let lines = ended.stderr.lines().chain(ended.stdout.lines());
    lines.filter_map(|line| Some(line.split_once("own: ")?.1.to_owned())).collect()
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
    assert_eq!(reports[..3], ["life 0", "IllegalRequest of process 3", "life 1"], "{reports:#?}");
    assert!(reports.contains(&"fast 90 at 1820201000".to_owned()), "{reports:#?}");
}

#[test]
fn thread_that_the_plan_does_not_count_is_refused_at_the_start() {
    let _turn = among_others();
    let ended = run("threads = 2", &["--fast"]);
    assert!(
        ended.stderr.contains("let `threads` of the plan count one for each process"),
        "{}",
        ended.stderr
    );
}

#[test]
fn on_the_wall_clock_a_process_that_computes_without_end_gives_every_window_back() {
    let _turn = alone();
    let ended = run("threads = 4\nattributes = { computes = true }", &[]).expect_code(0);
    let windows = ended.windows();
    let granted = windows.iter().filter(|window| window.partition == "own" && window.granted_ns.is_some());
    let (granted, closed) = granted.fold((0, 0), |(granted, closed), window| {
        (granted + 1, closed + usize::from(window.closed_ns.is_some()))
    });
    assert!(closed * 2 > granted, "{closed} of {granted} windows were closed");
    assert!(said(&ended).contains(&"slow has 75".to_owned()), "{:#?}", said(&ended));
}
