//! The ring and the index in every order in which the two ends of a channel can meet.

use loom::sync::Arc;
use loom::thread;

use super::super::index::Index;
use super::super::sync::explore;
use super::*;

/// Words that threads of the model share.
#[derive(Clone)]
struct Heap(Arc<Vec<AtomicU64>>);

impl Heap {
    fn new(bytes: usize) -> Self {
        Self(Arc::new((0..bytes / WORD).map(|_| AtomicU64::new(0)).collect()))
    }
}

impl Words for Heap {
    fn words(&self) -> &[AtomicU64] {
        &self.0
    }
}

fn ring(slots: usize) -> Ring<Heap> {
    let shape = RingShape { message_bytes: 16, slots };
    Ring::new(Heap::new(shape.bytes()), shape, false)
}

fn same(ring: &Ring<Heap>) -> Ring<Heap> {
    Ring::new(ring.memory.clone(), ring.shape, ring.checked)
}

fn put(ring: &Ring<Heap>, value: u64) {
    ring.put([value; 2].as_bytes(), Stamp { source_ns: value, sequence: value });
}

/// The value of a copy, all of whose words have to be the same.
fn value(copy: &Copy) -> u64 {
    let stamp = copy.stamp;
    assert_eq!(copy.bytes(), [stamp.sequence; 2].as_bytes(), "parts of two messages");
    assert_eq!(stamp.source_ns, stamp.sequence, "a stamp of another message");
    stamp.sequence
}

fn latest(ring: &Ring<Heap>, seen: &mut u64) -> Option<u64> {
    let mut copy = Copy::new(16);
    match ring.latest(seen, &mut copy) {
        Found::Message => Some(value(&copy)),
        Found::Nothing => None,
        Found::Damaged => panic!("nothing is damaged"),
    }
}

fn all(ring: &Ring<Heap>, seen: &mut u64) -> Vec<u64> {
    let mut copy = Copy::new(16);
    let mut found = Vec::new();
    while ring.next(seen, &mut copy) == Found::Message {
        found.push(value(&copy));
    }
    found
}

#[test]
fn model_sealed_a_latest_value_is_whole_whenever_it_is_read_and_never_goes_back() {
    explore(|| {
        let ring = ring(2);
        put(&ring, 1);
        let source = same(&ring);
        let writer = thread::spawn(move || (2..=3).for_each(|value| put(&source, value)));
        let mut seen = 0;
        let mut found: Vec<u64> = (0..2).filter_map(|_| latest(&ring, &mut seen)).collect();
        writer.join().unwrap();
        found.extend(latest(&ring, &mut seen));
        assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{found:?}");
        assert_eq!(found.last(), Some(&3));
    });
}

#[test]
fn model_sealed_who_looks_at_each_message_has_each_once_in_order_and_the_last_of_them() {
    explore(|| {
        let ring = ring(2);
        put(&ring, 1);
        let source = same(&ring);
        let writer = thread::spawn(move || (2..=3).for_each(|value| put(&source, value)));
        let mut seen = 0;
        let mut found = all(&ring, &mut seen);
        writer.join().unwrap();
        found.extend(all(&ring, &mut seen));
        assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{found:?}");
        assert_eq!(found.last(), Some(&3));
    });
}

#[test]
fn model_sealed_a_queue_loses_nothing_gives_nothing_twice_and_never_holds_more_than_its_depth() {
    explore(|| {
        let ring = ring(2);
        let index = Index(Heap::new(128));
        index.tell(0, 0);
        let (source, seen_by_source) = (same(&ring), Index(index.0.clone()));
        let sender = thread::spawn(move || {
            let mut sent = Vec::new();
            for value in 1..=3 {
                if seen_by_source.waiting(source.newest()) == Some(0) {
                    put(&source, value);
                    sent.push(value);
                }
            }
            sent
        });
        let (mut seen, mut copy, mut found) = (0, Copy::new(16), Vec::new());
        let mut take = |found: &mut Vec<u64>| {
            match ring.take(&mut seen, 1, &mut copy) {
                Found::Message => found.push(value(&copy)),
                Found::Nothing => {}
                Found::Damaged => panic!("nothing is damaged"),
            }
            index.tell(0, seen);
        };
        (0..2).for_each(|_| take(&mut found));
        let sent = sender.join().unwrap();
        (0..2).for_each(|_| take(&mut found));
        assert_eq!(found, sent);
    });
}

/// A writer that is killed when it has done the first `steps` of a message's steps, and its successor.
fn killed_after(steps: usize) {
    explore(move || {
        let ring = ring(2);
        put(&ring, 1);
        let source = same(&ring);
        let writers = thread::spawn(move || {
            let number = source.begin();
            let slot = source.slot(number);
            let words = [(MESSAGE, 77), (MESSAGE + 1, 77), (SOURCE_NS, 77), (SEQUENCE, 77), (LENGTH, 16)];
            for (word, content) in words.into_iter().take(steps) {
                slot[word].store(content, Ordering::Relaxed);
            }
            if steps > words.len() {
                slot[NUMBER].store(whole(number), Ordering::Release);
            }
            put(&source, 2);
        });
        let mut seen = 0;
        let mut found: Vec<u64> = (0..2).filter_map(|_| latest(&ring, &mut seen)).collect();
        writers.join().unwrap();
        found.extend(latest(&ring, &mut seen));
        assert_eq!(found.first().filter(|first| **first > 2), None);
        assert_eq!(found.last(), Some(&2), "{found:?}");
    });
}

#[test]
fn model_sealed_a_message_that_a_killed_writer_left_half_written_is_seen_by_nobody() {
    (0..=6).for_each(killed_after);
}
