//! What a partition takes of the machine beside its windows: of the disk, and of the kernel's memory; and what its
//! neighbours notice of it.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::process::Signal;

use crate::children::Process;
use crate::output::{Fault, Window};
use crate::programs::{Ended, Started, bateleur};
use crate::{Traces, await_some, children_of};

/// What a partition may take of the disk, bytes: its log, what is kept of the one before, and what one write may add.
pub const DISK: u64 = (1 << 20) + (256 << 10) + (64 << 10);
/// What it may take of the kernel's memory outside of its control group, bytes.
pub const KERNEL: i64 = 2 << 20;

/// Keys of a partition `neighbour` that takes a little of each resource in each window, and raises an error where it does not get it.
pub const NEEDS: &str = "system_calls = [\"timers\", \"inotify\"]\n\
    attributes = { needs = [\"pipes\", \"events\", \"files\", \"memory_files\", \"memory\", \"timers\", \"timer_descriptors\", \"watches\"] }\n";

/// What the machine has of its own memory at one moment, and one partition of the disk.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Since its partitions were ready.
    pub module_ms: u64,
    /// The kernel's memory that no control group counts, bytes.
    pub kernel: i64,
    /// What sockets of the internet hold beside its memory, bytes; 0 where the kernel counts it as its memory.
    pub sockets: i64,
    /// What open sockets of the partition have sent and still hold, bytes.
    pub sent: i64,
    /// What the partition's logs take, bytes.
    pub disk: u64,
}

/// What the kernel has allocated for no control group: its general caches for such memory, those of packets, and that of locks. Caches of
/// which each object is counted in a group are left out.
fn kernel_memory() -> i64 {
    let text = fs::read_to_string("/proc/slabinfo").unwrap_or_default();
    let of_line = |line: &str| {
        let mut fields = line.split_ascii_whitespace();
        let name = fields.next()?;
        let general =
            name.strip_prefix("kmalloc-").is_some_and(|size| size.starts_with(|c: char| c.is_ascii_digit()));
        let (count, size) = (fields.next()?.parse::<i64>().ok()?, fields.nth(1)?.parse::<i64>().ok()?);
        (general || name.starts_with("skbuff") || name == "file_lock_cache").then_some(count * size)
    };
    text.lines().filter_map(of_line).sum()
}

/// Where the kernel counts what sockets of `partition` hold: the file of its group, where version 1 of the controller counts
/// them apart. `/proc/net/sockstat` would not do: the kernel keeps up to 1 MiB of each processor aside for it, and other
/// programs' sockets are in it too.
fn socket_account(executive: i32, partition: &str) -> Option<PathBuf> {
    let group_of = |process: Process| {
        let groups = fs::read_to_string(format!("/proc/{}/cgroup", process.pid)).ok()?;
        let group = groups.lines().find_map(|line| line.split_once(":memory:/"))?.1.to_owned();
        Path::new(&group).ends_with(partition).then_some(group)
    };
    let group = children_of(executive).into_iter().find_map(group_of)?;
    Some(Path::new("/sys/fs/cgroup/memory").join(group).join("memory.kmem.tcp.usage_in_bytes"))
}

/// The user of `partition`, which has it alone.
fn user_of(executive: i32, partition: &str) -> Option<u32> {
    let user = |process: Process| {
        let groups = fs::read_to_string(format!("/proc/{}/cgroup", process.pid)).ok()?;
        groups.lines().any(|line| Path::new(line).ends_with(partition)).then_some(())?;
        let status = fs::read_to_string(format!("/proc/{}/status", process.pid)).ok()?;
        status.lines().find_map(|line| line.strip_prefix("Uid:"))?.split_whitespace().next()?.parse().ok()
    };
    children_of(executive).into_iter().find_map(user)
}

