//! A message's own copy: what stands in memory that another process writes is read once, into memory that it can not reach.

use std::cell::RefCell;
use std::rc::Rc;

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use super::sync::{AtomicU64, Ordering};
use crate::Stamp;

/// Copies that one port needs at a time without asking for memory: the one that is held, and the one that replaces it.
const AT_A_TIME: usize = 2;

/// Two words, aligned as every message may be.
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(16))]
struct Pair([u64; 2]);

/// Room for one message.
pub(crate) struct Copy {
    room: Box<[Pair]>,
    bytes: usize,
    pub(super) stamp: Stamp,
}

impl Copy {
    /// For a message of so many bytes at most.
    pub(crate) fn new(most: usize) -> Self {
        let room = vec![Pair::new_zeroed(); most.div_ceil(size_of::<Pair>())];
        Self { room: room.into_boxed_slice(), bytes: 0, stamp: Stamp::default() }
    }

    /// Takes over the first `bytes` bytes of `words`, of as many as there is room for.
    pub(super) fn take(&mut self, words: &[AtomicU64], bytes: usize) {
        self.bytes = bytes.min(size_of_val(&*self.room));
        let count = self.bytes.div_ceil(size_of::<u64>());
        let Ok(room) = <[u64]>::mut_from_bytes(self.room.as_mut_bytes()) else { return };
        for (place, word) in room[..count].iter_mut().zip(words) {
            *place = word.load(Ordering::Relaxed);
        }
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.room.as_bytes()[..self.bytes]
    }
}

/// The copies of one port that nobody holds.
pub(crate) struct Spare {
    most: usize,
    free: RefCell<Vec<Copy>>,
}

impl Spare {
    pub(super) fn new(most: usize) -> Rc<Self> {
        let free = (0..AT_A_TIME).map(|_| Copy::new(most)).collect();
        Rc::new(Self { most, free: RefCell::new(free) })
    }

    pub(super) fn lend(self: &Rc<Self>) -> Copied {
        let copy = self.free.borrow_mut().pop().unwrap_or_else(|| Copy::new(self.most));
        Copied { copy: Some(copy), home: self.clone() }
    }
}

/// A message out of a sealed channel.
pub(crate) struct Copied {
    /// Always there until it is given back.
    copy: Option<Copy>,
    home: Rc<Spare>,
}

impl Copied {
    pub(crate) fn bytes(&self) -> &[u8] {
        self.copy.as_ref().map_or(&[], Copy::bytes)
    }

    pub(crate) fn stamp(&self) -> Stamp {
        self.copy.as_ref().map_or_else(Stamp::default, |copy| copy.stamp)
    }

    pub(super) fn room(&mut self) -> &mut Copy {
        self.copy.get_or_insert_with(|| Copy::new(self.home.most))
    }
}

impl Drop for Copied {
    fn drop(&mut self) {
        self.home.free.borrow_mut().extend(self.copy.take());
    }
}
