//! Memory blocks (ARINC 653 part 2): memory that the plan shares among partitions, each for reading or for reading and writing.
//!
//! The executive makes the memory and hands it over; it is mapped before the partition's first own instruction and stays so until its
//! process ends. What the plan gives for reading is mapped for reading, from a descriptor that only reads: no call of this process makes
//! it writable. Another partition may write at any time, on another core: what is copied here is copied word by word and is not one whole.
#![allow(unsafe_code)] // memory that others change

use std::os::fd::{FromRawFd, OwnedFd};
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use bateleur_contract::MemoryBlockDescription;
use rustix::mm::{MapFlags, ProtFlags, mmap};
use zerocopy::{FromBytes, Immutable, IntoBytes};

use crate::context::StartError;

/// A memory block of the plan. Cheap to clone.
#[derive(Debug, Clone)]
pub struct MemoryBlock {
    name: Arc<str>,
    at: NonNull<u8>,
    bytes: usize,
    writable: bool,
}

/// Why bytes of a memory block can not be reached.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MemoryBlockError {
    /// They lie beyond its end.
    #[error("memory block \"{name}\" has {bytes} bytes: there are no {length} at {offset}")]
    Outside {
        /// The block.
        name: String,
        /// Its size.
        bytes: usize,
        /// The first byte that was asked for.
        offset: usize,
        /// How many were.
        length: usize,
    },
    /// The plan gives it for reading.
    #[error("the plan gives memory block \"{0}\" for reading: name the partition in its `read_write`")]
    ReadOnly(String),
}

// SAFETY: its memory is mapped until the process ends, and is reached by atomics alone.
unsafe impl Send for MemoryBlock {}
// SAFETY: as above.
unsafe impl Sync for MemoryBlock {}

impl MemoryBlock {
    /// Maps what the executive left open under a number. Done once for each.
    pub(crate) fn map(described: &MemoryBlockDescription) -> Result<Self, StartError> {
        let name = &described.name;
        let failed =
            |error| StartError::Other(format!("the memory of block \"{name}\" was not handed over: {error}"));
        // SAFETY: the executive left it open where it says so, and nobody else in the process knows it.
        let file = unsafe { OwnedFd::from_raw_fd(described.descriptor) };
        let bytes = usize::try_from(described.bytes).unwrap_or(usize::MAX);
        let there = rustix::fs::fstat(&file).map_err(failed)?.st_size;
        if bytes == 0 || u64::try_from(there) != Ok(described.bytes) {
            return Err(failed(rustix::io::Errno::INVAL));
        }
        let access = if described.writable { ProtFlags::READ | ProtFlags::WRITE } else { ProtFlags::READ };
        // SAFETY: a fresh mapping at an address of the kernel's choice, of a file that is as long and keeps its size.
        let at = unsafe { mmap(std::ptr::null_mut(), bytes, access, MapFlags::SHARED, file, 0) };
        let at = NonNull::new(at.map_err(failed)?.cast()).ok_or(failed(rustix::io::Errno::INVAL))?;
        Ok(Self { name: name.as_str().into(), at, bytes, writable: described.writable })
    }

    /// Its name in the plan.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its size, bytes; never 0.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.bytes
    }

    /// The plan lets this partition write it.
    #[must_use]
    pub fn is_writable(&self) -> bool {
        self.writable
    }

    /// Where it begins, on a page. Writing to one that is not writable is the error `memory_violation`.
    #[must_use]
    pub fn address(&self) -> *mut u8 {
        self.at.as_ptr()
    }

    /// Copies bytes from `offset` on.
    ///
    /// # Errors
    /// They lie beyond its end.
    pub fn read(&self, offset: usize, into: &mut [u8]) -> Result<(), MemoryBlockError> {
        let from = self.within(offset, into.len())?;
        let (head, words, tail) = parts(from, into.len());
        let (first, rest) = into.split_at_mut(head);
        let (middle, last) = rest.split_at_mut(words * WORD);
        // SAFETY: inside of the mapping, aligned as `parts` says, and reached by atomics alone.
        unsafe {
            first.iter_mut().enumerate().for_each(|(at, byte)| *byte = byte_at(from, at).load(Relaxed));
            for (at, word) in middle.chunks_exact_mut(WORD).enumerate() {
                word.copy_from_slice(&word_at(from, head + at * WORD).load(Relaxed).to_ne_bytes());
            }
            let end = head + words * WORD;
            last.iter_mut().enumerate().for_each(|(at, byte)| *byte = byte_at(from, end + at).load(Relaxed));
        }
        debug_assert_eq!(last.len(), tail);
        Ok(())
    }

    /// Writes bytes from `offset` on.
    ///
    /// # Errors
    /// The plan gives it for reading; or they lie beyond its end.
    pub fn write(&self, offset: usize, bytes: &[u8]) -> Result<(), MemoryBlockError> {
        if !self.writable {
            return Err(MemoryBlockError::ReadOnly(self.name.to_string()));
        }
        let to = self.within(offset, bytes.len())?;
        let (head, words, _) = parts(to, bytes.len());
        let (first, rest) = bytes.split_at(head);
        let (middle, last) = rest.split_at(words * WORD);
        // SAFETY: inside of a mapping that may be written, aligned as `parts` says, and reached by atomics alone.
        unsafe {
            first.iter().enumerate().for_each(|(at, byte)| byte_at(to, at).store(*byte, Relaxed));
            for (at, word) in middle.chunks_exact(WORD).enumerate() {
                let mut whole = [0; WORD];
                whole.copy_from_slice(word);
                word_at(to, head + at * WORD).store(u64::from_ne_bytes(whole), Relaxed);
            }
            let end = head + words * WORD;
            last.iter().enumerate().for_each(|(at, byte)| byte_at(to, end + at).store(*byte, Relaxed));
        }
        Ok(())
    }

    /// The value of plain data at `offset`.
    ///
    /// # Errors
    /// It lies beyond its end.
    pub fn load<T: FromBytes + IntoBytes>(&self, offset: usize) -> Result<T, MemoryBlockError> {
        let mut value = T::new_zeroed();
        self.read(offset, value.as_mut_bytes()).map(|()| value)
    }

    /// Writes a value of plain data at `offset`.
    ///
    /// # Errors
    /// As [`MemoryBlock::write`].
    pub fn store<T: IntoBytes + Immutable>(&self, offset: usize, value: &T) -> Result<(), MemoryBlockError> {
        self.write(offset, value.as_bytes())
    }

    fn within(&self, offset: usize, length: usize) -> Result<*mut u8, MemoryBlockError> {
        if offset.checked_add(length).is_none_or(|end| end > self.bytes) {
            let (name, bytes) = (self.name.to_string(), self.bytes);
            return Err(MemoryBlockError::Outside { name, bytes, offset, length });
        }
        // SAFETY: at most its end.
        Ok(unsafe { self.at.as_ptr().add(offset) })
    }
}

