//! OBJ: how processes wait at objects.

use bateleur_processes::standard::*;

use crate::bench::*;

#[test]
fn obj_01_messages_are_first_in_first_out_whatever_the_discipline() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 1, 3, BY_PRIORITY).unwrap();
    for message in [b"1", b"2", b"3"] {
        done(bench.send_buffer(buffer, message, 0));
    }
    for expected in [b"1", b"2", b"3"] {
        let mut message = Vec::new();
        done(bench.receive_buffer(buffer, 0, &mut message));
        assert_eq!(message, expected);
    }
}

/// Three processes of priorities 20, 40 and 30 wait for a semaphore, in this order, and one of 10 runs.
fn three(discipline: u32) -> (Bench, SemaphoreId, [ProcessId; 3]) {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 9, discipline).unwrap();
    let ids = [("b", 20), ("c", 40), ("d", 30)].map(|(name, priority)| bench.created(name, priority));
    bench.started("a", 10);
    bench.normal();
    for id in ids {
        bench.start(id).unwrap();
        waits(bench.wait_semaphore(semaphore, FOREVER));
    }
    (bench, semaphore, ids)
}

#[test]
fn obj_02_fifo_is_by_arrival() {
    let (mut bench, semaphore, ids) = three(FIFO);
    for id in ids {
        bench.signal_semaphore(semaphore).unwrap();
        bench.runs(id);
        bench.stop_self();
    }
}

#[test]
fn obj_03_priority_is_by_priority_then_by_arrival() {
    let (mut bench, semaphore, ids) = three(BY_PRIORITY);
    for id in [ids[1], ids[2], ids[0]] {
        bench.signal_semaphore(semaphore).unwrap();
        bench.runs(id);
        bench.stop_self();
    }
}

#[test]
fn obj_04_woken_together_they_run_by_priority() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let ids = [("b", 20), ("c", 40), ("d", 30)].map(|(name, priority)| bench.created(name, priority));
    let a = bench.started("a", 10);
    bench.normal();
    for id in ids {
        bench.start(id).unwrap();
        bench.wait_for(event);
    }
    bench.set_event(event).unwrap();
    assert_eq!(bench.order(), [ids[1], ids[2], ids[0], a]);
}

#[test]
fn obj_05_unit_belongs_to_the_woken_process_at_once() {
    let (mut bench, semaphore, _, _) = Bench::waiting(FOREVER);
    done(bench.lock_preemption());
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(code(bench.wait_semaphore(semaphore, 0)), NV);
}

#[test]
fn obj_06_signal_wakes_one_and_set_wakes_all() {
    let (mut bench, semaphore, _) = three(FIFO);
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().waiting_processes, 2);
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    bench.started("b", 20);
    bench.started("c", 20);
    bench.started("a", 10);
    bench.normal();
    bench.wait_for(event);
    bench.wait_for(event);
    bench.set_event(event).unwrap();
    assert_eq!(bench.get_event_status(event).unwrap().waiting_processes, 0);
}

#[test]
fn obj_07_who_waited_long_enough_leaves_the_queue() {
    let (mut bench, semaphore, b, _) = Bench::waiting(ms(10));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().waiting_processes, 0);
}

#[test]
fn obj_08_grant_at_the_instant_of_the_time_out_is_one_of_both() {
    let (mut bench, semaphore, b, a) = Bench::waiting(ms(10));
    bench.advance(ms(10) - 1);
    bench.runs(a);
    bench.signal_semaphore(semaphore).unwrap();
    bench.at(10);
    bench.runs(b);
    one_of(bench.result(), &[NE, TM]);
    let value = bench.get_semaphore_status(semaphore).unwrap().current_value;
    assert_eq!(bench.result().is_ok(), value == 0, "nothing is lost");
}

#[test]
fn obj_09_suspended_process_keeps_its_turn() {
    let (mut bench, semaphore, ids) = three(FIFO);
    bench.suspend(ids[0]).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(ids[1]);
    bench.resume(ids[0]).unwrap();
    assert_eq!(bench.state(ids[0]), ProcessState::Ready);
}

#[test]
fn obj_10_stopped_process_leaves_without_taking() {
    let (mut bench, semaphore, ids) = three(FIFO);
    bench.stop(ids[0]).unwrap();
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(ids[1]);
}

#[test]
fn obj_11_senders_or_receivers_wait_at_a_buffer_never_both() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 1, 1, FIFO).unwrap();
    bench.started("b", 20);
    bench.started("a", 10);
    bench.normal();
    waits(bench.receive_buffer(buffer, FOREVER, &mut Vec::new()));
    assert_eq!(bench.get_buffer_status(buffer).unwrap().waiting_processes, 1);
    done(bench.send_buffer(buffer, b"x", FOREVER));
    assert_eq!(bench.get_buffer_status(buffer).unwrap().waiting_processes, 0);
}

#[test]
fn obj_12_woken_equal_waits_for_the_caller_to_give_way() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let (b, a) = (bench.started("b", 10), bench.started("a", 10));
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(a);
    done(bench.timed_wait(0));
    bench.runs(b);
}

#[test]
fn obj_13_time_outs_go_on_outside_of_windows() {
    let (mut bench, _, b, _) = Bench::waiting(ms(70));
    bench.at(50);
    bench.at(100);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn obj_14_objects_end_with_the_partition() {
    let (mut bench, semaphore, b, _) = Bench::waiting(FOREVER);
    bench.stop(b).unwrap();
    bench.stop_self();
    assert!(bench.get_semaphore_status(semaphore).is_ok());
}
