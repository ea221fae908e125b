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

use bateleur_host::helper::end_helper;
use bateleur_plan::PartitionId;
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

/// A channel probe that takes longer is ended, ns. It gives a process that does nothing 20 s at most, and the channels twice as long, all at
/// a time.
const CHANNEL_PROBE_PATIENCE_NS: u64 = 90_000_000_000;

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
pub(crate) struct Rebuilds {
    hooks: RebuildHooks,
    /// At work: for whom, and since when.
    channel_probe: Option<(Suspicion, Spawned, File, u64)>,
    waiting: VecDeque<Suspicion>,
    /// Channels that were rebuilt since the recorder was told.
    rebuilt: Vec<String>,
}

/// A partition whose successor waits for its channels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Suspicion {
    /// Its place.
    pub(crate) place: usize,
    pub(crate) id: PartitionId,
    /// Those that a channel cleaner could not clear.
    pub(crate) bad: Vec<String>,
    /// The others are to be examined: a start has failed.
    pub(crate) examine: bool,
}

impl Rebuilds {
    pub(crate) fn new(hooks: RebuildHooks) -> Self {
        Self { hooks, channel_probe: None, waiting: VecDeque::new(), rebuilt: Vec::new() }
    }

    /// Its channels are looked at before there is another successor.
    pub(crate) fn add(&mut self, suspicion: Suspicion) {
        if !self.waiting.iter().any(|waiting| waiting.place == suspicion.place) {
            self.waiting.push_back(suspicion);
        }
    }

    /// Sees that every channel is held; gives those that can not be.
    pub(crate) fn tend(&self) -> Vec<String> {
        (self.hooks.tend)()
    }

    /// Makes channels anew that nobody is attached to.
    pub(crate) fn rebuild(&mut self, channels: &[String]) -> Result<(), NotHeld> {
        self.rebuilt.extend_from_slice(channels);
        (self.hooks.rebuild)(channels)
    }

    /// Channels that were made anew since the last question.
    pub(crate) fn take_rebuilt(&mut self) -> Vec<String> {
        std::mem::take(&mut self.rebuilt)
    }

    /// The channel probe at work.
    pub(crate) fn channel_probe(&self) -> Option<BorrowedFd<'_>> {
        self.channel_probe.as_ref().map(|(_, process, ..)| process.pidfd.as_fd())
    }

    /// The partition at `place` has no successor to come: its channels need not be examined.
    pub(crate) fn forget(&mut self, place: usize) {
        self.waiting.retain(|waiting| waiting.place != place);
        if let Some((_, process, ..)) = self.channel_probe.take_if(|(examined, ..)| examined.place == place) {
            end_helper(&process);
        }
    }

    /// The module ends.
    pub(crate) fn give_up(&mut self) {
        self.waiting.clear();
        if let Some((_, process, ..)) = self.channel_probe.take() {
            end_helper(&process);
        }
    }

    /// The next partition whose channels have been examined, with the damaged ones; `None`: nobody, or it takes time.
    pub(crate) fn next_examined(&mut self) -> Option<(usize, Vec<String>)> {
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
        match (self.hooks.examine)(next.id) {
            Ok((process, answers)) => {
                self.channel_probe = Some((next, process, answers, now_ns()));
                None
            }
            // Without a channel probe the successor can only try.
            Err(_) => Some((next.place, next.bad)),
        }
    }
}
