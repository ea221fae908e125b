//! For modules that share a virtual clock: real sockets between them, a modelled network on top.
//!
//! Each datagram says when it arrives; the receiver keeps it until then. What a datagram that is on its way would meet in a
//! network is drawn by the sender from the model. Module time stands still while a window runs, so a datagram that was
//! sent has to lie in the receiver's socket when the sender's window ends: the sender sends itself a mark behind it, and
//! waits until that has come back through the same queue of the kernel.

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use bateleur_contract::relay::LinkModelTable;

use super::{Came, Endpoint, RelayTransport, TransportError};
use crate::Rejection;
use crate::model::{LinkModel, ModelCounters};

/// Bytes before a datagram: when it arrives, and the number of the parcel.
const HEAD: usize = 16;
/// How long a mark may take to come back, real time: on any machine that works, microseconds.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longer than any parcel.
const ROOM: usize = 1 << 16;

/// See the module's head.
pub struct Stepped {
    sockets: Vec<Socket>,
    ways: Vec<Way>,
    taken: Vec<(usize, Vec<u8>)>,
    buffer: Vec<u8>,
}

struct Socket {
    socket: UdpSocket,
    local: SocketAddr,
    marks: u64,
}

struct Way {
    socket: usize,
    remote: SocketAddr,
    max_datagram: usize,
    model: LinkModel,
    parcels: u64,
    /// By when it arrives, and the number of the parcel.
    on_the_way: BTreeMap<(u64, u64), Vec<u8>>,
}

impl Stepped {
    /// Opens the sockets of the endpoints, with the network that `model` says for what is sent.
    ///
    /// # Errors
    /// An address that can not be had.
    pub fn open(endpoints: &[Endpoint], model: &LinkModelTable) -> Result<Self, TransportError> {
        let mut stepped =
            Self { sockets: Vec::new(), ways: Vec::new(), taken: Vec::new(), buffer: vec![0; ROOM] };
        for endpoint in endpoints {
            let local = endpoint.local;
            let socket = match stepped.sockets.iter().position(|socket| socket.local == local) {
                Some(place) => place,
                None => {
                    let network = endpoint.name.clone();
                    let failed = |error| TransportError::Bind { network, local, error };
                    let socket = UdpSocket::bind(local).map_err(failed)?;
                    stepped.sockets.push(Socket { socket, local, marks: 0 });
                    stepped.sockets.len() - 1
                }
            };
            stepped.ways.push(Way {
                socket,
                remote: endpoint.remote,
                max_datagram: endpoint.max_datagram,
                model: LinkModel::new(model, &endpoint.name, endpoint.link, endpoint.initiator),
                parcels: 0,
                on_the_way: BTreeMap::new(),
            });
        }
        Ok(stepped)
    }

    /// What the modelled network did to what an endpoint has sent.
    #[must_use]
    pub fn model(&self, endpoint: usize) -> ModelCounters {
        self.ways.get(endpoint).map_or_else(ModelCounters::default, |way| way.model.counters())
    }

    /// Takes parcels out of a socket, until mark number `mark` where one is waited for. False: it did not come.
    fn empty(&mut self, number: usize, mark: Option<u64>) -> bool {
        let Self { sockets, ways, buffer, .. } = self;
        let Socket { socket, local, .. } = &sockets[number];
        let begun = Instant::now();
        let _ = socket.set_nonblocking(mark.is_none()); // the one way to fail is not to be a socket
        let _ = socket.set_read_timeout(Some(PATIENCE));
        loop {
            let Ok((length, from)) = socket.recv_from(buffer) else {
                // Nothing waits; or an error that an earlier datagram has met, behind which more may wait.
                if mark.is_none() || begun.elapsed() >= PATIENCE {
                    return mark.is_none();
                }
                continue;
            };
            let Some((at_ns, parcel, datagram)) = opened(&buffer[..length]) else { continue };
            if from == *local {
                match mark {
                    Some(mark) if mark == parcel => return true,
                    _ => continue,
                }
            }
            let sender = ways.iter_mut().find(|way| way.socket == number && way.remote == from);
            if let Some(way) = sender {
                way.on_the_way.insert((at_ns, parcel), datagram.to_vec());
            }
        }
    }
}

fn opened(parcel: &[u8]) -> Option<(u64, u64, &[u8])> {
    let (at_ns, rest) = parcel.split_first_chunk()?;
    let (number, datagram) = rest.split_first_chunk()?;
    Some((u64::from_le_bytes(*at_ns), u64::from_le_bytes(*number), datagram))
}

fn packed(at_ns: u64, number: u64, datagram: &[u8]) -> Vec<u8> {
    let mut parcel = Vec::with_capacity(HEAD + datagram.len());
    parcel.extend_from_slice(&at_ns.to_le_bytes());
    parcel.extend_from_slice(&number.to_le_bytes());
    parcel.extend_from_slice(datagram);
    parcel
}

