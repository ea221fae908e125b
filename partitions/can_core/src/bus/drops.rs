//! How much a socket could not keep: what came while its buffer was full, by the kernel's own count.
#![allow(unsafe_code)] // a socket option that no crate in use reads

use std::os::fd::{AsFd, AsRawFd};

/// Numbers that `SO_MEMINFO` gives, and the place of the drops among them (`SK_MEMINFO_VARS`, `SK_MEMINFO_DROPS` in
/// `linux/sock_diag.h`).
const NUMBERS: usize = 9;
const DROPS: usize = 8;

/// Packets that the kernel threw away because the socket's buffer was full, since it was opened; the kernel counts them in 32
/// bits. 0 where it does not say (before Linux 4.12).
pub(super) fn count(socket: &impl AsFd) -> u64 {
    let mut numbers = [0_u32; NUMBERS];
    let mut length = size_of_val(&numbers) as libc::socklen_t;
    // SAFETY: the kernel writes at most `length` bytes into `numbers`, which outlives the call.
    let result = unsafe {
        libc::getsockopt(
            socket.as_fd().as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            numbers.as_mut_ptr().cast(),
            &raw mut length,
        )
    };
    if result == 0 { numbers[DROPS].into() } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::net::sockopt;
    use std::net::UdpSocket;

    #[test]
    fn what_a_full_socket_could_not_keep_is_counted() {
        let here = UdpSocket::bind("127.0.0.1:0").unwrap();
        here.set_nonblocking(true).unwrap();
        sockopt::set_socket_recv_buffer_size(&here, 4_096).unwrap();
        assert_eq!(count(&here), 0);
        let there = UdpSocket::bind("127.0.0.1:0").unwrap();
        let sent = 100;
        for _ in 0..sent {
            there.send_to(&[0; 500], here.local_addr().unwrap()).unwrap();
        }
        let mut came = 0;
        while here.recv(&mut [0; 512]).is_ok() {
            came += 1;
        }
        assert!(came < sent, "the buffer was not full");
        assert_eq!(count(&here), sent - came);
    }
}
