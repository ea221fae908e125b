//! SCN: what processes do one after the other. A window of 50 ms in every 100, instants in ms.

use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, End};

use crate::bench::*;

#[test]
fn scn_01_started_process_runs_before_start_returns() {
    let (mut bench, a, b) = Bench::pair();
    bench.start(b).unwrap();
    bench.runs(b);
    bench.at(5);
    bench.stop_self();
    bench.runs(a);
}

#[test]
fn scn_02_equals_take_turns_when_they_give_way() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    bench.at(3);
    done(bench.timed_wait(0));
    bench.runs(b);
    bench.at(6);
    done(bench.timed_wait(0));
    bench.runs(a);
}

#[test]
fn scn_03_first_release_after_normal() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, 30);
    bench.start(p).unwrap();
    let a = bench.started("a", 10);
    bench.at(20);
    bench.normal();
    bench.runs(a);
    bench.at(100);
    bench.runs(p);
    assert_eq!(bench.deadline(p), Some(130));
}

#[test]
fn scn_04_delayed_start_shifts_releases() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, 30);
    bench.delayed_start(p, ms(30)).unwrap();
    bench.at(20);
    bench.normal();
    bench.at(130);
    bench.runs(p);
    assert_eq!(bench.deadline(p), Some(160));
    waits(bench.periodic_wait());
    bench.at(229);
    bench.nobody_runs();
    bench.at(230);
    bench.runs(p);
}

#[test]
fn scn_05_release_does_not_move_with_the_work() {
    let mut bench = Bench::new();
    let h = bench.timed("h", 30, 100, -1);
    let p = bench.timed("p", 20, 100, -1);
    bench.start(h).unwrap();
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    bench.runs(h);
    bench.at(110);
    waits(bench.periodic_wait());
    bench.runs(p);
    bench.at(115);
    waits(bench.periodic_wait());
    assert_eq!(bench.next_timer(), Some(ms(200)));
}

#[test]
fn scn_06_release_that_has_passed_comes_at_once() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    bench.at(205);
    waits(bench.periodic_wait());
    bench.runs(p);
    waits(bench.periodic_wait());
    assert_eq!(bench.next_timer(), Some(ms(300)));
}

fn late(capacity: i64) -> (Bench, ProcessId) {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let p = bench.timed("p", 20, 100, capacity);
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    (bench, p)
}

#[test]
fn scn_07_handler_starts_a_late_process_again() {
    let (mut bench, p) = late(30);
    bench.at(130);
    bench.handler_runs();
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.error_code, error.failed_process_id), (ErrorCode::DeadlineMissed, p));
    bench.stop(p).unwrap();
    bench.start(p).unwrap();
    bench.stop_self();
    bench.nobody_runs();
    bench.at(200);
    bench.runs(p);
}

#[test]
fn scn_08_deadline_outside_of_the_window() {
    let (mut bench, p) = late(80);
    bench.at(150);
    bench.runs(p);
    bench.at(200);
    bench.handler_runs();
}

/// `b` (20) waits for a semaphore since 0, and `a` (10) runs.
fn waiting(time_out: SystemTime) -> (Bench, SemaphoreId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    waits(bench.wait_semaphore(semaphore, time_out));
    (bench, semaphore, b, a)
}

#[test]
fn scn_09_signal_to_a_suspended_process() {
    let (mut bench, semaphore, b, a) = waiting(FOREVER);
    bench.at(5);
    bench.suspend(b).unwrap();
    bench.at(7);
    bench.signal_semaphore(semaphore).unwrap();
    let status = bench.get_semaphore_status(semaphore).unwrap();
    assert_eq!((status.current_value, status.waiting_processes), (0, 0));
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.runs(a);
    bench.at(9);
    bench.resume(b).unwrap();
    bench.runs(b);
    assert_eq!(bench.result(), NE);
}

