//! MTX: mutexes.

use bateleur_processes::standard::*;

use crate::bench::*;

/// Process `a` (20) has faulted with mutex `m` (priority 50, waiting by priority), the handler has read that and ended, and `b` (10) runs.
fn faulted_owner() -> (Bench, MutexId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, BY_PRIORITY).unwrap();
    let (a, b) = (bench.started("a", 20), bench.started("b", 10));
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.fault(ErrorCode::NumericError, 0);
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.runs(b);
    (bench, mutex, a, b)
}

/// In the same case the error handler runs again, because `b` has raised an error.
fn faulted_owner_and_handler() -> (Bench, MutexId, ProcessId, ProcessId) {
    let (mut bench, mutex, a, b) = faulted_owner();
    bench.raise("mutex is lost");
    (bench, mutex, a, b)
}

fn status(bench: &Bench, mutex: MutexId) -> MutexStatus {
    bench.get_mutex_status(mutex).unwrap()
}

#[test]
fn mtx_create_01_too_many() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 0);
    assert_eq!(code(bench.create_mutex("m", 1, FIFO)), IC);
}

#[test]
fn mtx_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_mutex("m", 1, FIFO).unwrap();
    assert_eq!(code(bench.create_mutex("m", 1, FIFO)), NA);
}

#[test]
fn mtx_create_03_priority() {
    for priority in [0, 240, -1] {
        assert_eq!(code(Bench::new().create_mutex("m", priority, FIFO)), IP, "{priority}");
    }
}

#[test]
fn mtx_create_04_discipline() {
    assert_eq!(code(Bench::new().create_mutex("m", 1, NONSENSE)), IP);
}

#[test]
fn mtx_create_05_not_in_normal() {
    assert_eq!(code(Bench::running().0.create_mutex("m", 1, FIFO)), IM);
}

#[test]
fn mtx_create_06_new_mutex_is_available() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 7, FIFO).unwrap();
    let status = status(&bench, mutex);
    assert_eq!((status.mutex_state, status.lock_count), (MutexState::Available, 0));
}

#[test]
fn mtx_acq_01_unknown_mutex() {
    assert_eq!(code(Bench::running().0.acquire_mutex(MutexId(1), 0)), IP);
}

#[test]
fn mtx_acq_02_preemption_lock() {
    assert_eq!(code(Bench::running().0.acquire_mutex(PREEMPTION_LOCK_MUTEX, 0)), IP);
}

#[test]
fn mtx_acq_03_time_out_out_of_range() {
    let (mut bench, _, mutex) = Bench::owner();
    bench.release_mutex(mutex).unwrap();
    bench.at(1);
    assert_eq!(code(bench.acquire_mutex(mutex, SystemTime::MAX)), IP);
}

#[test]
fn mtx_acq_04_owner_of_another() {
    let mut bench = Bench::new();
    let one = bench.create_mutex("one", 20, FIFO).unwrap();
    let two = bench.create_mutex("two", 20, FIFO).unwrap();
    bench.started("a", 10);
    bench.normal();
    done(bench.acquire_mutex(one, 0));
    assert_eq!(code(bench.acquire_mutex(two, 0)), IM);
    bench.release_mutex(one).unwrap();
    done(bench.lock_preemption());
    assert_eq!(code(bench.acquire_mutex(one, 0)), IM, "the lock counts");
}

#[test]
fn mtx_acq_05_error_handler() {
    let (mut bench, mutex, ..) = faulted_owner_and_handler();
    assert_eq!(code(bench.acquire_mutex(mutex, 0)), IM);
}

#[test]
fn mtx_acq_06_caller_is_more_urgent_than_the_mutex() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 9, FIFO).unwrap();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(code(bench.acquire_mutex(mutex, 0)), IM);
}

#[test]
fn mtx_acq_07_available_mutex_is_the_callers() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 20, FIFO).unwrap();
    let (a, equal) = (bench.started("a", 10), bench.created("b", 20));
    bench.normal();
    done(bench.acquire_mutex(mutex, FOREVER));
    bench.start(equal).unwrap();
    bench.runs(a);
    let status = status(&bench, mutex);
    assert_eq!((status.mutex_owner, status.lock_count, bench.priority(a)), (a, 1, 20));
}

#[test]
fn mtx_acq_08_seventeenth_time() {
    let (mut bench, _, mutex) = Bench::owner();
    for _ in 2..=16 {
        done(bench.acquire_mutex(mutex, 0));
    }
    assert_eq!(code(bench.acquire_mutex(mutex, 0)), IC);
    assert_eq!(status(&bench, mutex).lock_count, 16);
}

