//! A logbook (ARINC 653 part 2): memory in which a partition leaves messages, which the executive copies to a store that outlives both.
//!
//! Neither side waits for the other. Messages are numbered from 1 on. The partition writes one into the place of its number and marks it
//! whole; the executive copies the oldest one that is not stored, and then says so. The executive believes nothing that it finds here:
//! numbers and lengths are bounded by the plan, and what the partition spoils is its own logbook.

use std::ops::Deref;

use serde::{Deserialize, Serialize};

use crate::sync::Ordering::{Acquire, Relaxed, Release, SeqCst};
use crate::sync::{AtomicU64, fence};

/// The newest message that was begun. The partition's, as `CLEARED` is.
const NEWEST: usize = 0;
/// The last one that exists no longer.
const CLEARED: usize = 1;
/// The last one that is in the store. The executive's, as `CLAIMED` is.
const STORED: usize = 2;
/// The one that is on its way there: it can not be replaced.
const CLAIMED: usize = 3;
/// Where the places of messages begin.
const PLACES: usize = 4;
/// In the state of a place, below its number.
const STATE_BITS: u32 = 2;
/// Bytes of a word.
const WORD: usize = 8;
/// More than [`Logbook::overwrite`] ever needs, unless something else writes over the memory.
const TRIES: usize = 4;

/// How much a logbook holds. All above 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogbookSizes {
    /// MAX_MESSAGE_SIZE: bytes of a message.
    pub message: u32,
    /// MAX_NB_LOGGED_MESSAGES: messages that are kept.
    pub logged: u32,
    /// MAX_NB_IN_PROGRESS_MESSAGES: messages on their way to the store.
    pub in_progress: u32,
}

impl LogbookSizes {
    /// Words of a place: state, length, content.
    fn place(self) -> usize {
        2 + (self.message as usize).div_ceil(WORD)
    }

    /// Places for messages: for those that are kept, and for those that are on their way while they are.
    #[must_use]
    pub fn places(self) -> usize {
        self.logged as usize + self.in_progress as usize
    }

    /// Bytes of the memory.
    #[must_use]
    pub fn bytes(self) -> u64 {
        ((PLACES + self.places() * self.place()) * WORD) as u64
    }
}

/// What has become of a message (WRITE_STATUS).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WriteStatus {
    /// It was not written to its end, and has no content.
    Aborted,
    /// It is on its way to the store.
    InProgress,
    /// It is stored.
    Complete,
}

/// How many messages a logbook has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogbookCounts {
    /// Those that are stored.
    pub logged: u32,
    /// Those on their way.
    pub in_progress: u32,
    /// Those of both that were aborted.
    pub aborted: u32,
}

/// As many messages are on their way as may be, or one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("messages are on their way to the store")]
pub struct Busy;

/// The state of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Begun = 0,
    Whole = 1,
    Aborted = 2,
}

fn state(number: u64, state: State) -> u64 {
    number << STATE_BITS | state as u64
}

/// The memory of a logbook. One thread at a time uses it on each side.
#[derive(Debug, Clone)]
pub struct Logbook<M> {
    memory: M,
    sizes: LogbookSizes,
}

impl<M: Deref<Target = [AtomicU64]>> Logbook<M> {
    /// Over memory that has as many bytes as its sizes say; `None`: it has fewer.
    pub fn over(memory: M, sizes: LogbookSizes) -> Option<Self> {
        (memory.len() as u64 * WORD as u64 >= sizes.bytes()).then_some(Self { memory, sizes })
    }

    /// What it holds at most.
    #[must_use]
    pub fn sizes(&self) -> LogbookSizes {
        self.sizes
    }

    fn word(&self, at: usize) -> &AtomicU64 {
        &self.memory[at]
    }

    /// The words of the place of a message.
    fn place(&self, number: u64) -> &[AtomicU64] {
        let (place, words) = ((number % self.sizes.places() as u64) as usize, self.sizes.place());
        &self.memory[PLACES + place * words..][..words]
    }

