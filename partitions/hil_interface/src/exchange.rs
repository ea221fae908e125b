//! The conversation of one window, in any protocol.

use std::net::SocketAddr;
use std::os::fd::AsFd;

use bateleur_messages::hil::{Actuators, Packet, Protocol};
use bateleur_messages::{ServoTimers, SimulatorLink};

use crate::inbox::{Counters, Inbox, Sensors};
use crate::link::{Chunk, Link, LinkError};
use crate::mavlink::Mavlink;

/// Times that one window looks into the socket at most, so that a flood can not keep it busy for ever. A free-running
/// simulator sends a few datagrams a window, one with steps of its own a few more.
const LOOKS: usize = 32;

/// Times that a window empties the socket of a free-running simulator before it takes what is newest, at 16 datagrams each:
/// more than the system's buffer holds of sensor sets, so that none of them is still there a window later.
const FREE_DRAINS: usize = 20;

/// Times that a question is asked at most. On the wall clock there is time for two; where time stands still until the answer comes, they
/// are many short ones.
const TRIES: usize = 20;
/// The same for a simulator that did not answer the last question either.
const TRIES_AFTER_SILENT_WINDOW: usize = 2;

/// Time, as the executive gives it.
pub trait Waiting {
    /// Module time, ns.
    fn now_ns(&self) -> u64;
    /// Waits until `device` can be read, at the longest until module time `until_ns`; false: nothing came.
    fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool;
    /// The same, by a caller who asks again when nothing came.
    fn wait_shortly(&self, device: &impl AsFd, until_ns: u64) -> bool;
    /// Waits until `device` takes bytes or its connection has failed; false: neither.
    fn wait_writable(&self, device: &impl AsFd, until_ns: u64) -> bool;
}

/// How to talk to the simulator: the function's attributes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings<'a> {
    /// What both speak.
    pub protocol: Protocol,
    /// Where the simulator is; `None`: at its usual port on this machine.
    pub simulator: Option<&'a str>,
    /// Own address; `None`: any.
    pub listen: Option<&'a str>,
    /// The simulator advances to the module's time; otherwise it has its own clock.
    pub lockstep: bool,
    /// MAVLink: number of the system that the flight computer belongs to.
    pub system: u8,
    /// MAVLink: number of the simulator's system; 0: whoever sends sensors first.
    pub simulator_system: u8,
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

/// How the protocol puts it.
#[derive(Debug)]
enum Speech {
    Native,
    Mavlink(Box<Mavlink>),
}

/// The link to a simulator, and what it said.
#[derive(Debug)]
pub struct Conversation {
    protocol: Protocol,
    lockstep: bool,
    link: Link,
    speech: Speech,
    inbox: Inbox,
    question: Vec<u8>,
}

impl Conversation {
    /// Opens the socket. Over TCP the connection is made with the first question.
    ///
    /// # Errors
    /// An address that is none, or an own port that can not be had.
    pub fn open(settings: &Settings<'_>) -> Result<Self, LinkError> {
        let &Settings { protocol, simulator, listen, lockstep, system, simulator_system } = settings;
        Ok(Self {
            protocol,
            lockstep,
            link: Link::open(protocol, simulator, listen)?,
            speech: match protocol {
                Protocol::Native => Speech::Native,
                _ => Speech::Mavlink(Box::new(Mavlink::new(system, simulator_system, lockstep))),
            },
            inbox: Inbox::new(lockstep),
            question: Vec::with_capacity(256),
        })
    }

    /// Where the simulator is.
    pub fn simulator(&self) -> SocketAddr {
        self.link.simulator()
    }

    /// What became of what came.
    pub fn counters(&self) -> &Counters {
        self.inbox.counters()
    }

    /// What the simulator sends that can hardly be meant so, to be told once.
    pub fn remarks(&mut self) -> Vec<String> {
        self.inbox.remarks()
    }

    /// The same counters as a message, at module time `time_ns`.
    pub fn report(&self, time_ns: u64) -> SimulatorLink {
        let counters = self.inbox.counters();
        SimulatorLink {
            time_ns,
            measured_ns: self.inbox.measured_ns(),
            accepted: counters.accepted,
            missing: counters.missing,
            repeated: counters.repeated,
            stale: counters.stale,
            refused: counters.refused,
            unused: counters.unused,
            invalid: counters.invalid,
            lost: counters.lost,
            strangers: counters.strangers,
            errors: counters.errors,
            connections: counters.connections,
            clock_ties: counters.clock_ties,
            protocol: self.protocol as u32,
            lockstep: u32::from(self.lockstep),
        }
    }

