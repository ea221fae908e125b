//! What the peer's clock says: an estimate from two-way exchanges of instants.
//!
//! Every datagram says when it was sent (t3), and when the latest datagram of the other end was sent (t1) and came (t2). With
//! the instant at which it comes itself (t4) that is an exchange: the peer's clock is ahead by ((t2 - t1) + (t3 - t4)) / 2, and
//! wrong by half of the way there and back, (t4 - t1) - (t3 - t2), at most. The exchange with the shortest way of late is the
//! best one; nothing that is held up on the way can make the estimate worse than it says. It must never ask which clock it
//! is: instants are arguments.

/// Exchanges that are remembered.
const REMEMBERED: usize = 64;
/// How fast two clocks may part, parts in 10⁹: crystals of computers stay below 15 parts in a million of each other as a
/// rule. Too low: an old exchange counts as better than it is.
const PARTING_PPB: u64 = 15_000;
/// Longer ways there and back are not believed, ns.
const LONGEST_NS: i64 = 10_000_000_000;

/// One exchange of four instants, ns. The middle two are the peer's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exchange {
    /// Own datagram sent, own clock.
    pub sent_ns: u64,
    /// It came, the peer's clock.
    pub peer_came_ns: u64,
    /// The peer's datagram sent, the peer's clock.
    pub peer_sent_ns: u64,
    /// It came, own clock.
    pub came_ns: u64,
}

/// What is known of the peer's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// The peer's clock less the own one, ns.
    pub offset_ns: i64,
    /// The true value lies no further away, as long as the clocks part as slowly as crystals do, ns.
    pub uncertainty_ns: u64,
    /// The way there and back of the exchange that the estimate rests on, ns.
    pub round_trip_ns: u64,
    /// Exchanges so far.
    pub exchanges: u64,
}

#[derive(Debug, Clone, Copy)]
struct Remembered {
    offset_ns: i64,
    round_trip_ns: u64,
    /// Half of the way, and what the clocks may have parted during the exchange.
    wrong_by_ns: u64,
    came_ns: u64,
}

impl Remembered {
    fn wrong_at(&self, now_ns: u64) -> u64 {
        self.wrong_by_ns + parted_ns(now_ns.saturating_sub(self.came_ns))
    }
}

fn parted_ns(for_ns: u64) -> u64 {
    // Rounded up, without overflow for any length of time.
    (for_ns / 1_000_000).saturating_mul(PARTING_PPB) / 1_000 + 1
}

/// Estimates the peer's clock.
#[derive(Debug, Clone, Default)]
pub struct PeerClock {
    remembered: Vec<Remembered>,
    next: usize,
    exchanges: u64,
}

impl PeerClock {
    /// Knows nothing.
    pub fn new() -> Self {
        Self { remembered: Vec::with_capacity(REMEMBERED), next: 0, exchanges: 0 }
    }

    /// Takes an exchange; false: it can not have been so.
    pub fn take(&mut self, exchange: &Exchange) -> bool {
        let away_ns = difference(exchange.came_ns, exchange.sent_ns);
        let held_ns = difference(exchange.peer_sent_ns, exchange.peer_came_ns);
        let (Some(away_ns), Some(held_ns)) = (away_ns, held_ns) else { return false };
        let round_trip_ns = away_ns - held_ns;
        if held_ns < 0 || !(0..=LONGEST_NS).contains(&away_ns) || round_trip_ns < 0 {
            return false;
        }
        let there = difference(exchange.peer_came_ns, exchange.sent_ns);
        let back = difference(exchange.peer_sent_ns, exchange.came_ns);
        let (Some(there), Some(back)) = (there, back) else { return false };
        let round_trip_ns = round_trip_ns.unsigned_abs();
        let taken = Remembered {
            offset_ns: i64::midpoint(there, back),
            round_trip_ns,
            wrong_by_ns: round_trip_ns.div_ceil(2) + parted_ns(held_ns.unsigned_abs()),
            came_ns: exchange.came_ns,
        };
        match self.remembered.get_mut(self.next) {
            Some(place) => *place = taken,
            None => self.remembered.push(taken),
        }
        self.next = (self.next + 1) % REMEMBERED;
        self.exchanges += 1;
        true
    }

    /// The best of what is remembered, at `now_ns` of the own clock.
    pub fn estimate(&self, now_ns: u64) -> Option<Estimate> {
        let best = self.remembered.iter().min_by_key(|exchange| exchange.wrong_at(now_ns))?;
        Some(Estimate {
            offset_ns: best.offset_ns,
            uncertainty_ns: best.wrong_at(now_ns),
            round_trip_ns: best.round_trip_ns,
            exchanges: self.exchanges,
        })
    }

    /// Forgets everything: it was another life of the peer, with another clock perhaps.
    pub fn forget(&mut self) {
        self.remembered.clear();
        self.next = 0;
        self.exchanges = 0;
    }
}

/// `a - b`, where it is one that two clocks of modules can have.
pub(crate) fn difference(a: u64, b: u64) -> Option<i64> {
    const FAR: i128 = (i64::MAX / 4) as i128;
    let difference = i128::from(a) - i128::from(b);
    if (-FAR..FAR).contains(&difference) { i64::try_from(difference).ok() } else { None }
}

