//! Prepared machines: a well-kept one, and the same with one fault each.

use std::fs;
use std::path::Path;

use super::*;
use bateleur_host::guarantee::Guarantee;

/// A machine of four processors whose core 2 is kept for one module.
const WELL: &[(&str, &str)] = &[
    ("proc/sys/kernel/osrelease", "6.12.1-rt"),
    ("proc/sys/kernel/version", "#1 SMP PREEMPT_RT"),
    ("proc/sys/kernel/sched_rt_runtime_us", "950000"),
    ("proc/sys/kernel/sched_rt_period_us", "1000000"),
    ("proc/sys/kernel/seccomp/actions_avail", "kill_process kill_thread trap errno"),
    ("proc/self/ns/user", ""),
    ("proc/self/status", "Name:\tbateleur\nCapEff:\t000001ffffffffff\n"),
    (
        "proc/self/limits",
        "Max open files            8192      8192      files\nMax locked memory  8192  8192  bytes\n",
    ),
    ("proc/self/mounts", "cgroup2 /sys/fs/cgroup cgroup2 rw 0 0\n"),
    ("proc/self/cgroup", "0::/bateleur.service\n"),
    ("proc/swaps", "Filename Type Size Used Priority\n"),
    ("proc/cmdline", "isolcpus=2 nohz_full=2 rcu_nocbs=2 irqaffinity=0"),
    ("proc/irq/24/effective_affinity_list", "0"),
    ("proc/irq/25/smp_affinity_list", "0-1"),
    ("sys/fs/cgroup/bateleur.service/cgroup.procs", "77"),
    ("sys/fs/cgroup/bateleur.service/cgroup.controllers", "cpuset cpu memory pids"),
    ("sys/fs/cgroup/bateleur.service/cgroup.subtree_control", "memory pids"),
    ("sys/devices/system/cpu/online", "0-3"),
    ("sys/devices/system/cpu/isolated", "2"),
    ("sys/devices/system/cpu/nohz_full", "2"),
    ("sys/devices/system/cpu/cpu2/cpufreq/scaling_governor", "performance"),
    ("sys/devices/system/cpu/cpu2/cpuidle/state0/latency", "0"),
    ("sys/devices/system/cpu/cpu2/cpuidle/state0/name", "POLL"),
    ("sys/devices/system/cpu/cpu2/cpuidle/state1/latency", "170"),
    ("sys/devices/system/cpu/cpu2/cpuidle/state1/name", "C6"),
    ("sys/devices/system/cpu/cpu2/cpuidle/state1/disable", "1"),
    ("sys/devices/system/cpu/cpu2/topology/thread_siblings_list", "2"),
    ("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc"),
    ("sys/devices/system/clocksource/clocksource0/available_clocksource", "tsc hpet acpi_pm"),
];

fn tried() -> Tried {
    let held = Guarantee {
        promise: "a window starts and ends at its instant".into(),
        held: true,
        detail: "SCHED_FIFO".into(),
    };
    Tried { landlock: Some(6), shared_memory_bytes: Some(64 << 20), promises: vec![held] }
}

fn write(root: &Path, file: &str, text: &str) {
    let path = root.join(file);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, format!("{text}\n")).unwrap();
}

