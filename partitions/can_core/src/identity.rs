//! What tells gateways, and the starts of one gateway, apart.

use std::hash::{BuildHasher, Hasher};

/// Another one for each start.
pub fn session() -> u32 {
    // Seeded by the system for each process.
    std::hash::RandomState::new().build_hasher().finish() as u32
}

/// The same for a gateway of this name on this machine: FNV-1a over what tells machines apart, and the name.
pub fn usual_identity(name: &str, port: u16) -> u64 {
    let machine = std::fs::read_to_string("/etc/machine-id").unwrap_or_default();
    let node = rustix::system::uname();
    let parts = [machine.trim().as_bytes(), node.nodename().to_bytes(), name.as_bytes(), &port.to_be_bytes()];
    let bytes = parts.iter().flat_map(|part| part.iter().copied().chain([0]));
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}
