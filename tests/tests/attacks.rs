//! A partition that attacks the machine instead of its neighbours: none of those that share nothing with it but the
//! processor and the kernel loses a window, a message or a resource by it, the disk and the kernel's memory that it takes
//! stay within their bounds, and nothing of it stays behind.
//!
//! One run carries out several attacks, each for a while; what is noticed is told with the attack that was under way.

use std::fmt::Write;
use std::time::Duration;

use bateleur_tests::{
    DISK, KERNEL, NEEDS, Sample, Sketch, alone, channel_between, held, is_noticed, is_walled_in, ports_of,
    run_watched, taken,
};

/// How long each attack goes on, ms.
const EACH_MS: u64 = 1_200;

/// Those that nothing may happen to.
const OTHERS: [&str; 4] = ["before", "after", "writer", "reader"];

/// The attacker between two neighbours, and a pair of its own far from it.
fn sketch(attacks: &[&str], keys: &str) -> Sketch {
    let attacker = format!(
        "attributes = {{ attacks = {attacks:?}, each_ms = {EACH_MS} }}\n\
         restart = {{ start = \"cold\", budget = 1000000, within = \"1s\", then = \"idle\" }}\n{keys}\n{}",
        ports_of("attacker", &[("own", "source", "sampling")])
    );
    Sketch::new()
        .table("[health]\nsilence_windows = 5\n")
        .table(&channel_between("before.numbers", "after.numbers"))
        .table(&channel_between("after.queue", "before.queue"))
        .table(&channel_between("writer.numbers", "reader.numbers"))
        .table(&channel_between("writer.queue", "reader.queue"))
        .table(&channel_between("attacker.own", "ear.loose"))
        .partition(
            "before",
            "neighbour",
            1000,
            &(NEEDS.to_owned()
                + &ports_of(
                    "before",
                    &[("numbers", "source", "sampling"), ("queue", "destination", "queuing")],
                )),
        )
        .partition("attacker", "attacker", 3000, &attacker)
        .partition(
            "after",
            "neighbour",
            1000,
            &(NEEDS.to_owned()
                + &ports_of(
                    "after",
                    &[("numbers", "destination", "sampling"), ("queue", "source", "queuing")],
                )),
        )
        .partition(
            "writer",
            "neighbour",
            500,
            &ports_of("writer", &[("numbers", "source", "sampling"), ("queue", "source", "queuing")]),
        )
        .partition(
            "reader",
            "neighbour",
            500,
            &(NEEDS.to_owned()
                + &ports_of(
                    "reader",
                    &[("numbers", "destination", "sampling"), ("queue", "destination", "queuing")],
                )),
        )
        .partition("ear", "neighbour", 300, &ports_of("ear", &[("loose", "destination", "sampling")]))
}

/// What the kernel may keep for the connections of a partition with one port beyond what its sockets may hold, bytes.
const CONNECTIONS: i64 = (256 + 16) * (64 << 10);

/// To how many addresses a partition may send in its life.
const MOST_ADDRESSES: usize = 64;

/// Which attack was under way.
fn place(ns: u64) -> usize {
    (ns / (EACH_MS * 1_000_000)) as usize
}

/// Carries out the attacks. What is measured of the kernel is the whole machine's, and others use it too: an attack that seems to take
/// too much is tried again, alone, and is blamed if it takes as much each time.
#[track_caller]
fn assert_nobody_notices(attacks: &[&str], keys: &str) {
    if !is_walled_in() {
        return;
    }
    let _turn = alone();
    let (mut noticed, suspects) = carry_out(attacks, keys);
    for (attack, found) in suspects {
        let again: Vec<Suspect<'_>> = (0..2).map_while(|_| carry_out(&[attack], keys).1.pop()).collect();
        match again.len() {
            2 => noticed += &found,
            _ => eprintln!("not seen again: {found}"),
        }
    }
    assert!(noticed.is_empty(), "others notice:\n{noticed}");
}

/// An attack, and what the machine's kernel took meanwhile, in words.
type Suspect<'a> = (&'a str, String);

/// Carries out the attacks, the first of which is none, and says what others noticed; apart from that, which attacks may have
/// taken the kernel's memory.
fn carry_out<'a>(attacks: &[&'a str], keys: &str) -> (String, Vec<Suspect<'a>>) {
    let all = [&["nothing"], attacks].concat();
    let folder = tempfile::tempdir().unwrap();
    let schedule = sketch(&all, keys).write(folder.path());
    let length = Duration::from_millis(all.len() as u64 * EACH_MS);
    let (ended, samples) = run_watched(&schedule, "attacker", length);
    let mut noticed = String::new();
    let windows = ended.windows();
    for name in OTHERS {
        let during = |attack: usize| {
            let own = windows.iter().filter(move |window| window.partition == name);
            own.filter(move |window| place(window.planned_start_ns) == attack)
        };
        for (number, attack) in all.iter().enumerate().skip(1) {
            let (bad, count) = (taken(during(number)), during(number).count());
            if count < (EACH_MS / 40) as usize {
                writeln!(noticed, "{attack}: {name} has only {count} windows").unwrap();
            }
            if bad > 0 {
                writeln!(noticed, "{attack}: {bad} of {count} windows of {name} were taken from it").unwrap();
            }
        }
    }
    for fault in ended.faults().iter().filter(|fault| is_noticed(fault, &["attacker", "ear"])) {
        let attack = all.get(place(fault.time_ns)).unwrap_or(&"the end");
        writeln!(noticed, "{attack}: {fault:?}").unwrap();
    }
    let of = |attack: usize| {
        let within = move |sample: &&Sample| place(sample.module_ms * 1_000_000) == attack;
        samples.iter().filter(within).copied().collect::<Vec<Sample>>()
    };
    let mut suspects = Vec::new();
    for (number, attack) in all.iter().enumerate().skip(1) {
        let during = of(number);
        let disk = during.iter().map(|sample| sample.disk).max().unwrap_or(0);
        if disk > DISK {
            writeln!(noticed, "{attack}: {} KiB of the disk", disk >> 10).unwrap();
        }
        let kernel = held(&during, &of(0), |sample| sample.kernel);
        let sockets = held(&during, &of(0), |sample| sample.sockets);
        let sent = held(&during, &of(0), |sample| sample.sent);
        eprintln!(
            "{attack}: disk {} KiB, kernel {} KiB, sockets {} KiB, sent {} KiB",
            disk >> 10,
            kernel >> 10,
            sockets >> 10,
            sent >> 10
        );
        let bound = if keys.contains("tcp") { KERNEL + CONNECTIONS } else { KERNEL };
        if sockets + sent > bound {
            writeln!(noticed, "{attack}: {} KiB in sockets, {} KiB sent", sockets >> 10, sent >> 10).unwrap();
        } else if kernel > KERNEL {
            let found =
                format!("{attack}: {} KiB of the kernel's memory outside of its group\n", kernel >> 10);
            suspects.push((*attack, found));
        }
    }
    if !noticed.is_empty() {
        writeln!(noticed, "{}", ended.stderr).unwrap();
    }
    (noticed, suspects)
}

