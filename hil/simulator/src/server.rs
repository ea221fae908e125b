//! The sockets.

use crate::counters::Counters;
use crate::options::Options;
use crate::session::{Session, SessionError};
use crate::truth::TruthError;
use bateleur_messages::hil::{Packet, PilotOrder, Protocol};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How soon a stop is noticed while nobody talks.
const PATIENCE: Duration = Duration::from_millis(100);
/// Pace of a free-running plant.
const CYCLE: Duration = Duration::from_millis(20);
/// Longest datagram that is read, bytes; the packets of this link are below 400.
const DATAGRAM_BYTES: usize = 2048;

/// Free ports that are tried until one is free for datagrams and for connections.
const PORT_TRIES: u32 = 16;

/// Why a server could not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// Someone else listens there.
    #[error(
        "{address} is taken, probably by another simulator: end that one (`ss -lntup` shows who it is), or choose \
         another port with --listen (of `bateleur fly`: --simulator); port 0 takes a free one"
    )]
    Busy {
        /// The address.
        address: SocketAddr,
    },
    /// The address cannot be used at all.
    #[error(
        "cannot listen on {address}: {error}; --listen wants an address of this machine, as 127.0.0.1:15200"
    )]
    Address {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        error: io::Error,
    },
    /// The session could not begin.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Why a server ended before it was told to, or could not end in order.
#[derive(Debug, Error)]
pub enum RunError {
    /// The socket broke.
    #[error("the simulator's socket failed: {0}")]
    Socket(io::Error),
    /// The log could not be completed.
    #[error(transparent)]
    Truth(#[from] TruthError),
}

/// A session behind a socket: the one of datagrams, and for MAVLink over TCP a listening one with the same port beside
/// it. The safety pilot is called over datagrams in any case.
#[derive(Debug)]
pub struct Server {
    socket: UdpSocket,
    listener: Option<TcpListener>,
    /// The flight computer that connected last.
    client: Option<TcpStream>,
    address: SocketAddr,
    session: Session,
    free_running: bool,
    /// How long the socket waits.
    patience: Duration,
    peer: Option<SocketAddr>,
    incoming: Box<[u8; DATAGRAM_BYTES]>,
    reply: Vec<u8>,
}

impl Server {
    /// Takes the address and creates the log; nobody is answered before [`Server::run`].
    ///
    /// # Errors
    /// When the address is taken, the airframe makes no sense or the log cannot be created.
    pub fn bind(options: &Options) -> Result<Self, StartError> {
        let address = options.listen;
        let refused = |error: io::Error| match error.kind() {
            ErrorKind::AddrInUse => StartError::Busy { address },
            _ => StartError::Address { address, error },
        };
        let (socket, listener) = sockets(address, options.protocol).map_err(refused)?;
        Ok(Self {
            address: socket.local_addr().map_err(refused)?,
            socket,
            listener,
            client: None,
            session: Session::new(options)?,
            free_running: options.free_running,
            patience: Duration::ZERO,
            peer: None,
            incoming: Box::new([0; DATAGRAM_BYTES]),
            reply: Vec::with_capacity(DATAGRAM_BYTES),
        })
    }

    /// Where it listens, with the port that it really has.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves until `stop` is set (noticed within 100 ms), then completes the log.
    ///
    /// # Errors
    /// When the socket breaks or the log cannot be completed.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<Counters, RunError> {
        let served = if self.free_running { self.run_free(stop) } else { self.run_lockstep(stop) };
        let flushed = self.session.flush();
        served?;
        flushed?;
        Ok(self.session.counters())
    }

    /// Answers whatever waits at the socket, and returns: for a flight computer in the same process.
    pub fn serve_waiting(&mut self) {
        if self.patience != Duration::MAX {
            // From now on nobody waits here.
            self.patience = Duration::MAX;
            let _ = self.socket.set_nonblocking(true); // it would wait for the patience that it has
        }
        while let Ok((length, sender)) = self.socket.recv_from(&mut self.incoming[..]) {
            self.reply.clear();
            if self.session.take(&self.incoming[..length], &mut self.reply) {
                self.peer = Some(sender);
            }
            if !self.reply.is_empty() && self.socket.send_to(&self.reply, sender).is_err() {
                self.session.count_unsent();
            }
        }
    }

    /// Gives the safety pilot an order, from the same process.
    pub fn order(&mut self, order: PilotOrder) {
        let (mut bytes, mut echo) = (Vec::new(), Vec::new());
        Packet::Pilot(order).write(&mut bytes);
        self.session.take(&bytes, &mut echo);
    }

    /// Completes the log.
    ///
    /// # Errors
    /// It can not be written.
    pub fn finish(&mut self) -> Result<(), TruthError> {
        self.session.flush()
    }

    fn run_lockstep(&mut self, stop: &AtomicBool) -> Result<(), RunError> {
        while !stop.load(Ordering::Relaxed) {
            self.serve(PATIENCE)?;
        }
        Ok(())
    }

