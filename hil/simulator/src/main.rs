//! The plant behind a UDP socket.

fn main() {}
