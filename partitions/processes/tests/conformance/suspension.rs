//! PROC: suspension.

use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn proc_suspself_01_owner_and_handler_must_not() {
    let (mut bench, ..) = Bench::owner();
    assert_eq!(code(bench.suspend_self(FOREVER)), IM);
    let (mut bench, _) = Bench::in_handler();
    assert_eq!(code(bench.suspend_self(FOREVER)), IM);
}

#[test]
fn proc_suspself_02_time_out_out_of_range() {
    let (mut bench, _) = Bench::running();
    bench.at(1);
    assert_eq!(code(bench.suspend_self(SystemTime::MAX)), IP);
}

#[test]
fn proc_suspself_03_periodic_process_must_not() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 10, 100, -1);
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    assert_eq!(code(bench.suspend_self(FOREVER)), IM);
}

#[test]
fn proc_suspself_04_time_out_0_returns_at_once() {
    let mut bench = Bench::new();
    let (a, _) = (bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    done(bench.suspend_self(0));
    bench.runs(a);
}

#[test]
fn proc_suspself_05_without_time_out_until_resume() {
    let mut bench = Bench::new();
    let (a, _) = (bench.started("a", 20), bench.started("b", 10));
    bench.normal();
    waits(bench.suspend_self(FOREVER));
    assert_eq!(bench.state(a), ProcessState::Waiting);
    bench.at(1000);
    assert_eq!(bench.state(a), ProcessState::Waiting);
    bench.resume(a).unwrap();
    bench.runs(a);
    assert_eq!(bench.result(), NE);
}

#[test]
fn proc_suspself_06_resume_before_the_time_out() {
    let mut bench = Bench::new();
    let (a, _) = (bench.started("a", 20), bench.started("b", 10));
    bench.normal();
    waits(bench.suspend_self(ms(10)));
    bench.at(5);
    bench.resume(a).unwrap();
    assert_eq!(bench.result(), NE);
    assert_eq!(bench.next_timer(), None);
}

#[test]
fn proc_suspself_07_time_out_ends_it() {
    let (mut bench, a) = Bench::running();
    waits(bench.suspend_self(ms(10)));
    bench.at(9);
    bench.nobody_runs();
    bench.at(10);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
    assert_eq!(bench.state(a), ProcessState::Running);
}

#[test]
fn proc_suspself_08_main_process_must_not() {
    assert_eq!(code(Bench::new().suspend_self(FOREVER)), IM);
}

#[test]
fn proc_susp_01_owner_or_one_who_waits_for_a_mutex() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, FIFO).unwrap();
    let (a, b) = (bench.started("a", 20), bench.started("b", 10));
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.fault(ErrorCode::NumericError, 0);
    bench.get_error_status().unwrap();
    bench.resume(a).unwrap();
    assert_eq!(bench.suspend(a), IM, "owns it");
    bench.stop(a).unwrap();
    bench.stop_self();
    bench.runs(b);
    waits(bench.acquire_mutex(mutex, FOREVER));
    bench.fault(ErrorCode::PowerFail, 0);
    assert_eq!(bench.suspend(b), IM, "waits for it");
    let (mut bench, a) = Bench::in_handler();
    bench.get_error_status().unwrap();
    bench.stop_self();
    done(bench.lock_preemption());
    bench.raise("again");
    assert_eq!(bench.suspend(a), IM, "owns the lock");
}

#[test]
fn proc_susp_02_unknown_process_or_oneself() {
    let (mut bench, a) = Bench::running();
    assert_eq!((bench.suspend(ProcessId(77)), bench.suspend(a)), (IP, IP));
}

#[test]
fn proc_susp_03_dormant_or_faulted_process() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.suspend(b), IM);
    let (mut bench, a) = Bench::in_handler();
    bench.stop_self();
    bench.stop_self_after_reading(a);
    assert_eq!(bench.suspend(a), IM);
}

#[test]
fn proc_susp_04_periodic_process() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.suspend(p), IM);
}

#[test]
fn proc_susp_05_suspended_process() {
    let mut bench = Bench::new();
    let (_, b) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    assert_eq!((bench.suspend(b), bench.suspend(b)), (NE, NA));
}

#[test]
fn proc_susp_06_ready_process_waits() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    bench.suspend(b).unwrap();
    assert_eq!(bench.order(), [a]);
    assert_eq!(bench.state(b), ProcessState::Waiting);
}

#[test]
fn proc_susp_07_waiting_process_is_suspended_as_well() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    bench.wait_for(event);
    assert_eq!(bench.suspend(b), NE);
    bench.set_event(event).unwrap();
    bench.runs(a);
    bench.resume(b).unwrap();
    bench.runs(b);
}

#[test]
fn proc_susp_08_process_started_before_normal_stays_suspended() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 20));
    assert_eq!(bench.suspend(b), NE);
    bench.normal();
    bench.runs(a);
    bench.resume(b).unwrap();
    bench.runs(b);
}

#[test]
fn proc_resume_01_unknown_process_or_oneself() {
    let (mut bench, a) = Bench::running();
    assert_eq!((bench.resume(ProcessId(77)), bench.resume(a)), (IP, IP));
}

#[test]
fn proc_resume_02_dormant_process() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.resume(b), IM);
}

#[test]
fn proc_resume_03_periodic_process_that_has_not_faulted() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.resume(p), IM);
}

#[test]
fn proc_resume_04_process_that_is_neither_suspended_nor_faulted() {
    let mut bench = Bench::new();
    let (_, b) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    assert_eq!(bench.resume(b), NA);
}

#[test]
fn proc_resume_05_process_that_waits_for_more_stays_waiting() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    bench.wait_for(event);
    bench.suspend(b).unwrap();
    assert_eq!(bench.resume(b), NE);
    bench.runs(a);
    assert_eq!((bench.state(b), bench.resume(b)), (ProcessState::Waiting, NA));
    bench.set_event(event).unwrap();
    bench.runs(b);
}

#[test]
fn proc_resume_06_faulted_process_goes_on() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    let life = bench.dispatch();
    bench.fault(ErrorCode::NumericError, 0x10);
    bench.get_error_status().unwrap();
    assert_eq!(bench.state(p), ProcessState::Faulted);
    assert_eq!(bench.resume(p), NE);
    bench.stop_self();
    assert_eq!(bench.dispatch(), life, "not from its entry point");
}
