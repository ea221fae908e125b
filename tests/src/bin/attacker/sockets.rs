//! Sockets: the kernel's memory behind them, and what is on its way.

use super::*;

pub(super) fn loopback(port: u16) -> libc::sockaddr_in {
    // SAFETY: plain data, for which zero is a value.
    let mut address: libc::sockaddr_in = unsafe { std::mem::zeroed() };
    address.sin_family = libc::AF_INET as libc::sa_family_t;
    address.sin_port = port.to_be();
    address.sin_addr.s_addr = u32::from_be_bytes([127, 0, 0, 1]).to_be();
    address
}

pub(super) fn widen(socket: c_long) {
    let much = 64 << 20_i32;
    for option in [libc::SO_RCVBUF, libc::SO_SNDBUF, libc::SO_RCVBUFFORCE, libc::SO_SNDBUFFORCE] {
        call!(SYS_setsockopt, socket, libc::SOL_SOCKET, option, &raw const much, 4);
    }
}

/// Sockets that are written to and never read.
pub(super) fn internet(held: &mut Held, turn: &Turn, kind: i32) {
    static BYTES: [u8; 60_000] = [0; 60_000];
    let length = size_of::<libc::sockaddr_in>();
    turn.repeat(|| {
        let receiver = call!(SYS_socket, libc::AF_INET, kind | libc::SOCK_NONBLOCK, 0);
        if !keep(held, receiver) {
            return false;
        }
        widen(receiver);
        let mut address = loopback(0);
        let mut room = length as libc::socklen_t;
        call!(SYS_bind, receiver, &raw const address, length);
        call!(SYS_getsockname, receiver, &raw mut address, &raw mut room);
        if kind == libc::SOCK_STREAM {
            call!(SYS_listen, receiver, 128);
        }
        let sender = call!(SYS_socket, libc::AF_INET, kind | libc::SOCK_NONBLOCK, 0);
        widen(sender);
        call!(SYS_connect, sender, &raw const address, length);
        let accepted = call!(SYS_accept4, receiver, null::<u8>(), null::<u8>(), libc::SOCK_NONBLOCK);
        keep(held, accepted);
        for _ in 0..64 {
            if call!(SYS_sendto, sender, BYTES.as_ptr(), BYTES.len(), 0, 0, 0) <= 0 {
                break;
            }
        }
        keep(held, sender)
    });
    // The first ones once more: what did not fit before may fit now.
    for sender in held.descriptors.iter().take(64) {
        call!(SYS_sendto, *sender, BYTES.as_ptr(), BYTES.len(), libc::MSG_DONTWAIT, 0, 0);
    }
}

/// Sockets with datagrams that are begun and never finished, so that the kernel keeps them.
pub(super) fn incomplete_datagrams(held: &mut Held, turn: &Turn) {
    // All together are less than a datagram may have.
    static BYTES: [u8; 15_000] = [0; 15_000];
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_NONBLOCK, 0);
        if !keep(held, socket) {
            return false;
        }
        widen(socket);
        let address = loopback(9);
        let length = size_of::<libc::sockaddr_in>();
        call!(SYS_connect, socket, &raw const address, length);
        let cork = 1_i32;
        for level in [libc::SOL_UDP, libc::IPPROTO_UDPLITE] {
            call!(SYS_setsockopt, socket, level, libc::UDP_CORK, &raw const cork, 4);
        }
        call!(SYS_write, socket, BYTES.as_ptr(), BYTES.len());
        call!(SYS_sendto, socket, BYTES.as_ptr(), BYTES.len(), libc::MSG_MORE, &raw const address, length);
        // SAFETY: plain data, for which zero is a value.
        let mut message: libc::mmsghdr = unsafe { std::mem::zeroed() };
        let mut part = libc::iovec { iov_base: BYTES.as_ptr().cast_mut().cast(), iov_len: BYTES.len() };
        (message.msg_hdr.msg_iov, message.msg_hdr.msg_iovlen) = (&raw mut part, 1);
        message.msg_hdr.msg_flags = libc::MSG_MORE;
        call!(SYS_sendmsg, socket, &raw const message.msg_hdr, libc::MSG_MORE);
        call!(SYS_sendmmsg, socket, &raw mut message, 1, libc::MSG_MORE);
        true
    });
}

/// Datagrams to computers that are not there: they wait until the kernel no longer asks for them, and the sockets are closed.
pub(super) fn silent_neighbours(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 1_400] = [0; 1_400];
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_NONBLOCK, 0);
        if socket < 0 {
            return false;
        }
        widen(socket);
        held.count += 1;
        let mut address = loopback(9);
        let number = 1 + held.count as u32 % 1_000;
        address.sin_addr.s_addr = (u32::from_be_bytes([10, 99, 1, 0]) + number).to_be();
        let length = size_of::<libc::sockaddr_in>();
        while call!(SYS_sendto, socket, BYTES.as_ptr(), BYTES.len(), 0, &raw const address, length) > 0
            && now_ns() < turn.until_ns
        {
            held.strike_ns += 1;
            if held.strike_ns.is_multiple_of(100) {
                break; // the kernel keeps no more for one neighbour
            }
        }
        call!(SYS_close, socket);
        true
    });
}

