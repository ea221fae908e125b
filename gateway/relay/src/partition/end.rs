//! One link of this relay: its end, and the ports of the channels that it carries.

use bateleur_apex::{
    Context, PortKind, RawQueuingDestination, RawQueuingSource, RawSamplingDestination, RawSamplingSource,
    Sent, StartError, Window,
};
use bateleur_contract::relay::{LinkTable, RelayChannel, RelayTable};
use bateleur_messages::link::{NETWORKS, REASON_NAMES};
use bateleur_relay::{Composer, Delivery, Event, Key, Link, Stamp};

use super::keys;

/// A link and what it carries.
pub(super) struct End {
    pub(super) link: Link,
    pub(super) ports: Ports,
    name: String,
    peer: String,
    networks: Vec<String>,
    channels: Vec<String>,
    /// Answers of the peer's computers that nobody listens there, by network: so far, and when the network was heard or told last.
    port_unreachable: [(u64, u64); NETWORKS],
    /// Messages dropped for full queues when it was last said, and those that nobody received.
    overflows_told: u64,
    unreceived_told: u64,
    /// It has still to be said that the link is not authenticated.
    unprotected: bool,
}

impl End {
    /// Opens the ports of a link's channels.
    pub(super) fn open(
        context: &mut Context,
        table: &RelayTable,
        link: &LinkTable,
        key: &Key,
    ) -> Result<Self, StartError> {
        let refused = |error: bateleur_relay::LinkError| StartError::Other(error.to_string());
        let ports = link.channels.iter().map(|channel| Port::open(context, channel));
        let ports = Ports { all: ports.collect::<Result<_, _>>()?, first: 0, unreceived: None };
        Ok(Self {
            link: Link::new(table, link, key, keys::unforeseen()?).map_err(refused)?,
            ports,
            name: link.name.clone(),
            peer: link.peer.clone(),
            networks: link.paths.iter().map(|path| path.network.clone()).collect(),
            channels: link.channels.iter().map(|channel| channel.name.clone()).collect(),
            port_unreachable: Default::default(),
            overflows_told: 0,
            unreceived_told: 0,
            unprotected: !link.authenticated,
        })
    }

    /// Says what happened: to the health monitor what is wrong, to the log what is well again.
    pub(super) fn tell(&mut self, window: &Window) {
        if std::mem::take(&mut self.unprotected) {
            window.report(&format!("link {}: not authenticated, as the plan says", self.name));
        }
        while let Some(event) = self.link.next_event() {
            self.tell_one(&event, window);
        }
        if self.link.sends_all_again() {
            self.ports.send_all_again();
        }
        self.tell_unreceived(window);
        for (network, (so_far, told)) in self.port_unreachable.iter_mut().enumerate() {
            if self.link.is_up(network) {
                *told = *so_far; // of a time that is over
            }
        }
    }

    /// Notes how often a network's other computer has answered that nobody listens there.
    pub(super) fn note_port_unreachable(&mut self, network: usize, count: u64) {
        self.port_unreachable[network].0 = count;
    }

    /// What is to be said of a network's silence beside itself.
    fn why_silent(&mut self, network: usize) -> &'static str {
        let (so_far, told) = &mut self.port_unreachable[network];
        let answered = *so_far > std::mem::replace(told, *so_far);
        if answered { "; the computer there says that no relay listens" } else { "" }
    }

    fn tell_one(&mut self, event: &Event, window: &Window) {
        let why = match event {
            Event::NetworkDown(place) | Event::NetworkSilent(place) => self.why_silent(*place),
            _ => "",
        };
        let Self { name, peer, .. } = self;
        match event {
            Event::NetworkDown(place) => {
                let network = &self.networks[*place];
                window.raise(&format!("link {name}: nothing comes on network {network} any more{why}"));
            }
            Event::NetworkUp(place) => {
                window.report(&format!("link {name}: network {} is back", self.networks[*place]));
            }
            Event::NetworkSilent(place) => {
                let (counters, network) = (self.link.counters(), &self.networks[*place]);
                let text = match (counters.networks[*place].received, refusals(&counters.rejected)) {
                    (0, _) => format!("nothing has come on network {network}{why}"),
                    (came, why) => {
                        format!("{came} datagrams came on network {network}, none was taken: {why}")
                    }
                };
                window.raise(&format!("link {name}: {text}"));
            }
            Event::Up => {
                window.report(&format!("link {name}: up, {peer} is there"));
            }
            Event::Down => {
                let heard = (0..self.networks.len()).any(|network| self.link.is_up(network));
                let why = if heard { "does not hear this module" } else { "is not heard" };
                window.raise(&format!("link {name}: down, {peer} {why}"));
            }
            Event::PeerRestarted => {
                window.report(&format!("link {name}: the relay of {peer} was restarted"));
            }
            Event::PlanDiffers(what) if what.is_empty() => {
                window.raise(&format!("link {name}: {peer} has another plan; nothing of it is taken"));
            }
            Event::PlanDiffers(what) => window.report(&format!("link {name}: the plan of {peer} {what}")),
            Event::Overflow(place) => self.tell_overflow(*place, window),
            Event::NetworkSlow { network, took_ns, allowed_ns } => window.raise(&format!(
                "link {name}: datagrams take up to {} us on network {}, the plan says {}",
                took_ns / 1_000,
                self.networks[*network],
                allowed_ns / 1_000
            )),
            Event::NetworkInTime(network) => {
                let network = &self.networks[*network];
                window.report(&format!("link {name}: network {network} is as quick as the plan says again"));
            }
        }
    }

    /// Said where it has become twice as much: a slow reader must not fill the health log.
    fn tell_overflow(&mut self, place: usize, window: &Window) {
        let overflowed = self.link.counters().messages_overflowed;
        if overflowed >= 2 * self.overflows_told {
            self.overflows_told = overflowed;
            let channel = &self.channels[place];
            window
                .raise(&format!("link {}: no room for {channel}; {overflowed} messages dropped", self.name));
        }
    }

    /// A message that nobody was there to receive, said as rarely: whoever is not there is an error of its own.
    fn tell_unreceived(&mut self, window: &Window) {
        let Some((place, count)) = self.ports.unreceived else { return };
        if count > self.unreceived_told && count >= 2 * self.unreceived_told {
            self.unreceived_told = count;
            let channel = &self.channels[place];
            let text = format!("link {}: nobody receives {channel}; {count} messages dropped", self.name);
            window.report(&text);
        }
    }
}

