//! What figures are held against, measured with the same system calls on the same processor at the same priority, without
//! the executive.
#![allow(unsafe_code)] // clocks of another process

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use bateleur_system::sched;
use bateleur_system::time::{now_ns, sleep_until_ns};

use super::turns::Ring;

/// What the figures are of, in a line: the processors that may be used, kernel, rights, and the day.
pub(super) fn machine(processors: usize) -> String {
    let name = rustix::system::uname();
    let of_kernel = |text: &std::ffi::CStr| text.to_string_lossy().into_owned();
    let (kernel, kind) = (of_kernel(name.release()), of_kernel(name.machine()));
    let rights = if rustix::process::geteuid().is_root() { "as root" } else { "not as root" };
    format!("{processors} processors ({kind}), Linux {kernel}, {rights}, {}", today())
}

/// The date, UTC.
fn today() -> String {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Realtime).tv_sec;
    let mut text = [0_u8; 16];
    // SAFETY: all that it is handed lives here, and it writes no more than it is told that there is room for.
    let length = unsafe {
        let mut date: libc::tm = std::mem::zeroed();
        libc::gmtime_r(&now, &mut date);
        libc::strftime(text.as_mut_ptr().cast(), text.len(), c"%Y-%m-%d".as_ptr(), &date)
    };
    String::from_utf8_lossy(&text[..length]).into_owned()
}

/// The dispatcher's priority, for loops that stand in for it.
pub(super) const DISPATCHER: u8 = 98;
/// The priority that partitions have when the plan says nothing.
pub(super) const PARTITION: u8 = 40;

/// Runs `work` in a thread of its own on processor `core`, at real-time `priority`.
pub(super) fn on_core<T: Send + 'static>(
    core: u32,
    priority: u8,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let prepared = move || {
        sched::bind(0, &[core]).context("cannot use the processor")?;
        sched::fifo(0, priority).context("no SCHED_FIFO (run as root)")?;
        Ok(work())
    };
    std::thread::spawn(prepared).join().map_err(|_| anyhow!("a measuring thread failed"))?
}

/// How late `clock_nanosleep` to an absolute instant returns, us, one sample each `period_us` for `length`.
pub(super) fn cyclic(core: u32, period_us: u64, length: Duration) -> Result<Vec<f64>> {
    on_core(core, DISPATCHER, move || {
        let count = length.as_micros() as u64 / period_us;
        let mut late = Vec::with_capacity(count as usize);
        let origin_ns = now_ns() + 1_000_000;
        for number in 0..count {
            let target_ns = origin_ns + number * period_us * 1000;
            sleep_until_ns(target_ns);
            late.push(now_ns().saturating_sub(target_ns) as f64 / 1e3);
        }
        late
    })
}

/// Processor time of one `clock_nanosleep` while a thread of a partition's priority spins on the same processor, us: what
/// any dispatcher pays to be woken by the clock.
pub(super) fn timer_wake_us(core: u32, rounds: u32) -> Result<f64> {
    on_core(core, DISPATCHER, move || {
        let over = AtomicU32::new(0);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let ready = sched::bind(0, &[core]).and_then(|()| sched::fifo(0, PARTITION));
                while ready.is_ok() && over.load(Ordering::Relaxed) == 0 {
                    std::hint::spin_loop();
                }
            });
            let (origin_ns, begun_us) = (now_ns(), own_time_us());
            for round in 1..=u64::from(rounds) {
                sleep_until_ns(origin_ns + round * 1_000_000);
            }
            let used_us = own_time_us() - begun_us;
            over.store(1, Ordering::Relaxed);
            used_us / f64::from(rounds)
        })
    })
}

/// Processor time of the calling thread, us.
pub(super) fn own_time_us() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 / 1e3
}

