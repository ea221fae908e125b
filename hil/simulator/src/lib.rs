//! The plant behind a UDP socket.
