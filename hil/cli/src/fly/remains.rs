//! The processes of a module that was killed: its partitions, its helpers, and the guard that cleans up after it.
//!
//! Whoever starts the module anew waits for their end first: they hold its addresses, and a computer that is switched on has
//! none of them.

use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use bateleur_system::processes::below;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// How long they may take, real time.
const PATIENCE: Duration = Duration::from_secs(20);
/// Between two looks.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };

/// The name of an executive's process below a supervisor.
const EXECUTIVE: &str = "bateleurd";

/// See the module's head.
pub(super) struct Remains(Vec<(String, OwnedFd)>);

impl Remains {
    /// All processes below the process `root`, which still lives.
    pub(super) fn of(root: u32) -> Self {
        let open = |pid| pidfd_open(Pid::from_raw(pid)?, PidfdFlags::empty()).ok();
        let below = i32::try_from(root).map_or_else(|_| Vec::new(), below);
        Self(below.into_iter().filter_map(|process| Some((process.name, open(process.pid)?))).collect())
    }

    /// Kills an executive among them.
    pub(super) fn without_executive(self) -> Self {
        for (_, process) in self.0.iter().filter(|(name, _)| name == EXECUTIVE) {
            let _ = pidfd_send_signal(process, Signal::KILL); // it has ended
        }
        self
    }

    /// Waits until all of them have ended.
    ///
    /// # Errors
    /// One does not.
    pub(super) fn await_end(&self) -> Result<()> {
        self.await_end_within(PATIENCE)
    }

    fn await_end_within(&self, patience: Duration) -> Result<()> {
        let begun = Instant::now();
        for (_, process) in &self.0 {
            loop {
                let mut waits = [PollFd::new(process, PollFlags::IN)];
                if poll(&mut waits, Some(&LOOK)).is_ok_and(|ready| ready > 0) {
                    break;
                }
                if begun.elapsed() > patience {
                    bail!("what was left of it has not ended within {} s", patience.as_secs());
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    use rustix::process::{Signal, kill_process};

    use super::*;

    #[test]
    fn children_are_waited_for_until_the_last_has_ended() {
        let words = "sleep 1000 & echo $!; sleep 1000 & echo $!; wait";
        let mut parent = Command::new("sh").args(["-c", words]).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(parent.stdout.take().unwrap()).lines();
        let children: Vec<Pid> =
            lines.take(2).map(|line| Pid::from_raw(line.unwrap().parse().unwrap()).unwrap()).collect();
        let remains = Remains::of(parent.id());
        assert_eq!(remains.0.len(), 2, "no other process of the machine is its child");
        assert!(remains.await_end_within(Duration::ZERO).is_err(), "both live");
        for (child, is_over) in children.into_iter().zip([false, true]) {
            kill_process(child, Signal::KILL).unwrap();
            let ended = if is_over { remains.await_end() } else { remains.await_end_within(Duration::ZERO) };
            assert_eq!(ended.is_ok(), is_over, "one of two lives");
        }
        parent.wait().unwrap();
    }
}
