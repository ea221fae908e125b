//! The dead of a module: one janitor at a time removes what a process left in shared memory.
//!
//! Every dead process is buried, also one that has no successor: its queues would stay full for its peers, and its
//! places in the channels would stay taken. It must never hold up a successor for longer than a janitor may take.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};

use super::watched::{Life, Watched};
use super::{StartJanitor, end_helper};
use crate::partition::ended;
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;

/// A janitor that takes longer is ended: the library's clean-up can hang. One that works takes some milliseconds, and on a
/// machine with ten times the work that it can do a second; ended then, it leaves the successor without its ports.
const JANITOR_PATIENCE_NS: u64 = 3_000_000_000;

/// See the module's head.
pub(super) struct Burials {
    start_janitor: StartJanitor,
    /// At work: for whom, and since when.
    janitor: Option<(usize, Spawned, u64)>,
    waiting: VecDeque<usize>,
}

impl Burials {
    pub(super) fn new(start_janitor: StartJanitor) -> Self {
        Self { start_janitor, janitor: None, waiting: VecDeque::new() }
    }

    /// The process that `place` had waits for its burial.
    pub(super) fn add(&mut self, place: usize) {
        let under_way = self.janitor.as_ref().is_some_and(|(busy, ..)| *busy == place);
        if !under_way && !self.waiting.contains(&place) {
            self.waiting.push_back(place);
        }
    }

    /// The next partition whose dead process has been buried; none: a janitor is at work, or nobody waits.
    pub(super) fn next_buried(&mut self, watched: &[Watched]) -> Option<usize> {
        if let Some((place, janitor, since_ns)) = self.janitor.take() {
            if ended(&janitor).is_none() {
                if now_ns() - since_ns < JANITOR_PATIENCE_NS {
                    self.janitor = Some((place, janitor, since_ns));
                    return None;
                }
                end_helper(&janitor);
            }
            return Some(place);
        }
        let place = self.waiting.pop_front()?;
        let Life::Dead(pid, _) = watched[place].life else { return Some(place) };
        match (self.start_janitor)(watched[place].cage.id, pid) {
            Ok(janitor) => {
                self.janitor = Some((place, janitor, now_ns()));
                None
            }
            // Without a janitor a successor may still find its ports free: trying costs nothing.
            Err(_) => Some(place),
        }
    }

    /// The janitor at work.
    pub(super) fn janitor(&self) -> Option<BorrowedFd<'_>> {
        self.janitor.as_ref().map(|(_, process, _)| process.pidfd.as_fd())
    }

    /// The module ends: nobody needs what is in shared memory any more.
    pub(super) fn give_up(&mut self) {
        if let Some((_, janitor, _)) = self.janitor.take() {
            end_helper(&janitor);
        }
    }
}