/// A network of the test alone, with room for many neighbours of whom none is there.
#[allow(unsafe_code)]
fn enter_a_silent_network() {
    // SAFETY: only this thread's network namespace changes, and it has no sockets.
    unsafe { rustix::thread::unshare_unsafe(rustix::thread::UnshareFlags::NEWNET) }.unwrap();
    for line in [
        "link set lo up",
        "link add silent type veth peer name nobody",
        "link set nobody up",
        "link set silent up",
        "address add 10.99.0.1/16 dev silent",
        "address add fd99::1/64 dev silent nodad",
    ] {
        let done = std::process::Command::new("ip").args(line.split(' ')).status();
        assert!(done.unwrap().success(), "ip {line}");
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn nobody_notices_a_partition_that_puts_work_into_interrupts() {
        let attacks = [
            "timers_2500",
            "timers_20000",
            "timers_that_repeat",
            "timers_of_processor_time",
            "timer_descriptors",
            "interval_timers",
            "queued_signals",
        ];
        assert_nobody_notices(&attacks, "");
    }

    #[test]
    fn nobody_notices_a_partition_that_uses_up_what_it_was_granted() {
        let attacks = ["timers_2500", "timers_that_repeat", "interval_timers", "queued_signals", "watches"];
        let keys = "system_calls = [\"timers\", \"inotify\", \"queued_signals\"]";
        assert_nobody_notices(&attacks, keys);
    }

    #[test]
    fn nobody_notices_a_partition_with_threads_that_wake_and_end_in_others_time() {
        assert_nobody_notices(&["sleepers", "children", "timers_2500"], "threads = 8");
    }

    #[test]
    fn nobody_notices_a_partition_that_fills_the_disk_and_its_channel() {
        let attacks = [
            "allocate",
            "truncate",
            "write_anywhere",
            "map_log",
            "change_log",
            "babble",
            "fill_channel",
            "sparse_in_channel",
            "names_in_channel",
            "folders_in_channel",
            "chmod",
            "lock_all",
            "change_folder",
        ];
        assert_nobody_notices(&attacks, "");
    }

    #[test]
    fn nobody_notices_a_partition_that_takes_the_kernels_memory() {
        let attacks = [
            "watches",
            "descriptors",
            "watched_descriptors",
            "datagrams_between_sockets",
            "streams_between_sockets",
            "descriptors_in_flight",
            "filters_of_sockets",
            "pipes",
            "message_queues",
            "system_v",
            "locked_memory",
            "small_mappings",
            "named_mappings",
            "huge_pages",
            "file_locks",
            "absent_names",
        ];
        assert_nobody_notices(&attacks, "");
    }

    #[test]
    fn nobody_notices_a_partition_that_fills_sockets_of_the_internet() {
        let attacks =
            ["udp", "incomplete_datagrams", "tcp", "tcp_never_accepted", "tcp_timers", "groups_of_hosts"];
        assert_nobody_notices(&attacks, "network = true");
    }

    #[test]
    fn nobody_notices_a_partition_that_talks_to_computers_that_are_not_there() {
        if is_walled_in() {
            enter_a_silent_network();
        }
        assert_nobody_notices(&["silent_neighbours", "many_neighbours"], "network = true");
        if is_walled_in() {
            let neighbours =
                std::process::Command::new("ip").args(["neighbour", "show", "nud", "all"]).output();
            let count = String::from_utf8_lossy(&neighbours.unwrap().stdout).lines().count();
            // Those of the attacker's successor, which begins again, and the network's own groups.
            assert!(
                (8..=2 * MOST_ADDRESSES + 16).contains(&count),
                "{count} neighbours are in the machine's tables"
            );
        }
    }

    #[test]
    fn nobody_notices_a_partition_that_uses_up_the_connections_it_was_granted() {
        assert_nobody_notices(&["tcp", "tcp_timers"], "network = true\nsystem_calls = [\"tcp\"]");
    }

    #[test]
    fn nobody_notices_a_partition_that_keeps_the_kernel_busy() {
        let attacks = [
            "barriers",
            "drain",
            "open_and_close",
            "make_and_remove",
            "futexes",
            "page_faults",
            "long_reads",
            "tell_tale_files",
            "splices",
            "execute_itself",
            "exit",
            "exit_with_much",
            "stop_all",
            "kill_all",
        ];
        assert_nobody_notices(&attacks, "");
    }
}
