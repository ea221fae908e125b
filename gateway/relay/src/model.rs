//! A network that delays, loses, doubles, reorders and cuts off datagrams, seeded and counted.
//!
//! Responsible for: when a datagram arrives, and how often. The same seed does the same to the same datagrams at the same
//! instants. It must never lose count: what it did to datagrams is what relays have to find in their counters.

use bateleur_contract::relay::{CutTable, LinkModelTable};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Bytes that a datagram has on an Ethernet beside its payload: preamble, frame, IPv4, UDP, gap.
const OVERHEAD: u64 = 8 + 18 + 20 + 8 + 12;
/// What would have to wait longer than this for the wire is dropped, as by a switch whose queue is full, ns.
const LONGEST_WAIT_NS: u64 = 100_000_000;

/// What was done to datagrams.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct ModelCounters {
    /// Datagrams that were handed in.
    pub offered: u64,
    /// Lost by chance.
    pub lost: u64,
    /// Lost because the network was cut.
    pub cut: u64,
    /// Lost because too much waited for the wire.
    pub crowded: u64,
    /// Arrived twice.
    pub duplicated: u64,
    /// Arrived after one that was handed in later.
    pub reordered: u64,
    /// Arrivals in all: every one of a datagram that arrives twice.
    pub arrivals: u64,
}

/// One direction of a modelled network.
#[derive(Debug)]
pub struct LinkModel {
    table: LinkModelTable,
    cuts: Vec<CutTable>,
    random: ChaCha8Rng,
    /// Until then the wire is busy, ns.
    busy_until_ns: u64,
    /// First arrivals of datagrams that are on their way, and whether one has overtaken them.
    on_the_way: Vec<(u64, bool)>,
    counters: ModelCounters,
}

/// When a datagram arrives, ns: not at all, once, or twice.
pub type Arrivals = [Option<u64>; 2];

