//! Two gateways at full buses: frames with numbers in them are sent as densely as the bus allows, and the numbers are looked at on
//! the other side.
//!
//! In virtual time everything is in memory and an hour of bus time takes a minute; in real time the gateways are those of
//! [`crate::node`], with UDP between them.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::node::{self, Options, StartError};
use bateleur_can_core::bus::bits::Rates;
use bateleur_can_core::bus::memory::{MemoryBus, Node, Wire};
use bateleur_can_core::bus::{Bus, BusError, BusName, Sent};
use bateleur_can_core::frame::{Frame, Id, Kind};
use bateleur_can_core::{Gateway, Settings};
use bateleur_can_core::{Ring, Rules};

/// Identifiers that the frames have in turn: of both lengths.
const IDS: u32 = 16;
/// Frames that wait at the sender: as soon as one has been sent, the next one begins.
const AHEAD: usize = 2;

/// What a bus is filled with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load {
    /// Bit rates.
    pub rates: Rates,
    /// FD frames with 64 bytes and bit-rate switch, instead of classic ones with 8.
    pub fd: bool,
}

/// What came of it, in one direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Soak {
    /// Frames that the first bus carried.
    pub sent: u64,
    /// Frames that the second bus carried.
    pub arrived: u64,
    /// Frames whose number was not the one after the one before, of their identifier.
    pub out_of_sequence: u64,
    /// Frames that some counter says were lost.
    pub counted_lost: u64,
    /// Time in which the first bus was not idle, ns.
    pub busy_ns: u64,
    /// Bus time, ns.
    pub lasted_ns: u64,
}

impl Soak {
    /// Every frame has come, in its place.
    pub fn is_whole(&self) -> bool {
        self.sent == self.arrived && self.out_of_sequence == 0 && self.counted_lost == 0
    }
}

/// Numbers frames, and looks at numbers.
#[derive(Debug, Clone, Default)]
struct Numbers {
    next: [u64; IDS as usize],
    turn: u32,
}

impl Numbers {
    fn frame(&mut self, fd: bool) -> Frame {
        let which = self.turn % IDS;
        self.turn = self.turn.wrapping_add(1);
        let number = self.next[which as usize];
        self.next[which as usize] += 1;
        let mut data = [0; 64];
        data[..8].copy_from_slice(&number.to_le_bytes());
        data[8..]
            .iter_mut()
            .enumerate()
            .for_each(|(place, byte)| *byte = (number as u8).wrapping_add(place as u8));
        // Every fourth one is extended.
        let id = if which % 4 == 3 {
            Id::Extended(which << 20 | 0x155)
        } else {
            Id::Standard(0x100 + which as u16)
        };
        let kind = if fd { Kind::Fd { brs: true, esi: false } } else { Kind::Data };
        let length = if fd { 64 } else { 8 };
        Frame::new(id, kind, &data[..length]).unwrap_or(Frame::classic(id, &data[..8]))
    }

    /// Whether the frame is the next one of its identifier.
    fn follows(&mut self, frame: &Frame) -> bool {
        let which = match frame.id() {
            Id::Standard(id) => u32::from(id) - 0x100,
            Id::Extended(id) => id >> 20,
        };
        let Some(next) = self.next.get_mut(which as usize) else { return false };
        let number = frame.data().first_chunk().map_or(u64::MAX, |bytes| u64::from_le_bytes(*bytes));
        let follows = number == *next;
        *next = number.wrapping_add(1);
        follows
    }
}

fn wire(rates: Rates) -> Wire {
    Wire { queue: 8, ..Wire::new(rates) }
}