    fn put(&self, number: u64, bytes: &[u8]) {
        let [state_word, length, content @ ..] = self.place(number) else { return };
        length.store(bytes.len() as u64, Relaxed);
        for (word, bytes) in content.iter().zip(bytes.chunks(WORD)) {
            let mut whole = [0; WORD];
            whole[..bytes.len()].copy_from_slice(bytes);
            word.store(u64::from_le_bytes(whole), Relaxed);
        }
        state_word.store(state(number, State::Whole), Release);
    }

    /// Its content; what is there instead where that was spoiled.
    fn copy(&self, number: u64, into: &mut Vec<u8>) {
        into.clear();
        let [_, length, content @ ..] = self.place(number) else { return };
        let length = (length.load(Relaxed) as usize).min(self.sizes.message as usize);
        content
            .iter()
            .take(length.div_ceil(WORD))
            .for_each(|word| into.extend(word.load(Relaxed).to_le_bytes()));
        into.truncate(length);
    }

    fn is(&self, number: u64, wanted: State) -> bool {
        self.place(number)[0].load(Acquire) == state(number, wanted)
    }

    /// Messages that were begun and are not stored.
    fn under_way(&self) -> u64 {
        self.word(NEWEST).load(Acquire).saturating_sub(self.word(STORED).load(Acquire))
    }

    /// How many of the newest messages can be read.
    fn there(&self) -> u64 {
        let since = self.word(NEWEST).load(Acquire).saturating_sub(self.word(CLEARED).load(Relaxed));
        since.min(u64::from(self.sizes.logged))
    }

    // The partition's side.

    /// Whoever wrote before has died: what he had not written to its end is aborted.
    pub fn abort_unfinished(&self) {
        let newest = self.word(NEWEST).load(Acquire);
        let stored = self.word(STORED).load(Acquire);
        for number in newest.saturating_sub(self.sizes.in_progress.into()).max(1)..=newest {
            if self.is(number, State::Begun) {
                // One that is stored was to be replaced, and had not been touched.
                let found = if number <= stored { State::Whole } else { State::Aborted };
                self.place(number)[0].store(state(number, found), Release);
            }
        }
    }

    /// Adds a message of at most [`LogbookSizes::message`] bytes.
    ///
    /// # Errors
    /// As many are on their way as may be.
    pub fn write(&self, message: &[u8]) -> Result<(), Busy> {
        if self.under_way() >= self.sizes.in_progress.into() {
            return Err(Busy);
        }
        let number = self.word(NEWEST).load(Relaxed).wrapping_add(1);
        self.place(number)[0].store(state(number, State::Begun), Relaxed);
        self.word(NEWEST).store(number, Release);
        self.put(number, message);
        Ok(())
    }

    /// Adds a message, or puts it in the place of the newest one where as many are on their way as may be. Needs room for two: the
    /// executive claims all but one at most.
    ///
    /// # Errors
    /// There is room for one only.
    pub fn overwrite(&self, message: &[u8]) -> Result<(), Busy> {
        // Where the newest one is claimed, others have been stored meanwhile, and there is room.
        for _ in 0..TRIES {
            if self.write(message).is_ok() {
                return Ok(());
            }
            if self.sizes.in_progress < 2 {
                break;
            }
            let number = self.word(NEWEST).load(Relaxed);
            let place = &self.place(number)[0];
            let before = place.load(Relaxed);
            // Either the executive sees that it is begun, or this side that it is claimed.
            place.store(state(number, State::Begun), Relaxed);
            fence(SeqCst);
            if self.word(CLAIMED).load(Acquire) < number {
                self.put(number, message);
                return Ok(());
            }
            place.store(before, Release);
        }
        Err(Busy)
    }

    /// Reads a message; 0 is the newest one. `None`: there are not so many.
    pub fn read(&self, entry: u32, into: &mut Vec<u8>) -> Option<WriteStatus> {
        into.clear();
        if u64::from(entry) >= self.there() {
            return None;
        }
        let number = self.word(NEWEST).load(Relaxed) - u64::from(entry);
        if self.is(number, State::Aborted) {
            return Some(WriteStatus::Aborted);
        }
        self.copy(number, into);
        let is_stored = number <= self.word(STORED).load(Acquire);
        Some(if is_stored { WriteStatus::Complete } else { WriteStatus::InProgress })
    }