/// A futex wake of a thread on the same processor and the switch to it, us: half of a round of two threads.
pub(super) fn futex_switch(core: u32, rounds: u32) -> Result<f64> {
    on_core(core, DISPATCHER, move || {
        let ring = Ring::new(2);
        let begun_ns = now_ns();
        // A scoped thread inherits neither priority nor processor reliably: it takes them itself.
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let ready = sched::bind(0, &[core]).and_then(|()| sched::fifo(0, DISPATCHER));
                ready.map(|()| ring.take_turns(1, rounds))
            });
            ring.take_turns(0, rounds);
        });
        (now_ns() - begun_ns) as f64 / 1e3 / f64::from(2 * rounds)
    })
}

/// Processor time that a process has used so far, us; `None` if it has ended.
pub(super) fn processor_time_us(pid: i32) -> Option<f64> {
    let mut clock: libc::clockid_t = 0;
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: both calls write into the structures that they are handed, which live here.
    let read = unsafe {
        libc::clock_getcpuclockid(pid, &raw mut clock) == 0 && libc::clock_gettime(clock, &raw mut time) == 0
    };
    read.then(|| time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 / 1e3)
}

/// Processor time of the threads of a process whose name begins with `name`, us; `None` if the kernel does not count.
pub(super) fn thread_time_us(pid: i32, name: &str) -> Option<f64> {
    let of_thread = |tid: i32| {
        let folder = format!("/proc/{pid}/task/{tid}");
        let comm = std::fs::read_to_string(format!("{folder}/comm")).ok()?;
        let counted = std::fs::read_to_string(format!("{folder}/schedstat")).ok()?;
        let ns: f64 = counted.split_whitespace().next()?.parse().ok()?;
        comm.starts_with(name).then_some(ns / 1e3)
    };
    let times: Vec<f64> = sched::threads(pid).into_iter().filter_map(of_thread).collect();
    (!times.is_empty()).then(|| times.iter().sum())
}

/// Child processes of `pid`: number, name.
pub(super) fn children(pid: i32) -> Vec<(i32, String)> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let about = |number: i32| {
        let stat = std::fs::read_to_string(format!("/proc/{number}/stat")).ok()?;
        let (before, after) = stat.rsplit_once(')')?;
        let mut fields = after.split_ascii_whitespace();
        let (state, parent) = (fields.next()?, fields.next()?);
        let lives = parent == pid.to_string() && state != "Z" && state != "X";
        lives.then(|| (number, before.split_once('(').map(|(_, name)| name.to_owned()).unwrap_or_default()))
    };
    numbers.filter_map(about).collect()
}

/// The real cyclictest at the same priority on the same core, where it is installed: one sample a millisecond, us.
pub(super) fn cyclictest(core: u32, length: Duration) -> Option<Vec<f64>> {
    let loops = length.as_millis().to_string();
    let arguments = ["-q", "-m", "-t", "1", "-i", "1000", "-h", "2000", "-l", &loops];
    let output = std::process::Command::new("cyclictest")
        .args(arguments)
        .args(["-p", &DISPATCHER.to_string(), "-a", &core.to_string()])
        .output()
        .ok()?;
    let samples = histogram(&String::from_utf8_lossy(&output.stdout));
    (!samples.is_empty()).then_some(samples)
}

/// Samples from the lines "000012 000345" of cyclictest's histogram.
fn histogram(text: &str) -> Vec<f64> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let pairs = lines.filter_map(|line| {
        let mut fields = line.split_whitespace();
        Some((fields.next()?.parse::<f64>().ok()?, fields.next()?.parse::<usize>().ok()?))
    });
    pairs.flat_map(|(us, count)| std::iter::repeat_n(us, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn machine_is_told_with_the_day() {
        let said = machine(2);
        let day = said.rsplit_once(", ").map(|(_, day)| day.split('-').collect::<Vec<_>>()).unwrap();
        assert_eq!(day.iter().map(|part| part.len()).collect::<Vec<_>>(), [4, 2, 2], "{said}");
        assert!(day.iter().all(|part| part.parse::<u16>().is_ok()) && said.contains("Linux "), "{said}");
    }

    #[test]
    fn the_histogram_of_cyclictest_becomes_samples() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000003 000002\n000007 000001\n# Total: 000000003\n";
        assert_eq!(histogram(text), [3.0, 3.0, 7.0]);
    }
}
