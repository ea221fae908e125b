//! BUF and BB: buffers and blackboards.

use bateleur_processes::standard::*;

use crate::bench::*;

/// In NORMAL: a buffer of one message of four bytes, a process `b` (20) that runs, and behind it `a` (10).
fn buffer() -> (Bench, BufferId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("buffer", 4, 1, FIFO).unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    (bench, buffer, b, a)
}

/// The same with a blackboard.
fn blackboard() -> (Bench, BlackboardId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    let blackboard = bench.create_blackboard("board", 4).unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    (bench, blackboard, b, a)
}

fn receive(bench: &mut Bench, buffer: BufferId) -> Vec<u8> {
    let mut message = Vec::new();
    done(bench.receive_buffer(buffer, 0, &mut message));
    message
}

fn count(bench: &Bench, buffer: BufferId) -> i32 {
    bench.get_buffer_status(buffer).unwrap().nb_message
}

#[test]
fn buf_create_01_too_many_or_too_much_memory() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 1);
    bench.create_buffer("a", 1, 1, FIFO).unwrap();
    assert_eq!(code(bench.create_buffer("b", 1, 1, FIFO)), IC);
    let mut bench = Bench::with(|settings| settings.limits.object_memory = 99);
    assert_eq!(code(bench.create_buffer("a", 10, 10, FIFO)), IC);
}

#[test]
fn buf_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_buffer("a", 1, 1, FIFO).unwrap();
    assert_eq!(code(bench.create_buffer("a", 1, 1, FIFO)), NA);
}

#[test]
fn buf_create_03_message_size() {
    for size in [0, -1, MAX_MESSAGE_SIZE + 1] {
        assert_eq!(code(Bench::new().create_buffer("a", size, 1, FIFO)), IP, "{size}");
    }
}

#[test]
fn buf_create_04_number_of_messages() {
    for messages in [0, -1, MAX_MESSAGES + 1] {
        assert_eq!(code(Bench::new().create_buffer("a", 1, messages, FIFO)), IP, "{messages}");
    }
}

#[test]
fn buf_create_05_discipline() {
    assert_eq!(code(Bench::new().create_buffer("a", 1, 1, NONSENSE)), IP);
}

#[test]
fn buf_create_06_not_in_normal() {
    assert_eq!(code(Bench::running().0.create_buffer("a", 1, 1, FIFO)), IM);
}

#[test]
fn buf_create_07_new_buffer_is_empty() {
    let mut bench = Bench::new();
    let buffer = bench.create_buffer("a", 4, 3, BY_PRIORITY).unwrap();
    let status = bench.get_buffer_status(buffer).unwrap();
    assert_eq!((status.nb_message, status.max_nb_message, status.max_message_size), (0, 3, 4));
}

#[test]
fn buf_send_01_unknown_buffer() {
    assert_eq!(code(Bench::new().send_buffer(BufferId(1), b"x", 0)), IP);
}

#[test]
fn buf_send_02_message_too_long() {
    let (mut bench, buffer, ..) = self::buffer();
    assert_eq!(code(bench.send_buffer(buffer, b"12345", 0)), IP);
    assert_eq!(code(bench.send_buffer(buffer, b"1234", 0)), NE);
}

#[test]
fn buf_send_03_empty_message() {
    let (mut bench, buffer, ..) = self::buffer();
    assert_eq!(code(bench.send_buffer(buffer, b"", 0)), IP);
}

#[test]
fn buf_send_04_time_out_out_of_range() {
    let (mut bench, buffer, ..) = self::buffer();
    bench.at(1);
    assert_eq!(code(bench.send_buffer(buffer, b"x", SystemTime::MAX)), IP);
}

#[test]
fn buf_send_05_waiting_receiver_has_it_at_once() {
    let (mut bench, buffer, b, a) = self::buffer();
    waits(bench.receive_buffer(buffer, FOREVER, &mut Vec::new()));
    bench.runs(a);
    done(bench.send_buffer(buffer, b"now", FOREVER));
    bench.runs(b);
    assert_eq!((bench.result(), bench.message(), count(&bench, buffer)), (NE, &b"now"[..], 0));
}

