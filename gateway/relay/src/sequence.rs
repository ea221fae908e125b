//! Which datagrams of the peer's life have come, on which network, and when first: the replay window.
//!
//! Responsible for: taking each datagram once, and telling a copy of the other network from a repetition on the same one.
//! It must never take a number twice, nor one from before the window.

use bateleur_messages::link::NETWORKS;

/// Datagrams that the window reaches back. At one datagram a millisecond, the shortest gap, more than a second: no network
/// of an aircraft holds one back that long.
pub(crate) const WINDOW: u64 = 1024;

/// What a datagram's number says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Seen {
    /// It had not come on any network.
    First {
        /// A later one has come on this network.
        reordered: bool,
    },
    /// It had come on another network.
    Copy {
        /// A later one has come on this network.
        reordered: bool,
        /// After the first, ns.
        after_ns: u64,
    },
    /// It had come on this network.
    Again,
    /// It lies before the window: it may have come or not.
    TooOld,
    /// It lies before the datagram that proved this life.
    Before,
}

/// Numbers that have come of those from a first one on.
#[derive(Debug, Clone, Copy)]
struct Came {
    first: u64,
    highest: u64,
    count: u64,
}

impl Came {
    fn new(first: u64) -> Self {
        Self { first, highest: first, count: 0 }
    }

    /// Notes a number; true: a higher one had come.
    fn note(&mut self, sequence: u64) -> bool {
        self.count += 1;
        let reordered = sequence < self.highest;
        self.highest = self.highest.max(sequence);
        reordered
    }

    /// Numbers up to the highest that have not come.
    fn lost(&self) -> u64 {
        if self.count == 0 { 0 } else { self.lost_until(self.highest) }
    }

    fn lost_until(&self, last: u64) -> u64 {
        (last - self.first).saturating_add(1).saturating_sub(self.count)
    }
}

/// The numbers of one life of the peer.
#[derive(Debug, Clone)]
pub(crate) struct Sequences {
    /// The life was proven by this one.
    born: u64,
    all: Came,
    networks: [Came; NETWORKS],
    /// Of the number `n` at place `n % WINDOW`: a bit for each network on which it has come.
    seen: Vec<u8>,
    /// When it came first, ns.
    first_ns: Vec<u64>,
}

impl Sequences {
    /// Of a life that number `born` has proven.
    pub(crate) fn new(born: u64) -> Self {
        Self {
            born,
            all: Came::new(born),
            networks: [Came::new(born); NETWORKS],
            seen: vec![0; WINDOW as usize],
            first_ns: vec![0; WINDOW as usize],
        }
    }

    /// Notes that number `sequence` came on `network` at `now_ns`.
    pub(crate) fn note(&mut self, sequence: u64, network: usize, now_ns: u64) -> Seen {
        let place = (sequence % WINDOW) as usize;
        if sequence < self.born {
            return Seen::Before;
        }
        if self.all.count > 0 && sequence.saturating_add(WINDOW) <= self.all.highest {
            return Seen::TooOld;
        }
        self.forget_until(sequence);
        let bit = 1 << network;
        let before = self.seen[place];
        if before & bit != 0 {
            return Seen::Again;
        }
        self.seen[place] |= bit;
        let reordered = self.networks[network].note(sequence);
        if before != 0 {
            return Seen::Copy { reordered, after_ns: now_ns.saturating_sub(self.first_ns[place]) };
        }
        self.first_ns[place] = now_ns;
        self.all.note(sequence);
        Seen::First { reordered }
    }

    /// The places of numbers between the highest so far and `sequence` hold what lies a window back.
    fn forget_until(&mut self, sequence: u64) {
        if self.all.count == 0 {
            return;
        }
        let fresh = sequence.saturating_sub(self.all.highest).min(WINDOW);
        for number in 0..fresh {
            self.seen[((sequence - number) % WINDOW) as usize] = 0;
        }
    }

    /// Whether no later one has come.
    pub(crate) fn is_newest(&self, sequence: u64) -> bool {
        self.all.count == 0 || sequence > self.all.highest
    }

