//! TIME: time management.

use bateleur_processes::standard::*;

use crate::bench::*;

/// A periodic process (100 ms) that runs since its release at 100 ms.
fn periodic(capacity: i64) -> (Bench, ProcessId) {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, capacity);
    bench.create_error_handler(STACK).unwrap();
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    bench.runs(p);
    (bench, p)
}

#[test]
fn time_twait_01_owner_and_handler_must_not() {
    assert_eq!(code(Bench::owner().0.timed_wait(1)), IM);
    assert_eq!(code(Bench::in_handler().0.timed_wait(1)), IM);
}

#[test]
fn time_twait_02_delay_out_of_range() {
    let (mut bench, _) = Bench::running();
    bench.at(1);
    assert_eq!((code(bench.timed_wait(-2)), code(bench.timed_wait(SystemTime::MAX))), (IP, IP));
}

#[test]
fn time_twait_03_infinite_delay() {
    assert_eq!(code(Bench::running().0.timed_wait(FOREVER)), IP);
}

#[test]
fn time_twait_04_delay_0_gives_way_to_equals() {
    let mut bench = Bench::new();
    let (a, b) = (bench.started("a", 10), bench.started("b", 10));
    bench.normal();
    done(bench.timed_wait(0));
    bench.runs(b);
    bench.stop_self();
    done(bench.timed_wait(0));
    bench.runs(a);
}

#[test]
fn time_twait_05_waits_for_the_delay() {
    let (mut bench, a) = Bench::running();
    waits(bench.timed_wait(ms(5)));
    assert_eq!(bench.state(a), ProcessState::Waiting);
    bench.at(5);
    bench.runs(a);
    assert_eq!(bench.result(), NE);
}

#[test]
fn time_twait_06_never_early() {
    let (mut bench, a) = Bench::running();
    waits(bench.timed_wait(ms(5)));
    bench.advance(ms(5) - 1);
    bench.nobody_runs();
    bench.advance(ms(5));
    bench.runs(a);
}

#[test]
fn time_twait_07_periodic_process_may() {
    let (mut bench, p) = periodic(-1);
    waits(bench.timed_wait(ms(5)));
    bench.at(105);
    bench.runs(p);
}

#[test]
fn time_twait_08_not_in_start_mode() {
    assert_eq!(code(Bench::new().timed_wait(1)), IM);
}

#[test]
fn time_pwait_01_owner_and_handler_must_not() {
    let (mut bench, _) = periodic(-1);
    done(bench.lock_preemption());
    assert_eq!(code(bench.periodic_wait()), IM);
    bench.raise("x");
    assert_eq!(code(bench.periodic_wait()), IM);
}

#[test]
fn time_pwait_02_aperiodic_process_must_not() {
    let (mut bench, a) = Bench::running();
    assert_eq!(code(bench.periodic_wait()), IM);
    bench.runs(a);
}

#[test]
fn p4_05_periodic_wait_of_an_aperiodic_process_beside_a_periodic_one_is_refused() {
    let mut bench = Bench::new();
    let mut attributes = Bench::attributes("periodic", 20);
    attributes.period = ms(100);
    let periodic = bench.create_process(&attributes).unwrap();
    let aperiodic = bench.create_process(&Bench::attributes("aperiodic", 10)).unwrap();
    bench.start(periodic).unwrap();
    bench.start(aperiodic).unwrap();
    bench.normal();
    bench.runs(aperiodic);
    assert_eq!(code(bench.periodic_wait()), IM, "until the first release of the other");
    bench.runs(aperiodic);
}

#[test]
fn time_pwait_03_next_deadline_beyond_all_times() {
    let mut bench = Bench::new();
    let mut attributes = Bench::attributes("p", 20);
    let period = ms(100) * (SystemTime::MAX / 3 / ms(100)); // the third release is still a time, its deadline is not
    (attributes.period, attributes.time_capacity) = (period, period);
    let p = bench.create_process(&attributes).unwrap();
    bench.start(p).unwrap();
    bench.normal();
    bench.at(100);
    waits(bench.periodic_wait());
    bench.advance(period + ms(100));
    assert_eq!(code(bench.periodic_wait()), IC);
}

