//! A bus in memory: arbitration by identifier, frames as long as their bits, errors where they are wanted. It has no clock;
//! whoever uses it says how late it is.
//!
//! Responsible for: behaving as controllers on a wire do, as far as that decides which frame comes when and which not at all.

use std::collections::{BTreeMap, VecDeque};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::bits::{self, ERROR_BITS, Rates};
use super::{BusState, Sent};
use crate::frame::{Frame, Id, Kind};

/// Error counter from which on a controller is passive.
const PASSIVE: u32 = 128;
/// Error counter from which on it is off the bus.
const OFF: u32 = 256;
/// Recessive bits that a controller waits for before it takes part again: 128 times eleven.
const RECOVERY_BITS: u64 = 128 * 11;

/// Classes of errors in the words of Linux (`linux/can/error.h`).
mod class {
    /// Problems of the controller; the second byte says which.
    pub(super) const CONTROLLER: u32 = 0x04;
    /// Off the bus.
    pub(super) const BUS_OFF: u32 = 0x40;
    /// Taking part again.
    pub(super) const RESTARTED: u32 = 0x100;
    /// Second byte: passive by what was sent, active again.
    pub(super) const TX_PASSIVE: u8 = 0x20;
    pub(super) const ACTIVE: u8 = 0x40;
}

/// What a bus is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wire {
    /// Bit rates.
    pub rates: Rates,
    /// Share of the frames that are destroyed on the wire; their senders send them again.
    pub error_share: f64,
    /// Seed of that chance.
    pub seed: u64,
    /// Frames that a controller holds for sending, at most.
    pub queue: usize,
    /// Frames that a controller holds for its computer, at most; more are lost and counted.
    pub inbox: usize,
    /// A controller that went off the bus is restarted after so long, ns; `None` if it stays off.
    pub restart_after_ns: Option<u64>,
}

impl Wire {
    /// Without errors, at these rates.
    pub fn new(rates: Rates) -> Self {
        Self {
            rates,
            error_share: 0.0,
            seed: 1,
            queue: 64,
            inbox: 65_536,
            restart_after_ns: Some(100_000_000),
        }
    }
}

/// A controller on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node(usize);

/// What happened on the wire.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames that arrived.
    pub frames: u64,
    /// Frames that were destroyed, and sent again.
    pub destroyed: u64,
    /// Time in which the wire was not idle, ns.
    pub busy_ns: u64,
    /// Times that a frame had to wait for one of a lower identifier.
    pub arbitrations_lost: u64,
}

#[derive(Debug, Default)]
struct Controller {
    /// By priority, then by age.
    outbox: BTreeMap<(u64, u64), Frame>,
    inbox: VecDeque<(u64, Frame)>,
    overflow: u64,
    errors_sent: u32,
    errors_heard: u32,
    off_until_ns: Option<u64>,
    is_off: bool,
}

#[derive(Debug)]
struct Transmission {
    sender: usize,
    key: (u64, u64),
    end_ns: u64,
    destroyed: bool,
}

/// See the module's text.
#[derive(Debug)]
pub struct MemoryBus {
    wire: Wire,
    now_ns: u64,
    nodes: Vec<Controller>,
    under_way: Option<Transmission>,
    chance: ChaCha8Rng,
    destroy_next: u64,
    accepted: u64,
    traffic: Traffic,
}

impl MemoryBus {
    /// An idle bus at time 0.
    pub fn new(wire: Wire) -> Self {
        Self {
            wire,
            now_ns: 0,
            nodes: Vec::new(),
            under_way: None,
            chance: ChaCha8Rng::seed_from_u64(wire.seed),
            destroy_next: 0,
            accepted: 0,
            traffic: Traffic::default(),
        }
    }

    /// Another controller.
    pub fn attach(&mut self) -> Node {
        self.nodes.push(Controller::default());
        Node(self.nodes.len() - 1)
    }

    /// How late it is, ns.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// What happened so far.
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Destroys the next so many frames.
    pub fn destroy(&mut self, frames: u64) {
        self.destroy_next = frames;
    }

