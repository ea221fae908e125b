//! REL, DL: release points and deadlines.

use bateleur_processes::standard::*;
use bateleur_processes::{End, PeriodGrid};

use crate::bench::*;

#[test]
fn rel_01_releases_lie_on_the_period_starts_of_the_schedule() {
    let mut bench = Bench::with(|settings| settings.grid = PeriodGrid { origin: ms(30), period: ms(100) });
    let p = bench.timed("p", 20, 200, -1);
    bench.start(p).unwrap();
    bench.at(31);
    bench.normal();
    assert_eq!(bench.next_timer(), Some(ms(130)));
    bench.at(130);
    waits(bench.periodic_wait());
    assert_eq!(bench.next_timer(), Some(ms(330)));
}

#[test]
fn rel_02_first_release_is_at_the_next_period_start() {
    let (bench, ..) = Bench::periodic(-1);
    let first = bench.next_timer();
    assert!(
        [Some(ms(100)), None].contains(&first),
        "called exactly at a period start: the next one, or this one"
    );
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.start(p).unwrap();
    bench.advance(1);
    bench.normal();
    assert_eq!(bench.next_timer(), Some(ms(100)));
}

#[test]
fn rel_03_releases_do_not_drift() {
    let (mut bench, p, _) = Bench::periodic(-1);
    for period in 1..50 {
        bench.at(100 * period);
        bench.runs(p);
        bench.at(100 * period + period);
        waits(bench.periodic_wait());
    }
}

#[test]
fn rel_04_release_outside_of_a_window_is_seen_in_the_next_one() {
    let (mut bench, p, a) = Bench::periodic(-1);
    bench.at(50);
    bench.runs(a);
    bench.at(120);
    bench.runs(p);
    waits(bench.periodic_wait());
    assert_eq!(bench.next_timer(), Some(ms(200)));
}

#[test]
fn rel_05_delay_shifts_every_release() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.delayed_start(p, ms(30)).unwrap();
    bench.normal();
    for release in [130, 230, 330] {
        bench.at(release);
        bench.runs(p);
        waits(bench.periodic_wait());
    }
}

#[test]
fn rel_06_new_schedule_has_its_own_period_starts() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    bench.started("a", 10);
    bench.normal();
    bench.at(40);
    bench.change_grid(PeriodGrid { origin: ms(50), period: ms(100) }, ms(10));
    bench.start(p).unwrap();
    assert_eq!(bench.next_timer(), Some(ms(50)));
}

#[test]
fn rel_07_released_together_they_run_by_priority_then_in_order() {
    let mut bench = Bench::new();
    let ids = [("p", 20), ("q", 30), ("r", 20)].map(|(name, priority)| bench.timed(name, priority, 100, -1));
    ids.iter().for_each(|id| bench.start(*id).unwrap());
    bench.normal();
    bench.at(100);
    assert_eq!(bench.order(), [ids[1], ids[0], ids[2]]);
}

#[test]
fn dl_01_deadline_is_the_release_and_the_capacity() {
    let (mut bench, p, _) = Bench::periodic(30);
    assert_eq!(bench.deadline(p), Some(130));
    bench.at(110);
    assert_eq!(bench.deadline(p), Some(130));
}

#[test]
fn dl_02_deadline_runs_on_while_the_process_does_not() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let semaphore = bench.create_semaphore("s", 0, 1, FIFO).unwrap();
    let b = bench.timed("b", 20, -1, 30);
    bench.start(b).unwrap();
    bench.started("a", 10);
    bench.normal();
    waits(bench.wait_semaphore(semaphore, FOREVER));
    bench.suspend(b).unwrap();
    bench.at(30);
    bench.handler_runs();
    assert_eq!(bench.get_error_status().unwrap().failed_process_id, b);
}

#[test]
fn dl_03_missed_at_the_deadline_itself_unless_the_activation_has_ended() {
    let (mut bench, p, _) = Bench::periodic(30);
    bench.advance(ms(130) - 1);
    bench.runs(p);
    bench.at(130);
    bench.handler_runs();
    let (mut bench, _, a) = Bench::periodic(30);
    bench.advance(ms(130) - 1);
    waits(bench.periodic_wait());
    bench.at(130);
    bench.runs(a);
}

#[test]
fn dl_04_missed_outside_of_a_window_is_told_before_any_process_runs() {
    let (mut bench, ..) = Bench::periodic(80);
    bench.at(149);
    bench.at(200);
    bench.handler_runs();
}

#[test]
fn dl_05_told_once() {
    let (mut bench, p, _) = Bench::periodic(30);
    bench.at(130);
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.at(190);
    bench.runs(p);
}

#[test]
fn dl_06_late_process_goes_on_unless_the_handler_stops_it() {
    let (mut bench, p, _) = Bench::periodic(30);
    bench.at(130);
    assert_eq!(bench.state(p), ProcessState::Ready);
    bench.get_error_status().unwrap();
    bench.stop_self();
    bench.runs(p);
}

#[test]
fn dl_07_without_a_handler_the_partitions_table_decides() {
    let mut bench = Bench::new();
    let a = bench.timed("a", 10, -1, 30);
    bench.start(a).unwrap();
    bench.normal();
    bench.at(30);
    assert!(matches!(bench.end(), Some(End::Restart { mode: OperatingMode::WarmStart, .. })));
}

#[test]
fn dl_08_soft_and_hard_are_treated_alike() {
    for deadline in [Deadline::Soft, Deadline::Hard] {
        let mut bench = Bench::new();
        bench.create_error_handler(STACK).unwrap();
        let mut attributes = Bench::attributes("a", 10);
        (attributes.time_capacity, attributes.deadline) = (ms(30), deadline);
        let a = bench.create_process(&attributes).unwrap();
        bench.start(a).unwrap();
        bench.normal();
        bench.at(30);
        bench.handler_runs();
        assert_eq!(bench.get_process_status(a).unwrap().attributes.deadline, deadline);
    }
}

#[test]
fn dl_09_services_that_move_a_deadline() {
    let (mut bench, p, _) = Bench::periodic(30);
    bench.at(110);
    bench.replenish(ms(50)).unwrap();
    assert_eq!(bench.deadline(p), Some(160));
    waits(bench.periodic_wait());
    assert_eq!(bench.deadline(p), Some(230));
    bench.stop(p).unwrap();
    assert_eq!((bench.deadline(p), bench.next_timer()), (None, None));
}

#[test]
fn dl_10_aperiodic_has_one_deadline_from_start_to_stop() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let a = bench.timed("a", 10, -1, 50);
    bench.start(a).unwrap();
    bench.normal();
    waits(bench.timed_wait(ms(20)));
    bench.at(20);
    assert_eq!(bench.deadline(a), Some(50));
    bench.at(50);
    bench.handler_runs();
}

#[test]
fn dl_11_lock_and_mutex_do_not_delay_the_detection() {
    let (mut bench, ..) = Bench::periodic(30);
    bench.at(100);
    done(bench.lock_preemption());
    bench.at(130);
    bench.handler_runs();
}
