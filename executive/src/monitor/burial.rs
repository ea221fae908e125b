//! The dead of a module: one janitor at a time removes what a process left in shared memory.
//!
//! Every dead process is buried, also one that has no successor: its queues would stay full for its peers, and its
//! places in the channels would stay taken. A janitor that ends of what it finds in a channel is followed by one that
//! does not look into that. It must never hold up a successor for long: one that hangs is given three seconds.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;

use super::processes::end_helper;
use super::standby::Waiting;
use super::watched::{Life, Watched};
use super::{Monitor, StartJanitor};
use crate::partition::{ended, is_victim};
use crate::plan::PartitionId;
use crate::system::chance;
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;

/// A janitor that has used more time than this is ended: the library's clean-up can hang. One that works takes some
/// milliseconds.
const JANITOR_PATIENCE_NS: u64 = 3_000_000_000;

/// What a pipe holds (pipe(7)): more channels than a module has.
const PROGRESS_BYTES: usize = 1 << 16;

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
    janitor: Option<Janitor>,
    waiting: VecDeque<Dead>,
    /// They are buried when nobody else waits.
    fallen: Option<(Fallen, Vec<String>)>,
}

/// Numbers of helpers that have ended, each of which was attached to all channels of the module.
pub type Fallen = Rc<RefCell<Vec<i32>>>;

/// What a janitor is told.
#[derive(Debug)]
pub struct Burial {
    /// The dead process.
    pub pid: i32,
    /// The channels that it was attached to.
    pub channels: Vec<String>,
    /// Those among them whose memory must not be looked at.
    pub damaged: Vec<String>,
}

/// A janitor at work.
#[derive(Debug)]
struct Janitor {
    dead: Dead,
    burial: Burial,
    process: Spawned,
    /// Where it says at which channel it is.
    progress: File,
    /// CLOCK_MONOTONIC, ns.
    since_ns: u64,
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
    pub(super) fn new(start_janitor: StartJanitor, fallen: Option<(Fallen, Vec<String>)>) -> Self {
        Self { start_janitor, janitor: None, waiting: VecDeque::new(), fallen }
    }

    /// The process that `place` had there waits for its burial.
    pub(super) fn add(&mut self, place: usize, seat: Seat) {
        let dead = Dead::Of((place, seat));
        let under_way = self.janitor.as_ref().is_some_and(|janitor| janitor.dead == dead);
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
        self.janitor.as_ref().is_some_and(|janitor| is_it(&janitor.dead)) || self.waiting.iter().any(is_it)
    }

    /// The next partition whose dead process has been buried; none: a janitor is at work, or nobody waits. `channels_of`: those that
    /// a partition is attached to.
    pub(super) fn next_buried(
        &mut self,
        watched: &[Watched],
        channels_of: impl Fn(PartitionId) -> Vec<String>,
    ) -> Option<Grave> {
        if let Some(mut janitor) = self.janitor.take() {
            let status = ended(&janitor.process);
            let hangs = status.is_none() && hangs(janitor.process.pid, now_ns() - janitor.since_ns);
            if status.is_none() && !hangs {
                self.janitor = Some(janitor);
                return None;
            }
            if hangs {
                end_helper(&janitor.process);
            }
            let dead = janitor.dead.clone();
            if (hangs || is_victim(status))
                && janitor.spare_what_it_was_at(hangs)
                && self.start(janitor.dead, janitor.burial)
            {
                return None;
            }
            if let Dead::Of(grave) = dead {
                return Some(grave);
            }
        }
        let dead = self.waiting.pop_front().or_else(|| self.fallen_one())?;
        let (pid, channels) = match &dead {
            Dead::Of(grave @ (place, seat)) => {
                let watched = &watched[*place];
                let Some(pid) = dead_process(watched, *seat) else { return Some(*grave) };
                (pid, channels_of(watched.cage.id))
            }
            Dead::Stranger(pid, channels) => (*pid, channels.clone()),
        };
        let grave = match dead {
            Dead::Of(grave) => Some(grave),
            // What is left of it costs an observer's place in its channels, and nothing else.
            Dead::Stranger(..) => None,
        };
        // Without a janitor a successor may still find its ports free: trying costs nothing.
        let is_at_work = self.start(dead, Burial { pid, channels, damaged: Vec::new() });
        grave.filter(|_| !is_at_work)
    }

    fn fallen_one(&self) -> Option<Dead> {
        let (fallen, channels) = self.fallen.as_ref()?;
        fallen.borrow_mut().pop().map(|pid| Dead::Stranger(pid, channels.clone()))
    }

    /// Whether a janitor is at work now.
    fn start(&mut self, dead: Dead, burial: Burial) -> bool {
        self.janitor = (self.start_janitor)(&burial).ok().map(|(process, progress)| Janitor {
            dead,
            burial,
            process,
            progress,
            since_ns: now_ns(),
        });
        self.janitor.is_some()
    }

    /// The janitor at work.
    pub(super) fn janitor(&self) -> Option<BorrowedFd<'_>> {
        self.janitor.as_ref().map(|janitor| janitor.process.pidfd.as_fd())
    }

    /// Ends the janitor at work, whose burial begins anew when the next one is looked for: nobody may map what is emptied.
    pub(super) fn set_back(&mut self) {
        if let Some(janitor) = self.janitor.take() {
            end_helper(&janitor.process);
            self.waiting.push_front(janitor.dead);
        }
    }

    /// The module ends: nobody needs what is in shared memory any more.
    pub(super) fn give_up(&mut self) {
        if let Some(janitor) = self.janitor.take() {
            end_helper(&janitor.process);
        }
    }
}