#[test]
fn scn_10_time_out_of_a_suspended_process() {
    let (mut bench, _, b, a) = waiting(ms(10));
    bench.at(5);
    bench.suspend(b).unwrap();
    bench.at(10);
    bench.runs(a);
    bench.at(15);
    bench.resume(b).unwrap();
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn scn_11_resumed_before_the_signal() {
    let (mut bench, semaphore, b, _) = waiting(FOREVER);
    bench.at(5);
    bench.suspend(b).unwrap();
    bench.at(6);
    bench.resume(b).unwrap();
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.at(8);
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(b);
}

#[test]
fn scn_12_suspended_by_itself_with_and_without_resume() {
    let mut bench = Bench::new();
    let (a, _) = (bench.started("a", 10), bench.started("b", 5));
    bench.normal();
    waits(bench.suspend_self(ms(20)));
    bench.at(10);
    bench.resume(a).unwrap();
    bench.runs(a);
    assert_eq!(bench.result(), NE);
    bench.at(40);
    waits(bench.suspend_self(ms(20)));
    bench.at(100);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
}

#[test]
fn scn_13_message_goes_to_the_receiver_whose_turn_it_is() {
    for (discipline, first) in [(FIFO, 0), (BY_PRIORITY, 1)] {
        let mut bench = Bench::new();
        let buffer = bench.create_buffer("b", 2, 1, discipline).unwrap();
        let receivers = [bench.created("r", 20), bench.created("q", 30)];
        bench.started("s", 10);
        bench.normal();
        for receiver in receivers {
            bench.start(receiver).unwrap();
            waits(bench.receive_buffer(buffer, FOREVER, &mut Vec::new()));
        }
        for (message, receiver) in [(b"m1", receivers[first]), (b"m2", receivers[1 - first])] {
            done(bench.send_buffer(buffer, message, 0));
            bench.runs(receiver);
            assert_eq!(bench.message(), message);
            bench.stop_self();
        }
    }
}

#[test]
fn scn_14_message_of_a_waiting_sender_enters() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 2, 1, FIFO).unwrap();
    let (s, r) = (bench.started("s", 10), bench.created("r", 20));
    bench.delayed_start(r, 1).unwrap();
    bench.normal();
    done(bench.send_buffer(buffer, b"m0", 0));
    waits(bench.send_buffer(buffer, b"m1", FOREVER));
    bench.advance(1);
    let mut message = Vec::new();
    done(bench.receive_buffer(buffer, 0, &mut message));
    assert_eq!((message.as_slice(), bench.get_buffer_status(buffer).unwrap().nb_message), (&b"m0"[..], 1));
    bench.runs(r);
    assert_eq!(bench.state(s), ProcessState::Ready);
}

#[test]
fn scn_15_signaller_can_not_take_the_unit_back() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (w, h) = (bench.started("w", 10), bench.created("h", 20));
    bench.delayed_start(h, 1).unwrap();
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.advance(1);
    bench.runs(h);
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(code(bench.wait_semaphore(semaphore, 0)), NV);
    bench.stop_self();
    bench.runs(w);
    assert_eq!(bench.result(), NE);
}

#[test]
fn scn_16_readers_of_a_blackboard_run_by_priority() {
    let mut bench = Bench::new();
    let board = bench.create_blackboard("b", 4).unwrap();
    let ids = [("x", 10), ("y", 30), ("z", 20)].map(|(name, priority)| bench.created(name, priority));
    bench.started("d", 5);
    bench.normal();
    for id in ids {
        bench.start(id).unwrap();
        waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
    }
    bench.display_blackboard(board, b"m").unwrap();
    for id in [ids[1], ids[2], ids[0]] {
        bench.runs(id);
        assert_eq!(bench.message(), b"m");
        bench.stop_self();
    }
}

#[test]
fn scn_17_event_up_and_down() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (b, c, a) = (bench.started("b", 20), bench.started("c", 20), bench.started("a", 10));
    bench.normal();
    bench.wait_for(event);
    bench.wait_for(event);
    bench.set_event(event).unwrap();
    for id in [b, c] {
        bench.runs(id);
        assert_eq!(bench.result(), NE);
        bench.stop_self();
    }
    done(bench.wait_event(event, FOREVER));
    bench.runs(a);
    bench.reset_event(event).unwrap();
    assert_eq!(code(bench.wait_event(event, 0)), NV);
}

#[test]
fn scn_18_owner_runs_at_the_ceiling() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 30, FIFO).unwrap();
    let l = bench.started("l", 10);
    let (m, h) = (bench.created("m", 20), bench.created("h", 30));
    bench.delayed_start(m, ms(2)).unwrap();
    bench.delayed_start(h, ms(3)).unwrap();
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(bench.priority(l), 30);
    bench.at(3);
    bench.runs(l);
    bench.at(6);
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.order(), [h, m, l]);
}

#[test]
fn scn_19_too_urgent_for_the_mutex() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 30, FIFO).unwrap();
    bench.started("h", 40);
    bench.normal();
    assert_eq!(code(bench.acquire_mutex(mutex, FOREVER)), IM);
}

