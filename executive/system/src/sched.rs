//! Scheduling policy and affinity of threads that are not our own.
#![allow(unsafe_code)]

use std::io;

use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// Gives thread `tid` SCHED_FIFO. What it forks later starts as ordinary work (SCHED_RESET_ON_FORK), so that a child
/// can not carry a partition's priority out of its window.
pub fn fifo(tid: i32, priority: u8) -> io::Result<()> {
    set(tid, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, i32::from(priority))
}

/// Takes real-time priority from thread `tid`.
pub fn ordinary(tid: i32) -> io::Result<()> {
    set(tid, libc::SCHED_OTHER, 0)
}

/// Whether a thread has real-time priority.
#[must_use]
pub fn is_real_time(tid: i32) -> bool {
    // SAFETY: plain system call on a number.
    let policy = unsafe { libc::sched_getscheduler(tid) };
    matches!(policy & !libc::SCHED_RESET_ON_FORK, libc::SCHED_FIFO | libc::SCHED_RR)
}

/// Whether the kernel leaves ordinary work a part of a processor that real-time work would take whole (sched_rt_runtime_us).
#[must_use]
pub fn spares_ordinary_work() -> bool {
    let runtime_us = std::fs::read_to_string("/proc/sys/kernel/sched_rt_runtime_us");
    runtime_us.is_ok_and(|text| text.trim().parse().is_ok_and(|runtime_us: i64| runtime_us >= 0))
}

/// Processor time that a process has used with all its threads, ns; `None` if it has ended.
#[must_use]
pub fn used_ns(pid: i32) -> Option<u64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // As clock_getcpuclockid computes it, which would ask the kernel once more whether the process is there (CPUCLOCK_SCHED).
    // A thread's clock can be read in its own process only.
    let clock = (!pid << 3) | 2;
    // SAFETY: plain system call that writes into the structure, which lives here.
    let read = unsafe { libc::clock_gettime(clock, &raw mut time) };
    (read == 0).then(|| time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64) // never negative
}

fn set(tid: i32, policy: i32, priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: plain system call; the structure is alive for its length and is not kept.
    match unsafe { libc::sched_setscheduler(tid, policy, &raw const parameters) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// The threads of a process, as they are now.
#[must_use]
pub fn threads(pid: i32) -> Vec<i32> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

/// The processors that this process may use now.
#[must_use]
pub fn allowed_cores() -> Vec<u32> {
    let Ok(set) = sched_getaffinity(None) else { return vec![0] };
    (0..CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).map(|core| core as u32).collect()
}

/// Binds a thread (0: the caller's) to `cores`.
pub fn bind(tid: i32, cores: &[u32]) -> io::Result<()> {
    let mut set = CpuSet::new();
    cores.iter().for_each(|&core| set.set(core as usize));
    Ok(sched_setaffinity(Pid::from_raw(tid), &set)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_of_another_process_is_read_and_grows() {
        let mut busy = std::process::Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        let pid = busy.id() as i32;
        let begun = std::time::Instant::now();
        let first = used_ns(pid).unwrap();
        while used_ns(pid).unwrap() < first + 1_000_000 {
            assert!(begun.elapsed().as_secs() < 60, "{:?}", used_ns(pid));
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        busy.kill().unwrap();
        busy.wait().unwrap();
        assert_eq!(used_ns(pid), None);
    }
}
