//! PROC: process management, without starts.

use bateleur_processes::Runner;
use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn proc_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_process_id("a")), IC);
}

#[test]
fn proc_id_02_known_name() {
    let mut bench = Bench::new();
    let a = bench.created("a", 1);
    assert_eq!(bench.get_process_id("a"), Ok(a));
}

#[test]
fn proc_id_03_in_all_modes_and_the_caller_runs_on() {
    let (bench, a) = Bench::running();
    assert_eq!(bench.get_process_id("a"), Ok(a));
    bench.runs(a);
    let (bench, a) = Bench::in_handler();
    assert_eq!(bench.get_process_id("a"), Ok(a));
    bench.handler_runs();
}

#[test]
fn proc_id_04_main_process_and_handler_have_no_name() {
    let (bench, _) = Bench::in_handler();
    for name in ["", "main", "MAIN", "handler"] {
        assert_eq!(code(bench.get_process_id(name)), IC);
    }
}

#[test]
fn proc_stat_01_unknown_process() {
    assert_eq!(code(Bench::new().get_process_status(ProcessId(1))), IP);
}

#[test]
fn proc_stat_02_status_is_one_of_this_moment() {
    let mut bench = Bench::new();
    let a = bench.timed("a", 10, 100, 40);
    let status = bench.get_process_status(a).unwrap();
    assert_eq!((status.state, status.current_priority), (ProcessState::Dormant, 10));
    assert_eq!((status.attributes.period, status.attributes.time_capacity), (ms(100), ms(40)));
}

#[test]
fn proc_stat_03_suspended_processes_count_among_those_that_wait() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let b = bench.started("b", 20);
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.get_event_status(event).unwrap().waiting_processes, 0);
    bench.wait_for(event);
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_event_status(event).unwrap().waiting_processes, 1);
}

#[test]
fn proc_stat_04_caller_is_running() {
    let (bench, a) = Bench::running();
    assert_eq!(bench.state(a), ProcessState::Running);
}

#[test]
fn proc_stat_05_suspended_or_started_before_normal_is_waiting() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 5));
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.normal();
    assert_eq!(bench.state(b), ProcessState::Ready);
    bench.suspend(b).unwrap();
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.runs(a);
}

#[test]
fn proc_stat_06_dormant_or_unlimited_process_has_no_deadline() {
    let mut bench = Bench::new();
    let (limited, unlimited) = (bench.timed("a", 10, -1, 50), bench.timed("b", 5, -1, -1));
    assert_eq!(bench.deadline(limited), None);
    bench.start(limited).unwrap();
    bench.start(unlimited).unwrap();
    bench.normal();
    assert_eq!((bench.deadline(limited), bench.deadline(unlimited)), (Some(50), None));
}

#[test]
fn proc_stat_07_current_priority_is_that_of_the_mutex() {
    let (mut bench, a, mutex) = Bench::owner();
    assert_eq!(bench.priority(a), 200);
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.priority(a), 10);
}

#[test]
fn proc_prio_01_unknown_process() {
    assert_eq!(Bench::new().set_priority(ProcessId(1), 5), IP);
}

#[test]
fn proc_prio_02_priority_outside_1_to_239() {
    let (mut bench, a) = Bench::running();
    for priority in [i32::MIN, 0, 240] {
        assert_eq!(bench.set_priority(a, priority), IP);
    }
    assert_eq!((bench.set_priority(a, 1), bench.set_priority(a, 239)), (NE, NE));
}

#[test]
fn proc_prio_03_dormant_process() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.set_priority(b, 5), IM);
}

#[test]
fn proc_prio_04_owner_of_a_mutex_or_the_lock_changes_later() {
    let (mut bench, a, mutex) = Bench::owner();
    assert_eq!(bench.set_priority(a, 55), NE);
    assert_eq!(bench.priority(a), 200);
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.priority(a), 55);
    let (mut bench, a) = Bench::running();
    done(bench.lock_preemption());
    assert_eq!(bench.set_priority(a, 55), NE);
    assert_eq!(bench.priority(a), 10);
    assert_eq!(bench.unlock_preemption(), Ok(0));
    assert_eq!(bench.priority(a), 55);
}

#[test]
fn proc_prio_05_process_goes_behind_its_new_equals() {
    let mut bench = Bench::new();
    let (a, b, c) = (bench.started("a", 10), bench.started("b", 5), bench.started("c", 4));
    bench.normal();
    bench.set_priority(c, 5).unwrap();
    bench.runs(a);
    bench.set_priority(a, 5).unwrap();
    assert_eq!(bench.order(), [b, c, a]);
}

#[test]
fn proc_prio_06_waiting_process_keeps_its_place_or_is_sorted_anew() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 2, BY_PRIORITY).unwrap();
    let (b, c) = (bench.started("b", 30), bench.started("c", 20));
    let a = bench.started("a", 10);
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.runs(a);
    bench.set_priority(c, 40).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    assert!([Some(Runner::Process(b)), Some(Runner::Process(c))].contains(&bench.who()));
}

