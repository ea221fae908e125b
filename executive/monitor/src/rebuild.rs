//! Channels that are rebuilt, because a partition has written over their memory.
//!
//! A successor that can not start is a sign of it, and no proof: it may fail by itself. So a channel probe attaches to its
//! channels in its place. Those that can not be attached to, or that a channel cleaner or a channel holder could not serve, get new directories
//! and are created again, and everybody who was attached to them is restarted, which uses up nobody's budget but that of the
//! partition that failed, and gives nobody any back. Partitions without such a channel are not touched.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};

use bateleur_contract::StartCondition;

use super::cleanup::PairMember;
use super::standby::Standby;
use super::watched::{Life, Then};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::health::decision::Decision;
use crate::health::log::Fault;
use crate::health::record::Level;
use bateleur_host::helper::end_helper;
use bateleur_host::partition::attached_channels;
use bateleur_plan::{Closed, PartitionError, PartitionId, StartMode};
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::is_readable;

/// Starts a channel probe of a partition's channels; it writes the names of the damaged ones to the file and ends.
pub type StartChannelProbe = Box<dyn Fn(PartitionId) -> io::Result<(Spawned, File)>>;
/// Makes channels anew that nobody is attached to.
pub type RebuildChannels = Box<dyn Fn(&[String]) -> Result<(), NotHeld>>;
/// Sees that every channel is held; gives those that can not be.
pub type TendChannels = Box<dyn Fn() -> Vec<String>>;

/// Why channels could not be rebuilt.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotHeld(pub String);

/// A channel probe that takes longer is ended, ns. It gives the channels twice 2.5 s at most, all at a time.
const CHANNEL_PROBE_PATIENCE_NS: u64 = 9_000_000_000;

/// How channels are examined and renewed.
pub struct RebuildHooks {
    /// See [`StartChannelProbe`].
    pub examine: StartChannelProbe,
    /// See [`RebuildChannels`].
    pub rebuild: RebuildChannels,
    /// See [`TendChannels`].
    pub tend: TendChannels,
}

/// See the module's head.
pub(super) struct Rebuilds {
    means: RebuildHooks,
    /// At work: for whom, and since when.
    channel_probe: Option<(Suspicion, Spawned, File, u64)>,
    waiting: VecDeque<Suspicion>,
    /// Channels that were rebuilt since the recorder was told.
    rebuilt: Vec<String>,
}

/// A partition whose successor waits for its channels.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Suspicion {
    place: usize,
    /// Those that a channel cleaner could not clear.
    bad: Vec<String>,
    /// The others are to be examined: a start has failed.
    examine: bool,
}

impl Rebuilds {
    pub(super) fn new(means: RebuildHooks) -> Self {
        Self { means, channel_probe: None, waiting: VecDeque::new(), rebuilt: Vec::new() }
    }

    /// The channel probe at work.
    pub(super) fn channel_probe(&self) -> Option<BorrowedFd<'_>> {
        self.channel_probe.as_ref().map(|(_, process, ..)| process.pidfd.as_fd())
    }

    /// The partition at `place` has no successor to come: its channels need not be examined.
    pub(super) fn forget(&mut self, place: usize) {
        self.waiting.retain(|waiting| waiting.place != place);
        if let Some((_, process, ..)) = self.channel_probe.take_if(|(examined, ..)| examined.place == place) {
            end_helper(&process);
        }
    }

    /// The module ends.
    pub(super) fn give_up(&mut self) {
        self.waiting.clear();
        if let Some((_, process, ..)) = self.channel_probe.take() {
            end_helper(&process);
        }
    }

    /// The next partition whose channels have been examined, with the damaged ones; `None`: nobody, or it takes time.
    fn next_examined(&mut self, id_of: impl Fn(usize) -> PartitionId) -> Option<(usize, Vec<String>)> {
        if let Some((mut found, process, answers, since_ns)) = self.channel_probe.take() {
            let has_ended = is_readable(process.pidfd.as_fd());
            if !has_ended && now_ns() - since_ns < CHANNEL_PROBE_PATIENCE_NS {
                self.channel_probe = Some((found, process, answers, since_ns));
                return None;
            }
            end_helper(&process); // with what it has started
            let mut names = String::new();
            let _ = answers.take(1 << 16).read_to_string(&mut names); // what it did not say is taken as sound
            found.bad.extend(names.lines().map(str::to_owned));
            found.bad.sort_unstable();
            found.bad.dedup();
            return Some((found.place, found.bad));
        }
        let next = self.waiting.pop_front()?;
        if !next.examine {
            return Some((next.place, next.bad));
        }
        match (self.means.examine)(id_of(next.place)) {
            Ok((process, answers)) => {
                self.channel_probe = Some((next, process, answers, now_ns()));
                None
            }
            // Without a channel probe the successor can only try.
            Err(_) => Some((next.place, next.bad)),
        }
    }
}

