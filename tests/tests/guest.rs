//! What needs a kernel that the machine below may not be: PREEMPT_RT and every controller of control groups version 2, in a
//! delegated group, as a unit of systemd gives it. See `tests/guest/prepare`.

#![cfg(target_arch = "x86_64")] // the guest's kernel is
#![allow(clippy::unwrap_used, clippy::panic)] // as in any test

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

/// The last line that a test program says of itself.
fn verdict(said: &str) -> &str {
    said.lines().rfind(|line| line.starts_with("test result:")).unwrap_or("it said no result")
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn hostile_partition_meets_every_wall_of_a_machine_with_control_groups_of_version_2() {
    let guest = Guest::of_the_flight().tests("space", &["hostile", "counter"]);
    let said = guest.run(&format!(
        "{DELEGATED}
        export BATELEUR_TESTS_UNIT=/sys/fs/cgroup/unit.service
        ./space --test-threads 1 --nocapture"
    ));
    assert!(verdict(&said.text).contains(" 0 failed"), "{}", said.text);
    assert_eq!(said.code, Some(0), "{}", said.text);
    let skipped: Vec<_> =
        said.text.lines().filter(|line| line.contains("skipped: not on this machine")).collect();
    assert_eq!(skipped, Vec::<&str>::new());
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn doctor_finds_a_real_time_kernel_and_every_controller() {
    let said = Guest::of_the_flight().run(&format!(
        "{DELEGATED}
        in_unit ./bateleur doctor
        echo doctor ended with $?"
    ));
    let line = |word: &str| {
        let found = said
            .text
            .lines()
            .find(|line| line.split_once("  ").is_some_and(|(_, rest)| rest.trim().starts_with(word)));
        found.unwrap_or_else(|| panic!("nothing about {word}: {}", said.text))
    };
    assert!(line("PREEMPT_RT").starts_with("well"), "{}", said.text);
    assert!(line("control groups").contains("version 2"), "{}", said.text);
    assert!(line("group controllers").contains("memory, pids"), "{}", said.text);
    assert!(line("real-time priority").starts_with("well"), "{}", said.text);
    // It is an emulator, and its lacks are named with a mend.
    assert!(line("isolated cores").starts_with("LACKS"), "{}", said.text);
    assert!(said.text.contains("mend   kernel parameter isolcpus=1"), "{}", said.text);
    assert!(said.text.contains("doctor ended with 1"), "{}", said.text);
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn two_laps_are_flown_in_virtual_time() {
    let said = Guest::of_the_flight().run(&format!(
        "{DELEGATED}
        in_unit ./bateleur fly --fast --seed 4 --turbulence light --wind 4 --kill imu@70 --output /tmp/out"
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    assert!(said.text.contains("completed, 2 laps"), "{}", said.text);
    assert!(said.text.contains("imu: back after"), "{}", said.text);
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn a_bus_of_the_kernel_carries_classic_and_fd_frames() {
    let said = Guest::of_the_flight().can().run(&format!(
        "{}
        candump -L -n 3 vcan0 > /tmp/heard &
        sleep 1
        cansend vcan0 123#0102 && cansend vcan0 1ABCDEF0#R && cansend vcan0 321##1aabbcc || exit 7
        wait
        cut -d ' ' -f 3 /tmp/heard",
        Guest::LOAD_CAN
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    let heard: Vec<_> = said.text.split_whitespace().collect();
    // The kernel adds the flag of an FD frame (4) to the bit-rate switch (1).
    assert_eq!(heard, ["123#0102", "1ABCDEF0#R", "321##5AABBCC"], "{}", said.text);
}
