//! Where frames go and come from: a bus, the network, or both with this function as the gateway between them.

use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

use bateleur_can_core::bus::{Bus, BusError, BusName, Losses, Sent};
use bateleur_can_core::{Event, Frame, Gateway, Ids};

/// A bus that broke is tried again so often, module time, ns.
const RETRY_NS: u64 = 1_000_000_000;
/// Frames, and datagrams, taken in one look at most: between two looks the time is looked at, so that a flood does not hold the
/// window.
const PER_LOOK: usize = 32;

/// Time, as the executive gives it.
pub trait Waiting {
    /// Module time, ns.
    fn now_ns(&self) -> u64;
    /// Waits until `device` can be read, at the longest until module time `until_ns`; false: nothing came.
    fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool;
}

/// What there is.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The bus.
    pub bus: BusName,
    /// Own UDP address; `None`: no network.
    pub listen: Option<SocketAddr>,
    /// How it behaves on the network.
    pub gateway: bateleur_can_core::Settings,
}

#[derive(Debug)]
struct Net {
    gateway: Gateway,
    socket: UdpSocket,
}

/// See the module's text.
pub struct Wires {
    name: BusName,
    bus: Option<Box<dyn Bus>>,
    retry_at_ns: u64,
    net: Option<Net>,
    /// Frames that the bus did not take.
    pub refused: u64,
    /// Of buses that were opened before the one that is there; what was told; and when it is looked at next, ns.
    former_losses: Losses,
    losses_told: Losses,
    losses_at_ns: u64,
    /// A gateway was started anew: what was sent to it before is lost.
    has_restarted_peer: bool,
    /// What is to be said.
    pub events: Vec<String>,
}

