//! A ring of messages that one process writes and any number read, none of whom the writer can harm.
//!
//! Message `n` stands in slot `n % slots`, under a number that says that it is there and whole. A writer that is killed leaves a slot
//! that is marked as being written, and behind it nothing: its successor writes the same message number there. Nothing that is read
//! here is believed: a number only says which slot to look at, a length is held against the plan's, and every look is one of a bounded
//! count. What a writer can gain by writing nonsense is that nobody hears it.

use bateleur_contract::sealed::{LINE, RingShape, SLOT_HEAD, WORD};
use zerocopy::IntoBytes;

use super::copy::Copy;
use super::memory::{Memory, Words};
use super::sync::{AtomicU64, Ordering, fence};
use crate::Stamp;

/// The word with the number of the last message.
const NEWEST: usize = 0;
/// Words of a slot: see [`whole`] and [`being_written`]; the stamp; the length, with the checksum above it; then the message.
const NUMBER: usize = 0;
const SOURCE_NS: usize = 1;
const SEQUENCE: usize = 2;
const LENGTH: usize = 3;
const MESSAGE: usize = SLOT_HEAD / WORD;
/// A read that finds its message written over looks at the one that is newest then, so often at most.
const LOOKS: usize = 4;

/// What a look has found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Found {
    /// Nothing that was not seen before.
    Nothing,
    /// A message, which was copied.
    Message,
    /// What stands there is no message: its length or its checksum is wrong, or the numbers are.
    Damaged,
}

/// Why a message could not be copied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Missed {
    /// Another one stands there, or is being written.
    Gone,
    /// It is no message.
    Damaged,
}

/// See the module's head.
pub(crate) struct Ring<M> {
    memory: M,
    shape: RingShape,
    /// Messages carry a checksum.
    checked: bool,
}

/// A slot's number where message `number` stands whole.
fn whole(number: u64) -> u64 {
    number.wrapping_mul(2)
}

/// The same while it is being written.
fn being_written(number: u64) -> u64 {
    whole(number).wrapping_sub(1)
}

impl<M: Words> Ring<M> {
    /// On memory that has the shape's bytes.
    pub(crate) fn new(memory: M, shape: RingShape, checked: bool) -> Self {
        Self { memory, shape, checked }
    }

    /// The number of the last message; 0: there was none.
    pub(crate) fn newest(&self) -> u64 {
        self.memory.words()[NEWEST].load(Ordering::Acquire)
    }

    /// Where the slot of a message begins, bytes. No number leads out of the memory.
    fn place(&self, number: u64) -> usize {
        LINE + (number % self.shape.slots as u64) as usize * self.shape.slot_bytes()
    }

    fn slot(&self, number: u64) -> &[AtomicU64] {
        let begin = self.place(number) / WORD;
        &self.memory.words()[begin..begin + self.shape.slot_bytes() / WORD]
    }

    /// Whether a message of so many bytes can stand here.
    pub(crate) fn holds(&self, bytes: usize) -> bool {
        bytes <= self.shape.message_bytes
    }

    /// Marks the next message's slot as being written; gives its number.
    fn begin(&self) -> u64 {
        let number = self.newest().wrapping_add(1);
        self.slot(number)[NUMBER].store(being_written(number), Ordering::Relaxed);
        // Whoever reads one of the words that follow finds the mark when it looks again.
        fence(Ordering::Release);
        number
    }

    /// The message stands: its head, and its number last.
    fn finish(&self, number: u64, stamp: Stamp, bytes: usize, checksum: u32) {
        let slot = self.slot(number);
        slot[SOURCE_NS].store(stamp.source_ns, Ordering::Relaxed);
        slot[SEQUENCE].store(stamp.sequence, Ordering::Relaxed);
        slot[LENGTH].store(bytes as u64 | u64::from(checksum) << 32, Ordering::Relaxed);
        slot[NUMBER].store(whole(number), Ordering::Release);
        self.memory.words()[NEWEST].store(number, Ordering::Release);
    }

    fn write_words(&self, number: u64, bytes: &[u8]) {
        for (word, piece) in self.slot(number)[MESSAGE..].iter().zip(bytes.chunks(WORD)) {
            let mut whole = [0; WORD];
            whole[..piece.len()].copy_from_slice(piece);
            word.store(u64::from_ne_bytes(whole), Ordering::Relaxed);
        }
    }