/// An instant of the peer's clock on the own one, not before its zero.
pub(crate) fn own_ns(peer_ns: u64, offset_ns: i64) -> u64 {
    peer_ns.saturating_add_signed(offset_ns.saturating_neg())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// An exchange with a peer that is `ahead_ns`, over ways of these lengths.
    fn exchange(at_ns: u64, ahead_ns: i64, there_ns: u64, held_ns: u64, back_ns: u64) -> Exchange {
        let peer = |own_ns: u64| own_ns.saturating_add_signed(ahead_ns);
        Exchange {
            sent_ns: at_ns,
            peer_came_ns: peer(at_ns + there_ns),
            peer_sent_ns: peer(at_ns + there_ns + held_ns),
            came_ns: at_ns + there_ns + held_ns + back_ns,
        }
    }

    #[test]
    fn equal_ways_give_the_offset_itself() {
        let mut clock = PeerClock::new();
        assert!(clock.take(&exchange(5_000_000_000, -1_234_567, 40_000, 20_000_000, 40_000)));
        let estimate = clock.estimate(5_020_080_000).unwrap();
        assert_eq!((estimate.offset_ns, estimate.round_trip_ns), (-1_234_567, 80_000));
        assert!((40_000..41_000).contains(&estimate.uncertainty_ns), "{estimate:?}");
    }

    #[test]
    fn delays_do_not_move_an_estimate_that_rests_on_a_short_way() {
        let mut clock = PeerClock::new();
        let mut now_ns = 1_000_000_000;
        clock.take(&exchange(now_ns, 777, 30_000, 1_000, 30_000));
        for spike in 1..30 {
            now_ns += 20_000_000;
            clock.take(&exchange(now_ns, 777, 30_000 + spike * 500_000, 1_000, 30_000));
        }
        assert_eq!(clock.estimate(now_ns).unwrap().offset_ns, 777);
    }

    #[test]
    fn an_old_exchange_gives_way_to_a_newer_one_on_a_longer_way() {
        let mut clock = PeerClock::new();
        clock.take(&exchange(0, 1_000, 20_000, 0, 20_000));
        clock.take(&exchange(20_000_000_000, 201_000, 25_000, 0, 25_000));
        assert_eq!(clock.estimate(20_000_000_000).unwrap().offset_ns, 201_000);
    }

    #[test]
    fn what_can_not_have_been_is_not_taken() {
        let mut clock = PeerClock::new();
        let good = exchange(1_000_000, 0, 1_000, 1_000, 1_000);
        assert!(!clock.take(&Exchange { came_ns: 900_000, ..good }));
        assert!(!clock.take(&Exchange { peer_sent_ns: good.peer_came_ns - 1, ..good }));
        assert!(!clock.take(&Exchange { peer_sent_ns: good.peer_came_ns + 10_000, ..good }));
        assert!(!clock.take(&Exchange { peer_came_ns: u64::MAX, peer_sent_ns: u64::MAX, ..good }));
        assert_eq!(clock.estimate(0), None);
    }

    proptest! {
        #[test]
        fn the_truth_lies_within_the_uncertainty(
            ahead_ns in -1_000_000_000_i64..1_000_000_000,
            ways in proptest::collection::vec((0_u64..8_000_000, 0_u64..20_000_000, 0_u64..8_000_000), 1..200)
        ) {
            let (mut clock, mut now_ns) = (PeerClock::new(), 10_000_000_000);
            for (there_ns, held_ns, back_ns) in ways {
                now_ns += 20_000_000;
                prop_assert!(clock.take(&exchange(now_ns, ahead_ns, there_ns, held_ns, back_ns)));
                let estimate = clock.estimate(now_ns).unwrap();
                prop_assert!(estimate.offset_ns.abs_diff(ahead_ns) <= estimate.uncertainty_ns);
            }
        }

        #[test]
        fn instants_that_are_taken_give_the_numbers_of_wider_arithmetic(
            a: u64, away in 0_u64..20_000_000_000, b: u64, held in 0_u64..20_000_000_000
        ) {
            let (d, c) = (a.wrapping_add(away), b.wrapping_add(held));
            let mut clock = PeerClock::new();
            let taken = clock.take(&Exchange { sent_ns: a, peer_came_ns: b, peer_sent_ns: c, came_ns: d });
            let wide = [a, b, c, d].map(i128::from);
            let round_trip = (wide[3] - wide[0]) - (wide[2] - wide[1]);
            let is_possible = wide[3] >= wide[0] && wide[2] >= wide[1] && round_trip >= 0;
            prop_assert!(is_possible || !taken);
            if let Some(estimate) = clock.estimate(d) {
                let twice = (wide[1] - wide[0]) + (wide[2] - wide[3]);
                prop_assert!((2 * i128::from(estimate.offset_ns) - twice).abs() <= 1);
                prop_assert_eq!(i128::from(estimate.round_trip_ns), round_trip);
                prop_assert!(2 * i128::from(estimate.uncertainty_ns) >= round_trip);
            }
        }
    }
}
