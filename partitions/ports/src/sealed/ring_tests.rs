use std::collections::BTreeSet;

use super::super::sync::AtomicU64;
use super::*;

/// Words of one process.
struct Heap(Vec<AtomicU64>);

impl Words for Heap {
    fn words(&self) -> &[AtomicU64] {
        &self.0
    }
}

fn ring(message_bytes: usize, depth: Option<usize>, checked: bool) -> Ring<Heap> {
    let shape = RingShape::new(message_bytes, depth);
    Ring::new(Heap((0..shape.bytes() / WORD).map(|_| AtomicU64::new(0)).collect()), shape, checked)
}

fn stamp(sequence: u64) -> Stamp {
    Stamp { source_ns: sequence, sequence }
}

/// A small generator (xorshift), the same for the same seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }

    fn bytes(&mut self, most: usize) -> Vec<u8> {
        (0..self.below(most + 1)).map(|_| self.next() as u8).collect()
    }
}

#[test]
fn messages_of_any_length_come_out_as_they_went_in() {
    let mut random = Random(0x1234_5678);
    for most in [1, 7, 8, 9, 31, 64, 1000] {
        for checked in [false, true] {
            let ring = ring(most, None, checked);
            let (mut copy, mut latest, mut each) = (Copy::new(most), 0, 0);
            for number in 1..300 {
                let bytes = random.bytes(most);
                ring.put(&bytes, stamp(number));
                assert_eq!(ring.next(&mut each, &mut copy), Found::Message);
                assert_eq!((copy.bytes(), copy.stamp), (&*bytes, stamp(number)));
                if number % 3 == 0 {
                    assert_eq!(ring.latest(&mut latest, &mut copy), Found::Message);
                    assert_eq!((copy.bytes(), copy.stamp), (&*bytes, stamp(number)));
                    assert_eq!(ring.latest(&mut latest, &mut copy), Found::Nothing);
                }
            }
        }
    }
}

#[test]
fn who_is_slower_than_the_ring_is_long_loses_the_oldest_and_no_others() {
    let ring = ring(8, None, false);
    let (mut copy, mut seen) = (Copy::new(8), 0);
    let kept = ring.shape.slots as u64 - 1;
    (1..=1000_u64).for_each(|number| ring.put(&number.to_ne_bytes(), stamp(number)));
    let found: Vec<u64> = std::iter::from_fn(|| {
        (ring.next(&mut seen, &mut copy) == Found::Message).then_some(copy.stamp.sequence)
    })
    .collect();
    assert_eq!(found, (1001 - kept..=1000).collect::<Vec<_>>());
}

#[test]
fn a_length_beyond_the_channels_longest_message_is_damage() {
    let ring = ring(16, None, false);
    ring.put(&[7; 16], stamp(1));
    for length in [17, 1 << 20, u64::MAX] {
        ring.slot(1)[LENGTH].store(length, Ordering::Relaxed);
        assert_eq!(ring.latest(&mut 0, &mut Copy::new(16)), Found::Damaged, "{length}");
    }
}

#[test]
fn any_changed_bit_of_a_checked_message_is_damage() {
    let ring = ring(24, None, true);
    ring.put(&[7; 24], stamp(1));
    let words = [SOURCE_NS, SEQUENCE, LENGTH, MESSAGE, MESSAGE + 1, MESSAGE + 2];
    for (word, bit) in words.into_iter().flat_map(|word| (0..64).map(move |bit| (word, bit))) {
        let word = &ring.slot(1)[word];
        let before = word.load(Ordering::Relaxed);
        word.store(before ^ (1 << bit), Ordering::Relaxed);
        assert_eq!(ring.latest(&mut 0, &mut Copy::new(24)), Found::Damaged);
        word.store(before, Ordering::Relaxed);
    }
    assert_eq!(ring.latest(&mut 0, &mut Copy::new(24)), Found::Message);
}

/// Writes over up to three words of the ring.
fn spoil(ring: &Ring<Heap>, random: &mut Random) {
    for _ in 0..random.below(4) {
        let words = ring.memory.words();
        // The words with numbers more often than their share: they decide what is looked at.
        let place = match random.below(4) {
            0 => NEWEST,
            1 => ring.place(random.next()) / WORD + random.below(MESSAGE),
            _ => random.below(words.len()),
        };
        let old = words[place].load(Ordering::Relaxed);
        let new = match random.below(4) {
            0 => random.next(),
            1 => old ^ (1 << random.below(64)),
            2 => old.wrapping_add(random.below(300) as u64),
            _ => old.wrapping_sub(random.below(300) as u64),
        };
        words[place].store(new, Ordering::Relaxed);
    }
}

#[test]
fn memory_that_is_written_over_gives_no_message_that_was_not_written_there() {
    for seed in 1..=20_u64 {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let ring = ring(40, Some(4), true);
        let (mut copy, mut written) = (Copy::new(40), BTreeSet::new());
        let (mut latest, mut each, mut taken) = (0, 0, 0);
        let mut found = [0; 3];
        for number in 1..=10_000 {
            let bytes = random.bytes(40);
            ring.put(&bytes, stamp(number));
            written.insert((number, bytes));
            spoil(&ring, &mut random);
            for (way, count) in found.iter_mut().enumerate() {
                let look = match way {
                    0 => ring.latest(&mut latest, &mut copy),
                    1 => ring.next(&mut each, &mut copy),
                    _ => ring.take(&mut taken, 4, &mut copy),
                };
                if look == Found::Message {
                    let message = (copy.stamp.sequence, copy.bytes().to_vec());
                    assert!(written.contains(&message), "seed {seed}, message {number}: {message:?}");
                    *count += 1;
                }
            }
        }
        assert!(
            found.iter().all(|count| *count > 1000),
            "seed {seed}: hardly anything came through: {found:?}"
        );
    }
}
