//! PROC-CREATE, PROC-START, PROC-DSTART.

use bateleur_processes::Dispatch;
use bateleur_processes::standard::*;

use crate::bench::*;

/// Changes one attribute of a process that could be created, and gives what becomes of it.
fn create(change: impl FnOnce(&mut ProcessAttributes)) -> Code {
    let mut attributes = Bench::attributes("p", 10);
    change(&mut attributes);
    code(Bench::new().create_process(&attributes))
}

#[test]
fn proc_create_01_too_many_or_too_much_memory() {
    let mut bench = Bench::with(|settings| settings.limits.processes = 1);
    bench.created("a", 1);
    assert_eq!(code(bench.create_process(&Bench::attributes("b", 1))), IC);
    let mut bench = Bench::with(|settings| settings.limits.stack_memory = u64::from(STACK) * 2 - 1);
    bench.created("a", 1);
    assert_eq!(code(bench.create_process(&Bench::attributes("b", 1))), IC);
}

#[test]
fn proc_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.created("a", 1);
    assert_eq!(code(bench.create_process(&Bench::attributes("a", 1))), NA);
}

#[test]
fn proc_create_03_stack_size() {
    assert_eq!(create(|attributes| attributes.stack_size = 0), IP);
    assert_eq!(create(|attributes| attributes.stack_size = 8 << 10), NE);
}

#[test]
fn proc_create_04_priority_outside_1_to_239() {
    for (priority, expected) in [(0, IP), (240, IP), (-1, IP), (1, NE), (239, NE)] {
        assert_eq!(create(|attributes| attributes.base_priority = priority), expected, "{priority}");
    }
}

#[test]
fn proc_create_05_period() {
    assert_eq!(create(|attributes| attributes.period = SystemTime::MIN), IP);
}

#[test]
fn proc_create_06_period_is_no_multiple_of_the_partitions() {
    assert_eq!(create(|attributes| attributes.period = ms(150)), IC);
    assert_eq!(create(|attributes| attributes.period = ms(300)), NE);
}

#[test]
fn proc_create_07_time_capacity() {
    assert_eq!(create(|attributes| attributes.time_capacity = -2), IP);
}

#[test]
fn proc_create_08_time_capacity_above_the_period() {
    assert_eq!(create(|attributes| (attributes.period, attributes.time_capacity) = (ms(100), ms(101))), IP);
}

#[test]
fn proc_create_09_not_in_normal() {
    let (mut bench, _) = Bench::running();
    assert_eq!(code(bench.create_process(&Bench::attributes("b", 1))), IM);
}

#[test]
fn proc_create_10_process_is_dormant_with_its_base_priority() {
    let mut bench = Bench::new();
    let a = bench.created("a", 10);
    assert_eq!((bench.state(a), bench.priority(a)), (ProcessState::Dormant, 10));
}

#[test]
fn proc_create_11_periodic_without_a_deadline() {
    assert_eq!(create(|attributes| attributes.period = ms(100)), NE);
}

#[test]
fn proc_create_12_aperiodic_with_and_without_a_deadline() {
    assert_eq!(create(|attributes| attributes.time_capacity = ms(5)), NE);
    assert_eq!(create(|_| {}), NE);
}

#[test]
fn proc_create_13_time_capacity_as_long_as_the_period() {
    assert_eq!(create(|attributes| (attributes.period, attributes.time_capacity) = (ms(100), ms(100))), NE);
}

#[test]
fn proc_create_14_period_or_capacity_0() {
    one_of(create(|attributes| attributes.period = 0), &[IP, NE]);
    one_of(create(|attributes| attributes.time_capacity = 0), &[IP, NE]);
}

#[test]
fn proc_create_15_period_below_infinite() {
    one_of(create(|attributes| attributes.period = -2), &[IP, NE]);
}

#[test]
fn proc_create_16_mode_is_checked_first_or_last() {
    let (mut bench, _) = Bench::running();
    one_of(code(bench.create_process(&Bench::attributes("a", 0))), &[IM, NA, IP]);
}

#[test]
fn proc_start_01_unknown_process() {
    assert_eq!(Bench::new().start(ProcessId(1)), IP);
}

#[test]
fn proc_start_02_process_that_is_not_dormant() {
    let (mut bench, a) = Bench::running();
    assert_eq!(bench.start(a), NA);
}

#[test]
fn proc_start_03_deadline_beyond_all_times() {
    let mut bench = Bench::new();
    let mut attributes = Bench::attributes("b", 20);
    attributes.time_capacity = SystemTime::MAX;
    let b = bench.create_process(&attributes).unwrap();
    bench.started("a", 10);
    bench.normal();
    bench.at(1);
    assert_eq!(bench.start(b), IC);
    assert_eq!(bench.state(b), ProcessState::Dormant);
}

