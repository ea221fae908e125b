//! The UDP socket to a ground station that speaks MAVLink.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};

use crate::Station;

/// The longest datagram that is looked at, bytes.
const LONGEST: usize = 2048;
/// Datagrams taken in one window, most.
const DATAGRAMS_PER_WINDOW: usize = 16;
/// Messages sent in one window, most.
const MESSAGES_PER_WINDOW: usize = 16;

/// Why there is no radio.
#[derive(Debug, thiserror::Error)]
#[error(
    "attribute mavlink = \"{text}\": {reason}; give the address and port at which the ground station listens, such as \
     \"127.0.0.1:14550\", and let the partition use the network (network = true), or \"serial\" for the line itself"
)]
pub struct RadioError {
    text: String,
    reason: String,
}

/// A socket towards one ground station. Its answers are taken, those of others are counted.
#[derive(Debug)]
pub struct Radio {
    socket: UdpSocket,
    ground: SocketAddr,
    /// Datagrams of others.
    pub strangers: u64,
}

impl Radio {
    /// Towards the ground station that listens at `text`.
    ///
    /// # Errors
    /// No address, or no network.
    pub fn open(text: &str) -> Result<Self, RadioError> {
        let open = || -> io::Result<(UdpSocket, SocketAddr)> {
            let ground = text.to_socket_addrs()?.find(|address| address.port() != 0);
            let ground = ground.ok_or_else(|| io::Error::other("no address with a port"))?;
            let any: SocketAddr =
                if ground.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
            let socket = UdpSocket::bind(any)?;
            socket.set_nonblocking(true)?;
            Ok((socket, ground))
        };
        let (socket, ground) =
            open().map_err(|error| RadioError { text: text.into(), reason: error.to_string() })?;
        Ok(Self { socket, ground, strangers: 0 })
    }

    /// Gives the station what has come.
    pub fn receive(&mut self, station: &mut Station, now_ns: u64) {
        let mut bytes = [0; LONGEST];
        for _ in 0..DATAGRAMS_PER_WINDOW {
            match self.socket.recv_from(&mut bytes) {
                Ok((length, from)) if from == self.ground => station.datagram(&bytes[..length], now_ns),
                Ok(_) => self.strangers += 1,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => {} // nobody listens yet
            }
        }
    }

    /// Sends what the station has to say. What the network does not take is lost, as datagrams are.
    pub fn send(&mut self, station: &mut Station) {
        for _ in 0..MESSAGES_PER_WINDOW {
            let Some(message) = station.next_message() else { return };
            let _ = self.socket.send_to(&message, self.ground); // as above
        }
    }
}