#[test]
fn time_pwait_04_next_release_is_a_period_after_the_last() {
    let (mut bench, p) = periodic(40);
    bench.at(115);
    waits(bench.periodic_wait());
    assert_eq!((bench.state(p), bench.deadline(p)), (ProcessState::Waiting, Some(240)));
    bench.at(199);
    bench.nobody_runs();
    bench.at(200);
    bench.runs(p);
    assert_eq!(bench.result(), NE);
}

#[test]
fn time_pwait_05_release_that_has_passed_is_taken_at_once_or_left_out() {
    let (mut bench, p) = periodic(-1);
    bench.at(250);
    waits(bench.periodic_wait());
    if bench.who().is_none() {
        bench.at(300);
    }
    bench.runs(p);
}

#[test]
fn time_pwait_06_without_a_deadline() {
    let (mut bench, p) = periodic(-1);
    one_of(code(bench.periodic_wait()), &[NE, IC]);
    assert_eq!(bench.deadline(p), None);
}

#[test]
fn time_get_01_in_every_mode() {
    let mut bench = Bench::new();
    bench.at(3);
    assert_eq!(bench.get_time(), ms(3));
    let (bench, _) = Bench::in_handler();
    assert_eq!(bench.get_time(), 0);
}

#[test]
fn time_get_02_never_backwards_and_not_from_the_start_again() {
    let (mut bench, _) = Bench::running();
    bench.at(50);
    bench.at(40);
    assert_eq!(bench.get_time(), ms(50));
    bench.set_partition_mode(OperatingMode::ColdStart).unwrap();
    assert_eq!(bench.partition.restarted().get_time(), ms(50));
}

#[test]
fn time_repl_01_handler_and_start_mode() {
    assert_eq!(Bench::new().replenish(1), NA);
    assert_eq!(Bench::in_handler().0.replenish(1), NA);
}

#[test]
fn time_repl_02_process_without_a_deadline() {
    let (mut bench, a) = Bench::running();
    one_of(bench.replenish(ms(5)), &[NE, NA]);
    assert_eq!(bench.deadline(a), None);
}

#[test]
fn time_repl_03_periodic_beyond_its_next_release() {
    let (mut bench, p) = periodic(30);
    bench.at(120);
    assert_eq!((bench.replenish(FOREVER), bench.replenish(ms(81))), (IM, IM));
    assert_eq!(bench.deadline(p), Some(130));
}

#[test]
fn time_repl_04_periodic_up_to_its_next_release() {
    let (mut bench, _) = periodic(30);
    bench.at(120);
    one_of(bench.replenish(ms(80)), &[IM, NE]);
}

#[test]
fn time_repl_05_budget_out_of_range() {
    let mut bench = Bench::new();
    let a = bench.timed("a", 10, -1, 50);
    bench.start(a).unwrap();
    bench.normal();
    bench.at(1);
    assert_eq!((bench.replenish(-2), bench.replenish(SystemTime::MAX)), (IP, IP));
    one_of(periodic(30).0.replenish(SystemTime::MAX), &[IP, IM]);
}

#[test]
fn time_repl_06_aperiodic_without_end() {
    let mut bench = Bench::new();
    let a = bench.timed("a", 10, -1, 50);
    bench.start(a).unwrap();
    bench.normal();
    assert_eq!(bench.replenish(FOREVER), NE);
    assert_eq!((bench.deadline(a), bench.next_timer()), (None, None));
}

#[test]
fn time_repl_07_deadline_is_the_budget_from_now() {
    let (mut bench, p) = periodic(30);
    bench.at(120);
    assert_eq!(bench.replenish(ms(50)), NE);
    assert_eq!(bench.deadline(p), Some(170));
    bench.at(169);
    bench.runs(p);
    bench.at(170);
    bench.handler_runs();
}

#[test]
fn time_repl_08_smaller_budget_brings_the_deadline_nearer() {
    let (mut bench, p) = periodic(30);
    assert_eq!(bench.replenish(ms(10)), NE);
    assert_eq!(bench.deadline(p), Some(110));
    bench.at(110);
    bench.handler_runs();
}