/// Fills a bus for so long, in virtual time.
pub fn in_virtual_time(load: Load, lasts_ns: u64) -> Soak {
    let (mut first, mut second) = (MemoryBus::new(wire(load.rates)), MemoryBus::new(wire(load.rates)));
    let (sender, near, far, listener) = (first.attach(), first.attach(), second.attach(), second.attach());
    let addresses: [SocketAddr; 2] =
        [SocketAddr::from(([10, 0, 0, 1], 1)), SocketAddr::from(([10, 0, 0, 2], 1))];
    let settings = |place: usize| Settings::new(place as u64 + 1, 1, vec![addresses[1 - place]]);
    let mut gateways = [Gateway::new(settings(0)), Gateway::new(settings(1))];
    gateways.iter_mut().for_each(|gateway| gateway.address_is_ready(0));
    let mut to_bus = Ring::new(Rules { capacity: 4_096, ..settings(0).ring });
    let (mut numbers, mut expected) = (Numbers::default(), Numbers::default());
    let mut soak = Soak::default();
    let mut post: VecDeque<(usize, Vec<u8>)> = VecDeque::new();
    let mut now_ns = 0;
    loop {
        while now_ns < lasts_ns && first.pending(sender) < AHEAD {
            first.send(sender, &numbers.frame(load.fd));
        }
        while let Some((_, frame)) = first.receive(near) {
            soak.sent += 1;
            gateways[0].take_frame(&frame, now_ns);
        }
        for (place, gateway) in gateways.iter_mut().enumerate() {
            gateway.run(now_ns, &mut |_, bytes| {
                post.push_back((1 - place, bytes.to_vec()));
                true
            });
        }
        while let Some((place, bytes)) = post.pop_front() {
            let from = addresses[1 - place];
            gateways[place].take_datagram(&bytes, from, now_ns, |frame, age_ns| {
                to_bus.push(*frame, age_ns, now_ns);
            });
        }
        to_bus.hand_out(now_ns, |aged| second.send(far, &aged.frame) == Sent::Taken);
        while let Some((_, frame)) = second.receive(listener) {
            soak.arrived += 1;
            soak.out_of_sequence += u64::from(!expected.follows(&frame));
        }
        let Some(due_ns) = [first.due_ns(), second.due_ns()].into_iter().flatten().min() else { break };
        now_ns = due_ns.max(now_ns);
        first.advance(now_ns);
        second.advance(now_ns);
    }
    soak.counted_lost =
        gateways.iter().map(|gateway| gateway.counters().lost()).sum::<u64>() + to_bus.given_up().total();
    (soak.busy_ns, soak.lasted_ns) = (first.traffic().busy_ns, now_ns);
    soak
}

/// One end in real time: a bus in memory on the machine's clock, with a sender or a listener at it.
struct Paced {
    bus: MemoryBus,
    port: Node,
    other: Node,
    load: Load,
    begun_ns: Option<u64>,
    numbers: Numbers,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    soak: Mutex<Soak>,
    sends: AtomicBool,
}

impl Paced {
    fn new(load: Load, shared: Arc<Shared>) -> Self {
        // A bus that is full has no time to make up for: what a thread was kept from must already lie at the controller, or the
        // second bus falls behind for ever.
        let mut bus = MemoryBus::new(Wire { queue: 1 << 16, ..wire(load.rates) });
        let (port, other) = (bus.attach(), bus.attach());
        Self { bus, port, other, load, begun_ns: None, numbers: Numbers::default(), shared }
    }
}

/// The end that sends.
struct Sender(Paced);
/// The end that listens.
struct Listener(Paced);

impl Paced {
    /// Lets the bus go on until `now_ns`, event by event.
    fn advance(&mut self, now_ns: u64, mut each: impl FnMut(&mut Self)) {
        let to_ns = now_ns.saturating_sub(*self.begun_ns.get_or_insert(now_ns));
        loop {
            each(self);
            match self.bus.due_ns() {
                Some(due_ns) if due_ns <= to_ns => self.bus.advance(due_ns),
                _ => break,
            }
        }
        self.bus.advance(to_ns);
        each(self);
    }

    fn due_ns(&self) -> u64 {
        self.bus.due_ns().map_or(u64::MAX, |due_ns| self.begun_ns.unwrap_or(0) + due_ns)
    }
}

impl Bus for Sender {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        let frame = self.0.bus.receive(self.0.port).map(|(_, frame)| frame);
        if frame.is_some()
            && let Ok(mut soak) = self.0.shared.soak.lock()
        {
            soak.sent += 1;
        }
        Ok(frame)
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        Ok(self.0.bus.send(self.0.port, frame))
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        None
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.0.advance(now_ns, |paced| {
            while paced.shared.sends.load(Ordering::Relaxed) && paced.bus.pending(paced.other) < AHEAD {
                let frame = paced.numbers.frame(paced.load.fd);
                paced.bus.send(paced.other, &frame);
            }
        });
        if let Ok(mut soak) = self.0.shared.soak.lock() {
            (soak.busy_ns, soak.lasted_ns) = (self.0.bus.traffic().busy_ns, self.0.bus.now_ns());
        }
        Ok(())
    }

    fn due_ns(&self) -> u64 {
        self.0.due_ns()
    }
}

