//! The ring buffer between a bus and a network, in either direction.
//!
//! Responsible for: holding frames for as long as they are worth something, and counting each one that is given up. It must
//! never lose a frame silently, and never hand out an old one.

use std::collections::{HashMap, VecDeque};

use crate::Ids;
use crate::frame::{Frame, Kind};
use crate::wire::native::Aged;

/// What a ring does with frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// Frames that it holds at most; where one more comes, the oldest is given up.
    pub capacity: usize,
    /// A frame that is older is given up, ns.
    pub max_age_ns: u64,
    /// Of these identifiers the newest frame takes the place of one that still waits: values that are sent again and again.
    pub newest_wins: Ids,
}

/// Frames that a ring gave up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct GivenUp {
    /// Because it was full.
    pub overflow: u64,
    /// Because they were older than is worth while.
    pub expired: u64,
    /// Because a newer one of the same identifier came.
    pub superseded: u64,
}

impl GivenUp {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.overflow + self.expired + self.superseded
    }
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    frame: Frame,
    /// When it came from where it was made, ns; before the time at which it came here where it has aged on the way.
    born_ns: u64,
    /// Since when a frame waits in this place, ns: a newer one that takes it waits no longer for that.
    since_ns: u64,
}

/// See the module's text.
#[derive(Debug)]
pub struct Ring {
    rules: Rules,
    entries: VecDeque<Entry>,
    /// Entries taken out so far: an entry's number is this and its place.
    taken: u64,
    /// The number of the entry of each identifier whose newest wins.
    latest: HashMap<(u32, bool), u64>,
    given_up: GivenUp,
    /// For [`in_rounds`], which sorts in it.
    rounds: Vec<(u32, Aged)>,
}

impl Ring {
    /// An empty one.
    pub fn new(rules: Rules) -> Self {
        let capacity = rules.capacity.max(1);
        Self {
            entries: VecDeque::with_capacity(capacity),
            rules: Rules { capacity, ..rules },
            taken: 0,
            latest: HashMap::new(),
            given_up: GivenUp::default(),
            rounds: Vec::new(),
        }
    }

    /// Frames that wait.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Frames that were given up so far.
    pub fn given_up(&self) -> GivenUp {
        self.given_up
    }

    /// Since when the first place is taken, ns.
    pub fn oldest_ns(&self) -> Option<u64> {
        self.entries.front().map(|entry| entry.since_ns)
    }

    /// Takes a frame that is `age_ns` old at `now_ns`; whether it needed a place of its own.
    pub fn push(&mut self, frame: Frame, age_ns: u64, now_ns: u64) -> bool {
        if age_ns > self.rules.max_age_ns {
            self.given_up.expired += 1;
            return false;
        }
        let born_ns = now_ns.saturating_sub(age_ns);
        let entry = Entry { frame, born_ns, since_ns: born_ns };
        let newest_wins = self.rules.newest_wins.contain(frame.id());
        if newest_wins && self.supersede(entry) {
            return false;
        }
        if self.entries.len() == self.rules.capacity {
            self.pop();
            self.given_up.overflow += 1;
        }
        if newest_wins {
            self.latest.insert(key(&frame), self.taken + self.entries.len() as u64);
        }
        self.entries.push_back(entry);
        true
    }

    /// Puts the newest value in the place of the one that waits, if there is one.
    fn supersede(&mut self, entry: Entry) -> bool {
        let Some(number) = self.latest.get(&key(&entry.frame)) else { return false };
        let Some(place) = number.checked_sub(self.taken) else { return false };
        let Some(waiting) = self.entries.get_mut(place as usize) else { return false };
        *waiting = Entry { since_ns: waiting.since_ns, ..entry };
        self.given_up.superseded += 1;
        true
    }

    fn pop(&mut self) -> Option<Entry> {
        let entry = self.entries.pop_front()?;
        self.taken += 1;
        Some(entry)
    }

    /// Moves every frame that is not too old into `out`, in the order in which a bus would carry them: the first of each
    /// identifier, then the second of each, and so on. So sets of frames that are sent again and again stay sets, where several of
    /// them wait.
    pub fn drain(&mut self, now_ns: u64, out: &mut Vec<Aged>) {
        let begun = out.len();
        while let Some(Entry { frame, born_ns, .. }) = self.pop() {
            let age_ns = now_ns.saturating_sub(born_ns);
            if age_ns > self.rules.max_age_ns {
                self.given_up.expired += 1;
            } else {
                out.push(Aged { frame, age_ns });
            }
        }
        self.latest.clear();
        if out.len() - begun > 1 {
            in_rounds(&mut out[begun..], &mut self.rounds);
        }
    }