#[test]
fn buf_send_06_message_is_stored_where_nobody_waits() {
    let (mut bench, buffer, b, _) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    bench.runs(b);
    assert_eq!(count(&bench, buffer), 1);
}

#[test]
fn buf_send_07_full_and_no_waiting() {
    let (mut bench, buffer, ..) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    assert_eq!(code(bench.send_buffer(buffer, b"y", 0)), NV);
}

#[test]
fn buf_send_08_full_and_waiting_forbidden() {
    let (mut bench, buffer, ..) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    done(bench.lock_preemption());
    assert_eq!(code(bench.send_buffer(buffer, b"y", FOREVER)), IM);
}

#[test]
fn buf_send_09_room_in_time() {
    let (mut bench, buffer, b, _) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    waits(bench.send_buffer(buffer, b"y", ms(10)));
    assert_eq!(receive(&mut bench, buffer), b"x");
    bench.runs(b);
    assert_eq!((bench.result(), count(&bench, buffer)), (NE, 1));
    assert_eq!(receive(&mut bench, buffer), b"y");
}

#[test]
fn buf_send_10_no_room_in_time() {
    let (mut bench, buffer, b, _) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    waits(bench.send_buffer(buffer, b"y", ms(10)));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
    assert_eq!(receive(&mut bench, buffer), b"x");
    assert_eq!(count(&bench, buffer), 0);
}

#[test]
fn buf_recv_01_unknown_buffer() {
    assert_eq!(code(Bench::new().receive_buffer(BufferId(1), 0, &mut Vec::new())), IP);
}

#[test]
fn buf_recv_02_time_out_out_of_range() {
    let (mut bench, buffer, ..) = self::buffer();
    bench.at(1);
    assert_eq!(code(bench.receive_buffer(buffer, SystemTime::MAX, &mut Vec::new())), IP);
}

#[test]
fn buf_recv_03_oldest_message_and_the_first_senders_enters() {
    let (mut bench, buffer, b, a) = self::buffer();
    done(bench.send_buffer(buffer, b"one", 0));
    waits(bench.send_buffer(buffer, b"two", FOREVER));
    bench.runs(a);
    assert_eq!(receive(&mut bench, buffer), b"one");
    bench.runs(b);
    assert_eq!(receive(&mut bench, buffer), b"two");
}

#[test]
fn buf_recv_04_empty_and_no_waiting() {
    let (mut bench, buffer, ..) = self::buffer();
    assert_eq!(code(bench.receive_buffer(buffer, 0, &mut Vec::new())), NV);
}

#[test]
fn buf_recv_05_empty_and_waiting_forbidden() {
    let (mut bench, buffer, ..) = self::buffer();
    done(bench.lock_preemption());
    assert_eq!(code(bench.receive_buffer(buffer, 1, &mut Vec::new())), IM);
}

#[test]
fn buf_recv_06_message_in_time() {
    let (mut bench, buffer, b, _) = self::buffer();
    waits(bench.receive_buffer(buffer, ms(10), &mut Vec::new()));
    bench.at(9);
    done(bench.send_buffer(buffer, b"x", 0));
    bench.runs(b);
    assert_eq!((bench.result(), bench.next_timer()), (NE, None));
}

#[test]
fn buf_recv_07_no_message_in_time() {
    let (mut bench, buffer, b, _) = self::buffer();
    waits(bench.receive_buffer(buffer, ms(10), &mut Vec::new()));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
    assert_eq!(bench.get_buffer_status(buffer).unwrap().waiting_processes, 0);
}

#[test]
fn buf_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_buffer_id("a")), IC);
}

#[test]
fn buf_id_02_known_name() {
    let (bench, buffer, ..) = self::buffer();
    assert_eq!(bench.get_buffer_id("buffer"), Ok(buffer));
}

#[test]
fn buf_id_03_in_all_modes_and_the_caller_runs_on() {
    assert_eq!(code(Bench::new().get_buffer_id("a")), IC);
    let (bench, buffer, b, _) = self::buffer();
    assert_eq!(bench.get_buffer_id("buffer"), Ok(buffer));
    bench.runs(b);
}

