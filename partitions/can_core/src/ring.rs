//! The ring buffer between a bus and a network, in either direction.
//!
//! Responsible for: holding frames for as long as they are worth something, and counting each one that is given up. It must
//! never lose a frame silently, and never hand out an old one.

use std::collections::btree_map;
use std::collections::{BTreeMap, VecDeque};

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
    /// Frames that came into the ring before its place was taken.
    number: u64,
    /// When it came from where it was made, ns; before the time at which it came here where it has aged on the way.
    born_ns: u64,
    /// Since when a frame waits in this place, ns: a newer one that takes it waits no longer for that.
    since_ns: u64,
}

impl Entry {
    fn age_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.born_ns)
    }
}

/// See the module's text.
#[derive(Debug)]
pub struct Ring {
    rules: Rules,
    /// What waits, by priority on the bus; those of one priority in the order in which they came.
    queues: BTreeMap<u64, VecDeque<Entry>>,
    /// The priority of each that waits, by its number: in the order in which they came.
    arrivals: BTreeMap<u64, u64>,
    /// Places that were taken so far.
    came: u64,
    given_up: GivenUp,
}

impl Ring {
    /// An empty one.
    pub fn new(rules: Rules) -> Self {
        let capacity = rules.capacity.max(1);
        Self {
            rules: Rules { capacity, ..rules },
            queues: BTreeMap::new(),
            arrivals: BTreeMap::new(),
            came: 0,
            given_up: GivenUp::default(),
        }
    }

    /// Frames that wait.
    pub fn len(&self) -> usize {
        self.arrivals.len()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.arrivals.is_empty()
    }

    /// Frames that were given up so far.
    pub fn given_up(&self) -> GivenUp {
        self.given_up
    }

    /// Since when the first place is taken, ns.
    pub fn oldest_ns(&self) -> Option<u64> {
        let (_, priority) = self.arrivals.first_key_value()?;
        self.queues.get(priority)?.front().map(|entry| entry.since_ns)
    }

    /// Takes a frame that is `age_ns` old at `now_ns`; whether it needed a place of its own.
    pub fn push(&mut self, frame: Frame, age_ns: u64, now_ns: u64) -> bool {
        if age_ns > self.rules.max_age_ns {
            self.given_up.expired += 1;
            return false;
        }
        let born_ns = now_ns.saturating_sub(age_ns);
        let entry = Entry { frame, number: self.came, born_ns, since_ns: born_ns };
        if self.rules.newest_wins.contain(frame.id()) && self.supersede(entry) {
            return false;
        }
        if self.len() == self.rules.capacity {
            self.give_up_oldest();
        }
        self.came += 1;
        self.arrivals.insert(entry.number, frame.priority());
        self.queues.entry(frame.priority()).or_default().push_back(entry);
        true
    }

    /// Puts the newest value in the place of the one that waits, if there is one.
    fn supersede(&mut self, entry: Entry) -> bool {
        let Some(queue) = self.queues.get_mut(&entry.frame.priority()) else { return false };
        let Some(waiting) = queue.iter_mut().rfind(|waiting| key(&waiting.frame) == key(&entry.frame)) else {
            return false;
        };
        *waiting = Entry { number: waiting.number, since_ns: waiting.since_ns, ..entry };
        self.given_up.superseded += 1;
        true
    }

    fn give_up_oldest(&mut self) {
        let Some((_, priority)) = self.arrivals.pop_first() else { return };
        if let btree_map::Entry::Occupied(mut queue) = self.queues.entry(priority) {
            queue.get_mut().pop_front(); // the oldest of all is the oldest of its priority
            if queue.get().is_empty() {
                queue.remove();
            }
        }
        self.given_up.overflow += 1;
    }

