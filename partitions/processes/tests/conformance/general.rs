//! GEN and TYP: what holds of all services.

use bateleur_processes::standard::*;
use bateleur_processes::{Notice, Partition, Runner};

use crate::bench::*;

#[test]
fn gen_01_two_checks_that_hold_at_once_give_either_code() {
    let (mut bench, _) = Bench::running();
    one_of(code(bench.create_buffer("", 0, 0, NONSENSE)), &[IP, IM]);
    let (mut bench, _) = Bench::in_handler();
    one_of(code(bench.timed_wait(FOREVER)), &[IP, IM]);
}

#[test]
fn gen_02_refused_service_changes_nothing() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 1, 1, FIFO).unwrap();
    let before = bench.get_semaphore_status(semaphore);
    assert_eq!(code(bench.create_semaphore("s", 0, 5, FIFO)), NA);
    assert_eq!(code(bench.signal_semaphore(semaphore)), NA);
    assert_eq!(code(bench.wait_semaphore(semaphore, -7)), IP);
    assert_eq!(bench.get_semaphore_status(semaphore), before);
}

#[test]
fn gen_03_length_is_0_when_nothing_was_read() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("b", 4, 1, FIFO).unwrap();
    let mut message = b"old".to_vec();
    assert_eq!(code(bench.receive_buffer(buffer, 0, &mut message)), NV);
    assert!(message.is_empty());
    message.push(1);
    assert_eq!(code(bench.receive_buffer(buffer, FOREVER, &mut message)), IM);
    assert!(message.is_empty());
    let a = bench.started("a", 10);
    bench.normal();
    waits(bench.receive_buffer(buffer, ms(5), &mut message));
    bench.at(5);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
    assert!(bench.message().is_empty());
}

#[test]
fn gen_04_identifiers_are_not_zero_and_hold_until_restart() {
    let mut bench = Bench::new();
    let (a, b) = (bench.created("a", 1), bench.created("b", 1));
    assert!(a.0 != 0 && b.0 != 0 && a != b);
    bench.normal();
    assert!(bench.get_process_status(a).is_ok());
}

#[test]
fn gen_05_two_classes_may_share_a_name() {
    let mut bench = Bench::new();
    bench.created("x", 1);
    assert!(bench.create_buffer("x", 1, 1, FIFO).is_ok());
    assert!(bench.create_event("x").is_ok());
    assert_eq!(code(bench.create_event("x")), NA);
}

#[test]
fn gen_06_nothing_is_created_in_normal() {
    let (mut bench, _) = Bench::running();
    bench.channels.add_sampling("p", PortDirection::Source);
    bench.channels.add_queuing("q", PortDirection::Source);
    let Bench { partition, channels } = &mut bench;
    let made = [
        code(partition.create_process(&Bench::attributes("n", 1))),
        code(partition.create_buffer("n", 1, 1, FIFO)),
        code(partition.create_blackboard("n", 1)),
        code(partition.create_semaphore("n", 0, 1, FIFO)),
        code(partition.create_event("n")),
        code(partition.create_mutex("n", 1, FIFO)),
        code(partition.create_error_handler(STACK)),
        code(partition.create_sampling_port(channels, "p", 8, PortDirection::Source, 1)),
        code(partition.create_queuing_port(channels, "q", 8, 2, PortDirection::Source, FIFO)),
    ];
    assert_eq!(made, [IM; 9]);
}

#[test]
fn gen_07_identifier_of_another_class_is_unknown() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    bench.create_semaphore("s", 1, 1, FIFO).unwrap();
    assert_eq!(code(bench.wait_semaphore(SemaphoreId(event.0), 0)), IP);
}

#[test]
fn gen_08_time_out_0_polls_a_positive_one_ends_and_infinite_does_not() {
    let (mut bench, a) = Bench::running_with_event();
    let event = bench.get_event_id("e").unwrap();
    assert_eq!(code(bench.wait_event(event, 0)), NV);
    waits(bench.wait_event(event, ms(3)));
    bench.at(3);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
    waits(bench.wait_event(event, FOREVER));
    assert_eq!(bench.next_timer(), None);
}

#[test]
fn gen_09_time_out_below_infinite_is_a_wrong_parameter_or_infinite() {
    let (mut bench, _) = Bench::running_with_event();
    let event = bench.get_event_id("e").unwrap();
    one_of(code(bench.wait_event(event, -2)), &[IP, NE]);
}

