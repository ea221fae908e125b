//! SEM: semaphores.

use bateleur_processes::standard::*;

use crate::bench::*;

/// In NORMAL: a semaphore with this value and maximum, a process `b` (20) that runs, and behind it `a` (10).
fn semaphore(value: i32, maximum: i32) -> (Bench, SemaphoreId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    let semaphore = bench.create_semaphore("s", value, maximum, FIFO).unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    (bench, semaphore, b, a)
}

fn value(bench: &Bench, semaphore: SemaphoreId) -> i32 {
    bench.get_semaphore_status(semaphore).unwrap().current_value
}

#[test]
fn sem_create_01_too_many() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 0);
    assert_eq!(code(bench.create_semaphore("s", 0, 1, FIFO)), IC);
}

#[test]
fn sem_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    assert_eq!(code(bench.create_semaphore("s", 0, 1, FIFO)), NA);
}

#[test]
fn sem_create_03_current_value() {
    for value in [-1, 32_768] {
        assert_eq!(code(Bench::new().create_semaphore("s", value, 32_767, FIFO)), IP, "{value}");
    }
}

#[test]
fn sem_create_04_maximum_value() {
    for maximum in [-1, 32_768] {
        assert_eq!(code(Bench::new().create_semaphore("s", 0, maximum, FIFO)), IP, "{maximum}");
    }
    assert_eq!(code(Bench::new().create_semaphore("s", 0, 32_767, FIFO)), NE);
}

#[test]
fn sem_create_05_current_above_maximum() {
    assert_eq!(code(Bench::new().create_semaphore("s", 2, 1, FIFO)), IP);
}

#[test]
fn sem_create_06_discipline() {
    assert_eq!(code(Bench::new().create_semaphore("s", 0, 1, NONSENSE)), IP);
}

#[test]
fn sem_create_07_not_in_normal() {
    assert_eq!(code(Bench::running().0.create_semaphore("s", 0, 1, FIFO)), IM);
}

#[test]
fn sem_create_08_semaphore_has_its_value() {
    let (bench, semaphore, ..) = semaphore(3, 5);
    assert_eq!(value(&bench, semaphore), 3);
}

#[test]
fn sem_wait_01_unknown_semaphore() {
    assert_eq!(code(Bench::new().wait_semaphore(SemaphoreId(1), 0)), IP);
}

#[test]
fn sem_wait_02_time_out_out_of_range() {
    let (mut bench, semaphore, ..) = semaphore(1, 1);
    bench.at(1);
    assert_eq!(code(bench.wait_semaphore(semaphore, SystemTime::MAX)), IP);
    assert_eq!(value(&bench, semaphore), 1);
}

#[test]
fn sem_wait_03_value_above_0() {
    let (mut bench, semaphore, b, _) = semaphore(2, 2);
    done(bench.wait_semaphore(semaphore, FOREVER));
    bench.runs(b);
    assert_eq!(value(&bench, semaphore), 1);
}

#[test]
fn sem_wait_04_value_0_and_no_waiting() {
    let (mut bench, semaphore, ..) = semaphore(0, 1);
    assert_eq!(code(bench.wait_semaphore(semaphore, 0)), NV);
}

#[test]
fn sem_wait_05_value_0_and_waiting_forbidden() {
    let (mut bench, semaphore, ..) = semaphore(0, 1);
    done(bench.lock_preemption());
    assert_eq!(code(bench.wait_semaphore(semaphore, 1)), IM);
}

#[test]
fn sem_wait_06_signalled_in_time() {
    let (mut bench, semaphore, b, _) = semaphore(0, 1);
    waits(bench.wait_semaphore(semaphore, ms(10)));
    bench.signal_semaphore(semaphore).unwrap();
    bench.runs(b);
    assert_eq!((bench.result(), bench.next_timer()), (NE, None));
}

#[test]
fn sem_wait_07_not_signalled_in_time() {
    let (mut bench, semaphore, b, _) = semaphore(0, 1);
    waits(bench.wait_semaphore(semaphore, ms(10)));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
    bench.signal_semaphore(semaphore).unwrap();
    assert_eq!(value(&bench, semaphore), 1);
}

#[test]
fn sem_sig_01_unknown_semaphore() {
    assert_eq!(Bench::new().signal_semaphore(SemaphoreId(1)), IP);
}

#[test]
fn sem_sig_02_value_is_the_highest() {
    let (mut bench, semaphore, ..) = semaphore(1, 1);
    assert_eq!(bench.signal_semaphore(semaphore), NA);
    assert_eq!(value(&bench, semaphore), 1);
}

#[test]
fn sem_sig_03_first_who_waits_has_the_unit() {
    let (mut bench, semaphore, b, _) = semaphore(0, 1);
    waits(bench.wait_semaphore(semaphore, FOREVER));
    assert_eq!(bench.signal_semaphore(semaphore), NE);
    bench.runs(b);
    assert_eq!(value(&bench, semaphore), 0);
}

#[test]
fn sem_sig_04_value_rises_where_nobody_waits() {
    let (mut bench, semaphore, ..) = semaphore(0, 1);
    assert_eq!(bench.signal_semaphore(semaphore), NE);
    assert_eq!(value(&bench, semaphore), 1);
}

#[test]
fn sem_sig_05_maximum_0_with_somebody_who_waits() {
    let (mut bench, semaphore, ..) = semaphore(0, 0);
    waits(bench.wait_semaphore(semaphore, FOREVER));
    one_of(bench.signal_semaphore(semaphore), &[NE, NA]);
}

#[test]
fn sem_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_semaphore_id("s")), IC);
}

#[test]
fn sem_id_02_known_name() {
    let (bench, semaphore, ..) = semaphore(0, 1);
    assert_eq!(bench.get_semaphore_id("s"), Ok(semaphore));
}

#[test]
fn sem_id_03_in_all_modes_and_the_caller_runs_on() {
    assert_eq!(code(Bench::new().get_semaphore_id("s")), IC);
    let (bench, semaphore, b, _) = semaphore(0, 1);
    assert_eq!(bench.get_semaphore_id("s"), Ok(semaphore));
    bench.runs(b);
}

#[test]
fn sem_stat_01_unknown_semaphore() {
    assert_eq!(code(Bench::new().get_semaphore_status(SemaphoreId(1))), IP);
}

#[test]
fn sem_stat_02_status_is_one_of_this_moment() {
    let (bench, semaphore, ..) = semaphore(2, 5);
    let expected = SemaphoreStatus { current_value: 2, maximum_value: 5, waiting_processes: 0 };
    assert_eq!(bench.get_semaphore_status(semaphore), Ok(expected));
}

#[test]
fn sem_stat_03_suspended_processes_count_among_those_that_wait() {
    let (mut bench, semaphore, b, _) = semaphore(0, 1);
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_semaphore_status(semaphore).unwrap().waiting_processes, 1);
}
