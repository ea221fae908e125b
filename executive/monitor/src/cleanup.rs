//! The dead of a module: channel cleaners remove what processes left in shared memory, one at a time in each channel.
//!
//! Every dead process is cleaned up after, also one that has no successor: its queues would stay full for its peers, and its
//! places in the channels would stay taken. A channel cleaner that ends of what it finds in a channel is followed by one that
//! does not look into that. It must never hold up a successor for long: one that hangs is given some seconds of its own, and those who share
//! no channel with its dead one do not wait for it.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;

use crate::lifecycle::PairMember;
use bateleur_host::helper::end_helper;
use bateleur_host::helper::orders::BAD;
use bateleur_system::cpu_starvation;
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{ended, is_victim};

/// A channel cleaner that has used more time than this is ended: the library's clean-up can hang. One that works takes some
/// milliseconds; a slow or emulated machine is known by what its start took, of which this is a multiple.
const LEAST_PATIENCE_NS: u64 = 3_000_000_000;
const MOST_PATIENCE_NS: u64 = 20_000_000_000;
const STARTS: u64 = 100;

/// What a pipe holds (pipe(7)): more channels than a module has.
const PROGRESS_BYTES: usize = 1 << 16;

/// Channel cleaners at work, most.
const CHANNEL_CLEANERS: usize = 4;

/// Starts a channel cleaner for a dead process that was attached to channels, some of which are damaged. It writes the name of each
/// into the file before it looks at its memory.
pub type StartChannelCleaner = Box<dyn Fn(&CleanupOrder) -> io::Result<(Spawned, File)>>;

/// See the module's head.
pub(crate) struct Cleanups {
    start_channel_cleaner: StartChannelCleaner,
    channel_cleaners: Vec<ChannelCleaner>,
    waiting: VecDeque<Dead>,
    /// They are cleaned up after when nobody else waits.
    ended_helpers: Option<(EndedHelpers, Vec<String>)>,
}

/// Numbers of helpers that have ended, each of which was attached to all channels of the module.
pub type EndedHelpers = Rc<RefCell<Vec<i32>>>;

/// What a channel cleaner is told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CleanupOrder {
    /// The dead process.
    pub pid: i32,
    /// Its user, where nobody else has it and no process of it lives: everything of it goes.
    pub user: Option<u32>,
    /// The channels that it was attached to.
    pub channels: Vec<String>,
    /// Those among them whose memory must not be looked at.
    pub damaged: Vec<String>,
}

/// A channel cleaner at work.
#[derive(Debug)]
struct ChannelCleaner {
    dead: Dead,
    order: CleanupOrder,
    process: Spawned,
    /// Where it says at which channel it is, and which it could not clear.
    progress: File,
    /// CLOCK_MONOTONIC, ns.
    since_ns: u64,
    /// What it may use, ns.
    patience_ns: u64,
    /// Those that it, or one before it, could not clear.
    bad: Vec<String>,
}

/// A dead process that is cleaned up after.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Dead {
    /// The partition's place and which of its processes it was; `None`: it was none of a partition.
    of: Option<(usize, PairMember)>,
    order: CleanupOrder,
}

impl Dead {
    fn cleaned(self, bad: Vec<String>) -> Option<Cleaned> {
        let (place, member) = self.of?;
        Some(Cleaned { place, member, pid: self.order.pid, bad })
    }

    fn helper(pid: i32, channels: Vec<String>) -> Self {
        Self { of: None, order: CleanupOrder { pid, user: None, channels, damaged: Vec::new() } }
    }
}

/// A partition's dead process that has been cleaned up after.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Cleaned {
    /// The partition's place.
    pub(crate) place: usize,
    /// Which of its processes it was.
    pub(crate) member: PairMember,
    /// Its number.
    pub(crate) pid: i32,
    /// Channels that could not be cleared.
    pub(crate) bad: Vec<String>,
}

impl Cleanups {
    pub(crate) fn new(
        start_channel_cleaner: StartChannelCleaner,
        ended_helpers: Option<(EndedHelpers, Vec<String>)>,
    ) -> Self {
        Self { start_channel_cleaner, channel_cleaners: Vec::new(), waiting: VecDeque::new(), ended_helpers }
    }

