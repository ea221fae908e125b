//! Authentication: a keyed hash over every byte of a datagram, with a key for each link, direction and network.
//!
//! Responsible for: tags. BLAKE3 with a key is a pseudo-random function of the bytes: nothing depends on a number that must
//! not be used twice, which a restarted relay could not promise (see the decision on the tag). Its output is as long
//! as wanted: one pass over the bytes gives a tag for each network. It must never compare tags in a time that depends on
//! where they differ.

/// Bytes of a tag.
pub const TAG_BYTES: usize = 16;
/// A link's key as it is handed to a relay.
pub type Key = [u8; 32];
/// One for each network that a link can have.
pub(crate) type Tags = [[u8; TAG_BYTES]; NETWORKS];

use bateleur_messages::link::NETWORKS;

/// What sets these keys apart from others that are derived from the same file.
const CONTEXT: &str = "bateleur relay, datagrams of one direction of a link, version 1";

/// Makes and checks the tags of one direction of a link.
#[derive(Clone)]
pub(crate) struct Seal([u8; 32]);

impl Seal {
    /// The seal of datagrams that the initiator (or else the other end) of `link` sends.
    pub(crate) fn new(key: &Key, link: u16, of_initiator: bool) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key(CONTEXT);
        hasher.update(key);
        hasher.update(&link.to_le_bytes());
        hasher.update(&[u8::from(of_initiator)]);
        Self(*hasher.finalize().as_bytes())
    }

    /// The tags of a datagram whose other bytes are `bytes`, one for each network.
    pub(crate) fn tags(&self, bytes: &[u8]) -> Tags {
        let hash = blake3::keyed_hash(&self.0, bytes);
        let mut tags = Tags::default();
        tags.as_flattened_mut().copy_from_slice(hash.as_bytes());
        tags
    }

    /// Whether `tag` is that of `bytes` on `network`.
    pub(crate) fn fits(&self, bytes: &[u8], network: usize, tag: &[u8]) -> bool {
        let tags = self.tags(bytes);
        tags.get(network).is_some_and(|own| constant_time_eq::constant_time_eq(own, tag))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = [7; 32];

    #[test]
    fn a_tag_fits_its_bytes_network_direction_link_and_key_and_no_other() {
        let seal = Seal::new(&KEY, 3, true);
        let tags = seal.tags(b"datagram");
        assert!(seal.fits(b"datagram", 0, &tags[0]) && seal.fits(b"datagram", 1, &tags[1]));
        assert!(!seal.fits(b"datagraM", 0, &tags[0]));
        assert!(!seal.fits(b"datagram", 1, &tags[0]) && !seal.fits(b"datagram", 2, &tags[0]));
        assert!(!seal.fits(b"datagram", 0, &tags[0][..15]));
        for other in [Seal::new(&KEY, 3, false), Seal::new(&KEY, 4, true), Seal::new(&[8; 32], 3, true)] {
            assert!(!other.fits(b"datagram", 0, &tags[0]));
        }
    }
}