#[test]
fn buf_stat_01_unknown_buffer() {
    assert_eq!(code(Bench::new().get_buffer_status(BufferId(1))), IP);
}

#[test]
fn buf_stat_02_status_is_one_of_this_moment() {
    let (mut bench, buffer, ..) = self::buffer();
    done(bench.send_buffer(buffer, b"x", 0));
    let status = bench.get_buffer_status(buffer).unwrap();
    let expected =
        BufferStatus { nb_message: 1, max_nb_message: 1, max_message_size: 4, waiting_processes: 0 };
    assert_eq!(status, expected);
}

#[test]
fn buf_stat_03_suspended_processes_count_among_those_that_wait() {
    let (mut bench, buffer, b, _) = self::buffer();
    waits(bench.receive_buffer(buffer, FOREVER, &mut Vec::new()));
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_buffer_status(buffer).unwrap().waiting_processes, 1);
}

#[test]
fn bb_create_01_too_many_or_too_much_memory() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 1);
    bench.create_blackboard("a", 1).unwrap();
    assert_eq!(code(bench.create_blackboard("b", 1)), IC);
    let mut bench = Bench::with(|settings| settings.limits.object_memory = 9);
    assert_eq!(code(bench.create_blackboard("a", 10)), IC);
}

#[test]
fn bb_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_blackboard("a", 1).unwrap();
    assert_eq!(code(bench.create_blackboard("a", 1)), NA);
}

#[test]
fn bb_create_03_message_size() {
    assert_eq!(code(Bench::new().create_blackboard("a", 0)), IP);
}

#[test]
fn bb_create_04_not_in_normal() {
    assert_eq!(code(Bench::running().0.create_blackboard("a", 1)), IM);
}

#[test]
fn bb_create_05_new_blackboard_is_empty() {
    let (bench, board, ..) = blackboard();
    assert_eq!(bench.get_blackboard_status(board).unwrap().empty_indicator, EmptyIndicator::Empty);
}

#[test]
fn bb_disp_01_unknown_blackboard() {
    assert_eq!(Bench::new().display_blackboard(BlackboardId(1), b"x"), IP);
}

#[test]
fn bb_disp_02_message_too_long() {
    let (mut bench, board, ..) = blackboard();
    assert_eq!(bench.display_blackboard(board, b"12345"), IP);
    assert_eq!(bench.display_blackboard(board, b"1234"), NE);
}

#[test]
fn bb_disp_03_empty_message() {
    let (mut bench, board, ..) = blackboard();
    assert_eq!(bench.display_blackboard(board, b""), IP);
}

#[test]
fn bb_disp_04_message_takes_the_place_of_the_one_before() {
    let (mut bench, board, ..) = blackboard();
    bench.display_blackboard(board, b"old").unwrap();
    bench.display_blackboard(board, b"new").unwrap();
    let mut message = Vec::new();
    done(bench.read_blackboard(board, 0, &mut message));
    assert_eq!(message, b"new");
    assert_eq!(bench.get_blackboard_status(board).unwrap().empty_indicator, EmptyIndicator::Occupied);
}

#[test]
fn bb_disp_05_everybody_who_waits_has_it() {
    let mut bench = Bench::new();
    let board = bench.create_blackboard("board", 4).unwrap();
    let readers = [bench.started("b", 30), bench.started("c", 20)];
    bench.started("a", 10);
    bench.normal();
    for _ in readers {
        waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
    }
    bench.display_blackboard(board, b"all").unwrap();
    for reader in readers {
        bench.runs(reader);
        assert_eq!((bench.result(), bench.message()), (NE, &b"all"[..]));
        bench.stop_self();
    }
}

#[test]
fn bb_read_01_unknown_blackboard() {
    assert_eq!(code(Bench::new().read_blackboard(BlackboardId(1), 0, &mut Vec::new())), IP);
}

#[test]
fn bb_read_02_time_out_out_of_range() {
    let (mut bench, board, ..) = blackboard();
    bench.at(1);
    assert_eq!(code(bench.read_blackboard(board, SystemTime::MAX, &mut Vec::new())), IP);
}