    /// Removes all messages.
    ///
    /// # Errors
    /// One is on its way.
    pub fn clear(&self) -> Result<(), Busy> {
        if self.under_way() > 0 {
            return Err(Busy);
        }
        self.word(CLEARED).store(self.word(NEWEST).load(Relaxed), Release);
        Ok(())
    }

    /// How many messages there are.
    #[must_use]
    pub fn counts(&self) -> LogbookCounts {
        let (there, under_way) = (self.there(), self.under_way().min(self.sizes.in_progress.into()));
        let newest = self.word(NEWEST).load(Relaxed);
        let is_aborted = |entry: &u64| self.is(newest.saturating_sub(*entry), State::Aborted);
        LogbookCounts {
            logged: there.saturating_sub(under_way) as u32,
            in_progress: under_way as u32,
            aborted: (0..there).filter(is_aborted).count() as u32,
        }
    }

    // The executive's side.

    /// Removes everything, before the partition begins.
    pub fn begin(&self) {
        self.memory.iter().for_each(|word| word.store(0, Relaxed));
    }

    /// Puts in a message of the store, before the partition begins. In the order of their numbers.
    pub fn put_stored(&self, number: u64, content: Option<&[u8]>) {
        match content {
            Some(bytes) => self.put(number, bytes),
            None => self.place(number)[0].store(state(number, State::Aborted), Release),
        }
        self.word(NEWEST).store(number, Release);
        self.word(STORED).store(number, Release);
    }

    /// The newest message that was begun.
    #[must_use]
    pub fn newest(&self) -> u64 {
        self.word(NEWEST).load(Acquire)
    }

    /// How many messages may be claimed before [`Logbook::set_stored`] says that they are stored.
    #[must_use]
    pub fn most_claimed(&self) -> u64 {
        u64::from(self.sizes.in_progress.saturating_sub(1).max(1))
    }

    /// All messages up to this one are in the store, or were removed.
    pub fn set_stored(&self, number: u64) {
        self.word(STORED).store(number, Release);
    }

    /// Messages up to this one were removed.
    #[must_use]
    pub fn cleared(&self) -> u64 {
        self.word(CLEARED).load(Acquire)
    }

    /// Says so, before the partition begins.
    pub fn set_cleared(&self, number: u64) {
        self.word(CLEARED).store(number, Release);
    }

