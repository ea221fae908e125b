//! BUG: what other implementations have done wrong.

use bateleur_processes::standard::*;
use bateleur_processes::{End, PartitionAction};

use crate::bench::*;

#[test]
fn bug_01_periodic_process_may_have_no_deadline() {
    let mut bench = Bench::new();
    bench.timed("p", 20, 100, -1);
}

#[test]
fn bug_02_suspension_does_not_outlive_stop() {
    let mut bench = Bench::new();
    let (b, _) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    waits(bench.suspend_self(FOREVER));
    bench.stop(b).unwrap();
    bench.start(b).unwrap();
    bench.runs(b);
}

#[test]
fn bug_03_level_of_the_lock_is_its_owners() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    bench.started("a", 20);
    bench.started("b", 10);
    bench.normal();
    done(bench.lock_preemption());
    done(bench.lock_preemption());
    bench.stop_self();
    assert_eq!(done(bench.lock_preemption()), 1);
}

#[test]
fn bug_04_warm_start_in_cold_start_is_no_panic() {
    let mut bench =
        Bench::with(|settings| settings.health.action = [PartitionAction::WarmStart; ErrorCode::COUNT]);
    bench.fault(ErrorCode::NumericError, 0);
    assert!(matches!(bench.end(), Some(End::Restart { mode: OperatingMode::ColdStart, .. })));
}

#[test]
fn bug_06_longest_message_is_accepted() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 4, 1, FIFO).unwrap();
    let board = bench.create_blackboard("b", 4).unwrap();
    done(bench.send_buffer(buffer, b"1234", 0));
    assert_eq!(bench.display_blackboard(board, b"1234"), NE);
}

#[test]
fn bug_07_infinite_time_out_is_accepted() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 4, 1, FIFO).unwrap();
    let board = bench.create_blackboard("b", 4).unwrap();
    bench.started("b", 20);
    bench.started("a", 10);
    bench.normal();
    waits(bench.receive_buffer(buffer, FOREVER, &mut Vec::new()));
    waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
}

#[test]
fn bug_08_unknown_blackboard_is_a_wrong_parameter() {
    assert_eq!(code(Bench::new().get_blackboard_status(BlackboardId(1))), IP);
}

#[test]
fn bug_09_unknown_process_is_a_wrong_parameter_everywhere() {
    let (mut bench, _) = Bench::running();
    for id in [ProcessId(0), ProcessId(-1), ProcessId(99), ProcessId(i32::MIN)] {
        assert_eq!([bench.start(id), bench.stop(id), bench.suspend(id), bench.resume(id)], [IP; 4]);
        assert_eq!([bench.set_priority(id, 5), bench.delayed_start(id, 0)], [IP; 2]);
    }
}

#[test]
fn bug_10_port_in_normal_is_refused_for_the_mode() {
    let mut bench = Bench::new();
    bench.channels.add_sampling("p", PortDirection::Source);
    bench.started("a", 10);
    bench.normal();
    let made = bench.partition.create_sampling_port(&bench.channels, "p", 8, 0_u32, 1);
    assert_eq!(code(made), IM);
}

#[test]
fn bug_11_messages_of_two_buffers_do_not_meet() {
    let mut bench = Bench::new();
    let buffers = ["a", "b"].map(|name| bench.create_buffer(name, 4, 2, FIFO).unwrap());
    for (buffer, messages) in buffers.into_iter().zip([[b"aaaa", b"AAAA"], [b"bbbb", b"BBBB"]]) {
        messages.iter().for_each(|message| done(bench.send_buffer(buffer, *message, 0)));
    }
    for (buffer, messages) in buffers.into_iter().zip([[b"aaaa", b"AAAA"], [b"bbbb", b"BBBB"]]) {
        for expected in messages {
            let mut message = Vec::new();
            done(bench.receive_buffer(buffer, 0, &mut message));
            assert_eq!(message, expected);
        }
    }
}

#[test]
fn bug_12_resume_of_a_ready_process_does_nothing() {
    let mut bench = Bench::new();
    let (_, b) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    assert_eq!(bench.resume(b), NA);
}

#[test]
fn bug_13_errors_are_the_handlers_and_a_missed_deadline_is_told_once() {
    let (mut bench, _) = Bench::running();
    assert_eq!(code(bench.get_error_status()), IC);
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let a = bench.timed("a", 10, -1, 5);
    bench.start(a).unwrap();
    bench.normal();
    (5..20).for_each(|instant| bench.at(instant));
    bench.get_error_status().unwrap();
    assert_eq!(code(bench.get_error_status()), NA);
}

