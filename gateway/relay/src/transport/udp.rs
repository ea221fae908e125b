//! UDP, to one peer or to a group: a socket for each endpoint, many datagrams with one call.
//!
//! A socket with one peer is connected: the kernel drops what strangers send before it costs this partition anything. One of
//! a group can not be; there the sender's address is looked at.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::OwnedFd;

use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with, sockopt};
use rustix::time::{ClockId, clock_gettime};

use super::batch::{BATCH, Inbox, Outbox, note_arrivals, only_where_joined};
use super::{Came, Endpoint, RelayTransport, TransportError};
use crate::Rejection;

/// What the kernel keeps for a socket between two windows, bytes; it may give less.
const KEPT: usize = 1 << 20;
/// When the wall clock was set by more than this since the last look, its notes say nothing, ns.
const CLOCK_WAS_SET_NS: i64 = 100_000;
/// Datagrams do not lie in a socket for longer, ns.
const LONGEST_WAIT_NS: i64 = 10_000_000_000;

/// See the module's head.
pub struct Udp {
    ways: Vec<Way>,
    inbox: Inbox,
    wall: WallClock,
}

struct Way {
    receiving: UdpSocket,
    /// Of a group: a socket of its own, from the own address.
    sending: Option<UdpSocket>,
    outbox: Outbox,
    /// Of a group: datagrams from here are one's own.
    own: Option<SocketAddr>,
    endpoint: usize,
    failed: usize,
    /// Answers that nobody listens at the other end, to what was received.
    port_unreachable: u64,
}

impl Way {
    fn flush(&mut self) {
        self.failed += self.outbox.flush(self.sending.as_ref().unwrap_or(&self.receiving));
    }
}

impl Udp {
    /// Opens a socket for each endpoint; one whose remote address is that of a group listens to the group.
    ///
    /// # Errors
    /// An address that can not be had or used.
    pub fn open(endpoints: &[Endpoint]) -> Result<Self, TransportError> {
        let mut ways = Vec::with_capacity(endpoints.len());
        for (number, endpoint) in endpoints.iter().enumerate() {
            let shared = endpoints.iter().filter(|other| other.local == endpoint.local).count() > 1;
            ways.push(Way::open(number, endpoint, shared)?);
        }
        // One byte more than any: a longer datagram shows.
        let longest = endpoints.iter().map(|endpoint| endpoint.max_datagram).max().unwrap_or(0) + 1;
        Ok(Self { ways, inbox: Inbox::new(longest), wall: WallClock::default() })
    }

    /// The socket on which an endpoint's datagrams come: to wait for them.
    #[must_use]
    pub fn socket(&self, endpoint: usize) -> Option<&UdpSocket> {
        self.ways.get(endpoint).map(|way| &way.receiving)
    }
}

impl Way {
    fn open(number: usize, endpoint: &Endpoint, shared: bool) -> Result<Self, TransportError> {
        let Endpoint { local, remote, .. } = *endpoint;
        let network = || endpoint.name.clone();
        let refused = |error: io::Error| TransportError::Remote { network: network(), local, remote, error };
        let cannot_bind = |error: io::Error| TransportError::Bind { network: network(), local, error };
        let group = remote.ip().is_multicast();
        let (receiving, sending) = if group {
            let (IpAddr::V4(to), IpAddr::V4(own)) = (remote.ip(), local.ip()) else {
                return Err(refused(io::Error::other("a group has to be one of IPv4")));
            };
            let receiving = bound(remote, true).map_err(&refused)?;
            receiving.join_multicast_v4(&to, &own).map_err(refused)?;
            only_where_joined(&receiving).map_err(refused)?;
            let sending = bound(local, shared).map_err(cannot_bind)?;
            send_from(&sending, own).map_err(refused)?;
            sending.connect(remote).map_err(refused)?;
            (receiving, Some(sending))
        } else {
            let socket = bound(local, shared).map_err(cannot_bind)?;
            socket.connect(remote).map_err(refused)?;
            (socket, None)
        };
        note_arrivals(&receiving).map_err(refused)?;
        let _ = sockopt::set_socket_recv_buffer_size(&receiving, KEPT); // what there is has to do
        Ok(Self {
            receiving,
            own: sending.as_ref().and_then(|socket| socket.local_addr().ok()),
            sending,
            outbox: Outbox::new(endpoint.max_datagram),
            endpoint: number,
            failed: 0,
            port_unreachable: 0,
        })
    }
}

impl RelayTransport for Udp {
    fn send(&mut self, endpoint: usize, parts: [&[u8]; 2]) {
        let Some(way) = self.ways.get_mut(endpoint) else { return };
        if !way.outbox.add(parts) {
            way.flush();
            way.outbox.add(parts);
        }
    }

    fn flush(&mut self, _now_ns: u64, failed: &mut dyn FnMut(usize)) {
        for way in &mut self.ways {
            way.flush();
            (0..std::mem::take(&mut way.failed)).for_each(|_| failed(way.endpoint));
        }
    }

