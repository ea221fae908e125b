//! A gateway with its sockets, on the clock of a machine: one thread, one loop, nothing in it waits but the loop itself.
//!
//! Responsible for: moving bytes between a bus, a UDP socket, socketcand's clients and [`Gateway`], opening again what broke, and
//! saying what a person should hear of. It decides nothing about frames.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use bateleur_can_core::bus::room::keep_more;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::time::{ClockId, clock_gettime};

use crate::server::{Server, ServerOptions};
use crate::status::{Status, Teller};
use bateleur_can_core::Counters;
use bateleur_can_core::Ids;
use bateleur_can_core::bus::replay::Log;
use bateleur_can_core::bus::{Bus, BusError, BusName, BusState, Losses, Sent};
use bateleur_can_core::{Gateway, Settings};
use bateleur_can_core::{Ring, Rules};

/// How soon a stop is noticed, at the latest, ns.
const STOP_NS: u64 = 100_000_000;
/// A bus or an address that is not there is tried again so often, ns.
const RETRY_NS: u64 = 1_000_000_000;
/// A bus whose queue is full is tried again after so long, ns: two frames at 1 Mbit/s.
const FULL_NS: u64 = 250_000;
/// Frames, and datagrams, taken in one turn at most, so that one side can not keep the other waiting.
const PER_TURN: usize = 256;

/// What a gateway is made of.
#[derive(Debug, Clone)]
pub struct Options {
    /// Its name, for people and for its status.
    pub name: String,
    /// Its bus.
    pub bus: BusName,
    /// Its UDP address.
    pub listen: SocketAddr,
    /// How it behaves.
    pub settings: Settings,
    /// What the ring between network and bus does.
    pub to_bus: Rules,
    /// The socketcand server beside it.
    pub server: Option<ServerOptions>,
    /// Where its status is told.
    pub status: Option<PathBuf>,
    /// A log of all frames, as candump writes it.
    pub log: Option<PathBuf>,
}

/// Why a gateway can not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Its bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Its UDP port.
    #[error(
        "cannot listen on {address} for datagrams: {error}; another gateway has it, or it is none of this computer's (--listen)"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's answer.
        error: io::Error,
    },
    /// The server's port.
    #[error("cannot listen on {address} for socketcand's clients: {error} (--socketcand)")]
    Server {
        /// The address.
        address: SocketAddr,
        /// The system's answer.
        error: io::Error,
    },
    /// The status.
    #[error("cannot tell the status at {path}: {error}")]
    Status {
        /// The socket.
        path: String,
        /// The system's answer.
        error: io::Error,
    },
    /// The log.
    #[error("cannot write the log {path}: {error}")]
    Log {
        /// The file.
        path: String,
        /// The system's answer.
        error: io::Error,
    },
}

/// A running gateway.
pub struct Node {
    options: Options,
    gateway: Gateway,
    bus: Option<Box<dyn Bus>>,
    bus_ended: bool,
    bus_at_ns: u64,
    /// Why it is not there, as it was told last.
    bus_error: String,
    /// The state that was told last.
    bus_state: BusState,
    socket: Option<UdpSocket>,
    socket_at_ns: u64,
    server: Option<Server>,
    teller: Option<Teller>,
    log: Option<Log>,
    to_bus: Ring,
    full_until_ns: u64,
    own: Own,
    /// Of buses that were opened before the one that is there.
    former_losses: Losses,
    /// When they are looked at next, ns, and when they are told next: where they have become twice as many.
    losses_at_ns: u64,
    losses_told: Losses,
    begun_ns: u64,
}

/// What the loop itself counts.
#[derive(Debug, Clone, Copy, Default)]
struct Own {
    bus_out: u64,
    bus_refused: u64,
    bus_off: u64,
    bus_reopened: u64,
}

