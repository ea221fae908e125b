//! Both ends of a link in virtual time, with a modelled network between them.

mod attacks;
mod faults;
mod flow;
mod packing;

use std::collections::BTreeMap;

use bateleur_contract::PortKind;
use bateleur_contract::relay::{ClockRole, LinkModelTable, LinkTable, PathTable, RelayChannel, RelayTable};

use crate::model::{LinkModel, ModelCounters};
use crate::{Arrival, Event, Frame, Link, Stamp};

/// From one window of a relay to its next, ns.
pub(crate) const MINOR_NS: u64 = 20_000_000;
/// The right key.
pub(crate) const KEY: [u8; 32] = [0x5a; 32];
/// What the second module's clock is ahead of the first one's, ns.
pub(crate) const AHEAD_NS: u64 = 1_234_567_000;

/// Places of the channels in the table.
pub(crate) const STATE: usize = 0;
pub(crate) const ORDERS: usize = 1;
pub(crate) const MAP: usize = 2;
pub(crate) const RATES: usize = 3;

fn channel(id: u16, name: &str, outgoing: bool, kind: PortKind, max_bytes: u32, depth: u32) -> RelayChannel {
    let (name, port) = (name.to_owned(), name.replace('.', "-"));
    RelayChannel { id, name, port, outgoing, kind, plain: false, max_bytes, depth, period_ns: MINOR_NS }
}

/// The table of "fcu" (the initiator) or of "nav", with a link of two networks and four channels.
pub(crate) fn table(initiator: bool) -> RelayTable {
    let (own, peer) = if initiator { (1, 2) } else { (2, 1) };
    let path = |network: &str, net: u8| PathTable {
        network: network.into(),
        local: ([10, net, 0, own], 15300).into(),
        remote: ([10, net, 0, peer], 15300).into(),
        latency_ns: 623_000,
    };
    let name = |number| ["", "fcu", "nav"][number as usize].to_owned();
    RelayTable {
        module: name(own),
        digest: "5d".repeat(32),
        sections: BTreeMap::new(),
        transport: "udp".into(),
        links: vec![LinkTable {
            name: "bus".into(),
            id: 7,
            peer: name(peer),
            initiator,
            authenticated: true,
            gap_ns: 4_000_000,
            max_datagram: 1472,
            skew_ns: 10_000_000,
            lost_after_ns: 100_000_000,
            clock: ClockRole::None,
            paths: vec![path("a", 77), path("b", 78)],
            channels: vec![
                channel(3, "estimator.state", initiator, PortKind::Sampling, 64, 1),
                channel(4, "command.orders", initiator, PortKind::Queuing, 200, 16),
                channel(5, "camera.map", initiator, PortKind::Queuing, 9_000, 4),
                channel(9, "imu.rates", !initiator, PortKind::Sampling, 24, 1),
            ],
        }],
    }
}

pub(crate) fn link(table: &RelayTable, life: u8) -> Link {
    Link::new(table, &table.links[0], &KEY, [life; 32]).unwrap()
}

/// A message that came out: channel, source time, the source's number, bytes.
pub(crate) type Message = (usize, u64, u32, Vec<u8>);

/// One module's end.
pub(crate) struct End {
    pub(crate) link: Link,
    pub(crate) received: Vec<Message>,
    pub(crate) events: Vec<Event>,
    /// What it has put on the networks, with their tags.
    pub(crate) sent: Vec<(usize, Vec<u8>)>,
    /// Its module time less that of the test, ns.
    ahead_ns: u64,
    to_send: Vec<(usize, Stamp, Vec<u8>)>,
    /// Queues take this many more messages.
    pub(crate) room: usize,
}

impl End {
    fn new(link: Link, ahead_ns: u64) -> Self {
        Self {
            link,
            received: Vec::new(),
            events: Vec::new(),
            sent: Vec::new(),
            ahead_ns,
            to_send: Vec::new(),
            room: usize::MAX,
        }
    }

    /// Writes a message at `now_ns` of the test, which goes with the next window that has room.
    pub(crate) fn write(&mut self, channel: usize, sequence: u64, now_ns: u64, bytes: &[u8]) {
        self.to_send.push((channel, Stamp { source_ns: now_ns + self.ahead_ns, sequence }, bytes.to_vec()));
    }

    /// Messages of one channel that came.
    pub(crate) fn of(&self, channel: usize) -> Vec<&Message> {
        self.received.iter().filter(|message| message.0 == channel).collect()
    }

