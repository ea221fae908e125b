//! Sealed channels: memory that its writer alone can write, so that nobody else is harmed by what is written there.
//!
//! The executive makes the memory and hands each end what it may do with it: the source a descriptor for reading and writing of its
//! [`ring`], everybody else one for reading; a queue's destination the same of its [`index`]. Whoever reads copies a message first and
//! judges the copy. Nothing of this asks for another process' help, so nobody waits, and nothing is left by one that was killed.

use std::cell::Cell;
use std::os::fd::OwnedFd;
use std::rc::Rc;

use bateleur_contract::sealed::{INDEX_BYTES, RingShape};

use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::Errno;

use crate::ends::{Refusal, Unreceived};
use crate::{ChannelError, ChannelType, Stamp};

mod copy;
mod index;
mod memory;
mod ring;
mod sync;

pub(crate) use copy::Copied;
use copy::Spare;
use index::Index;
use memory::{Memory, MemoryError};
use ring::{Found, Ring};

/// The memory of a sealed channel, as a process was handed it.
#[derive(Debug)]
pub struct Handed {
    /// The source's; for the source's own process a descriptor for writing too.
    pub ring: OwnedFd,
    /// A queue's: the destination's; for that one's process a descriptor for writing too. An observer has none.
    pub index: Option<OwnedFd>,
    /// Messages carry a checksum.
    pub checked: bool,
    /// The process' number among those of its partition.
    pub incarnation: u32,
}

impl Handed {
    /// Memory for a channel whose ends all are in this process or are handed it by this one: for tests and measurements. A module's is
    /// made by its executive.
    ///
    /// # Errors
    /// The machine has no memory to give.
    pub fn alone(kind: &ChannelType, checked: bool) -> Result<Self, ChannelError> {
        let refused =
            |error: Errno| ChannelError::Create { channel: kind.name.clone(), reason: error.to_string() };
        let memory = |bytes: usize| {
            let memory = memfd_create(&kind.name, MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
            ftruncate(&memory, bytes as u64)?;
            fcntl_add_seals(&memory, SealFlags::SHRINK | SealFlags::GROW)?;
            Ok(memory)
        };
        let ring = memory(RingShape::new(kind.size, kind.depth).bytes()).map_err(refused)?;
        let index = kind.depth.map(|_| memory(INDEX_BYTES)).transpose().map_err(refused)?;
        Ok(Self { ring, index, checked, incarnation: 0 })
    }

    /// The same for another incarnation.
    ///
    /// # Errors
    /// The process has no descriptor left.
    pub fn again(&self, incarnation: u32) -> std::io::Result<Self> {
        let index = self.index.as_ref().map(OwnedFd::try_clone).transpose()?;
        Ok(Self { ring: self.ring.try_clone()?, index, checked: self.checked, incarnation })
    }

    fn ring(&self, kind: &ChannelType, writes: bool) -> Result<Ring<Memory>, ChannelError> {
        let shape = RingShape::new(kind.size, kind.depth);
        let map = if writes { Memory::writable } else { Memory::readable };
        let memory = map(&self.ring, shape.bytes()).map_err(|error| unusable(kind, &error))?;
        Ok(Ring::new(memory, shape, self.checked))
    }

    fn index(&self, kind: &ChannelType, writes: bool) -> Result<Option<Index<Memory>>, ChannelError> {
        let map = |index| {
            if writes { Memory::writable(index, INDEX_BYTES) } else { Memory::readable(index, INDEX_BYTES) }
        };
        let memory = self.index.as_ref().map(map).transpose().map_err(|error| unusable(kind, &error))?;
        Ok(memory.map(Index))
    }

    /// The source's end.
    pub(crate) fn writer(&self, kind: &ChannelType) -> Result<Writer, ChannelError> {
        let queue = self.index(kind, false)?.zip(kind.depth.map(|depth| depth as u64));
        Ok(Writer { ring: self.ring(kind, true)?, queue })
    }

    /// A destination's end. It begins with what its source writes next; one of the module's beginning also with what was written before.
    pub(crate) fn reader(&self, kind: &ChannelType) -> Result<Reader, ChannelError> {
        let ring = self.ring(kind, false)?;
        let (index, newest) = (self.index(kind, true)?, ring.newest());
        let (way, seen) = match (index, kind.depth) {
            (Some(index), Some(depth)) => {
                index.tell(self.incarnation, newest);
                (Way::Queue { index, depth: depth as u64, incarnation: self.incarnation }, newest)
            }
            _ => (Way::Latest, if self.incarnation == 0 { 0 } else { newest }),
        };
        Ok(Reader { ring, way, seen: Cell::new(seen), spare: Spare::new(kind.size) })
    }

    /// The end of somebody who looks at every message, from the next one on.
    pub(crate) fn observer(&self, kind: &ChannelType) -> Result<Reader, ChannelError> {
        let ring = self.ring(kind, false)?;
        let seen = Cell::new(ring.newest());
        Ok(Reader { ring, way: Way::Each, seen, spare: Spare::new(kind.size) })
    }
}

fn unusable(kind: &ChannelType, error: &MemoryError) -> ChannelError {
    ChannelError::Attach {
        channel: kind.name.clone(),
        reason: format!("its memory can not be used: {error}"),
    }
}

/// A source's end.
pub(crate) struct Writer {
    ring: Ring<Memory>,
    /// A queue's: what its destination says, and its length.
    queue: Option<(Index<Memory>, u64)>,
}

impl Writer {
    /// Adds a message; gives 1, or 0 where nobody receives.
    pub(crate) fn put(&self, bytes: &[u8], stamp: Stamp) -> Result<usize, Refusal> {
        let receivers = self.room_for(bytes.len())?;
        if receivers > 0 {
            self.ring.put(bytes, stamp);
        }
        Ok(receivers)
    }

