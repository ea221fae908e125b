//! How many datagram sockets a partition has: two programs inside the kernel, which it runs for a control group where such a
//! socket is made and where it is closed (BPF, attached to the group).
//!
//! What a socket has sent and the kernel has not passed on yet counts as nobody's memory. The kernel bounds it for each socket, so
//! the number of sockets bounds it for the partition. A closed socket keeps its place for as long as what it sent may wait.

use std::io;
use std::os::fd::BorrowedFd;

use crate::bpf::{
    EXIT, Hook, Lookup, MAP_LOOKUP, Map, NOW_NS, R0, R1, R2, R6, R7, R8, R9, R10, add, attach, call, copy,
    instruction, load_word, set, set_wide, skip_if, skip_unless,
};

/// How long what was sent waits after its socket was closed, ns: the kernel asks a neighbour three times, a second apart, where it is.
const WAITS_NS: u64 = 4_000_000_000;

/// The places for sockets of one control group. They end with the group.
#[derive(Debug)]
pub struct SocketPlaces(
    /// A value for each place: 0 or an instant of CLOCK_MONOTONIC from which on it is free, or all ones while its socket is open.
    Map,
);

impl SocketPlaces {
    /// Lets the processes of `group` have `count` open datagram sockets of the internet at most.
    ///
    /// # Errors
    /// The kernel has no such programs, or this process may not load them (CAP_BPF and CAP_NET_ADMIN).
    pub fn limit(group: BorrowedFd<'_>, count: usize) -> io::Result<Self> {
        Self::limit_for(group, count, WAITS_NS)
    }

    fn limit_for(group: BorrowedFd<'_>, count: usize, waits_ns: u64) -> io::Result<Self> {
        let map = Map::new(Lookup::Array, size_of::<u32>(), count * size_of::<u64>(), 1)?;
        attach(group, &at_creation(&map, count), Hook::SocketCreate)?;
        attach(group, &at_release(&map, count, waits_ns), Hook::SocketRelease)?;
        Ok(Self(map))
    }

    /// All places are free: for a group whose processes have ended.
    ///
    /// # Errors
    /// The kernel refuses.
    pub fn clear(&self) -> io::Result<()> {
        self.0.zero(0)
    }
}

/// Where a socket's type is in what a program is given.
const TYPE: i16 = 8;

/// Goes on two instructions from its end if the socket is no datagram socket, else at its end with the instant in `R7` and the
/// places at `R6`.
fn find_places(map: &Map, otherwise: u64) -> Vec<u64> {
    let mut program = vec![
        load_word(R2, R1, TYPE), // its type
        skip_if(R2, libc::SOCK_DGRAM, 2),
        set(R0, 1),
        EXIT,
        call(NOW_NS),
        copy(R7, R0),
        instruction(0x62, R10, 0, -4, 0), // the key: 0
        copy(R2, R10),
        add(R2, -4), // where it is
    ];
    program.extend(map.point_at(R1));
    program.extend([
        call(MAP_LOOKUP),
        skip_unless(R0, 0, 2), // there is one, as always
        otherwise,
        EXIT,
        copy(R6, R0),
        set(R8, -1), // a place whose socket is open
    ]);
    program
}

/// `R0` becomes what place `place` holds.
fn look_at(place: usize) -> u64 {
    instruction(0x79, R0, R6, (place * size_of::<u64>()) as i16, 0)
}

/// Puts `from` into the place if that holds `R0` still; `R0` becomes what it held.
fn exchange(place: usize, from: u64) -> u64 {
    const COMPARE_AND_EXCHANGE: i32 = 0xf1;
    instruction(0xdb, R6, from, (place * size_of::<u64>()) as i16, COMPARE_AND_EXCHANGE)
}

/// Takes the first free place; a socket that finds none is not made.
fn at_creation(map: &Map, count: usize) -> Vec<u64> {
    let mut program = find_places(map, set(R0, 0));
    for place in 0..count {
        program.extend([
            look_at(place),
            instruction(0x2d, R0, R7, 5, 0), // to the next place if it is free later than now
            copy(R9, R0),
            exchange(place, R8),
            instruction(0x5d, R0, R9, 2, 0), // to the next place if somebody else was faster
            set(R0, 1),
            EXIT,
        ]);
    }
    program.extend([set(R0, 0), EXIT]);
    program
}

/// Gives back the first place that is taken, which is as good as any, from `waits_ns` after now.
fn at_release(map: &Map, count: usize, waits_ns: u64) -> Vec<u64> {
    let mut program = find_places(map, set(R0, 1));
    program.extend(set_wide(R1, 0, waits_ns));
    program.push(instruction(0x0f, R7, R1, 0, 0)); // R7 += R1
    for place in 0..count {
        program.extend([
            look_at(place),
            instruction(0x5d, R0, R8, 4, 0), // to the next place if it is not taken
            exchange(place, R7),
            instruction(0x5d, R0, R8, 2, 0), // to the next place if somebody else was faster
            set(R0, 1),
            EXIT,
        ]);
    }
    program.extend([set(R0, 1), EXIT]);
    program
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, UdpSocket};
    use std::time::{Duration, Instant};

    use super::*;
    use crate::bpf::group::{is_inside, limited, passes_inside};

    const COUNT: usize = 5;
    const WAITS: Duration = Duration::from_millis(600);

    fn socket() -> io::Result<UdpSocket> {
        UdpSocket::bind("127.0.0.1:0")
    }

    #[test]
    fn sockets_inside_a_group_are_as_many_as_places_and_a_closed_one_keeps_its_place_for_a_while() {
        if !is_inside() {
            return;
        }
        let mut open: Vec<UdpSocket> = std::iter::from_fn(|| socket().ok()).take(99).collect();
        assert_eq!(open.len(), COUNT);
        assert_eq!(UdpSocket::bind("[::1]:0").unwrap_err().kind(), io::ErrorKind::PermissionDenied);
        let stream = TcpListener::bind("127.0.0.1:0").unwrap();
        drop(stream);
        socket().unwrap_err(); // what it listened on had no place to give back
        open.truncate(COUNT - 2);
        let closed = Instant::now();
        let came = loop {
            let tried = Instant::now();
            if let Ok(socket) = socket() {
                open.push(socket);
                break closed.elapsed();
            }
            assert!(tried - closed < Duration::from_secs(30), "no place is given back");
            std::thread::sleep(Duration::from_millis(1));
        };
        assert!(came >= WAITS - Duration::from_millis(100), "after {came:?}");
        open.push(socket().unwrap());
        socket().unwrap_err();
    }

    #[test]
    fn a_group_has_as_many_datagram_sockets_as_places_and_others_have_what_they_had() {
        let Some((group, places)) =
            limited("sockets", |group| SocketPlaces::limit_for(group, COUNT, WAITS.as_nanos() as u64))
        else {
            return;
        };
        let inside = || {
            passes_inside(
                &group,
                "sockets::tests::sockets_inside_a_group_are_as_many_as_places_and_a_closed_one_keeps_its_place_for_a_while",
            )
        };
        assert!(inside());
        // Its places wait; those of a successor do not.
        places.clear().unwrap();
        assert!(inside());
        let others: Vec<_> = (0..COUNT * 2).map(|_| socket().unwrap()).collect();
        assert_eq!(others.len(), COUNT * 2);
    }
}