    pub(crate) fn take(
        &mut self,
        network: usize,
        now_ns: u64,
        datagram: &[u8],
    ) -> Result<(), crate::Rejection> {
        let now_ns = now_ns + self.ahead_ns;
        let Self { link, received, room, .. } = self;
        link.receive(Arrival { network, came_ns: now_ns, now_ns }, datagram, &mut |delivery| {
            received.push((delivery.channel, delivery.source_ns, delivery.sequence, delivery.bytes.to_vec()));
            *room -= 1;
            *room > 0
        })
    }

    pub(crate) fn look(&mut self, now_ns: u64) {
        let Self { link, received, ahead_ns, .. } = self;
        link.look(now_ns + *ahead_ns, &mut |delivery| {
            received.push((delivery.channel, delivery.source_ns, delivery.sequence, delivery.bytes.to_vec()));
            true
        });
        self.events.extend(std::iter::from_fn(|| self.link.next_event()));
    }

    /// Sends what a window has to send; gives the datagram as it goes out on each network.
    pub(crate) fn send(&mut self, now_ns: u64) -> Vec<(usize, Vec<u8>)> {
        let now_ns = now_ns + self.ahead_ns;
        let Some(mut composer) = self.link.open(now_ns, Frame { number: 3, start_ns: now_ns - 1_000 }) else {
            return Vec::new();
        };
        while let Some((channel, stamp, bytes)) = self.to_send.first() {
            if !composer.put(*channel, *stamp, bytes) {
                break;
            }
            self.to_send.remove(0);
        }
        let sealed = composer.finish(now_ns);
        let all = (0..2).map(|network| (network, [sealed.bytes, sealed.tag(network)].concat()));
        let all: Vec<_> = all.collect();
        self.sent.extend(all.clone());
        all
    }
}

/// Both ends and what lies between them.
pub(crate) struct Pair {
    pub(crate) ends: [End; 2],
    /// By sending end, then network.
    models: Vec<LinkModel>,
    /// By instant and number: receiving end, network, datagram.
    on_the_way: BTreeMap<(u64, u64), (usize, usize, Vec<u8>)>,
    number: u64,
    pub(crate) now_ns: u64,
    /// Nothing that this end sends comes anywhere, as where a cable has one broken pair.
    pub(crate) mute: Option<usize>,
}

impl Pair {
    pub(crate) fn new(model: &LinkModelTable) -> Self {
        Self::of([link(&table(true), 1), link(&table(false), 2)], model)
    }

    pub(crate) fn of([first, second]: [Link; 2], model: &LinkModelTable) -> Self {
        let models = [(true, "a"), (true, "b"), (false, "a"), (false, "b")];
        Self {
            ends: [End::new(first, 0), End::new(second, AHEAD_NS)],
            models: models.map(|(initiator, name)| LinkModel::new(model, name, 7, initiator)).into(),
            on_the_way: BTreeMap::new(),
            number: 0,
            now_ns: MINOR_NS,
            mute: None,
        }
    }

    /// A minor frame: a window of the first end at its beginning, one of the second in its middle.
    pub(crate) fn frame(&mut self) {
        for end in 0..2 {
            self.window(end);
            self.now_ns += MINOR_NS / 2;
        }
    }

    pub(crate) fn frames(&mut self, count: usize) {
        (0..count).for_each(|_| self.frame());
    }

    /// Frames until messages flow both ways.
    pub(crate) fn meet(&mut self) {
        self.frames(4);
        assert!(self.ends.iter().all(|end| end.link.state() == bateleur_messages::link::UP));
    }

    /// As if a wire were drawn: what is on its way never comes, in both directions of all networks.
    pub(crate) fn lose_what_is_on_the_way(&mut self) {
        self.on_the_way.clear();
    }

    pub(crate) fn models(&self, end: usize, network: usize) -> ModelCounters {
        self.models[2 * end + network].counters()
    }

    fn window(&mut self, end: usize) {
        let now_ns = self.now_ns;
        while let Some(first) = self.on_the_way.first_entry().filter(|first| first.key().0 <= now_ns) {
            let ((at_ns, _), (to, network, datagram)) = first.remove_entry();
            let _ = self.ends[to].take(network, at_ns, &datagram); // counted
        }
        self.ends[end].look(now_ns);
        for (network, datagram) in self.ends[end].send(now_ns) {
            if self.mute == Some(end) {
                continue;
            }
            for at_ns in self.models[2 * end + network].pass(now_ns, datagram.len()).into_iter().flatten() {
                self.number += 1;
                self.on_the_way.insert((at_ns, self.number), (1 - end, network, datagram.clone()));
            }
        }
    }
}