    /// Hands out every frame that is not too old, in the order in which a bus would carry them: the first of each priority, then the
    /// second of each, and so on. So sets of frames that are sent again and again stay sets, where several of them wait. A frame
    /// that `takes` refuses waits on, and all behind it.
    pub fn hand_out(&mut self, now_ns: u64, mut takes: impl FnMut(&Aged) -> bool) {
        self.expire(now_ns);
        let mut goes_on = true;
        while goes_on && !self.is_empty() {
            self.queues.retain(|_, queue| {
                if let Some(first) = queue.front().filter(|_| goes_on) {
                    goes_on = takes(&Aged { frame: first.frame, age_ns: first.age_ns(now_ns) });
                    if goes_on {
                        self.arrivals.remove(&first.number);
                        queue.pop_front();
                    }
                }
                !queue.is_empty()
            });
        }
    }

    /// Gives up what has become too old.
    pub fn expire(&mut self, now_ns: u64) {
        self.queues.retain(|_, queue| {
            queue.retain(|entry| {
                let is_worth_it = entry.age_ns(now_ns) <= self.rules.max_age_ns;
                if !is_worth_it {
                    self.arrivals.remove(&entry.number);
                    self.given_up.expired += 1;
                }
                is_worth_it
            });
            !queue.is_empty()
        });
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
        ring.hand_out(now_ns, |aged| {
            out.push(aged.frame);
            true
        });
        out
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
        let mut room = 1;
        ring.hand_out(60, |_| {
            room -= 1;
            room >= 0
        });
        ring.push(frame(2, 2), 0, 90);
        assert_eq!((ring.len(), ring.oldest_ns()), (2, Some(0)), "its place is as old as it was");
        assert_eq!(drained(&mut ring, 110), [frame(2, 2)]);
        assert_eq!(ring.given_up(), GivenUp { superseded: 1, expired: 1, overflow: 0 });
    }

    #[test]
    fn full_ring_gives_up_its_oldest_frame_and_not_the_most_urgent_also_while_the_bus_takes_nothing() {
        let mut ring = Ring::new(rules(2, 100, Ids::None));
        ring.push(frame(0x700, 1), 0, 0);
        ring.push(frame(0x010, 1), 0, 1);
        ring.hand_out(1, |_| false);
        ring.push(frame(0x300, 1), 0, 2);
        assert_eq!(drained(&mut ring, 2), [frame(0x010, 1), frame(0x300, 1)]);
        assert_eq!(ring.given_up(), GivenUp { overflow: 1, ..GivenUp::default() });
    }

    #[test]
    fn old_frame_is_given_up_also_behind_one_that_came_earlier_and_is_younger() {
        let mut ring = Ring::new(rules(9, 100, Ids::None));
        ring.push(frame(1, 1), 0, 1_050);
        ring.push(frame(2, 1), 90, 1_060);
        ring.expire(1_080);
        assert_eq!((ring.len(), ring.given_up().expired), (1, 1));
        assert_eq!(drained(&mut ring, 1_080), [frame(1, 1)]);
    }

    #[test]
    fn ring_of_a_bus_that_is_absent_holds_nothing_of_frames_that_it_gave_up() {
        let mut ring = Ring::new(rules(2, 100, Ids::All));
        (0..100).for_each(|id| assert!(ring.push(frame(id, 1), 0, 0)));
        assert_eq!((ring.queues.len(), ring.arrivals.len()), (2, 2));
        ring.expire(1_000);
        assert_eq!((ring.queues.len(), ring.arrivals.len()), (0, 0));
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
            room in 1_usize..50,
            all: bool,
        ) {
            let mut ring = Ring::new(rules(capacity, 100, if all { Ids::All } else { Ids::None }));
            let (mut now_ns, mut out) = (0, 0);
            for (frame, passes_ns, drain) in &frames {
                now_ns += passes_ns;
                ring.push(*frame, 0, now_ns);
                if *drain {
                    let mut sent = Vec::new();
                    ring.hand_out(now_ns, |aged| {
                        sent.push(*aged);
                        sent.len() <= room
                    });
                    sent.truncate(room);
                    let mut seen = BTreeMap::new();
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