    /// As above, by lending its place to `fill`.
    pub(crate) fn put_in_place(
        &self,
        bytes: usize,
        stamp: Stamp,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<usize, Refusal> {
        let receivers = self.room_for(bytes)?;
        if receivers > 0 && !self.ring.put_in_place(bytes, stamp, fill) {
            return Err(Refusal::Other("no place in the channel's memory".into()));
        }
        Ok(receivers)
    }

    fn room_for(&self, bytes: usize) -> Result<usize, Refusal> {
        if !self.ring.holds(bytes) {
            return Err(Refusal::Other(format!("{bytes} bytes are more than the channel carries")));
        }
        let Some((index, depth)) = &self.queue else { return Ok(1) };
        match index.waiting(self.ring.newest()) {
            None => Ok(0),
            // More than fit: what the destination says is damaged, or what this memory says. Either is mended by its next look.
            Some(waiting) if waiting >= *depth => Err(Refusal::Full),
            Some(_) => Ok(1),
        }
    }
}

/// How a reader goes through a ring.
enum Way {
    /// From newest to newest.
    Latest,
    /// From each to the next.
    Each,
    /// As one for whom the source waits.
    Queue { index: Index<Memory>, depth: u64, incarnation: u32 },
}

/// A destination's or an observer's end.
pub(crate) struct Reader {
    ring: Ring<Memory>,
    way: Way,
    /// The number of the last message that was seen.
    seen: Cell<u64>,
    spare: Rc<Spare>,
}

impl Reader {
    pub(crate) fn receive(&self) -> Result<Option<Copied>, Unreceived> {
        let mut seen = self.seen.get();
        if self.ring.newest() == seen && !matches!(self.way, Way::Queue { .. }) {
            return Ok(None);
        }
        let mut copied = self.spare.lend();
        let found = match &self.way {
            Way::Latest => self.ring.latest(&mut seen, copied.room()),
            Way::Each => self.ring.next(&mut seen, copied.room()),
            Way::Queue { index, depth, incarnation } => {
                let found = self.ring.take(&mut seen, *depth, copied.room());
                index.tell(*incarnation, seen);
                found
            }
        };
        self.seen.set(seen);
        match found {
            Found::Nothing => Ok(None),
            Found::Message => Ok(Some(copied)),
            Found::Damaged => Err(Unreceived::Damaged),
        }
    }

    pub(crate) fn has_messages(&self) -> bool {
        self.ring.newest() != self.seen.get()
    }

    /// Messages of a queue that wait; `None`: it is none.
    pub(crate) fn waiting(&self) -> Option<usize> {
        let Way::Queue { depth, .. } = &self.way else { return None };
        // What the source says may be anything.
        let waiting = self.ring.newest().wrapping_sub(self.seen.get()).min(*depth);
        usize::try_from(waiting).ok()
    }
}
