//! The processes of a module that was killed: its partitions, its helpers, and the guard that cleans up after it.
//!
//! Whoever starts the module anew waits for their end first: they hold its addresses, and a computer that is switched on has
//! none of them.

use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

/// How long they may take, real time.
const PATIENCE: Duration = Duration::from_secs(20);
/// Between two looks.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };

/// See the module's head.
pub(super) struct Remains(Vec<OwnedFd>);

impl Remains {
    /// The children of the process `parent`, which still lives.
    pub(super) fn of(parent: u32) -> Self {
        let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
        let children = pids.filter(|pid| parent_of(*pid) == Some(parent));
        let open = |pid| pidfd_open(Pid::from_raw(pid)?, PidfdFlags::empty()).ok();
        Self(children.filter_map(open).collect())
    }

    /// Waits until all of them have ended.
    ///
    /// # Errors
    /// One does not.
    pub(super) fn await_end(&self) -> Result<()> {
        let begun = Instant::now();
        for process in &self.0 {
            loop {
                let mut waits = [PollFd::new(process, PollFlags::IN)];
                if poll(&mut waits, Some(&LOOK)).is_ok_and(|ready| ready > 0) {
                    break;
                }
                if begun.elapsed() > PATIENCE {
                    bail!("what was left of it has not ended within {} s", PATIENCE.as_secs());
                }
            }
        }
        Ok(())
    }
}

/// Field 4 of /proc/PID/stat; the name before it may hold anything, so fields are counted from its closing bracket.
fn parent_of(pid: i32) -> Option<u32> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit_once(')')?.1.split_ascii_whitespace().nth(1)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn children_are_waited_for_until_they_have_ended() {
        let mut child = Command::new("sleep").arg("1000").spawn().unwrap();
        let remains = Remains::of(std::process::id());
        assert!(!remains.0.is_empty());
        let own = Remains(vec![pidfd_open(Pid::from_child(&child), PidfdFlags::empty()).unwrap()]);
        let thread = std::thread::spawn(move || own.await_end());
        std::thread::sleep(Duration::from_millis(50));
        assert!(!thread.is_finished());
        child.kill().unwrap();
        child.wait().unwrap();
        thread.join().unwrap().unwrap();
    }
}