    /// Claims the message behind `stored`, the last one that was claimed before or is stored, and copies it. True: it is whole, false: it
    /// was aborted, `None`: it is not there, or not yet written to its end.
    pub fn claim(&self, stored: u64, into: &mut Vec<u8>) -> Option<bool> {
        let number = stored.wrapping_add(1);
        if self.word(NEWEST).load(Acquire) < number {
            return None;
        }
        self.word(CLAIMED).store(number, Release);
        fence(SeqCst);
        let found = self.place(number)[0].load(Acquire);
        if found == state(number, State::Aborted) {
            into.clear();
            return Some(false);
        }
        (found == state(number, State::Whole)).then(|| {
            self.copy(number, into);
            true
        })
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    type Book = Logbook<Arc<[AtomicU64]>>;

    fn book(message: u32, logged: u32, in_progress: u32) -> Book {
        let sizes = LogbookSizes { message, logged, in_progress };
        let memory = (0..sizes.bytes() / 8).map(|_| AtomicU64::new(0)).collect();
        Logbook::over(memory, sizes).unwrap()
    }

    /// Stores as much as it can; the messages, in their order.
    fn store(book: &Book, stored: &mut u64) -> Vec<Option<Vec<u8>>> {
        let (mut found, mut bytes) = (Vec::new(), Vec::new());
        while let Some(whole) = book.claim(*stored, &mut bytes) {
            found.push(whole.then(|| bytes.clone()));
            *stored += 1;
            book.set_stored(*stored);
        }
        found
    }

    fn read(book: &Book, entry: u32) -> Option<(WriteStatus, Vec<u8>)> {
        let mut bytes = vec![9];
        book.read(entry, &mut bytes).map(|status| (status, bytes))
    }

    #[test]
    fn memory_that_is_too_small_is_refused() {
        let sizes = LogbookSizes { message: 9, logged: 2, in_progress: 1 };
        let words = |words: u64| (0..words).map(|_| AtomicU64::new(0)).collect::<Arc<[AtomicU64]>>();
        assert_eq!(sizes.bytes(), 8 * (4 + 3 * 4));
        assert!(Logbook::over(words(16), sizes).is_some() && Logbook::over(words(15), sizes).is_none());
    }

    #[test]
    fn log_write_04_messages_are_stored_in_their_order_and_the_oldest_makes_room() {
        let (book, mut stored) = (book(20, 3, 2), 0);
        for first in (0..20_u8).step_by(2) {
            let messages: Vec<Vec<u8>> =
                (first..first + 2).map(|length| vec![length; length.into()]).collect();
            messages.iter().for_each(|message| book.write(message).unwrap());
            assert_eq!(book.write(b"x"), Err(Busy));
            assert_eq!(read(&book, 0), Some((WriteStatus::InProgress, messages[1].clone())));
            let all: Vec<_> = messages.iter().cloned().map(Some).collect();
            assert_eq!(store(&book, &mut stored), all);
            assert_eq!(read(&book, 1), Some((WriteStatus::Complete, messages[0].clone())));
        }
        assert_eq!(read(&book, 2), Some((WriteStatus::Complete, vec![17; 17])));
        assert_eq!(read(&book, 3), None, "three are kept");
        assert_eq!(book.counts(), LogbookCounts { logged: 3, in_progress: 0, aborted: 0 });
    }

    #[test]
    fn bug_05_message_that_replaces_the_newest_one_leaves_the_others_and_never_the_one_that_is_claimed() {
        let (book, mut stored, mut bytes) = (book(8, 4, 2), 0, Vec::new());
        for message in [b"a", b"b", b"c"] {
            book.overwrite(message).unwrap();
        }
        assert_eq!(book.claim(0, &mut bytes), Some(true));
        book.overwrite(b"d").unwrap();
        assert_eq!(store(&book, &mut stored), [Some(b"a".to_vec()), Some(b"d".to_vec())]);
        let one = self::book(8, 4, 1);
        one.write(b"a").unwrap();
        assert_eq!(one.overwrite(b"b"), Err(Busy));
    }

    #[test]
    fn log_read_05_message_of_a_writer_that_died_within_it_is_aborted_and_the_others_are_whole() {
        let (book, mut stored) = (book(8, 4, 3), 0);
        book.write(b"a").unwrap();
        // Dies behind its first step.
        book.place(2)[0].store(state(2, State::Begun), Relaxed);
        book.word(NEWEST).store(2, Release);
        assert_eq!(store(&book, &mut stored), [Some(b"a".to_vec())]);
        book.abort_unfinished();
        book.write(b"c").unwrap();
        assert_eq!(book.counts(), LogbookCounts { logged: 1, in_progress: 2, aborted: 1 });
        assert_eq!(store(&book, &mut stored), [None, Some(b"c".to_vec())]);
        let all: Vec<_> = (0..3).filter_map(|entry| read(&book, entry)).collect();
        assert_eq!(all[0], (WriteStatus::Complete, b"c".to_vec()));
        assert_eq!(all[1], (WriteStatus::Aborted, vec![]));
        assert_eq!(all[2], (WriteStatus::Complete, b"a".to_vec()));
    }

    #[test]
    fn cleared_messages_are_gone_and_numbers_go_on() {
        let (book, mut stored) = (book(8, 4, 2), 0);
        book.write(b"a").unwrap();
        assert_eq!(book.clear(), Err(Busy));
        store(&book, &mut stored);
        assert_eq!((book.clear(), read(&book, 0), book.cleared()), (Ok(()), None, 1));
        book.write(b"b").unwrap();
        assert_eq!((read(&book, 1), store(&book, &mut stored)), (None, vec![Some(b"b".to_vec())]));
    }

    #[test]
    fn message_can_be_replaced_while_all_that_may_be_claimed_is_being_stored() {
        for in_progress in 2..5 {
            let (book, mut bytes) = (book(8, 4, in_progress), Vec::new());
            for number in 0..in_progress {
                book.write(&[number as u8]).unwrap();
            }
            for claimed in 0..book.most_claimed() {
                assert_eq!(book.claim(claimed, &mut bytes), Some(true));
                assert_eq!(book.overwrite(b"new"), Ok(()), "{claimed} of {in_progress}");
            }
        }
    }

    #[test]
    fn stored_message_whose_writer_died_before_it_replaced_it_is_whole() {
        let (book, mut stored) = (book(8, 4, 2), 0);
        book.write(b"a").unwrap();
        store(&book, &mut stored);
        book.place(1)[0].store(state(1, State::Begun), Relaxed);
        book.abort_unfinished();
        assert_eq!(read(&book, 0), Some((WriteStatus::Complete, b"a".to_vec())));
    }

    /// Whatever a partition writes over its logbook, each side comes back.
    #[test]
    fn any_words_in_the_memory_are_read_without_a_panic() {
        let (book, mut random) = (book(12, 5, 3), 1_u64);
        let mut next = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let short = random >> 60;
            if random & 1 == 0 { short } else { random.wrapping_neg() >> (random >> 58) }
        };
        let mut bytes = Vec::new();
        for _ in 0..20_000 {
            for word in &*book.memory {
                word.store(next(), Relaxed);
            }
            let stored = next();
            let _ = book.claim(stored, &mut bytes);
            assert!(bytes.len() <= 12);
            (0..6).for_each(|entry| {
                let _ = book.read(entry, &mut bytes);
            });
            assert!(bytes.len() <= 12 && book.counts().logged <= 5);
            let _ = (book.clear(), book.overwrite(b"x"), book.write(b"y"));
            book.abort_unfinished();
        }
    }
}

