//! Channels that are made anew, because a partition has written over their memory.
//!
//! A successor that can not start is a sign of it, and no proof: it may fail by itself. So an examiner attaches to its
//! channels in its place. Those that can not be attached to are emptied and created again, and everybody who was
//! attached to them is restarted, which uses up nobody's budget but that of the partition that failed. Partitions without
//! such a channel are not touched.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::atomic::Ordering::Acquire;

use bateleur_contract::StartCondition;

use super::burial::Seat;
use super::processes::end_helper;
use super::standby::Standby;
use super::watched::{Life, Then};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::health::decision::Decision;
use crate::health::log::Fault;
use crate::health::record::Level;
use crate::partition::{attached_channels, ended};
use crate::plan::{Closed, PartitionError, PartitionId, StartMode};
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;

/// Starts an examiner of a partition's channels; it writes the names of the damaged ones to the file and ends.
pub type StartExaminer = Box<dyn Fn(PartitionId) -> io::Result<(Spawned, File)>>;
/// Empties channels that nobody is attached to, and creates them again.
pub type RenewChannels = Box<dyn Fn(&[String]) -> Result<(), NotHeld>>;

/// Why channels could not be made anew.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{why}")]
pub struct NotHeld {
    /// The channel that can not be held, where that is known.
    pub channel: Option<String>,
    /// Why.
    pub why: String,
}

/// An examiner that takes longer is ended, ns. It gives the channels twice 2.5 s at most, all at a time.
const EXAMINER_PATIENCE_NS: u64 = 9_000_000_000;

/// How channels are examined and renewed.
pub struct Means {
    /// See [`StartExaminer`].
    pub examine: StartExaminer,
    /// See [`RenewChannels`].
    pub renew: RenewChannels,
}

/// See the module's head.
pub(super) struct Renewals {
    means: Means,
    /// At work: for the partition at this place, and since when.
    examiner: Option<(usize, Spawned, File, u64)>,
    waiting: VecDeque<usize>,
    /// Channels that were made anew since the recorder was told.
    renewed: Vec<String>,
}

impl Renewals {
    pub(super) fn new(means: Means) -> Self {
        Self { means, examiner: None, waiting: VecDeque::new(), renewed: Vec::new() }
    }

    /// The examiner at work.
    pub(super) fn examiner(&self) -> Option<BorrowedFd<'_>> {
        self.examiner.as_ref().map(|(_, process, ..)| process.pidfd.as_fd())
    }

    /// The partition at `place` has no successor to come: its channels need not be examined.
    pub(super) fn forget(&mut self, place: usize) {
        self.waiting.retain(|waiting| *waiting != place);
        if let Some((_, process, ..)) = self.examiner.take_if(|(examined, ..)| *examined == place) {
            end_helper(&process);
        }
    }

    /// The module ends.
    pub(super) fn give_up(&mut self) {
        self.waiting.clear();
        if let Some((_, process, ..)) = self.examiner.take() {
            end_helper(&process);
        }
    }

    /// The next partition whose channels have been examined, with the damaged ones; none: nobody, or it takes time.
    fn next_examined(&mut self, id_of: impl Fn(usize) -> PartitionId) -> Option<(usize, Vec<String>)> {
        if let Some((place, process, answers, since_ns)) = self.examiner.take() {
            if ended(&process).is_none() {
                if now_ns() - since_ns < EXAMINER_PATIENCE_NS {
                    self.examiner = Some((place, process, answers, since_ns));
                    return None;
                }
                end_helper(&process);
            }
            let mut names = String::new();
            let _ = answers.take(1 << 16).read_to_string(&mut names); // what it did not say is taken as sound
            return Some((place, names.lines().map(str::to_owned).collect()));
        }
        let place = self.waiting.pop_front()?;
        match (self.means.examine)(id_of(place)) {
            Ok((process, answers)) => {
                self.examiner = Some((place, process, answers, now_ns()));
                None
            }
            // Without an examiner the successor can only try.
            Err(_) => Some((place, Vec::new())),
        }
    }
}

impl Monitor {
    /// The partition's successor has failed to start and its remains are buried: its channels are examined first.
    pub(super) fn examine(&mut self, place: usize) {
        if !self.renewals.waiting.contains(&place) {
            self.renewals.waiting.push_back(place);
        }
    }