impl Bus for Listener {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        Ok(self.0.bus.receive(self.0.port).map(|(_, frame)| frame))
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        Ok(self.0.bus.send(self.0.port, frame))
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        None
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.0.advance(now_ns, |paced| {
            while let Some((_, frame)) = paced.bus.receive(paced.other) {
                let follows = paced.numbers.follows(&frame);
                if let Ok(mut soak) = paced.shared.soak.lock() {
                    soak.arrived += 1;
                    soak.out_of_sequence += u64::from(!follows);
                }
            }
        });
        Ok(())
    }

    fn due_ns(&self) -> u64 {
        self.0.due_ns()
    }
}

/// Fills a bus for so long, in real time, with UDP on this machine between two gateways, each in a thread of its own.
///
/// # Errors
/// The sockets can not be had.
pub fn in_real_time(load: Load, lasts: Duration) -> Result<Soak, StartError> {
    let shared = Arc::new(Shared::default());
    let options = |identity: u64, peers: Vec<SocketAddr>| {
        let mut settings = Settings::new(identity, 1, peers);
        // Someone else's burst of work may last; none of it may cost a frame here.
        settings.ring = Rules { capacity: 1 << 16, max_age_ns: 10_000_000_000, ..settings.ring };
        Options {
            name: format!("soak {identity}"),
            bus: BusName::None,
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            to_bus: settings.ring.clone(),
            settings,
            server: None,
            status: None,
            log: None,
        }
    };
    let mut near =
        node::Node::with_bus(options(1, vec![]), Box::new(Sender(Paced::new(load, shared.clone()))))?;
    let peers = near.address().into_iter().collect();
    let mut far =
        node::Node::with_bus(options(2, peers), Box::new(Listener(Paced::new(load, shared.clone()))))?;
    let stop = Arc::new(AtomicBool::new(false));
    let far_end = std::thread::spawn({
        let stop = stop.clone();
        move || {
            far.run(&stop, &mut |_| ());
            far.counters().lost()
        }
    });
    let begun_ns = node::now_ns();
    // They find each other before the first frame; the last ones get time to arrive.
    let until = |ns: u64, near: &mut node::Node| {
        while node::now_ns() < ns {
            near.turn(1_000_000, &mut |_| ());
        }
    };
    until(begun_ns + 1_500_000_000, &mut near);
    shared.sends.store(true, Ordering::Relaxed);
    until(begun_ns + 1_500_000_000 + lasts.as_nanos() as u64, &mut near);
    shared.sends.store(false, Ordering::Relaxed);
    until(node::now_ns() + 2_500_000_000, &mut near);
    stop.store(true, Ordering::Relaxed);
    let far_lost = far_end.join().unwrap_or(u64::MAX);
    let mut soak = shared.soak.lock().map(|soak| *soak).unwrap_or_default();
    soak.counted_lost = near.counters().lost().saturating_add(far_lost);
    Ok(soak)
}

/// The three loads: what the aircraft's bus has, the most of a classic bus, and an FD bus.
pub const LOADS: [(&str, Load); 3] = [
    ("800 kbit/s", Load { rates: Rates::classic(800_000), fd: false }),
    ("1 Mbit/s", Load { rates: Rates::classic(1_000_000), fd: false }),
    ("FD, 1 and 5 Mbit/s", Load { rates: Rates { nominal: 1_000_000, data: 5_000_000 }, fd: true }),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_frame_is_lost_at_a_full_bus_of_any_rate_in_virtual_time() {
        for (name, load) in LOADS {
            let soak = in_virtual_time(load, 5_000_000_000);
            assert!(soak.is_whole(), "{name}: {soak:?}");
            assert!(
                soak.busy_ns as f64 > 0.999 * soak.lasted_ns as f64 - 1e6,
                "{name} was not full: {soak:?}"
            );
            assert!(soak.sent > 5 * 5_000, "{name}: {soak:?}");
        }
    }

    #[test]
    fn a_lost_frame_would_show() {
        let (mut numbers, mut expected) = (Numbers::default(), Numbers::default());
        let frames: Vec<Frame> = (0..64).map(|_| numbers.frame(false)).collect();
        let wrong = frames
            .iter()
            .enumerate()
            .filter(|(place, _)| *place != 20)
            .filter(|(_, frame)| !expected.follows(frame));
        assert_eq!(wrong.count(), 1);
    }

    #[test]
    fn no_frame_is_lost_between_real_sockets() {
        // However busy this machine is: a bus waits for nobody, and the gateways have to catch up.
        let soak = in_real_time(LOADS[0].1, Duration::from_millis(500)).unwrap();
        assert_eq!((soak.arrived, soak.out_of_sequence, soak.counted_lost), (soak.sent, 0, 0), "{soak:?}");
        assert!(soak.sent > 1_000, "{soak:?}");
    }
}
