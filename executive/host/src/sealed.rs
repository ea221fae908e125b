//! The memories of sealed channels: made before frame 0, held to the end of the run, never looked into.
//!
//! Each is a file in memory without a name, of a fixed size. The source of a channel is handed its ring for reading and writing, everybody
//! else for reading alone; with a queue's index it is the other way round. A descriptor for reading is opened apart, and the file's mode
//! lets nobody but the executive's user open it once more: as root that is none of a partition's.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileExt;

use bateleur_contract::sealed::{INDEX_BYTES, MEMORY_NAME, RingShape, SealedDescriptors};
use bateleur_plan::{ChannelId, Isolation, Plan};
use rustix::fs::{
    FallocateFlags, MemfdFlags, Mode, OFlags, SealFlags, fallocate, fchmod, fcntl_add_seals, memfd_create,
    open,
};

/// Which end of a channel somebody has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It writes.
    Source,
    /// It reads, and takes messages out of a queue.
    Destination,
    /// It looks.
    Observer,
}

/// See the module's head; by the channels' names.
#[derive(Debug, Default)]
pub struct SealedChannels(BTreeMap<String, SealedChannel>);

#[derive(Debug)]
struct SealedChannel {
    ring: OwnedFd,
    index: Option<OwnedFd>,
    checked: bool,
}

/// Descriptors for a process that is about to be started, in the order of their numbers there.
#[derive(Debug)]
pub struct Handover {
    first: i32,
    files: Vec<OwnedFd>,
}

impl Handover {
    /// The first of them has this number.
    #[must_use]
    pub fn from(first: i32) -> Self {
        Self { first, files: Vec::new() }
    }

    /// The descriptors.
    pub fn files(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.files.iter().map(AsFd::as_fd)
    }

    /// Adds one; its number.
    pub(crate) fn add(&mut self, file: OwnedFd) -> i32 {
        self.files.push(file);
        self.first + self.files.len() as i32 - 1
    }
}

impl SealedChannels {
    /// Makes the memories of those of `channels` that are to be sealed.
    ///
    /// # Errors
    /// The machine has no memory or no descriptor left.
    pub fn make(plan: &Plan, channels: impl Iterator<Item = ChannelId>) -> io::Result<Self> {
        let sealed = channels.map(|id| &plan[id]).filter(|channel| channel.isolation.is_sealed());
        let made = sealed.map(|channel| {
            let name = plan.port_path(channel.source);
            let depth = plan.queue_depth(channel).map(|depth| depth as usize);
            let shape = RingShape::new(plan[channel.source].payload.max_size_bytes(), depth);
            let ring = memory(&name, shape.bytes())?;
            let index = depth.map(|_| memory(&name, INDEX_BYTES)).transpose()?;
            let checked = channel.isolation == Isolation::Checked;
            Ok((name, SealedChannel { ring, index, checked }))
        });
        made.collect::<io::Result<_>>().map(Self)
    }

    /// Whether the channel with this name is one of them.
    #[must_use]
    pub fn contains(&self, channel: &str) -> bool {
        self.0.contains_key(channel)
    }

    /// Adds to `handover` what somebody at an end of a channel is to have; gives its numbers, or `None` if the channel is not sealed.
    ///
    /// # Errors
    /// The executive has no descriptor left.
    pub fn hand(
        &self,
        channel: &str,
        end: End,
        handover: &mut Handover,
    ) -> io::Result<Option<SealedDescriptors>> {
        let Some(channel) = self.0.get(channel) else { return Ok(None) };
        let ring = match end {
            End::Source => channel.ring.try_clone()?,
            End::Destination | End::Observer => for_reading(&channel.ring)?,
        };
        let index = match (end, &channel.index) {
            (End::Observer, _) | (_, None) => None,
            (End::Source, Some(index)) => Some(for_reading(index)?),
            (End::Destination, Some(index)) => Some(index.try_clone()?),
        };
        Ok(Some(SealedDescriptors {
            ring: handover.add(ring),
            index: index.map(|index| handover.add(index)),
            checked: channel.checked,
        }))
    }

    /// The incarnation with this number, which was the destination of a queue, is dead: its source is told that nobody receives. One that
    /// has taken its place stays.
    ///
    /// # Errors
    /// The memory can not be written.
    pub fn detach(&self, channel: &str, incarnation: u32) -> io::Result<()> {
        let Some(index) = self.0.get(channel).and_then(|channel| channel.index.as_ref()) else {
            return Ok(());
        };
        let index = std::fs::File::from(index.try_clone()?);
        let mut attached = [0; size_of::<u64>()];
        index.read_exact_at(&mut attached, 0)?;
        if u64::from_ne_bytes(attached) == u64::from(incarnation) + 1 {
            index.write_all_at(&[0; size_of::<u64>()], 0)?;
        }
        Ok(())
    }
}

fn memory(channel: &str, bytes: usize) -> io::Result<OwnedFd> {
    let memory = unsealed(&format!("{}{channel}", MEMORY_NAME.trim_start_matches("memfd:")), bytes as u64)?;
    seal(&memory, SealFlags::empty())?;
    Ok(memory)
}

