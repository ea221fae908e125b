//! Ways for datagrams from one relay to another, behind one trait.
//!
//! Responsible for: bytes, whole or not at all, and the instant at which they came. A transport may lose, delay, double and
//! reorder datagrams: a link sees to that. It must never block, never change a byte, and never hand on part of a
//! datagram.

use std::net::SocketAddr;

use bateleur_contract::relay::RelayTable;

use crate::Rejection;

mod batch;
pub mod conformance;
mod stepped;
mod udp;

pub use stepped::Stepped;
pub use udp::Udp;

/// One end of one network of one link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// The link's number in the plan.
    pub link: u16,
    /// The link's place in the table of this end.
    pub place: usize,
    /// The network's place in the link's table.
    pub network: usize,
    /// Its name in the plan.
    pub name: String,
    /// This end is the one that the plan names first.
    pub initiator: bool,
    /// Where this end listens and sends from.
    pub local: SocketAddr,
    /// Where the other end does, or the group that both listen to.
    pub remote: SocketAddr,
    /// The longest datagram, bytes.
    pub max_datagram: usize,
}

impl Endpoint {
    /// All of a table, link by link.
    #[must_use]
    pub fn all(table: &RelayTable) -> Vec<Self> {
        let mut endpoints = Vec::new();
        for (place, link) in table.links.iter().enumerate() {
            for (network, path) in link.paths.iter().enumerate() {
                endpoints.push(Self {
                    link: link.id,
                    place,
                    network,
                    name: path.network.clone(),
                    initiator: link.initiator,
                    local: path.local,
                    remote: path.remote,
                    max_datagram: link.max_datagram as usize,
                });
            }
        }
        endpoints
    }
}

/// Something that came.
#[derive(Debug)]
pub struct Came<'a> {
    /// The place of the endpoint.
    pub endpoint: usize,
    /// When it came, as near to the wire as can be told, module time, ns.
    pub at_ns: u64,
    /// The datagram, or why it is none.
    pub datagram: Result<&'a [u8], Rejection>,
}

/// A transport that can not be opened.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The own address can not be had.
    #[error(
        "network {network}: cannot listen at {local}: {error}; give an address of this computer, and a port that no other \
         program has"
    )]
    Bind {
        /// The network.
        network: String,
        /// The address.
        local: SocketAddr,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The other end's address can not be used.
    #[error("network {network}: cannot send from {local} to {remote}: {error}")]
    Remote {
        /// The network.
        network: String,
        /// The own address.
        local: SocketAddr,
        /// The peer's.
        remote: SocketAddr,
        /// The system's answer.
        error: std::io::Error,
    },
    /// Anything else that a transport needs: what it is, and how to mend it.
    #[error("{0}")]
    Other(String),
}

/// A way for datagrams.
pub trait RelayTransport {
    /// Takes a datagram, which is `parts` one after the other, to be sent from an endpoint with the next
    /// [`RelayTransport::flush`].
    fn send(&mut self, endpoint: usize, parts: [&[u8]; 2]);

    /// Sends what was taken, at `now_ns`; `failed` is told the endpoint of each datagram that could not be sent.
    fn flush(&mut self, now_ns: u64, failed: &mut dyn FnMut(usize));

    /// Hands over what has come, at most `most` datagrams of each endpoint; what is more waits. `now` gives module time, ns. A
    /// transport that is told of arrivals by another clock looks at that one first and at module time directly behind it: whatever
    /// comes between makes an arrival late, never early. A link's estimate of the peer's clock would be wrong by more than it says
    /// with one that is early.
    fn receive(&mut self, now: &dyn Fn() -> u64, most: usize, take: &mut dyn FnMut(Came<'_>));

    /// How often an endpoint was answered that nobody listens at its remote address, where the transport is told: the other
    /// computer is there, and no relay.
    fn port_unreachable_count(&self, _endpoint: usize) -> u64 {
        0
    }
}