impl Wires {
    /// Opens bus and network.
    ///
    /// # Errors
    /// What can not be had, and what helps.
    pub fn open(settings: Settings) -> Result<Self, String> {
        let bus = match &settings.bus {
            BusName::None => None,
            name => Some(name.open(&Ids::All).map_err(|error| format!("attribute bus: {error}"))?),
        };
        let net = match settings.listen {
            Some(address) => Some(Net::open(address, settings.gateway)?),
            None => None,
        };
        if bus.is_none() && net.is_none() {
            return Err("attribute bus or attribute listen: without a bus and without the network there is nobody to talk to".into());
        }
        Ok(Self {
            name: settings.bus,
            bus,
            retry_at_ns: 0,
            net,
            refused: 0,
            former_losses: Losses::default(),
            losses_told: Losses::default(),
            losses_at_ns: 0,
            has_restarted_peer: false,
            events: Vec::new(),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> Option<SocketAddr> {
        self.net.as_ref()?.socket.local_addr().ok()
    }

    /// What the gateway counted, where there is one.
    pub fn gateway(&self) -> Option<&Gateway> {
        self.net.as_ref().map(|net| &net.gateway)
    }

    /// What went wrong with frames of the bus out of this program's sight.
    pub fn losses(&self) -> Losses {
        self.former_losses + self.bus.as_ref().map(|bus| bus.losses()).unwrap_or_default()
    }

    /// Sends a frame: to the bus, and to who is on the network; there with [`Wires::flush`].
    pub fn send(&mut self, frame: &Frame, now_ns: u64) {
        self.put_on_bus(frame, now_ns);
        if let Some(net) = &mut self.net {
            net.gateway.take_frame(frame, now_ns);
        }
    }

    fn put_on_bus(&mut self, frame: &Frame, now_ns: u64) {
        let Some(bus) = &mut self.bus else {
            self.refused += u64::from(self.name != BusName::None);
            return;
        };
        match bus.send(frame) {
            Ok(Sent::Taken) => {}
            Ok(Sent::Full | Sent::Refused) => self.refused += 1,
            Err(error) => self.give_up(&error, now_ns),
        }
    }

    /// What waits goes out.
    pub fn flush(&mut self, now_ns: u64) {
        if let Some(Net { gateway, socket }) = &mut self.net {
            let mut send = |to: SocketAddr, bytes: &[u8]| socket.send_to(bytes, to).is_ok();
            gateway.run(now_ns, &mut send);
            gateway.flush(now_ns, &mut send);
            while let Some(event) = gateway.event() {
                self.has_restarted_peer |= matches!(event, Event::Restarted { .. });
                if !matches!(event, Event::State(_)) {
                    self.events.push(event.to_string());
                }
            }
        }
    }

    /// Whether a gateway was started anew since this was last asked.
    pub fn take_restarted_peer(&mut self) -> bool {
        std::mem::take(&mut self.has_restarted_peer)
    }

    /// Gives frames that have come to `take`, each with how old it is, ns; whether more may have come than one look takes.
    pub fn receive(&mut self, now_ns: u64, mut take: impl FnMut(&Frame, u64)) -> bool {
        self.mend(now_ns);
        let mut is_more = self.hear_bus(now_ns, &mut take);
        let mut frames = Vec::new();
        if let Some(Net { gateway, socket }) = &mut self.net {
            let (mut bytes, mut datagrams) = ([0; 2_048], 0);
            while datagrams < PER_LOOK {
                let Ok((length, from)) = socket.recv_from(&mut bytes) else { break };
                gateway.take_datagram(&bytes[..length], from, now_ns, |frame, age_ns| {
                    frames.push((*frame, age_ns));
                });
                datagrams += 1;
            }
            is_more |= datagrams == PER_LOOK;
        }
        for (frame, age_ns) in &frames {
            take(frame, *age_ns);
            if self.bus.is_some() {
                self.put_on_bus(frame, now_ns);
            }
        }
        self.flush(now_ns);
        is_more
    }

    fn hear_bus(&mut self, now_ns: u64, take: &mut impl FnMut(&Frame, u64)) -> bool {
        let Some(bus) = &mut self.bus else { return false };
        let (mut result, mut frames) = (bus.tend(now_ns), 0);
        while frames < PER_LOOK && result.is_ok() {
            match bus.receive() {
                Ok(Some(frame)) => {
                    frames += 1;
                    take(&frame, 0);
                    if let Some(net) = &mut self.net {
                        net.gateway.take_frame(&frame, now_ns);
                    }
                }
                Ok(None) => break,
                Err(error) => result = Err(error),
            }
        }
        self.events.extend(bus.complaint());
        if let Err(error) = result {
            self.give_up(&error, now_ns);
        }
        if now_ns >= self.losses_at_ns {
            self.losses_at_ns = now_ns + RETRY_NS;
            let (losses, events) = (self.losses(), &mut self.events);
            losses.tell(&mut self.losses_told, &self.name, &mut |text| events.push(text.to_owned()));
        }
        frames == PER_LOOK
    }

    fn give_up(&mut self, error: &BusError, now_ns: u64) {
        self.events.push(error.to_string());
        self.former_losses = self.losses();
        (self.bus, self.retry_at_ns) = (None, now_ns + RETRY_NS);
    }

    fn mend(&mut self, now_ns: u64) {
        if self.bus.is_some() || self.name == BusName::None || now_ns < self.retry_at_ns {
            return;
        }
        self.retry_at_ns = now_ns + RETRY_NS;
        if let Ok(bus) = self.name.open(&Ids::All) {
            self.events.push(format!("{} is there again", self.name));
            self.bus = Some(bus);
        }
    }

    /// Waits until something comes, at the longest until module time `until_ns`; false: nothing came.
    pub fn wait(&self, time: &impl Waiting, until_ns: u64) -> bool {
        match (self.bus.as_ref().and_then(|bus| bus.readable()), &self.net) {
            (Some(bus), _) => time.wait_readable(&Readable(bus), until_ns),
            (None, Some(net)) => time.wait_readable(&net.socket, until_ns),
            (None, None) => false,
        }
    }
}

struct Readable<'a>(BorrowedFd<'a>);

impl AsFd for Readable<'_> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0
    }
}

impl Net {
    fn open(address: SocketAddr, settings: bateleur_can_core::Settings) -> Result<Self, String> {
        let open = || {
            let socket = UdpSocket::bind(address)?;
            socket.set_nonblocking(true)?;
            socket.set_broadcast(true)?;
            std::io::Result::Ok(socket)
        };
        let socket = open().map_err(|error| {
            format!("attribute listen = \"{address}\": {error}; another program has that port, the address is not this computer's, or the plan does not say `network = true`")
        })?;
        let mut gateway = Gateway::new(settings);
        gateway.bus_is_ready();
        gateway.address_is_ready(0);
        Ok(Self { gateway, socket })
    }
}