    fn receive(&mut self, now: &dyn Fn() -> u64, most: usize, take: &mut dyn FnMut(Came<'_>)) {
        let realtime_ns = self.wall.look();
        let now_ns = now();
        for way in &mut self.ways {
            let (own, endpoint) = (way.own, way.endpoint);
            let mut left = most;
            while left > 0 {
                let received = self.inbox.receive(&way.receiving, left, &mut |received| {
                    if own.is_some() && received.from == own {
                        return; // a group brings back what was sent to it
                    }
                    let noted = realtime_ns.zip(received.realtime_ns);
                    let at_ns = noted.map_or(now_ns, |noted| arrival_ns(now_ns, noted));
                    take(Came { endpoint, at_ns, datagram: received.bytes.ok_or(Rejection::Giant) });
                });
                left -= received;
                way.port_unreachable += std::mem::take(&mut self.inbox.port_unreachable);
                if received < BATCH {
                    break; // nothing is left
                }
            }
        }
    }

    fn port_unreachable_count(&self, endpoint: usize) -> u64 {
        self.ways.get(endpoint).map_or(0, |way| way.port_unreachable + way.outbox.port_unreachable)
    }
}

/// When a datagram came, module time, ns, of which the kernel noted the second instant of the wall clock, where the first one is now.
/// It may have come since that now.
fn arrival_ns(now_ns: u64, (wall_ns, came_ns): (u64, u64)) -> u64 {
    let since_ns = i64::try_from(i128::from(came_ns) - i128::from(wall_ns)).unwrap_or(0);
    now_ns.saturating_add_signed(since_ns.clamp(-LONGEST_WAIT_NS, LONGEST_WAIT_NS))
}

/// The kernel notes instants of the wall clock. It can be set; module time can not.
#[derive(Default)]
struct WallClock {
    /// Wall clock less monotonic clock at the last look, ns.
    ahead_ns: Option<i64>,
}

impl WallClock {
    /// The wall clock now, ns; nothing where it was set since the last look.
    fn look(&mut self) -> Option<u64> {
        let nanoseconds = |clock| {
            let time = clock_gettime(clock);
            time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
        };
        let (realtime_ns, monotonic_ns) = (nanoseconds(ClockId::Realtime), nanoseconds(ClockId::Monotonic));
        let ahead_ns = realtime_ns - monotonic_ns;
        let before = self.ahead_ns.replace(ahead_ns);
        let was_set = before.is_some_and(|before_ns| (ahead_ns - before_ns).abs() > CLOCK_WAS_SET_NS);
        u64::try_from(realtime_ns).ok().filter(|_| !was_set)
    }
}

/// A socket at `address`, which others of this process may share.
fn bound(address: SocketAddr, shared: bool) -> io::Result<UdpSocket> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket: OwnedFd = socket_with(family, SocketType::DGRAM, flags, None)?;
    if shared {
        sockopt::set_socket_reuseaddr(&socket, true)?;
    }
    bind(&socket, &address)?;
    Ok(socket.into())
}