    /// How a controller is.
    pub fn state(&self, node: Node) -> BusState {
        let Controller { is_off, errors_sent, errors_heard, .. } = self.nodes[node.0];
        match (is_off, errors_sent.max(errors_heard)) {
            (true, _) => BusState::Off,
            (false, PASSIVE..) => BusState::Passive,
            _ => BusState::Active,
        }
    }

    /// Frames that a controller lost because its computer did not fetch them.
    pub fn overflow(&self, node: Node) -> u64 {
        self.nodes[node.0].overflow
    }

    /// Frames that a controller still has to send.
    pub fn pending(&self, node: Node) -> usize {
        self.nodes[node.0].outbox.len()
    }

    /// Gives a controller a frame to send, now.
    pub fn send(&mut self, node: Node, frame: &Frame) -> Sent {
        let controller = &mut self.nodes[node.0];
        if !frame.is_of_the_bus() {
            return Sent::Refused;
        }
        if controller.outbox.len() >= self.wire.queue {
            return Sent::Full;
        }
        controller.outbox.insert((frame.priority(), self.accepted), *frame);
        self.accepted += 1;
        Sent::Taken
    }

    /// What a controller heard, with the time at which the frame had come.
    pub fn receive(&mut self, node: Node) -> Option<(u64, Frame)> {
        self.nodes[node.0].inbox.pop_front()
    }

    /// When something happens next by itself, ns; `None` if the bus is idle for as long as nobody sends.
    pub fn due_ns(&self) -> Option<u64> {
        if let Some(under_way) = &self.under_way {
            return Some(under_way.end_ns);
        }
        if self.nodes.iter().any(|node| !node.is_off && !node.outbox.is_empty()) {
            return Some(self.now_ns);
        }
        self.nodes.iter().filter_map(|node| node.off_until_ns).min()
    }

    /// Lets time pass until `to_ns`.
    pub fn advance(&mut self, to_ns: u64) {
        loop {
            self.restart_controllers();
            if self.under_way.is_none() {
                self.arbitrate();
            }
            match self.under_way.take() {
                Some(under_way) if under_way.end_ns <= to_ns => self.finish(&under_way),
                Some(under_way) => {
                    self.under_way = Some(under_way);
                    break;
                }
                None => match self.nodes.iter().filter_map(|node| node.off_until_ns).min() {
                    Some(back_ns) if back_ns <= to_ns => self.now_ns = self.now_ns.max(back_ns),
                    _ => break,
                },
            }
        }
        self.now_ns = self.now_ns.max(to_ns);
    }

    /// Whoever has the lowest identifier begins to send.
    fn arbitrate(&mut self) {
        let candidates = self.nodes.iter().enumerate().filter(|(_, node)| !node.is_off);
        let firsts = candidates.filter_map(|(place, node)| Some((*node.outbox.first_key_value()?.0, place)));
        let (mut best, mut contenders) = (None, 0);
        for first in firsts {
            contenders += 1;
            if best.is_none_or(|best| first < best) {
                best = Some(first);
            }
        }
        let Some((key, sender)) = best else { return };
        self.traffic.arbitrations_lost += contenders - 1;
        let Some(frame) = self.nodes[sender].outbox.get(&key) else { return };
        let whole_ns = bits::bits(frame).duration_ns(self.wire.rates);
        let destroyed = self.is_destroyed();
        let lasts_ns = match destroyed {
            true => {
                let error = bits::Bits { nominal: ERROR_BITS, data: 0 }.duration_ns(self.wire.rates);
                self.chance.random_range(0..=whole_ns) + error
            }
            false => whole_ns,
        };
        self.under_way = Some(Transmission { sender, key, end_ns: self.now_ns + lasts_ns, destroyed });
        self.traffic.busy_ns += lasts_ns;
    }

    fn is_destroyed(&mut self) -> bool {
        if self.destroy_next > 0 {
            self.destroy_next -= 1;
            return true;
        }
        self.wire.error_share > 0.0 && self.chance.random_bool(self.wire.error_share.min(1.0))
    }

