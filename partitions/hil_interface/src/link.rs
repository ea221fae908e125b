//! The UDP socket to the simulator.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

use crate::inbox::Inbox;

/// The longest datagram that is looked at, bytes: a sensor set has about 400, twice that with every byte doubled.
const LONGEST_DATAGRAM: usize = 2048;
/// Datagrams taken out of the socket at once, at most: a flood must not keep the function busy beyond its window.
const DATAGRAMS_AT_ONCE: usize = 16;

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The simulator's address can not be read or found.
    #[error(
        "attribute simulator = \"{text}\": {reason}; give an address and a port, such as \"127.0.0.1:15200\""
    )]
    Simulator {
        /// The attribute.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The own address can not be read.
    #[error("attribute listen = \"{text}\" is no address; give one such as \"0.0.0.0:0\" (0: any free port)")]
    Listen {
        /// The attribute.
        text: String,
    },
    /// The own port can not be had.
    #[error(
        "attribute listen = \"{address}\": {error}; another program has that port or the address is not this \
         computer's: end that program, or give another port (0: any free one)"
    )]
    Bind {
        /// The address.
        address: SocketAddr,
        /// The system's answer.
        error: io::Error,
    },
}

/// The socket, and who is at the other end.
#[derive(Debug)]
pub struct Link {
    socket: UdpSocket,
    simulator: SocketAddr,
}

impl Link {
    /// Opens a socket at `listen` towards the simulator at `simulator`.
    pub fn open(simulator: &str, listen: &str) -> Result<Self, LinkError> {
        let listen: SocketAddr = listen.parse().map_err(|_| LinkError::Listen { text: listen.into() })?;
        let simulator = address_of(simulator, &listen)?;
        let open = || {
            let socket = UdpSocket::bind(listen)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        let socket = open().map_err(|error| LinkError::Bind { address: listen, error })?;
        Ok(Self { socket, simulator })
    }

    /// Where the simulator is.
    pub fn simulator(&self) -> SocketAddr {
        self.simulator
    }

    /// Sends a datagram. An error (the network is down, nobody listens) is counted: there will be a next cycle.
    pub fn send(&self, datagram: &[u8], inbox: &mut Inbox) {
        match self.socket.send_to(datagram, self.simulator) {
            Ok(sent) if sent == datagram.len() => {}
            _ => inbox.counters_mut().errors += 1,
        }
    }

    /// Takes out what has come. Datagrams of strangers are counted and thrown away.
    pub fn drain(&self, inbox: &mut Inbox) {
        let mut datagram = [0; LONGEST_DATAGRAM];
        for _ in 0..DATAGRAMS_AT_ONCE {
            match self.socket.recv_from(&mut datagram) {
                Ok((length, from)) if from == self.simulator => inbox.take(&datagram[..length]),
                Ok(_) => inbox.counters_mut().strangers += 1,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => inbox.counters_mut().errors += 1,
            }
        }
    }
}

impl AsFd for Link {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// The first address behind `text` that the socket can reach: of the same family as its own.
fn address_of(text: &str, listen: &SocketAddr) -> Result<SocketAddr, LinkError> {
    let wrong = |reason: String| LinkError::Simulator { text: text.into(), reason };
    let mut addresses = text.to_socket_addrs().map_err(|error| wrong(error.to_string()))?;
    addresses
        .find(|address| address.is_ipv4() == listen.is_ipv4() && address.port() != 0)
        .ok_or_else(|| wrong(format!("no address there that a socket at {listen} can reach")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_taken_is_refused_with_the_mend() {
        let other = UdpSocket::bind("127.0.0.1:0").unwrap();
        let listen = other.local_addr().unwrap().to_string();
        let error = Link::open("127.0.0.1:15200", &listen).unwrap_err().to_string();
        assert!(error.contains(&listen) && error.contains("another program has that port"), "{error}");
    }

    #[test]
    fn addresses_that_are_none_are_refused_with_an_example() {
        let error = Link::open("127.0.0.1", "0.0.0.0:0").unwrap_err().to_string();
        assert!(error.contains("such as \"127.0.0.1:15200\""), "{error}");
        let error = Link::open("[::1]:15200", "0.0.0.0:0").unwrap_err().to_string();
        assert!(error.contains("can reach"), "{error}");
        let error = Link::open("127.0.0.1:15200", "here").unwrap_err().to_string();
        assert!(error.contains("attribute listen = \"here\""), "{error}");
    }

    #[test]
    fn datagrams_of_strangers_are_counted_and_thrown_away() {
        let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
        let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
        let link = Link::open(&simulator.local_addr().unwrap().to_string(), "127.0.0.1:0").unwrap();
        let mut inbox = Inbox::new();
        stranger.send_to(b"x", link.socket.local_addr().unwrap()).unwrap();
        link.drain(&mut inbox);
        assert_eq!((inbox.counters().strangers, inbox.counters().refused), (1, 0));
    }

    #[test]
    fn a_simulator_that_is_not_there_is_no_disaster() {
        let nobody = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap(); // closed again at once
        let link = Link::open(&nobody.to_string(), "127.0.0.1:0").unwrap();
        let mut inbox = Inbox::new();
        for _ in 0..3 {
            link.send(b"x", &mut inbox);
            link.drain(&mut inbox);
        }
        assert_eq!(inbox.counters().accepted, 0);
    }
}