    /// The process that the partition at `place` had there waits for its cleanup.
    pub(crate) fn add(&mut self, place: usize, member: PairMember, order: CleanupOrder) {
        let dead = Dead { of: Some((place, member)), order };
        let under_way = self.channel_cleaners.iter().any(|channel_cleaner| channel_cleaner.dead == dead);
        if !under_way && !self.waiting.contains(&dead) {
            self.waiting.push_back(dead);
        }
    }

    /// A process that is no partition was attached to `channels` when it ended.
    pub(crate) fn add_helper(&mut self, pid: i32, channels: Vec<String>) {
        self.waiting.push_back(Dead::helper(pid, channels));
    }

    /// Whether that process waits for its cleanup.
    pub(crate) fn awaits(&self, pid: i32) -> bool {
        let is_it = |dead: &Dead| dead.of.is_none() && dead.order.pid == pid;
        self.channel_cleaners.iter().any(|channel_cleaner| is_it(&channel_cleaner.dead))
            || self.waiting.iter().any(is_it)
    }

    /// Whether somebody waits for a channel cleaner.
    pub(crate) fn are_waiting(&self) -> bool {
        !self.waiting.is_empty()
            || self
                .ended_helpers
                .as_ref()
                .is_some_and(|(ended_helpers, _)| !ended_helpers.borrow().is_empty())
    }

    /// The next process of a partition that has been cleaned up after; `None` if channel cleaners are at work, or nobody waits. Where the
    /// partition at a place `starts`, what was its standby waits: a channel cleaner would share the processor with the successor.
    pub(crate) fn next_cleaned(&mut self, starts: impl Fn(usize) -> bool) -> Option<Cleaned> {
        let mut place = 0;
        while place < self.channel_cleaners.len() {
            let status = ended(&self.channel_cleaners[place].process);
            let channel_cleaner = &self.channel_cleaners[place];
            let hangs = status.is_none() && channel_cleaner.hangs();
            if status.is_none() && !hangs {
                place += 1;
                continue;
            }
            let mut channel_cleaner = self.channel_cleaners.swap_remove(place);
            if hangs {
                end_helper(&channel_cleaner.process);
            }
            let at = channel_cleaner.listen();
            let victim = hangs || is_victim(status);
            if victim && channel_cleaner.spare(at, hangs) {
                let bad = channel_cleaner.bad.clone();
                if self.start(channel_cleaner.dead.clone(), channel_cleaner.order, bad) {
                    continue;
                }
            }
            if let Some(cleaned) = channel_cleaner.dead.cleaned(channel_cleaner.bad) {
                return Some(cleaned);
            }
        }
        self.start_next(starts)
    }

    /// Starts channel cleaners for those who wait; gives one who can have none.
    fn start_next(&mut self, starts: impl Fn(usize) -> bool) -> Option<Cleaned> {
        let mut place = 0;
        while self.channel_cleaners.len() < CHANNEL_CLEANERS {
            let Some(dead) = self.waiting.get(place).cloned().or_else(|| self.ended_helper()) else { break };
            let at_work = |channel: &String| {
                self.channel_cleaners
                    .iter()
                    .any(|channel_cleaner| channel_cleaner.order.channels.contains(channel))
            };
            let waits = matches!(dead.of, Some((of, PairMember::Standby)) if starts(of));
            if waits || dead.order.channels.iter().any(at_work) {
                if place >= self.waiting.len() {
                    self.waiting.push_back(dead); // a helper
                    break;
                }
                place += 1;
                continue;
            }
            self.waiting.remove(place); // out of bounds: a helper
            // Without a channel cleaner a successor may still find its ports free: trying costs nothing. What is left of a stranger costs an
            // observer's place in its channels, and nothing else.
            let order = dead.order.clone();
            let has_left = !order.channels.is_empty();
            if !(has_left && self.start(dead.clone(), order, Vec::new()))
                && let Some(cleaned) = dead.cleaned(Vec::new())
            {
                return Some(cleaned);
            }
        }
        None
    }

    fn ended_helper(&self) -> Option<Dead> {
        let (ended_helpers, channels) = self.ended_helpers.as_ref()?;
        ended_helpers.borrow_mut().pop().map(|pid| Dead::helper(pid, channels.clone()))
    }

