//! The process of an executive, as its supervisor sees it: a child, or the process that has started the supervisor in place of a dead one.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus};

use bateleur_system::processes::{below, process};
use bateleur_system::wait::{await_any_end, is_stopped, is_victim};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// The name of the process that cleans up after an executive.
const GUARD: &str = "guard";

/// See the module's head.
pub(crate) struct WatchedExecutive {
    pid: Pid,
    process: OwnedFd,
    /// `None`: it is no child of this process.
    child: Option<Child>,
    /// Of one that is no child: what it leaves does not become a child of this process either, and ends before this one does.
    guard: Option<OwnedFd>,
}

impl WatchedExecutive {
    /// One that this process has started.
    pub(crate) fn started(child: Child) -> io::Result<Self> {
        let pid = Pid::from_child(&child);
        Ok(Self { pid, process: pidfd_open(pid, PidfdFlags::empty())?, child: Some(child), guard: None })
    }

    /// One that has started this process.
    pub(crate) fn found(pid: Pid, process: OwnedFd) -> Self {
        let lives = !await_any_end(&[process.as_fd()], 0); // its number may be somebody else's otherwise
        let children = if lives { below(pid.as_raw_nonzero().get()) } else { Vec::new() };
        let guard = children.into_iter().find(|child| child.name == GUARD);
        let guard = guard.and_then(|guard| pidfd_open(Pid::from_raw(guard.pid)?, PidfdFlags::empty()).ok());
        Self { pid, process, child: None, guard }
    }

    /// Waits for its end, at most so long; whether it has ended.
    pub(crate) fn await_end(&self, nanoseconds: u64) -> bool {
        await_any_end(&[self.process.as_fd()], nanoseconds)
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let _ = pidfd_send_signal(&self.process, signal); // it has ended
    }

    /// Whether a signal has stopped it.
    pub(crate) fn is_stopped(&self) -> bool {
        let pid = self.pid.as_raw_nonzero().get();
        if self.child.is_some() { is_stopped(pid) } else { process(pid).is_some_and(|it| it.state == 'T') }
    }

    /// The exit code that it has given by itself, or how it has died. `said`: the code that it was about to give, if it knew.
    pub(crate) fn end(&mut self, said: Option<u8>) -> io::Result<Result<u8, String>> {
        let Some(child) = &mut self.child else {
            return Ok(said.ok_or_else(|| "ended; how, only its dead supervisor could see".to_owned()));
        };
        let status = child.wait()?;
        Ok(match status.code() {
            Some(code) if !is_victim(Some(status)) => Ok(code as u8), // 0 to 255
            _ => Err(died_of(status)),
        })
    }

    /// Waits, at most so long, until what it has left is cleaned up, as far as that is not a child of this process.
    pub(crate) fn await_guard(&self, nanoseconds: u64) {
        if let Some(guard) = &self.guard {
            await_any_end(&[guard.as_fd()], nanoseconds);
        }
    }
}

fn died_of(status: ExitStatus) -> String {
    match status.signal() {
        Some(signal) => format!("ended by signal {signal}"),
        None => format!("ended with exit code {}", status.code().unwrap_or(-1)),
    }
}
