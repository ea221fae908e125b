//! EH: the error handler.

use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, End};

use crate::bench::*;

#[test]
fn eh_01_handler_is_above_all_processes() {
    let (mut bench, p, _) = Bench::periodic(-1);
    bench.raise("x");
    bench.at(100);
    bench.handler_runs();
    assert_eq!(bench.state(p), ProcessState::Ready);
}

#[test]
fn eh_02_first_error_starts_it_and_others_are_appended() {
    let (mut bench, ..) = Bench::periodic(30);
    bench.at(100);
    bench.raise("x");
    let run = bench.dispatch();
    assert!(matches!(run, Dispatch::Run { life: 1, .. }));
    bench.at(130);
    assert_eq!(bench.dispatch(), run, "it is not started again");
}

#[test]
fn eh_03_handler_reads_until_nothing_is_left() {
    let (mut bench, ..) = Bench::periodic(30);
    bench.at(100);
    bench.raise("x");
    bench.at(130);
    let codes: Vec<ErrorCode> =
        std::iter::from_fn(|| bench.get_error_status().ok()).map(|error| error.error_code).collect();
    assert_eq!(codes, [ErrorCode::ApplicationError, ErrorCode::DeadlineMissed]);
}

#[test]
fn eh_04_handler_may_do_what_does_not_wait() {
    let (mut bench, p, a) = Bench::periodic(-1);
    bench.raise("x");
    assert_eq!((bench.suspend(a), bench.resume(a), bench.stop(a), bench.start(a)), (NE, NE, NE, NE));
    assert_eq!((bench.stop(p), bench.report_application_message(b"x")), (NE, NE));
    assert_eq!(bench.set_partition_mode(OperatingMode::Idle), NE);
}

#[test]
fn eh_05_what_the_handler_must_not_do() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, FIFO).unwrap();
    let event = bench.create_event("e").unwrap();
    bench.started("a", 10);
    bench.normal();
    bench.raise("x");
    let refused = [
        code(bench.wait_event(event, FOREVER)),
        code(bench.timed_wait(1)),
        code(bench.periodic_wait()),
        code(bench.suspend_self(1)),
        code(bench.acquire_mutex(mutex, 0)),
        code(bench.get_my_id()),
        code(bench.create_event("f")),
    ];
    assert_eq!(refused, [IM; 7]);
    assert_eq!([code(bench.lock_preemption()), code(bench.unlock_preemption()), bench.replenish(1)], [NA; 3]);
}

#[test]
fn eh_06_error_inside_of_it_is_the_partitions() {
    let (mut bench, ..) = Bench::periodic(-1);
    bench.raise("x");
    bench.fault(ErrorCode::MemoryViolation, 0);
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
}

#[test]
fn eh_07_stop_and_start_of_the_faulty_process_use_the_release_rules() {
    let (mut bench, p, _) = Bench::periodic(30);
    bench.at(130);
    bench.stop(p).unwrap();
    bench.start(p).unwrap();
    assert_eq!((bench.state(p), bench.deadline(p)), (ProcessState::Waiting, Some(230)));
}

#[test]
fn eh_08_errors_that_are_left_start_it_again() {
    let (mut bench, ..) = Bench::periodic(-1);
    bench.raise("x");
    bench.stop_self();
    assert!(matches!(bench.dispatch(), Dispatch::Run { who: bateleur_processes::Runner::Handler, life: 2 }));
    bench.get_error_status().unwrap();
    bench.stop_self();
    assert_ne!(bench.who(), Some(bateleur_processes::Runner::Handler));
}

#[test]
fn eh_09_faulty_process_that_nobody_stops_stays_faulted() {
    let (mut bench, p, a) = Bench::periodic(-1);
    bench.fault(ErrorCode::NumericError, 0);
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.at(100);
    if bench.end().is_none() {
        assert_eq!(bench.state(a), ProcessState::Faulted);
        bench.runs(p);
    }
}

/// A partition before NORMAL with an enabled error handler.
fn enabled() -> Bench {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    assert_eq!(bench.enable_error_handler(), NE);
    bench
}

#[test]
fn ehx_01_handler_that_is_enabled_serves_errors_before_normal() {
    let mut bench = Bench::new();
    assert_eq!(bench.enable_error_handler(), NA, "there is none");
    let mut bench = enabled();
    let main = bench.dispatch();
    assert_eq!(bench.raise_application_error(ErrorCode::ApplicationError, b"x"), NE);
    bench.handler_runs();
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.error_code, error.failed_process_id), (ErrorCode::ApplicationError, MAIN_PROCESS_ID));
    assert_eq!(bench.set_partition_mode(OperatingMode::Normal), IM, "the main process has not ended");
    bench.stop_self();
    assert_eq!((bench.dispatch(), bench.end()), (main, None), "the main process goes on");
    let process = bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.state(process), ProcessState::Running);
}

#[test]
fn fault_of_the_main_process_and_one_of_the_handler_are_the_partitions() {
    let mut bench = enabled();
    bench.fault(ErrorCode::MemoryViolation, 0);
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
    let mut bench = enabled();
    assert_eq!(bench.raise_application_error(ErrorCode::ApplicationError, b"x"), NE);
    bench.fault(ErrorCode::NumericError, 0);
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
}

#[test]
fn error_before_normal_is_the_partitions_while_the_handler_is_not_enabled() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    assert_eq!(bench.raise_application_error(ErrorCode::ApplicationError, b"x"), NE);
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
}
