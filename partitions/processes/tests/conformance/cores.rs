//! Cores of processes (Part 2). The processes of a partition take turns on one core, whose number is 0.

use bateleur_processes::standard::*;
use bateleur_processes::{AffinityPermission, ReturnCode};

use crate::bench::*;

fn permitted(permission: AffinityPermission) -> (Bench, ProcessId) {
    let mut bench = Bench::with(|settings| settings.affinity = permission);
    let a = bench.started("a", 10);
    (bench, a)
}

#[test]
fn mc_set_01_partition_that_is_not_permitted_is_refused() {
    let (mut bench, a) = permitted(AffinityPermission::NotPermitted);
    assert_eq!(code(bench.set_process_core_affinity(a, 0)), IC);
    assert_eq!(
        code(bench.set_process_core_affinity(ProcessId(99), 0)),
        IC,
        "before the process is looked for"
    );
}

#[test]
fn mc_set_02_unknown_process_is_a_wrong_parameter() {
    let (mut bench, _) = permitted(AffinityPermission::AllModes);
    assert_eq!(code(bench.set_process_core_affinity(ProcessId(99), 0)), IP);
    assert_eq!(code(bench.set_process_core_affinity(MAIN_PROCESS_ID, 0)), IP);
}

#[test]
fn mc_set_03_core_of_others_is_a_wrong_configuration() {
    let (mut bench, a) = permitted(AffinityPermission::AllModes);
    for core in [1, 7, -3, i32::MIN, i32::MAX] {
        assert_eq!(code(bench.set_process_core_affinity(a, core)), IC, "core {core}");
    }
    assert_eq!(bench.get_process_core_affinity(a), Ok(CORE_AFFINITY_NO_PREFERENCE), "nothing has changed");
}

#[test]
fn mc_set_04_permission_before_normal_ends_with_it() {
    let (mut bench, a) = permitted(AffinityPermission::InitOnly);
    assert_eq!(code(bench.set_process_core_affinity(a, 0)), NE);
    bench.normal();
    assert_eq!(code(bench.set_process_core_affinity(a, 0)), IM);
}

#[test]
fn mc_set_05_running_process_is_bound_and_goes_on() {
    let (mut bench, a) = permitted(AffinityPermission::AllModes);
    bench.normal();
    bench.runs(a);
    assert_eq!(code(bench.set_process_core_affinity(a, 0)), NE);
    bench.runs(a);
    assert_eq!((bench.get_process_core_affinity(a), bench.get_my_processor_core_id()), (Ok(0), 0));
    assert_eq!(code(bench.set_process_core_affinity(a, CORE_AFFINITY_NO_PREFERENCE)), NE);
    assert_eq!(bench.get_process_core_affinity(a), Ok(CORE_AFFINITY_NO_PREFERENCE));
}

#[test]
fn mc_get_01_unknown_process_is_a_wrong_parameter() {
    let (bench, _) = permitted(AffinityPermission::AllModes);
    assert_eq!(bench.get_process_core_affinity(ProcessId(99)), Err(ReturnCode::InvalidParam));
}

#[test]
fn mc_get_02_core_of_a_process_or_no_preference() {
    let (mut bench, a) = permitted(AffinityPermission::AllModes);
    assert_eq!(bench.get_process_core_affinity(a), Ok(CORE_AFFINITY_NO_PREFERENCE));
    bench.initialize_process_core_affinity(a, 0).unwrap();
    assert_eq!(bench.get_process_core_affinity(a), Ok(0));
}

#[test]
fn mc_def_01_core_of_others_is_a_wrong_configuration() {
    let (mut bench, _) = permitted(AffinityPermission::AllModes);
    for core in [1, 7, -3] {
        assert_eq!(code(bench.set_default_process_core_affinity(core)), IC, "core {core}");
    }
}

#[test]
fn mc_def_02_in_normal_it_is_the_wrong_mode() {
    let (mut bench, _) = permitted(AffinityPermission::AllModes);
    bench.normal();
    assert_eq!(code(bench.set_default_process_core_affinity(0)), IM);
}

#[test]
fn mc_def_03_default_is_for_processes_without_a_core_of_their_own() {
    let (mut bench, a) = permitted(AffinityPermission::AllModes);
    assert_eq!(code(bench.set_default_process_core_affinity(0)), NE);
    assert_eq!(bench.get_process_core_affinity(a), Ok(CORE_AFFINITY_NO_PREFERENCE), "it has none of its own");
    bench.normal();
    bench.runs(a);
    assert_eq!(bench.get_my_processor_core_id(), 0);
}

#[test]
fn mc_def_04_any_core_is_allowed() {
    let (mut bench, _) = permitted(AffinityPermission::AllModes);
    assert_eq!(code(bench.set_default_process_core_affinity(CORE_AFFINITY_ANY)), NE);
}