    /// Datagrams that came on no network, as far as later ones show.
    pub(crate) fn lost(&self) -> u64 {
        self.all.lost()
    }

    /// Datagrams that did not come on a network, as far as later ones on it show.
    pub(crate) fn lost_on(&self, network: usize) -> u64 {
        self.networks[network].lost()
    }

    /// The same, now that nothing of this life comes any more: as far as any network shows.
    pub(crate) fn lost_at_end(&self, network: usize) -> u64 {
        if self.all.count == 0 { 0 } else { self.networks[network].lost_until(self.all.highest) }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    const FIRST: Seen = Seen::First { reordered: false };

    #[test]
    fn a_repetition_is_told_from_the_copy_of_the_other_network() {
        let mut sequences = Sequences::new(0);
        assert_eq!(sequences.note(5, 0, 100), FIRST);
        assert_eq!(sequences.note(5, 0, 110), Seen::Again);
        assert_eq!(sequences.note(5, 1, 130), Seen::Copy { reordered: false, after_ns: 30 });
        assert_eq!(sequences.note(5, 1, 140), Seen::Again);
    }

    #[test]
    fn numbers_from_before_the_proof_of_a_life_are_never_taken() {
        let mut sequences = Sequences::new(7);
        assert_eq!(sequences.note(7, 0, 0), FIRST);
        assert_eq!(sequences.note(6, 1, 0), Seen::Before);
        assert_eq!(sequences.lost(), 0);
    }

    #[test]
    fn what_is_missing_is_lost_until_it_comes() {
        let mut sequences = Sequences::new(10);
        for number in [10, 11, 14] {
            sequences.note(number, 0, 0);
        }
        assert_eq!((sequences.lost(), sequences.lost_on(0), sequences.lost_on(1)), (2, 2, 0));
        assert_eq!(sequences.note(12, 1, 0), FIRST);
        assert_eq!((sequences.lost(), sequences.lost_on(0)), (1, 2));
        assert_eq!(sequences.note(13, 0, 0), Seen::First { reordered: true });
        assert_eq!((sequences.lost(), sequences.lost_on(0)), (0, 1));
    }

    #[test]
    fn what_a_network_missed_before_its_first_and_after_its_last_is_lost_too() {
        let mut sequences = Sequences::new(10);
        (10..30).for_each(|number| assert_eq!(sequences.note(number, 0, 0), FIRST));
        assert_eq!(sequences.lost_on(1), 0, "as far as it shows by itself");
        (15..25).for_each(|number| assert_ne!(sequences.note(number, 1, 0), Seen::Again));
        assert_eq!((sequences.lost_on(1), sequences.lost_at_end(1), sequences.lost_at_end(0)), (5, 10, 0));
        assert_eq!(Sequences::new(3).lost_at_end(1), 0);
    }

    #[test]
    fn numbers_from_before_the_window_are_never_taken() {
        let mut sequences = Sequences::new(0);
        sequences.note(0, 0, 0);
        sequences.note(5 * WINDOW, 0, 0);
        assert_eq!(sequences.note(0, 1, 0), Seen::TooOld);
        assert_eq!(sequences.note(4 * WINDOW, 0, 0), Seen::TooOld);
        assert_eq!(sequences.note(4 * WINDOW + 1, 0, 0), Seen::First { reordered: true });
        assert_eq!(sequences.note(u64::MAX, 0, 0), FIRST);
        assert_eq!(sequences.note(5 * WINDOW, 0, 0), Seen::TooOld);
    }

    proptest! {
        #[test]
        fn each_number_is_taken_once_whatever_comes_in_whatever_order(
            arrivals in proptest::collection::vec((0_u64..3000, 0_usize..NETWORKS), 1..400)
        ) {
            let (mut sequences, mut taken) = (Sequences::new(0), BTreeSet::new());
            for (sequence, network) in arrivals {
                if let Seen::First { .. } = sequences.note(sequence, network, 0) {
                    prop_assert!(taken.insert(sequence), "{sequence} was taken twice");
                }
            }
            let span = taken.last().unwrap() + 1;
            prop_assert_eq!(sequences.lost(), span - taken.len() as u64);
        }
    }
}