#[test]
fn mtx_acq_09_owner_counts_on() {
    let (mut bench, _, mutex) = Bench::owner();
    done(bench.acquire_mutex(mutex, FOREVER));
    assert_eq!(status(&bench, mutex).lock_count, 2);
}

#[test]
fn mtx_acq_10_owned_and_no_waiting() {
    let (mut bench, mutex, ..) = faulted_owner();
    assert_eq!(code(bench.acquire_mutex(mutex, 0)), NV);
}

#[test]
fn mtx_acq_11_handed_over_in_time() {
    let (mut bench, mutex, a, b) = faulted_owner_and_handler();
    bench.get_error_status().unwrap();
    bench.stop_self();
    waits(bench.acquire_mutex(mutex, ms(10)));
    bench.nobody_runs();
    bench.fault(ErrorCode::PowerFail, 0);
    bench.handler_runs();
    bench.reset_mutex(mutex, a).unwrap();
    while bench.get_error_status().is_ok() {}
    bench.stop_self();
    bench.runs(b);
    assert_eq!((bench.result(), bench.next_timer(), bench.priority(b)), (NE, None, 50));
}

#[test]
fn mtx_acq_12_not_handed_over_in_time() {
    let (mut bench, mutex, _, b) = faulted_owner();
    waits(bench.acquire_mutex(mutex, ms(10)));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn mtx_acq_13_main_process_may_own_one() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 7, FIFO).unwrap();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(status(&bench, mutex).mutex_owner, MAIN_PROCESS_ID);
    assert_eq!(bench.release_mutex(mutex), NE);
}

#[test]
fn mtx_rel_01_unknown_mutex() {
    assert_eq!(Bench::running().0.release_mutex(MutexId(1)), IP);
}

#[test]
fn mtx_rel_02_preemption_lock() {
    assert_eq!(Bench::running().0.release_mutex(PREEMPTION_LOCK_MUTEX), IP);
}

#[test]
fn mtx_rel_03_caller_is_not_the_owner() {
    let (mut bench, mutex, ..) = faulted_owner();
    assert_eq!(bench.release_mutex(mutex), IM);
    bench.raise("x");
    assert_eq!(bench.release_mutex(mutex), IM, "the handler owns none");
    let (mut bench, _, mutex) = Bench::owner();
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.release_mutex(mutex), IM, "nobody owns it");
}

#[test]
fn mtx_rel_04_inner_release() {
    let (mut bench, a, mutex) = Bench::owner();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(bench.release_mutex(mutex), NE);
    assert_eq!((status(&bench, mutex).mutex_owner, bench.priority(a)), (a, 200));
}

#[test]
fn mtx_rel_05_last_release_puts_the_caller_before_its_equals() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 20, FIFO).unwrap();
    let (a, _) = (bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(bench.release_mutex(mutex), NE);
    bench.runs(a);
    assert_eq!(bench.priority(a), 10);
}

#[test]
fn mtx_rel_06_first_who_waits_owns_it() {
    let (mut bench, mutex, a, b) = faulted_owner();
    waits(bench.acquire_mutex(mutex, FOREVER));
    bench.fault(ErrorCode::PowerFail, 0);
    bench.get_error_status().unwrap();
    bench.resume(a).unwrap();
    bench.stop_self();
    bench.runs(a);
    assert_eq!(bench.release_mutex(mutex), NE);
    bench.runs(b);
    let status = status(&bench, mutex);
    assert_eq!((status.mutex_owner, status.lock_count, status.waiting_processes), (b, 1, 0));
    assert_eq!(bench.release_mutex(mutex), NE);
    assert_eq!(self::status(&bench, mutex).mutex_state, MutexState::Available);
    bench.runs(a);
}

#[test]
fn mtx_reset_01_unknown_mutex() {
    let (mut bench, _, a, _) = faulted_owner_and_handler();
    assert_eq!(bench.reset_mutex(MutexId(1), a), IP);
}

#[test]
fn mtx_reset_02_preemption_lock() {
    let (mut bench, a) = Bench::running();
    done(bench.lock_preemption());
    assert_eq!(bench.reset_mutex(PREEMPTION_LOCK_MUTEX, a), IP);
    let (mut bench, a) = Bench::in_handler();
    bench.get_error_status().unwrap();
    bench.stop_self();
    done(bench.lock_preemption());
    bench.raise("x");
    one_of(bench.reset_mutex(PREEMPTION_LOCK_MUTEX, a), &[IP, NE]);
}

