//! Observers that operators have asked for: processes that read channels and send what they carry to a client. The
//! executive maps none of it; an observer that ends, for whatever reason, is cleaned up after like a partition.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use super::Monitor;
use bateleur_control::{Answer, ChannelStatus, LinkName, Ordered};
use bateleur_host::partition::{message_name, queue_depth};
use bateleur_plan::{ChannelId, nearest};
use bateleur_system::spawn::Spawned;
use bateleur_system::wait::{ended, is_readable};

/// At a time. A channel admits four observers: one is the recorder, one is left for tools of other kinds.
const MOST: usize = 2;

/// Starts an observer of the named channels that writes into the descriptor.
pub type StartObserver = Box<dyn Fn(&[String], &OwnedFd) -> io::Result<Spawned>>;

/// Those at work, each with its channels.
#[derive(Default)]
pub(super) struct Observers {
    start: Option<StartObserver>,
    working: Vec<(Spawned, Vec<String>)>,
}

impl Observers {
    pub(super) fn new(start: Option<StartObserver>) -> Self {
        Self { start, working: Vec::new() }
    }

    pub(super) fn processes(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.working.iter().map(|(process, _)| process.pidfd.as_fd())
    }

    /// The next one that has ended: its process, and the channels that it was attached to.
    fn next_ended(&mut self) -> Option<(i32, Vec<String>)> {
        let place = self.working.iter().position(|(process, _)| is_readable(process.pidfd.as_fd()))?;
        let (process, channels) = self.working.swap_remove(place);
        let _ = ended(&process); // reaps it
        Some((process.pid, channels))
    }
}

impl Monitor {
    pub(super) fn look_at_observers(&mut self) {
        while let Some((pid, channels)) = self.operator.observers.next_ended() {
            self.cleanups.add_helper(pid, channels);
        }
    }

    /// Hands the client over to an observer of `ports`; of all channels where there are none.
    pub(super) fn watch(
        &self,
        ordered: &Ordered,
        ports: &[String],
    ) -> Result<(Answer, (Spawned, Vec<String>)), String> {
        let observers = &self.operator.observers;
        let start = observers.start.as_ref().ok_or("this module has no observers")?;
        if observers.working.len() >= MOST {
            return Err(format!("{MOST} observers are at work already: end one of them first"));
        }
        let connection = ordered.connection.as_ref().ok_or("the connection could not be handed over")?;
        let mut channels: Vec<String> = match ports {
            [] => self.channels().map(|id| self.plan.port_path(self.plan[id].source)).collect(),
            some => some.iter().map(|port| self.channel_of(port)).collect::<Result<_, _>>()?,
        };
        channels.sort_unstable();
        channels.dedup();
        let process =
            start(&channels, connection).map_err(|error| format!("cannot start an observer: {error}"))?;
        Ok((Answer::Watching, (process, channels)))
    }

    pub(super) fn take_on(&mut self, observer: (Spawned, Vec<String>)) {
        self.operator.observers.working.push(observer);
    }

    pub(super) fn link_names(&self) -> Vec<LinkName> {
        let module = self.plan.module(&self.operator.about.module);
        module.map(|view| LinkName::of(&view)).unwrap_or_default()
    }

    pub(super) fn channel_list(&self) -> Vec<ChannelStatus> {
        let channels = self.channels().map(|id| {
            let channel = &self.plan[id];
            let source = &self.plan[channel.source];
            ChannelStatus {
                source: self.plan.port_path(channel.source),
                destinations: channel.destinations.iter().map(|port| self.plan.port_path(*port)).collect(),
                queue_depth: queue_depth(&self.plan, channel),
                message: message_name(source),
                size: source.payload.max_size_bytes(),
                definition: self.plan.messages.get(&message_name(source)).cloned().unwrap_or_default(),
            }
        });
        channels.collect()
    }

    fn channels(&self) -> impl Iterator<Item = ChannelId> + '_ {
        self.plan
            .module(&self.operator.about.module)
            .into_iter()
            .flat_map(|view| view.channels().collect::<Vec<_>>())
    }

    /// The source of the channel that `port` is attached to.
    fn channel_of(&self, port: &str) -> Result<String, String> {
        let attached = |id: &ChannelId| {
            let channel = &self.plan[*id];
            let mut ports = channel.destinations.iter().chain([&channel.source]);
            ports.any(|known| self.plan.port_path(*known) == port)
        };
        if let Some(id) = self.channels().find(attached) {
            return Ok(self.plan.port_path(self.plan[id].source));
        }
        let all: Vec<String> = self
            .channels()
            .flat_map(|id| {
                let channel = &self.plan[id];
                channel.destinations.iter().chain([&channel.source]).copied().collect::<Vec<_>>()
            })
            .map(|port| self.plan.port_path(port))
            .collect();
        let hint = match nearest(port, all.iter().map(String::as_str)) {
            Some(near) => format!("did you mean `{near}`?"),
            None => "see `bateleur ports list`".to_owned(),
        };
        Err(format!("no channel of the module has a port \"{port}\": {hint}"))
    }
}
