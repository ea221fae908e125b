//! The UDP socket to the simulator.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

use crate::inbox::Counters;
use crate::link::LinkError;

/// The longest datagram that is looked at, bytes: a sensor set has about 400, twice that with every byte doubled.
const LONGEST_DATAGRAM: usize = 2048;
/// Datagrams taken out of the socket at once, at most: a flood must not keep the function busy beyond its window.
const DATAGRAMS_AT_ONCE: usize = 16;

/// The socket, and who is at the other end.
#[derive(Debug)]
pub(crate) struct UdpLink {
    socket: UdpSocket,
    pub(crate) simulator: SocketAddr,
}

impl UdpLink {
    /// Opens a socket at `listen` towards the simulator at `simulator`.
    pub(crate) fn open(simulator: SocketAddr, listen: SocketAddr) -> Result<Self, LinkError> {
        let open = || {
            let socket = UdpSocket::bind(listen)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        let socket = open().map_err(|error| LinkError::Bind { address: listen, error })?;
        Ok(Self { socket, simulator })
    }

    #[cfg(test)]
    pub(crate) fn own_port(&self) -> u16 {
        self.socket.local_addr().map_or(0, |address| address.port())
    }

    /// Sends a datagram. An error (the network is down, nobody listens) is counted: there will be a next cycle.
    pub(crate) fn send(&self, datagram: &[u8], counters: &mut Counters) {
        match self.socket.send_to(datagram, self.simulator) {
            Ok(sent) if sent == datagram.len() => {}
            _ => counters.errors += 1,
        }
    }

    /// Takes out what has come, up to a bound, and gives it to `take`. Datagrams of strangers are counted and thrown away; the counts are given back.
    pub(crate) fn drain(&self, mut take: impl FnMut(&[u8])) -> Counters {
        let mut counters = Counters::default();
        let mut datagram = [0; LONGEST_DATAGRAM];
        for _ in 0..DATAGRAMS_AT_ONCE {
            match self.socket.recv_from(&mut datagram) {
                Ok((length, from)) if from == self.simulator => take(&datagram[..length]),
                Ok(_) => counters.strangers += 1,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => counters.errors += 1,
            }
        }
        counters
    }
}

impl AsFd for UdpLink {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(simulator: &UdpSocket) -> UdpLink {
        UdpLink::open(simulator.local_addr().unwrap(), "127.0.0.1:0".parse().unwrap()).unwrap()
    }

    #[test]
    fn datagrams_of_strangers_are_counted_and_thrown_away() {
        let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
        let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
        let link = link(&simulator);
        let own = link.socket.local_addr().unwrap();
        stranger.send_to(b"x", own).unwrap();
        simulator.send_to(b"y", own).unwrap();
        let mut taken = Vec::new();
        let counters = link.drain(|datagram| taken.push(datagram.to_vec()));
        assert_eq!((counters.strangers, taken), (1, vec![b"y".to_vec()]));
    }

    #[test]
    fn a_simulator_that_is_not_there_is_no_disaster() {
        let place = UdpSocket::bind("127.0.0.1:0").unwrap();
        let (link, address) = (link(&place), place.local_addr().unwrap());
        drop(place);
        let mut counters = Counters::default();
        for _ in 0..3 {
            link.send(b"x", &mut counters);
            assert_eq!(link.drain(|_| panic!("nobody answers")), Counters::default());
        }
        let simulator = UdpSocket::bind(address).unwrap();
        link.send(b"y", &mut counters);
        let mut heard = [0; 8];
        let (length, from) = simulator.recv_from(&mut heard).unwrap();
        simulator.send_to(&heard[..length], from).unwrap();
        let mut taken = Vec::new();
        link.drain(|datagram| taken.extend_from_slice(datagram));
        assert_eq!((taken.as_slice(), counters), (&b"y"[..], Counters::default()), "its coming later shows");
    }
}