/// As many computers as a table of neighbours has room for, one packet each, over IPv4 and IPv6.
pub(super) fn many_neighbours(held: &mut Held, turn: &Turn) {
    while held.descriptors.len() < 2 {
        let family = if held.descriptors.is_empty() { libc::AF_INET } else { libc::AF_INET6 };
        let socket = call!(SYS_socket, family, libc::SOCK_DGRAM | libc::SOCK_NONBLOCK, 0);
        if socket < 0 {
            return;
        }
        keep(held, socket);
    }
    let [old, new] = [held.descriptors[0], held.descriptors[1]];
    turn.repeat(|| {
        held.count += 1;
        let mut address = loopback(9);
        address.sin_addr.s_addr = (u32::from_be_bytes([10, 99, 2, 0]) + held.count as u32 % 4_000).to_be();
        call!(SYS_sendto, old, c"x".as_ptr(), 1, 0, &raw const address, size_of::<libc::sockaddr_in>());
        // SAFETY: plain data, for which zero is a value.
        let mut address: libc::sockaddr_in6 = unsafe { std::mem::zeroed() };
        (address.sin6_family, address.sin6_port) = (libc::AF_INET6 as u16, 9_u16.to_be());
        address.sin6_addr.s6_addr[..2].copy_from_slice(&[0xfd, 0x99]);
        address.sin6_addr.s6_addr[14..].copy_from_slice(&(held.count as u16 % 4_000).to_be_bytes());
        call!(SYS_sendto, new, c"x".as_ptr(), 1, 0, &raw const address, size_of::<libc::sockaddr_in6>());
        true
    });
}

/// As many sockets of a bus as there may be, of which one sends and none is read.
pub(super) fn can_frames(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_CAN, libc::SOCK_RAW | libc::SOCK_NONBLOCK, libc::CAN_RAW);
        if !keep(held, socket) {
            return false;
        }
        widen(socket);
        // SAFETY: plain data, for which zero is a value; zero is also every bus.
        let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
        address.can_family = libc::AF_CAN as libc::sa_family_t;
        call!(SYS_bind, socket, &raw const address, size_of::<libc::sockaddr_can>()) == 0
    });
    let Some(first) = held.descriptors.first().copied() else { return };
    // SAFETY: as above.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::AF_CAN as libc::sa_family_t;
    for interface in 1..4 {
        address.can_ifindex = interface;
        // An identifier, a length, and eight bytes of nothing.
        let frame: [u32; 4] = [0x123, 8, 0, 0];
        let length = size_of::<libc::sockaddr_can>();
        turn.repeat(|| call!(SYS_sendto, first, frame.as_ptr(), 16, 0, &raw const address, length) > 0);
    }
}

/// Connections that are written to, closed by who made them, and never accepted: they need no descriptor.
pub(super) fn tcp_never_accepted(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 60_000] = [0; 60_000];
    let Some((_, address)) = listener(held) else { return };
    turn.repeat(|| {
        let client = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM, 0);
        let made = call!(SYS_connect, client, &raw const address, size_of::<libc::sockaddr_in>()) == 0;
        while call!(SYS_sendto, client, BYTES.as_ptr(), BYTES.len(), libc::MSG_DONTWAIT, 0, 0) > 0 {}
        call!(SYS_close, client);
        made
    });
}

/// One socket that listens, and where.
pub(super) fn listener(held: &mut Held) -> Option<(i32, libc::sockaddr_in)> {
    let mut address = loopback(0);
    if held.descriptors.is_empty() {
        let listener = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM | libc::SOCK_NONBLOCK, 0);
        call!(SYS_bind, listener, &raw const address, size_of::<libc::sockaddr_in>());
        call!(SYS_listen, listener, 4_096);
        keep(held, listener);
    }
    let listener = held.descriptors.first().copied()?;
    let mut room = size_of::<libc::sockaddr_in>() as libc::socklen_t;
    call!(SYS_getsockname, listener, &raw mut address, &raw mut room);
    Some((listener, address))
}

