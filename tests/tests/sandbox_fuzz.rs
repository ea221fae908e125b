//! A partition that makes random system calls, beside six that have nothing to do with it: none of them misses a window,
//! loses a message, is restarted or is denied a resource by it, and what it takes of the disk and of the kernel's memory
//! stays within its bounds. Nothing is left behind.
//!
//! `BATELEUR_FUZZ_SECONDS`: how long, all runs together. `BATELEUR_FUZZ_SEED`: the first run's seed; each further run has
//! the next one. A finding names its seed, and the health log the incarnation at that time: see `tests/src/bin/fuzzer.rs`.

use std::fmt::Write;
use std::time::Duration;

use bateleur_tests::fuzzed::{self, KINDS, Kind, PAIRS, QUIET_MS};
use bateleur_tests::{DISK, KERNEL, Sample, alone, held, is_noticed, is_walled_in, run_watched, taken};

/// The longest run with one seed, s.
const RUN_S: u64 = 60;

/// Runs with one seed; what others noticed, in words. What is measured of the kernel is the whole machine's, and others use it too: it
/// counts if it is so again.
fn fuzz(kind: &Kind, seed: u64, seconds: u64) -> String {
    let (mut noticed, mut kernel) = run(kind, seed, seconds);
    if kernel > KERNEL {
        kernel = kernel.min(run(kind, seed, seconds).1);
    }
    if kernel > KERNEL {
        writeln!(noticed, "{} KiB of the kernel's memory", kernel >> 10).unwrap();
    }
    if noticed.is_empty() { noticed } else { format!("{}, seed {seed}:\n{noticed}", kind.name) }
}

/// One run; what others noticed, and what of the kernel's memory was taken meanwhile, bytes.
fn run(kind: &Kind, seed: u64, seconds: u64) -> (String, i64) {
    let folder = tempfile::tempdir().unwrap();
    let schedule = kind.sketch(seed).write(folder.path());
    eprintln!("{}, seed {seed}", kind.name);
    let (ended, samples) = run_watched(&schedule, "fuzzer", Duration::from_secs(seconds));
    let mut noticed = String::new();
    let windows = ended.windows();
    for name in PAIRS.into_iter().flat_map(|(from, to)| [from, to]) {
        let own = || windows.iter().filter(move |window| window.partition == name);
        let (bad, all) = (taken(own()), own().count());
        // Beside other work the machine takes one now and then.
        if bad > all / 1000 || all < (seconds - 1) as usize * 40 {
            writeln!(noticed, "{bad} of {all} windows of {name} were taken from it").unwrap();
        }
    }
    for fault in ended.faults().iter().filter(|fault| is_noticed(fault, fuzzed::EXPECTED)) {
        writeln!(noticed, "{fault:?}").unwrap();
    }
    let (quiet, loud): (Vec<Sample>, Vec<Sample>) =
        samples.into_iter().partition(|sample| sample.module_ms < QUIET_MS);
    let disk = loud.iter().map(|sample| sample.disk).max().unwrap_or(0);
    let kernel = held(&loud, &quiet, |sample| sample.kernel);
    let sockets = held(&loud, &quiet, |sample| sample.sockets + sample.sent);
    if disk > DISK {
        writeln!(noticed, "{} KiB of the disk", disk >> 10).unwrap();
    }
    if sockets > KERNEL {
        writeln!(noticed, "{} KiB in sockets", sockets >> 10).unwrap();
    }
    let incarnations = ended.faults().iter().filter(|fault| fault.partition == "fuzzer").count();
    let log = std::fs::read(ended.folder().join("partitions/fuzzer.log")).unwrap_or_default();
    let log = String::from_utf8_lossy(&log);
    let steps = |line: &str| line.split_once("ended in step ")?.1.split(',').next()?.parse::<u64>().ok();
    println!(
        "{}, seed {seed}, {seconds} s: {incarnations} incarnations ended, {} steps; disk {} KiB, kernel {} KiB",
        kind.name,
        log.lines().filter_map(steps).sum::<u64>(),
        disk >> 10,
        kernel >> 10,
    );
    (noticed, kernel)
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

/// Runs of every kind in turn, `seconds` together.
#[track_caller]
fn assert_nobody_notices(seconds: u64) {
    if !is_walled_in() {
        return;
    }
    let _turn = alone();
    let first = number("BATELEUR_FUZZ_SEED", 1);
    let runs = seconds.div_ceil(RUN_S).max(KINDS.len() as u64);
    let each = (seconds / runs).max(3);
    let findings: Vec<String> =
        (0..runs).map(|run| fuzz(&KINDS[run as usize % KINDS.len()], first + run, each)).collect();
    let findings: String = findings.concat();
    assert!(findings.is_empty(), "others notice:\n{findings}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn nobody_notices_a_partition_that_makes_random_system_calls() {
        assert_nobody_notices(number("BATELEUR_FUZZ_SECONDS", 20));
    }

    #[test]
    #[ignore = "takes minutes: `cargo verify` runs it"]
    fn nobody_notices_a_partition_that_makes_random_system_calls_for_long() {
        assert_nobody_notices(number("BATELEUR_FUZZ_SECONDS", 600));
    }
}