    fn run_free(&mut self, stop: &AtomicBool) -> Result<(), RunError> {
        let start = Instant::now();
        let mut ticks: u32 = 0;
        while !stop.load(Ordering::Relaxed) {
            let due = start + CYCLE * (ticks + 1);
            let left = due.saturating_duration_since(Instant::now());
            if !left.is_zero() {
                self.serve(left)?;
                continue;
            }
            ticks += 1;
            self.send_tick();
        }
        Ok(())
    }

    fn send_tick(&mut self) {
        let answer = self.session.tick();
        if answer.is_empty() {
            return;
        }
        let sent = match (&mut self.client, self.peer) {
            (Some(client), _) => client.write_all(answer).map(drop),
            (None, Some(peer)) => self.socket.send_to(answer, peer).map(drop),
            (None, None) => return,
        };
        if sent.is_err() {
            self.session.count_unsent();
            self.hang_up();
        }
    }

    /// Answers what has come, or returns after `patience`.
    fn serve(&mut self, patience: Duration) -> Result<(), RunError> {
        if self.listener.is_none() {
            // One call for each datagram: in virtual time this is what an exchange costs.
            if self.patience != patience {
                self.socket.set_read_timeout(Some(patience)).map_err(RunError::Socket)?;
                self.patience = patience;
            }
            return self.serve_datagram();
        }
        let (mut datagram, mut caller, mut bytes) = (false, false, false);
        {
            let mut set = vec![PollFd::new(&self.socket, PollFlags::IN)];
            set.extend(self.listener.iter().map(|listener| PollFd::new(listener, PollFlags::IN)));
            set.extend(self.client.iter().map(|client| PollFd::new(client, PollFlags::IN)));
            let patience = Timespec { tv_sec: 0, tv_nsec: patience.subsec_nanos().into() };
            match poll(&mut set, Some(&patience)) {
                Ok(_) | Err(Errno::INTR) => {}
                Err(error) => return Err(RunError::Socket(error.into())),
            }
            let mut ready = set.iter().map(|one| !one.revents().is_empty());
            datagram |= ready.next() == Some(true);
            caller |= self.listener.is_some() && ready.next() == Some(true);
            bytes |= self.client.is_some() && ready.next() == Some(true);
        }
        if datagram {
            self.serve_datagram()?;
        }
        if bytes {
            self.serve_stream();
        }
        if caller {
            self.accept();
        }
        Ok(())
    }

    fn serve_datagram(&mut self) -> Result<(), RunError> {
        let (length, sender) = match self.socket.recv_from(&mut self.incoming[..]) {
            Ok(received) => received,
            Err(error) => return harmless(error),
        };
        self.reply.clear();
        if self.session.take(&self.incoming[..length], &mut self.reply) {
            self.peer = Some(sender);
        }
        if !self.reply.is_empty() && self.socket.send_to(&self.reply, sender).is_err() {
            self.session.count_unsent();
        }
        Ok(())
    }

    fn serve_stream(&mut self) {
        let Some(client) = &mut self.client else { return };
        let length = match client.read(&mut self.incoming[..]) {
            Ok(length @ 1..) => length,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => return,
            Ok(0) | Err(_) => return self.hang_up(),
        };
        self.reply.clear();
        self.session.take_stream(&self.incoming[..length], &mut self.reply);
        if client.write_all(&self.reply).is_err() {
            self.session.count_unsent();
            self.hang_up();
        }
    }

    /// A flight computer that connects while another one is there is the same one, started anew.
    fn accept(&mut self) {
        let Some(Ok((client, _))) = self.listener.as_ref().map(TcpListener::accept) else { return };
        self.hang_up();
        // One that does not read what it is sent must not stop the aircraft.
        let prepared = client.set_write_timeout(Some(PATIENCE)).and_then(|()| client.set_nodelay(true));
        self.client = prepared.ok().map(|()| client);
    }

    fn hang_up(&mut self) {
        self.client = None;
        self.session.end_of_stream();
    }
}

/// The sockets at an address. With port 0 both get the same free one.
fn sockets(address: SocketAddr, protocol: Protocol) -> io::Result<(UdpSocket, Option<TcpListener>)> {
    if protocol != Protocol::MavlinkTcp {
        return Ok((UdpSocket::bind(address)?, None));
    }
    let mut tries = 0;
    loop {
        let listener = TcpListener::bind(address)?;
        match UdpSocket::bind(listener.local_addr()?) {
            Ok(socket) => return Ok((socket, Some(listener))),
            Err(error) if address.port() != 0 || tries == PORT_TRIES => return Err(error),
            Err(_) => tries += 1,
        }
    }
}

/// A time-out, a signal, or the echo of an answer to somebody who has left.
fn harmless(error: io::Error) -> Result<(), RunError> {
    match error.kind() {
        ErrorKind::WouldBlock
        | ErrorKind::TimedOut
        | ErrorKind::Interrupted
        | ErrorKind::ConnectionRefused
        | ErrorKind::ConnectionReset => Ok(()),
        _ => Err(RunError::Socket(error)),
    }
}