    fn finish(&mut self, under_way: &Transmission) {
        let &Transmission { sender, key, end_ns, destroyed } = under_way;
        self.now_ns = end_ns;
        if destroyed {
            self.traffic.destroyed += 1;
            self.punish(sender);
            return;
        }
        let Some(frame) = self.nodes[sender].outbox.remove(&key) else { return };
        self.traffic.frames += 1;
        for place in 0..self.nodes.len() {
            let node = &mut self.nodes[place];
            if place == sender {
                let was_passive = node.errors_sent >= PASSIVE;
                node.errors_sent = node.errors_sent.saturating_sub(1);
                if was_passive && node.errors_sent < PASSIVE {
                    self.report(place, class::CONTROLLER, class::ACTIVE);
                }
            } else if !node.is_off {
                node.errors_heard = node.errors_heard.saturating_sub(1);
                self.deliver(place, frame);
            }
        }
    }

    /// An error on the wire: eight for the sender, one for each listener.
    fn punish(&mut self, sender: usize) {
        for place in 0..self.nodes.len() {
            let node = &mut self.nodes[place];
            if node.is_off {
                continue;
            }
            if place != sender {
                node.errors_heard = (node.errors_heard + 1).min(PASSIVE);
                continue;
            }
            let before = node.errors_sent;
            node.errors_sent += 8;
            let after = node.errors_sent;
            if after >= OFF {
                node.is_off = true;
                let recovery = bits::Bits { nominal: RECOVERY_BITS, data: 0 }.duration_ns(self.wire.rates);
                node.off_until_ns =
                    self.wire.restart_after_ns.map(|wait_ns| self.now_ns + wait_ns + recovery);
                self.report(place, class::BUS_OFF, 0);
            } else if before < PASSIVE && after >= PASSIVE {
                self.report(place, class::CONTROLLER, class::TX_PASSIVE);
            }
        }
    }

    fn restart_controllers(&mut self) {
        for place in 0..self.nodes.len() {
            let node = &mut self.nodes[place];
            if node.off_until_ns.is_some_and(|back_ns| back_ns <= self.now_ns) {
                (node.is_off, node.off_until_ns, node.errors_sent, node.errors_heard) = (false, None, 0, 0);
                self.report(place, class::RESTARTED, 0);
            }
        }
    }

    fn report(&mut self, place: usize, class: u32, detail: u8) {
        let data = [0, detail, 0, 0, 0, 0, 0, 0];
        if let Ok(frame) = Frame::new(Id::Extended(class), Kind::Error, &data) {
            self.deliver(place, frame);
        }
    }