#[test]
fn bb_read_03_message_stays() {
    let (mut bench, board, ..) = blackboard();
    bench.display_blackboard(board, b"x").unwrap();
    for _ in 0..2 {
        let mut message = Vec::new();
        done(bench.read_blackboard(board, FOREVER, &mut message));
        assert_eq!(message, b"x");
    }
}

#[test]
fn bb_read_04_empty_and_no_waiting() {
    let (mut bench, board, ..) = blackboard();
    assert_eq!(code(bench.read_blackboard(board, 0, &mut Vec::new())), NV);
}

#[test]
fn bb_read_05_empty_and_waiting_forbidden() {
    let (mut bench, board, ..) = blackboard();
    done(bench.lock_preemption());
    assert_eq!(code(bench.read_blackboard(board, FOREVER, &mut Vec::new())), IM);
}

#[test]
fn bb_read_06_displayed_in_time() {
    let (mut bench, board, b, _) = blackboard();
    waits(bench.read_blackboard(board, ms(10), &mut Vec::new()));
    bench.at(9);
    bench.display_blackboard(board, b"x").unwrap();
    bench.runs(b);
    assert_eq!((bench.result(), bench.next_timer()), (NE, None));
}

#[test]
fn bb_read_07_not_displayed_in_time() {
    let (mut bench, board, b, _) = blackboard();
    waits(bench.read_blackboard(board, ms(10), &mut Vec::new()));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn bb_read_08_cleared_before_the_woken_reader_runs() {
    let (mut bench, board, b, a) = blackboard();
    waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
    done(bench.lock_preemption());
    bench.display_blackboard(board, b"x").unwrap();
    bench.clear_blackboard(board).unwrap();
    bench.runs(a);
    bench.unlock_preemption().unwrap();
    bench.runs(b);
    assert_eq!((bench.result(), bench.message()), (NE, &b"x"[..]));
}

#[test]
fn bb_clear_01_unknown_blackboard() {
    assert_eq!(Bench::new().clear_blackboard(BlackboardId(1)), IP);
}

#[test]
fn bb_clear_02_empty_afterwards_and_nobody_wakes() {
    let (mut bench, board, _, a) = blackboard();
    assert_eq!(bench.clear_blackboard(board), NE);
    waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
    assert_eq!(bench.clear_blackboard(board), NE);
    bench.runs(a);
    bench.display_blackboard(board, b"x").unwrap();
    assert_eq!(bench.clear_blackboard(board), NE);
    assert_eq!(bench.get_blackboard_status(board).unwrap().empty_indicator, EmptyIndicator::Empty);
}

#[test]
fn bb_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_blackboard_id("a")), IC);
}

#[test]
fn bb_id_02_known_name() {
    let (bench, board, ..) = blackboard();
    assert_eq!(bench.get_blackboard_id("board"), Ok(board));
}

#[test]
fn bb_id_03_in_all_modes_and_the_caller_runs_on() {
    assert_eq!(code(Bench::new().get_blackboard_id("a")), IC);
    let (bench, board, b, _) = blackboard();
    assert_eq!(bench.get_blackboard_id("board"), Ok(board));
    bench.runs(b);
}

#[test]
fn bb_stat_01_unknown_blackboard() {
    assert_eq!(code(Bench::new().get_blackboard_status(BlackboardId(1))), IP);
}

#[test]
fn bb_stat_02_status_is_one_of_this_moment() {
    let (bench, board, ..) = blackboard();
    let expected = BlackboardStatus {
        empty_indicator: EmptyIndicator::Empty,
        max_message_size: 4,
        waiting_processes: 0,
    };
    assert_eq!(bench.get_blackboard_status(board), Ok(expected));
}

#[test]
fn bb_stat_03_suspended_processes_count_among_those_that_wait() {
    let (mut bench, board, b, _) = blackboard();
    waits(bench.read_blackboard(board, FOREVER, &mut Vec::new()));
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_blackboard_status(board).unwrap().waiting_processes, 1);
}
