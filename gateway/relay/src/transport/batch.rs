//! Many datagrams with one system call, and the instant at which the kernel had them.
//!
//! Responsible for: `sendmmsg` and `recvmmsg`, which the libraries that are used elsewhere do not wrap. It must never
//! hand the kernel memory that does not outlive the call.
#![allow(unsafe_code)] // these two calls, and reading what they wrote

use std::io;
use std::os::fd::AsRawFd;

/// Datagrams of one call.
pub(crate) const BATCH: usize = 16;
/// Bytes for what the kernel says beside a datagram: one instant.
const CONTROL: usize = 64;

/// Asks the kernel to note when datagrams of a socket come.
pub(crate) fn note_arrivals(socket: &impl AsRawFd) -> io::Result<()> {
    let on: libc::c_int = 1;
    let length = size_of::<libc::c_int>() as libc::socklen_t;
    // SAFETY: the kernel reads one integer, which lives here.
    let done = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_TIMESTAMPNS,
            (&raw const on).cast(),
            length,
        )
    };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Keeps a socket of a group from hearing what comes to the group over interfaces on which somebody else of this computer has joined
/// it.
pub(crate) fn only_where_joined(socket: &impl AsRawFd) -> io::Result<()> {
    let off: libc::c_int = 0;
    let length = size_of::<libc::c_int>() as libc::socklen_t;
    // SAFETY: the kernel reads one integer, which lives here.
    let done = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::IPPROTO_IP,
            libc::IP_MULTICAST_ALL,
            (&raw const off).cast(),
            length,
        )
    };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Whether the peer's computer has answered that nobody listens there.
fn is_port_unreachable(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::ConnectionRefused
}

/// What goes out with one call.
pub(crate) struct Outbox {
    bytes: Vec<u8>,
    ends: Vec<usize>,
    /// Answers that nobody listens at the other end.
    pub(crate) port_unreachable: u64,
}

impl Outbox {
    /// For datagrams of `longest` bytes.
    pub(crate) fn new(longest: usize) -> Self {
        Self { bytes: Vec::with_capacity(longest), ends: Vec::with_capacity(BATCH), port_unreachable: 0 }
    }

    /// Adds a datagram. False: it is full, flush first.
    pub(crate) fn add(&mut self, parts: [&[u8]; 2]) -> bool {
        if self.ends.len() == BATCH {
            return false;
        }
        parts.into_iter().for_each(|part| self.bytes.extend_from_slice(part));
        self.ends.push(self.bytes.len());
        true
    }

    /// Sends everything through a connected socket, or to `to`; gives the number of datagrams that could not be sent.
    pub(crate) fn flush(&mut self, socket: &impl AsRawFd) -> usize {
        if self.ends.is_empty() {
            return 0;
        }
        let mut vectors = [libc::iovec { iov_base: std::ptr::null_mut(), iov_len: 0 }; BATCH];
        let mut start = 0;
        for (vector, end) in vectors.iter_mut().zip(&self.ends) {
            *vector = libc::iovec { iov_base: self.bytes[start..].as_mut_ptr().cast(), iov_len: end - start };
            start = *end;
        }
        // SAFETY: a structure of integers and pointers, for which zeros are a value.
        let mut messages: [libc::mmsghdr; BATCH] = unsafe { std::mem::zeroed() };
        for (message, vector) in messages.iter_mut().zip(&mut vectors) {
            message.msg_hdr.msg_iov = vector;
            message.msg_hdr.msg_iovlen = 1;
        }
        let failed =
            send_all(socket.as_raw_fd(), &mut messages[..self.ends.len()], &mut self.port_unreachable);
        self.bytes.clear();
        self.ends.clear();
        failed
    }
}

/// Gives the number of those that could not be sent, and counts answers that nobody listens there.
fn send_all(socket: i32, messages: &mut [libc::mmsghdr], port_unreachable: &mut u64) -> usize {
    let (mut done, mut failed) = (0, 0);
    // An error that was reported to the socket earlier (nobody listened at the peer) shows at the next call: that
    // one is made once more.
    let mut again = true;
    while done < messages.len() {
        let rest = &mut messages[done..];
        // SAFETY: headers, vectors and bytes are arrays that outlive the call, with these lengths.
        let sent = unsafe {
            libc::sendmmsg(socket, rest.as_mut_ptr(), rest.len() as libc::c_uint, libc::MSG_DONTWAIT)
        };
        if sent < 0 {
            *port_unreachable += u64::from(is_port_unreachable(&io::Error::last_os_error()));
        }
        match usize::try_from(sent) {
            Ok(sent) if sent > 0 => {
                done += sent;
                again = true;
            }
            _ if std::mem::take(&mut again) => {}
            _ => {
                done += 1;
                failed += 1;
                again = true;
            }
        }
    }
    failed
}

/// What comes in with one call.
pub(crate) struct Inbox {
    bytes: Vec<u8>,
    length: usize,
    control: [[u64; CONTROL / 8]; BATCH],
    /// Answers that nobody listens at the other end, on any socket.
    pub(crate) port_unreachable: u64,
}

