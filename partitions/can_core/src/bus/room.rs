//! Room in sockets for what comes while a program can not run.

use std::os::fd::AsFd;

use rustix::net::sockopt;

/// What the system keeps for the gateway while another program has the processor, bytes: a second and a half of datagrams of one
/// frame each from a full bus at 1 Mbit/s. What it keeps by default is gone after some 40 ms.
const KEPT: usize = 4 << 20;

/// Gives the socket room for what comes while this program can not run. Beyond `net.core.rmem_max` only CAP_NET_ADMIN can; what
/// there is has to do otherwise, and what is lost then is counted.
pub fn keep_more(socket: &impl AsFd) {
    let _ = sockopt::set_socket_recv_buffer_size_force(socket, KEPT)
        .or_else(|_| sockopt::set_socket_recv_buffer_size(socket, KEPT));
    let _ = sockopt::set_socket_send_buffer_size(socket, KEPT);
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;

    #[test]
    fn a_socket_keeps_more_than_the_system_gives_by_itself() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let by_itself = sockopt::socket_recv_buffer_size(&socket).unwrap();
        keep_more(&socket);
        let most = std::fs::read_to_string("/proc/sys/net/core/rmem_max").unwrap().trim().parse().unwrap();
        let kept = sockopt::socket_recv_buffer_size(&socket).unwrap();
        // The kernel counts twice what it is asked for, for what it needs itself.
        assert!(kept >= 2 * KEPT.min(most) && kept > by_itself, "{kept} of {by_itself}");
    }
}
