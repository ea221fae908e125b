//! LK, MX: what the preemption lock and mutexes do to scheduling.

use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn lk_01_lock_stops_switching_between_processes() {
    let (mut bench, p, a) = Bench::periodic(-1);
    done(bench.lock_preemption());
    bench.at(150);
    bench.runs(a);
    bench.unlock_preemption().unwrap();
    bench.runs(p);
}

#[test]
fn lk_03_handler_preempts_the_owner() {
    let (mut bench, ..) = Bench::periodic(-1);
    done(bench.lock_preemption());
    bench.raise("x");
    bench.handler_runs();
}

#[test]
fn lk_04_woken_process_waits_for_the_unlock() {
    let (mut bench, semaphore, b, a) = Bench::waiting(FOREVER);
    done(bench.lock_preemption());
    assert_eq!(bench.signal_semaphore(semaphore), NE);
    bench.runs(a);
    bench.unlock_preemption().unwrap();
    bench.runs(b);
}

#[test]
fn lk_05_owner_must_not_wait() {
    let (mut bench, semaphore, ..) = Bench::waiting(FOREVER);
    done(bench.lock_preemption());
    assert_eq!(code(bench.wait_semaphore(semaphore, FOREVER)), IM);
    assert_eq!((code(bench.timed_wait(0)), code(bench.timed_wait(1))), (IM, IM));
    assert_eq!((code(bench.periodic_wait()), code(bench.suspend_self(1))), (IM, IM));
}

#[test]
fn lk_06_stopped_owner_gives_the_lock_back() {
    let (mut bench, p, a) = Bench::periodic(-1);
    done(bench.lock_preemption());
    bench.at(100);
    bench.raise("x");
    bench.stop(a).unwrap();
    bench.get_error_status().unwrap();
    bench.stop_self();
    assert_eq!(bench.get_partition_status().lock_level, 0);
    bench.runs(p);
}

#[test]
fn lk_07_faulted_owner_keeps_the_lock_until_it_is_stopped_or_the_lock_is_reset() {
    for stop in [true, false] {
        let (mut bench, _, a) = Bench::periodic(-1);
        done(bench.lock_preemption());
        bench.fault(ErrorCode::NumericError, 0);
        assert_eq!(bench.get_partition_status().lock_level, 1);
        if stop {
            bench.stop(a).unwrap();
        } else {
            bench.reset_mutex(PREEMPTION_LOCK_MUTEX, a).unwrap();
        }
        assert_eq!(bench.get_partition_status().lock_level, 0);
    }
}

#[test]
fn lk_08_lock_counts_from_1_to_16() {
    let (mut bench, _) = Bench::running();
    (1..=16).for_each(|level| assert_eq!(done(bench.lock_preemption()), level));
    (0..16).rev().for_each(|level| assert_eq!(bench.unlock_preemption(), Ok(level)));
    assert_eq!(code(bench.unlock_preemption()), NA);
}

#[test]
fn mx_01_one_mutex_for_each_process_and_the_lock_is_one() {
    let (mut bench, ..) = Bench::owner();
    assert_eq!(code(bench.lock_preemption()), IM);
}

#[test]
fn mx_02_owner_has_the_priority_of_the_mutex_even_if_nobody_waits() {
    let (bench, a, _) = Bench::owner();
    assert_eq!(bench.priority(a), 200);
}

#[test]
fn mx_03_equal_priority_does_not_preempt_the_owner() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 20, FIFO).unwrap();
    let (a, b) = (bench.started("a", 10), bench.created("b", 20));
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.start(b).unwrap();
    bench.runs(a);
    bench.release_mutex(mutex).unwrap();
    bench.runs(b);
}

#[test]
fn mx_04_priority_that_an_owner_is_given_holds_from_the_release_on() {
    let (mut bench, a, mutex) = Bench::owner();
    bench.set_priority(a, 33).unwrap();
    assert_eq!(bench.priority(a), 200);
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.priority(a), 33);
}

#[test]
fn mx_05_owner_does_not_wait() {
    let (mut bench, ..) = Bench::owner();
    assert_eq!((code(bench.timed_wait(1)), code(bench.suspend_self(1))), (IM, IM));
}

#[test]
fn mx_06_owner_and_who_waits_for_a_mutex_can_not_be_suspended() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, FIFO).unwrap();
    let (a, b) = (bench.started("a", 20), bench.started("b", 10));
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.fault(ErrorCode::NumericError, 0);
    bench.get_error_status().unwrap();
    bench.stop_self();
    waits(bench.acquire_mutex(mutex, FOREVER));
    bench.fault(ErrorCode::PowerFail, 0);
    bench.resume(a).unwrap();
    assert_eq!((bench.suspend(a), bench.suspend(b)), (IM, IM));
}

/// `a` (20) has faulted with a mutex of priority 50; `b` (10), then `c` (15) wait for it; the handler runs.
fn contended(discipline: u32) -> (Bench, MutexId, [ProcessId; 3]) {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, discipline).unwrap();
    let a = bench.started("a", 20);
    let (b, c) = (bench.started("b", 10), bench.created("c", 15));
    bench.delayed_start(c, ms(1)).unwrap();
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.fault(ErrorCode::NumericError, 0);
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.runs(b);
    waits(bench.acquire_mutex(mutex, FOREVER));
    bench.at(1);
    bench.runs(c);
    waits(bench.acquire_mutex(mutex, FOREVER));
    bench.fault(ErrorCode::PowerFail, 0);
    (bench, mutex, [a, b, c])
}

#[test]
fn mx_07_waiting_processes_are_served_by_discipline_without_a_free_moment() {
    for (discipline, place) in [(FIFO, 1), (BY_PRIORITY, 2)] {
        let (mut bench, mutex, ids) = contended(discipline);
        bench.reset_mutex(mutex, ids[0]).unwrap();
        assert_eq!(bench.get_mutex_status(mutex).unwrap().mutex_owner, ids[place]);
    }
}

#[test]
fn mx_08_time_does_not_release_a_mutex() {
    let (mut bench, a, mutex) = Bench::owner();
    bench.at(100_000);
    assert_eq!(bench.get_mutex_status(mutex).unwrap().mutex_owner, a);
}

#[test]
fn mx_09_queue_forms_behind_an_owner_that_has_faulted_or_was_stopped() {
    let (mut bench, mutex, ids) = contended(FIFO);
    assert_eq!(bench.get_mutex_status(mutex).unwrap().waiting_processes, 2);
    bench.stop(ids[0]).unwrap();
    assert!(bench.get_mutex_status(mutex).unwrap().mutex_state == MutexState::Owned);
}