#[test]
fn scn_20_owner_is_given_another_priority() {
    let mut bench = Bench::new();
    let mutex = bench.create_mutex("m", 30, FIFO).unwrap();
    let l = bench.started("l", 10);
    let (m, h) = (bench.created("m", 20), bench.created("h", 35));
    bench.delayed_start(m, ms(2)).unwrap();
    bench.delayed_start(h, ms(3)).unwrap();
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    bench.at(3);
    bench.runs(h);
    bench.set_priority(l, 25).unwrap();
    assert_eq!(bench.priority(l), 30);
    bench.stop_self();
    bench.at(6);
    bench.release_mutex(mutex).unwrap();
    assert_eq!(bench.priority(l), 25);
    assert_eq!(bench.order(), [l, m]);
}

#[test]
fn scn_21_mutex_of_a_faulted_process_is_reset() {
    for (discipline, place) in [(FIFO, 0), (BY_PRIORITY, 1)] {
        let mut bench = Bench::new();
        bench.create_error_handler(STACK).unwrap();
        let mutex = bench.create_mutex("m", 30, discipline).unwrap();
        let l = bench.started("l", 10);
        let waiting = [bench.created("b", 12), bench.created("c", 15)];
        bench.delayed_start(waiting[0], ms(4)).unwrap();
        bench.delayed_start(waiting[1], ms(6)).unwrap();
        bench.started("d", 5);
        bench.normal();
        done(bench.acquire_mutex(mutex, 0));
        bench.at(3);
        bench.fault(ErrorCode::NumericError, 0);
        bench.get_error_status().unwrap();
        bench.stop(l).unwrap();
        bench.stop_self();
        for instant in [4, 6] {
            bench.at(instant);
            waits(bench.acquire_mutex(mutex, FOREVER));
        }
        bench.at(9);
        bench.raise("mutex is lost");
        bench.reset_mutex(mutex, l).unwrap();
        bench.get_error_status().unwrap();
        bench.stop_self();
        bench.runs(waiting[place]);
        let status = bench.get_mutex_status(mutex).unwrap();
        assert_eq!((status.mutex_owner, status.lock_count), (waiting[place], 1));
    }
}

#[test]
fn scn_22_started_process_waits_for_the_unlock() {
    let (mut bench, a, b) = Bench::pair();
    done(bench.lock_preemption());
    bench.start(b).unwrap();
    bench.runs(a);
    bench.at(5);
    bench.unlock_preemption().unwrap();
    bench.runs(b);
}

#[test]
fn scn_23_owner_of_the_lock_goes_on_after_the_other_partitions() {
    let mut bench = Bench::new();
    let (h, a) = (bench.started("h", 30), bench.started("a", 10));
    bench.normal();
    waits(bench.timed_wait(ms(70)));
    bench.at(45);
    done(bench.lock_preemption());
    bench.at(100);
    bench.runs(a);
    bench.at(103);
    bench.unlock_preemption().unwrap();
    bench.runs(h);
}

#[test]
fn scn_24_owner_of_the_lock_asks_to_wait() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 1, 1, FIFO).unwrap();
    bench.started("a", 10);
    bench.normal();
    done(bench.lock_preemption());
    assert_eq!(code(bench.receive_buffer(buffer, ms(5), &mut Vec::new())), IM);
    assert_eq!(code(bench.receive_buffer(buffer, 0, &mut Vec::new())), NV);
    assert_eq!((code(bench.timed_wait(0)), code(bench.periodic_wait())), (IM, IM));
}

#[test]
fn scn_25_owner_of_the_lock_divides_by_zero() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let (a, h) = (bench.started("a", 10), bench.created("h", 30));
    bench.normal();
    done(bench.lock_preemption());
    bench.start(h).unwrap();
    bench.at(10);
    bench.fault(ErrorCode::NumericError, 0);
    assert_eq!(bench.state(a), ProcessState::Faulted);
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.error_code, error.failed_process_id), (ErrorCode::NumericError, a));
    bench.stop(a).unwrap();
    assert_eq!(bench.get_partition_status().lock_level, 0);
    bench.stop_self();
    bench.runs(h);
}

#[test]
fn scn_26_raised_error_is_read_and_the_caller_goes_on() {
    let (mut bench, a) = Bench::in_handler();
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.error_code, error.failed_process_id), (ErrorCode::ApplicationError, a));
    assert_eq!(error.message.as_bytes(), b"x");
    assert_eq!(code(bench.get_error_status()), NA);
    bench.at(6);
    bench.stop_self();
    bench.runs(a);
}