/// Memory whose size is yet to be sealed, all of it there: no window waits for a page, and no reader pays for one.
pub(crate) fn unsealed(name: &str, bytes: u64) -> io::Result<OwnedFd> {
    let memory = memfd_create(name, MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    fallocate(&memory, FallocateFlags::empty(), 0, bytes)?;
    // Whoever has a descriptor for reading could open one for writing through /proc, if the mode let him.
    fchmod(&memory, Mode::RUSR)?;
    Ok(memory)
}

/// Its size stays, and so do its seals: these, and `more`.
pub(crate) fn seal(memory: &OwnedFd, more: SealFlags) -> io::Result<()> {
    Ok(fcntl_add_seals(memory, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL | more)?)
}

/// A descriptor that only reads.
pub(crate) fn for_reading(memory: &OwnedFd) -> io::Result<OwnedFd> {
    let path = format!("/proc/self/fd/{}", memory.as_raw_fd());
    Ok(open(path, OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())?)
}

#[cfg(test)]
mod tests {
    use rustix::io::{Errno, pread, pwrite};
    use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap, mprotect};

    use super::*;

    fn queue() -> SealedChannels {
        let shape = RingShape::new(24, Some(4));
        let channel = SealedChannel {
            ring: memory("a.b", shape.bytes()).unwrap(),
            index: Some(memory("a.b", INDEX_BYTES).unwrap()),
            checked: false,
        };
        SealedChannels([("a.b".to_owned(), channel)].into())
    }

    fn writes(file: BorrowedFd<'_>) -> bool {
        pwrite(file, &[1], 0).is_ok()
    }

    #[test]
    fn each_end_can_write_its_own_memory_alone() {
        let channels = queue();
        for (end, expected) in [
            (End::Source, vec![true, false]),
            (End::Destination, vec![false, true]),
            (End::Observer, vec![false]),
        ] {
            let mut handover = Handover::from(7);
            let at = channels.hand("a.b", end, &mut handover).unwrap().unwrap();
            assert_eq!((at.ring, at.index), (7, (expected.len() == 2).then_some(8)));
            assert_eq!(handover.files().map(writes).collect::<Vec<_>>(), expected, "{end:?}");
        }
        assert!(channels.hand("c.d", End::Source, &mut Handover::from(7)).unwrap().is_none());
    }

    #[test]
    #[allow(unsafe_code)] // a mapping, to try to write to it
    fn a_reader_makes_no_writable_memory_of_its_own() {
        let channels = queue();
        let mut handover = Handover::from(7);
        channels.hand("a.b", End::Destination, &mut handover).unwrap();
        let ring = handover.files().next().unwrap();
        let map = |access| {
            // SAFETY: fresh mappings at addresses of the kernel's choice, which nobody looks into.
            unsafe { mmap(std::ptr::null_mut(), 4096, access, MapFlags::SHARED, ring, 0) }
        };
        assert_eq!(map(ProtFlags::READ | ProtFlags::WRITE).err(), Some(Errno::ACCESS));
        let mapped = map(ProtFlags::READ).unwrap();
        // SAFETY: a change of this mapping alone.
        let changed = unsafe { mprotect(mapped, 4096, MprotectFlags::READ | MprotectFlags::WRITE) };
        assert_eq!(changed, Err(Errno::ACCESS));
        // Through /proc the kernel writes where a debugger may, but never into memory that others share.
        let own = std::fs::File::options().write(true).open("/proc/self/mem").unwrap();
        assert!(own.write_at(&[1], mapped as u64).is_err());
        for cut in [rustix::fs::ftruncate(ring, 0), fcntl_add_seals(ring, SealFlags::WRITE)] {
            assert!(cut.is_err());
        }
    }

    #[test]
    fn a_source_can_neither_cut_off_nor_lengthen_what_others_map() {
        let channels = queue();
        let mut handover = Handover::from(7);
        channels.hand("a.b", End::Source, &mut handover).unwrap();
        let ring = handover.files().next().unwrap();
        assert_eq!(rustix::fs::ftruncate(ring, 0), Err(Errno::PERM));
        assert_eq!(rustix::fs::ftruncate(ring, 1 << 30), Err(Errno::PERM));
        assert_eq!(fcntl_add_seals(ring, SealFlags::WRITE), Err(Errno::PERM));
    }

    #[test]
    fn only_the_incarnation_that_died_is_detached() {
        let channels = queue();
        let mut handover = Handover::from(7);
        channels.hand("a.b", End::Destination, &mut handover).unwrap();
        let index = handover.files().nth(1).unwrap();
        let attached = || {
            let mut word = [0; 8];
            pread(index, &mut word, 0).unwrap();
            u64::from_ne_bytes(word)
        };
        pwrite(index, &6_u64.to_ne_bytes(), 0).unwrap(); // incarnation 5
        channels.detach("a.b", 4).unwrap();
        assert_eq!(attached(), 6);
        channels.detach("a.b", 5).unwrap();
        assert_eq!(attached(), 0);
        channels.detach("c.d", 5).unwrap();
    }
}
