//! The channels of a dead process: cleaned up, examined, and made anew where they are damaged.

use crate::cleanup::Cleaned;
use crate::commands::cleaned;
use crate::health::decision::Decision;
use crate::lifecycle::{Event, PairMember, Phase};
use crate::monitor::Monitor;
use crate::partition::Partition;
use bateleur_contract::Clock;
use bateleur_host::partition::shared_channels;
use bateleur_plan::{Closed, PartitionError, StartMode};
use bateleur_system::time::now_ns;

/// How long a spare that begins keeps the channel cleaner of the one before it waiting, at most, ns: peers find its queues full meanwhile.
const MOST_DELAY_NS: u64 = 100_000_000;

impl Monitor {
    pub(crate) fn look_at_channel_cleaner(&mut self) {
        self.tend_channels();
        let module_ns = self.module_ns;
        loop {
            // On the virtual clock nobody's time passes while somebody cleans up.
            let (partitions, on_wall) = (&self.partitions, self.clock == Clock::Wall);
            let starts = |place: usize| {
                let partition: &Partition = &partitions[place];
                let is_starting = on_wall && partition.life.phase() == Phase::Starting;
                is_starting && now_ns().saturating_sub(partition.active.since_ns) < MOST_DELAY_NS
            };
            let Some(Cleaned { place, member, pid, bad }) = self.cleanups.next_cleaned(starts) else { break };
            let Some(dead) = self.partitions[place].member(member) else { continue };
            // Another one may have died there meanwhile, and waits for a clean-up of its own.
            if dead.remains.take_if(|remains| *remains == pid).is_none() {
                continue;
            }
            let event = cleaned(member, !bad.is_empty());
            if member == PairMember::Active {
                self.partitions[place].damaged = bad;
            }
            self.feed(place, event, module_ns);
        }
    }

    /// Sees that every channel is held before somebody is cleaned up after: a clean-up takes away a channel that only the dead one holds.
    fn tend_channels(&mut self) {
        if self.cleanups.are_waiting() {
            let bad = self.rebuilds.tend();
            if !bad.is_empty() {
                self.rebuild(None, &bad, self.module_ns);
            }
        }
    }

    /// Looks at the examination under way, and does what follows from it.
    pub(crate) fn look_at_channel_probe(&mut self, module_ns: u64) {
        while let Some((place, damaged)) = self.rebuilds.next_examined() {
            if self.partitions[place].life.phase() != Phase::Examining {
                continue; // somebody has seen to it meanwhile
            }
            if !damaged.is_empty() {
                self.rebuild(Some(place), &damaged, module_ns);
            }
            return self.feed(place, Event::Examined, module_ns);
        }
    }

    /// Makes `damaged` anew; everybody who was attached is restarted, but the partition at `place`, who waits for them.
    fn rebuild(&mut self, place: Option<usize>, damaged: &[String], module_ns: u64) {
        self.cleanups.set_back(damaged);
        let attached: Vec<usize> =
            (0..self.partitions.len()).filter(|other| self.is_attached(*other, damaged)).collect();
        let alive = |other: &usize| self.partitions[*other].life.has_process();
        let ended: Vec<usize> = attached.iter().copied().filter(alive).collect();
        // Nobody may be left who maps the old ones.
        attached.iter().for_each(|other| self.feed(*other, Event::Detach, module_ns));
        let made = self.rebuilds.rebuild(damaged);
        let names = damaged.join(", ");
        let text = match &made {
            Ok(()) => format!("channels made anew: {names}"),
            Err(error) => format!("channels can not be made anew: {names}: {error}"),
        };
        if let Some(teller) = place.or_else(|| ended.first().copied()) {
            self.say(teller, text, module_ns);
        }
        for other in attached.into_iter().filter(|other| Some(*other) != place) {
            if ended.contains(&other) {
                self.restart_for_channels(other, &names, module_ns);
            } else if made.is_ok() {
                self.feed(other, Event::ChannelsRenewed, module_ns);
            }
        }
    }

    fn is_attached(&self, place: usize, channels: &[String]) -> bool {
        let own = shared_channels(&self.plan, self.partitions[place].active.sandbox.id);
        own.iter().any(|channel| channels.contains(channel))
    }

    /// The partition has been ended because of its channels, and is no less for it.
    fn restart_for_channels(&mut self, place: usize, names: &str, module_ns: u64) {
        let warm = self.plan[self.partitions[place].active.sandbox.id].restart.start == StartMode::Warm;
        let detail = format!("its channel was damaged and is made anew ({names})");
        let decision = Decision::Restart { warm };
        let fault =
            self.partitions[place].entry(PartitionError::PortError.name(), decision, detail, module_ns);
        self.tell_fault(place, &fault);
        self.open_fault(place, fault);
        self.partitions[place].active.skip_reports();
        self.feed(place, Event::Reattach, module_ns);
    }
}
