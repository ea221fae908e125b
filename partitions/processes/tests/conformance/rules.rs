//! SM, MODE: states and modes.

use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, End, PartitionAction};

use crate::bench::*;

#[test]
fn sm_01_created_process_is_dormant() {
    let mut bench = Bench::new();
    let a = bench.created("a", 10);
    assert_eq!(bench.state(a), ProcessState::Dormant);
}

#[test]
fn sm_02_started_process_may_have_to_wait() {
    let mut bench = Bench::new();
    let (a, p) = (bench.started("a", 10), bench.timed("p", 20, 100, -1));
    let d = bench.created("d", 30);
    assert_eq!(bench.state(a), ProcessState::Waiting);
    bench.normal();
    bench.start(p).unwrap();
    bench.delayed_start(d, 1).unwrap();
    assert_eq!((bench.state(p), bench.state(d)), (ProcessState::Waiting, ProcessState::Waiting));
}

#[test]
fn sm_03_aperiodic_process_started_in_normal_is_ready() {
    let mut bench = Bench::new();
    bench.started("a", 10);
    let b = bench.created("b", 5);
    bench.normal();
    bench.start(b).unwrap();
    assert_eq!(bench.state(b), ProcessState::Ready);
}

#[test]
fn sm_04_most_urgent_runs_and_among_equals_the_longest_ready() {
    let mut bench = Bench::new();
    let (a, b, c) = (bench.started("a", 10), bench.started("b", 20), bench.started("c", 10));
    bench.normal();
    assert_eq!(bench.order(), [b, a, c]);
}

#[test]
fn sm_05_preempted_process_stays_first_of_its_equals() {
    let mut bench = Bench::new();
    let (a, equal) = (bench.started("a", 10), bench.started("b", 10));
    let urgent = bench.created("c", 20);
    bench.normal();
    bench.start(urgent).unwrap();
    assert_eq!(bench.state(a), ProcessState::Ready);
    assert_eq!(bench.order(), [urgent, a, equal]);
}

#[test]
fn sm_06_who_gives_way_is_last_of_its_equals() {
    for by_priority in [false, true] {
        let mut bench = Bench::new();
        let (a, b) = (bench.started("a", 10), bench.started("b", 10));
        bench.normal();
        if by_priority {
            bench.set_priority(a, 10).unwrap();
        } else {
            done(bench.timed_wait(0));
        }
        assert_eq!(bench.order(), [b, a]);
    }
}

#[test]
fn sm_07_running_process_waits_by_each_waiting_service() {
    for service in 0..3 {
        let (mut bench, semaphore, _, a) = Bench::waiting(FOREVER);
        match service {
            0 => waits(bench.wait_semaphore(semaphore, FOREVER)),
            1 => waits(bench.timed_wait(1)),
            _ => waits(bench.suspend_self(FOREVER)),
        }
        assert_eq!(bench.state(a), ProcessState::Waiting);
    }
    let (mut bench, p, _) = Bench::periodic(-1);
    bench.at(100);
    waits(bench.periodic_wait());
    assert_eq!(bench.state(p), ProcessState::Waiting);
}

#[test]
fn sm_08_suspended_ready_process_waits() {
    let mut bench = Bench::new();
    bench.started("a", 10);
    let b = bench.started("b", 5);
    bench.normal();
    bench.suspend(b).unwrap();
    assert_eq!(bench.state(b), ProcessState::Waiting);
}

#[test]
fn sm_09_woken_process_is_last_of_its_equals() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (w, a, b) = (bench.started("w", 10), bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.runs(a);
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(bench.order(), [a, b, w]);
}

#[test]
fn sm_10_stopped_process_is_dormant_from_every_state() {
    let (mut bench, _, b, a) = Bench::waiting(FOREVER);
    bench.stop(b).unwrap();
    bench.stop_self();
    assert_eq!((bench.state(a), bench.state(b)), (ProcessState::Dormant, ProcessState::Dormant));
}

#[test]
fn sm_11_fault_makes_the_running_process_faulted() {
    for code in [
        ErrorCode::NumericError,
        ErrorCode::IllegalRequest,
        ErrorCode::StackOverflow,
        ErrorCode::MemoryViolation,
        ErrorCode::HardwareFault,
    ] {
        let (mut bench, _, a) = Bench::periodic(-1);
        bench.fault(code, 1);
        bench.handler_runs();
        assert_eq!(bench.state(a), ProcessState::Faulted, "{code:?}");
    }
}

#[test]
fn sm_12_faulted_process_leaves_by_resume_or_stop_only() {
    let (mut bench, _, a) = Bench::periodic(-1);
    bench.fault(ErrorCode::NumericError, 0);
    assert_eq!((bench.start(a), bench.suspend(a)), (NA, IM));
    bench.at(1000);
    assert_eq!(bench.state(a), ProcessState::Faulted);
    bench.resume(a).unwrap();
    assert_eq!(bench.state(a), ProcessState::Ready);
    let (mut bench, _, a) = Bench::periodic(-1);
    bench.fault(ErrorCode::NumericError, 0);
    bench.stop(a).unwrap();
    assert_eq!(bench.state(a), ProcessState::Dormant);
}

#[test]
fn sm_13_suspended_and_waiting_are_two_reasons() {
    let (mut bench, semaphore, b, a) = Bench::waiting(FOREVER);
    bench.suspend(b).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.runs(a);
    bench.resume(b).unwrap();
    bench.runs(b);
}

#[test]
fn sm_14_what_a_suspended_process_is_given_is_its_own() {
    let (mut bench, semaphore, b, _) = Bench::waiting(FOREVER);
    bench.suspend(b).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    let status = bench.get_semaphore_status(semaphore).unwrap();
    assert_eq!((status.current_value, status.waiting_processes), (0, 0));
    bench.resume(b).unwrap();
    assert_eq!(bench.result(), NE);
}