impl Janitor {
    /// It has ended of what it found in a channel, or hung there: has its follower not look into that one. As each hang takes its time,
    /// the channels behind it are left to the next janitor that comes there. False: it was at none.
    fn spare_what_it_was_at(&mut self, hung: bool) -> bool {
        let mut said = vec![0; PROGRESS_BYTES];
        let count = self.progress.read(&mut said).unwrap_or(0);
        let said = String::from_utf8_lossy(&said[..count]);
        let Some(at) = said.lines().last() else { return false };
        let Some(place) = self.burial.channels.iter().position(|channel| channel == at) else { return false };
        if hung {
            self.burial.channels.truncate(place + 1);
        }
        self.burial.damaged.push(at.to_owned());
        true
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

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;
    use std::process::{Command, Stdio};

    use rustix::process::{Pid, PidfdFlags, pidfd_open};

    use super::*;
    use crate::partition::await_any_end;

    /// A process that does what a shell is told.
    #[expect(clippy::zombie_processes, reason = "it is waited for by its descriptor, like every helper")]
    fn shell(words: &str) -> (Spawned, File) {
        let child = Command::new("sh").args(["-c", words]).stdout(Stdio::piped()).spawn().unwrap();
        let pidfd = pidfd_open(Pid::from_child(&child), PidfdFlags::empty()).unwrap();
        let pid = child.id().try_into().unwrap();
        (Spawned { pid, pidfd }, File::from(OwnedFd::from(child.stdout.unwrap())))
    }

    fn text(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// What each janitor of a burial was told to spare, where they did in turn what `janitors` says.
    fn spared(janitors: &'static [&'static str]) -> Vec<Vec<String>> {
        let told: Rc<RefCell<Vec<Vec<String>>>> = Rc::default();
        let log = told.clone();
        let fallen = Fallen::default();
        let mut burials = Burials::new(
            Box::new(move |burial| {
                let mut told = log.borrow_mut();
                told.push(burial.damaged.clone());
                Ok(shell(janitors[told.len() - 1]))
            }),
            Some((fallen.clone(), text(&["a", "b", "c"]))),
        );
        fallen.borrow_mut().push(7);
        assert_eq!(burials.next_buried(&[], |_| Vec::new()), None);
        while burials.awaits(7) {
            await_any_end(&burials.janitor().into_iter().collect::<Vec<_>>(), 1_000_000_000);
            assert_eq!(burials.next_buried(&[], |_| Vec::new()), None, "no partition was buried");
        }
        told.take()
    }

    #[test]
    fn a_janitor_that_ends_of_a_damaged_channel_is_followed_by_one_that_spares_it() {
        let twice = spared(&["echo a; kill -BUS $$", "echo b; echo c; kill -SEGV $$", "echo b"]);
        assert_eq!(twice, [text(&[]), text(&["a"]), text(&["a", "c"])]);
        let panicked = spared(&["echo b; exit 101", "exit 0"]);
        assert_eq!(panicked, [text(&[]), text(&["b"])]);
    }

    #[test]
    fn a_janitor_that_says_why_it_failed_or_ended_at_no_channel_is_not_followed() {
        assert_eq!(spared(&["echo a; echo b; exit 1"]).len(), 1, "it has looked at all of them");
        assert_eq!(spared(&["kill -SEGV $$"]).len(), 1);
    }

    #[test]
    fn a_janitor_that_can_not_be_started_is_not_tried_for_ever() {
        let fallen = Fallen::default();
        let tries = Rc::new(RefCell::new(0));
        let counted = tries.clone();
        let start: StartJanitor = Box::new(move |_| {
            *counted.borrow_mut() += 1;
            Err(std::io::ErrorKind::OutOfMemory.into())
        });
        let mut burials = Burials::new(start, Some((fallen.clone(), text(&["a"]))));
        fallen.borrow_mut().push(7);
        for _ in 0..10 {
            assert_eq!(burials.next_buried(&[], |_| Vec::new()), None);
        }
        assert_eq!(*tries.borrow(), 1);
    }

    #[test]
    fn a_burial_that_was_set_back_begins_anew() {
        let start: StartJanitor = Box::new(|_| Ok(shell("echo a; sleep 60")));
        let mut burials = Burials::new(start, None);
        burials.add_stranger(7, text(&["a"]));
        assert_eq!(burials.next_buried(&[], |_| Vec::new()), None);
        burials.set_back();
        assert!(burials.janitor().is_none() && burials.awaits(7));
        burials.give_up();
    }

    #[test]
    fn a_janitor_that_hung_is_followed_by_one_that_leaves_what_lies_behind() {
        let (process, progress) = shell("echo a; echo b");
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        let burial = Burial { pid: 7, channels: text(&["a", "b", "c", "d"]), damaged: Vec::new() };
        let dead = Dead::Stranger(7, burial.channels.clone());
        let mut janitor = Janitor { dead, burial, process, progress, since_ns: 0 };
        assert!(janitor.spare_what_it_was_at(true));
        assert_eq!((&janitor.burial.channels, &janitor.burial.damaged), (&text(&["a", "b"]), &text(&["b"])));
    }
}