#[test]
fn proc_start_04_aperiodic_is_ready_behind_its_equals() {
    let mut bench = Bench::new();
    let (a, equal) = (bench.started("a", 10), bench.started("b", 10));
    let c = bench.timed("c", 10, -1, 40);
    bench.normal();
    bench.at(7);
    bench.start(c).unwrap();
    assert_eq!(bench.deadline(c), Some(47));
    assert_eq!(bench.order(), [a, equal, c]);
}

#[test]
fn proc_start_05_periodic_waits_for_its_first_release() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, 30);
    let a = bench.started("a", 10);
    bench.normal();
    bench.at(7);
    bench.start(p).unwrap();
    bench.runs(a);
    assert_eq!((bench.state(p), bench.deadline(p)), (ProcessState::Waiting, Some(130)));
    bench.at(100);
    bench.runs(p);
}

#[test]
fn proc_start_06_waits_for_normal() {
    let mut bench = Bench::new();
    let a = bench.started("a", 10);
    assert_eq!(bench.state(a), ProcessState::Waiting);
    bench.normal();
    assert_eq!(bench.state(a), ProcessState::Running);
}

#[test]
fn proc_start_07_begins_afresh() {
    let mut bench = Bench::new();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    bench.set_priority(b, 30).unwrap();
    waits(bench.suspend_self(FOREVER));
    bench.runs(a);
    bench.stop(b).unwrap();
    bench.start(b).unwrap();
    assert_eq!(bench.priority(b), 20);
    assert!(matches!(bench.dispatch(), Dispatch::Run { life: 2, .. }), "from its entry point");
    bench.runs(b);
}

#[test]
fn proc_dstart_01_unknown_process() {
    assert_eq!(Bench::new().delayed_start(ProcessId(1), 0), IP);
}

#[test]
fn proc_dstart_02_process_that_is_not_dormant() {
    let (mut bench, a) = Bench::running();
    assert_eq!(bench.delayed_start(a, 0), NA);
}

#[test]
fn proc_dstart_03_delay_out_of_range() {
    let (mut bench, _, b) = Bench::pair();
    bench.at(1);
    assert_eq!((bench.delayed_start(b, -2), bench.delayed_start(b, SystemTime::MAX)), (IP, IP));
}

#[test]
fn proc_dstart_04_infinite_delay() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.delayed_start(b, FOREVER), IP);
}

#[test]
fn proc_dstart_05_delay_not_below_the_period() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, -1);
    assert_eq!((bench.delayed_start(p, ms(100)), bench.delayed_start(p, ms(100) - 1)), (IP, NE));
}

#[test]
fn proc_dstart_06_deadline_beyond_all_times() {
    let mut bench = Bench::new();
    let mut attributes = Bench::attributes("b", 20);
    attributes.time_capacity = SystemTime::MAX - ms(10);
    let b = bench.create_process(&attributes).unwrap();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.delayed_start(b, ms(11)), IC);
}

#[test]
fn proc_dstart_07_delay_0_is_start() {
    let (mut bench, _, b) = Bench::pair();
    assert_eq!(bench.delayed_start(b, 0), NE);
    bench.runs(b);
}

#[test]
fn proc_dstart_08_aperiodic_begins_after_the_delay() {
    let mut bench = Bench::new();
    let b = bench.timed("b", 20, -1, 40);
    let a = bench.started("a", 10);
    bench.normal();
    bench.at(3);
    bench.delayed_start(b, ms(5)).unwrap();
    assert_eq!(bench.deadline(b), Some(48));
    bench.at(7);
    bench.runs(a);
    bench.at(8);
    bench.runs(b);
}

#[test]
fn proc_dstart_09_periodic_begins_so_much_after_a_period_start() {
    let mut bench = Bench::new();
    let p = bench.timed("p", 20, 100, 40);
    let a = bench.started("a", 10);
    bench.normal();
    bench.at(3);
    bench.delayed_start(p, ms(30)).unwrap();
    assert_eq!(bench.deadline(p), Some(170));
    bench.at(129);
    bench.runs(a);
    bench.at(130);
    bench.runs(p);
}

#[test]
fn proc_dstart_10_in_start_mode_the_delay_counts_from_normal() {
    let mut bench = Bench::new();
    let (a, p) = (bench.created("a", 10), bench.timed("p", 20, 100, 40));
    bench.delayed_start(a, ms(5)).unwrap();
    bench.delayed_start(p, ms(30)).unwrap();
    bench.at(20);
    bench.normal();
    bench.at(24);
    bench.nobody_runs();
    bench.at(25);
    bench.runs(a);
    assert_eq!(bench.deadline(p), Some(170));
    bench.at(130);
    bench.runs(p);
}

#[test]
fn proc_dstart_11_infinite_delay_of_a_process_that_is_not_dormant() {
    let (mut bench, a) = Bench::running();
    one_of(bench.delayed_start(a, FOREVER), &[NA, IP]);
}