#[test]
fn bug_14_report_is_bounded() {
    assert_eq!(Bench::new().report_application_message(&[0; 129]), IP);
}

#[test]
fn bug_15_first_release_does_not_lie_in_the_past() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, 50);
    bench.started("a", 10);
    bench.normal();
    bench.at(12_345);
    bench.start(p).unwrap();
    assert_eq!(bench.next_timer(), Some(ms(12_400)));
}

#[test]
fn bug_18_asking_works_before_anything_was_created() {
    let bench = Bench::new();
    assert_eq!(code(bench.get_event_id("e")), IC);
    assert_eq!(code(bench.get_process_id("p")), IC);
}

#[test]
fn bug_19_queuing_port_is_cleared_and_its_status_is_whole() {
    let mut bench = Bench::new();
    bench.channels.add_queuing("in", PortDirection::Destination);
    let port = bench.partition.create_queuing_port(&bench.channels, "in", 8, 2, 1_u32, FIFO).unwrap();
    assert_eq!(bench.partition.clear_queuing_port(&mut bench.channels, port), NE);
    assert_eq!(bench.get_queuing_port_status(&bench.channels, port).unwrap().max_nb_message, 2);
}

#[test]
fn bug_20_fresh_message_is_the_valid_one() {
    let mut bench = Bench::new();
    bench.channels.add_sampling("in", PortDirection::Destination);
    let port = bench.partition.create_sampling_port(&bench.channels, "in", 8, 1_u32, ms(145)).unwrap();
    bench.channels.sampling[0].2 = Some((b"x".to_vec(), 0));
    let read = bench.partition.read_sampling_message(&mut bench.channels, port, &mut Vec::new());
    assert_eq!(read, Ok(Validity::Valid));
}

#[test]
fn bug_22_time_out_of_a_queuing_port_is_kept() {
    let mut bench = Bench::new();
    bench.channels.add_queuing("in", PortDirection::Destination);
    let port = bench.partition.create_queuing_port(&bench.channels, "in", 8, 2, 1_u32, FIFO).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    let mut message = Vec::new();
    waits(bench.partition.receive_queuing_message(&mut bench.channels, port, ms(5), &mut message));
    bench.at(5);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
}

#[test]
fn bug_23_time_out_out_of_range_is_a_wrong_parameter() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    bench.started("a", 10);
    bench.normal();
    bench.at(1);
    assert_eq!(code(bench.wait_event(event, SystemTime::MAX)), IP);
}

#[test]
fn bug_24_periodic_wait_of_an_aperiodic_process_returns() {
    let (mut bench, a) = Bench::running();
    assert_eq!(code(bench.periodic_wait()), IM);
    bench.runs(a);
}

#[test]
fn bug_25_empty_buffer_is_empty_unlock_takes_effect_and_all_processes_start() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 1, 1, FIFO).unwrap();
    let ids = [("a", 30), ("b", 20), ("c", 10)].map(|(name, priority)| bench.started(name, priority));
    bench.normal();
    assert_eq!(code(bench.receive_buffer(buffer, 0, &mut Vec::new())), NV);
    done(bench.lock_preemption());
    bench.set_priority(ids[0], 5).unwrap();
    bench.unlock_preemption().unwrap();
    assert_eq!(bench.order(), [ids[1], ids[2], ids[0]]);
}

#[test]
fn bug_26_nobody_steps_in_between_signal_and_wake() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (w, thief) = (bench.started("w", 20), bench.started("t", 10));
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.runs(thief);
    done(bench.lock_preemption());
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(code(bench.wait_semaphore(semaphore, 0)), NV);
    bench.unlock_preemption().unwrap();
    bench.runs(w);
}

#[test]
fn bug_27_time_outs_count_module_time() {
    let (mut bench, a) = Bench::running();
    bench.at(49);
    waits(bench.timed_wait(ms(20)));
    bench.at(100);
    bench.runs(a);
}

#[test]
fn bug_28_release_is_not_counted_from_now() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.normal();
    bench.at(140);
    waits(bench.periodic_wait());
    assert_eq!(bench.next_timer(), Some(ms(200)));
}

#[test]
fn bug_29_woken_process_does_not_overtake_its_equals() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (w, a, b) = (bench.started("w", 10), bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    bench.wait_for(event);
    bench.set_event(event).unwrap();
    assert_eq!(bench.order(), [a, b, w]);
}

#[test]
fn bug_30_priority_of_the_mutex_needs_no_contention() {
    let (bench, a, _) = Bench::owner();
    assert_eq!(bench.priority(a), 200);
}