impl RelayTransport for Stepped {
    fn send(&mut self, endpoint: usize, parts: [&[u8]; 2]) {
        self.taken.push((endpoint, parts.concat()));
    }

    fn flush(&mut self, now_ns: u64, failed: &mut dyn FnMut(usize)) {
        let mut used = vec![false; self.sockets.len()];
        for (endpoint, datagram) in std::mem::take(&mut self.taken) {
            let Some(way) = self.ways.get_mut(endpoint) else { continue };
            let socket = &self.sockets[way.socket].socket;
            for at_ns in way.model.pass(now_ns, datagram.len()).into_iter().flatten() {
                way.parcels += 1;
                let parcel = packed(at_ns, way.parcels, &datagram);
                // An error of an earlier one shows at the next call: that one is made once more.
                let sent =
                    socket.send_to(&parcel, way.remote).or_else(|_| socket.send_to(&parcel, way.remote));
                match sent {
                    Ok(_) => used[way.socket] = true,
                    Err(_) => failed(endpoint),
                }
            }
        }
        for number in (0..used.len()).filter(|number| used[*number]) {
            let Socket { socket, local, marks } = &mut self.sockets[number];
            *marks += 1;
            let mark = *marks;
            if socket.send_to(&packed(0, mark, &[]), *local).is_ok() {
                self.empty(number, Some(mark));
            }
        }
    }

    fn receive(&mut self, now: &dyn Fn() -> u64, most: usize, take: &mut dyn FnMut(Came<'_>)) {
        let now_ns = now();
        (0..self.sockets.len()).for_each(|number| {
            self.empty(number, None);
        });
        for (endpoint, way) in self.ways.iter_mut().enumerate() {
            for _ in 0..most {
                let Some(first) = way.on_the_way.first_entry().filter(|first| first.key().0 <= now_ns) else {
                    break;
                };
                let (at_ns, _) = *first.key();
                let datagram = first.remove();
                let fits = datagram.len() <= way.max_datagram;
                let datagram = if fits { Ok(datagram.as_slice()) } else { Err(Rejection::Giant) };
                take(Came { endpoint, at_ns, datagram });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::conformance::{Bed, conforms};

    fn pair(model: &LinkModelTable) -> (Stepped, Stepped) {
        // Nobody can take a port between this and its use but a test that is as unlucky.
        let free: Vec<SocketAddr> = (0..4)
            .map(|_| UdpSocket::bind("127.0.0.1:0").unwrap())
            .map(|socket| socket.local_addr().unwrap())
            .collect();
        let end = |initiator: bool| {
            let endpoint = |network: usize| {
                let (own, other) = if initiator { (0, 1) } else { (1, 0) };
                let (local, remote) = (free[2 * network + own], free[2 * network + other]);
                let name = ["a", "b"][network].to_owned();
                Endpoint { link: 7, place: 0, network, name, initiator, local, remote, max_datagram: 2000 }
            };
            Stepped::open(&[endpoint(0), endpoint(1)], model).unwrap()
        };
        (end(true), end(false))
    }

    fn came(transport: &mut Stepped, now_ns: u64) -> Vec<(usize, u64, Vec<u8>)> {
        let mut found = Vec::new();
        transport.receive(&|| now_ns, 100, &mut |came| {
            found.push((came.endpoint, came.at_ns, came.datagram.unwrap().to_vec()));
        });
        found
    }

    #[test]
    fn the_stepped_transport_conforms() {
        let (here, there) = pair(&LinkModelTable { delay_ns: 300_000, ..Default::default() });
        conforms(&mut Bed::stepped(here, there, 300_000));
    }

    #[test]
    fn a_datagram_comes_at_its_instant_and_not_before() {
        let (mut here, mut there) = pair(&LinkModelTable { delay_ns: 500, ..Default::default() });
        here.send(1, [b"da", b"ta"]);
        here.flush(1_000, &mut |_| panic!("sent"));
        assert_eq!(came(&mut there, 1_499), []);
        assert_eq!(came(&mut there, 1_700), [(1, 1_500, b"data".to_vec())]);
    }

    #[test]
    fn a_lossy_network_does_the_same_twice_and_says_what_it_did() {
        let table = LinkModelTable {
            seed: 5,
            delay_ns: 1_000,
            jitter_ns: 50_000,
            loss: 0.1,
            duplicate: 0.1,
            ..Default::default()
        };
        let fly = || {
            let (mut here, mut there) = pair(&table);
            let mut found = Vec::new();
            for number in 0..200_u64 {
                here.send(0, [&number.to_le_bytes(), b""]);
                here.flush(number * 10_000, &mut |_| panic!("sent"));
                found.extend(came(&mut there, number * 10_000));
            }
            found.extend(came(&mut there, u64::MAX));
            (found, here.model(0))
        };
        let (found, model) = fly();
        assert_eq!((found.clone(), model), fly());
        assert_eq!(model.arrivals, found.len() as u64);
        assert!(model.lost > 0 && model.duplicated > 0 && model.reordered > 0);
    }
}