    /// Adds a message, which the ring holds.
    pub(crate) fn put(&self, bytes: &[u8], stamp: Stamp) {
        let number = self.begin();
        self.write_words(number, bytes);
        self.finish(number, stamp, bytes.len(), self.checksum(number, stamp, bytes));
    }

    /// The newest message since `seen`, which is moved on, copied.
    pub(crate) fn latest(&self, seen: &mut u64, into: &mut Copy) -> Found {
        for _ in 0..LOOKS {
            let newest = self.newest();
            if newest == *seen {
                return Found::Nothing;
            }
            match self.copy(newest, into) {
                Ok(()) => {
                    *seen = newest;
                    return Found::Message;
                }
                Err(Missed::Damaged) => {
                    *seen = newest; // told once
                    return Found::Damaged;
                }
                Err(Missed::Gone) => {}
            }
        }
        Found::Nothing
    }

    /// The message after `seen`, which is moved on, copied. One that is more behind than the ring keeps loses the oldest.
    pub(crate) fn next(&self, seen: &mut u64, into: &mut Copy) -> Found {
        let kept = self.shape.slots as u64 - 1;
        for _ in 0..self.shape.slots {
            let newest = self.newest();
            let waiting = newest.wrapping_sub(*seen);
            if waiting == 0 {
                return Found::Nothing;
            }
            if waiting > kept {
                *seen = newest.wrapping_sub(kept);
            }
            *seen = seen.wrapping_add(1);
            match self.copy(*seen, into) {
                Ok(()) => return Found::Message,
                Err(Missed::Damaged) => return Found::Damaged,
                Err(Missed::Gone) => {}
            }
        }
        Found::Nothing
    }

    /// The message after `seen` of a queue in which `depth` wait at most, which none may be lost of.
    pub(crate) fn take(&self, seen: &mut u64, depth: u64, into: &mut Copy) -> Found {
        let newest = self.newest();
        match newest.wrapping_sub(*seen) {
            0 => return Found::Nothing,
            // No sender goes so far: its memory is damaged, and what comes next is taken.
            waiting if waiting > depth => {
                *seen = newest;
                return Found::Damaged;
            }
            _ => *seen = seen.wrapping_add(1),
        }
        match self.copy(*seen, into) {
            Ok(()) => Found::Message,
            Err(_) => Found::Damaged,
        }
    }

    fn copy(&self, number: u64, into: &mut Copy) -> Result<(), Missed> {
        let slot = self.slot(number);
        if slot[NUMBER].load(Ordering::Acquire) != whole(number) {
            return Err(Missed::Gone);
        }
        let head = [SOURCE_NS, SEQUENCE, LENGTH].map(|word| slot[word].load(Ordering::Relaxed));
        let [source_ns, sequence, length] = head;
        let (bytes, checksum) = (length as u32 as usize, (length >> 32) as u32);
        let fits = self.holds(bytes);
        into.stamp = Stamp { source_ns, sequence };
        into.take(&slot[MESSAGE..], if fits { bytes } else { 0 });
        // What was read above is not older than the number that is read now.
        fence(Ordering::Acquire);
        if slot[NUMBER].load(Ordering::Relaxed) != whole(number) {
            return Err(Missed::Gone);
        }
        let sound = fits && checksum == self.checksum(number, into.stamp, into.bytes());
        if sound { Ok(()) } else { Err(Missed::Damaged) }
    }

    /// Of a message with everything that says what it is; 0 where messages carry none.
    fn checksum(&self, number: u64, stamp: Stamp, bytes: &[u8]) -> u32 {
        if !self.checked {
            return 0;
        }
        let mut hasher = crc32fast::Hasher::new();
        hasher.update([number, stamp.source_ns, stamp.sequence, bytes.len() as u64].as_bytes());
        hasher.update(bytes);
        hasher.finalize()
    }
}

impl Ring<Memory> {
    /// Adds a message of so many bytes, which the ring holds, by lending its place to `fill`; it holds there what an earlier message left.
    pub(crate) fn put_in_place(&self, bytes: usize, stamp: Stamp, fill: impl FnOnce(&mut [u8])) -> bool {
        let number = self.begin();
        let lent = self.memory.lend(self.place(number) + SLOT_HEAD, bytes, |message| {
            fill(message);
            self.checksum(number, stamp, message)
        });
        lent.map(|checksum| self.finish(number, stamp, bytes, checksum)).is_some()
    }
}

#[cfg(all(test, not(feature = "model")))]
#[path = "ring_tests.rs"]
mod tests;

#[cfg(all(test, feature = "model"))]
#[path = "ring_model.rs"]
mod model;