#[test]
fn proc_prio_07_base_priority_stays() {
    let (mut bench, a) = Bench::running();
    bench.set_priority(a, 99).unwrap();
    assert_eq!(bench.get_process_status(a).unwrap().attributes.base_priority, 10);
}

#[test]
fn proc_prio_08_started_process_in_start_mode() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 20));
    assert_eq!(bench.set_priority(a, 30), NE);
    bench.normal();
    assert_eq!(bench.order(), [a, b]);
}

#[test]
fn proc_stopself_01_caller_is_dormant() {
    let (mut bench, a) = Bench::running();
    bench.stop_self();
    assert_eq!(bench.state(a), ProcessState::Dormant);
    bench.nobody_runs();
}

#[test]
fn proc_stopself_02_preemption_lock_of_the_caller_is_given_back() {
    let mut bench = Bench::new();
    let (_, b) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    done(bench.lock_preemption());
    bench.stop_self();
    assert_eq!(bench.get_partition_status().lock_level, 0);
    bench.runs(b);
    assert_eq!(done(bench.lock_preemption()), 1);
}

#[test]
fn proc_stopself_03_mutex_of_the_caller_stays_or_is_released() {
    let (mut bench, a, mutex) = Bench::owner();
    bench.stop_self();
    let owner = bench.get_mutex_status(mutex).unwrap().mutex_owner;
    assert!([a, NULL_PROCESS_ID].contains(&owner));
}

#[test]
fn proc_stopself_04_deadline_is_off() {
    let mut bench = Bench::new();
    let a = bench.timed("a", 10, -1, 50);
    bench.start(a).unwrap();
    bench.normal();
    bench.stop_self();
    assert_eq!(bench.next_timer(), None);
    assert_eq!(bench.deadline(a), None);
}

#[test]
fn proc_stopself_05_handler_ends_its_run() {
    let (mut bench, a) = Bench::in_handler();
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.runs(a);
}

#[test]
fn proc_stopself_06_main_process_leaves_a_partition_in_which_nothing_runs() {
    let mut bench = Bench::new();
    bench.started("a", 10);
    bench.stop_self();
    bench.at(500);
    bench.nobody_runs();
    assert_eq!(bench.get_partition_status().operating_mode, OperatingMode::ColdStart);
}

#[test]
fn proc_stop_01_unknown_process_or_oneself() {
    let (mut bench, a) = Bench::running();
    assert_eq!((bench.stop(ProcessId(77)), bench.stop(a)), (IP, IP));
}

#[test]
fn proc_stop_02_error_handler_can_not_be_named() {
    let (mut bench, _) = Bench::in_handler();
    for id in [NULL_PROCESS_ID, MAIN_PROCESS_ID, ProcessId(2)] {
        one_of(bench.stop(id), &[IP, NV]);
    }
}

#[test]
fn proc_stop_03_dormant_process() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.stop(b), NA);
}

#[test]
fn proc_stop_04_process_leaves_everything_and_takes_nothing() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let b = bench.timed("b", 20, -1, 90);
    bench.start(b).unwrap();
    bench.started("a", 10);
    bench.normal();
    waits(bench.wait_semaphore(semaphore, ms(50)));
    bench.suspend(b).unwrap();
    assert_eq!(bench.stop(b), NE);
    assert_eq!((bench.state(b), bench.deadline(b)), (ProcessState::Dormant, None));
    assert_eq!(
        (bench.get_semaphore_status(semaphore).unwrap().waiting_processes, bench.next_timer()),
        (0, None)
    );
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().current_value, 1);
}

#[test]
fn proc_stop_05_lock_of_the_stopped_is_free() {
    let (mut bench, a) = Bench::in_handler();
    bench.get_error_status().unwrap();
    bench.stop_self();
    done(bench.lock_preemption());
    bench.raise("again");
    bench.stop(a).unwrap();
    assert_eq!(bench.get_partition_status().lock_level, 0);
}

#[test]
fn proc_stop_06_mutex_of_the_stopped_stays_or_is_released() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let mutex = bench.create_mutex("m", 50, FIFO).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.raise("x");
    bench.stop(a).unwrap();
    assert!([a, NULL_PROCESS_ID].contains(&bench.get_mutex_status(mutex).unwrap().mutex_owner));
}

#[test]
fn proc_stop_07_faulted_process_can_be_stopped() {
    let (mut bench, a) = Bench::in_handler();
    bench.stop_self();
    bench.stop_self_after_reading(a);
    assert_eq!(bench.stop(a), NE);
    assert_eq!(bench.state(a), ProcessState::Dormant);
}

#[test]
fn proc_stop_08_in_start_mode() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 5));
    assert_eq!(bench.stop(a), NE);
    bench.normal();
    assert_eq!(bench.order(), [b]);
}

impl Bench {
    /// The error handler, which runs, reads all errors and ends; then process `a` divides by zero, and the handler reads that.
    pub(crate) fn stop_self_after_reading(&mut self, a: ProcessId) {
        while self.get_error_status().is_ok() {}
        self.stop_self();
        self.runs(a);
        self.fault(ErrorCode::NumericError, 0);
        self.get_error_status().unwrap();
    }
}
