//! The way to the simulator, whatever the protocol needs.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::os::fd::AsFd;

use bateleur_messages::hil::Protocol;

use crate::exchange::Waiting;
use crate::inbox::Counters;
use crate::tcp::TcpLink;
use crate::udp::UdpLink;

/// The own address that stands for any.
const ANY: &str = "0.0.0.0:0";

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The simulator's address can not be read or found.
    #[error(
        "attribute simulator = \"{text}\": {reason}; give an address and a port, such as \"127.0.0.1:{port}\""
    )]
    Simulator {
        /// The attribute.
        text: String,
        /// What is wrong with it.
        reason: String,
        /// The protocol's usual port.
        port: u16,
    },
    /// The own address can not be read.
    #[error("attribute listen = \"{text}\" is no address; give one such as \"0.0.0.0:0\" (0: any free port)")]
    Listen {
        /// The attribute.
        text: String,
    },
    /// A protocol without an own address was given one.
    #[error(
        "attribute listen = \"{text}\" has no meaning for protocol \"mavlink-tcp\", where the simulator listens: leave it \
         out"
    )]
    Listens {
        /// The attribute.
        text: String,
    },
    /// The system refuses connections.
    #[error(
        "attribute protocol = \"mavlink-tcp\": {0}; the plan has to say `network = true` and `system_calls = [\"tcp\"]`"
    )]
    Connect(io::Error),
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

/// Bytes as they came.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Chunk<'a> {
    /// A whole datagram.
    Datagram(&'a [u8]),
    /// The next bytes of a stream.
    Stream(&'a [u8]),
    /// The stream has ended: what comes next belongs to another one.
    End,
}

/// The socket, and who is at the other end.
#[derive(Debug)]
pub(crate) enum Link {
    Udp(UdpLink),
    Tcp(TcpLink),
}

impl Link {
    /// The way to the simulator at `simulator` (`None`: where the protocol expects it on this machine), from the own
    /// address `listen`. Over TCP nothing happens before it is first used.
    pub(crate) fn open(
        protocol: Protocol,
        simulator: Option<&str>,
        listen: Option<&str>,
    ) -> Result<Self, LinkError> {
        let usual = format!("127.0.0.1:{}", protocol.port());
        let simulator = simulator.unwrap_or(&usual);
        let text = listen.unwrap_or(ANY);
        let address: SocketAddr = text.parse().map_err(|_| LinkError::Listen { text: text.into() })?;
        let to = address_of(simulator, &address, protocol.port())?;
        match (protocol, listen) {
            (Protocol::MavlinkTcp, Some(text)) => Err(LinkError::Listens { text: text.into() }),
            (Protocol::MavlinkTcp, None) => TcpLink::new(to).map(Self::Tcp).map_err(LinkError::Connect),
            _ => UdpLink::open(to, address).map(Self::Udp),
        }
    }

    /// Where the simulator is.
    pub(crate) fn simulator(&self) -> SocketAddr {
        match self {
            Self::Udp(link) => link.simulator,
            Self::Tcp(link) => link.simulator,
        }
    }

    #[cfg(test)]
    pub(crate) fn own_port(&self) -> u16 {
        match self {
            Self::Udp(link) => link.own_port(),
            Self::Tcp(_) => 0,
        }
    }

    /// Whether what is sent arrives unless the connection breaks.
    pub(crate) fn is_reliable(&self) -> bool {
        matches!(self, Self::Tcp(_))
    }

    /// Makes the connection if there is none and it is time to try, at the latest until module time `until_ns`.
    pub(crate) fn connect(&mut self, time: &impl Waiting, until_ns: u64, counters: &mut Counters) {
        if let Self::Tcp(link) = self {
            link.connect(time, until_ns, counters);
        }
    }

    /// Sends one message, or counts why not.
    pub(crate) fn send(&mut self, bytes: &[u8], counters: &mut Counters) {
        match self {
            Self::Udp(link) => link.send(bytes, counters),
            Self::Tcp(link) => link.send(bytes, counters),
        }
    }

    /// Waits until something comes, at the longest until module time `until_ns`; false: nothing came, or there is no
    /// connection. `shortly`: the caller will ask again.
    pub(crate) fn wait(&self, time: &impl Waiting, until_ns: u64, shortly: bool) -> bool {
        match self {
            Self::Udp(link) if shortly => time.wait_shortly(link, until_ns),
            Self::Udp(link) => time.wait_readable(link, until_ns),
            Self::Tcp(link) => {
                link.stream().is_some_and(|stream| time.wait_readable(&stream.as_fd(), until_ns))
            }
        }
    }

    /// Takes out what has come and gives it to `take`; what happened to the socket is given back as counts.
    pub(crate) fn drain(&mut self, mut take: impl FnMut(Chunk<'_>)) -> Counters {
        match self {
            Self::Udp(link) => link.drain(|datagram| take(Chunk::Datagram(datagram))),
            Self::Tcp(link) => link.drain(take),
        }
    }
}

/// The first address behind `text` that the socket can reach: of the same family as its own.
fn address_of(text: &str, listen: &SocketAddr, port: u16) -> Result<SocketAddr, LinkError> {
    let wrong = |reason: String| LinkError::Simulator { text: text.into(), reason, port };
    let mut addresses = text.to_socket_addrs().map_err(|error| wrong(error.to_string()))?;
    addresses
        .find(|address| address.is_ipv4() == listen.is_ipv4() && address.port() != 0)
        .ok_or_else(|| wrong(format!("no address there that a socket at {listen} can reach")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::UdpSocket;

    fn refused(protocol: Protocol, simulator: &str, listen: Option<&str>) -> String {
        Link::open(protocol, Some(simulator), listen).unwrap_err().to_string()
    }

    #[test]
    fn a_port_that_is_taken_is_refused_with_the_mend() {
        let other = UdpSocket::bind("127.0.0.1:0").unwrap();
        let listen = other.local_addr().unwrap().to_string();
        let error = refused(Protocol::Native, "127.0.0.1:15200", Some(&listen));
        assert!(error.contains(&listen) && error.contains("another program has that port"), "{error}");
    }

    #[test]
    fn addresses_that_are_none_are_refused_with_an_example_of_the_protocol() {
        let error = refused(Protocol::Native, "127.0.0.1", None);
        assert!(error.contains("such as \"127.0.0.1:15200\""), "{error}");
        let error = refused(Protocol::MavlinkTcp, "127.0.0.1", None);
        assert!(error.contains("such as \"127.0.0.1:4560\""), "{error}");
        let error = refused(Protocol::Native, "[::1]:15200", None);
        assert!(error.contains("can reach"), "{error}");
        let error = refused(Protocol::Mavlink, "127.0.0.1:15200", Some("here"));
        assert!(error.contains("attribute listen = \"here\""), "{error}");
        let error = refused(Protocol::MavlinkTcp, "127.0.0.1:15200", Some("127.0.0.1:0"));
        assert!(error.contains("leave it out"), "{error}");
    }

    #[test]
    fn without_an_address_each_protocol_has_its_usual_port() {
        for protocol in Protocol::ALL {
            let link = Link::open(protocol, None, None).unwrap();
            assert_eq!(link.simulator().to_string(), format!("127.0.0.1:{}", protocol.port()));
        }
    }
}
