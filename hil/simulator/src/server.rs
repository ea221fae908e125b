//! The socket.

use crate::counters::Counters;
use crate::options::Options;
use crate::session::{Session, SessionError};
use crate::truth::TruthError;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How soon a stop is noticed while nobody talks.
const PATIENCE: Duration = Duration::from_millis(100);
/// Pace of a free-running plant.
const CYCLE: Duration = Duration::from_millis(20);
/// Longest datagram that is read, bytes; the packets of this link are below 400.
const DATAGRAM_BYTES: usize = 2048;

/// Why a server could not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// Someone else listens there.
    #[error(
        "{address} is taken, probably by another simulator: end that one (`ss -lunp` shows who it is), or choose \
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

/// A session behind a socket.
#[derive(Debug)]
pub struct Server {
    socket: UdpSocket,
    address: SocketAddr,
    session: Session,
    free_running: bool,
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
        let socket = UdpSocket::bind(address).map_err(refused)?;
        socket.set_read_timeout(Some(PATIENCE)).map_err(refused)?;
        Ok(Self {
            address: socket.local_addr().map_err(refused)?,
            socket,
            session: Session::new(options)?,
            free_running: options.free_running,
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

    fn run_lockstep(&mut self, stop: &AtomicBool) -> Result<(), RunError> {
        while !stop.load(Ordering::Relaxed) {
            self.serve_one()?;
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
                self.socket.set_read_timeout(Some(left)).map_err(RunError::Socket)?;
                self.serve_one()?;
                continue;
            }
            ticks += 1;
            self.send_tick();
        }
        Ok(())
    }

    fn send_tick(&mut self) {
        let answer = self.session.tick();
        let Some(peer) = self.peer else { return };
        if answer.is_empty() {
            return;
        }
        if self.socket.send_to(answer, peer).is_err() {
            self.session.count_unsent();
        }
    }

    /// Answers one datagram, or returns after the socket's patience.
    fn serve_one(&mut self) -> Result<(), RunError> {
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
