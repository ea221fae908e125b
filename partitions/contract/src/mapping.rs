//! Shared memory as a Rust reference. The only unsafe code of the contract.
#![allow(unsafe_code)]

use std::marker::PhantomData;
use std::ops::Deref;
use std::os::fd::AsFd;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// Types that may be mapped: made of atomics only, so that another process may write them at any time.
///
/// # Safety
/// Every bit pattern is a value of the type, and every field has interior mutability through atomics.
pub unsafe trait SharedMemory: Sync {}

// SAFETY: an atomic, for which every bit pattern is a value.
unsafe impl SharedMemory for std::sync::atomic::AtomicU32 {}

/// A `T` in shared memory, unmapped when dropped.
#[derive(Debug)]
pub struct Mapped<T> {
    at: NonNull<T>,
    whole: PhantomData<T>,
}

// SAFETY: `T` is made of atomics (SharedMemory), the mapping is valid in every thread of the process.
unsafe impl<T: SharedMemory> Send for Mapped<T> {}
// SAFETY: as above; a shared reference allows atomic access only.
unsafe impl<T: SharedMemory> Sync for Mapped<T> {}

/// Why a descriptor could not be mapped.
#[derive(Debug, thiserror::Error)]
pub enum MappingError {
    /// The kernel refused.
    #[error("cannot map the shared page: {0}")]
    Refused(#[from] rustix::io::Errno),
    /// The file behind the descriptor is shorter than the type: touching it would be a bus error.
    #[error("the shared page has {found} bytes where {expected} belong")]
    TooShort {
        /// Bytes in the file.
        found: u64,
        /// Bytes of the type.
        expected: u64,
    },
}

impl<T: SharedMemory> Mapped<T> {
    /// Maps the first `size_of::<T>()` bytes behind `descriptor`, readable and writable.
    pub fn new(descriptor: impl AsFd) -> Result<Self, MappingError> {
        let expected = size_of::<T>() as u64;
        let found = rustix::fs::fstat(&descriptor)?.st_size as u64;
        if found < expected {
            return Err(MappingError::TooShort { found, expected });
        }
        // SAFETY: a fresh mapping at an address of the kernel's choice; it is as long as `T`, page aligned, and any
        // content is a valid `T` (SharedMemory).
        let at = unsafe {
            mmap(
                std::ptr::null_mut(),
                size_of::<T>(),
                ProtFlags::READ | ProtFlags::WRITE,
                MapFlags::SHARED,
                descriptor,
                0,
            )?
        };
        let at = NonNull::new(at.cast()).ok_or(MappingError::Refused(rustix::io::Errno::INVAL))?;
        Ok(Self { at, whole: PhantomData })
    }
}

impl<T: SharedMemory> Deref for Mapped<T> {
    type Target = T;

    fn deref(&self) -> &T {
        // SAFETY: mapped for as long as `self` lives, aligned, valid for every content (SharedMemory).
        unsafe { self.at.as_ref() }
    }
}

impl<T> Drop for Mapped<T> {
    fn drop(&mut self) {
        // SAFETY: the mapping was made by `new` with this length, and no reference outlives `self`.
        let _ = unsafe { munmap(self.at.as_ptr().cast(), size_of::<T>()) };
    }
}
/// Words in shared memory, unmapped with the last copy of this.
#[derive(Debug, Clone)]
pub struct MappedWords(Arc<Words>);

#[derive(Debug)]
struct Words {
    at: NonNull<AtomicU64>,
    count: usize,
}

// SAFETY: they are atomics, and the mapping is valid in every thread of the process.
unsafe impl Send for Words {}
// SAFETY: as above.
unsafe impl Sync for Words {}

impl MappedWords {
    /// Maps the whole words behind `descriptor`, readable and writable.
    ///
    /// # Errors
    /// There are none, or the kernel refuses.
    pub fn new(descriptor: impl AsFd) -> Result<Self, MappingError> {
        let found = rustix::fs::fstat(&descriptor)?.st_size as u64;
        let count = found as usize / size_of::<AtomicU64>();
        if count == 0 {
            return Err(MappingError::TooShort { found, expected: size_of::<AtomicU64>() as u64 });
        }
        let (access, bytes) = (ProtFlags::READ | ProtFlags::WRITE, count * size_of::<AtomicU64>());
        // SAFETY: a fresh mapping at an address of the kernel's choice, page aligned, of a file that is as long.
        let at = unsafe { mmap(std::ptr::null_mut(), bytes, access, MapFlags::SHARED, descriptor, 0)? };
        let at = NonNull::new(at.cast()).ok_or(MappingError::Refused(rustix::io::Errno::INVAL))?;
        Ok(Self(Arc::new(Words { at, count })))
    }
}

impl Deref for MappedWords {
    type Target = [AtomicU64];

    fn deref(&self) -> &[AtomicU64] {
        // SAFETY: mapped for as long as `self` lives, aligned, and atomics have a value for every content.
        unsafe { std::slice::from_raw_parts(self.0.at.as_ptr(), self.0.count) }
    }
}

impl Drop for Words {
    fn drop(&mut self) {
        // SAFETY: the mapping was made with this length, and no reference outlives `self`.
        let _ = unsafe { munmap(self.at.as_ptr().cast(), self.count * size_of::<AtomicU64>()) };
    }
}
