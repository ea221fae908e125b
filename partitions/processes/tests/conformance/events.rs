//! EVT: events.

use bateleur_processes::standard::*;

use crate::bench::*;

/// In NORMAL: an event that is down, a process `b` (20) that runs, and behind it `a` (10).
fn event() -> (Bench, EventId, ProcessId, ProcessId) {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    (bench, event, b, a)
}

#[test]
fn evt_create_01_too_many() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 0);
    assert_eq!(code(bench.create_event("e")), IC);
}

#[test]
fn evt_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_event("e").unwrap();
    assert_eq!(code(bench.create_event("e")), NA);
}

#[test]
fn evt_create_03_not_in_normal() {
    assert_eq!(code(Bench::running().0.create_event("e")), IM);
}

#[test]
fn evt_create_04_new_event_is_down() {
    let (bench, event, ..) = event();
    assert_eq!(bench.get_event_status(event).unwrap().event_state, EventState::Down);
}

#[test]
fn evt_set_01_unknown_event() {
    assert_eq!(Bench::new().set_event(EventId(1)), IP);
}

#[test]
fn evt_set_02_up_and_up_again() {
    let (mut bench, event, ..) = event();
    assert_eq!((bench.set_event(event), bench.set_event(event)), (NE, NE));
    assert_eq!(bench.get_event_status(event).unwrap().event_state, EventState::Up);
}

#[test]
fn evt_set_03_everybody_who_waits_goes_on() {
    let mut bench = Bench::new();
    let event = bench.create_event("e").unwrap();
    let (c, b, a) = (bench.started("c", 30), bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    bench.wait_for(event);
    bench.wait_for(event);
    bench.set_event(event).unwrap();
    assert_eq!(bench.order(), [c, b, a]);
}

#[test]
fn evt_reset_01_unknown_event() {
    assert_eq!(Bench::new().reset_event(EventId(1)), IP);
}

#[test]
fn evt_reset_02_down_and_woken_ones_stay_woken() {
    let (mut bench, event, b, _) = event();
    bench.wait_for(event);
    done(bench.lock_preemption());
    bench.set_event(event).unwrap();
    assert_eq!((bench.reset_event(event), bench.reset_event(event)), (NE, NE));
    bench.unlock_preemption().unwrap();
    bench.runs(b);
    assert_eq!(bench.result(), NE);
}

#[test]
fn evt_wait_01_unknown_event() {
    assert_eq!(code(Bench::new().wait_event(EventId(1), 0)), IP);
}

#[test]
fn evt_wait_02_time_out_out_of_range() {
    let (mut bench, event, ..) = event();
    bench.at(1);
    assert_eq!(code(bench.wait_event(event, SystemTime::MAX)), IP);
}

#[test]
fn evt_wait_03_up() {
    let (mut bench, event, b, _) = event();
    bench.set_event(event).unwrap();
    done(bench.wait_event(event, FOREVER));
    bench.runs(b);
}

#[test]
fn evt_wait_04_down_and_no_waiting() {
    let (mut bench, event, ..) = event();
    assert_eq!(code(bench.wait_event(event, 0)), NV);
}

#[test]
fn evt_wait_05_down_and_waiting_forbidden() {
    let (mut bench, event, ..) = event();
    done(bench.lock_preemption());
    assert_eq!(code(bench.wait_event(event, 1)), IM);
}

#[test]
fn evt_wait_06_set_in_time() {
    let (mut bench, event, b, _) = event();
    waits(bench.wait_event(event, ms(10)));
    bench.set_event(event).unwrap();
    bench.runs(b);
    assert_eq!((bench.result(), bench.next_timer()), (NE, None));
}

#[test]
fn evt_wait_07_not_set_in_time() {
    let (mut bench, event, b, _) = event();
    waits(bench.wait_event(event, ms(10)));
    bench.at(10);
    bench.runs(b);
    assert_eq!(bench.result(), TM);
}

#[test]
fn evt_id_01_unknown_name() {
    assert_eq!(code(Bench::new().get_event_id("e")), IC);
}

#[test]
fn evt_id_02_known_name() {
    let (bench, event, ..) = event();
    assert_eq!(bench.get_event_id("e"), Ok(event));
}

#[test]
fn evt_id_03_in_all_modes_and_the_caller_runs_on() {
    assert_eq!(code(Bench::new().get_event_id("e")), IC);
    let (bench, event, b, _) = event();
    assert_eq!(bench.get_event_id("e"), Ok(event));
    bench.runs(b);
}

#[test]
fn evt_stat_01_unknown_event() {
    assert_eq!(code(Bench::new().get_event_status(EventId(1))), IP);
}

#[test]
fn evt_stat_02_status_is_one_of_this_moment() {
    let (bench, event, ..) = event();
    let expected = EventStatus { event_state: EventState::Down, waiting_processes: 0 };
    assert_eq!(bench.get_event_status(event), Ok(expected));
}

#[test]
fn evt_stat_03_suspended_processes_count_among_those_that_wait() {
    let (mut bench, event, b, _) = event();
    bench.wait_for(event);
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_event_status(event).unwrap().waiting_processes, 1);
}