    /// Asks the simulator and gives its answer, or what else is new.
    ///
    /// In lockstep it waits for the answer. Where datagrams may be lost, it asks a second time where none came
    /// within a third of the time: one lost datagram in either direction then costs nothing. A simulator that has moved on by a
    /// step of its own is asked again until it has come as far as it shall. With a simulator that has a clock of its own, whatever came
    /// since the last window is taken, and waited for only where there is nothing.
    pub fn exchange(&mut self, timers: &ServoTimers, moment: &Moment, time: &impl Waiting) -> Sensors {
        self.inbox.begin(moment.module_ns);
        self.link.connect(time, moment.deadline_ns, self.inbox.counters_mut());
        self.ask(timers, moment);
        if self.lockstep {
            self.await_answer(timers, moment, time);
        } else {
            for _ in 0..FREE_DRAINS {
                if !self.drain() || time.now_ns() >= moment.deadline_ns {
                    break;
                }
            }
            for _ in 0..LOOKS {
                if self.inbox.has_news() || !self.link.wait(time, moment.deadline_ns, false) {
                    break;
                }
                self.drain();
            }
        }
        if let Speech::Mavlink(mavlink) = &mut self.speech {
            mavlink.finish(&mut self.inbox);
        }
        self.inbox.finish()
    }

    fn await_answer(&mut self, timers: &ServoTimers, moment: &Moment, time: &impl Waiting) {
        let deadline_ns = moment.deadline_ns;
        let left_ns = deadline_ns.saturating_sub(time.now_ns());
        let hopeful = self.inbox.was_answered();
        let tries = match (self.link.is_reliable(), hopeful) {
            (true, _) => 1,
            (false, true) => TRIES,
            (false, false) => TRIES_AFTER_SILENT_WINDOW,
        };
        let mut until_ns = if tries == 1 { deadline_ns } else { deadline_ns - (left_ns - left_ns / 3) };
        let (mut asked, mut looks) = (1, 0);
        while looks < LOOKS {
            let shortly = hopeful && asked < tries;
            if self.link.wait(time, until_ns, shortly) {
                looks += 1;
                self.drain();
                if self.inbox.is_answered() || time.now_ns() >= deadline_ns {
                    break;
                }
                self.ask_on(timers);
            } else if asked == tries || time.now_ns() >= deadline_ns {
                break;
            } else {
                self.link.send(&self.question, self.inbox.counters_mut());
                self.inbox.counters_mut().repeated += 1;
                (asked, until_ns) = (asked + 1, deadline_ns);
            }
        }
    }

    fn ask(&mut self, timers: &ServoTimers, moment: &Moment) {
        self.question.clear();
        match &mut self.speech {
            Speech::Native => {
                let actuators = Actuators::new(moment.module_ns, moment.sequence, timers);
                Packet::Actuators(actuators).write(&mut self.question);
            }
            Speech::Mavlink(mavlink) => mavlink.ask(moment.module_ns, timers, &mut self.question),
        }
        self.link.send(&self.question, self.inbox.counters_mut());
    }

    /// Asks a simulator again that has made a step of its own.
    fn ask_on(&mut self, timers: &ServoTimers) {
        let Speech::Mavlink(mavlink) = &mut self.speech else { return };
        if mavlink.wants_another_question() {
            self.question.clear();
            mavlink.write_question(timers, &mut self.question);
            self.link.send(&self.question, self.inbox.counters_mut());
        }
    }

    /// Takes a part of what has come; false: there was nothing.
    fn drain(&mut self) -> bool {
        let Self { link, speech, inbox, .. } = self;
        let mut came = false;
        let socket = link.drain(|chunk| {
            came = true;
            match (&mut *speech, chunk) {
                (Speech::Mavlink(mavlink), chunk) => mavlink.take(chunk, inbox),
                (Speech::Native, Chunk::Datagram(datagram)) => inbox.take(datagram),
                (Speech::Native, Chunk::Stream(_) | Chunk::End) => {} // it has no streams
            }
        });
        inbox.counters_mut().add_socket(&socket);
        came || socket.strangers > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        time_stands: bool,
    }

    impl World {
        fn new(does: &[Does]) -> (Self, Conversation) {
            Self::timed(does, true)
        }

        fn timed(does: &[Does], lockstep: bool) -> (Self, Conversation) {
            let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
            let address = simulator.local_addr().unwrap().to_string();
            let settings = Settings {
                protocol: Protocol::Native,
                simulator: Some(&address),
                listen: Some("127.0.0.1:0"),
                lockstep,
                system: 1,
                simulator_system: 0,
            };
            let link = Conversation::open(&settings).unwrap();
            simulator.set_nonblocking(true).unwrap();
            let does = RefCell::new(does.iter().rev().copied().collect());
            let (asked, now_ns, waits) = (RefCell::default(), Cell::new(CYCLE), Cell::new(0));
            (Self { simulator, does, asked, now_ns, waits, time_stands: false }, link)
        }

        fn run(&self, conversation: &mut Conversation) -> Sensors {
            self.run_at(conversation, CYCLE)
        }

        fn run_at(&self, conversation: &mut Conversation, module_ns: u64) -> Sensors {
            let moment = Moment { module_ns, sequence: 4, deadline_ns: module_ns + DEADLINE - CYCLE };
            conversation.exchange(&ServoTimers::AT_REST, &moment, self)
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
            if !self.time_stands {
                self.now_ns.set(if came { self.now_ns.get() + 100_000 } else { until_ns });
            }
            came || self.does.borrow().contains(&Does::Flood)
        }

