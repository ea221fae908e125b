//! However a run ends, nothing of it is left: no process, no shared memory, no control group, no socket.

use bateleur_tests::{
    Started, Traces, alone, among_others, bateleur, executive_of, flight_schedule, process_named,
};
use rustix::process::Signal;

/// A module on the wall clock, with all that it has on the machine.
fn run() -> (Started, Traces) {
    let schedule = flight_schedule();
    let device = "command.device=/dev/nowhere";
    let mut module =
        bateleur(&["run", "--schedule", schedule.to_str().unwrap(), "--set", device, "--until", "100"]);
    module.await_words("partitions are ready");
    let traces = Traces::of(module.pid());
    assert!(traces.has_sockets(), "hil_interface has one");
    (module, traces)
}

/// A flight under way.
fn fly() -> (Started, Traces) {
    let schedule = flight_schedule();
    let mut flight =
        bateleur(&["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()]);
    flight.await_words("partitions are ready");
    let traces = Traces::of(flight.pid());
    assert!(traces.has_sockets(), "the simulator and hil_interface have one each");
    (flight, traces)
}

#[test]
fn flight_that_ends_leaves_nothing() {
    let _turn = among_others();
    let (flight, traces) = fly();
    flight.end().expect_code(0);
    assert_eq!(traces.left(), Vec::<String>::new(), "at once");
}

#[test]
fn flight_that_is_interrupted_leaves_nothing_and_says_so() {
    let _turn = among_others();
    let (flight, traces) = fly();
    flight.signal(Signal::INT);
    let ended = flight.end().expect_code(1);
    assert_eq!(ended.summary()["completed"], false);
    assert_eq!(ended.summary()["failure"], "it was interrupted");
    traces.expect_gone();
}

#[test]
fn flight_that_is_killed_leaves_nothing() {
    let _turn = among_others();
    let (flight, traces) = fly();
    flight.signal(Signal::KILL);
    drop(flight);
    traces.expect_gone();
}

#[test]
fn flight_whose_executive_is_killed_ends_and_leaves_nothing() {
    let _turn = among_others();
    let (flight, traces) = fly();
    executive_of(flight.pid()).signal(Signal::KILL);
    let ended = flight.end().expect_code(1);
    assert_eq!(ended.summary()["completed"], false);
    traces.expect_gone();
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn flight_whose_terminal_is_interrupted_says_so_once_on_either_clock() {
        let _turn = alone();
        let schedule = flight_schedule();
        for clock in [&["--fast"][..], &[]] {
            let mut arguments = vec!["fly", "--format", "json", "--schedule", schedule.to_str().unwrap()];
            arguments.extend(clock);
            let mut flight = bateleur(&arguments);
            flight.await_words("waiting for the estimator");
            flight.signal_group(Signal::INT);
            let ended = flight.end().expect_code(1);
            assert_eq!(ended.summary()["failure"], "it was interrupted", "{clock:?}\n{}", ended.stderr);
            let told = ended.stderr.matches("stopped after").count();
            assert_eq!(told, 1, "{clock:?}: {}", ended.stderr);
            assert!(!ended.stderr.contains("simulator ended"), "{clock:?}: {}", ended.stderr);
        }
    }

    #[test]
    fn module_that_is_asked_to_end_leaves_nothing() {
        let _turn = alone();
        for signal in [Signal::TERM, Signal::INT] {
            let (module, traces) = run();
            module.signal(signal);
            module.end().expect_code(0);
            assert_eq!(traces.left(), Vec::<String>::new(), "at once");
        }
    }

    #[test]
    fn module_that_is_killed_leaves_nothing() {
        let _turn = alone();
        let (module, traces) = run();
        drop(module); // by SIGKILL, with its supervisor
        traces.expect_gone();
    }

    #[test]
    fn module_that_is_killed_with_its_guard_is_cleaned_up_by_the_next_start() {
        let _turn = alone();
        let (module, traces) = run();
        let guard = process_named(module.pid(), "guard");
        guard.signal(Signal::KILL);
        drop(module); // by SIGKILL, with its supervisor
        // What holds memory and groups is gone with the executive, but nobody removes the names.
        assert!(!traces.shared_memory().is_empty(), "without the guard something is left");
        let schedule = flight_schedule();
        let device = "command.device=/dev/nowhere";
        let next =
            ["run", "--fast", "--schedule", schedule.to_str().unwrap(), "--set", device, "--until", "0.2"];
        bateleur(&next).end().expect_code(0);
        traces.expect_gone();
    }

    #[test]
    fn next_start_leaves_a_living_module_alone() {
        let _turn = alone();
        let (module, traces) = run();
        let schedule = flight_schedule();
        let device = "command.device=/dev/nowhere";
        let next =
            ["run", "--fast", "--schedule", schedule.to_str().unwrap(), "--set", device, "--until", "0.2"];
        bateleur(&next).end().expect_code(0);
        assert!(
            traces.processes().iter().all(bateleur_tests::Process::is_alive),
            "{:#?}",
            traces.processes()
        );
        assert!(!traces.shared_memory().is_empty());
        module.signal(Signal::TERM);
        module.end().expect_code(0);
        traces.expect_gone();
    }
}