    /// Takes back frames that [`Ring::drain`] gave at the same instant and that could not go on; nothing may have come in
    /// between.
    pub fn put_back(&mut self, now_ns: u64, rest: &[Aged]) {
        for Aged { frame, age_ns } in rest.iter().rev() {
            let born_ns = now_ns.saturating_sub(*age_ns);
            self.entries.push_front(Entry { frame: *frame, born_ns, since_ns: born_ns });
        }
        for (place, entry) in self.entries.iter().enumerate() {
            if self.rules.newest_wins.contain(entry.frame.id()) {
                self.latest.insert(key(&entry.frame), self.taken + place as u64);
            }
        }
    }

    /// Gives up what has become too old, from the oldest on.
    pub fn expire(&mut self, now_ns: u64) {
        let born_ns = |ring: &Self| ring.entries.front().map(|entry| entry.born_ns);
        while born_ns(self).is_some_and(|born_ns| now_ns.saturating_sub(born_ns) > self.rules.max_age_ns) {
            self.pop();
            self.given_up.expired += 1;
        }
    }
}

/// Sorts frames by how many of their identifier came before, then as a bus would; `scratch` is room to do it in.
fn in_rounds(frames: &mut [Aged], scratch: &mut Vec<(u32, Aged)>) {
    frames.sort_by_key(|aged| aged.frame.priority());
    if !frames.is_sorted_by(|one, next| one.frame.priority() < next.frame.priority()) {
        scratch.clear();
        for aged in frames.iter() {
            let round = match scratch.last() {
                Some((round, before)) if before.frame.priority() == aged.frame.priority() => round + 1,
                _ => 0,
            };
            scratch.push((round, *aged));
        }
        scratch.sort_by_key(|(round, _)| *round);
        frames.iter_mut().zip(scratch.iter()).for_each(|(to, (_, aged))| *to = *aged);
    }
}