/// What sockets of `user` have sent and still hold, bytes, by the table of UDP sockets (proc_net(5)).
fn sent(user: u32) -> i64 {
    let tables = ["udp", "udp6"].map(|name| fs::read_to_string(format!("/proc/thread-self/net/{name}")));
    let of_line = |line: &str| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let queue = fields.get(4)?.split_once(':')?.0;
        (fields.get(7)?.parse() == Ok(user)).then(|| i64::from_str_radix(queue, 16).unwrap_or(0))
    };
    tables.into_iter().flatten().map(|text| text.lines().filter_map(of_line).sum::<i64>()).sum()
}

/// The number in a file of the kernel's.
fn bytes_in(file: &Path) -> i64 {
    fs::read_to_string(file).ok().and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}

/// What files of a partition take of the disk.
fn disk_of(folder: &Path, partition: &str) -> u64 {
    let entries = fs::read_dir(folder.join("partitions")).into_iter().flatten().flatten();
    let own = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(partition));
    own.filter_map(|entry| entry.metadata().ok()).map(|about| about.blocks() * 512).sum()
}

/// A module that runs for `length` and is ended by SIGTERM, with samples of the machine and of `partition`. Nothing of it stays.
#[track_caller]
pub fn run_watched(schedule: &str, partition: &str, length: Duration) -> (Ended, Vec<Sample>) {
    let mut module = bateleur(&["run", "--schedule", schedule]);
    module.await_words("partitions are ready");
    let traces = Traces::of(module.pid());
    let samples = watch(&module, partition, length);
    let late = children_of(module.pid());
    module.signal(Signal::TERM);
    let ended = module.end().expect_code(0);
    traces.expect_gone();
    let gone =
        await_some(Duration::from_secs(10), || late.iter().all(|process| !process.is_alive()).then_some(()));
    assert!(gone.is_some(), "processes of the end are left: {late:?}");
    (ended, samples)
}

/// Whether a fault is one that others than the partitions `expected` notice. How late windows begin is judged elsewhere.
pub fn is_noticed(fault: &Fault, expected: &[&str]) -> bool {
    !["late_dispatcher", "window_overrun", "processor_taken"].contains(&fault.error.as_str())
        && !expected.contains(&fault.partition.as_str())
}

/// Samples of the machine and of `partition` for `length`, from now on, when the partitions of `module` are ready.
fn watch(module: &Started, partition: &str, length: Duration) -> Vec<Sample> {
    let begun = Instant::now();
    let mut samples = Vec::new();
    let account = socket_account(module.pid(), partition);
    let user = user_of(module.pid(), partition).expect("the partition has a process and a user");
    while begun.elapsed() < length {
        samples.push(Sample {
            module_ms: begun.elapsed().as_millis() as u64,
            kernel: kernel_memory(),
            sockets: account.as_deref().map_or(0, bytes_in),
            sent: sent(user),
            disk: disk_of(&module.folder(), partition),
        });
        std::thread::sleep(Duration::from_millis(100));
    }
    samples
}

/// Windows that were not granted although the dispatcher came in time: somebody in the module took them. How late windows begin is
/// for `bateleur bench attacks`: a machine that others use takes many by itself.
pub fn taken<'a>(windows: impl Iterator<Item = &'a Window>) -> usize {
    windows.filter(|window| window.granted_ns.is_none() && !window.late).count()
}

/// What is held in `during` beyond what there was `before`, bytes, for certain: others use the machine too, and that comes
/// and goes, so it is the least of the second half beyond the most before, and beyond what that went up and down.
pub fn held(during: &[Sample], before: &[Sample], value: fn(&Sample) -> i64) -> i64 {
    let least = |samples: &[Sample]| samples.iter().map(value).min().unwrap_or(0);
    let most = |samples: &[Sample]| samples.iter().map(value).max().unwrap_or(0);
    least(&during[during.len() / 2..]) - most(before) - (most(before) - least(before))
}

/// Whether partitions have a user of their own: one that attacks all that it can reach must not reach the files and the
/// processes of who runs the tests.
pub fn is_walled_in() -> bool {
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        eprintln!("not tried: only root's partitions have another user than the tests");
    }
    is_root
}