/// Connections whose acknowledgements are due all at once, and whose keep-alive runs out.
pub(super) fn tcp_timers(held: &mut Held, turn: &Turn) {
    let length = size_of::<libc::sockaddr_in>();
    let Some((listener, address)) = listener(held) else { return };
    turn.repeat(|| {
        let client = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM | libc::SOCK_NONBLOCK, 0);
        if !keep(held, client) {
            return false;
        }
        for (level, option, value) in [
            (libc::SOL_SOCKET, libc::SO_KEEPALIVE, 1_i32),
            (libc::IPPROTO_TCP, libc::TCP_KEEPIDLE, 1),
            (libc::IPPROTO_TCP, libc::TCP_KEEPINTVL, 1),
            (libc::IPPROTO_TCP, libc::TCP_NODELAY, 1),
        ] {
            call!(SYS_setsockopt, client, level, option, &raw const value, 4);
        }
        call!(SYS_connect, client, &raw const address, length);
        let server = call!(SYS_accept4, listener, null::<u8>(), null::<u8>(), libc::SOCK_NONBLOCK);
        keep(held, server)
    });
    turn.repeat(|| {
        held.count += 1;
        let Some(socket) = held.descriptors.get(held.count as usize) else {
            held.count = 0;
            return false;
        };
        call!(SYS_sendto, *socket, c"x".as_ptr(), 1, libc::MSG_DONTWAIT, 0, 0);
        true
    });
}

/// Multicast groups and sources.
pub(super) fn groups_of_hosts(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM, 0);
        for group in 0..64_u32 {
            held.count += 1;
            let many = u32::from_be_bytes([239, 1, 0, 0]) + (held.count as u32 % 60_000);
            let request = libc::ip_mreq {
                imr_multiaddr: libc::in_addr { s_addr: many.to_be() },
                imr_interface: libc::in_addr { s_addr: u32::from_be_bytes([127, 0, 0, 1]).to_be() },
            };
            let joined = call!(
                SYS_setsockopt,
                socket,
                libc::IPPROTO_IP,
                libc::IP_ADD_MEMBERSHIP,
                &raw const request,
                size_of_val(&request)
            );
            if group > 0 && joined != 0 {
                break;
            }
        }
        keep(held, socket)
    });
}

pub(super) fn socket_pairs(held: &mut Held, turn: &Turn, kind: i32) {
    static BYTES: [u8; 32 << 10] = [0; 32 << 10];
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, kind | libc::SOCK_NONBLOCK, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        for end in ends {
            widen(end.into());
            while call!(SYS_write, end, BYTES.as_ptr(), BYTES.len()) > 0 {}
            // Many small ones take more of the kernel's memory than they are long.
            while call!(SYS_write, end, BYTES.as_ptr(), 1) > 0 {}
        }
        held.descriptors.extend(ends);
        true
    });
}

/// Descriptors that are held by no process, only by messages.
pub(super) fn in_flight(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_STREAM, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        let mut pipe = [0_i32; 2];
        call!(SYS_pipe2, pipe.as_mut_ptr(), libc::O_NONBLOCK);
        call!(SYS_fcntl, pipe[1], libc::F_SETPIPE_SZ, 1 << 20);
        // Each message carries 16 descriptors, and the socket itself among them: they hold one another.
        let carried: Vec<i32> = ends.iter().chain(&pipe).copied().cycle().take(16).collect();
        let mut control = vec![0_u64; 2 + carried.len() / 2];
        let mut byte = 0_u8;
        let mut part = libc::iovec { iov_base: (&raw mut byte).cast(), iov_len: 1 };
        // SAFETY: plain data; the control message lies in a buffer that is long enough and aligned.
        let message = unsafe {
            let mut message: libc::msghdr = std::mem::zeroed();
            message.msg_iov = &raw mut part;
            message.msg_iovlen = 1;
            message.msg_control = control.as_mut_ptr().cast();
            message.msg_controllen = (control.len() * 8) as _;
            let header = libc::CMSG_FIRSTHDR(&raw const message);
            (*header).cmsg_level = libc::SOL_SOCKET;
            (*header).cmsg_type = libc::SCM_RIGHTS;
            (*header).cmsg_len = libc::CMSG_LEN(64) as _;
            std::ptr::copy_nonoverlapping(carried.as_ptr().cast(), libc::CMSG_DATA(header), 64);
            message
        };
        let mut sent = 0;
        while call!(SYS_sendmsg, ends[0], &raw const message, libc::MSG_DONTWAIT) > 0 {
            sent += 1;
        }
        for descriptor in ends.iter().chain(&pipe) {
            call!(SYS_close, *descriptor);
        }
        held.count += sent;
        sent > 0
    });
}

/// Programs that a socket runs on each datagram.
pub(super) fn filters_of_sockets(held: &mut Held, turn: &Turn) {
    let accept = libc::sock_filter { code: 0x06, jt: 0, jf: 0, k: 0xffff };
    let load = libc::sock_filter { code: 0x28, jt: 0, jf: 0, k: 0 };
    let mut program = vec![load; 4_095];
    program.push(accept);
    let filter = libc::sock_fprog { len: 4_096, filter: program.as_mut_ptr() };
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_DGRAM, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        for end in ends {
            let size = size_of::<libc::sock_fprog>();
            call!(SYS_setsockopt, end, libc::SOL_SOCKET, libc::SO_ATTACH_FILTER, &raw const filter, size);
            call!(SYS_write, end, c"x".as_ptr(), 1);
        }
        held.descriptors.extend(ends);
        true
    });
}
