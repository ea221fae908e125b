//! A transport of the relay's datagrams over zenoh, for a fleet that has it anyway.
//!
//! Responsible for: a session for each own address, and for each network of each link a key expression for either direction:
//! `bateleur/LINK/NETWORK/first` is what the end sends that the plan names first. It passes the conformance suite of
//! all transports. Authentication, replay, lives and order are the link's: zenoh carries bytes. It must never let the
//! relay wait: what zenoh does not take at once is lost, and counted as unsent or by the peer as lost.
//!
//! zenoh runs threads of its own in the process. A partition that uses it needs `threads` in the plan, and its time is spent in
//! windows like all of a partition's; what arrives between them is noted when the threads run next.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, TrySendError, sync_channel};
use std::time::Instant;

use bateleur_relay::Rejection;
use bateleur_relay::transport::{Came, Endpoint, RelayTransport, TransportError};
use zenoh::Wait;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};

/// Datagrams that wait for a window, most; what comes beyond is dropped, as by a socket that is full.
const WAITING: usize = 1024;

/// See the crate's head.
pub struct Zenoh {
    ways: Vec<Way>,
    // Closed when dropped, after what is declared on them.
    _sessions: Vec<zenoh::Session>,
}

struct Way {
    publisher: Publisher<'static>,
    _subscriber: Subscriber<()>,
    came: Receiver<(Instant, Vec<u8>)>,
    outbox: VecDeque<Vec<u8>>,
    max_datagram: usize,
}

impl Zenoh {
    /// Opens a session for each own address of `endpoints`: it listens there where this end is not the first of a link, and
    /// connects to the other end where it is.
    ///
    /// # Errors
    /// An address that can not be had.
    pub fn open(endpoints: &[Endpoint]) -> Result<Self, TransportError> {
        let mut sessions: Vec<(SocketAddr, zenoh::Session)> = Vec::new();
        let mut ways = Vec::new();
        for endpoint in endpoints {
            let place = sessions.iter().position(|(local, _)| *local == endpoint.local);
            let place = match place {
                Some(place) => place,
                None => {
                    sessions.push((endpoint.local, session(endpoint.local, endpoints)?));
                    sessions.len() - 1
                }
            };
            ways.push(Way::declare(&sessions[place].1, endpoint).map_err(|error| refused(endpoint, &error))?);
        }
        Ok(Self { ways, _sessions: sessions.into_iter().map(|(_, session)| session).collect() })
    }

    /// Whether the other ends listen to everything that is sent from here: until then datagrams are lost.
    #[must_use]
    pub fn is_joined(&self) -> bool {
        self.ways
            .iter()
            .all(|way| way.publisher.matching_status().wait().is_ok_and(|status| status.matching()))
    }
}

fn session(local: SocketAddr, endpoints: &[Endpoint]) -> Result<zenoh::Session, TransportError> {
    let mine = || endpoints.iter().filter(|endpoint| endpoint.local == local);
    let listen = mine().any(|endpoint| !endpoint.initiator).then(|| format!("\"tcp/{local}\""));
    let connect = mine().filter(|endpoint| endpoint.initiator);
    let connect: Vec<String> = connect.map(|endpoint| format!("\"tcp/{}\"", endpoint.remote)).collect();
    // Nobody is looked for who does not stand in the plan.
    let text = format!(
        "{{ mode: \"peer\", listen: {{ endpoints: [{}] }}, connect: {{ endpoints: [{}] }}, \
         scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }} }}",
        listen.unwrap_or_default(),
        connect.join(", ")
    );
    let failed = |error: zenoh::Error| match mine().next() {
        Some(endpoint) => refused(endpoint, &error),
        None => TransportError::Other(error.to_string()),
    };
    let config = zenoh::Config::from_json5(&text).map_err(failed)?;
    zenoh::open(config).wait().map_err(failed)
}

fn refused(endpoint: &Endpoint, error: &zenoh::Error) -> TransportError {
    TransportError::Remote {
        network: endpoint.name.clone(),
        local: endpoint.local,
        remote: endpoint.remote,
        error: std::io::Error::other(error.to_string()),
    }
}

impl Way {
    fn declare(session: &zenoh::Session, endpoint: &Endpoint) -> Result<Self, zenoh::Error> {
        let key = |first: bool| {
            let end = if first { "first" } else { "second" };
            format!("bateleur/{}/{}/{end}", endpoint.link, endpoint.name)
        };
        let publisher = session
            .declare_publisher(key(endpoint.initiator))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .wait()?;
        let (put, came) = sync_channel(WAITING);
        let subscriber = session
            .declare_subscriber(key(!endpoint.initiator))
            .callback(move |sample| {
                let datagram = (Instant::now(), sample.payload().to_bytes().into_owned());
                match put.try_send(datagram) {
                    Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {} // lost, as the link will see
                }
            })
            .wait()?;
        let max_datagram = endpoint.max_datagram;
        Ok(Self { publisher, _subscriber: subscriber, came, outbox: VecDeque::new(), max_datagram })
    }
}

impl RelayTransport for Zenoh {
    fn send(&mut self, endpoint: usize, parts: [&[u8]; 2]) {
        if let Some(way) = self.ways.get_mut(endpoint) {
            way.outbox.push_back(parts.concat());
        }
    }

    fn flush(&mut self, _now_ns: u64, failed: &mut dyn FnMut(usize)) {
        for (endpoint, way) in self.ways.iter_mut().enumerate() {
            while let Some(datagram) = way.outbox.pop_front() {
                if way.publisher.put(datagram).wait().is_err() {
                    failed(endpoint);
                }
            }
        }
    }

    fn receive(&mut self, now: &dyn Fn() -> u64, most: usize, take: &mut dyn FnMut(Came<'_>)) {
        for (endpoint, way) in self.ways.iter().enumerate() {
            for (came, datagram) in way.came.try_iter().take(most) {
                let waited_ns = u64::try_from(came.elapsed().as_nanos()).unwrap_or(u64::MAX);
                let fits = datagram.len() <= way.max_datagram;
                let datagram = if fits { Ok(datagram.as_slice()) } else { Err(Rejection::Giant) };
                take(Came { endpoint, at_ns: now().saturating_sub(waited_ns), datagram });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::time::{Duration, Instant};

    use bateleur_relay::transport::conformance::{Bed, conforms};

    use super::*;

    #[test]
    fn zenoh_conforms() {
        let sockets: Vec<_> = (0..4).map(|_| TcpListener::bind("127.0.0.1:0").unwrap()).collect();
        let at: Vec<SocketAddr> = sockets.iter().map(|socket| socket.local_addr().unwrap()).collect();
        drop(sockets);
        let end = |initiator: bool| {
            let endpoint = |network: usize| {
                let (own, other) = if initiator { (0, 1) } else { (1, 0) };
                let (local, remote) = (at[2 * network + own], at[2 * network + other]);
                let name = ["a", "b"][network].to_owned();
                Endpoint { link: 7, place: 0, network, name, initiator, local, remote, max_datagram: 2000 }
            };
            Zenoh::open(&[endpoint(0), endpoint(1)]).unwrap()
        };
        let (there, here) = (end(false), end(true));
        let begun = Instant::now();
        while !(here.is_joined() && there.is_joined()) {
            assert!(begun.elapsed() < Duration::from_secs(60), "two sessions on this computer do not join");
            std::thread::sleep(Duration::from_millis(10));
        }
        conforms(&mut Bed::real(here, there));
    }
}
