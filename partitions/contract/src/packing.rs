//! How many datagrams of a link the messages of a window need at most, in whichever order they come.
//!
//! Responsible for: the one reckoning that the checker of plans trusts and a relay keeps. A relay fills its datagrams by these rules:
//! a message that fits into an empty datagram travels whole; what does not fit into the rest of one comes first in the
//! next; a longer message goes in pieces, one of its own in each datagram, and leaves half of the room to others while they
//! want some. It must never count less than a relay needs: what is left over waits for the relay's next window, and a
//! bound that was promised is broken.

use crate::relay::{DATAGRAM_OVERHEAD_BYTES, ENTRY_OVERHEAD_BYTES};

/// Messages of one channel that wait for a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Waiting {
    /// Bytes of each, at most.
    pub bytes: u64,
    /// How many, at most.
    pub count: u64,
}

const HEAD: u64 = ENTRY_OVERHEAD_BYTES as u64;
/// Free room in which no message is begun that goes in pieces: a head, and the smallest piece.
const WASTE: u64 = 2 * HEAD;

/// What a datagram has room for, bytes of messages and their heads.
fn room(max_bytes: u32) -> u64 {
    u64::from(max_bytes.saturating_sub(DATAGRAM_OVERHEAD_BYTES))
}

/// Whether a message of `bytes` goes in pieces on a link with datagrams of `max_bytes`.
#[must_use]
pub fn goes_in_pieces(bytes: u64, max_bytes: u32) -> bool {
    bytes.saturating_add(HEAD) > room(max_bytes)
}

/// The most datagrams that a relay needs for what waits; one, where nothing does. `max_bytes`: of a datagram, as the plan
/// has it; twice [`DATAGRAM_OVERHEAD_BYTES`] or more.
#[must_use]
pub fn datagrams_needed(waiting: &[Waiting], max_bytes: u32) -> u64 {
    let room = room(max_bytes);
    let (mut whole, mut pieces) = (Load::default(), Load::default());
    for one in waiting {
        let load = if goes_in_pieces(one.bytes, max_bytes) { &mut pieces } else { &mut whole };
        load.add(one);
    }
    let needed = if pieces.count == 0 { of_whole(&whole, room) } else { of_both(&whole, &pieces, room) };
    needed.max(1)
}

#[derive(Debug, Default)]
struct Load {
    count: u64,
    /// With a head for each.
    bytes: u64,
    /// The longest, with its head.
    longest: u64,
}

impl Load {
    fn add(&mut self, waiting: &Waiting) {
        if waiting.count == 0 {
            return;
        }
        let each = waiting.bytes.saturating_add(HEAD);
        self.count = self.count.saturating_add(waiting.count);
        self.bytes = self.bytes.saturating_add(each.saturating_mul(waiting.count));
        self.longest = self.longest.max(each);
    }
}

/// Each bound holds by itself; which one is the closest depends on the lengths.
fn of_whole(load: &Load, room: u64) -> u64 {
    let Some(beyond) = load.bytes.checked_sub(room).filter(|beyond| *beyond > 0) else { return 1 };
    // While any is left, a datagram has so many of them.
    let in_each = (room / load.longest.max(1)).max(1);
    let by_number = load.count.div_ceil(in_each);
    // What does not fit into one datagram is in the next: any two in a row have more than one has room for.
    let by_pairs = 2 * load.bytes.div_ceil(room.max(1)) - 1;
    // Every datagram but the last is full but for less than the longest message; the last two have more than one has room for.
    let by_waste = match room - load.longest {
        0 => u64::MAX,
        least => 1 + beyond.div_ceil(least),
    };
    by_number.min(by_pairs).min(by_waste)
}

/// A datagram at whose end a message goes on is full; each of these has a head for going on. Others are full but for what
/// did not fit.
fn of_both(whole: &Load, pieces: &Load, room: u64) -> u64 {
    let alone = whole.count == 0 && pieces.count == 1;
    let waste = if alone { 0 } else { whole.longest.max(WASTE) };
    let least = room.saturating_sub(waste.max(HEAD));
    let bytes = whole.bytes.saturating_add(pieces.bytes);
    let by_waste = match least {
        0 => u64::MAX,
        least => 1 + (bytes - 1) / least,
    };
    // A datagram ends a message in pieces, or is full of one, or has a whole one.
    let full = pieces.bytes / room.saturating_sub(HEAD).max(1);
    let by_number = whole.count.saturating_add(pieces.count).saturating_add(full);
    by_waste.min(by_number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn needed(waiting: &[(u64, u64)], max_bytes: u32) -> u64 {
        let waiting: Vec<_> = waiting.iter().map(|&(bytes, count)| Waiting { bytes, count }).collect();
        datagrams_needed(&waiting, max_bytes)
    }

    #[test]
    fn nothing_and_whatever_fits_together_need_one() {
        assert_eq!(needed(&[], 1452), 1);
        assert_eq!(needed(&[(100, 0)], 1452), 1);
        assert_eq!(needed(&[(300, 1), (30, 4), (200, 2)], 1452), 1);
        assert_eq!(needed(&[(1292, 1)], 1452), 1);
    }

    #[test]
    fn messages_are_not_divided_to_fill_a_datagram() {
        // Two of 64 bytes fit into 155: seven need four datagrams, though their bytes would fit into three.
        assert_eq!(needed(&[(32, 7)], 283), 4);
        assert_eq!(needed(&[(700, 3)], 1452), 3);
    }

    #[test]
    fn each_piece_has_heads_of_its_own() {
        assert_eq!(needed(&[(312, 1)], 256), 4);
        assert_eq!(needed(&[(2600, 1)], 1452), 3);
    }
}
