//! A ring of entries on a shared page: any number of writers on one side, one reader on the other, and nobody waits.
//!
//! Entry `n` stands in place `n % places`. Its writer counts it, then writes it under the place's sequence number, which says
//! whose entry stands there whole. A reader that is slower than the writers loses the oldest entries.

use crate::sync::{AtomicU32, Ordering, fence};

/// A place whose entry is being written.
const WRITING: u32 = u32::MAX;

/// A place of a ring. All of it may be written by another process at any time.
pub(crate) trait RingPlace {
    /// Number of the entry that stands here, plus one; [`WRITING`] while it is written.
    fn sequence(&self) -> &AtomicU32;
}

/// See the module's head.
pub(crate) struct Ring<'a, P> {
    /// Entries so far.
    pub(crate) count: &'a AtomicU32,
    pub(crate) places: &'a [P],
}

impl<P: RingPlace> Ring<'_, P> {
    /// Adds an entry by `write`. It is lost where a writer that is a whole ring behind still writes at its place.
    pub(crate) fn add(&self, write: impl FnOnce(&P)) {
        let number = self.count.fetch_add(1, Ordering::Relaxed);
        let place = self.place(number);
        let sequence = place.sequence();
        let seen = sequence.load(Ordering::Relaxed);
        let taken = seen != WRITING
            && sequence.compare_exchange(seen, WRITING, Ordering::Acquire, Ordering::Relaxed).is_ok();
        if taken {
            // Whoever reads one of the words that follow finds the mark above when it looks again.
            fence(Ordering::Release);
            write(place);
            sequence.store(number.wrapping_add(1), Ordering::Release);
        }
    }

    /// The next entry since number `seen`, which is moved on, and `lost` by as many as were written over before they were
    /// read. `None` if there is none, or it is still being written.
    pub(crate) fn next<E>(&self, seen: &mut u32, lost: &mut u64, read: fn(&P) -> E) -> Option<E> {
        let room = self.places.len() as u32;
        // So often at most: a writer that only counts must not keep the reader here.
        for _ in 0..2 * room {
            let newest = self.count.load(Ordering::Acquire);
            let skipped = newest.wrapping_sub(*seen).saturating_sub(room);
            (*seen, *lost) = (seen.wrapping_add(skipped), *lost + u64::from(skipped));
            if *seen == newest {
                return None;
            }
            let entry = self.read(*seen, read);
            // One that is still being written is waited for, unless newer ones would have to wait with it: its writer may have ended.
            let ahead = newest.wrapping_sub(*seen);
            if entry.is_none() && !(1..ahead).any(|ahead| self.is_whole(seen.wrapping_add(ahead))) {
                return None;
            }
            *seen = seen.wrapping_add(1);
            if entry.is_some() {
                return entry;
            }
            *lost += 1;
        }
        None
    }

    fn place(&self, number: u32) -> &P {
        &self.places[number as usize % self.places.len()]
    }

    fn is_whole(&self, number: u32) -> bool {
        self.place(number).sequence().load(Ordering::Acquire) == number.wrapping_add(1)
    }

    /// Entry `number`; `None` if it does not stand there whole.
    fn read<E>(&self, number: u32, read: fn(&P) -> E) -> Option<E> {
        if !self.is_whole(number) {
            return None;
        }
        let entry = read(self.place(number));
        fence(Ordering::Acquire);
        let sequence = self.place(number).sequence().load(Ordering::Relaxed);
        (sequence == number.wrapping_add(1)).then_some(entry)
    }

    /// What a writer that ended in the middle has left is no entry, and its place is free.
    pub(crate) fn forget_unfinished(&self) {
        for place in self.places {
            let _ = place.sequence().compare_exchange(WRITING, 0, Ordering::Relaxed, Ordering::Relaxed); // a whole one
        }
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::sync::AtomicU64;

    #[derive(Default)]
    struct Place {
        sequence: AtomicU32,
        words: [AtomicU64; 4],
    }

    impl RingPlace for Place {
        fn sequence(&self) -> &AtomicU32 {
            &self.sequence
        }
    }

    fn write(value: u64) -> impl Fn(&Place) {
        move |place: &Place| place.words.iter().for_each(|word| word.store(value, Ordering::Relaxed))
    }

    fn read(place: &Place) -> [u64; 4] {
        std::array::from_fn(|at| place.words[at].load(Ordering::Relaxed))
    }

    fn ring() -> (AtomicU32, [Place; 4]) {
        (AtomicU32::new(0), Default::default())
    }

    fn all(ring: &Ring<'_, Place>, seen: &mut u32, lost: &mut u64) -> Vec<u64> {
        std::iter::from_fn(|| ring.next(seen, lost, read)).map(|words| words[0]).collect()
    }

    #[test]
    fn entry_whose_writer_has_ended_in_the_middle_is_lost_and_keeps_no_newer_one_back() {
        let (count, places) = ring();
        let ring = Ring { count: &count, places: &places };
        let (mut seen, mut lost) = (0, 0);
        count.store(1, Ordering::Relaxed); // counted, and not written yet
        assert!(all(&ring, &mut seen, &mut lost).is_empty());
        assert_eq!((seen, lost), (0, 0), "it may still come");
        ring.add(write(1));
        assert_eq!(all(&ring, &mut seen, &mut lost), [1]);
        assert_eq!((seen, lost), (2, 1));
    }

    #[test]
    fn place_that_a_writer_left_in_the_middle_is_free_again_for_the_successor() {
        let (count, places) = ring();
        let ring = Ring { count: &count, places: &places };
        places[0].sequence.store(WRITING, Ordering::Relaxed);
        ring.add(write(1));
        assert!(all(&ring, &mut 0, &mut 0).is_empty(), "somebody may be writing there");
        ring.forget_unfinished();
        (0..4).for_each(|value| ring.add(write(value)));
        assert_eq!(all(&ring, &mut 0, &mut 0), [0, 1, 2, 3]);
    }

    #[test]
    fn numbers_wrap_around() {
        let (count, places) = ring();
        let ring = Ring { count: &count, places: &places };
        count.store(u32::MAX - 1, Ordering::Relaxed);
        let mut seen = u32::MAX - 1;
        (0..4).for_each(|value| ring.add(write(value)));
        assert_eq!(all(&ring, &mut seen, &mut 0), [0, 1, 2, 3]);
    }

    #[test]
    fn page_of_random_words_ends_the_readers_search() {
        let (count, places) = ring();
        let ring = Ring { count: &count, places: &places };
        let mut random = 0x9e37_79b9_7f4a_7c15_u64;
        let mut next = || {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random as u32
        };
        let (mut seen, mut lost) = (0, 0);
        for _ in 0..100_000 {
            count.store(next(), Ordering::Relaxed);
            places.iter().for_each(|place| place.sequence.store(next(), Ordering::Relaxed));
            let _ = ring.next(&mut seen, &mut lost, read);
        }
    }

    #[test]
    fn entries_of_several_writers_are_whole_each_and_none_comes_twice() {
        let (count, places) = ring();
        let ring = Ring { count: &count, places: &places };
        const EACH: u64 = 100_000;
        let done = AtomicU32::new(0);
        std::thread::scope(|scope| {
            for writer in 0..3 {
                let (ring, done) = (&ring, &done);
                scope.spawn(move || {
                    (0..EACH).for_each(|entry| ring.add(write(writer * EACH + entry)));
                    done.fetch_add(1, Ordering::Release);
                });
            }
            let (mut seen, mut lost, mut found, mut last) = (0, 0, 0_u64, [None; 3]);
            loop {
                let ended = done.load(Ordering::Acquire) == 3;
                while let Some(words) = ring.next(&mut seen, &mut lost, read) {
                    assert!(words.iter().all(|word| *word == words[0]), "torn: {words:?}");
                    let last = &mut last[(words[0] / EACH) as usize];
                    assert!(last.is_none_or(|last| last < words[0]), "twice, or out of order");
                    *last = Some(words[0]);
                    found += 1;
                }
                if ended {
                    break;
                }
            }
            assert!(found + lost <= 3 * EACH && found > 0, "{found} found, {lost} lost");
        });
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::sync::Arc;
    use loom::thread;

    use super::*;
    use crate::sync::explore;

    struct Place {
        sequence: AtomicU32,
        words: [AtomicU32; 2],
    }

    impl RingPlace for Place {
        fn sequence(&self) -> &AtomicU32 {
            &self.sequence
        }
    }

    fn place() -> Place {
        Place { sequence: AtomicU32::new(0), words: [AtomicU32::new(0), AtomicU32::new(0)] }
    }

    fn add(shared: &(AtomicU32, [Place; 2]), value: u32) {
        let ring = Ring { count: &shared.0, places: &shared.1 };
        ring.add(|place| place.words.iter().for_each(|word| word.store(value, Ordering::Relaxed)));
    }

    /// Reads what there is, and gives how much that was.
    fn look(shared: &(AtomicU32, [Place; 2]), seen: &mut u32, lost: &mut u64) -> Vec<u32> {
        let ring = Ring { count: &shared.0, places: &shared.1 };
        let read =
            |place: &Place| [place.words[0].load(Ordering::Relaxed), place.words[1].load(Ordering::Relaxed)];
        let mut found = Vec::new();
        while let Some(words) = ring.next(seen, lost, read) {
            assert_eq!(words[0], words[1], "torn");
            found.push(words[0]);
        }
        found
    }

    #[test]
    fn model_ring_reports_of_two_threads_are_found_whole_and_once() {
        explore(|| {
            let shared = Arc::new((AtomicU32::new(0), [place(), place()]));
            let writers = [1, 2].map(|value| {
                let shared = shared.clone();
                thread::spawn(move || add(&shared, value))
            });
            let (mut seen, mut lost) = (0, 0);
            let mut found = look(&shared, &mut seen, &mut lost);
            writers.into_iter().for_each(|writer| writer.join().unwrap());
            found.extend(look(&shared, &mut seen, &mut lost));
            found.sort_unstable();
            assert!(found.windows(2).all(|pair| pair[0] != pair[1]), "twice: {found:?}");
            assert_eq!(found.len() as u64 + lost, 2, "{found:?}");
        });
    }

    #[test]
    fn model_ring_an_entry_that_is_written_over_while_it_is_read_is_not_found_in_pieces() {
        explore(|| {
            let shared = Arc::new((AtomicU32::new(0), [place(), place()]));
            add(&shared, 1);
            let writer = {
                let shared = shared.clone();
                thread::spawn(move || [2, 3].into_iter().for_each(|value| add(&shared, value)))
            };
            let (mut seen, mut lost) = (0, 0);
            let mut found = look(&shared, &mut seen, &mut lost);
            writer.join().unwrap();
            found.extend(look(&shared, &mut seen, &mut lost));
            assert!(found.is_sorted() && found.last() == Some(&3), "{found:?}");
            assert_eq!(found.len() as u64 + lost, 3);
        });
    }
}