/// Lets what goes to a group leave through the interface with the address `own`, and come back to listeners on this
/// computer.
fn send_from(socket: &UdpSocket, own: Ipv4Addr) -> io::Result<()> {
    sockopt::set_ip_multicast_if(socket, &own)?;
    socket.set_multicast_loop_v4(true)?;
    socket.set_multicast_ttl_v4(1) // one switched network
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::conformance::{Bed, conforms};

    fn endpoint(network: usize, local: SocketAddr, remote: SocketAddr, initiator: bool) -> Endpoint {
        let name = ["a", "b"][network].to_owned();
        Endpoint { link: 7, place: 0, network, name, initiator, local, remote, max_datagram: 2000 }
    }

    /// Ports that nobody has at the moment.
    fn free(count: usize) -> Vec<SocketAddr> {
        let sockets: Vec<_> = (0..count).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap()).collect();
        sockets.iter().map(|socket| socket.local_addr().unwrap()).collect()
    }

    #[test]
    fn udp_to_one_peer_conforms() {
        let at = free(4);
        let here = [endpoint(0, at[0], at[1], true), endpoint(1, at[2], at[3], true)];
        let there = [endpoint(0, at[1], at[0], false), endpoint(1, at[3], at[2], false)];
        conforms(&mut Bed::real(Udp::open(&here).unwrap(), Udp::open(&there).unwrap()));
    }

    #[test]
    fn udp_to_a_group_conforms() {
        let at = free(4);
        let group = |address: SocketAddr| SocketAddr::from(([239, 192, 77, 1], address.port()));
        let (a, b) = (group(free(1)[0]), group(free(1)[0]));
        let here = [endpoint(0, at[0], a, true), endpoint(1, at[2], b, true)];
        let there = [endpoint(0, at[1], a, false), endpoint(1, at[3], b, false)];
        conforms(&mut Bed::real(Udp::open(&here).unwrap(), Udp::open(&there).unwrap()));
    }

    #[test]
    fn several_links_share_an_address_and_are_told_apart_by_their_peers() {
        let at = free(3);
        let mut hub = Udp::open(&[endpoint(0, at[0], at[1], true), endpoint(0, at[0], at[2], true)]).unwrap();
        let (one, two) = (UdpSocket::bind(at[1]).unwrap(), UdpSocket::bind(at[2]).unwrap());
        two.send_to(b"two", at[0]).unwrap();
        one.send_to(b"one", at[0]).unwrap();
        let mut found = Vec::new();
        hub.receive(&|| 0, 8, &mut |came| found.push((came.endpoint, came.datagram.unwrap().to_vec())));
        assert_eq!(found, [(0, b"one".to_vec()), (1, b"two".to_vec())]);
    }

    #[test]
    fn what_a_stranger_sends_does_not_reach_the_relay() {
        let at = free(2);
        let mut udp = Udp::open(&[endpoint(0, at[0], at[1], true)]).unwrap();
        UdpSocket::bind("127.0.0.1:0").unwrap().send_to(b"hello", at[0]).unwrap();
        udp.receive(&|| 0, 8, &mut |came| panic!("{came:?}"));
    }

    #[test]
    fn what_waits_is_taken_although_nobody_listened_before() {
        let at = free(2);
        let mut udp = Udp::open(&[endpoint(0, at[0], at[1], true)]).unwrap();
        udp.send(0, [b"is anybody there?", b""]);
        udp.flush(0, &mut |_| ());
        std::thread::sleep(std::time::Duration::from_millis(20)); // the refusal comes back to the socket
        UdpSocket::bind(at[1]).unwrap().send_to(b"now there is", at[0]).unwrap();
        let mut found = Vec::new();
        udp.receive(&|| 0, 8, &mut |came| found.push(came.datagram.unwrap().to_vec()));
        assert_eq!(found, [b"now there is"]);
    }

    #[test]
    fn peer_whose_computer_is_there_and_whose_relay_is_not_is_told_from_a_silent_one() {
        let at = free(4);
        let ends = [endpoint(0, at[0], at[1], true), endpoint(1, at[2], at[3], true)];
        let mut udp = Udp::open(&ends).unwrap();
        // Somebody listens at the second one, and says nothing.
        let _silent = UdpSocket::bind(at[3]).unwrap();
        for _ in 0..3 {
            (0..2).for_each(|number| udp.send(number, [b"is anybody there?", b""]));
            udp.flush(0, &mut |_| ());
            std::thread::sleep(std::time::Duration::from_millis(20)); // the refusal comes back to the socket
            udp.receive(&|| 0, 8, &mut |came| panic!("{came:?}"));
        }
        assert!((1..=3).contains(&udp.port_unreachable_count(0)), "{}", udp.port_unreachable_count(0));
        assert_eq!(udp.port_unreachable_count(1), 0);
    }

    #[test]
    fn an_address_that_is_not_to_be_had_is_refused_with_the_mend() {
        let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
        let (local, remote) = (taken.local_addr().unwrap(), free(1)[0]);
        let error = Udp::open(&[endpoint(0, local, remote, true)]).err().unwrap().to_string();
        assert!(error.contains(&local.to_string()) && error.contains("no other program has"), "{error}");
    }

    #[test]
    fn arrival_before_and_after_the_look_at_both_clocks_is_dated_by_their_difference() {
        assert_eq!(arrival_ns(5_000, (70_000, 69_000)), 4_000);
        assert_eq!(arrival_ns(5_000, (70_000, 70_300)), 5_300, "it came while the sockets were read");
        assert_eq!(arrival_ns(5_000, (70_000, 60_000)), 0, "before module time began");
    }

    #[test]
    fn arrival_is_not_dated_before_its_sending_by_a_relay_that_is_held_between_its_looks_at_two_clocks() {
        let at = free(2);
        let mut udp = Udp::open(&[endpoint(0, at[0], at[1], true)]).unwrap();
        let begun = std::time::Instant::now();
        let module_ns = || 1_000_000_000 + begun.elapsed().as_nanos() as u64;
        let sent_ns = module_ns();
        UdpSocket::bind(at[1]).unwrap().send_to(b"when?", at[0]).unwrap();
        let held = || {
            let now_ns = module_ns();
            std::thread::sleep(std::time::Duration::from_millis(3));
            now_ns
        };
        let mut found = Vec::new();
        udp.receive(&held, 8, &mut |came| found.push(came.at_ns));
        assert!(found.len() == 1 && found[0] >= sent_ns, "{found:?} before {sent_ns}");
    }

    #[test]
    fn an_instant_at_which_the_wall_clock_was_set_is_not_believed() {
        let mut clock = WallClock::default();
        assert!(clock.look().is_some() && clock.look().is_some());
        clock.ahead_ns = clock.ahead_ns.map(|ahead_ns| ahead_ns - 2_000_000);
        assert!(clock.look().is_none());
        assert!(clock.look().is_some());
    }
}
