//! HM: health monitoring services, and HMT: who decides about an error.

use bateleur_processes::standard::*;
use bateleur_processes::{End, Level, Notice, PartitionAction, Settings, Verdict};

use crate::bench::*;

const APPLICATION: ErrorCode = ErrorCode::ApplicationError;

fn restart(mode: OperatingMode) -> Option<End> {
    Some(End::Restart { mode, condition: StartCondition::HmPartitionRestart })
}

/// Every error has this action in the partition's table.
fn table(action: PartitionAction) -> impl FnOnce(&mut Settings) {
    move |settings| settings.health.action = [action; ErrorCode::COUNT]
}

/// In NORMAL with one process, without an error handler.
fn unhandled(action: PartitionAction) -> (Bench, ProcessId) {
    let mut bench = Bench::with(table(action));
    let a = bench.started("a", 10);
    bench.normal();
    (bench, a)
}

fn verdict(bench: &mut Bench) -> Option<Verdict> {
    match bench.take_notice()? {
        Notice::Error { verdict, .. } => Some(verdict),
        Notice::Report { .. } | Notice::Refused { .. } | Notice::SameNameButCase { .. } => None,
    }
}

#[test]
fn hm_rep_01_message_too_long() {
    let mut bench = Bench::new();
    assert_eq!(bench.report_application_message(&[b'x'; 129]), IP);
    assert_eq!(bench.report_application_message(&[b'x'; 128]), NE);
}

#[test]
fn hm_rep_02_empty_message() {
    one_of(Bench::new().report_application_message(b""), &[NE, IP]);
}

#[test]
fn hm_rep_03_recorded_and_no_error() {
    let (mut bench, a) = Bench::running();
    bench.at(3);
    bench.report_application_message(b"hello").unwrap();
    bench.runs(a);
    let Some(Notice::Report { time, process, text }) = bench.take_notice() else { panic!("no report") };
    assert_eq!((time, process, text.as_bytes()), (ms(3), a, &b"hello"[..]));
    assert_eq!(bench.take_notice(), None);
}

#[test]
fn hm_create_01_handler_exists() {
    let mut bench = Bench::new();
    assert_eq!((bench.create_error_handler(STACK), bench.create_error_handler(STACK)), (NE, NA));
}

#[test]
fn hm_create_02_stack_or_memory() {
    assert_eq!(Bench::new().create_error_handler(0), IC);
    let mut bench = Bench::with(|settings| settings.limits.stack_memory = 0);
    assert_eq!(bench.create_error_handler(STACK), IC);
}

#[test]
fn hm_create_03_not_in_normal() {
    assert_eq!(Bench::running().0.create_error_handler(STACK), IM);
}

#[test]
fn hm_create_04_handler_sleeps_until_an_error_and_is_above_all() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let a = bench.started("a", 239);
    bench.normal();
    bench.runs(a);
    bench.raise("x");
    bench.handler_runs();
    assert!(bench.get_error_status().is_ok());
    assert_eq!(code(bench.get_error_status()), NA, "nothing else was in the list");
}

#[test]
fn hm_get_01_caller_is_not_the_handler() {
    assert_eq!(code(Bench::running().0.get_error_status()), IC);
    assert_eq!(code(Bench::new().get_error_status()), IC);
}

#[test]
fn hm_get_02_no_error_is_left() {
    let (mut bench, _) = Bench::in_handler();
    bench.get_error_status().unwrap();
    assert_eq!(code(bench.get_error_status()), NA);
}

#[test]
fn hm_get_03_oldest_error_leaves_the_list() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let late = bench.timed("late", 5, -1, 7);
    bench.start(late).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    bench.raise("x");
    bench.at(7);
    let first = bench.get_error_status().unwrap();
    let second = bench.get_error_status().unwrap();
    assert_eq!((first.error_code, first.failed_process_id), (APPLICATION, a));
    assert_eq!((second.error_code, second.failed_process_id), (ErrorCode::DeadlineMissed, late));
}

#[test]
fn hm_raise_01_message_too_long() {
    assert_eq!(Bench::running().0.raise_application_error(APPLICATION, &[0; 129]), IP);
}