    /// Whether a channel cleaner is at work now.
    fn start(&mut self, dead: Dead, order: CleanupOrder, bad: Vec<String>) -> bool {
        let begun_ns = now_ns();
        let Ok((process, progress)) = (self.start_channel_cleaner)(&order) else { return false };
        let since_ns = now_ns();
        let patience_ns = (since_ns - begun_ns) * STARTS;
        self.channel_cleaners.push(ChannelCleaner {
            dead,
            order,
            process,
            progress,
            since_ns,
            patience_ns: patience_ns.clamp(LEAST_PATIENCE_NS, MOST_PATIENCE_NS),
            bad,
        });
        true
    }

    /// The channel cleaners at work.
    pub(crate) fn channel_cleaners(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.channel_cleaners.iter().map(|channel_cleaner| channel_cleaner.process.pidfd.as_fd())
    }

    /// Ends channel cleaners at work in `channels`, whose cleanups begin anew when the next ones are looked for: nobody may map what is put aside.
    pub(crate) fn set_back(&mut self, channels: &[String]) {
        let is_there = |channel_cleaner: &mut ChannelCleaner| {
            channel_cleaner.order.channels.iter().any(|channel| channels.contains(channel))
        };
        for channel_cleaner in self.channel_cleaners.extract_if(.., is_there) {
            end_helper(&channel_cleaner.process);
            self.waiting.push_front(channel_cleaner.dead);
        }
    }

    /// The module ends: nobody needs what is in shared memory any more.
    pub(crate) fn give_up(&mut self) {
        self.channel_cleaners.drain(..).for_each(|channel_cleaner| end_helper(&channel_cleaner.process));
    }
}

impl ChannelCleaner {
    /// Whether it will not come to an end. Ended before its work is done, it leaves its successor's places in the channels taken.
    fn hangs(&self) -> bool {
        let elapsed_ns = now_ns() - self.since_ns;
        let most_ns = cpu_starvation::STARVED_PATIENCE_NS;
        cpu_starvation::has_had(self.process.pid, elapsed_ns, self.patience_ns, most_ns)
    }

    /// Takes down what it has said: the channels that it could not clear; and gives the one at which it was last.
    fn listen(&mut self) -> Option<String> {
        let mut said = vec![0; PROGRESS_BYTES];
        let count = self.progress.read(&mut said).unwrap_or(0);
        let said = String::from_utf8_lossy(&said[..count]);
        let refused = |line: &'_ str| line.strip_prefix(BAD)?.strip_prefix(' ').map(str::to_owned);
        let known = |channel: &String| self.order.channels.contains(channel);
        let bad: Vec<String> = said.lines().filter_map(refused).filter(known).collect();
        self.bad.extend(bad);
        said.lines().rfind(|line| refused(line).is_none()).map(str::to_owned)
    }