#[test]
fn gen_10_time_out_beyond_all_times_is_a_wrong_parameter() {
    let (mut bench, _) = Bench::running_with_event();
    let event = bench.get_event_id("e").unwrap();
    bench.at(1);
    assert_eq!(code(bench.wait_event(event, SystemTime::MAX)), IP);
    assert_eq!(code(bench.timed_wait(SystemTime::MAX)), IP);
}

#[test]
fn gen_11_whoever_must_not_wait_may_poll() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    assert_eq!(code(bench.wait_event(event, 0)), NV, "in start mode");
    bench.create_error_handler(STACK).unwrap();
    bench.started("a", 10);
    bench.normal();
    done(bench.lock_preemption());
    assert_eq!(code(bench.wait_event(event, 0)), NV, "with the preemption lock");
    bench.raise("x");
    assert_eq!(code(bench.wait_event(event, 0)), NV, "in the error handler");
}

#[test]
fn gen_12_waiting_is_refused_where_it_would_happen_only() {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", 1, 1, FIFO).unwrap();
    bench.started("a", 10);
    bench.normal();
    done(bench.lock_preemption());
    done(bench.wait_semaphore(semaphore, FOREVER));
    assert_eq!(code(bench.wait_semaphore(semaphore, FOREVER)), IM);
}

#[test]
fn gen_13_asking_and_reporting_let_the_caller_run_on() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    bench.set_event(event).unwrap();
    let (a, equal) = (bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    bench.get_process_status(equal).unwrap();
    bench.get_event_status(event).unwrap();
    bench.report_application_message(b"hello").unwrap();
    bench.reset_event(event).unwrap();
    let _ = (bench.get_my_id(), bench.get_time(), bench.get_partition_status());
    bench.runs(a);
}

#[test]
fn typ_02_name_of_32_characters_needs_no_end() {
    let long = "n".repeat(32);
    let mut bench = Bench::new();
    let event = bench.create_event(&long).unwrap();
    assert_eq!(bench.get_event_id(&long), Ok(event));
    assert_eq!(code(bench.create_event(&"n".repeat(33))), IP);
    let mut array = [b'x'; 32];
    array[3..5].copy_from_slice(&[0, b'y']);
    assert_eq!(Name::of_array(array), Name::new("xxx").unwrap());
    assert_eq!(Name::of_array([b'x'; 32]).as_bytes().len(), 32);
}

#[test]
fn typ_03_case_of_names_may_count_and_a_near_miss_is_told() {
    let mut bench = Bench::new();
    bench.create_event("Engine").unwrap();
    one_of(code(bench.get_event_id("ENGINE")), &[NE, IC]);
    one_of(code(bench.create_event("engine")), &[NE, NA]);
    assert!(matches!(bench.take_notice(), Some(Notice::SameNameButCase { .. })));
}

#[test]
fn typ_04_number_outside_of_an_enumeration_is_refused_as_a_parameter() {
    let mut bench = Bench::new();
    assert_eq!(code(bench.create_semaphore("s", 0, 1, NONSENSE)), IP);
    assert_eq!(bench.set_partition_mode(NONSENSE), IP);
    bench.channels.add_queuing("q", PortDirection::Source);
    let Bench { partition, channels } = &mut bench;
    assert_eq!(code(partition.create_queuing_port(channels, "q", 8, 2, NONSENSE, FIFO)), IC);
}

impl Bench {
    /// In NORMAL, with one process that runs, and an event that is down.
    fn running_with_event() -> (Self, ProcessId) {
        let mut bench = Self::new();
        bench.create_event("e").unwrap();
        let a = bench.started("a", 10);
        bench.normal();
        (bench, a)
    }
}

#[test]
fn identifiers_of_unknown_things_are_refused_and_do_not_panic() {
    let bench = Bench::new();
    for number in [i32::MIN, -4, -3, -1, 0, 1, 4095, i32::MAX] {
        assert_eq!(code(bench.get_process_status(ProcessId(number))), IP);
        assert_eq!(code(bench.get_mutex_status(MutexId(number))), IP);
        assert_eq!(code(bench.get_buffer_status(BufferId(number))), IP);
    }
    let partition: &Partition = &bench;
    assert_eq!(partition.result(), NE);
    assert_eq!(bench.who(), Some(Runner::Main));
}
