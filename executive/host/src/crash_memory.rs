//! The memory in which a partition's process writes down how it ends by a fault (`bateleur_contract::crash`). Each process has one of its own, so
//! that what a dead one wrote can be read while its successor runs. Here nothing is read of it but how far it is, and the signal.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::FileExt;

use bateleur_contract::CrashHead;
use bateleur_contract::crash::{BYTES, HEAD_BYTES, WHOLE};
use rustix::fs::{FallocateFlags, MemfdFlags, SealFlags, fallocate, fcntl_add_seals, memfd_create};

/// See the module's head.
#[derive(Debug)]
pub(crate) struct CrashMemory(File);

impl CrashMemory {
    /// For a process of the partition with this name. All of it is there: one that has no memory left can write too.
    pub(crate) fn make(partition: &str) -> io::Result<Self> {
        let name = format!("{partition} crash");
        let file = memfd_create(name, MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
        fallocate(&file, FallocateFlags::empty(), 0, BYTES)?;
        fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
        Ok(Self(file.into()))
    }

    /// The signal that the process was hit by, 0 for a panic; `None`: it has not written everything down.
    pub(crate) fn signal(&self) -> Option<u64> {
        let mut head = [0; HEAD_BYTES];
        self.0.read_exact_at(&mut head, 0).ok()?;
        let head = CrashHead::from_bytes(&head);
        (head.state == WHOLE).then_some(head.signal)
    }

    pub(crate) fn into_file(self) -> File {
        self.0
    }
}

impl AsFd for CrashMemory {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_as_long_as_it_was_made_and_says_nothing_until_everything_was_written() {
        let memory = CrashMemory::make("own").unwrap();
        assert!(memory.0.set_len(0).is_err() && memory.0.set_len(BYTES + 1).is_err(), "sealed");
        assert_eq!(memory.signal(), None);
        let begun = CrashHead { state: 1, signal: 11, ..CrashHead::default() };
        memory.0.write_all_at(&begun.to_bytes(), 0).unwrap();
        assert_eq!(memory.signal(), None);
        memory.0.write_all_at(&CrashHead { state: WHOLE, ..begun }.to_bytes(), 0).unwrap();
        assert_eq!(memory.signal(), Some(11));
    }
}