impl LinkModel {
    /// The model of what the initiator (or else the other end) of `link` sends on `network`.
    #[must_use]
    pub fn new(table: &LinkModelTable, network: &str, link: u16, of_initiator: bool) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&table.seed.to_le_bytes());
        hasher.update(&link.to_le_bytes());
        hasher.update(&[u8::from(of_initiator)]);
        hasher.update(network.as_bytes());
        Self {
            table: table.clone(),
            cuts: table.cuts.iter().filter(|cut| cut.network == network).cloned().collect(),
            random: ChaCha8Rng::from_seed(*hasher.finalize().as_bytes()),
            busy_until_ns: 0,
            on_the_way: Vec::new(),
            counters: ModelCounters::default(),
        }
    }

    /// A datagram of `bytes` is handed in at `now_ns`, which never decreases.
    pub fn pass(&mut self, now_ns: u64, bytes: usize) -> Arrivals {
        self.counters.offered += 1;
        // Every datagram draws the same numbers, so that what becomes of one does not depend on another.
        let [loss, jitter, reorder, duplicate, second_jitter] = [(); 5].map(|()| self.share());
        if self.cuts.iter().any(|cut| (cut.from_ns..cut.until_ns).contains(&now_ns)) {
            self.counters.cut += 1;
            return [None; 2];
        }
        if loss < self.table.loss {
            self.counters.lost += 1;
            return [None; 2];
        }
        let Some(sent_ns) = self.through_the_wire(now_ns, bytes) else {
            self.counters.crowded += 1;
            return [None; 2];
        };
        let jitter_ns = |share: f64| (share * self.table.jitter_ns as f64) as u64;
        let held_ns = if reorder < self.table.reorder { self.table.reorder_ns } else { 0 };
        let first_ns = sent_ns + self.table.delay_ns + jitter_ns(jitter) + held_ns;
        let second_ns = (duplicate < self.table.duplicate)
            .then(|| sent_ns + self.table.delay_ns + jitter_ns(second_jitter) + held_ns);
        self.counters.arrivals += 1 + u64::from(second_ns.is_some());
        self.counters.duplicated += u64::from(second_ns.is_some());
        self.overtake(now_ns, second_ns.map_or(first_ns, |second_ns| second_ns.min(first_ns)));
        [Some(first_ns), second_ns]
    }

    /// What was done so far.
    #[must_use]
    pub fn counters(&self) -> ModelCounters {
        self.counters
    }

    /// When the last bit is on the wire; nothing: too much waits for it.
    fn through_the_wire(&mut self, now_ns: u64, bytes: usize) -> Option<u64> {
        if self.table.rate_bps == 0 {
            return Some(now_ns);
        }
        let start_ns = self.busy_until_ns.max(now_ns);
        if start_ns - now_ns > LONGEST_WAIT_NS {
            return None;
        }
        let bits = (bytes as u64 + OVERHEAD) * 8;
        let length_ns = u128::from(bits) * 1_000_000_000 / u128::from(self.table.rate_bps);
        self.busy_until_ns = start_ns.saturating_add(u64::try_from(length_ns).unwrap_or(u64::MAX));
        Some(self.busy_until_ns)
    }

    /// One arrives at `first_ns`: those that come later were handed in before.
    fn overtake(&mut self, now_ns: u64, first_ns: u64) {
        self.on_the_way.retain(|(arrives_ns, _)| *arrives_ns > now_ns);
        for (arrives_ns, overtaken) in &mut self.on_the_way {
            if *arrives_ns > first_ns && !std::mem::replace(overtaken, true) {
                self.counters.reordered += 1;
            }
        }
        self.on_the_way.push((first_ns, false));
    }

    /// Evenly between 0 and 1.
    fn share(&mut self) -> f64 {
        (self.random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(table: LinkModelTable) -> LinkModel {
        LinkModel::new(&table, "a", 1, true)
    }

    fn arrivals(model: &mut LinkModel, count: u64) -> Vec<Arrivals> {
        (0..count).map(|number| model.pass(number * 1_000_000, 100)).collect()
    }

    #[test]
    fn a_model_without_faults_passes_everything_at_once() {
        let mut model = model(LinkModelTable::default());
        assert_eq!(arrivals(&mut model, 3), [0, 1_000_000, 2_000_000].map(|at| [Some(at), None]));
        let expected = ModelCounters { offered: 3, arrivals: 3, ..ModelCounters::default() };
        assert_eq!(model.counters(), expected);
    }

    #[test]
    fn the_same_seed_does_the_same_and_another_direction_something_else() {
        let table =
            LinkModelTable { seed: 9, loss: 0.1, jitter_ns: 500_000, duplicate: 0.1, ..Default::default() };
        let first = arrivals(&mut model(table.clone()), 500);
        assert_eq!(first, arrivals(&mut model(table.clone()), 500));
        assert_ne!(first, arrivals(&mut LinkModel::new(&table, "a", 1, false), 500));
        assert_ne!(first, arrivals(&mut LinkModel::new(&table, "b", 1, true), 500));
    }

    #[test]
    fn counters_say_what_was_done() {
        let mut model = model(LinkModelTable {
            seed: 3,
            delay_ns: 2_000_000,
            jitter_ns: 5_000_000,
            loss: 0.05,
            duplicate: 0.03,
            reorder: 0.02,
            reorder_ns: 4_000_000,
            ..Default::default()
        });
        let all = arrivals(&mut model, 10_000);
        let counted = model.counters();
        assert_eq!(counted.lost, all.iter().filter(|arrivals| arrivals[0].is_none()).count() as u64);
        assert_eq!(counted.duplicated, all.iter().filter(|arrivals| arrivals[1].is_some()).count() as u64);
        assert_eq!(counted.arrivals, all.iter().flatten().flatten().count() as u64);
        let firsts: Vec<u64> =
            all.iter().filter_map(|arrivals| arrivals.iter().flatten().min()).copied().collect();
        let overtaken = |n: &usize| firsts[n + 1..].iter().any(|later| *later < firsts[*n]);
        assert_eq!(counted.reordered, (0..firsts.len()).filter(overtaken).count() as u64);
        assert!((300..700).contains(&counted.lost) && counted.reordered > 1_000, "{counted:?}");
    }

    #[test]
    fn a_cut_lasts_as_long_as_it_says_on_its_network() {
        let cuts = vec![CutTable { network: "a".into(), from_ns: 1_000_000, until_ns: 3_000_000 }];
        let table = LinkModelTable { cuts, ..Default::default() };
        let came = |network| {
            let all = arrivals(&mut LinkModel::new(&table, network, 1, true), 4);
            all.iter().map(|arrivals| arrivals[0].is_some()).collect::<Vec<_>>()
        };
        assert_eq!(came("a"), [true, false, false, true]);
        assert_eq!(came("b"), [true; 4]);
    }

    #[test]
    fn a_slow_wire_takes_its_time_and_drops_what_would_wait_too_long() {
        let mut model = model(LinkModelTable { rate_bps: 1_000_000, ..Default::default() });
        assert_eq!(model.pass(0, 59), [Some(1_000_000), None]); // 125 bytes with what is around it
        assert_eq!(model.pass(0, 59), [Some(2_000_000), None]);
        let passed = (0..1_000).filter(|_| model.pass(0, 59)[0].is_some()).count();
        assert_eq!((passed, model.counters().crowded), (99, 901));
    }
}