impl Monitor {
    /// The partition's remains are cleaned up after, but for what is in its `bad` channels, or its last successor has failed to start: before
    /// there is another one, its channels are looked at.
    pub(super) fn examine(&mut self, place: usize, bad: Vec<String>) {
        if !self.rebuilds.waiting.iter().any(|waiting| waiting.place == place) {
            let examine = self.watched[place].start_failed;
            self.rebuilds.waiting.push_back(Suspicion { place, bad, examine });
        }
    }

    /// Looks at the examination under way, and does what follows from it.
    pub(super) fn look_at_channel_probe(&mut self, module_ns: u64) {
        let watched = &self.watched;
        while let Some((place, damaged)) = self.rebuilds.next_examined(|place| watched[place].sandbox.id) {
            if !matches!(self.watched[place].life, Life::Dead(_, Then::Successor)) {
                continue; // somebody has seen to it meanwhile
            }
            if !damaged.is_empty() {
                self.rebuild(Some(place), &damaged, module_ns);
            }
            return self.start_successor(place);
        }
    }

    /// Sees that every channel is held before somebody is cleaned up after: a clean-up takes away a channel that only the dead one holds.
    pub(super) fn tend_channels(&mut self) {
        if self.cleanups.are_waiting() {
            let bad = (self.rebuilds.means.tend)();
            if !bad.is_empty() {
                self.rebuild(None, &bad, self.module_ns);
            }
        }
    }

    /// Channels that were rebuilt since the last question.
    #[must_use]
    pub fn take_rebuilt(&mut self) -> Vec<String> {
        std::mem::take(&mut self.rebuilds.rebuilt)
    }

    /// Makes `damaged` anew; everybody who was attached is restarted, but the partition at `place`, who waits for them.
    fn rebuild(&mut self, place: Option<usize>, damaged: &[String], module_ns: u64) {
        self.cleanups.set_back(damaged);
        let ended = self.end_attached(place, damaged);
        let made = (self.rebuilds.means.rebuild)(damaged);
        let names = damaged.join(", ");
        let text = match &made {
            Ok(()) => format!("channels made anew: {names}"),
            Err(error) => format!("channels can not be made anew: {names}: {error}"),
        };
        if let Some(teller) = place.or_else(|| ended.first().copied()) {
            self.tell_rebuild(teller, text, module_ns);
        }
        for other in (0..self.watched.len()).filter(|other| Some(*other) != place) {
            let gave_up = matches!(self.watched[other].life, Life::Gone | Life::Dead(_, Then::Rest))
                && self.watched[other].start_failed;
            if ended.contains(&other) {
                self.restart_for_channels(other, &names, module_ns);
            } else if made.is_ok() && gave_up && self.is_attached(other, damaged) {
                // It could not start because of them: one more start. Its budget is what it is, or two that damage what they share would
                // bring each other back for ever.
                self.clean_up(other, Then::Successor, module_ns);
            }
        }
        self.rebuilds.rebuilt.extend_from_slice(damaged);
    }

    /// Ends all processes that are attached to `channels`, for nobody may be left who maps the old ones; gives the
    /// partitions that were alive. That at `place` has none.
    fn end_attached(&mut self, place: Option<usize>, channels: &[String]) -> Vec<usize> {
        let attached: Vec<usize> =
            (0..self.watched.len()).filter(|other| self.is_attached(*other, channels)).collect();
        let alive = |other: &usize| Some(*other) != place && self.watched[*other].is_alive();
        let alive: Vec<usize> = attached.iter().copied().filter(alive).collect();
        alive.iter().for_each(|other| self.watched[*other].put_an_end());
        for other in attached {
            // It is started again behind its partition's successor.
            if self.watched[other].standby.as_mut().is_some_and(Standby::put_an_end) {
                self.cleanups.add(other, PairMember::Standby);
            }
        }
        alive
    }

    fn is_attached(&self, place: usize, channels: &[String]) -> bool {
        let own = attached_channels(&self.plan, self.watched[place].sandbox.id);
        own.iter().any(|channel| channels.contains(channel))
    }

    /// The partition has been ended because of its channels, and is no less for it.
    fn restart_for_channels(&mut self, place: usize, names: &str, module_ns: u64) {
        let watched = &mut self.watched[place];
        let warm = self.plan[watched.sandbox.id].restart.start == StartMode::Warm;
        watched.next_start = match warm {
            true => StartCondition::HmPartitionWarmRestart,
            false => StartCondition::HmPartitionColdRestart,
        };
        let fault = Fault {
            time_ns: module_ns,
            level: Level::Partition,
            partition: Some(watched.sandbox.name.clone()),
            generation: watched.generation,
            error: PartitionError::PortError.name().into(),
            action: Decision::Restart { warm }.name().into(),
            detail: format!("its channel was damaged and is made anew ({names})"),
            recovered_ns: None,
        };
        self.tell_fault(place, &fault);
        let watched = &mut self.watched[place];
        if let Some(before) = watched.fault.replace(fault) {
            self.health_log.write(&before);
        }
        watched.reports_seen = watched.sandbox.control.page.reports_so_far();
        self.clean_up(place, Then::Successor, module_ns);
    }

    fn tell_rebuild(&mut self, place: usize, text: String, module_ns: u64) {
        let partition = self.watched[place].sandbox.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
    }
}