#[test]
fn scn_27_deadline_passes_while_the_handler_runs() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    bench.started("a", 10);
    let b = bench.timed("b", 5, -1, 7);
    bench.start(b).unwrap();
    bench.normal();
    bench.at(5);
    bench.raise("x");
    bench.get_error_status().unwrap();
    bench.at(8);
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.error_code, error.failed_process_id), (ErrorCode::DeadlineMissed, b));
    assert!(matches!(bench.dispatch(), Dispatch::Run { life: 1, .. }));
}

#[test]
fn scn_28_error_without_a_handler_restarts_the_partition() {
    let (mut bench, a) = Bench::running();
    bench.raise("x");
    assert!(matches!(bench.end(), Some(End::Restart { mode: OperatingMode::WarmStart, .. })));
    let partition = bench.partition.restarted();
    assert_eq!(u32::from(partition.get_partition_status().start_condition), 3);
    assert_eq!(code(partition.get_process_status(a)), IP);
}

#[test]
fn scn_29_validity_ends_with_the_refresh_period() {
    let mut bench = Bench::new();
    bench.channels.add_sampling("in", PortDirection::Destination);
    let port = bench.partition.create_sampling_port(&bench.channels, "in", 8, 1_u32, ms(145)).unwrap();
    bench.started("a", 10);
    bench.normal();
    bench.channels.sampling[0].2 = Some((b"x".to_vec(), ms(10)));
    for (instant, validity) in [(60, Validity::Valid), (155, Validity::Valid), (156, Validity::Invalid)] {
        bench.at(instant);
        let mut message = Vec::new();
        let read = bench.partition.read_sampling_message(&mut bench.channels, port, &mut message);
        assert_eq!((read, message), (Ok(validity), b"x".to_vec()), "at {instant}");
    }
}

#[test]
fn scn_31_three_messages_into_a_queue_of_two() {
    let mut bench = Bench::new();
    bench.channels.add_queuing("out", PortDirection::Source);
    let port = bench.partition.create_queuing_port(&bench.channels, "out", 8, 2, 0_u32, FIFO).unwrap();
    let sent = [b"m1", b"m2", b"m3"]
        .map(|message| code(bench.partition.send_queuing_message(&mut bench.channels, port, message, 0)));
    assert_eq!(sent, [NE, NE, NV]);
    assert_eq!(bench.channels.queuing[0].messages, [b"m1", b"m2"]);
}

#[test]
fn scn_34_deadline_is_moved_up_to_the_next_release() {
    let (mut bench, p) = late(30);
    bench.at(120);
    assert_eq!(bench.replenish(ms(50)), NE);
    assert_eq!(bench.deadline(p), Some(170));
    assert_eq!(bench.replenish(ms(90)), IM);
    assert_eq!(bench.deadline(p), Some(170));
}

#[test]
fn scn_35_wait_ends_outside_of_the_window() {
    let (mut bench, a) = Bench::running();
    bench.at(40);
    waits(bench.timed_wait(ms(30)));
    assert_eq!(bench.next_timer(), Some(ms(70)));
    bench.at(100);
    bench.runs(a);
}

#[test]
fn scn_36_time_out_during_a_lock() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    waits(bench.wait_event(event, ms(10)));
    bench.at(2);
    done(bench.lock_preemption());
    bench.at(10);
    assert_eq!(bench.state(b), ProcessState::Ready);
    bench.runs(a);
    bench.at(15);
    bench.unlock_preemption().unwrap();
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn scn_37_stopped_process_was_first_in_the_queue() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (b, c) = (bench.started("b", 20), bench.started("c", 20));
    bench.started("a", 10);
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.stop(b).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(c);
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().current_value, 0);
}

#[test]
fn scn_38_handler_raises_an_error() {
    let (mut bench, _) = Bench::in_handler();
    bench.raise("worse");
    assert!(matches!(bench.end(), Some(End::Restart { .. })));
}

#[test]
fn scn_39_suspended_before_normal() {
    let mut bench = Bench::new();
    let b = bench.timed("b", 20, -1, 60);
    bench.start(b).unwrap();
    bench.suspend(b).unwrap();
    let a = bench.started("a", 10);
    bench.at(10);
    bench.normal();
    bench.runs(a);
    assert_eq!(bench.state(b), ProcessState::Waiting);
    bench.at(30);
    bench.resume(b).unwrap();
    bench.runs(b);
    assert_eq!(bench.deadline(b), Some(70));
}

#[test]
fn scn_40_late_without_having_run() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let p = bench.timed("p", 20, 100, 30);
    bench.start(p).unwrap();
    let a = bench.started("a", 30);
    bench.normal();
    bench.at(100);
    bench.runs(a);
    bench.at(130);
    bench.handler_runs();
    assert_eq!(bench.get_error_status().unwrap().failed_process_id, p);
}
