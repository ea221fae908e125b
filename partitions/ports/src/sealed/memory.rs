//! A sealed channel's memory as words that another process may change at any time. The only unsafe code of this crate.
#![allow(unsafe_code)]

use std::os::fd::AsFd;
use std::ptr::NonNull;

use rustix::fs::{SealFlags, fcntl_get_seals, fstat};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use super::sync::AtomicU64;

/// Memory that two processes meet in: words, each read and written as a whole.
pub(crate) trait Words {
    /// All of them.
    fn words(&self) -> &[AtomicU64];
}

/// Why memory that was handed over can not be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MemoryError {
    /// The kernel refused.
    #[error("it can not be mapped: {0}")]
    Refused(#[from] rustix::io::Errno),
    /// Touching what is missing would be a bus error.
    #[error("it has {found} bytes where {expected} belong")]
    TooShort {
        /// Bytes that it has.
        found: u64,
        /// Bytes of the channel.
        expected: u64,
    },
    /// Its other end could cut it off.
    #[error("it is not sealed against being cut off")]
    NotSealed,
}

/// A mapping of a whole memory, unmapped when dropped.
#[derive(Debug)]
pub(crate) struct Memory {
    at: NonNull<u8>,
    bytes: usize,
}

impl Memory {
    /// Maps memory that this process alone may write.
    pub(super) fn writable(descriptor: impl AsFd, bytes: usize) -> Result<Self, MemoryError> {
        Self::map(descriptor, bytes, ProtFlags::READ | ProtFlags::WRITE)
    }

    /// Maps memory that another process writes. Whoever writes there ends by SIGSEGV.
    pub(super) fn readable(descriptor: impl AsFd, bytes: usize) -> Result<Self, MemoryError> {
        Self::map(descriptor, bytes, ProtFlags::READ)
    }

    fn map(descriptor: impl AsFd, bytes: usize, access: ProtFlags) -> Result<Self, MemoryError> {
        let (found, expected) = (fstat(&descriptor)?.st_size as u64, bytes as u64);
        if found < expected {
            return Err(MemoryError::TooShort { found, expected });
        }
        if !fcntl_get_seals(&descriptor)?.contains(SealFlags::SHRINK) {
            return Err(MemoryError::NotSealed);
        }
        // SAFETY: a fresh mapping at an address of the kernel's choice, as long as the file is and stays.
        let at = unsafe { mmap(std::ptr::null_mut(), bytes, access, MapFlags::SHARED, descriptor, 0)? };
        let at = NonNull::new(at.cast()).ok_or(MemoryError::Refused(rustix::io::Errno::INVAL))?;
        Ok(Self { at, bytes })
    }

    /// Lends a part of writable memory to `fill`. Readers may look at it meanwhile, as words, and throw away what they have seen.
    pub(super) fn lend<R>(&self, from: usize, bytes: usize, fill: impl FnOnce(&mut [u8]) -> R) -> Option<R> {
        let end = from.checked_add(bytes).filter(|end| *end <= self.bytes)?;
        debug_assert!(end <= self.bytes);
        // SAFETY: within the mapping; every byte of it has a value; this process is the only one that writes here, in the one
        // thread that has the port, and it has no other reference to it while `fill` runs.
        Some(fill(unsafe { std::slice::from_raw_parts_mut(self.at.as_ptr().add(from), bytes) }))
    }
}

impl Words for Memory {
    fn words(&self) -> &[AtomicU64] {
        // SAFETY: mapped for as long as `self` lives, aligned to a page, whole words; any content is one of an atomic.
        unsafe { std::slice::from_raw_parts(self.at.as_ptr().cast(), self.bytes / size_of::<u64>()) }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: the mapping was made by `map` with this length, and no reference outlives `self`.
        let _ = unsafe { munmap(self.at.as_ptr().cast(), self.bytes) };
    }
}