    fn deliver(&mut self, place: usize, frame: Frame) {
        let node = &mut self.nodes[place];
        if node.inbox.len() >= self.wire.inbox {
            node.overflow += 1;
        } else {
            node.inbox.push_back((self.now_ns, frame));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: Rates = Rates::classic(1_000_000);
    const SECOND: u64 = 1_000_000_000;

    fn bus() -> (MemoryBus, Node, Node, Node) {
        let mut bus = MemoryBus::new(Wire::new(RATE));
        let nodes = [(); 3].map(|()| bus.attach());
        (bus, nodes[0], nodes[1], nodes[2])
    }

    fn frame(id: u16) -> Frame {
        Frame::classic(Id::Standard(id), &[0x55; 8])
    }

    fn heard(bus: &mut MemoryBus, node: Node) -> Vec<(u64, Frame)> {
        std::iter::from_fn(|| bus.receive(node)).collect()
    }

    #[test]
    fn the_lowest_identifier_wins_and_each_frame_takes_its_bits() {
        let (mut bus, a, b, c) = bus();
        for (node, id) in [(a, 0x300), (b, 0x100), (a, 0x200)] {
            assert_eq!(bus.send(node, &frame(id)), Sent::Taken);
        }
        bus.advance(SECOND);
        let all = heard(&mut bus, c);
        assert_eq!(
            all.iter().map(|(_, frame)| *frame).collect::<Vec<_>>(),
            [frame(0x100), frame(0x200), frame(0x300)]
        );
        let mut end_ns = 0;
        for (time_ns, frame) in all {
            end_ns += bits::bits(&frame).nominal * 1_000;
            assert_eq!(time_ns, end_ns, "one after the other, without a gap");
        }
        assert_eq!(
            heard(&mut bus, a),
            [heard(&mut bus, c), vec![(bits::bits(&frame(0x100)).nominal * 1_000, frame(0x100))]].concat()
        );
        assert_eq!((bus.traffic().frames, bus.traffic().busy_ns), (3, end_ns));
        assert_eq!(bus.now_ns(), SECOND);
    }

    #[test]
    fn a_frame_that_comes_while_another_is_sent_waits_for_its_end() {
        let (mut bus, a, b, c) = bus();
        bus.send(a, &frame(0x700));
        bus.advance(50_000);
        bus.send(b, &frame(0x001));
        bus.advance(SECOND);
        let order: Vec<Frame> = heard(&mut bus, c).into_iter().map(|(_, frame)| frame).collect();
        assert_eq!(order, [frame(0x700), frame(0x001)]);
    }

    #[test]
    fn a_destroyed_frame_is_sent_again_and_costs_time() {
        let (mut bus, a, b, _) = bus();
        bus.destroy(2);
        bus.send(a, &frame(1));
        bus.advance(SECOND);
        let heard = heard(&mut bus, b);
        assert_eq!(heard.len(), 1);
        assert!(heard[0].0 > (bits::bits(&frame(1)).nominal + 2 * ERROR_BITS) * 1_000);
        assert_eq!(bus.traffic().destroyed, 2);
        assert_eq!(bus.state(a), BusState::Active);
    }

    #[test]
    fn many_errors_make_a_controller_passive_then_off_and_it_comes_back() {
        let (mut bus, a, b, _) = bus();
        bus.destroy(32);
        bus.send(a, &frame(1));
        bus.advance(20_000_000);
        assert_eq!(bus.state(a), BusState::Off);
        let told: Vec<u32> = heard(&mut bus, a).iter().map(|(_, frame)| frame.word() & 0x1fff_ffff).collect();
        assert_eq!(told, [class::CONTROLLER, class::BUS_OFF]);
        bus.send(b, &frame(2));
        bus.advance(30_000_000);
        assert!(heard(&mut bus, a).is_empty(), "off the bus it hears nothing");
        bus.advance(SECOND);
        assert_eq!(bus.state(a), BusState::Active);
        let (_, back) = heard(&mut bus, b)[0];
        assert_eq!(back, frame(1), "what it had to send is not lost");
        assert_eq!(heard(&mut bus, a)[0].1.word() & 0x1fff_ffff, class::RESTARTED);
    }

    #[test]
    fn full_queues_refuse_and_full_inboxes_count() {
        let mut bus = MemoryBus::new(Wire { queue: 2, inbox: 1, ..Wire::new(RATE) });
        let (a, b) = (bus.attach(), bus.attach());
        let taken: Vec<Sent> = (0..3).map(|id| bus.send(a, &frame(id))).collect();
        assert_eq!(taken, [Sent::Taken, Sent::Taken, Sent::Full]);
        bus.advance(SECOND);
        assert_eq!((heard(&mut bus, b).len(), bus.overflow(b)), (1, 1));
    }

    #[test]
    fn a_share_of_errors_is_what_was_asked_for_and_the_same_for_a_seed() {
        let run = |seed| {
            let mut bus = MemoryBus::new(Wire { error_share: 0.1, seed, ..Wire::new(RATE) });
            let (a, b) = (bus.attach(), bus.attach());
            for number in 0..2_000_u64 {
                bus.send(a, &frame((number % 2_000) as u16 & 0x7ff));
                bus.advance((number + 1) * 1_000_000);
            }
            assert_eq!(heard(&mut bus, b).iter().filter(|(_, frame)| frame.is_of_the_bus()).count(), 2_000);
            bus.traffic()
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
        assert!((150..300).contains(&run(3).destroyed), "{:?}", run(3));
    }
}