    /// It has ended of what it found in the channel that it was `at`, or hung there: has its follower not look into that one. As each
    /// hang takes its time, the channels behind it are left to the next channel cleaner that comes there. False: it was at none.
    fn spare(&mut self, at: Option<String>, hung: bool) -> bool {
        let place = self.order.channels.iter().position(|channel| Some(channel) == at.as_ref());
        let (Some(at), Some(place)) = (at, place) else { return false };
        if hung {
            self.order.channels.truncate(place + 1);
        }
        self.order.damaged.push(at);
        true
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::os::fd::OwnedFd;
    use std::process::{Command, Stdio};

    use rustix::process::{Pid, PidfdFlags, pidfd_open};

    use super::*;
    use bateleur_system::wait::await_any_end;

    /// A process that does what a shell is told.
    #[expect(clippy::zombie_processes, reason = "it is waited for by its descriptor, like every helper")]
    pub(crate) fn shell(words: &str) -> (Spawned, File) {
        let child = Command::new("sh").args(["-c", words]).stdout(Stdio::piped()).spawn().unwrap();
        let pidfd = pidfd_open(Pid::from_child(&child), PidfdFlags::empty()).unwrap();
        let pid = child.id().try_into().unwrap();
        (Spawned { pid, pidfd }, File::from(OwnedFd::from(child.stdout.unwrap())))
    }

    fn text(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// What each channel cleaner of a cleanup was told to spare, where they did in turn what `channel_cleaners` says.
    fn spared(channel_cleaners: &'static [&'static str]) -> Vec<Vec<String>> {
        let told: Rc<RefCell<Vec<Vec<String>>>> = Rc::default();
        let log = told.clone();
        let ended_helpers = EndedHelpers::default();
        let mut cleanups = Cleanups::new(
            Box::new(move |order| {
                let mut told = log.borrow_mut();
                told.push(order.damaged.clone());
                Ok(shell(channel_cleaners[told.len() - 1]))
            }),
            Some((ended_helpers.clone(), text(&["a", "b", "c"]))),
        );
        ended_helpers.borrow_mut().push(7);
        assert_eq!(cleanups.next_cleaned(|_| false), None);
        while cleanups.awaits(7) {
            await_any_end(&cleanups.channel_cleaners().collect::<Vec<_>>(), 1_000_000_000);
            assert_eq!(cleanups.next_cleaned(|_| false), None, "no partition was buried");
        }
        told.take()
    }

    #[test]
    fn a_channel_cleaner_that_ends_of_a_damaged_channel_is_followed_by_one_that_spares_it() {
        let twice = spared(&["echo a; kill -BUS $$", "echo b; echo c; kill -SEGV $$", "echo b"]);
        assert_eq!(twice, [text(&[]), text(&["a"]), text(&["a", "c"])]);
        let panicked = spared(&["echo b; exit 101", "exit 0"]);
        assert_eq!(panicked, [text(&[]), text(&["b"])]);
    }

    #[test]
    fn a_channel_cleaner_that_says_why_it_failed_or_ended_at_no_channel_is_not_followed() {
        assert_eq!(spared(&["echo a; echo b; exit 1"]).len(), 1, "it has looked at all of them");
        assert_eq!(spared(&["kill -SEGV $$"]).len(), 1);
    }

    #[test]
    fn a_channel_cleaner_that_can_not_be_started_is_not_tried_for_ever() {
        let ended_helpers = EndedHelpers::default();
        let tries = Rc::new(RefCell::new(0));
        let counted = tries.clone();
        let start: StartChannelCleaner = Box::new(move |_| {
            *counted.borrow_mut() += 1;
            Err(std::io::ErrorKind::OutOfMemory.into())
        });
        let mut cleanups = Cleanups::new(start, Some((ended_helpers.clone(), text(&["a"]))));
        ended_helpers.borrow_mut().push(7);
        for _ in 0..10 {
            assert_eq!(cleanups.next_cleaned(|_| false), None);
        }
        assert_eq!(*tries.borrow(), 1);
    }

    #[test]
    fn every_dead_process_of_a_place_is_cleaned_up_after_once_however_often_it_is_added() {
        let pids: Rc<RefCell<Vec<i32>>> = Rc::default();
        let log = pids.clone();
        let start: StartChannelCleaner = Box::new(move |order| {
            log.borrow_mut().push(order.pid);
            Ok(shell("exit 0"))
        });
        let mut cleanups = Cleanups::new(start, None);
        let order = |pid| CleanupOrder { pid, user: None, channels: text(&["a"]), damaged: Vec::new() };
        for pid in [7, 7] {
            cleanups.add(0, PairMember::Active, order(pid));
        }
        assert_eq!(cleanups.next_cleaned(|_| false), None, "it is under way");
        // Its successor is dead before the cleaner has come to its end.
        for pid in [7, 8] {
            cleanups.add(0, PairMember::Active, order(pid));
        }
        let mut cleaned = Vec::new();
        while cleaned.len() < 2 {
            await_any_end(&cleanups.channel_cleaners().collect::<Vec<_>>(), 1_000_000_000);
            cleaned.extend(cleanups.next_cleaned(|_| false).map(|cleaned| cleaned.pid));
        }
        assert_eq!((cleaned, pids.take()), (vec![7, 8], vec![7, 8]));
    }

    #[test]
    fn a_successor_that_starts_keeps_the_processor_until_it_is_ready() {
        let mut cleanups = Cleanups::new(Box::new(|_| Ok(shell("exit 0"))), None);
        let order = |pid| CleanupOrder { pid, user: None, channels: text(&["a"]), damaged: Vec::new() };
        cleanups.add(3, PairMember::Standby, order(7));
        let at_work = |cleanups: &Cleanups| cleanups.channel_cleaners().count();
        assert_eq!((cleanups.next_cleaned(|place| place == 3), at_work(&cleanups)), (None, 0));
        // Who has no successor yet waits for none, and nobody waits for another partition's.
        cleanups.add(4, PairMember::Active, order(8));
        assert_eq!((cleanups.next_cleaned(|_| true), at_work(&cleanups)), (None, 1));
        let mut cleaned = Vec::new();
        while cleaned.len() < 2 {
            await_any_end(&cleanups.channel_cleaners().collect::<Vec<_>>(), 1_000_000_000);
            cleaned.extend(cleanups.next_cleaned(|place| place == 4).map(|cleaned| cleaned.pid));
        }
        assert_eq!(cleaned, [8, 7]);
    }

    #[test]
    fn a_cleanup_that_was_set_back_begins_anew() {
        let start: StartChannelCleaner = Box::new(|_| Ok(shell("echo a; sleep 60")));
        let mut cleanups = Cleanups::new(start, None);
        cleanups.add_helper(7, text(&["a"]));
        assert_eq!(cleanups.next_cleaned(|_| false), None);
        cleanups.set_back(&text(&["b"]));
        assert_eq!(cleanups.channel_cleaners().count(), 1, "it is at work elsewhere");
        cleanups.set_back(&text(&["a"]));
        assert!(cleanups.channel_cleaners().next().is_none() && cleanups.awaits(7));
        cleanups.give_up();
    }

    #[test]
    fn a_channel_cleaner_that_hung_is_followed_by_one_that_leaves_what_lies_behind() {
        let (process, progress) = shell("echo a; echo b");
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        let channels = text(&["a", "b", "c", "d"]);
        let order = CleanupOrder { pid: 7, user: None, channels, damaged: Vec::new() };
        let dead = Dead::helper(7, order.channels.clone());
        let mut channel_cleaner =
            ChannelCleaner { dead, order, process, progress, since_ns: 0, patience_ns: 0, bad: Vec::new() };
        let at = channel_cleaner.listen();
        assert!(channel_cleaner.spare(at, true));
        assert_eq!(
            (&channel_cleaner.order.channels, &channel_cleaner.order.damaged),
            (&text(&["a", "b"]), &text(&["b"]))
        );
    }

    #[test]
    fn a_channel_that_a_channel_cleaner_could_not_clear_is_told_with_those_of_the_channel_cleaners_before_it()
    {
        let (process, progress) = shell("echo a; echo bad a; echo b; echo bad unknown; echo c");
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        let order =
            CleanupOrder { pid: 7, user: None, channels: text(&["a", "b", "c"]), damaged: Vec::new() };
        let dead = Dead { of: Some((0, PairMember::Active)), order: order.clone() };
        let mut channel_cleaner =
            ChannelCleaner { dead, order, process, progress, since_ns: 0, patience_ns: 0, bad: text(&["b"]) };
        assert_eq!(channel_cleaner.listen().as_deref(), Some("c"));
        assert_eq!(channel_cleaner.bad, text(&["b", "a"]));
    }

    #[test]
    fn nobody_waits_for_a_channel_cleaner_that_is_at_work_in_channels_of_others() {
        let start: StartChannelCleaner =
            Box::new(|order| Ok(shell(if order.pid == 7 { "echo a; sleep 60" } else { "exit 0" })));
        let mut cleanups = Cleanups::new(start, None);
        cleanups.add_helper(7, text(&["a", "b"]));
        cleanups.add_helper(8, text(&["b", "c"]));
        cleanups.add_helper(9, text(&["c", "d"]));
        let begun_ns = now_ns();
        while cleanups.awaits(9) && now_ns() - begun_ns < 10_000_000_000 {
            assert_eq!(cleanups.next_cleaned(|_| false), None);
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert_eq!([7, 8, 9].map(|pid| cleanups.awaits(pid)), [true, true, false]);
        cleanups.give_up();
    }
}