const WORD: usize = size_of::<u64>();

/// Bytes before the first whole word, whole words, and bytes behind them.
fn parts(at: *mut u8, length: usize) -> (usize, usize, usize) {
    let head = at.align_offset(WORD).min(length);
    let words = (length - head) / WORD;
    (head, words, length - head - words * WORD)
}

/// # Safety
/// The byte lies in memory that is mapped for good.
unsafe fn byte_at<'m>(base: *mut u8, at: usize) -> &'m AtomicU8 {
    // SAFETY: as the caller says; any byte is one.
    unsafe { AtomicU8::from_ptr(base.add(at)) }
}

/// # Safety
/// The word lies in memory that is mapped for good, and is aligned.
unsafe fn word_at<'m>(base: *mut u8, at: usize) -> &'m AtomicU64 {
    // SAFETY: as the caller says; any bits are one.
    unsafe { AtomicU64::from_ptr(base.add(at).cast()) }
}

#[cfg(test)]
mod tests {
    use std::os::fd::IntoRawFd;

    use super::*;

    /// Two views of one memory of 100 bytes: one that writes, one that reads.
    fn views() -> (MemoryBlock, MemoryBlock) {
        let file = rustix::fs::memfd_create("block", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 100).unwrap();
        let map = |file: OwnedFd, writable| {
            let descriptor = file.into_raw_fd();
            MemoryBlock::map(&MemoryBlockDescription { name: "map".into(), bytes: 100, writable, descriptor })
        };
        (map(file.try_clone().unwrap(), true).unwrap(), map(file, false).unwrap())
    }

    #[test]
    fn bytes_come_out_as_they_went_in_at_every_offset_and_length() {
        let (writer, reader) = views();
        for offset in 0..20 {
            for length in 0..40 {
                let bytes: Vec<u8> = (0..length).map(|at| (offset * 7 + at * 3 + 1) as u8).collect();
                writer.write(offset, &vec![0xff; length + 1]).unwrap();
                writer.write(offset, &bytes).unwrap();
                let mut found = vec![0; length + 1];
                reader.read(offset, &mut found).unwrap();
                assert_eq!((&found[..length], found[length]), (&*bytes, 0xff), "{length} at {offset}");
            }
        }
        writer.store(9, &[1.5_f64, -2.0]).unwrap();
        assert_eq!(reader.load::<[f64; 2]>(9), Ok([1.5, -2.0]));
    }

    #[test]
    fn what_lies_beyond_the_end_and_writing_what_is_read_are_refused() {
        let (writer, reader) = views();
        assert!(writer.write(99, &[1]).is_ok());
        for (offset, length) in [(100, 1), (99, 2), (0, 101), (usize::MAX, 1)] {
            let refused = writer.write(offset, &vec![0; length]).unwrap_err();
            assert!(matches!(refused, MemoryBlockError::Outside { bytes: 100, .. }), "{refused}");
            assert!(reader.read(offset, &mut vec![0; length]).is_err());
        }
        assert_eq!(reader.write(0, &[1]), Err(MemoryBlockError::ReadOnly("map".into())));
    }

    #[test]
    fn memory_of_another_size_than_the_plans_is_refused() {
        let file = rustix::fs::memfd_create("block", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, 10).unwrap();
        let descriptor = file.into_raw_fd();
        let described = MemoryBlockDescription { name: "map".into(), bytes: 11, writable: false, descriptor };
        let refused = MemoryBlock::map(&described).unwrap_err().to_string();
        assert!(refused.contains("\"map\" was not handed over"), "{refused}");
    }
}
