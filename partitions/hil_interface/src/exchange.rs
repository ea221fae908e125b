//! The conversation of one window.

use std::os::fd::AsFd;

use bateleur_messages::ServoTimers;
use bateleur_messages::hil::{Actuators, Packet};

use crate::inbox::{Inbox, Sensors};
use crate::link::Link;

/// Times that one window looks into the socket at most, so that a flood can not keep it busy for ever. A free-running
/// simulator sends a few datagrams a window.
const LOOKS: usize = 32;

/// Time, as the executive gives it.
pub trait Waiting {
    /// Module time, ns.
    fn now_ns(&self) -> u64;
    /// Waits until `device` can be read, at the longest until module time `until_ns`; false: nothing came.
    fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool;
}

/// When the conversation takes place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// Module time to which the simulator shall advance, ns.
    pub module_ns: u64,
    /// Number of the question.
    pub sequence: u64,
    /// Module time at which the answer is no longer waited for, ns.
    pub deadline_ns: u64,
}

/// Asks the simulator and gives its answer, or what else is new. Asks a second time where no answer came within a third
/// of the time: one lost datagram in either direction then costs nothing.
pub fn exchange(
    link: &Link,
    inbox: &mut Inbox,
    timers: &ServoTimers,
    moment: &Moment,
    time: &impl Waiting,
) -> Sensors {
    let mut question = Vec::with_capacity(128);
    Packet::Actuators(Actuators::new(moment.module_ns, moment.sequence, timers)).write(&mut question);
    inbox.begin(moment.module_ns);
    link.send(&question, inbox);
    let left_ns = moment.deadline_ns.saturating_sub(time.now_ns());
    let mut until_ns = moment.deadline_ns.saturating_sub(left_ns - left_ns / 3);
    let mut asked_again = false;
    for _ in 0..LOOKS {
        if time.wait_readable(link, until_ns) {
            link.drain(inbox);
            if inbox.is_answered() || time.now_ns() >= moment.deadline_ns {
                break;
            }
        } else if asked_again {
            break;
        } else {
            link.send(&question, inbox);
            inbox.counters_mut().repeated += 1;
            (asked_again, until_ns) = (true, moment.deadline_ns);
        }
    }
    inbox.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AT_REST;
    use bateleur_messages::frame::Decoder;
    use bateleur_messages::{RawAnalog, RawGps};
    use std::cell::{Cell, RefCell};
    use std::net::UdpSocket;

    const CYCLE: u64 = 20_000_000;
    const DEADLINE: u64 = CYCLE + 2_700_000;

    /// What the simulator does with a question.
    #[derive(Clone, Copy, PartialEq)]
    enum Does {
        Answer,
        Nothing,
        Flood,
    }

    /// A simulator that acts whenever the function waits, and time that passes then.
    struct World {
        simulator: UdpSocket,
        does: RefCell<Vec<Does>>,
        asked: RefCell<Vec<Actuators>>,
        now_ns: Cell<u64>,
        waits: Cell<usize>,
    }

    impl World {
        fn new(does: &[Does]) -> (Self, Link) {
            let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
            let link = Link::open(&simulator.local_addr().unwrap().to_string(), "127.0.0.1:0").unwrap();
            simulator.set_nonblocking(true).unwrap();
            let does = RefCell::new(does.iter().rev().copied().collect());
            let (asked, now_ns, waits) = (RefCell::default(), Cell::new(CYCLE), Cell::new(0));
            (Self { simulator, does, asked, now_ns, waits }, link)
        }

        fn run(&self, link: &Link, inbox: &mut Inbox) -> Sensors {
            let moment = Moment { module_ns: CYCLE, sequence: 4, deadline_ns: DEADLINE };
            exchange(link, inbox, &AT_REST, &moment, self)
        }

        fn answer(&self, question: &Actuators, to: std::net::SocketAddr) {
            let mut bytes = Vec::new();
            let analog = RawAnalog { measured_ns: question.module_ns, ..RawAnalog::default() };
            Packet::Analog(analog).write(&mut bytes);
            Packet::Gps(RawGps { measured_ns: 3, ..RawGps::default() }).write(&mut bytes);
            self.simulator.send_to(&bytes, to).unwrap();
        }
    }

    impl Waiting for World {
        fn now_ns(&self) -> u64 {
            self.now_ns.get()
        }

        fn wait_readable(&self, _: &impl AsFd, until_ns: u64) -> bool {
            self.waits.set(self.waits.get() + 1);
            let mut bytes = [0; 512];
            let mut came = false;
            while let Ok((length, from)) = self.simulator.recv_from(&mut bytes) {
                let frame = Decoder::new().extend(&bytes[..length]).next().unwrap();
                let Ok(Packet::Actuators(question)) = Packet::of(&frame) else { panic!() };
                self.asked.borrow_mut().push(question);
                let does = self.does.borrow_mut().pop().unwrap_or(Does::Nothing);
                match does {
                    Does::Answer => self.answer(&question, from),
                    Does::Flood => (0..2_000).for_each(|_| drop(self.simulator.send_to(b"$", from))),
                    Does::Nothing => {}
                }
                came |= does != Does::Nothing;
            }
            self.now_ns.set(if came { self.now_ns.get() + 100_000 } else { until_ns });
            came || self.does.borrow().contains(&Does::Flood)
        }
    }

    #[test]
    fn an_answer_ends_the_wait() {
        let (world, link) = World::new(&[Does::Answer]);
        let mut inbox = Inbox::new();
        let sensors = world.run(&link, &mut inbox);
        assert_eq!(sensors.analog.map(|analog| analog.measured_ns), Some(CYCLE));
        assert!(sensors.gps.is_some());
        assert_eq!(world.waits.get(), 1);
        let asked = world.asked.borrow();
        assert_eq!((asked[0].module_ns, asked[0].sequence, asked[0].throttle_us), (CYCLE, 4, 1000));
    }

    #[test]
    fn a_lost_datagram_is_asked_for_again_after_a_third_of_the_time() {
        let (world, link) = World::new(&[Does::Nothing, Does::Answer]);
        let mut inbox = Inbox::new();
        assert!(world.run(&link, &mut inbox).analog.is_some());
        assert_eq!(world.now_ns.get(), CYCLE + 900_000 + 100_000);
        assert_eq!((inbox.counters().repeated, inbox.counters().accepted), (1, 1));
        let asked = world.asked.borrow();
        assert_eq!(asked[0], asked[1]);
    }

    #[test]
    fn a_silent_simulator_costs_the_time_until_the_cut_off_and_no_more() {
        let (world, link) = World::new(&[]);
        let mut inbox = Inbox::new();
        assert_eq!(world.run(&link, &mut inbox), Sensors::default());
        assert_eq!((world.now_ns.get(), world.waits.get()), (DEADLINE, 2));
        assert_eq!(inbox.counters().missing, 1);
    }

    #[test]
    fn a_flood_of_garbage_does_not_keep_the_function_busy_for_ever() {
        let (world, link) = World::new(&[Does::Flood, Does::Flood, Does::Flood]);
        let mut inbox = Inbox::new();
        assert_eq!(world.run(&link, &mut inbox), Sensors::default());
        assert!(world.waits.get() <= LOOKS);
        assert!(inbox.counters().refused > 0);
    }
}