/// One datagram of an [`Inbox`].
pub(crate) struct Received<'a> {
    /// Its bytes; nothing: it was longer than there is room for.
    pub(crate) bytes: Option<&'a [u8]>,
    /// When the kernel had it, CLOCK_REALTIME, ns.
    pub(crate) realtime_ns: Option<u64>,
    /// Who sent it: the address as the kernel gives it.
    pub(crate) from: Option<std::net::SocketAddr>,
}

impl Inbox {
    /// For datagrams of `longest` bytes.
    pub(crate) fn new(longest: usize) -> Self {
        Self {
            bytes: vec![0; longest * BATCH],
            length: longest,
            control: [[0; CONTROL / 8]; BATCH],
            port_unreachable: 0,
        }
    }

    /// Takes at most `most` datagrams that wait; gives their number.
    pub(crate) fn receive(
        &mut self,
        socket: &impl AsRawFd,
        most: usize,
        take: &mut dyn FnMut(Received<'_>),
    ) -> usize {
        let most = most.min(BATCH);
        // SAFETY: structures of integers and pointers, for which zeros are a value.
        let (mut messages, mut names): ([libc::mmsghdr; BATCH], [libc::sockaddr_storage; BATCH]) =
            unsafe { (std::mem::zeroed(), std::mem::zeroed()) };
        let mut vectors = [libc::iovec { iov_base: std::ptr::null_mut(), iov_len: 0 }; BATCH];
        for (number, vector) in vectors.iter_mut().enumerate() {
            let room = &mut self.bytes[number * self.length..(number + 1) * self.length];
            *vector = libc::iovec { iov_base: room.as_mut_ptr().cast(), iov_len: room.len() };
        }
        let parts = messages.iter_mut().zip(&mut vectors).zip(&mut names).zip(&mut self.control);
        for (((message, vector), name), control) in parts {
            let header = &mut message.msg_hdr;
            header.msg_iov = vector;
            header.msg_iovlen = 1;
            header.msg_name = (&raw mut *name).cast();
            header.msg_namelen = size_of::<libc::sockaddr_storage>() as libc::socklen_t;
            header.msg_control = control.as_mut_ptr().cast();
            header.msg_controllen = CONTROL as _;
        }
        let mut receive = || {
            // SAFETY: as above; the kernel writes into buffers of these lengths, which live here and in `self`.
            let received = unsafe {
                libc::recvmmsg(
                    socket.as_raw_fd(),
                    messages.as_mut_ptr(),
                    most as libc::c_uint,
                    libc::MSG_DONTWAIT,
                    std::ptr::null_mut(),
                )
            };
            usize::try_from(received).map_err(|_| io::Error::last_os_error())
        };
        // An error that was reported to the socket earlier (nobody listened at the peer) shows at one call, and hides what
        // waits: that one is made once more.
        let nothing = |error: &io::Error| error.kind() == io::ErrorKind::WouldBlock;
        let received = match receive() {
            Err(error) if !nothing(&error) => {
                self.port_unreachable += u64::from(is_port_unreachable(&error));
                receive().unwrap_or(0)
            }
            received => received.unwrap_or(0),
        };
        for (number, (message, name)) in messages.iter().zip(&names).take(received).enumerate() {
            let cut = message.msg_hdr.msg_flags & libc::MSG_TRUNC != 0;
            let length = (message.msg_len as usize).min(self.length);
            let start = number * self.length;
            take(Received {
                bytes: (!cut).then(|| &self.bytes[start..start + length]),
                realtime_ns: instant(&message.msg_hdr),
                from: address(name),
            });
        }
        received
    }
}

/// The instant that stands beside a datagram.
fn instant(header: &libc::msghdr) -> Option<u64> {
    // SAFETY: the kernel has filled the control buffer that the header points to and set its length.
    unsafe {
        let mut place = libc::CMSG_FIRSTHDR(header);
        while let Some(control) = place.as_ref() {
            if control.cmsg_level == libc::SOL_SOCKET && control.cmsg_type == libc::SCM_TIMESTAMPNS {
                let time: libc::timespec = std::ptr::read_unaligned(libc::CMSG_DATA(place).cast());
                let seconds = u64::try_from(time.tv_sec).ok()?;
                return Some(seconds * 1_000_000_000 + u64::try_from(time.tv_nsec).ok()?);
            }
            place = libc::CMSG_NXTHDR(header, place);
        }
    }
    None
}

fn address(name: &libc::sockaddr_storage) -> Option<std::net::SocketAddr> {
    match i32::from(name.ss_family) {
        libc::AF_INET => {
            // SAFETY: the family says which structure lies there; the storage is large and aligned enough for each.
            let name = unsafe { &*(&raw const *name).cast::<libc::sockaddr_in>() };
            let ip = std::net::Ipv4Addr::from(u32::from_be(name.sin_addr.s_addr));
            Some((ip, u16::from_be(name.sin_port)).into())
        }
        libc::AF_INET6 => {
            // SAFETY: as above.
            let name = unsafe { &*(&raw const *name).cast::<libc::sockaddr_in6>() };
            let ip = std::net::Ipv6Addr::from(name.sin6_addr.s6_addr);
            Some((ip, u16::from_be(name.sin6_port)).into())
        }
        _ => None,
    }
}