#[test]
fn mtx_reset_03_unknown_process() {
    let (mut bench, mutex, ..) = faulted_owner_and_handler();
    assert_eq!(bench.reset_mutex(mutex, ProcessId(77)), IP);
}

#[test]
fn mtx_reset_04_process_does_not_own_it() {
    let (mut bench, mutex, _, b) = faulted_owner_and_handler();
    assert_eq!(bench.reset_mutex(mutex, b), IM);
}

#[test]
fn mtx_reset_05_caller_is_a_third() {
    let (mut bench, mutex, a, _) = faulted_owner();
    one_of(bench.reset_mutex(mutex, a), &[IM, NE]);
}

#[test]
fn mtx_reset_06_before_normal() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 7, FIFO).unwrap();
    done(bench.acquire_mutex(mutex, 0));
    one_of(bench.reset_mutex(mutex, MAIN_PROCESS_ID), &[IM, NE]);
}

#[test]
fn mtx_reset_07_mutex_is_free_and_the_priority_is_back() {
    let (mut bench, mutex, a, _) = faulted_owner_and_handler();
    assert_eq!(bench.reset_mutex(mutex, a), NE);
    assert_eq!((status(&bench, mutex).lock_count, bench.priority(a)), (0, 20));
    let (mut bench, a, mutex) = Bench::owner();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(bench.reset_mutex(mutex, a), NE, "by the owner itself, from any count");
    assert_eq!((status(&bench, mutex).mutex_owner, bench.priority(a)), (NULL_PROCESS_ID, 10));
}

#[test]
fn mtx_reset_08_frees_what_a_stopped_or_faulted_process_left() {
    let (mut bench, mutex, a, _) = faulted_owner_and_handler();
    bench.stop(a).unwrap();
    if status(&bench, mutex).mutex_owner == a {
        assert_eq!(bench.reset_mutex(mutex, a), NE);
    }
    assert_eq!(status(&bench, mutex).mutex_state, MutexState::Available);
}

#[test]
fn mtx_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_mutex_id("m")), IC);
}

#[test]
fn mtx_id_02_known_name() {
    let (bench, _, mutex) = Bench::owner();
    assert_eq!(bench.get_mutex_id("m"), Ok(mutex));
}

#[test]
fn mtx_id_03_in_all_modes_and_the_caller_runs_on() {
    assert_eq!(code(Bench::new().get_mutex_id("m")), IC);
    let (bench, a, mutex) = Bench::owner();
    assert_eq!(bench.get_mutex_id("m"), Ok(mutex));
    bench.runs(a);
}

#[test]
fn mtx_stat_01_unknown_mutex() {
    assert_eq!(code(Bench::new().get_mutex_status(MutexId(1))), IP);
}

#[test]
fn mtx_stat_02_status_is_one_of_this_moment() {
    let (bench, a, mutex) = Bench::owner();
    let expected = MutexStatus {
        mutex_owner: a,
        mutex_state: MutexState::Owned,
        mutex_priority: 200,
        lock_count: 1,
        waiting_processes: 0,
    };
    assert_eq!(status(&bench, mutex), expected);
}

#[test]
fn mtx_stat_03_processes_that_wait_are_counted() {
    let (mut bench, mutex, ..) = faulted_owner();
    waits(bench.acquire_mutex(mutex, FOREVER));
    assert_eq!(status(&bench, mutex).waiting_processes, 1);
}

#[test]
fn mtx_stat_04_available_mutex_has_no_owner() {
    let (mut bench, _, mutex) = Bench::owner();
    bench.release_mutex(mutex).unwrap();
    assert_eq!(status(&bench, mutex).mutex_owner, NULL_PROCESS_ID);
}

#[test]
fn mtx_proc_01_unknown_process() {
    let bench = Bench::new();
    assert_eq!(code(bench.get_process_mutex_state(ProcessId(1))), IP);
    assert_eq!(bench.get_process_mutex_state(MAIN_PROCESS_ID), Ok(NO_MUTEX_OWNED));
}

#[test]
fn mtx_proc_02_owner_of_the_preemption_lock() {
    let (mut bench, a) = Bench::running();
    done(bench.lock_preemption());
    assert_eq!(bench.get_process_mutex_state(a), Ok(PREEMPTION_LOCK_MUTEX));
}

#[test]
fn mtx_proc_03_owner_of_a_mutex() {
    let (bench, a, mutex) = Bench::owner();
    assert_eq!(bench.get_process_mutex_state(a), Ok(mutex));
}

#[test]
fn mtx_proc_04_owner_of_none() {
    let (bench, a) = Bench::running();
    assert_eq!(bench.get_process_mutex_state(a), Ok(NO_MUTEX_OWNED));
}
