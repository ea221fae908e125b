//! What needs a kernel that the machine below may not be: PREEMPT_RT and every controller of control groups version 2, in a
//! delegated group, as a unit of systemd gives it; and what needs the other kind of processor that aircraft carry. See
//! `tests/guest/prepare`.

use std::time::Duration;

use bateleur_tests::fuzzed::{self, KINDS};
use bateleur_tests::{
    EXECUTIVE, Guest, Processor, bateleur, is_long, patient, ports_of, repository, small_mission,
};

/// Makes a group with every controller, as a unit of systemd has, and starts programs in it.
const DELEGATED: &str = "
echo '+memory +pids' > /sys/fs/cgroup/cgroup.subtree_control
export unit=/sys/fs/cgroup/unit$$.service
mkdir $unit
in_unit() { sh -c 'echo $$ > $unit/cgroup.procs; exec \"$@\"' sh \"$@\"; }
";

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn real_time_kernel_with_a_delegated_group_starts_strictly_and_what_one_lacks_is_said() {
    let started = format!(
        "{DELEGATED}
        grep -q 1 /sys/kernel/realtime || exit 9
        in_unit ./bateleur run --fast --until 2 --require strict --output /tmp/run || exit $?
        cat $unit/cgroup.subtree_control
        echo LEFT $(ls -d $unit/bateleur.fcu.* /dev/shm/bateleur.* 2>/dev/null)"
    );
    let shared = format!(
        "{DELEGATED}
        in_unit sleep 600 &
        sleep 1
        in_unit ./bateleur run --fast --until 1 --output /tmp/shared || exit $?
        cat $unit/cgroup.procs | wc -l"
    );
    let examined = format!(
        "{DELEGATED}
        in_unit ./bateleur doctor
        echo doctor ended with $?"
    );
    let [started, shared, examined] = Guest::of_the_flight().run_each([&started, &shared, &examined]);

    assert_eq!(started.code, Some(0), "{}", started.text);
    assert!(started.text.lines().any(|line| line.trim_end() == "LEFT"), "{}", started.text);
    assert!(started.text.contains("9 partitions are ready"), "{}", started.text);
    assert!(!started.text.contains("not guaranteed here"), "{}", started.text);
    assert!(started.text.contains("memory pids"), "{}", started.text);

    assert_eq!(shared.code, Some(0), "{}", shared.text);
    let is_said = shared.text.contains("is shared with process") && shared.text.contains("Delegate=yes");
    assert!(is_said, "{}", shared.text);
    let last = shared.text.lines().last().map(str::trim);
    assert_eq!(last, Some("1"), "the stranger stays where it is: {}", shared.text);

    let line = |word: &str| {
        let is_about =
            |line: &&str| line.split_once("  ").is_some_and(|(_, rest)| rest.trim().starts_with(word));
        let found = examined.text.lines().find(is_about);
        found.unwrap_or_else(|| panic!("nothing about {word}: {}", examined.text))
    };
    assert!(line("PREEMPT_RT").starts_with("well"), "{}", examined.text);
    assert!(line("control groups").contains("version 2"), "{}", examined.text);
    assert!(line("group controllers").contains("memory, pids"), "{}", examined.text);
    assert!(line("real-time priority").starts_with("well"), "{}", examined.text);
    // It is an emulator, and its lacks are named with a mend.
    assert!(line("isolated cores").starts_with("LACKS"), "{}", examined.text);
    for words in ["mend   kernel parameter isolcpus=1", "doctor ended with 1"] {
        assert!(examined.text.contains(words), "{}", examined.text);
    }
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn hostile_partition_meets_every_wall_of_a_machine_with_control_groups_of_version_2() {
    let guest = Guest::of_the_flight().tests(&["hostile", "counter"]);
    let walls = [
        "alone::children_of_a_taken",
        "calls_that_others_pay_for",
        "control_group",
        "forks_end",
        "kernels_settings",
        "libraries",
        "network_that_was_granted",
        "others_processes",
        "partition_that_exceeds_its_memory",
        "partition_that_mounts",
        "passwords",
        "session",
        "shared_memory",
        "temporary_folder",
        "threads_end",
    ];
    let said = guest.run(&format!(
        "{DELEGATED}
        export BATELEUR_TESTS_UNIT=$unit
        ./system --test-threads 1 --nocapture {}",
        walls.map(|wall| format!("space::{wall}")).join(" ")
    ));
    // What the filter of system calls ends is the same on every kernel; one of them stands for all.
    let verdict =
        said.text.lines().rfind(|line| line.starts_with("test result:")).unwrap_or("it said no result");
    assert!(verdict.contains(" 0 failed"), "{}", said.text);
    assert_eq!(said.code, Some(0), "{}", said.text);
    let skipped: Vec<_> =
        said.text.lines().filter(|line| line.contains("skipped: not guaranteed here")).collect();
    assert_eq!(skipped, Vec::<&str>::new());
}

/// Two buses with a gateway each, which have found one another.
const TWO_GATEWAYS: &str = "
ip link add dev vcan1 type vcan && ip link set vcan1 mtu 72 && ip link set vcan1 up || exit 8
start() { ./can_gateway run --bus socketcan:$1 --name $2 --identity $2 --listen 127.0.0.1:$3 --peer 127.0.0.1:$4 2>> /tmp/said.$2 & }
start vcan0 a 15211 15212
start vcan1 b 15212 15211
forwards() { ./can_gateway status --name $1 2> /tmp/asked | grep -q 'state *forward'; }
turns=0
until forwards a && forwards b; do sleep 1; turns=$((turns + 1)); [ $turns -lt 60 ] || { cat /tmp/said.*; exit 7; }; done
";

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn buses_of_the_kernel_and_two_gateways_carry_the_frames_of_can_utils_and_gateways_tell_what_is_wrong_with_a_bus()
 {
    let bus = format!(
        "{}
        candump -L -n 3 vcan0 > /tmp/heard &
        sleep 1
        cansend vcan0 123#0102 && cansend vcan0 1ABCDEF0#R && cansend vcan0 321##1aabbcc || exit 7
        wait
        cut -d ' ' -f 3 /tmp/heard",
        Guest::LOAD_CAN
    );
    let frames = format!(
        "export PATH=$PATH:/flight
        {TWO_GATEWAYS}
        candump -L vcan1 > /tmp/heard &
        listener=$!
        candump -L vcan0 > /tmp/back &
        listener_back=$!
        sleep 2
        for frame in 123#0102 1ABCDEF0#11 123#R4 321##1aabbcc 7FF#; do cansend vcan0 $frame || exit 6; sleep 1; done
        cansend vcan1 055#0504 || exit 6
        sleep 3
        echo FRAMES $(cut -d ' ' -f 3 /tmp/heard)
        echo BACK $(cut -d ' ' -f 3 /tmp/back | tail -n 1)
        cangen vcan0 -n 1000 -g 2 -I i -D i -L 8
        turns=0
        until [ $(wc -l < /tmp/heard) -ge 1006 ] || [ $turns -gt 60 ]; do sleep 1; turns=$((turns + 1)); done
        kill $listener $listener_back
        grep vcan1 /tmp/heard | tail -n 1000 | cut -d ' ' -f 3 | sort | md5sum > /tmp/there
        grep vcan0 /tmp/back | tail -n 1000 | cut -d ' ' -f 3 | sort | md5sum > /tmp/here
        cmp /tmp/there /tmp/here && echo SAME
        ./can_gateway status --name b"
    );
    let faults = "
        export PATH=$PATH:/flight
        cansend vcan1 20000040#0000000000000000 || exit 6
        sleep 2
        ./can_gateway status --name b | grep bus-off && echo OFF
        cansend vcan1 20000100#0000000000000000 || exit 6
        sleep 2
        ./can_gateway status --name b | grep 'error active' && echo ACTIVE
        candump -L -n 1 vcan1 > /tmp/heard &
        sleep 1
        cansend vcan0 234#01
        turns=0
        until [ -s /tmp/heard ] || [ $turns -gt 30 ]; do sleep 1; turns=$((turns + 1)); done
        echo HEARD $(cut -d ' ' -f 3 /tmp/heard)
        ip link add dev vcan2 type vcan
        timeout 20 ./can_gateway run --bus socketcan:vcan2 --name c --listen 127.0.0.1:0 2>&1; echo DOWN $?
        timeout 20 ./can_gateway run --bus socketcan:can9 --name d --listen 127.0.0.1:0 2>&1; echo NONE $?
        ip link set vcan1 down
        sleep 3
        ./can_gateway status --name b | grep 'not there' && echo GONE
        ip link set vcan1 up
        turns=0
        until ./can_gateway status --name b | grep 'error active' || [ $turns -gt 30 ]; do sleep 1; turns=$((turns + 1)); done
        cat /tmp/said.b";
    let guest = Guest::default().program("can_gateway").can();
    let [bus, frames, faults] = guest.run_each([&bus, &frames, faults]);

    assert_eq!(bus.code, Some(0), "{}", bus.text);
    let heard: Vec<_> = bus.text.split_whitespace().collect();
    // The kernel adds the flag of an FD frame (4) to the bit-rate switch (1).
    assert_eq!(heard, ["123#0102", "1ABCDEF0#R", "321##5AABBCC"], "{}", bus.text);

    assert_eq!(frames.code, Some(0), "{}", frames.text);
    let line = |word: &str| frames.text.lines().find(|line| line.starts_with(word)).unwrap_or_default();
    // As above. The last came from this bus itself.
    let sent = "123#0102 1ABCDEF0#11 123#R4 321##5AABBCC 7FF# 055#0504";
    assert_eq!(line("FRAMES").trim_end(), format!("FRAMES {sent}"), "{}", frames.text);
    assert_eq!(line("BACK").trim_end(), "BACK 055#0504", "{}", frames.text);
    assert!(frames.text.contains("SAME"), "{}", frames.text);
    assert!(line("lost").contains(" 0 frames"), "{}", frames.text);

    assert_eq!(faults.code, Some(0), "{}", faults.text);
    for word in ["OFF", "ACTIVE", "HEARD 234#01", "DOWN 2", "NONE 2", "GONE"] {
        assert!(faults.text.lines().any(|line| line.trim_end() == word), "no {word}: {}", faults.text);
    }
    assert!(faults.text.contains("ip link set vcan2 up"), "{}", faults.text);
    // Taken down and brought up again under a running gateway: told once each.
    let told = |words: &str| faults.text.lines().filter(|line| line.contains(words)).count();
    let down_and_up = (told("vcan1: the interface is down"), told("vcan1 is there again"));
    assert_eq!(down_and_up, (1, 1), "{}", faults.text);
}

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn partition_in_its_cage_flies_over_a_bus_of_the_kernel_is_found_again_after_it_was_killed_and_has_no_bus_without_a_grant()
 {
    let schedule = std::fs::read_to_string(repository().join("schedules/can.toml")).unwrap();
    let small = std::fs::read_to_string(small_mission()).unwrap();
    let guest = ["can_interface", "can_board", "can_gateway"]
        .iter()
        .fold(Guest::of_the_flight().can(), |guest, name| guest.program(name))
        .file("can.toml", &patient(&schedule))
        .file("small.toml", &small);
    // Two laps where there is time for them.
    let (mission, completed) =
        if is_long() { ("", "completed, 2 laps") } else { ("--mission small.toml", "completed, 1 lap") };
    let flown = format!(
        "{}{DELEGATED}
        candump -L vcan0 > /tmp/heard &
        listener=$!
        in_unit ./bateleur fly --fast --require strict --schedule can.toml --set can_interface.bus=socketcan:vcan0 \\
            --seed 4 --turbulence light --wind 4 --kill can_interface@40 --kill imu@50 {mission} --output /tmp/out
        echo FLIGHT $?
        kill $listener
        echo QUESTIONS $(grep -c ' 2F0#' /tmp/heard) ANSWERS $(grep -c ' 1F0#' /tmp/heard)",
        Guest::LOAD_CAN
    );
    let denied = format!(
        "{DELEGATED}
        sed 's/^network    = true$/network    = false/' can.toml > denied.toml
        cmp -s can.toml denied.toml && exit 9
        in_unit ./bateleur run --fast --until 1 --require strict --schedule denied.toml --set can_interface.bus=socketcan:vcan0 \\
            --output /tmp/denied
        echo ENDED $?"
    );
    let [flown, denied] = guest.run_each([&flown, &denied]);
    for words in ["FLIGHT 0", completed, "can_interface: back after", "imu: back after"] {
        assert!(flown.text.contains(words), "{words:?} is not in {}", flown.text);
    }
    let counts = flown.text.lines().find_map(|line| line.strip_prefix("QUESTIONS ")).unwrap_or_default();
    let numbers: Vec<u32> = counts.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    assert!(numbers.len() == 2 && numbers.iter().all(|number| *number > 3_000), "{}", flown.text);

    assert!(denied.text.contains("SIGSYS"), "{}", denied.text);
    assert!(denied.text.contains("ENDED ") && !denied.text.contains("ENDED 0"), "{}", denied.text);
}

/// A plan in which somebody fills every socket of the kernel's buses that it gets, beside six that do not talk to it; with or without
/// the grant.
fn with_a_flooded_bus(granted: bool) -> String {
    let grant = if granted { "system_calls = [\"can\"]\n" } else { "" };
    let keys = format!(
        "attributes = {{ attacks = [\"can_frames\"], each_ms = 1000000 }}\nnetwork = true\n{grant}{}",
        ports_of("attacker", &[("own", "source", "sampling")])
    );
    let built = bateleur_tests::program("attacker");
    let text = fuzzed::beside_six("attacker", &keys).text();
    let text = text.replace(built.parent().unwrap().to_str().unwrap(), "/flight/release");
    text.replace("module = \"test\"", "module = \"test\"\nstartup_timeout = \"60s\"")
}

/// Windows on an emulator's wall clock mean nothing: on the virtual clock each fault is somebody's.
#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn nobody_notices_a_partition_that_floods_a_bus_and_the_kernel_keeps_as_many_frames_as_the_book_says() {
    let guest = Guest::of_the_flight().can().program("attacker").program("neighbour");
    let guest = guest.file("granted.toml", &with_a_flooded_bus(true));
    let said = guest.file("refused.toml", &with_a_flooded_bus(false)).run(&format!(
        "{}{DELEGATED}
        available() {{ sed -n 's/MemAvailable: *\\([0-9]*\\) kB/\\1/p' /proc/meminfo; }}
        for plan in refused granted; do
            before=$(available)
            in_unit ./bateleur run --fast --until 20 --require strict --schedule $plan.toml --output /tmp/$plan &
            run=$!
            while kill -0 $run 2>/dev/null; do
                echo TAKEN $plan $((before - $(available)))
                echo SOCKETS $plan $(wc -l < /proc/net/can/rcvlist_all)
                sleep 1
            done
            wait $run || exit $?
            sed \"s/^/FAULT /\" /tmp/$plan/health.jsonl
        done
        echo MOST $(cat /proc/sys/net/core/rmem_max)",
        Guest::LOAD_CAN
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    let greatest = |word: &str| {
        let numbers =
            said.text.lines().filter_map(|line| line.strip_prefix(word)?.trim().parse::<i64>().ok());
        numbers.max().unwrap_or_else(|| panic!("no {word} in {}", said.text))
    };
    let (refused, granted) = (greatest("TAKEN refused"), greatest("TAKEN granted"));
    assert!(greatest("SOCKETS granted") > greatest("SOCKETS refused") + 100, "{}", said.text);
    // Each of as many sockets as descriptors holds twice what the machine allows.
    let bound = (256 + 16) * 2 * greatest("MOST") / 1024;
    println!("{refused} KiB without the grant, {granted} KiB with it, of {bound} KiB");
    assert!(granted > refused + bound / 20 && granted < refused + bound, "{granted} KiB: {}", said.text);
    let faults = said.text.lines().filter_map(|line| line.strip_prefix("FAULT "));
    let noticed: Vec<&str> = faults
        .filter(|line| {
            let fault: serde_json::Value = serde_json::from_str(line).unwrap();
            !fuzzed::EXPECTED.contains(&fault["partition"].as_str().unwrap_or_default())
        })
        .collect();
    assert!(noticed.is_empty(), "others notice:\n{noticed:#?}");
}

/// One partition on a core whose frames of 20 ms begin at multiples of 20 ms of CLOCK_REALTIME.
const ON_THE_CLOCK: &str = r#"
[module.guest]
cores = [1]
clock = "realtime"
follows_within = "200us"

[partition.a]
program = "bateleur_bench_partition"
module = "guest"
memory = "64MiB"
startup_timeout = "60s"
attributes = { says_origin = true }

[schedule.s]
major_frame = "20ms"
minor_frame = "20ms"
window = [{ partition = "a", offset = "1ms", duration = "2ms" }]
"#;

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn frames_follow_the_disciplined_clock_and_follow_it_again_after_it_was_set_and_after_nobody_kept_it() {
    let guest = EXECUTIVE
        .iter()
        .chain(&["bateleur_bench_partition", "clock_keeper"])
        .fold(Guest::default(), |guest, name| guest.program(name))
        .file("schedule.toml", ON_THE_CLOCK);
    let said = guest.run(&format!(
        "{DELEGATED}
        export PATH=$PATH:/flight
        await() {{ turns=0; until [ $(grep -c \"$2\" /tmp/said) -ge $1 ]; do
            sleep 1; turns=$((turns + 1)); [ $turns -lt 90 ] || {{ cat /tmp/said; exit 7; }}; done; }}
        clock_keeper kept 20 || exit 8
        sh -c 'echo $$ > $unit/cgroup.procs; exec ./bateleur run --output /tmp/run' > /tmp/said 2>&1 &
        module=$!
        await 1 'major frames follow realtime'
        sleep 2
        echo FIRST $(clock_keeper offset)
        clock_keeper step 1500 && clock_keeper kept 20 || exit 8
        await 1 'frames begin [0-9]* us beside those of realtime'
        await 1 'major frames follow realtime again'
        sleep 2
        echo SET $(clock_keeper offset)
        clock_keeper left || exit 8
        await 1 'nothing was heard of realtime.*CLOCK_REALTIME is not synchronised'
        clock_keeper kept 20
        await 2 'major frames follow realtime again'
        kill $module
        wait $module
        echo ENDED $?
        grep -h '^origin' /tmp/run/partitions/a.log
        cut -d , -f 5 /tmp/run/windows.csv | sed 's/^/PLANNED /'
        cat /tmp/said"
    ));
    assert!(said.text.contains("ENDED 0"), "{}", said.text);
    let after = |word: &str| {
        let numbers = said.text.lines().filter_map(|line| line.strip_prefix(word));
        numbers.filter_map(|number| number.trim().parse().ok()).collect::<Vec<i128>>()
    };
    let told_ns = |words: &str| {
        let line = said.text.lines().find(|line| line.contains(words)).expect(&said.text);
        (line.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e9) as i128
    };
    let (origin_ns, planned) = (after("origin ")[0], after("PLANNED "));
    // The last window a second before something was told of the clock, and how far from its place its frame began.
    let beside_ns = |offset_ns: i128, until_ns: i128| {
        let start_ns = planned.iter().rfind(|start_ns| **start_ns < until_ns - 1_000_000_000).unwrap();
        let into_ns = (origin_ns + start_ns - 1_000_000 + offset_ns).rem_euclid(20_000_000);
        into_ns.min(20_000_000 - into_ns)
    };
    let first_ns = beside_ns(after("FIRST ")[0], told_ns("us beside those of realtime"));
    let set_ns = beside_ns(after("SET ")[0], told_ns("nothing was heard of realtime"));
    // The planned instants, not when anything ran. How late an emulator was when the partition told the origin is in both.
    assert!(first_ns < 1_000_000, "{first_ns} ns beside: {}", said.text);
    assert!(first_ns.abs_diff(set_ns) < 20_000, "{first_ns} ns, then {set_ns} ns beside: {}", said.text);
    let set_by_ns = after("SET ")[0] - after("FIRST ")[0];
    assert!(set_by_ns.abs_diff(1_500_000) < 50_000, "{set_by_ns} ns: {}", said.text);
}

/// A module of the unit's name that starts in time on an emulator too.
const UNIT_PLAN: &str = r#"
[module.fcu]
cores = [1]

[partition.a]
program = "bateleur_bench_partition"
module = "fcu"
memory = "64MiB"
startup_timeout = "60s"

[partition.b]
program = "bateleur_bench_partition"
module = "fcu"
memory = "64MiB"
startup_timeout = "60s"

[schedule.s]
major_frame = "100ms"
minor_frame = "100ms"
window = [
    { partition = "a", offset = "1ms", duration = "20ms" },
    { partition = "b", offset = "51ms", duration = "20ms" },
]
"#;

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn unit_of_the_book_starts_strictly_under_systemd_stops_without_a_trace_and_comes_back_when_it_was_killed() {
    let unit = std::fs::read_to_string(repository().join("docs/bateleur.service")).unwrap();
    let guest = EXECUTIVE
        .iter()
        .chain(&["bateleur_bench_partition"])
        .fold(Guest::default(), |guest, name| guest.program(name))
        .systemd()
        .file("bateleur.service", &unit)
        .file("schedule.toml", UNIT_PLAN);
    let said = guest.run(
        r#"
        mkdir -p /opt/bateleur && cp release/bateleur* schedule.toml /opt/bateleur/ || exit 8
        install_unit() { cat > /etc/systemd/system/bateleur.service && systemctl daemon-reload || exit 8; }
        turns=0
        await() { until [ "$(journalctl -u bateleur | grep -c "$2")" -ge "$1" ]; do
            sleep 1; turns=$((turns + 1)); [ $turns -lt 120 ] || { journalctl -u bateleur; exit 7; }; done; }
        group=/sys/fs/cgroup/system.slice/bateleur.service
        left() { ls -d $group /dev/shm/bateleur.* 2> /dev/null; }

        install_unit < bateleur.service
        systemctl start bateleur; await 1 'partitions are ready'
        echo "IS $(systemctl is-active bateleur)"
        /opt/bateleur/bateleur kill a || exit 6
        await 1 'a: back after'
        echo "ENTRY $(journalctl BATELEUR_ERROR=killed BATELEUR_MODULE=fcu BATELEUR_PARTITION=a -o cat)"
        echo "FIELDS $(journalctl BATELEUR_ERROR=killed -o json | grep -o '"BATELEUR_[A-Z]*":"[a-z_]*"' | sort | tr '\n' ' ')"
        echo "HANDS ON $(cat $group/cgroup.subtree_control)"
        echo "LIMITS $(cat $group/bateleur.fcu.*/[ab]/memory.max | tr '\n' ' ')"
        start=$(systemctl show -P InvocationID bateleur)
        systemctl stop bateleur
        echo "STOPPED $(systemctl show -P Result bateleur) $(left)"
        echo "LOGS $(ls /var/lib/bateleur/$start)"

        sed 's/^Restart=no/Restart=on-failure/' bateleur.service | install_unit
        systemctl start bateleur; await 2 'partitions are ready'
        systemctl kill --signal KILL --kill-who main bateleur; await 3 'partitions are ready'
        up() { until systemctl is-active -q bateleur; do
            sleep 1; turns=$((turns + 1)); [ $turns -lt 120 ] || { journalctl -u bateleur; exit 7; }; done; }
        up
        echo "CAME BACK $(systemctl show -P NRestarts bateleur) $(systemctl is-active bateleur)"
        systemctl stop bateleur
        echo "STOPPED $(systemctl show -P Result bateleur) $(left)"

        sed 's/^Restart=no/Restart=on-failure/; s/^WatchdogSec=30/WatchdogSec=4/; s/^TimeoutStopSec=10/TimeoutStopSec=2/' \
            bateleur.service | install_unit
        systemctl start bateleur; await 4 'partitions are ready'
        sleep 9
        echo "LIVES $(systemctl show -P NRestarts bateleur) $(systemctl is-active bateleur)"
        systemctl kill --signal STOP --kill-who main bateleur; await 5 'partitions are ready'; up
        echo "WATCHED $(systemctl show -P NRestarts bateleur) $(journalctl -u bateleur | grep -c 'Watchdog timeout')"
        systemctl stop bateleur

        sed 's/ --require strict//; s/^#User/User/; s/^#Ambient/Ambient/' bateleur.service | install_unit
        systemctl start bateleur; await 6 'partitions are ready'
        echo "USER $(systemctl is-active bateleur) $(ps -o user,comm | grep bateleur | sort | uniq -c | tr -s ' \n' ' ')"
        systemctl stop bateleur
        echo "STOPPED $(systemctl show -P Result bateleur) $(left)"
        journalctl -u bateleur -o cat"#,
    );
    assert_eq!(said.code, Some(0), "{}", said.text);
    let told = |word: &str| {
        let lines = said.text.lines().filter_map(|line| line.strip_prefix(word));
        lines.map(str::trim).collect::<Vec<_>>()
    };
    assert_eq!(told("IS "), ["active"], "{}", said.text);
    assert!(matches!(told("ENTRY ")[..], [entry] if entry.starts_with("a: killed -> ")), "{}", said.text);
    let fields = told("FIELDS ");
    assert!(
        fields[0].contains("\"BATELEUR_LEVEL\":\"partition\"") && fields[0].contains("BATELEUR_ACTION"),
        "{fields:?}"
    );
    assert_eq!(told("HANDS ON "), ["memory pids"]);
    assert_eq!(told("LIMITS "), ["67108864 67108864"]);
    assert_eq!(told("CAME BACK "), ["1 active"], "{}", said.text);
    assert_eq!(told("LIVES "), ["0 active"], "a service that runs gives signs of life: {}", said.text);
    assert_eq!(told("WATCHED "), ["1 1"], "one that is stopped does not: {}", said.text);
    // No group of the unit, nothing in /dev/shm.
    assert_eq!(told("STOPPED "), ["success"; 3], "{}", said.text);
    assert!(said.text.contains("LOGS ") && said.text.contains("windows.csv"), "{}", said.text);
    let user = told("USER ");
    assert!(user[0].starts_with("active") && !user[0].contains("root"), "{user:?}");
    let lacks = said.text.lines().filter(|line| line.starts_with("not guaranteed here"));
    // The partitions of an ordinary user are kept apart by user namespaces.
    assert_eq!(lacks.count(), 1, "an ordinary user's, none of the others': {}", said.text);
}

/// One lap of a triangle.
const TRIANGLE: &str = "laps = 1
waypoint = [
    { north_m = 500, east_m = 0, altitude_m = 140 },
    { north_m = 500, east_m = 500, altitude_m = 140 },
    { north_m = 0, east_m = 250, altitude_m = 140 },
]
";

/// A flight with a crash of each kind: signals, system calls behind the filter, traps of the processor.
const WITH_CRASHES: &str = "fly --fast --seed 7 --wind 4 --turbulence light --kill controller@40 \
    --inject estimator:illegal-call@50 --inject gps:illegal-instruction@55 --inject imu:null-write@60 \
    --inject servo:bus-error@65 --inject command:panic@70";

#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn on_aarch64_a_flight_with_crashes_is_strictly_partitioned_and_the_same_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let mission = folder.path().join("mission.toml");
    std::fs::write(&mission, TRIANGLE).unwrap();
    let schedule = repository().join("schedule.toml");
    let files = ["--mission", mission.to_str().unwrap(), "--schedule", schedule.to_str().unwrap()];
    let arguments: Vec<&str> = WITH_CRASHES.split_whitespace().chain(files).collect();
    let here = bateleur(&arguments).end().expect_code(0);
    let summary = std::fs::read_to_string(here.folder().join("summary.json")).unwrap();
    let digest = summary.lines().find(|line| line.contains("\"digest\"")).unwrap();

    let said = Guest::of_the_flight_on(Processor::Aarch64).file("mission.toml", TRIANGLE).run(&format!(
        "{DELEGATED}
        uname -m
        grep -q 1 /sys/kernel/realtime || exit 9
        in_unit ./bateleur {WITH_CRASHES} --require strict --schedule schedule.toml --mission mission.toml \\
            --output /tmp/flight || exit $?
        grep digest /tmp/flight/summary.json
        ./bateleur health /tmp/flight > /tmp/faults || exit $?
        sed 's/^/FAULT /' /tmp/faults"
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    // What somebody suffered there and nobody here comes last, where it is read.
    let faults_here = bateleur(&["health", here.folder().to_str().unwrap()]).end().stdout;
    let faults_there = said.text.lines().filter_map(|line| line.strip_prefix("FAULT "));
    // System calls have other numbers there, and it was another day.
    let is_here =
        |fault: &&str| fault.starts_with("---") || faults_here.contains(fault.split(" (").next().unwrap());
    let faults_there: Vec<&str> = faults_there.filter(|fault| !fault.trim().is_empty()).collect();
    assert!(!faults_there.is_empty(), "{}", said.text);
    let only_there: Vec<&str> = faults_there.into_iter().filter(|fault| !is_here(fault)).collect();
    assert!(only_there.is_empty(), "{}\nonly there:\n{}", said.text, only_there.join("\n"));
    for word in [
        "aarch64",
        "9 partitions are ready",
        "controller[0]: killed",
        "estimator[0]: illegal_request (ended by SIGSYS",
        "gps[0]: illegal_request (ended by SIGILL",
        "imu[0]: memory_violation (ended by SIGSEGV",
        "servo[0]: memory_violation (ended by SIGBUS",
        "command[1]: recovered",
    ] {
        assert!(said.text.contains(word), "{word:?} is not in {}", said.text);
    }
    assert!(said.text.contains(digest), "there:\n{}\nhere, {digest}:\n{}", said.text, here.stdout);
    assert!(!said.text.contains("not guaranteed here"), "{}", said.text);
}

/// Windows on an emulator's wall clock mean nothing, so nobody is judged by them: on the virtual clock each fault is somebody's.
#[test]
#[ignore = "needs an emulator and a kernel: tests/guest/prepare, then `cargo verify`"]
fn on_aarch64_nobody_notices_a_partition_that_makes_random_system_calls() {
    // It begins after the first second of each kind; each further one takes up to two minutes where the processor is emulated.
    let seconds: f64 = std::env::var("BATELEUR_FUZZ_SECONDS").map_or(4.8, |text| text.parse().unwrap());
    let mut guest = Guest::of_the_flight_on(Processor::Aarch64).program("fuzzer").program("neighbour");
    for (number, kind) in KINDS.iter().enumerate() {
        let built = bateleur_tests::program("fuzzer");
        let built = built.parent().unwrap().to_str().unwrap();
        let text = kind.sketch(number as u64 + 1).text().replace(built, "/flight/release");
        let text = text.replace("module = \"test\"", "module = \"test\"\nstartup_timeout = \"30s\"");
        guest = guest.file(&format!("fuzz{number}.toml"), &text);
    }
    let each = seconds / KINDS.len() as f64;
    let said = guest.within(Duration::from_secs_f64(600.0 + 200.0 * seconds)).run(&format!(
        "{DELEGATED}
        for number in 0 1 2 3; do
            in_unit ./bateleur run --fast --until {each} --schedule fuzz$number.toml --output /tmp/run$number || exit $?
            sed \"s/^/FAULT /\" /tmp/run$number/health.jsonl
            [ -z \"$(ls -d /dev/shm/bateleur.* $unit/bateleur.test.* 2>/dev/null)\" ] || exit 9
        done"
    ));
    assert_eq!(said.code, Some(0), "{}", said.text);
    let all = said.text.lines().filter_map(|line| line.strip_prefix("FAULT "));
    let faults: Vec<serde_json::Value> = all.map(|line| serde_json::from_str(line).unwrap()).collect();
    let is_of = |fault: &serde_json::Value, names: &[&str]| {
        fault["partition"].as_str().is_some_and(|partition| names.contains(&partition))
    };
    let of_fuzzer = faults.iter().filter(|fault| is_of(fault, &["fuzzer"])).count();
    println!("{each} s of each kind: {of_fuzzer} faults of the fuzzer");
    assert!(of_fuzzer > KINDS.len(), "it has hardly begun: {}", said.text);
    let noticed: Vec<_> = faults.iter().filter(|fault| !is_of(fault, fuzzed::EXPECTED)).collect();
    assert!(noticed.is_empty(), "others notice:\n{noticed:#?}");
}
