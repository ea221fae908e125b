//! Waiting for processes and pipes, and how a process has ended.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};

use crate::time::{now_ns, timespec};

/// A started process.
#[derive(Debug)]
pub struct Spawned {
    /// Its number, as the executive sees it.
    pub pid: i32,
    /// Becomes readable when it ends.
    pub pidfd: OwnedFd,
}

/// How a process ended, if it has; reaps it.
pub fn ended(process: &Spawned) -> Option<ExitStatus> {
    let status = waitid(WaitId::PidFd(process.pidfd.as_fd()), WaitIdOptions::EXITED | WaitIdOptions::NOHANG)
        .ok()??;
    let raw = match (status.exit_status(), status.terminating_signal()) {
        (Some(code), _) => (code & 0xff) << 8,
        (_, Some(signal)) => signal,
        _ => 0,
    };
    Some(ExitStatus::from_raw(raw))
}

/// Whether a child of this process is stopped by a signal. It takes no memory and waits for nobody.
#[must_use]
pub fn is_stopped(pid: i32) -> bool {
    let seen = WaitIdOptions::STOPPED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT; // left for whoever asks next
    Pid::from_raw(pid).is_some_and(|pid| matches!(waitid(WaitId::Pid(pid), seen), Ok(Some(_))))
}

/// How a program of ours ends that has panicked.
const PANIC: i32 = 101;

/// Whether what a process of ours has read in shared memory has ended it: it was ended by a signal, the executive's among
/// them, or has panicked. What it says itself, as of a full disk, would be said by its successor too.
pub fn is_victim(status: Option<ExitStatus>) -> bool {
    status.is_some_and(|status| !status.success() && matches!(status.code(), None | Some(PANIC)))
}

/// Waits until one of `processes` ends, at most `nanoseconds`; false: none has.
pub fn await_any_end(processes: &[BorrowedFd<'_>], nanoseconds: u64) -> bool {
    let mut fds: Vec<_> = processes.iter().map(|process| PollFd::new(process, PollFlags::IN)).collect();
    let end_ns = now_ns().saturating_add(nanoseconds);
    loop {
        let left = timespec(end_ns.saturating_sub(now_ns()));
        // A signal to the executive is no reason to leave a dying process unreaped.
        match poll(&mut fds, Some(&left)) {
            Err(rustix::io::Errno::INTR) => {}
            // A failed question is no reason to believe that all live: the caller looks.
            answer => return answer.map_or(true, |ready| ready > 0),
        }
    }
}

/// Whether nobody holds the other end of a pipe or socket any more.
pub fn is_hung_up(descriptor: BorrowedFd<'_>) -> bool {
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    let mut one = [PollFd::from_borrowed_fd(descriptor, PollFlags::empty())]; // a hang-up is told unasked
    poll(&mut one, Some(&now)).is_ok() && one[0].revents().contains(PollFlags::HUP)
}

/// Whether a process has ended, or a pipe has something to say or was closed.
pub fn is_readable(descriptor: BorrowedFd<'_>) -> bool {
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut [PollFd::from_borrowed_fd(descriptor, PollFlags::IN)], Some(&now)).is_ok_and(|ready| ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn child_that_is_stopped_is_told_from_one_that_runs_or_has_ended() {
        let mut sleeper = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let pid = Pid::from_child(&sleeper);
        let stopped = || is_stopped(pid.as_raw_nonzero().get());
        assert!(!stopped());
        for _ in 0..3 {
            rustix::process::kill_process(pid, rustix::process::Signal::STOP).unwrap();
            let begun = std::time::Instant::now();
            while !stopped() {
                assert!(begun.elapsed().as_secs() < 60);
                std::thread::yield_now();
            }
            assert!(stopped(), "a look takes nothing away");
            rustix::process::kill_process(pid, rustix::process::Signal::CONT).unwrap();
            assert!(!stopped(), "it goes on with the signal");
        }
        sleeper.kill().unwrap();
        assert!(!stopped());
        sleeper.wait().unwrap();
        assert!(!stopped());
    }
}
