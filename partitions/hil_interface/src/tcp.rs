//! The TCP connection to the simulator, which listens.
//!
//! It is made without blocking when it is first needed, and made anew, at most once a second, when it was refused or has
//! broken. A simulator that does not read what it is sent costs messages, never half of one.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::OwnedFd;

use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, connect, socket_with, sockopt};

use crate::exchange::Waiting;
use crate::inbox::Counters;
use crate::link::Chunk;

/// Between two attempts to connect, module time, ns.
const RETRY_NS: u64 = 1_000_000_000;
/// How long an attempt may take, module time, ns: a network drops the first packet while it looks for the host.
const PATIENCE_NS: u64 = 3_000_000_000;
/// Bytes taken out at once, at most: a flood must not keep the function busy beyond its window.
const BYTES_AT_ONCE: usize = 16 * 1024;

/// The connection, or what there is of it.
#[derive(Debug)]
pub(crate) struct TcpLink {
    pub(crate) simulator: SocketAddr,
    state: State,
    /// Module time of the next attempt, ns.
    next_ns: u64,
    /// What is left of a message that was sent in part.
    rest: Vec<u8>,
    /// A connection broke while it was sent to, which is still to be told to whoever takes what comes.
    ended: bool,
}

#[derive(Debug)]
enum State {
    Closed,
    Connecting { stream: TcpStream, since_ns: u64 },
    Open(TcpStream),
}

impl TcpLink {
    /// Towards a simulator that listens at `simulator`; not connected yet.
    ///
    /// # Errors
    /// The partition may not make connections: better said at its start than counted in each window.
    pub(crate) fn new(simulator: SocketAddr) -> io::Result<Self> {
        socket_towards(simulator)?;
        Ok(Self { simulator, state: State::Closed, next_ns: 0, rest: Vec::new(), ended: false })
    }

    /// The connection, where there is one.
    pub(crate) fn stream(&self) -> Option<&TcpStream> {
        match &self.state {
            State::Open(stream) => Some(stream),
            _ => None,
        }
    }

    /// See [`crate::link::Link::connect`].
    pub(crate) fn connect(&mut self, time: &impl Waiting, until_ns: u64, counters: &mut Counters) {
        let now_ns = time.now_ns();
        if matches!(self.state, State::Closed) && now_ns >= self.next_ns {
            self.next_ns = now_ns.saturating_add(RETRY_NS);
            match begin(self.simulator) {
                Ok(stream) => self.state = State::Connecting { stream, since_ns: now_ns },
                Err(_) => counters.errors += 1,
            }
        }
        let State::Connecting { stream, since_ns } = &self.state else { return };
        if time.wait_writable(stream, until_ns) {
            let refused = sockopt::socket_error(stream).map_or_else(Some, Result::err);
            self.finish(refused.is_none(), counters);
        } else if now_ns.saturating_sub(*since_ns) >= PATIENCE_NS {
            self.finish(false, counters);
        }
    }

    fn finish(&mut self, connected: bool, counters: &mut Counters) {
        self.rest.clear();
        match std::mem::replace(&mut self.state, State::Closed) {
            State::Connecting { stream, .. } if connected => {
                counters.connections += 1;
                self.state = State::Open(stream);
            }
            _ => counters.errors += 1,
        }
    }

    /// Sends one message, or counts an error where the connection is not there or does not take it.
    pub(crate) fn send(&mut self, bytes: &[u8], counters: &mut Counters) {
        let State::Open(stream) = &mut self.state else { return };
        let mut clear = write(stream, &mut self.rest);
        if clear.is_ok() && self.rest.is_empty() {
            self.rest.extend_from_slice(bytes);
            clear = write(stream, &mut self.rest);
            if self.rest.len() == bytes.len() {
                self.rest.clear(); // nothing of it is on its way
                counters.errors += 1;
            }
        } else {
            counters.errors += 1;
        }
        if clear.is_err() {
            self.state = State::Closed;
            self.ended = true;
        }
    }