#[cfg(feature = "model")]
#[cfg(test)]
mod model {
    use loom::sync::Arc;
    use loom::thread;

    use super::*;
    use crate::sync::explore;

    struct Words(Vec<AtomicU64>);

    impl Deref for Words {
        type Target = [AtomicU64];

        fn deref(&self) -> &[AtomicU64] {
            &self.0
        }
    }

    struct Shared(Arc<Words>);

    impl Deref for Shared {
        type Target = [AtomicU64];

        fn deref(&self) -> &[AtomicU64] {
            &self.0
        }
    }

    #[test]
    fn model_logbook_what_replaces_a_message_and_what_stores_it_never_meet() {
        explore(|| {
            let sizes = LogbookSizes { message: 16, logged: 1, in_progress: 2 };
            let words = Arc::new(Words((0..sizes.bytes() / 8).map(|_| AtomicU64::new(0)).collect()));
            let [writer, store] =
                [words.clone(), words].map(|words| Logbook::over(Shared(words), sizes).unwrap());
            writer.write(&[1; 16]).unwrap();
            writer.write(&[2; 16]).unwrap();
            let storing = thread::spawn(move || {
                let (mut stored, mut found, mut bytes) = (0, Vec::new(), Vec::new());
                for _ in 0..2 {
                    let before = stored;
                    while stored < before + store.most_claimed()
                        && store.claim(stored, &mut bytes) == Some(true)
                    {
                        assert!(bytes.iter().all(|byte| *byte == bytes[0]), "torn: {bytes:?}");
                        found.push(bytes[0]);
                        stored += 1;
                    }
                    store.set_stored(stored);
                }
                (store, stored, found)
            });
            writer.overwrite(&[3; 16]).unwrap();
            let (store, mut stored, mut found) = storing.join().unwrap();
            let mut bytes = Vec::new();
            while store.claim(stored, &mut bytes) == Some(true) {
                found.push(bytes[0]);
                stored += 1;
            }
            assert!(matches!(found[..], [1, 3] | [1, 2, 3]), "{found:?}");
        });
    }
}
