//! How many datagram sockets a partition has: two programs inside the kernel, which it runs for a control group where such a
//! socket is made and where it is closed (BPF, attached to the group).
//!
//! What a socket has sent and the kernel has not passed on yet counts as nobody's memory. The kernel bounds it for each socket, so
//! the number of sockets bounds it for the partition. A closed socket keeps its place for as long as what it sent may wait.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

/// How long what was sent waits after its socket was closed, ns: the kernel asks a neighbour three times, a second apart, where it is.
const WAITS_NS: u64 = 4_000_000_000;

/// The places for sockets of one control group. They end with the group.
#[derive(Debug)]
pub struct SocketPlaces {
    /// A value for each place: 0 or an instant of CLOCK_MONOTONIC from which on it is free, or all ones while its socket is open.
    map: OwnedFd,
    count: usize,
}

impl SocketPlaces {
    /// Lets the processes of `group` have `count` open datagram sockets of the internet at most.
    ///
    /// # Errors
    /// The kernel has no such programs, or this process may not load them (CAP_BPF and CAP_NET_ADMIN).
    pub fn limit(group: BorrowedFd<'_>, count: usize) -> io::Result<Self> {
        Self::limit_for(group, count, WAITS_NS)
    }

    fn limit_for(group: BorrowedFd<'_>, count: usize, waits_ns: u64) -> io::Result<Self> {
        let places = Self { map: make_map(count)?, count };
        let map = places.map.as_raw_fd();
        attach(group, &load(&at_creation(map, count), SOCK_CREATE)?, SOCK_CREATE)?;
        attach(group, &load(&at_release(map, count, waits_ns), SOCK_RELEASE)?, SOCK_RELEASE)?;
        Ok(places)
    }

    /// All places are free: for a group whose processes have ended.
    ///
    /// # Errors
    /// The kernel refuses.
    pub fn clear(&self) -> io::Result<()> {
        let (key, value) = (0_u32, vec![0_u64; self.count]);
        let element = Element {
            map: self.map.as_raw_fd().cast_unsigned(),
            key: (&raw const key) as u64,
            value: value.as_ptr() as u64,
            flags: 0,
        };
        // SAFETY: the kernel reads a key of four bytes and a value as long as the map was made for.
        unsafe { bpf(MAP_UPDATE, &element) }.map(drop)
    }
}

// Numbers of `linux/bpf.h`, which the C library's binding does not have.
const MAP_CREATE: libc::c_int = 0;
const MAP_UPDATE: libc::c_int = 2;
const PROGRAM_LOAD: libc::c_int = 5;
const PROGRAM_ATTACH: libc::c_int = 8;
const MAP_OF_ARRAY: u32 = 2;
const PROGRAM_OF_GROUP_SOCKETS: u32 = 9;
const SOCK_CREATE: u32 = 2;
const SOCK_RELEASE: u32 = 34;
/// Programs of groups above and below run too.
const ALLOW_MULTI: u32 = 2;

#[repr(C)]
struct MapShape {
    kind: u32,
    key_size: u32,
    value_size: u32,
    entries: u32,
}

#[repr(C)]
struct Element {
    map: u32,
    key: u64,
    value: u64,
    flags: u64,
}

#[repr(C)]
struct Program {
    kind: u32,
    length: u32,
    instructions: u64,
    license: u64,
    log_level: u32,
    log_size: u32,
    log: u64,
    kernel: u32,
    flags: u32,
    name: [u8; 16],
    interface: u32,
    attach: u32,
}

#[repr(C)]
struct Attachment {
    group: u32,
    program: u32,
    attach: u32,
    flags: u32,
}

/// Makes the call; a descriptor or 0.
///
/// # Safety
/// What `attributes` points to is what the kernel expects of `command`.
unsafe fn bpf<T>(command: libc::c_int, attributes: &T) -> io::Result<libc::c_long> {
    // SAFETY: the kernel reads as many bytes as it is told of; what they point to is the caller's promise.
    let done =
        unsafe { libc::syscall(libc::SYS_bpf, command, std::ptr::from_ref(attributes), size_of::<T>()) };
    if done < 0 { Err(io::Error::last_os_error()) } else { Ok(done) }
}

fn make_map(count: usize) -> io::Result<OwnedFd> {
    let value_size = (count * size_of::<u64>()) as u32;
    let shape = MapShape { kind: MAP_OF_ARRAY, key_size: 4, value_size, entries: 1 };
    // SAFETY: numbers only; the kernel returns a new descriptor, which nobody else owns.
    unsafe { bpf(MAP_CREATE, &shape).map(|map| OwnedFd::from_raw_fd(map as i32)) }
}

fn load(instructions: &[u64], attach: u32) -> io::Result<OwnedFd> {
    let mut name = [0; 16];
    name[..8].copy_from_slice(b"bateleur");
    let program = Program {
        kind: PROGRAM_OF_GROUP_SOCKETS,
        length: instructions.len() as u32,
        instructions: instructions.as_ptr() as u64,
        license: c"MIT or Apache-2.0".as_ptr() as u64,
        log_level: 0,
        log_size: 0,
        log: 0,
        kernel: 0,
        flags: 0,
        name,
        interface: 0,
        attach,
    };
    // SAFETY: the kernel reads the instructions and the text; it returns a new descriptor, which nobody else owns.
    unsafe { bpf(PROGRAM_LOAD, &program).map(|program| OwnedFd::from_raw_fd(program as i32)) }
}