fn lay_out(changes: &[(&str, Option<&str>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    WELL.iter().for_each(|(file, text)| write(folder.path(), file, text));
    for (file, text) in changes {
        match text {
            Some(text) => write(folder.path(), file, text),
            None => fs::remove_file(folder.path().join(file)).unwrap(),
        }
    }
    folder
}

fn examined(changes: &[(&str, Option<&str>)]) -> Vec<Finding> {
    let folder = lay_out(changes);
    examine(&Root::new(folder.path()), &Subject { cores: vec![2], ports: 40 }, &tried())
}

/// The one thing that a changed machine lacks.
fn only_lack(changes: &[(&str, Option<&str>)]) -> Finding {
    let mut lacks: Vec<_> =
        examined(changes).into_iter().filter(|finding| finding.state == State::Lacks).collect();
    assert_eq!(lacks.len(), 1, "{lacks:#?}");
    lacks.remove(0)
}

#[test]
fn a_machine_that_is_kept_for_flying_lacks_nothing() {
    let findings = examined(&[]);
    assert!(findings.iter().all(|finding| finding.state != State::Lacks), "{findings:#?}");
    assert!(findings.len() > 18);
}

#[test]
fn an_executive_that_stepped_aside_is_judged_by_the_group_of_its_partitions() {
    let findings = examined(&[("proc/self/cgroup", Some("0::/bateleur.service/bateleur.executive"))]);
    assert!(findings.iter().all(|finding| finding.state != State::Lacks), "{findings:#?}");
}

#[test]
fn every_lack_says_what_it_costs_and_how_to_mend_it() {
    let empty = tempfile::tempdir().unwrap();
    let findings =
        examine(&Root::new(empty.path()), &Subject { cores: vec![1], ports: 40 }, &Tried::default());
    let lacks: Vec<_> = findings.iter().filter(|finding| finding.state == State::Lacks).collect();
    assert!(lacks.len() > 8, "{lacks:#?}");
    for lack in lacks {
        assert!(!lack.found.is_empty() && !lack.costs.is_empty() && !lack.mend.is_empty(), "{lack:?}");
    }
}

#[test]
fn a_saving_governor_is_named_with_its_processor() {
    let file = "sys/devices/system/cpu/cpu2/cpufreq/scaling_governor";
    let lack = only_lack(&[(file, Some("powersave"))]);
    assert_eq!(
        (lack.topic.as_str(), lack.found.as_str()),
        ("frequency governor", "powersave on processor 2")
    );
    assert_eq!(lack.mend, format!("echo performance > /{file}"));
}

#[test]
fn a_deep_sleep_state_is_named_with_its_latency() {
    let lack = only_lack(&[("sys/devices/system/cpu/cpu2/cpuidle/state1/disable", Some("0"))]);
    assert_eq!((lack.topic.as_str(), lack.found.as_str()), ("idle states", "C6 takes 170 us to leave"));
}

#[test]
fn a_tight_throttle_costs_the_rest_of_its_period() {
    let lack = only_lack(&[("proc/sys/kernel/sched_rt_runtime_us", Some("500000"))]);
    assert_eq!(lack.topic, "real-time throttling");
    assert!(lack.costs.contains("500000 us"), "{lack:?}");
}

#[test]
fn a_group_without_a_real_time_budget_is_found_where_this_process_is() {
    let lack = only_lack(&[
        (
            "proc/self/mounts",
            Some("cgroup2 /sys/fs/cgroup cgroup2 rw 0 0\ncgroup /sys/fs/cgroup/cpu cgroup rw,cpu 0 0"),
        ),
        ("proc/self/cgroup", Some("1:cpu:/user\n0::/bateleur.service")),
        ("sys/fs/cgroup/cpu/user/cpu.rt_runtime_us", Some("0")),
    ]);
    assert_eq!(lack.topic, "real-time group scheduling");
    assert!(lack.mend.starts_with("echo 940000 > /sys/fs/cgroup/cpu/user/cpu.rt_runtime_us"), "{lack:?}");
    assert!(lack.mend.ends_with("/sys/fs/cgroup/cpu/cgroup.procs"), "{lack:?}");
}

#[test]
fn without_control_groups_that_is_said_and_so_are_the_controllers() {
    let findings = examined(&[("proc/self/mounts", Some("proc /proc proc rw 0 0"))]);
    let lacks: Vec<_> = findings.iter().filter(|finding| finding.state == State::Lacks).collect();
    assert_eq!(
        lacks.iter().map(|lack| lack.topic.as_str()).collect::<Vec<_>>(),
        ["control groups", "group controllers"]
    );
    // This process is in one, and does not see it.
    assert!(
        lacks[0].found.contains("ip netns exec") && lacks[0].mend.contains("nsenter --net="),
        "{:?}",
        lacks[0]
    );
    let none =
        examined(&[("proc/self/mounts", Some("proc /proc proc rw 0 0")), ("proc/self/cgroup", Some("0::/"))]);
    let none = none.iter().find(|finding| finding.topic == "control groups").unwrap();
    assert!(none.found.contains("no version 2 hierarchy is mounted"), "{none:?}");
}

#[test]
fn controllers_that_the_first_version_holds_are_told_from_those_that_are_not_handed_down() {
    let file = "sys/fs/cgroup/bateleur.service/cgroup.subtree_control";
    let mounts = "cgroup /sys/fs/cgroup/memory cgroup rw,memory 0 0\ncgroup2 /sys/fs/cgroup cgroup2 rw 0 0";
    let beside = examined(&[(file, Some("pids")), ("proc/self/mounts", Some(mounts))]);
    let held = beside.iter().find(|finding| finding.topic == "group controllers").unwrap();
    assert_eq!(held.state, State::Note);
    assert!(held.found.starts_with("memory held by cgroup version 1"), "{held:?}");
    let off = only_lack(&[(file, Some("pids"))]);
    assert!(
        off.mend.starts_with("echo '+memory' > /sys/fs/cgroup/bateleur.service/cgroup.subtree_control"),
        "{off:?}"
    );
    let absent = only_lack(&[
        (file, Some("pids")),
        ("sys/fs/cgroup/bateleur.service/cgroup.controllers", Some("pids")),
    ]);
    assert!(absent.mend.contains("Delegate=yes"), "{absent:?}");
}

#[test]
fn a_core_that_everybody_may_use_is_named() {
    let lack = only_lack(&[("sys/devices/system/cpu/isolated", Some("3"))]);
    assert_eq!(lack.topic, "isolated cores");
    assert!(lack.mend.contains("isolcpus=2"), "{lack:?}");
}

#[test]
fn a_ticking_core_keeps_its_callbacks_away_by_rcu_nocbs_alone() {
    let lack = only_lack(&[("sys/devices/system/cpu/nohz_full", None)]);
    assert_eq!(lack.found, "the timer ticks on [2], RCU callbacks run on []");
}

#[test]
fn interrupts_on_the_plans_core_are_counted_and_sent_to_the_others() {
    let lack = only_lack(&[("proc/irq/24/effective_affinity_list", Some("2"))]);
    assert_eq!(lack.found, "1 arrive on the plan's cores: 24");
    assert!(lack.mend.contains("irqaffinity=0,1,3"), "{lack:?}");
}

#[test]
fn a_slow_clock_names_the_better_one_that_is_there() {
    let lack =
        only_lack(&[("sys/devices/system/clocksource/clocksource0/current_clocksource", Some("hpet"))]);
    assert!(lack.mend.starts_with("echo tsc > "), "{lack:?}");
}

#[test]
fn a_sibling_is_a_lack_even_when_the_core_itself_is_isolated() {
    let lack = only_lack(&[("sys/devices/system/cpu/cpu2/topology/thread_siblings_list", Some("2,6"))]);
    assert!(lack.mend.contains("cpu6/online"), "{lack:?}");
}

#[test]
fn an_ordinary_user_is_told_what_his_limits_cost() {
    let status = ("proc/self/status", Some("CapEff:\t0000000000000000"));
    let findings = examined(&[status]);
    let lacks: Vec<_> = findings.iter().filter(|finding| finding.state == State::Lacks).collect();
    assert_eq!(
        lacks.iter().map(|lack| lack.topic.as_str()).collect::<Vec<_>>(),
        ["real-time priority", "locked memory"]
    );
    let raised =
        "Max open files 8192 8192\nMax locked memory unlimited unlimited\nMax realtime priority 98 98";
    let findings = examined(&[status, ("proc/self/limits", Some(raised))]);
    assert!(findings.iter().all(|finding| finding.state != State::Lacks), "{findings:#?}");
}

#[test]
fn a_module_with_more_ports_than_descriptors_is_told_the_number() {
    let lack = only_lack(&[("proc/self/limits", Some("Max open files 256 256 files"))]);
    assert_eq!(lack.mend, "ulimit -n 464; LimitNOFILE=464 in a unit");
}

#[test]
fn a_promise_that_does_not_hold_keeps_its_own_way_out() {
    let folder = lay_out(&[]);
    let broken = Guarantee {
        promise: "a window starts and ends at its instant".into(),
        held: false,
        detail: "Operation not permitted; no SCHED_FIFO; run as root".into(),
    };
    let tried = Tried { promises: vec![broken], ..tried() };
    let findings = examine(&Root::new(folder.path()), &Subject { cores: vec![2], ports: 0 }, &tried);
    let lack = findings.last().unwrap();
    assert_eq!((lack.state, lack.mend.as_str()), (State::Lacks, "run as root"));
    assert!(lack.costs.contains("0.6 to 0.8 ms"));
}
