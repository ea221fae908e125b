//! A process that sleeps outside of services is passed over. No service of the standard knows of it.

use bateleur_processes::Runner;
use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn who_sleeps_is_passed_over_until_taken_back_and_is_the_first_of_its_equals_then() {
    let mut bench = Bench::new();
    let [a, equal, low] =
        [("a", 20), ("equal", 20), ("low", 10)].map(|(name, priority)| bench.started(name, priority));
    bench.normal();
    assert!(bench.others_are_ready());
    bench.lend();
    assert_eq!(bench.who(), Some(Runner::Process(equal)));
    bench.lend();
    assert_eq!(bench.who(), Some(Runner::Process(low)));
    assert_eq!(bench.get_process_status(a).unwrap().state, ProcessState::Ready);
    bench.lend();
    assert_eq!(bench.who(), None, "all sleep");
    bench.take_back();
    assert_eq!(bench.who(), Some(Runner::Process(a)));
    bench.stop_self();
    assert_eq!(bench.who(), Some(Runner::Process(equal)));
}

#[test]
fn who_is_passed_over_can_be_suspended_resumed_stopped_and_started() {
    let mut bench = Bench::new();
    let a = bench.started("a", 20);
    let low = bench.started("low", 10);
    bench.normal();
    bench.lend();
    assert_eq!(code(bench.suspend(a)), NE);
    bench.take_back();
    assert_eq!(bench.who(), Some(Runner::Process(low)), "it is suspended");
    assert_eq!(code(bench.resume(a)), NE);
    assert_eq!(bench.who(), Some(Runner::Process(a)));
    bench.lend();
    assert_eq!(code(bench.set_priority(a, 30)), NE);
    assert_eq!(code(bench.stop(a)), NE);
    bench.take_back();
    assert_eq!(bench.who(), Some(Runner::Process(low)), "it is dormant");
    assert_eq!(code(bench.start(a)), NE);
    assert_eq!(bench.who(), Some(Runner::Process(a)));
}

#[test]
fn error_handler_that_sleeps_lets_processes_run() {
    let (mut bench, a) = Bench::in_handler();
    assert!(bench.others_are_ready());
    bench.lend();
    assert_eq!(bench.who(), Some(Runner::Process(a)));
    bench.take_back();
    assert_eq!(bench.who(), Some(Runner::Handler));
}

#[test]
fn nobody_else_is_ready_where_one_runs_alone() {
    let (bench, _) = Bench::running();
    assert!(!bench.others_are_ready());
    let mut bench = Bench::new();
    bench.started("a", 10);
    bench.started("b", 10);
    bench.normal();
    assert!(bench.others_are_ready(), "its equal");
}
