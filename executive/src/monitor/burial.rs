//! The dead of a module: one janitor at a time removes what a process left in shared memory.
//!
//! Every dead process is buried, also one that has no successor: its queues would stay full for its peers, and its
//! places in the channels would stay taken. It must never hold up a successor for longer than a janitor may take.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};

use super::processes::end_helper;
use super::standby::Waiting;
use super::watched::{Life, Watched};
use super::{Monitor, StartForStranger, StartJanitor};
use crate::partition::ended;
use crate::system::chance;
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;

/// A janitor that has used more time than this is ended: the library's clean-up can hang. One that works takes some
/// milliseconds.
const JANITOR_PATIENCE_NS: u64 = 3_000_000_000;

/// Whose process is dead: a partition's place, and which of its two processes it was.
type Grave = (usize, Seat);

/// Which of a partition's processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Seat {
    /// The one that has the windows.
    Office,
    /// What lies behind it: one that stood by, or that was followed by one that did.
    Behind,
}

/// See the module's head.
pub(super) struct Burials {
    start_janitor: StartJanitor,
    start_for_stranger: StartForStranger,
    /// At work: for whom, and since when.
    janitor: Option<(Dead, Spawned, u64)>,
    waiting: VecDeque<Dead>,
}

/// Who is buried.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Dead {
    /// A process that a partition had.
    Of(Grave),
    /// Another one that was attached to channels.
    Stranger(i32, Vec<String>),
}

impl Burials {
    pub(super) fn new(start_janitor: StartJanitor, start_for_stranger: StartForStranger) -> Self {
        Self { start_janitor, start_for_stranger, janitor: None, waiting: VecDeque::new() }
    }

    /// The process that `place` had there waits for its burial.
    pub(super) fn add(&mut self, place: usize, seat: Seat) {
        let dead = Dead::Of((place, seat));
        let under_way = self.janitor.as_ref().is_some_and(|(busy, ..)| *busy == dead);
        if !under_way && !self.waiting.contains(&dead) {
            self.waiting.push_back(dead);
        }
    }

    /// A process that is no partition was attached to `channels` when it ended.
    pub(super) fn add_stranger(&mut self, pid: i32, channels: Vec<String>) {
        self.waiting.push_back(Dead::Stranger(pid, channels));
    }

    /// Whether that process waits for its burial.
    pub(super) fn awaits(&self, pid: i32) -> bool {
        let is_it = |dead: &Dead| matches!(dead, Dead::Stranger(stranger, _) if *stranger == pid);
        self.janitor.as_ref().is_some_and(|(dead, ..)| is_it(dead)) || self.waiting.iter().any(is_it)
    }

    /// The next partition whose dead process has been buried; none: a janitor is at work, or nobody waits.
    pub(super) fn next_buried(&mut self, watched: &[Watched]) -> Option<Grave> {
        if let Some((dead, janitor, since_ns)) = self.janitor.take() {
            if ended(&janitor).is_none() {
                if !hangs(janitor.pid, now_ns() - since_ns) {
                    self.janitor = Some((dead, janitor, since_ns));
                    return None;
                }
                end_helper(&janitor);
            }
            if let Dead::Of(grave) = dead {
                return Some(grave);
            }
        }
        let grave = match self.waiting.pop_front()? {
            Dead::Of(grave) => grave,
            Dead::Stranger(pid, channels) => {
                if let Ok(janitor) = (self.start_for_stranger)(pid, &channels) {
                    self.janitor = Some((Dead::Stranger(pid, channels), janitor, now_ns()));
                }
                return None; // what is left of it costs an observer's place in its channels, and nothing else
            }
        };
        let (place, seat) = grave;
        let Some(pid) = dead_process(&watched[place], seat) else { return Some(grave) };
        match (self.start_janitor)(watched[place].cage.id, pid) {
            Ok(janitor) => {
                self.janitor = Some((Dead::Of(grave), janitor, now_ns()));
                None
            }
            // Without a janitor a successor may still find its ports free: trying costs nothing.
            Err(_) => Some(grave),
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

impl Monitor {
    /// Buries a process that is no partition and was attached to `channels`.
    pub fn bury_stranger(&mut self, pid: i32, channels: Vec<String>) {
        self.burials.add_stranger(pid, channels);
    }

    /// Whether it still waits for that.
    #[must_use]
    pub fn awaits_burial(&self, pid: i32) -> bool {
        self.burials.awaits(pid)
    }

    /// Waits for it, as nobody's time passes (the virtual clock).
    pub fn await_burial(&mut self, pid: i32) {
        while self.awaits_burial(pid) {
            self.look_at_janitor();
            if self.awaits_burial(pid) {
                self.pause(200_000);
            }
        }
    }
}

/// Whether a janitor that began `elapsed_ns` ago will not come to an end. Ended before its work is done, it leaves its successor's
/// places in the channels taken.
fn hangs(pid: i32, elapsed_ns: u64) -> bool {
    chance::has_had(pid, elapsed_ns, JANITOR_PATIENCE_NS, chance::STARVED_PATIENCE_NS)
}

fn dead_process(watched: &Watched, seat: Seat) -> Option<i32> {
    match (seat, &watched.life, watched.standby.as_ref().map(|standby| &standby.life)) {
        (Seat::Office, Life::Dead(pid, _), _) | (Seat::Behind, _, Some(Waiting::Dead(pid))) => Some(*pid),
        _ => None,
    }
}