    /// See [`crate::link::Link::drain`].
    pub(crate) fn drain(&mut self, mut take: impl FnMut(Chunk<'_>)) -> Counters {
        let mut counters = Counters::default();
        if std::mem::take(&mut self.ended) {
            take(Chunk::End);
        }
        let State::Open(stream) = &mut self.state else { return counters };
        let mut bytes = [0; 4096];
        let mut taken = 0;
        while taken < BYTES_AT_ONCE {
            match stream.read(&mut bytes) {
                Ok(count @ 1..) => {
                    taken += count;
                    take(Chunk::Stream(&bytes[..count]));
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return counters,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // The simulator has hung up.
                Ok(0) | Err(_) => {
                    counters.errors += 1;
                    self.state = State::Closed;
                    take(Chunk::End);
                    return counters;
                }
            }
        }
        counters
    }
}

fn socket_towards(simulator: SocketAddr) -> io::Result<OwnedFd> {
    let family = if simulator.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    Ok(socket_with(family, SocketType::STREAM, flags, None)?)
}

fn begin(simulator: SocketAddr) -> io::Result<TcpStream> {
    let socket = socket_towards(simulator)?;
    // Messages are small and waited for.
    sockopt::set_tcp_nodelay(&socket, true)?;
    match connect(&socket, &simulator) {
        Ok(()) | Err(Errno::INPROGRESS) => Ok(socket.into()),
        Err(error) => Err(error.into()),
    }
}

/// Writes what the connection takes of `bytes` and removes it.
fn write(stream: &mut TcpStream, bytes: &mut Vec<u8>) -> io::Result<()> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(count) => drop(bytes.drain(..count)),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::net::TcpListener;
    use std::os::fd::AsFd;

    /// Time that stands, and waits that look for half a second of the real one.
    struct Patient(Cell<u64>);

    impl Waiting for Patient {
        fn now_ns(&self) -> u64 {
            self.0.get()
        }

        fn wait_readable(&self, device: &impl AsFd, _: u64) -> bool {
            poll(device, rustix::event::PollFlags::IN)
        }

        fn wait_shortly(&self, device: &impl AsFd, until_ns: u64) -> bool {
            self.wait_readable(device, until_ns)
        }

        fn wait_writable(&self, device: &impl AsFd, _: u64) -> bool {
            poll(device, rustix::event::PollFlags::OUT)
        }
    }

    fn poll(device: &impl AsFd, what: rustix::event::PollFlags) -> bool {
        let half = rustix::event::Timespec { tv_sec: 0, tv_nsec: 500_000_000 };
        let mut set = [rustix::event::PollFd::new(device, what)];
        rustix::event::poll(&mut set, Some(&half)).unwrap() > 0
    }

    fn drained(link: &mut TcpLink) -> (Vec<u8>, bool) {
        let (mut bytes, mut ended) = (Vec::new(), false);
        link.drain(|chunk| match chunk {
            Chunk::Stream(more) => bytes.extend_from_slice(more),
            Chunk::End => ended = true,
            Chunk::Datagram(_) => panic!("a stream has none"),
        });
        (bytes, ended)
    }

    #[test]
    fn a_simulator_that_listens_later_and_hangs_up_is_connected_again_once_a_second() {
        let place = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = place.local_addr().unwrap();
        drop(place);
        let (time, mut counters) = (Patient(Cell::new(5)), Counters::default());
        let mut link = TcpLink::new(address).unwrap();
        for _ in 0..10 {
            link.connect(&time, 0, &mut counters);
        }
        assert!(link.stream().is_none());
        assert_eq!((counters.errors, counters.connections), (1, 0), "one attempt, refused");

        let simulator = TcpListener::bind(address).unwrap();
        time.0.set(5 + RETRY_NS);
        link.connect(&time, 0, &mut counters);
        let (mut peer, _) = simulator.accept().unwrap();
        link.send(b"hello", &mut counters);
        let mut heard = [0; 5];
        peer.read_exact(&mut heard).unwrap();
        assert_eq!(&heard, b"hello");
        peer.write_all(b"well").unwrap();
        assert!(time.wait_readable(link.stream().unwrap(), 0));
        assert_eq!(drained(&mut link), (b"well".to_vec(), false));
        drop(peer);
        assert!(time.wait_readable(link.stream().unwrap(), 0));
        assert_eq!(drained(&mut link), (Vec::new(), true));
        assert!(link.stream().is_none());

        time.0.set(5 + 2 * RETRY_NS);
        link.connect(&time, 0, &mut counters);
        assert!(link.stream().is_some());
        assert_eq!(counters.connections, 2);
    }

    #[test]
    fn connection_that_broke_while_it_was_sent_to_leaves_nothing_for_the_next_one() {
        let simulator = TcpListener::bind("127.0.0.1:0").unwrap();
        let (time, mut counters) = (Patient(Cell::new(5)), Counters::default());
        let mut link = TcpLink::new(simulator.local_addr().unwrap()).unwrap();
        link.connect(&time, 0, &mut counters);
        let (mut peer, _) = simulator.accept().unwrap();
        peer.write_all(b"half a mess").unwrap();
        assert!(time.wait_readable(link.stream().unwrap(), 0));
        assert_eq!(drained(&mut link), (b"half a mess".to_vec(), false));
        drop(peer);
        for _ in 0..1_000 {
            link.send(b"is anybody there?", &mut counters);
            if link.stream().is_none() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(1)); // for the answer of the kernel there
        }
        assert!(link.stream().is_none(), "the sending showed it");
        time.0.set(5 + RETRY_NS);
        link.connect(&time, 0, &mut counters);
        let (mut peer, _) = simulator.accept().unwrap();
        peer.write_all(b"a whole one").unwrap();
        assert!(time.wait_readable(link.stream().unwrap(), 0));
        assert_eq!(drained(&mut link), (b"a whole one".to_vec(), true), "what came before has ended");
        assert_eq!(drained(&mut link), (Vec::new(), false));
    }

    #[test]
    fn a_simulator_that_does_not_read_gets_whole_messages_or_none() {
        let simulator = TcpListener::bind("127.0.0.1:0").unwrap();
        let (time, mut counters) = (Patient(Cell::new(5)), Counters::default());
        let mut link = TcpLink::new(simulator.local_addr().unwrap()).unwrap();
        link.connect(&time, 0, &mut counters);
        let (mut peer, _) = simulator.accept().unwrap();
        let message: Vec<u8> = (0..200).collect();
        while counters.errors < 5 {
            link.send(&message, &mut counters);
        }
        assert!(link.rest.len() < message.len());
        peer.set_read_timeout(Some(std::time::Duration::from_millis(200))).unwrap();
        let mut all = Vec::new();
        let mut bytes = [0; 65_536];
        while let Ok(count @ 1..) = peer.read(&mut bytes) {
            all.extend_from_slice(&bytes[..count]);
        }
        link.send(&message, &mut counters);
        while let Ok(count @ 1..) = peer.read(&mut bytes) {
            all.extend_from_slice(&bytes[..count]);
        }
        assert_eq!(all.len() % message.len(), 0, "{} bytes", all.len());
        assert!(all.chunks(message.len()).all(|one| one == message));
    }
}