#[test]
fn sm_15_time_out_of_a_suspended_process_is_kept() {
    let (mut bench, _, b, _) = Bench::waiting(ms(10));
    bench.suspend(b).unwrap();
    bench.at(10);
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.at(15);
    bench.resume(b).unwrap();
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn sm_16_resumed_process_keeps_its_place_and_its_time_out() {
    let (mut bench, semaphore, b, _) = Bench::waiting(ms(10));
    bench.suspend(b).unwrap();
    bench.resume(b).unwrap();
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().waiting_processes, 1);
    assert_eq!(bench.next_timer(), Some(ms(10)));
}

#[test]
fn sm_17_restart_ends_every_process_and_object() {
    let (mut bench, semaphore, b, _) = Bench::waiting(FOREVER);
    bench.set_partition_mode(OperatingMode::ColdStart).unwrap();
    let partition = bench.partition.restarted();
    assert_eq!(code(partition.get_process_status(b)), IP);
    assert_eq!(code(partition.get_semaphore_status(semaphore)), IP);
}

#[test]
fn sm_18_more_urgent_release_preempts_and_an_equal_one_does_not() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    let equal = bench.timed("q", 10, 100, -1);
    bench.start(p).unwrap();
    bench.start(equal).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    bench.at(100);
    bench.runs(p);
    bench.stop_self();
    bench.runs(a);
    assert_eq!(bench.state(equal), ProcessState::Ready);
}

#[test]
fn mode_01_main_process_alone_runs_in_start_mode() {
    let mut bench = Bench::new();
    bench.started("a", 239);
    bench.at(1000);
    assert_eq!(bench.who(), Some(bateleur_processes::Runner::Main));
}

#[test]
fn mode_02_started_processes_wait() {
    let mut bench = Bench::new();
    let a = bench.started("a", 10);
    bench.at(1000);
    assert_eq!(bench.state(a), ProcessState::Waiting);
}

#[test]
fn mode_03_services_that_do_not_wait_work_in_start_mode() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let event = bench.create_event("e").unwrap();
    let board = bench.create_blackboard("b", 4).unwrap();
    let buffer = bench.create_buffer("b", 4, 1, FIFO).unwrap();
    assert_eq!(bench.signal_semaphore(semaphore), NE);
    assert_eq!(bench.set_event(event), NE);
    assert_eq!(bench.display_blackboard(board, b"x"), NE);
    assert_eq!(code(bench.send_buffer(buffer, b"x", 0)), NE);
    assert_eq!(code(bench.wait_semaphore(semaphore, FOREVER)), NE);
}

#[test]
fn mode_04_waiting_in_start_mode_is_refused() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    assert_eq!(code(bench.wait_event(event, FOREVER)), IM);
}

#[test]
fn mode_05_started_processes_can_be_controlled_in_start_mode() {
    let mut bench = Bench::new();
    let a = bench.started("a", 10);
    assert_eq!(bench.set_priority(a, 20), NE);
    assert_eq!((bench.suspend(a), bench.resume(a), bench.stop(a)), (NE, NE, NE));
    bench.normal();
    bench.nobody_runs();
}

#[test]
fn mode_06_error_in_start_mode_is_the_partitions() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    bench.fault(ErrorCode::NumericError, 0);
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
}

#[test]
fn mode_07_cold_and_warm_start_run_the_same_entry() {
    for mode in [OperatingMode::ColdStart, OperatingMode::WarmStart] {
        let bench = Bench::with(|settings| settings.mode = mode);
        let main = Dispatch::Run { who: bateleur_processes::Runner::Main, life: 1 };
        assert_eq!(bench.dispatch(), main);
        assert_eq!(bench.get_partition_status().operating_mode, mode);
    }
}

#[test]
fn mode_08_restart_deletes_everything_and_numbers_come_again() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let a = bench.created("a", 10);
    bench.set_partition_mode(OperatingMode::ColdStart).unwrap();
    let mut partition = bench.partition.restarted();
    assert_eq!(code(partition.get_process_id("a")), IC);
    assert_eq!(partition.create_process(&Bench::attributes("b", 1)), Ok(a));
    assert_eq!(partition.create_error_handler(STACK), NE);
}

#[test]
fn mode_09_warm_start_by_health_monitoring_in_cold_start_is_cold() {
    let mut bench =
        Bench::with(|settings| settings.health.action = [PartitionAction::WarmStart; ErrorCode::COUNT]);
    bench.raise("x");
    assert!(matches!(bench.end(), Some(End::Restart { mode: OperatingMode::ColdStart, .. })));
}

#[test]
fn mode_10_normal_is_one_instant_for_all() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let (a, d) = (bench.timed("a", 10, -1, 50), bench.timed("d", 20, -1, 50));
    let p = bench.timed("p", 30, 100, 50);
    bench.start(a).unwrap();
    bench.delayed_start(d, ms(7)).unwrap();
    bench.delayed_start(p, ms(9)).unwrap();
    bench.at(30);
    bench.normal();
    assert_eq!((bench.deadline(a), bench.deadline(d), bench.deadline(p)), (Some(80), Some(87), Some(159)));
    assert_eq!(bench.get_partition_status().lock_level, 0);
    bench.runs(a);
}

#[test]
fn mode_11_main_process_ends_with_normal_or_goes_on() {
    let mut bench = Bench::new();
    bench.normal();
    bench.nobody_runs();
}

#[test]
fn mode_12_idle_partition_does_not_leave_by_itself() {
    let (mut bench, _) = Bench::running();
    bench.set_partition_mode(OperatingMode::Idle).unwrap();
    bench.at(100_000);
    assert_eq!(bench.end(), Some(End::Idle));
}
