//! PART: partition management.

use bateleur_processes::standard::*;
use bateleur_processes::{End, Partition, PeriodGrid, Runner};

use crate::bench::*;

fn restart(mode: OperatingMode, condition: StartCondition) -> Option<End> {
    Some(End::Restart { mode, condition })
}

#[test]
fn part_stat_01_status_is_always_given() {
    let mut bench = Bench::new();
    assert_eq!(bench.get_partition_status().operating_mode, OperatingMode::ColdStart);
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.get_partition_status().operating_mode, OperatingMode::Normal);
    bench.set_partition_mode(OperatingMode::Idle).unwrap();
    assert_eq!(bench.get_partition_status().operating_mode, OperatingMode::Idle);
}

#[test]
fn part_stat_02_status_has_period_duration_identifier_and_cores() {
    let mut bench = Bench::with(|settings| (settings.identifier, settings.duration) = (7, ms(50)));
    let status = bench.get_partition_status();
    assert_eq!((status.period, status.duration), (ms(100), ms(50)));
    assert_eq!((status.identifier, status.num_assigned_cores), (7, 1));
    bench.change_grid(PeriodGrid { origin: 0, period: ms(200) }, ms(20));
    let status = bench.get_partition_status();
    assert_eq!((status.period, status.duration), (ms(200), ms(20)), "of the active schedule");
}

#[test]
fn part_stat_03_start_condition_is_the_cause_of_the_last_start() {
    let mut bench = Bench::new();
    assert_eq!(bench.get_partition_status().start_condition, StartCondition::NormalStart);
    bench.set_partition_mode(OperatingMode::ColdStart).unwrap();
    let mut partition = bench.partition.restarted();
    assert_eq!(partition.get_partition_status().start_condition, StartCondition::PartitionRestart);
    partition.raise_application_error(ErrorCode::ApplicationError, b"").unwrap();
    let partition = partition.restarted();
    assert_eq!(partition.get_partition_status().start_condition, StartCondition::HmPartitionRestart);
}

#[test]
fn part_stat_04_lock_level_is_the_count_of_the_preemption_lock() {
    let mut bench = Bench::new();
    assert!(bench.get_partition_status().lock_level >= 0);
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.get_partition_status().lock_level, 0);
    done(bench.lock_preemption());
    done(bench.lock_preemption());
    assert_eq!(bench.get_partition_status().lock_level, 2);
}

#[test]
fn part_mode_01_unknown_mode_is_a_wrong_parameter() {
    assert_eq!(Bench::new().set_partition_mode(4_u32), IP);
}

#[test]
fn part_mode_02_normal_in_normal_does_nothing() {
    let (mut bench, a) = Bench::running();
    assert_eq!(bench.set_partition_mode(OperatingMode::Normal), NA);
    bench.runs(a);
}

#[test]
fn part_mode_03_warm_start_in_cold_start_is_refused() {
    assert_eq!(Bench::new().set_partition_mode(OperatingMode::WarmStart), IM);
}

#[test]
fn part_mode_04_nobody_runs_in_an_idle_partition() {
    let (mut bench, _) = Bench::running();
    bench.set_partition_mode(OperatingMode::Idle).unwrap();
    bench.at(1000);
    assert_eq!(bench.end(), Some(End::Idle));
}

#[test]
fn part_mode_05_start_modes_restart_and_do_not_return() {
    for mode in [OperatingMode::ColdStart, OperatingMode::WarmStart] {
        let (mut bench, _) = Bench::running();
        bench.set_partition_mode(mode).unwrap();
        assert_eq!(bench.end(), restart(mode, StartCondition::PartitionRestart));
    }
}

#[test]
fn part_mode_06_normal_begins_what_was_started() {
    let mut bench = Bench::new();
    let a = bench.started("a", 10);
    assert_eq!(bench.set_partition_mode(OperatingMode::Normal), NE);
    bench.runs(a);
}

#[test]
fn part_mode_07_start_mode_can_be_asked_for_again_in_itself() {
    for mode in [OperatingMode::ColdStart, OperatingMode::WarmStart] {
        let mut bench = Bench::with(|settings| settings.mode = mode);
        bench.set_partition_mode(mode).unwrap();
        assert_eq!(bench.end(), restart(mode, StartCondition::PartitionRestart));
    }
    let mut bench = Bench::with(|settings| settings.mode = OperatingMode::WarmStart);
    assert_eq!(bench.set_partition_mode(OperatingMode::ColdStart), NE);
}

#[test]
fn part_mode_08_error_handler_and_owner_of_the_lock_may_change_the_mode() {
    let (mut bench, _) = Bench::in_handler();
    assert_eq!(bench.set_partition_mode(OperatingMode::Idle), NE);
    let (mut bench, _) = Bench::running();
    done(bench.lock_preemption());
    assert_eq!(bench.set_partition_mode(OperatingMode::ColdStart), NE);
    assert!(bench.end().is_some());
}

#[test]
fn part_mode_09_not_available_is_no_answer() {
    let mut bench = Bench::new();
    for mode in [3, 3, 2, 1, 0_u32] {
        assert_ne!(bench.set_partition_mode(mode), NV);
    }
}

#[test]
fn restart_keeps_time_and_nothing_else() {
    let (mut bench, a) = Bench::running();
    bench.at(33);
    bench.set_partition_mode(OperatingMode::WarmStart).unwrap();
    let partition: Partition = bench.partition.restarted();
    assert_eq!(partition.get_time(), ms(33));
    assert_eq!(code(partition.get_process_status(a)), IP);
    assert!(matches!(partition.dispatch(), bateleur_processes::Dispatch::Run { who: Runner::Main, .. }));
}
