//! The bandwidth allocation gap: how soon after one datagram of a link the next may start.

/// Says when a datagram may go.
#[derive(Debug)]
pub(crate) struct Pace {
    gap_ns: u64,
    last_ns: Option<u64>,
}

impl Pace {
    /// Datagrams start at least `gap_ns` after each other.
    pub(crate) fn new(gap_ns: u64) -> Self {
        Self { gap_ns, last_ns: None }
    }

    /// When one may start.
    pub(crate) fn next_ns(&self) -> u64 {
        self.last_ns.map_or(0, |last_ns| last_ns.saturating_add(self.gap_ns))
    }

    /// Whether one may start now.
    pub(crate) fn allows(&self, now_ns: u64) -> bool {
        now_ns >= self.next_ns()
    }

    /// One starts now.
    pub(crate) fn started(&mut self, now_ns: u64) {
        self.last_ns = Some(now_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_waits_for_the_gap_and_not_longer() {
        let mut pace = Pace::new(4_000_000);
        assert!(pace.allows(0));
        pace.started(10);
        assert!(!pace.allows(11) && !pace.allows(4_000_009));
        assert!(pace.allows(4_000_010));
    }
}