#[test]
fn hm_raise_02_code_is_not_application_error() {
    let (mut bench, _) = Bench::running();
    assert_eq!(bench.raise_application_error(ErrorCode::NumericError, b""), IP);
    assert_eq!(bench.raise_application_error(NONSENSE, b""), IP);
}

#[test]
fn hm_raise_03_without_a_handler_the_partitions_table_decides() {
    let (mut bench, _) = unhandled(PartitionAction::Idle);
    bench.raise("x");
    assert_eq!(bench.end(), Some(End::Idle));
    let mut bench = Bench::with(table(PartitionAction::Idle));
    bench.create_error_handler(STACK).unwrap();
    bench.raise("in start mode");
    assert_eq!(bench.end(), Some(End::Idle));
    let (mut bench, _) = Bench::in_handler();
    bench.raise("in the handler");
    assert!(bench.end().is_some());
}

#[test]
fn hm_raise_04_handler_runs_at_once_and_the_caller_goes_on_after_it() {
    let (mut bench, a) = Bench::in_handler();
    let error = bench.get_error_status().unwrap();
    assert_eq!((error.failed_process_id, error.message.as_bytes()), (a, &b"x"[..]));
    bench.stop_self();
    bench.runs(a);
}

#[test]
fn hm_raise_05_full_list_loses_the_error_and_says_so_or_waits() {
    let mut bench = Bench::with(|settings| settings.limits.errors = 1);
    bench.create_error_handler(STACK).unwrap();
    let late = bench.timed("late", 5, -1, 7);
    bench.start(late).unwrap();
    bench.started("a", 10);
    bench.normal();
    bench.raise("x");
    bench.at(7);
    assert_eq!((verdict(&mut bench), verdict(&mut bench)), (Some(Verdict::Process), Some(Verdict::Lost)));
    bench.get_error_status().unwrap();
    assert_eq!(code(bench.get_error_status()), NA);
}

#[test]
fn hm_raise_06_caller_has_not_faulted() {
    let (bench, a) = Bench::in_handler();
    assert_eq!(bench.state(a), ProcessState::Ready);
}

#[test]
fn hm_conf_01_no_handler() {
    one_of(Bench::new().configure_error_handler(0_u32, 0), &[IC, NA]);
}

#[test]
fn hm_conf_02_not_in_normal() {
    assert_eq!(Bench::in_handler().0.configure_error_handler(0_u32, 0), IM);
}

#[test]
fn hm_conf_03_core_of_somebody_else() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    assert_eq!(bench.configure_error_handler(0_u32, 1), IC);
}

#[test]
fn hm_conf_04_concurrency() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    assert_eq!(bench.configure_error_handler(NONSENSE, 0), IP);
}

#[test]
fn hm_conf_05_both_kinds_are_accepted() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    assert_eq!(bench.configure_error_handler(ErrorHandlerConcurrency::ProcessesScheduled, 0), NE);
    assert_eq!(bench.configure_error_handler(ErrorHandlerConcurrency::ProcessesPause, 0), NE);
}

#[test]
fn hmt_01_table_says_who_decides() {
    for (level, expected) in [
        (Level::Module, Verdict::Module),
        (Level::Partition, Verdict::Partition(PartitionAction::Ignore)),
        (Level::Process, Verdict::Process),
    ] {
        let mut bench = Bench::with(|settings| {
            settings.health.level[APPLICATION as usize] = level;
            settings.health.action = [PartitionAction::Ignore; ErrorCode::COUNT];
        });
        bench.create_error_handler(STACK).unwrap();
        bench.started("a", 10);
        bench.normal();
        bench.raise("x");
        assert_eq!(verdict(&mut bench), Some(expected));
    }
}

#[test]
fn hmt_03_actions_of_the_partitions_table() {
    let cases = [
        (PartitionAction::Idle, Some(End::Idle)),
        (PartitionAction::ColdStart, restart(OperatingMode::ColdStart)),
        (PartitionAction::WarmStart, restart(OperatingMode::WarmStart)),
        (PartitionAction::Ignore, None),
    ];
    for (action, end) in cases {
        let (mut bench, _) = unhandled(action);
        bench.raise("x");
        assert_eq!(bench.end(), end, "{action:?}");
    }
}

