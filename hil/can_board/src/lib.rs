//! The distribution board: the sensors and servos of a simulated aircraft as nodes on a CAN bus.
//!
//! Responsible for: asking a simulator for sensors when the flight computer's question comes over the bus, and saying them as the
//! nodes of the board would. It must never make up a sensor, and never say one of another time than the one asked for.
//!
//! The bus is one in memory, with arbitration and the lengths of frames; its time passes only while there is something on it, so
//! that a flight is the same however quickly it is flown.

mod simulator;

use std::net::{SocketAddr, UdpSocket};

use bateleur_can_core::bus::bits::Rates;
use bateleur_can_core::bus::memory::{MemoryBus, Node, Traffic, Wire};
use bateleur_can_core::{Counters, Frame, Gateway, Settings, identity};
use bateleur_can_map::{Assembly, Outcome, Sync, Table};
use bateleur_messages::ServoTimers;
use zerocopy::{FromBytes, IntoBytes};

pub use simulator::{Answer, Simulator};

/// The bit rate of the bus where no other is given, bit/s: that of the aircraft whose board this stands for.
pub const RATE: u32 = 800_000;

/// See the module's text.
pub struct Board {
    table: Table,
    sync: Sync,
    bus: MemoryBus,
    /// Where the board's sensors and servos are on the bus.
    nodes: Node,
    /// Where the gateway is.
    port: Node,
    servo: Assembly,
    timers: ServoTimers,
    gateway: Gateway,
    socket: UdpSocket,
    simulator: Simulator,
    cycles: u64,
}

impl Board {
    /// A board that listens for gateways at `listen`, and flies the aircraft of the simulator at `simulator`.
    ///
    /// # Errors
    /// An address that can not be had, or a table without the board's ports.
    pub fn new(
        table: Table,
        listen: SocketAddr,
        simulator: SocketAddr,
        rates: Rates,
    ) -> anyhow::Result<Self> {
        let Some(sync) = table.sync() else {
            anyhow::bail!("the table has no [sync]: the board says sensors when it is asked")
        };
        let layout =
            |port: &str| table.layout(port).ok_or_else(|| anyhow::anyhow!("the table has no [port.{port}]"));
        for port in ["raw_analog", "raw_gps", "custom"] {
            layout(port)?;
        }
        let servo = Assembly::new(layout("timers")?.clone());
        let socket =
            UdpSocket::bind(listen).map_err(|error| anyhow::anyhow!("cannot listen on {listen}: {error}"))?;
        socket.set_nonblocking(true)?;
        let name = format!("can_board {}", socket.local_addr()?);
        // It is found; it does not look for anybody.
        let mut gateway =
            Gateway::new(Settings::new(identity::usual_identity(&name, 0), identity::session(), Vec::new()));
        gateway.bus_is_ready();
        gateway.address_is_ready(0);
        let mut bus = MemoryBus::new(Wire::new(rates));
        let (nodes, port) = (bus.attach(), bus.attach());
        let simulator = Simulator::new(simulator)?;
        Ok(Self {
            table,
            sync,
            bus,
            nodes,
            port,
            servo,
            timers: ServoTimers::AT_REST,
            gateway,
            socket,
            simulator,
            cycles: 0,
        })
    }

    /// Where gateways find it.
    ///
    /// # Errors
    /// The system's answer.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// What becomes readable when there is something to do.
    pub fn socket(&self) -> &UdpSocket {
        &self.socket
    }

    /// Questions that were answered.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }

    /// What was on the bus.
    pub fn traffic(&self) -> Traffic {
        self.bus.traffic()
    }

    /// What the gateway counted.
    pub fn counters(&self) -> Counters {
        self.gateway.counters()
    }

    /// When it has something to do by itself, ns of the same clock as [`Board::turn`]'s.
    pub fn due_ns(&self) -> u64 {
        self.gateway.due_ns()
    }

    /// Does what there is to do at `now_ns` of any clock that never goes back.
    pub fn turn(&mut self, now_ns: u64) {
        let mut bytes = [0; 2_048];
        while let Ok((length, from)) = self.socket.recv_from(&mut bytes) {
            let (bus, port) = (&mut self.bus, self.port);
            self.gateway.take_datagram(&bytes[..length], from, now_ns, |frame, _| {
                let _ = bus.send(port, frame); // three at a time; its queue holds more
            });
            self.carry(now_ns);
        }
        let socket = &self.socket;
        self.gateway.run(now_ns, &mut |to, bytes| socket.send_to(bytes, to).is_ok());
        while self.gateway.event().is_some() {}
    }

    /// Lets the bus's time pass until it is idle, and every node act on what it hears.
    fn carry(&mut self, now_ns: u64) {
        while let Some(due_ns) = self.bus.due_ns() {
            self.bus.advance(due_ns);
            while let Some((_, frame)) = self.bus.receive(self.nodes) {
                self.hear(&frame);
            }
            while let Some((_, frame)) = self.bus.receive(self.port) {
                self.gateway.take_frame(&frame, now_ns);
            }
        }
    }

    fn hear(&mut self, frame: &Frame) {
        if frame.id() == self.sync.frame {
            if let Ok(bytes) = frame.data().try_into() {
                self.sample(u64::from_le_bytes(bytes));
            }
        } else if let Outcome::Whole(bytes, 0) = self.servo.take(frame, 0)
            && let Ok(timers) = ServoTimers::read_from_bytes(&bytes)
        {
            self.timers = timers;
        }
    }

    /// The aircraft flies to `module_ns`; the nodes say what their sensors measure there.
    fn sample(&mut self, module_ns: u64) {
        let Some(Answer { analog, gps, custom, range }) = self.simulator.ask(module_ns, &self.timers) else {
            return;
        };
        self.cycles += 1;
        let mut frames = Vec::with_capacity(16);
        let mut say = |port: &str, message: &[u8]| {
            frames.extend(
                self.table.layout(port).map(|layout| layout.frames(message, module_ns)).unwrap_or_default(),
            );
        };
        say("raw_analog", analog.as_bytes());
        custom.iter().for_each(|custom| say("custom", custom.as_bytes()));
        gps.iter().for_each(|gps| say("raw_gps", gps.as_bytes()));
        range.iter().for_each(|range| say("range", range.as_bytes()));
        if let Some(answer) = self.sync.answer {
            frames.push(Frame::classic(answer, &module_ns.to_le_bytes()));
        }
        for frame in &frames {
            let _ = self.bus.send(self.nodes, frame); // some fifteen; its queue holds more
        }
    }
}