    /// Looks at the examination under way, and does what follows from it.
    pub(super) fn look_at_examiner(&mut self, module_ns: u64) {
        let watched = &self.watched;
        while let Some((place, damaged)) = self.renewals.next_examined(|place| watched[place].cage.id) {
            if !matches!(self.watched[place].life, Life::Dead(_, Then::Successor)) {
                continue; // somebody has seen to it meanwhile
            }
            if !damaged.is_empty() {
                self.renew(place, &damaged, module_ns);
            }
            return self.start_successor(place);
        }
    }

    /// Channels that were made anew since the last question.
    pub(crate) fn take_renewed(&mut self) -> Vec<String> {
        std::mem::take(&mut self.renewals.renewed)
    }

    /// Makes `damaged` anew; everybody but the partition at `place`, who waits for them, is restarted.
    fn renew(&mut self, place: usize, damaged: &[String], module_ns: u64) {
        self.burials.set_back();
        let mut channels = damaged.to_vec();
        let mut ended = Vec::new();
        let made = loop {
            ended.extend(self.end_attached(place, &channels));
            match (self.renewals.means.renew)(&channels) {
                // It is damaged too, though nobody has met it yet.
                Err(NotHeld { channel: Some(another), .. }) if !channels.contains(&another) => {
                    channels.push(another);
                }
                made => break made,
            }
        };
        let names = channels.join(", ");
        match made {
            Ok(()) => self.tell_renewal(place, format!("channels made anew: {names}"), module_ns),
            Err(error) => {
                self.tell_renewal(place, format!("channels can not be made anew: {error}"), module_ns)
            }
        }
        for other in (0..self.watched.len()).filter(|other| *other != place) {
            let gave_up = matches!(self.watched[other].life, Life::Gone | Life::Dead(_, Then::Rest))
                && self.watched[other].start_failed;
            if ended.contains(&other) {
                self.restart_for_channels(other, &names, module_ns);
            } else if gave_up && self.is_attached(other, &channels) {
                // It could not start because of them.
                self.watched[other].restarts.clear();
                self.bury(other, Then::Successor, module_ns);
            }
        }
        self.renewals.renewed.extend(channels);
    }

    /// Ends all processes that are attached to `channels`, for nobody may be left who maps what is emptied; gives the
    /// partitions that were alive. That at `place` has none.
    fn end_attached(&mut self, place: usize, channels: &[String]) -> Vec<usize> {
        let attached: Vec<usize> =
            (0..self.watched.len()).filter(|other| self.is_attached(*other, channels)).collect();
        let alive = |other: &usize| *other != place && self.watched[*other].is_alive();
        let alive: Vec<usize> = attached.iter().copied().filter(alive).collect();
        alive.iter().for_each(|other| self.watched[*other].put_an_end());
        for other in attached {
            // It is started again behind its partition's successor.
            if self.watched[other].standby.as_mut().is_some_and(Standby::put_an_end) {
                self.burials.add(other, Seat::Behind);
            }
        }
        alive
    }

    fn is_attached(&self, place: usize, channels: &[String]) -> bool {
        let own = attached_channels(&self.plan, self.watched[place].cage.id);
        own.iter().any(|channel| channels.contains(channel))
    }

    /// The partition has been ended because of its channels, and is no less for it.
    fn restart_for_channels(&mut self, place: usize, names: &str, module_ns: u64) {
        let watched = &mut self.watched[place];
        let warm = self.plan[watched.cage.id].restart.start == StartMode::Warm;
        watched.next_start = match warm {
            true => StartCondition::HmPartitionWarmRestart,
            false => StartCondition::HmPartitionColdRestart,
        };
        let fault = Fault {
            time_ns: module_ns,
            level: Level::Partition,
            partition: Some(watched.cage.name.clone()),
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
        watched.reports_seen = watched.cage.slot.page.report_count.load(Acquire);
        self.bury(place, Then::Successor, module_ns);
    }

    fn tell_renewal(&mut self, place: usize, text: String, module_ns: u64) {
        let partition = self.watched[place].cage.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
    }
}