        fn wait_shortly(&self, device: &impl AsFd, until_ns: u64) -> bool {
            self.wait_readable(device, until_ns)
        }

        fn wait_writable(&self, _: &impl AsFd, _: u64) -> bool {
            true
        }
    }

    #[test]
    fn an_answer_ends_the_wait() {
        let (world, mut link) = World::new(&[Does::Answer]);
        let sensors = world.run(&mut link);
        assert_eq!(sensors.analog.map(|analog| analog.measured_ns), Some(CYCLE));
        assert!(sensors.gps.is_some());
        assert_eq!(world.waits.get(), 1);
        let asked = world.asked.borrow();
        assert_eq!((asked[0].module_ns, asked[0].sequence, asked[0].throttle_us), (CYCLE, 4, 1000));
    }

    #[test]
    fn a_lost_datagram_is_asked_for_again_after_a_third_of_the_time() {
        let (world, mut link) = World::new(&[Does::Nothing, Does::Answer]);
        assert!(world.run(&mut link).analog.is_some());
        assert_eq!(world.now_ns.get(), CYCLE + 900_000 + 100_000);
        assert_eq!((link.counters().repeated, link.counters().accepted), (1, 1));
        let asked = world.asked.borrow();
        assert_eq!(asked[0], asked[1]);
    }

    #[test]
    fn a_silent_simulator_costs_the_time_until_the_cut_off_and_no_more() {
        let (world, mut link) = World::new(&[]);
        assert_eq!(world.run(&mut link), Sensors::default());
        assert_eq!((world.now_ns.get(), world.waits.get()), (DEADLINE, 2));
        assert_eq!(link.counters().missing, 1);
    }

    #[test]
    fn where_time_stands_still_a_lossy_link_is_asked_many_times_and_a_dead_one_no_longer() {
        let does: Vec<Does> = [Does::Nothing; 9].into_iter().chain([Does::Answer, Does::Answer]).collect();
        let (mut world, mut link) = World::new(&does);
        world.time_stands = true;
        assert_eq!(world.run(&mut link), Sensors::default(), "nobody has answered before: two attempts");
        assert_eq!(world.asked.borrow().len(), 2);
        world.does.borrow_mut().drain(..).count();
        world.does.borrow_mut().push(Does::Answer);
        assert!(world.run(&mut link).analog.is_some());
        world.does.borrow_mut().extend([Does::Answer].into_iter().chain([Does::Nothing; 9]));
        world.asked.borrow_mut().clear();
        assert!(world.run_at(&mut link, 2 * CYCLE).analog.is_some(), "ten attempts");
        assert_eq!(world.asked.borrow().len(), 10);
        world.asked.borrow_mut().clear();
        assert_eq!(world.run_at(&mut link, 3 * CYCLE), Sensors::default());
        assert_eq!(world.asked.borrow().len(), TRIES);
        assert_eq!(world.run_at(&mut link, 4 * CYCLE), Sensors::default());
        assert_eq!(world.asked.borrow().len(), TRIES + TRIES_AFTER_SILENT_WINDOW);
    }

    #[test]
    fn a_flood_of_garbage_does_not_keep_the_function_busy_for_ever() {
        let (world, mut link) = World::new(&[Does::Flood, Does::Flood, Does::Flood]);
        assert_eq!(world.run(&mut link), Sensors::default());
        assert!(world.waits.get() <= LOOKS);
        assert!(link.counters().refused > 0);
    }

    #[test]
    fn free_running_simulator_that_sends_more_than_sixteen_sets_a_window_is_not_flown_by_ever_older_ones() {
        let (world, mut link) = World::timed(&[], false);
        let own = std::net::SocketAddr::from(([127, 0, 0, 1], link.link.own_port()));
        for cycle in 1..=20 {
            for step in 1..=20 {
                let mut bytes = Vec::new();
                let measured_ns = cycle * CYCLE + step * 1_000_000;
                Packet::Analog(RawAnalog { measured_ns, ..RawAnalog::default() }).write(&mut bytes);
                world.simulator.send_to(&bytes, own).unwrap();
            }
            let taken = world.run_at(&mut link, (cycle + 1) * CYCLE).analog.map(|analog| analog.measured_ns);
            assert_eq!(taken, Some((cycle + 1) * CYCLE), "the newest");
        }
        assert_eq!((link.counters().stale, world.waits.get()), (0, 0));
    }

    #[test]
    fn a_simulator_with_a_clock_of_its_own_is_asked_once_and_waited_for_only_where_there_is_nothing() {
        let (world, mut link) = World::timed(&[Does::Answer], false);
        assert!(world.run(&mut link).analog.is_some());
        assert_eq!(world.waits.get(), 1);
        assert_eq!(world.run(&mut link), Sensors::default());
        assert_eq!((world.waits.get(), link.counters().repeated), (2, 0));
    }
}
