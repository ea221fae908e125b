//! PROC: the preemption lock, identifiers and cores.

use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn proc_lock_01_not_in_the_handler_nor_before_normal() {
    let mut bench = Bench::new();
    assert_eq!(code(bench.lock_preemption()), NA);
    let (mut bench, _) = Bench::in_handler();
    assert_eq!(code(bench.lock_preemption()), NA);
    assert_eq!(bench.get_partition_status().lock_level, 0);
}

#[test]
fn proc_lock_02_owner_of_a_mutex() {
    let (mut bench, ..) = Bench::owner();
    one_of(code(bench.lock_preemption()), &[IM, NE]);
}

#[test]
fn proc_lock_03_seventeenth_level() {
    let (mut bench, _) = Bench::running();
    for level in 1..=16 {
        assert_eq!(done(bench.lock_preemption()), level);
    }
    assert_eq!(code(bench.lock_preemption()), IC);
    assert_eq!(bench.get_partition_status().lock_level, 16);
}

#[test]
fn proc_lock_04_free_lock_has_the_caller_as_owner() {
    let (mut bench, a) = Bench::running();
    assert_eq!(done(bench.lock_preemption()), 1);
    assert_eq!(bench.get_process_mutex_state(a), Ok(PREEMPTION_LOCK_MUTEX));
}

#[test]
fn proc_lock_05_owner_counts_on() {
    let (mut bench, _) = Bench::running();
    done(bench.lock_preemption());
    assert_eq!(done(bench.lock_preemption()), 2);
}

#[test]
fn proc_lock_06_lock_of_another_is_waited_for() {
    let (mut bench, a, b) = Bench::faulted_locker();
    waits(bench.lock_preemption());
    bench.nobody_runs();
    assert_eq!(bench.state(b), ProcessState::Waiting);
    assert_eq!(bench.get_process_mutex_state(a), Ok(PREEMPTION_LOCK_MUTEX));
}

#[test]
fn proc_unlock_01_nothing_to_unlock() {
    assert_eq!(code(Bench::new().unlock_preemption()), NA);
    assert_eq!(code(Bench::running().0.unlock_preemption()), NA);
    let (mut bench, _) = Bench::in_handler();
    assert_eq!(code(bench.unlock_preemption()), NA);
}

#[test]
fn proc_unlock_02_caller_is_not_the_owner() {
    let (mut bench, ..) = Bench::faulted_locker();
    assert_eq!(code(bench.unlock_preemption()), IM);
}

#[test]
fn proc_unlock_03_inner_level() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.created("b", 20));
    bench.normal();
    done(bench.lock_preemption());
    done(bench.lock_preemption());
    bench.start(b).unwrap();
    assert_eq!(bench.unlock_preemption(), Ok(1));
    bench.runs(a);
}

#[test]
fn proc_unlock_04_last_level_lets_the_most_urgent_run() {
    let (mut bench, a, b) = Bench::pair();
    done(bench.lock_preemption());
    bench.start(b).unwrap();
    bench.runs(a);
    assert_eq!(bench.unlock_preemption(), Ok(0));
    bench.runs(b);
}

impl Bench {
    /// Process `a` has faulted with the preemption lock, the handler has read that and ended, and `b` runs.
    fn faulted_locker() -> (Self, ProcessId, ProcessId) {
        let mut bench = Self::new();
        bench.create_error_handler(STACK).unwrap();
        let (a, b) = (bench.started("a", 20), bench.started("b", 10));
        bench.normal();
        done(bench.lock_preemption());
        bench.fault(ErrorCode::NumericError, 0);
        bench.get_error_status().unwrap();
        bench.stop_self();
        bench.runs(b);
        (bench, a, b)
    }
}

#[test]
fn proc_myid_01_handler_has_no_identifier() {
    assert_eq!(code(Bench::in_handler().0.get_my_id()), IM);
}

#[test]
fn proc_myid_02_main_process_has_none_or_its_own() {
    one_of(code(Bench::new().get_my_id()), &[IM, NE]);
}

#[test]
fn proc_myid_03_process() {
    let (bench, a) = Bench::running();
    assert_eq!(bench.get_my_id(), Ok(a));
}

#[test]
fn proc_aff_01_unknown_process() {
    assert_eq!(Bench::new().initialize_process_core_affinity(ProcessId(1), 0), IP);
}

#[test]
fn proc_aff_02_core_that_the_partition_does_not_have() {
    let mut bench = Bench::new();
    let a = bench.created("a", 1);
    assert_eq!(bench.initialize_process_core_affinity(a, 1), IC);
    assert_eq!(bench.initialize_process_core_affinity(a, -1), IC);
}

#[test]
fn proc_aff_03_not_in_normal() {
    let (mut bench, a) = Bench::running();
    assert_eq!(bench.initialize_process_core_affinity(a, 0), IM);
}

#[test]
fn proc_aff_04_affinity_holds_in_normal() {
    let mut bench = Bench::new();
    let a = bench.started("a", 1);
    assert_eq!(bench.initialize_process_core_affinity(a, 0), NE);
    bench.normal();
    assert_eq!(bench.get_my_processor_core_id(), 0);
}

#[test]
fn proc_core_01_every_caller_has_a_core() {
    assert_eq!(Bench::new().get_my_processor_core_id(), 0);
    assert_eq!(Bench::running().0.get_my_processor_core_id(), 0);
    assert_eq!(Bench::in_handler().0.get_my_processor_core_id(), 0);
}

#[test]
fn proc_idx_01_handler_and_main_process_have_no_index() {
    assert_eq!(code(Bench::new().get_my_index()), IM);
    assert_eq!(code(Bench::in_handler().0.get_my_index()), IM);
}

#[test]
fn proc_idx_02_index_is_unique() {
    let mut bench = Bench::new();
    bench.started("a", 10);
    bench.started("b", 5);
    bench.normal();
    let first = bench.get_my_index().unwrap();
    bench.stop_self();
    assert_ne!(bench.get_my_index().unwrap(), first);
}
