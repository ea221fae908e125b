//! The instants that processes wait for: a heap in which every slot has one instant at most and can be found and removed.

use crate::standard::SystemTime;

/// The slot is not in the heap.
const ABSENT: u16 = u16::MAX;

#[derive(Debug)]
pub(crate) struct Timers {
    /// The earliest first; of equal instants the lowest slot.
    heap: Vec<(SystemTime, u16)>,
    /// By slot: its place in the heap.
    places: Vec<u16>,
}

impl Timers {
    pub(crate) fn new(slots: usize) -> Self {
        Self { heap: Vec::with_capacity(slots), places: vec![ABSENT; slots] }
    }

    /// The earliest instant, and its slot.
    pub(crate) fn first(&self) -> Option<(SystemTime, usize)> {
        self.heap.first().map(|(at, slot)| (*at, *slot as usize))
    }

    /// Arms a slot, in place of what it was armed for.
    pub(crate) fn arm(&mut self, slot: usize, at: SystemTime) {
        self.cancel(slot);
        let place = self.heap.len();
        self.heap.push((at, slot as u16));
        self.places[slot] = place as u16;
        self.rise(place);
    }

    pub(crate) fn cancel(&mut self, slot: usize) {
        let place = self.places[slot];
        if place == ABSENT {
            return;
        }
        let place = place as usize;
        self.swap(place, self.heap.len() - 1);
        self.heap.pop();
        self.places[slot] = ABSENT;
        if place < self.heap.len() {
            self.rise(place);
            self.sink(place);
        }
    }

    fn rise(&mut self, mut place: usize) {
        while place > 0 && self.heap[place] < self.heap[(place - 1) / 2] {
            self.swap(place, (place - 1) / 2);
            place = (place - 1) / 2;
        }
    }

    fn sink(&mut self, mut place: usize) {
        loop {
            let children = [2 * place + 1, 2 * place + 2];
            let present = children.into_iter().filter(|child| *child < self.heap.len());
            let Some(least) = present.min_by_key(|child| self.heap[*child]) else { return };
            if self.heap[place] <= self.heap[least] {
                return;
            }
            self.swap(place, least);
            place = least;
        }
    }

    fn swap(&mut self, one: usize, other: usize) {
        self.heap.swap(one, other);
        for place in [one, other] {
            self.places[self.heap[place].1 as usize] = place as u16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn heap_gives_the_earliest_of_those_that_are_armed() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut timers = Timers::new(20);
        let mut armed = [None; 20];
        for _ in 0..20_000 {
            let slot = random.random_range(0..20);
            if random.random_range(0..3) == 0 {
                timers.cancel(slot);
                armed[slot] = None;
            } else {
                let at = random.random_range(0..50);
                timers.arm(slot, at);
                armed[slot] = Some(at);
            }
            let earliest = (0..20).filter_map(|slot| Some((armed[slot]?, slot))).min();
            assert_eq!(timers.first(), earliest);
        }
    }
}
