//! How long datagrams are on their way on one network, beside what the plan says: it counts with that in every chain.
//!
//! Measured from the sender's stamp to the arrival, in own time, with the estimate of the peer's clock. One that takes too long
//! happens on a computer that was busy for a moment; what is told is a network on which it comes again. It must never judge
//! before the clocks of both ends are known.

/// Over how long the longest is looked for, ns.
const SPAN_NS: u64 = 1_000_000_000;
/// So many datagrams that take too long within a span are told.
const SEVERAL: u32 = 3;
/// Exchanges of time before anything is measured: the first ones are as wrong as the start of two computers makes them.
const EXCHANGES: u64 = 16;

/// One network of a link.
#[derive(Debug, Clone)]
pub(crate) struct Transit {
    allowed_ns: u64,
    since_ns: Option<u64>,
    /// The longest of the span that goes on, and of the one before, ns.
    longest_ns: [u64; 2],
    beyond: u32,
    slow: bool,
}

/// What changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    /// Several datagrams took longer than the plan says; the longest of late, ns.
    Slow(u64),
    /// None has for a whole span.
    InTime,
}

impl Transit {
    /// `allowed_ns`: what the plan says; 0: nothing is judged.
    pub(crate) fn new(allowed_ns: u64) -> Self {
        Self { allowed_ns, since_ns: None, longest_ns: [0; 2], beyond: 0, slow: false }
    }

    /// A datagram came at `now_ns` after `took_ns` on the way, as `exchanges` of time let it be known.
    pub(crate) fn took(&mut self, took_ns: u64, exchanges: u64, now_ns: u64) -> Option<Change> {
        if exchanges < EXCHANGES {
            return None;
        }
        let ended = now_ns.saturating_sub(*self.since_ns.get_or_insert(now_ns)) >= SPAN_NS;
        let well_again = ended && self.beyond == 0 && std::mem::replace(&mut self.slow, false);
        if ended {
            self.longest_ns = [0, self.longest_ns[0]];
            (self.since_ns, self.beyond) = (Some(now_ns), 0);
        }
        self.longest_ns[0] = self.longest_ns[0].max(took_ns);
        if self.allowed_ns == 0 {
            return None;
        }
        self.beyond += u32::from(took_ns > self.allowed_ns);
        if self.beyond >= SEVERAL && !std::mem::replace(&mut self.slow, true) {
            return Some(Change::Slow(self.longest_ns()));
        }
        well_again.then_some(Change::InTime)
    }

    /// The longest of late, ns; 0: nothing was measured.
    pub(crate) fn longest_ns(&self) -> u64 {
        self.longest_ns[0].max(self.longest_ns[1])
    }

    /// What the plan says, ns.
    pub(crate) fn allowed_ns(&self) -> u64 {
        self.allowed_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: u64 = EXCHANGES;

    #[test]
    fn datagrams_that_take_longer_than_the_plan_says_are_told_once_and_so_is_their_end() {
        let mut transit = Transit::new(500);
        let mut told = Vec::new();
        for number in 0..400_u64 {
            let took_ns = if (50..60).contains(&number) { 700 + number } else { 400 };
            told.extend(transit.took(took_ns, KNOWN, number * 20_000_000).map(|change| (number, change)));
        }
        // The span from 1 s on has them, and the one from 2 s on has none.
        assert_eq!(told, [(52, Change::Slow(752)), (150, Change::InTime)]);
        assert_eq!(transit.longest_ns(), 400);
    }

    #[test]
    fn two_of_a_second_are_shown_and_not_told() {
        let mut transit = Transit::new(500);
        for number in 0..40_u64 {
            let took_ns = if number % 20 == 7 { 9_000 } else { 100 };
            assert_eq!(transit.took(took_ns, KNOWN, number * 20_000_000), None);
        }
        assert_eq!(transit.longest_ns(), 9_000);
    }

    #[test]
    fn nothing_is_measured_before_the_clocks_are_known_nor_judged_where_the_plan_says_nothing() {
        let mut transit = Transit::new(500);
        (0..20).for_each(|number| assert_eq!(transit.took(1_000_000, KNOWN - 1, number), None));
        assert_eq!(transit.longest_ns(), 0);
        let mut silent = Transit::new(0);
        (0..20).for_each(|number| assert_eq!(silent.took(1_000_000, KNOWN, number), None));
        assert_eq!(silent.longest_ns(), 1_000_000);
    }
}
