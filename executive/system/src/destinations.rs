//! To how many addresses a partition sends: a program inside the kernel, which it runs for each packet that leaves a socket of a
//! control group (BPF).
//!
//! The kernel keeps an entry for each neighbour that it looks for, in tables that all programs of a network namespace share
//! (`net.ipv4.neigh.default.gc_thresh3`). Who fills them keeps others from reaching whom they have not talked to lately. The program sees a
//! packet as it leaves, so that neither routes of the sender's own (options of IP, routing headers) nor a choice of interface hide where
//! it goes.

use std::io;
use std::os::fd::BorrowedFd;

use crate::bpf::{
    EXIT, Hook, LOAD_BYTES, Lookup, MAP_LOOKUP, MAP_STORE, Map, R0, R1, R2, R3, R4, R6, R7, R8, R10, add,
    attach, call, copy, instruction, load_word, set, skip_if,
};

/// The destinations of one control group. They end with the group.
#[derive(Debug)]
pub struct Destinations(Map);

/// A destination: number of the interface, then an address of 16 bytes, of which one of IPv4 has the first four.
const KEY: usize = 20;
/// Where key, address and a value are on the program's stack.
const KEY_AT: i32 = -20;
const ADDRESS_AT: i32 = -16;
const VALUE_AT: i32 = -24;

/// Where a packet's protocol and interface are in what a program is given (`struct __sk_buff`).
const PROTOCOL: i16 = 16;
const INTERFACE: i16 = 40;

impl Destinations {
    /// Lets the processes of `group` send to `count` addresses at most. A packet to one more is refused with EPERM.
    ///
    /// # Errors
    /// The kernel has no such programs, or this process may not load them (CAP_BPF and CAP_NET_ADMIN).
    pub fn limit(group: BorrowedFd<'_>, count: usize) -> io::Result<Self> {
        let map = Map::new(Lookup::Hash, KEY, size_of::<u32>(), count)?;
        attach(group, &program(&map), Hook::PacketLeaves)?;
        Ok(Self(map))
    }

    /// None is known: for a group whose processes have ended.
    ///
    /// # Errors
    /// The kernel refuses.
    pub fn clear(&self) -> io::Result<()> {
        self.0.clear()
    }
}

fn program(map: &Map) -> Vec<u64> {
    let number = |protocol: libc::c_int| i32::from((protocol as u16).to_be());
    let mut program = vec![
        copy(R6, R1),
        load_word(R2, R6, INTERFACE),
        store_word(KEY_AT, R2),
        set(R2, 0),
        store_wide(ADDRESS_AT, R2),
        store_wide(ADDRESS_AT + 8, R2),
        store_word(VALUE_AT, R2),
        load_word(R2, R6, PROTOCOL),
        set(R7, 16), // where the address is in the header,
        set(R8, 4),  // and how long it is
        skip_if(R2, number(libc::ETH_P_IP), 5),
        set(R7, 24),
        set(R8, 16),
        skip_if(R2, number(libc::ETH_P_IPV6), 2),
        set(R0, 1), // for anything else neighbours are not looked for
        EXIT,
        copy(R1, R6),
        copy(R2, R7),
        copy(R3, R10),
        add(R3, ADDRESS_AT),
        copy(R4, R8),
        call(LOAD_BYTES),
        skip_if(R0, 0, 2),
        set(R0, 0),
        EXIT,
    ];
    let point_at_key = [copy(R2, R10), add(R2, KEY_AT)];
    program.extend(map.point_at(R1));
    program.extend(point_at_key);
    program.extend([call(MAP_LOOKUP), skip_if(R0, 0, 2), set(R0, 1), EXIT]);
    program.extend(map.point_at(R1));
    program.extend(point_at_key);
    program.extend([copy(R3, R10), add(R3, VALUE_AT), set(R4, 0), call(MAP_STORE)]);
    program.extend([skip_if(R0, 0, 2), set(R0, 0), EXIT, set(R0, 1), EXIT]);
    program
}

/// The four bytes at `offset` on the stack become those of `from`.
const fn store_word(offset: i32, from: u64) -> u64 {
    instruction(0x63, R10, from, offset as i16, 0)
}

/// The same with eight.
const fn store_wide(offset: i32, from: u64) -> u64 {
    instruction(0x7b, R10, from, offset as i16, 0)
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;
    use crate::bpf::group::{is_inside, limited, passes_inside};

    const COUNT: usize = 5;

    fn reached(addresses: impl Iterator<Item = String>) -> Vec<bool> {
        let sockets = [UdpSocket::bind("127.0.0.1:0").unwrap(), UdpSocket::bind("[::1]:0").unwrap()];
        let send = |address: String| {
            let socket = &sockets[usize::from(address.starts_with('['))];
            match socket.send_to(b"x", &address) {
                Ok(_) => true,
                Err(error) => {
                    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied, "{address}: {error}");
                    false
                }
            }
        };
        addresses.map(send).collect()
    }

    fn many() -> impl Iterator<Item = String> {
        (1..=COUNT * 3).map(|number| format!("127.0.1.{number}:9"))
    }

    #[test]
    fn processes_inside_a_group_reach_as_many_addresses_as_they_may_and_those_again() {
        if !is_inside() {
            return;
        }
        let six = reached(["[::1]:9".to_owned(), "[::1]:10".to_owned()].into_iter());
        assert_eq!(six, [true, true], "two ports of one address");
        for _ in 0..3 {
            let reached = reached(many());
            let expected: Vec<bool> = (0..COUNT * 3).map(|place| place < COUNT - 1).collect();
            assert_eq!(reached, expected, "with the one of IPv6");
        }
        let listener = std::net::TcpListener::bind("127.0.2.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        // What a connection sends is dropped, which ends in a time-out or at once.
        std::net::TcpStream::connect_timeout(&address, std::time::Duration::from_millis(300)).unwrap_err();
    }

    #[test]
    fn a_group_reaches_few_addresses_and_its_successor_as_many_and_others_have_what_they_had() {
        let Some((group, destinations)) = limited("destinations", |group| Destinations::limit(group, COUNT))
        else {
            return;
        };
        let inside = || {
            passes_inside(
                &group,
                "destinations::tests::processes_inside_a_group_reach_as_many_addresses_as_they_may_and_those_again",
            )
        };
        assert!(inside());
        destinations.clear().unwrap();
        assert!(inside());
        assert!(reached(many()).into_iter().all(|reached| reached));
    }
}
