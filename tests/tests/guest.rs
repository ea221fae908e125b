//! What needs a kernel that the machine below may not be: PREEMPT_RT and every controller of control groups version 2, in a
//! delegated group, as a unit of systemd gives it. See `tests/guest/prepare`.

#![cfg(target_arch = "x86_64")] // the guest's kernel is
#![allow(clippy::unwrap_used)] // as in any test

use bateleur_tests::Guest;

/// Puts the script's shell into a group of its own, which has its controllers, and `bateleur` alone into one inside.
const DELEGATED: &str = "
echo '+memory +pids' > /sys/fs/cgroup/cgroup.subtree_control
mkdir /sys/fs/cgroup/unit.service
in_unit() { sh -c 'echo $$ > /sys/fs/cgroup/unit.service/cgroup.procs; exec \"$@\"' sh \"$@\"; }
";

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn a_delegated_group_on_a_real_time_kernel_gives_every_means_and_a_strict_start() {
    let said = Guest::of_the_flight().run(&format!(
        "{DELEGATED}
        grep -q 1 /sys/kernel/realtime || exit 9
        in_unit ./bateleur run --fast --until 2 --require strict --output /tmp/run || exit $?
        cat /sys/fs/cgroup/unit.service/cgroup.subtree_control
        ls -d /sys/fs/cgroup/unit.service/bateleur.fcu.* /dev/shm/bateleur.* 2>/dev/null"
    ));
    assert_eq!(said.code, Some(1), "nothing is left for the last ls to list: {}", said.text);
    assert!(said.text.contains("9 partitions are ready"), "{}", said.text);
    assert!(!said.text.contains("not on this machine"), "{}", said.text);
    assert!(said.text.contains("memory pids"), "{}", said.text);
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn a_group_that_is_shared_with_strangers_is_left_as_it_is_and_the_lack_is_said() {
    let said = Guest::of_the_flight().run(&format!(
        "{DELEGATED}
        sh -c 'echo $$ > /sys/fs/cgroup/unit.service/cgroup.procs; exec sleep 60' &
        sleep 1
        in_unit ./bateleur run --fast --until 1 --output /tmp/run || exit $?
        cat /sys/fs/cgroup/unit.service/cgroup.procs | wc -l"
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    assert!(
        said.text.contains("is shared with process") && said.text.contains("Delegate=yes"),
        "{}",
        said.text
    );
    assert_eq!(
        said.text.lines().last().map(str::trim),
        Some("1"),
        "the stranger stays where it is: {}",
        said.text
    );
}