/// The ports of a link's channels, in the order of its table.
pub(super) struct Ports {
    all: Vec<Port>,
    /// Where the next datagram begins to look: the first that did not fit into the one before.
    first: usize,
    /// Messages for which nobody was there, and the channel of the last.
    unreceived: Option<(usize, u64)>,
}

/// The own end of a channel.
enum Port {
    SamplingOut { port: Box<RawSamplingDestination>, again: bool },
    QueuingOut(RawQueuingDestination),
    SamplingIn(RawSamplingSource),
    QueuingIn(RawQueuingSource),
}

impl Port {
    fn open(context: &mut Context, channel: &RelayChannel) -> Result<Self, StartError> {
        let name = channel.port.as_str();
        let (port, bytes) = match (channel.kind, channel.outgoing) {
            (PortKind::Sampling, true) => {
                let (port, bytes) = context.raw_sampling_destination(name)?;
                (Self::SamplingOut { port: Box::new(port), again: true }, bytes)
            }
            (PortKind::Queuing, true) => {
                let (port, bytes) = context.raw_queuing_destination(name)?;
                (Self::QueuingOut(port), bytes)
            }
            (PortKind::Sampling, false) => {
                let (port, bytes) = context.raw_sampling_source(name)?;
                (Self::SamplingIn(port), bytes)
            }
            (PortKind::Queuing, false) => {
                let (port, bytes) = context.raw_queuing_source(name)?;
                (Self::QueuingIn(port), bytes)
            }
        };
        let said = channel.max_bytes as usize;
        if bytes == said {
            return Ok(port);
        }
        Err(StartError::Other(format!("port \"{name}\" is for {bytes} bytes, and its channel for {said}")))
    }
}

impl Ports {
    /// Hands a message to its port; false: there is no room.
    pub(super) fn deliver(&mut self, delivery: &Delivery<'_>) -> bool {
        let stamp =
            bateleur_apex::Stamp { source_ns: delivery.source_ns, sequence: u64::from(delivery.sequence) };
        match self.all.get_mut(delivery.channel) {
            Some(Port::SamplingIn(port)) => {
                port.write(delivery.bytes, stamp);
                true
            }
            Some(Port::QueuingIn(port)) => match port.send(delivery.bytes, stamp) {
                Sent::Queued => true,
                Sent::Full => false,
                // As within a host: what nobody is there to receive is gone, and no queue is full.
                Sent::NoReceiver => {
                    let before = self.unreceived.map_or(0, |(_, count)| count);
                    self.unreceived = Some((delivery.channel, before + 1));
                    true
                }
            },
            _ => false, // the link hands on nothing of a channel that goes out
        }
    }

    /// Puts into a datagram what is new; true: not everything fitted.
    pub(super) fn collect(&mut self, composer: &mut Composer<'_>) -> bool {
        if !composer.takes_messages() {
            return false;
        }
        let count = self.all.len();
        let begun = self.first;
        let mut full = false;
        for step in 0..count {
            let place = (begun + step) % count;
            if !self.all[place].put(place, composer) && !std::mem::replace(&mut full, true) {
                self.first = place;
            }
        }
        full
    }

    /// Values that were written once shall reach a peer that was not there then.
    fn send_all_again(&mut self) {
        for port in &mut self.all {
            if let Port::SamplingOut { again, .. } = port {
                *again = true;
            }
        }
    }
}

impl Port {
    /// False: there is no room for something new.
    fn put(&mut self, place: usize, composer: &mut Composer<'_>) -> bool {
        match self {
            Self::SamplingOut { port, again } => {
                let Some(reading) = port.read() else { return true };
                if reading.updated || *again {
                    // Where there is no room it stays in the port, or is replaced by a newer one there.
                    *again = !composer.put(place, stamp(reading.stamp), reading.bytes);
                }
                !*again
            }
            Self::QueuingOut(port) => {
                while composer.has_room(place) {
                    let Some(message) = port.receive() else { return true };
                    // It was taken out of the queue, and there is room: it can not be refused.
                    composer.put(place, stamp(message.stamp()), message.bytes());
                }
                !port.has_messages()
            }
            Self::SamplingIn(_) | Self::QueuingIn(_) => true,
        }
    }
}

/// Why datagrams were refused, for whoever would look for a cable otherwise.
fn refusals(rejected: &[u64]) -> String {
    let all = REASON_NAMES.iter().zip(rejected).filter(|(_, count)| **count > 0);
    let words = all.map(|(reason, count)| match *reason {
        "key" => format!("key {count} (another key file?)"),
        "restart" => format!("restart {count} (is this end heard?)"),
        _ => format!("{reason} {count}"),
    });
    words.collect::<Vec<_>>().join(", ")
}

fn stamp(stamp: bateleur_apex::Stamp) -> Stamp {
    Stamp { source_ns: stamp.source_ns, sequence: stamp.sequence }
}