#[test]
fn hmt_04_process_level_without_a_handler_or_in_start_mode_is_the_partitions() {
    let (mut bench, _) = unhandled(PartitionAction::Ignore);
    bench.raise("x");
    assert_eq!(verdict(&mut bench), Some(Verdict::Partition(PartitionAction::Ignore)));
    let mut bench = Bench::with(table(PartitionAction::Ignore));
    bench.create_error_handler(STACK).unwrap();
    bench.raise("x");
    assert_eq!(verdict(&mut bench), Some(Verdict::Partition(PartitionAction::Ignore)));
}

#[test]
fn hmt_05_numbers_of_the_codes() {
    let codes = [
        ErrorCode::DeadlineMissed,
        ErrorCode::ApplicationError,
        ErrorCode::NumericError,
        ErrorCode::IllegalRequest,
        ErrorCode::StackOverflow,
        ErrorCode::MemoryViolation,
        ErrorCode::HardwareFault,
        ErrorCode::PowerFail,
    ];
    for (number, code) in (0..).zip(codes) {
        assert_eq!(ErrorCode::try_from(number), Ok(code));
        assert_eq!(u32::from(code), number);
    }
}

#[test]
fn hmt_06_status_of_an_error_names_process_address_and_text() {
    let (mut bench, a) = Bench::in_handler();
    let raised = bench.get_error_status().unwrap();
    assert_eq!((raised.failed_process_id, raised.failed_address), (a, 0));
    assert_eq!(raised.message.as_bytes(), b"x");
    bench.stop_self();
    bench.fault(ErrorCode::MemoryViolation, 0xdead);
    let fault = bench.get_error_status().unwrap();
    assert_eq!((fault.failed_process_id, fault.failed_address), (a, 0xdead));
    bench.fault(ErrorCode::PowerFail, 0);
    assert_eq!(bench.get_error_status().unwrap().failed_process_id, NULL_PROCESS_ID);
    let mut bench = Bench::with(table(PartitionAction::Ignore));
    bench.raise("x");
    let Some(Notice::Error { process, .. }) = bench.take_notice() else { panic!("no notice") };
    assert_eq!(process, MAIN_PROCESS_ID);
}

#[test]
fn hmt_07_missed_deadline_names_the_process_that_is_late() {
    let mut bench = Bench::new();
    bench.create_error_handler(STACK).unwrap();
    let late = bench.timed("late", 5, -1, 7);
    bench.start(late).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    bench.at(6);
    bench.runs(a);
    bench.at(7);
    assert_eq!(bench.get_error_status().unwrap().failed_process_id, late);
}

#[test]
fn hmt_09_restart_by_health_monitoring_is_told_afterwards() {
    let (mut bench, _) = unhandled(PartitionAction::WarmStart);
    bench.raise("x");
    let status = bench.partition.restarted().get_partition_status();
    assert_eq!(
        (status.start_condition, status.operating_mode),
        (StartCondition::HmPartitionRestart, OperatingMode::WarmStart)
    );
    let bench = Bench::with(|settings| settings.condition = StartCondition::HmModuleRestart);
    assert_eq!(bench.get_partition_status().start_condition, StartCondition::HmModuleRestart);
}

#[test]
fn hmt_10_ignored_fault_does_not_loop() {
    let (mut bench, _) = unhandled(PartitionAction::Ignore);
    bench.fault(ErrorCode::MemoryViolation, 0);
    assert_eq!(bench.end(), restart(OperatingMode::ColdStart));
}

#[test]
fn hmt_11_every_decision_is_told() {
    let (mut bench, a) = unhandled(PartitionAction::Idle);
    bench.at(4);
    bench.raise("x");
    let expected = Notice::Error {
        time: ms(4),
        process: a,
        code: APPLICATION,
        verdict: Verdict::Partition(PartitionAction::Idle),
    };
    assert_eq!(bench.take_notice(), Some(expected));
}

#[test]
fn notices_that_find_no_place_are_counted() {
    let mut bench = Bench::with(|settings| settings.limits.notices = 1);
    bench.report_application_message(b"1").unwrap();
    bench.report_application_message(b"2").unwrap();
    assert_eq!(bench.lost_notices(), 1);
}