/// CLOCK_MONOTONIC, ns.
pub fn now_ns() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Time since 1970, ns: what clients of socketcand are told.
fn time_of_day_ns() -> u64 {
    let time = clock_gettime(ClockId::Realtime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

impl Node {
    /// Opens bus, log, server and status. An address that this computer does not have yet is waited for.
    ///
    /// # Errors
    /// What can not be had, and what helps.
    pub fn new(options: Options) -> Result<Self, StartError> {
        let bus = options.bus.open(&let_through(&options.settings, options.server.is_some()))?;
        Self::with_bus(options, bus)
    }

    /// The same with a bus of the caller's.
    ///
    /// # Errors
    /// What can not be had, and what helps.
    pub fn with_bus(options: Options, bus: Box<dyn Bus>) -> Result<Self, StartError> {
        let server = match options.server.clone() {
            Some(server) => {
                let address = server.listen;
                Some(Server::bind(server).map_err(|error| StartError::Server { address, error })?)
            }
            None => None,
        };
        let teller = match &options.status {
            Some(path) => {
                let wrong = |error| StartError::Status { path: path.display().to_string(), error };
                Some(Teller::bind(path).map_err(wrong)?)
            }
            None => None,
        };
        let log = match &options.log {
            Some(path) => {
                let wrong = |error| StartError::Log { path: path.display().to_string(), error };
                Some(Log::open(path, &options.bus.to_string()).map_err(wrong)?)
            }
            None => None,
        };
        let mut node = Self {
            gateway: Gateway::new(options.settings.clone()),
            to_bus: Ring::new(options.to_bus.clone()),
            options,
            bus: Some(bus),
            bus_ended: false,
            bus_at_ns: 0,
            bus_error: String::new(),
            bus_state: BusState::Active,
            socket: None,
            socket_at_ns: 0,
            server,
            teller,
            log,
            full_until_ns: 0,
            own: Own::default(),
            former_losses: Losses::default(),
            losses_at_ns: 0,
            losses_told: Losses::default(),
            begun_ns: now_ns(),
        };
        node.gateway.bus_is_ready();
        node.open_socket(now_ns())?;
        Ok(node)
    }

    /// Where it listens for datagrams, as soon as it does.
    pub fn address(&self) -> Option<SocketAddr> {
        self.socket.as_ref()?.local_addr().ok()
    }

    /// Where it listens for clients of socketcand.
    pub fn server_address(&self) -> Option<SocketAddr> {
        self.server.as_ref().map(Server::address)
    }

    /// What became of everything.
    pub fn counters(&self) -> Counters {
        let Own { bus_out, bus_refused, bus_off, bus_reopened } = self.own;
        let to_bus = self.to_bus.given_up();
        let Losses { unkept: bus_unkept, denied: adapter_denied } = self.losses();
        let counters = self.gateway.counters();
        Counters {
            to_bus,
            bus_out,
            bus_refused,
            bus_off,
            bus_reopened,
            bus_unkept,
            adapter_denied,
            log_unwritten: self.log.as_ref().map_or(0, |log| log.failed),
            ..counters
        }
    }

    fn losses(&self) -> Losses {
        self.former_losses + self.bus.as_ref().map(|bus| bus.losses()).unwrap_or_default()
    }

    /// Everything about it.
    pub fn status(&self) -> Status {
        let now_ns = now_ns();
        let counters = self.counters();
        Status {
            name: self.options.name.clone(),
            pid: std::process::id(),
            uptime_s: now_ns.saturating_sub(self.begun_ns) as f64 * 1e-9,
            bus: self.options.bus.to_string(),
            bus_state: self.bus.as_ref().map(|bus| bus.state()),
            state: self.gateway.state(),
            protocol: self.options.settings.protocol,
            identity: format!("{:016x}", self.options.settings.identity),
            address: self.address(),
            same_identity: self.gateway.conflict(now_ns),
            waiting_for_network: self.gateway.waiting(),
            waiting_for_bus: self.to_bus.len(),
            targets: self.gateway.targets(now_ns),
            lost_frames: counters.lost(),
            counters,
            server: self.server.as_ref().map(Server::counters),
        }
    }

    /// Runs until `stop`; `say` is told what a person should hear of.
    pub fn run(&mut self, stop: &AtomicBool, say: &mut dyn FnMut(&str)) {
        while !stop.load(Ordering::Relaxed) {
            self.turn(STOP_NS, say);
        }
        let socket = self.socket.take();
        self.gateway.leave(now_ns(), &mut |to, bytes| put(socket.as_ref(), to, bytes));
        if let Some(log) = &mut self.log {
            log.flush();
        }
    }

    /// Waits until there is something to do, `at_most_ns` at the longest, and does it.
    pub fn turn(&mut self, at_most_ns: u64, say: &mut dyn FnMut(&str)) {
        let now_ns = now_ns();
        let due_ns = self.due_ns().min(now_ns.saturating_add(at_most_ns));
        self.wait(due_ns.saturating_sub(now_ns));
        self.mend(say);
        self.hear_bus(say);
        self.hear_clients();
        self.hear_network();
        self.feed_bus(say);
        let socket = self.socket.as_ref();
        self.gateway.run(self::now_ns(), &mut |to, bytes| put(socket, to, bytes));
        while let Some(event) = self.gateway.event() {
            say(&event.to_string());
        }
        if let Some(teller) = &self.teller {
            teller.answer(|| self.status());
        }
    }

    fn due_ns(&self) -> u64 {
        let mut due_ns = self.gateway.due_ns();
        match &self.bus {
            Some(bus) => due_ns = due_ns.min(bus.due_ns()),
            None if self.bus_ended => {}
            None => due_ns = due_ns.min(self.bus_at_ns),
        }
        if self.socket.is_none() {
            due_ns = due_ns.min(self.socket_at_ns);
        }
        if !self.to_bus.is_empty() {
            due_ns = due_ns.min(self.full_until_ns);
        }
        self.server.as_ref().map_or(due_ns, |server| due_ns.min(server.due_ns()))
    }

    fn wait(&self, ns: u64) {
        fn reads(fd: BorrowedFd<'_>) -> PollFd<'_> {
            PollFd::from_borrowed_fd(fd, PollFlags::IN)
        }
        let mut set: Vec<PollFd<'_>> = Vec::with_capacity(8);
        set.extend(self.bus.as_ref().and_then(|bus| bus.readable()).map(reads));
        set.extend(self.socket.as_ref().map(|socket| reads(socket.as_fd())));
        set.extend(self.teller.as_ref().map(|teller| reads(teller.descriptor())));
        let clients = self.server.iter().flat_map(Server::descriptors).map(|(fd, writes)| {
            let flags = if writes { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
            PollFd::from_borrowed_fd(fd, flags)
        });
        set.extend(clients);
        let time = Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 };
        let _ = poll(&mut set, Some(&time)); // interrupted: look anyway
    }

    /// Opens what is not there, where it is time to try.
    fn mend(&mut self, say: &mut dyn FnMut(&str)) {
        let now_ns = now_ns();
        if self.bus.is_none() && !self.bus_ended && now_ns >= self.bus_at_ns {
            self.bus_at_ns = now_ns + RETRY_NS;
            let wanted = let_through(&self.options.settings, self.server.is_some());
            match self.options.bus.open(&wanted) {
                Ok(bus) => {
                    say(&format!("{} is there again", self.options.bus));
                    self.own.bus_reopened += 1;
                    self.bus = Some(bus);
                }
                Err(error) => self.tell_bus_error(&error, say),
            }
        }
        if self.socket.is_none()
            && now_ns >= self.socket_at_ns
            && let Err(error) = self.open_socket(now_ns)
        {
            say(&error.to_string());
        }
    }

    fn open_socket(&mut self, now_ns: u64) -> Result<(), StartError> {
        let address = self.options.listen;
        self.socket_at_ns = now_ns + RETRY_NS;
        let open = || {
            let socket = UdpSocket::bind(address)?;
            socket.set_nonblocking(true)?;
            socket.set_broadcast(true)?;
            keep_more(&socket);
            io::Result::Ok(socket)
        };
        match open() {
            Ok(socket) => {
                self.socket = Some(socket);
                self.gateway.address_is_ready(now_ns);
                Ok(())
            }
            // It has no such address yet: whoever gives addresses is slower.
            Err(error) if error.kind() == ErrorKind::AddrNotAvailable => Ok(()),
            Err(error) => Err(StartError::Listen { address, error }),
        }
    }

    fn hear_bus(&mut self, say: &mut dyn FnMut(&str)) {
        let now_ns = now_ns();
        let Some(bus) = &mut self.bus else { return };
        let mut result = bus.tend(now_ns);
        for _ in 0..PER_TURN {
            if result.is_err() {
                break;
            }
            match bus.receive() {
                Ok(Some(frame)) => {
                    self.gateway.take_frame(&frame, now_ns);
                    if let Some(server) = &mut self.server {
                        server.tell(&frame, time_of_day_ns());
                    }
                    if let Some(log) = &mut self.log {
                        log.note(&frame);
                    }
                }
                Ok(None) => break,
                Err(error) => result = Err(error),
            }
        }
        let state = bus.state();
        if state != self.bus_state {
            self.own.bus_off += u64::from(state == BusState::Off);
            say(&format!("{}: the controller is {state}", self.options.bus));
            self.bus_state = state;
            self.full_until_ns = 0;
        }
        bus.complaint().iter().for_each(|complaint| say(complaint));
        if let Err(error) = result {
            self.give_up_bus(&error, say);
        }
        self.tell_losses(now_ns, say);
    }

    fn tell_losses(&mut self, now_ns: u64, say: &mut dyn FnMut(&str)) {
        if now_ns < self.losses_at_ns {
            return;
        }
        self.losses_at_ns = now_ns + RETRY_NS;
        let losses = self.losses();
        losses.tell(&mut self.losses_told, &self.options.bus, say);
    }

    /// A bus that is away for long fails for the same reason every second.
    fn tell_bus_error(&mut self, error: &BusError, say: &mut dyn FnMut(&str)) {
        let error = error.to_string();
        if error != self.bus_error {
            say(&error);
            self.bus_error = error;
        }
    }

    fn give_up_bus(&mut self, error: &BusError, say: &mut dyn FnMut(&str)) {
        self.bus_error.clear();
        self.tell_bus_error(error, say);
        self.former_losses = self.losses();
        self.bus = None;
        self.bus_ended = matches!(self.options.bus, BusName::Replay(_));
        self.bus_at_ns = now_ns() + RETRY_NS;
        if let Some(log) = &mut self.log {
            log.flush();
        }
    }

    fn hear_clients(&mut self) {
        let Some(server) = &mut self.server else { return };
        let now_ns = now_ns();
        let (gateway, to_bus, log) = (&mut self.gateway, &mut self.to_bus, &mut self.log);
        server.turn(now_ns, time_of_day_ns(), |frame| {
            // A client is on this bus: what it sends is heard by all others there.
            gateway.take_frame(frame, now_ns);
            to_bus.push(*frame, 0, now_ns);
            if let Some(log) = log {
                log.note(frame);
            }
        });
    }

    fn hear_network(&mut self) {
        let Some(socket) = &self.socket else { return };
        let mut bytes = [0; 2_048];
        let (gateway, to_bus) = (&mut self.gateway, &mut self.to_bus);
        let (server, log) = (&mut self.server, &mut self.log);
        for _ in 0..PER_TURN {
            match socket.recv_from(&mut bytes) {
                Ok((length, from)) => {
                    let now_ns = now_ns();
                    gateway.take_datagram(&bytes[..length], from, now_ns, |frame, age_ns| {
                        to_bus.push(*frame, age_ns, now_ns);
                        if let Some(server) = server {
                            server.tell(frame, time_of_day_ns());
                        }
                        if let Some(log) = log {
                            log.note(frame);
                        }
                    });
                }
                // Refused by somebody to whom something was sent: said by his silence.
                Err(error)
                    if matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::Interrupted) => {}
                Err(_) => return,
            }
        }
    }

    /// Hands the bus what waits for it, the lowest identifier first.
    fn feed_bus(&mut self, say: &mut dyn FnMut(&str)) {
        let now_ns = now_ns();
        if self.to_bus.is_empty() || now_ns < self.full_until_ns {
            return;
        }
        let Some(bus) = &mut self.bus else {
            self.to_bus.expire(now_ns);
            self.full_until_ns = now_ns + STOP_NS;
            return;
        };
        let (own, mut broken) = (&mut self.own, None);
        self.to_bus.hand_out(now_ns, |aged| {
            match bus.send(&aged.frame) {
                Ok(Sent::Taken) => own.bus_out += 1,
                Ok(Sent::Refused) => own.bus_refused += 1,
                Ok(Sent::Full) => return false,
                Err(error) => {
                    broken = Some(error);
                    return false;
                }
            }
            true
        });
        if !self.to_bus.is_empty() {
            // One that is off the bus is tried at once when that ends.
            self.full_until_ns = now_ns + if bus.state() == BusState::Off { STOP_NS } else { FULL_NS };
        }
        if let Some(error) = broken {
            self.give_up_bus(&error, say);
        }
    }
}

/// What the bus has to let through: clients want to see all of it.
fn let_through(settings: &Settings, has_clients: bool) -> Ids {
    if has_clients { Ids::All } else { settings.forward.clone() }
}

fn put(socket: Option<&UdpSocket>, to: SocketAddr, bytes: &[u8]) -> bool {
    socket.is_some_and(|socket| socket.send_to(bytes, to).is_ok())
}