/// A remote frame asks for the value that a data frame of the same identifier brings: they are two.
fn key(frame: &Frame) -> (u32, bool) {
    (frame.word(), matches!(frame.kind(), Kind::Fd { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Id, any};
    use proptest::prelude::*;

    fn rules(capacity: usize, max_age_ns: u64, newest_wins: Ids) -> Rules {
        Rules { capacity, max_age_ns, newest_wins }
    }

    fn frame(id: u16, value: u8) -> Frame {
        Frame::classic(Id::Standard(id), &[value])
    }

    fn drained(ring: &mut Ring, now_ns: u64) -> Vec<Frame> {
        let mut out = Vec::new();
        ring.drain(now_ns, &mut out);
        out.iter().map(|aged| aged.frame).collect()
    }

    #[test]
    fn a_full_ring_gives_up_its_oldest_frame_and_counts_it() {
        let mut ring = Ring::new(rules(2, 100, Ids::None));
        (1..=3).for_each(|value| assert!(ring.push(frame(1, value), 0, 0)));
        assert_eq!(drained(&mut ring, 0), [frame(1, 2), frame(1, 3)]);
        assert_eq!(ring.given_up(), GivenUp { overflow: 1, ..GivenUp::default() });
    }

    #[test]
    fn an_old_frame_is_not_handed_out_and_counts_its_age_from_where_it_was_made() {
        let mut ring = Ring::new(rules(9, 100, Ids::None));
        ring.push(frame(1, 1), 0, 0);
        ring.push(frame(1, 2), 90, 20);
        ring.push(frame(1, 3), 0, 30);
        ring.push(frame(1, 4), 101, 30);
        assert_eq!(drained(&mut ring, 120), [frame(1, 3)]);
        assert_eq!(ring.given_up().expired, 3);
        ring.push(frame(1, 5), 0, 200);
        ring.expire(301);
        assert!(ring.is_empty());
        assert_eq!(ring.given_up().expired, 4);
    }

    #[test]
    fn the_newest_of_a_periodic_identifier_takes_the_place_of_the_one_that_waits() {
        let mut ring = Ring::new(rules(9, 100, "10-1f".parse().unwrap()));
        ring.push(frame(0x10, 1), 0, 0);
        ring.push(frame(0x20, 1), 0, 0);
        ring.push(frame(0x10, 2), 0, 50);
        ring.push(frame(0x20, 2), 0, 50);
        ring.push(Frame::remote(Id::Standard(0x10), 1).unwrap(), 0, 50);
        let sent = drained(&mut ring, 101);
        assert_eq!(sent, [frame(0x10, 2), Frame::remote(Id::Standard(0x10), 1).unwrap(), frame(0x20, 2)]);
        assert_eq!(ring.given_up(), GivenUp { superseded: 1, expired: 1, overflow: 0 });
        ring.push(frame(0x10, 3), 0, 200);
        assert_eq!(drained(&mut ring, 200), [frame(0x10, 3)], "what was sent is not there to be replaced");
    }

    #[test]
    fn what_could_not_go_on_waits_again_and_may_be_replaced() {
        let mut ring = Ring::new(rules(9, 100, Ids::All));
        (1..=3).for_each(|id| assert!(ring.push(frame(id, 1), 0, 0)));
        let mut out = Vec::new();
        ring.drain(60, &mut out);
        ring.put_back(60, &out[1..]);
        ring.push(frame(2, 2), 0, 90);
        assert_eq!((ring.len(), ring.oldest_ns()), (2, Some(0)), "its place is as old as it was");
        assert_eq!(drained(&mut ring, 110), [frame(2, 2)]);
        assert_eq!(ring.given_up(), GivenUp { superseded: 1, expired: 1, overflow: 0 });
    }

    #[test]
    fn a_frame_that_overflowed_is_not_there_to_be_replaced() {
        let mut ring = Ring::new(rules(1, 100, Ids::All));
        ring.push(frame(1, 1), 0, 0);
        ring.push(frame(2, 1), 0, 0);
        ring.push(frame(1, 2), 0, 0);
        assert_eq!(drained(&mut ring, 0), [frame(1, 2)]);
        assert_eq!(ring.given_up().overflow, 2);
    }

    #[test]
    fn sets_that_wait_together_leave_one_after_the_other() {
        let mut ring = Ring::new(rules(99, 100, Ids::None));
        for (value, id) in (0..3).flat_map(|value| [0x110, 0x111, 0x114].map(|id| (value, id))) {
            ring.push(frame(id, value), 0, 0);
        }
        ring.push(frame(0x50, 9), 0, 0);
        let sets = (0..3).flat_map(|value| [0x110, 0x111, 0x114].map(|id| frame(id, value)));
        let expected: Vec<Frame> = std::iter::once(frame(0x50, 9)).chain(sets).collect();
        assert_eq!(drained(&mut ring, 0), expected);
    }

    #[test]
    fn a_value_that_is_replaced_again_and_again_does_not_put_off_those_behind_it() {
        let mut ring = Ring::new(rules(9, 100, "10".parse().unwrap()));
        assert!(ring.push(frame(0x10, 0), 0, 5));
        assert!(ring.push(frame(0x20, 0), 0, 6));
        assert!(!ring.push(frame(0x10, 1), 0, 90), "no place of its own");
        assert_eq!(ring.oldest_ns(), Some(5));
    }

    proptest! {
        #[test]
        fn every_frame_is_handed_out_or_counted_and_in_order(
            frames in proptest::collection::vec((any::frame(), 0_u64..200, any::<bool>()), 0..200),
            capacity in 1_usize..40,
            all: bool,
        ) {
            let mut ring = Ring::new(rules(capacity, 100, if all { Ids::All } else { Ids::None }));
            let (mut now_ns, mut out) = (0, 0);
            for (frame, passes_ns, drain) in &frames {
                now_ns += passes_ns;
                ring.push(*frame, 0, now_ns);
                if *drain {
                    let mut sent = Vec::new();
                    ring.drain(now_ns, &mut sent);
                    let mut seen = HashMap::new();
                    let rounds: Vec<_> = sent
                        .iter()
                        .map(|aged| {
                            let round = seen.entry(aged.frame.priority()).and_modify(|round| *round += 1).or_insert(0);
                            (*round, aged.frame.priority())
                        })
                        .collect();
                    prop_assert!(rounds.is_sorted());
                    prop_assert!(sent.iter().all(|aged| aged.age_ns <= 100));
                    out += sent.len();
                }
            }
            prop_assert_eq!(frames.len() as u64, out as u64 + ring.len() as u64 + ring.given_up().total());
        }
    }
}