fn attach(group: BorrowedFd<'_>, program: &OwnedFd, attach: u32) -> io::Result<()> {
    let attachment = Attachment {
        group: group.as_raw_fd().cast_unsigned(),
        program: program.as_raw_fd().cast_unsigned(),
        attach,
        flags: ALLOW_MULTI,
    };
    // SAFETY: numbers only.
    unsafe { bpf(PROGRAM_ATTACH, &attachment) }.map(drop)
}

// The programs, in the machine's instructions of eight bytes (Linux, Documentation/bpf/standardization/instruction-set.rst).

/// Registers: the result, arguments, what calls leave alone, the stack's end.
const R0: u64 = 0;
const R1: u64 = 1;
const R2: u64 = 2;
const R6: u64 = 6;
const R7: u64 = 7;
const R8: u64 = 8;
const R9: u64 = 9;
const R10: u64 = 10;

/// Functions of the kernel.
const MAP_LOOKUP: i32 = 1;
const NOW_NS: i32 = 5;

/// Where a socket's type is in what a program is given.
const TYPE: i16 = 8;

const fn instruction(operation: u64, to: u64, from: u64, offset: i16, number: i32) -> u64 {
    let offset = offset.cast_unsigned() as u64;
    let number = number.cast_unsigned() as u64;
    operation | to << 8 | from << 12 | offset << 16 | number << 32
}

const fn set(to: u64, number: i32) -> u64 {
    instruction(0xb7, to, 0, 0, number)
}

const fn copy(to: u64, from: u64) -> u64 {
    instruction(0xbf, to, from, 0, 0)
}

const fn call(function: i32) -> u64 {
    instruction(0x85, 0, 0, 0, function)
}

const EXIT: u64 = instruction(0x95, 0, 0, 0, 0);

/// Two instructions: `to` is a number of 64 bits.
fn set_wide(to: u64, from: u64, number: u64) -> [u64; 2] {
    let half = |number: u64| (number as u32).cast_signed();
    [instruction(0x18, to, from, 0, half(number)), instruction(0, 0, 0, 0, half(number >> 32))]
}

/// Goes on two instructions from its end if the socket is no datagram socket, else at its end with the instant in `R7` and the
/// places at `R6`.
fn find_places(map: i32, otherwise: u64) -> Vec<u64> {
    const MAP_BY_DESCRIPTOR: u64 = 1;
    let mut program = vec![
        instruction(0x61, R2, R1, TYPE, 0),            // R2 = its type
        instruction(0x15, R2, 0, 2, libc::SOCK_DGRAM), // go on if that is SOCK_DGRAM
        set(R0, 1),
        EXIT,
        call(NOW_NS),
        copy(R7, R0),
        instruction(0x62, R10, 0, -4, 0), // the key: 0
        copy(R2, R10),
        instruction(0x07, R2, 0, 0, -4), // where it is
    ];
    program.extend(set_wide(R1, MAP_BY_DESCRIPTOR, map.cast_unsigned().into()));
    program.extend([
        call(MAP_LOOKUP),
        instruction(0x55, R0, 0, 2, 0), // go on if there is one, as always
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
fn at_creation(map: i32, count: usize) -> Vec<u64> {
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
fn at_release(map: i32, count: usize, waits_ns: u64) -> Vec<u64> {
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
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    use super::*;
    use crate::cgroup::Group;

    /// Set in the process that makes the sockets, because a socket belongs to the group of who makes it.
    const INSIDE: &str = "BATELEUR_TEST_SOCKET_PLACES";
    const COUNT: usize = 5;
    const WAITS: Duration = Duration::from_millis(600);

    fn socket() -> io::Result<UdpSocket> {
        UdpSocket::bind("127.0.0.1:0")
    }

    #[test]
    fn sockets_inside_a_group_are_as_many_as_places_and_a_closed_one_keeps_its_place_for_a_while() {
        if std::env::var_os(INSIDE).is_none() {
            return;
        }
        let mut line = String::new();
        io::stdin().read_line(&mut line).unwrap();
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
        let name = format!("bateleur.sockets_test.{}", std::process::id());
        let Ok(group) = Group::beside_self(&name) else {
            return eprintln!("skipped: no control group of version 2 that may be used here");
        };
        let places = match SocketPlaces::limit_for(group.as_fd(), COUNT, WAITS.as_nanos() as u64) {
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                return eprintln!("skipped: no programs for control groups here: {error}");
            }
            made => made.unwrap(),
        };
        let inside = || {
            let test = "sockets::tests::sockets_inside_a_group_are_as_many_as_places_and_a_closed_one_keeps_its_place_for_a_while";
            let mut child = Command::new(std::env::current_exe().unwrap())
                .args(["--exact", test, "--nocapture"])
                .env(INSIDE, "1")
                .stdin(Stdio::piped())
                .stdout(Stdio::null())
                .spawn()
                .unwrap();
            std::fs::write(group.path().join("cgroup.procs"), child.id().to_string()).unwrap();
            drop(child.stdin.take());
            child.wait().unwrap().success()
        };
        assert!(inside());
        // Its places wait; those of a successor do not.
        places.clear().unwrap();
        assert!(inside());
        let others: Vec<_> = (0..COUNT * 2).map(|_| socket().unwrap()).collect();
        assert_eq!(others.len(), COUNT * 2);
    }
}
