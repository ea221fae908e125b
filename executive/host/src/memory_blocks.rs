//! The memory blocks of a module: made before frame 0, filled, and handed to the partitions that the plan names.
//!
//! Each is a file in memory without a name, of a fixed size, all of it there from the beginning. A partition that reads is handed a
//! descriptor that was opened for reading: neither a mapping nor a change of one makes it writable. A block that nobody writes is sealed,
//! so that the executive can not write it either.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bateleur_contract::MemoryBlockDescription;
use bateleur_plan::units::ShowSize;
use bateleur_plan::{MemoryAccess, MemoryBlock, ModuleView, PartitionId, Plan};
use rustix::fs::{FallocateFlags, SealFlags, fallocate};

use crate::sealed::{Handover, for_reading, seal, unsealed};

/// What the names of their memories begin with, as a map of the process shows them.
const MEMORY_NAME: &str = "memory block";
/// Bytes that are copied at once.
const PIECE: usize = 64 << 10;

/// See the module's head; by name.
#[derive(Debug, Default)]
pub struct MemoryBlocks(BTreeMap<String, Arc<OwnedFd>>);

/// Why a memory block can not be made.
#[derive(Debug, thiserror::Error)]
pub enum MemoryBlockError {
    /// The machine.
    #[error("memory block {name}, {size}: {error}", size = ShowSize(*.bytes))]
    Machine {
        /// The block.
        name: String,
        /// Its size.
        bytes: u64,
        /// What the machine said.
        error: io::Error,
    },
    /// Its content can not be read.
    #[error("the content of memory block {name}: {path}: {error}", path = .path.display())]
    Content {
        /// The block.
        name: String,
        /// The file.
        path: PathBuf,
        /// What the machine said.
        error: io::Error,
    },
    /// There is more than fits.
    #[error(
        "the content of memory block {name}: {path} is longer than the block, which has {size}: make `size` larger",
        path = .path.display(), size = ShowSize(*.bytes)
    )]
    TooLong {
        /// The block.
        name: String,
        /// The file.
        path: PathBuf,
        /// The size of the block.
        bytes: u64,
    },
}

/// The memory blocks that a module has: those with a partition on it.
pub fn of_module<'p>(view: &ModuleView<'p>) -> impl Iterator<Item = &'p MemoryBlock> + use<'p> {
    let (plan, module) = (view.plan(), view.id());
    plan.memory_blocks.iter().filter(move |block| block.partitions().any(|id| plan[id].module == module))
}

/// Memory of zeros for a block that partitions write.
///
/// # Errors
/// The machine has no memory or no descriptor left.
pub fn make(block: &MemoryBlock) -> Result<OwnedFd, MemoryBlockError> {
    let memory = zeros(block)?;
    seal(&memory, SealFlags::empty()).map_err(failed(block))?;
    Ok(memory)
}

fn zeros(block: &MemoryBlock) -> Result<OwnedFd, MemoryBlockError> {
    unsealed(&format!("{MEMORY_NAME} {}", block.name), block.size_bytes).map_err(failed(block))
}

impl MemoryBlocks {
    /// The blocks of a module as it starts, their content read from files relative to `folder`. `kept` are memories that outlive the
    /// executive. Their content stays if `warm`.
    ///
    /// # Errors
    /// The machine has no memory left, or a content can not be used.
    pub fn begin(
        view: &ModuleView<'_>,
        folder: &Path,
        kept: &BTreeMap<String, Arc<OwnedFd>>,
        warm: bool,
    ) -> Result<Self, MemoryBlockError> {
        let begun = of_module(view).map(|block| {
            let memory = match kept.get(&block.name) {
                Some(memory) if warm => memory.clone(),
                Some(memory) => {
                    clear(memory, block)?;
                    fill(memory, block, folder)?;
                    memory.clone()
                }
                None => {
                    let memory = zeros(block)?;
                    fill(&memory, block, folder)?;
                    let nobody_writes = block.read_write.is_empty();
                    let more = if nobody_writes { SealFlags::WRITE } else { SealFlags::empty() };
                    seal(&memory, more).map_err(failed(block))?;
                    Arc::new(memory)
                }
            };
            Ok((block.name.clone(), memory))
        });
        begun.collect::<Result<_, _>>().map(Self)
    }

    /// The blocks of a partition.
    ///
    /// # Errors
    /// The executive has no descriptor left.
    pub fn of(&self, plan: &Plan, partition: PartitionId) -> io::Result<GivenBlocks> {
        let given = plan.memory_blocks_of(partition).filter_map(|(block, access)| {
            let memory = self.0.get(&block.name)?;
            let file = match access {
                MemoryAccess::ReadWrite => memory.try_clone(),
                MemoryAccess::Read => for_reading(memory),
            };
            let described = MemoryBlockDescription {
                name: block.name.clone(),
                bytes: block.size_bytes,
                writable: access == MemoryAccess::ReadWrite,
                descriptor: -1, // as it is handed over
            };
            Some(file.map(|file| (described, file)))
        });
        given.collect::<io::Result<_>>().map(GivenBlocks)
    }
}

/// The memory blocks of one partition, each opened as the plan gives it.
#[derive(Debug)]
pub struct GivenBlocks(Vec<(MemoryBlockDescription, OwnedFd)>);

impl GivenBlocks {
    /// Adds them to `handover`; says which they are, and where.
    ///
    /// # Errors
    /// The executive has no descriptor left.
    pub fn hand(&self, handover: &mut Handover) -> io::Result<Vec<MemoryBlockDescription>> {
        let hand = |(described, file): &(MemoryBlockDescription, OwnedFd)| {
            Ok(MemoryBlockDescription { descriptor: handover.add(file.try_clone()?), ..described.clone() })
        };
        self.0.iter().map(hand).collect()
    }
}

fn failed(block: &MemoryBlock) -> impl FnOnce(io::Error) -> MemoryBlockError {
    let (name, bytes) = (block.name.clone(), block.size_bytes);
    move |error| MemoryBlockError::Machine { name, bytes, error }
}

/// All of it zeros, and all of it there.
fn clear(memory: &OwnedFd, block: &MemoryBlock) -> Result<(), MemoryBlockError> {
    let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
    let cleared = fallocate(memory, hole, 0, block.size_bytes);
    let there = cleared.and_then(|()| fallocate(memory, FallocateFlags::empty(), 0, block.size_bytes));
    there.map_err(|error| failed(block)(error.into()))
}

fn fill(memory: &OwnedFd, block: &MemoryBlock, folder: &Path) -> Result<(), MemoryBlockError> {
    let Some(file) = &block.content else { return Ok(()) };
    let path = folder.join(file);
    let unread = |error| MemoryBlockError::Content { name: block.name.clone(), path: path.clone(), error };
    // A pipe would wait for somebody who writes.
    let flags = rustix::fs::OFlags::RDONLY | rustix::fs::OFlags::CLOEXEC | rustix::fs::OFlags::NONBLOCK;
    let content = rustix::fs::open(&path, flags, rustix::fs::Mode::empty());
    let mut content = File::from(content.map_err(|error| unread(error.into()))?);
    if !content.metadata().map_err(unread)?.is_file() {
        return Err(unread(io::Error::other("it is no ordinary file")));
    }
    let memory = File::from(memory.try_clone().map_err(failed(block))?);
    let (mut piece, mut at) = (vec![0; PIECE], 0);
    loop {
        let length = content.read(&mut piece).map_err(unread)?;
        if length == 0 {
            return Ok(());
        }
        if at + length as u64 > block.size_bytes {
            return Err(MemoryBlockError::TooLong {
                name: block.name.clone(),
                path,
                bytes: block.size_bytes,
            });
        }
        memory.write_all_at(&piece[..length], at).map_err(failed(block))?;
        at += length as u64;
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use bateleur_plan::ModuleId;
    use rustix::io::{Errno, pread, pwrite};
    use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap, mprotect};

    use super::*;

    fn block(content: Option<&str>, read_write: &[usize]) -> MemoryBlock {
        MemoryBlock {
            name: "terrain".into(),
            size_bytes: 10_000,
            content: content.map(str::to_owned),
            read: vec![PartitionId(0)],
            read_write: read_write.iter().copied().map(PartitionId).collect(),
        }
    }

    fn plan(block: MemoryBlock) -> Plan {
        let partition =
            |name: &str| format!("[partition.{name}]\nprogram = \"x\"\nmodule = \"m\"\nmemory = \"8MiB\"\n");
        let window = |name: &str, ms: u32| {
            format!("{{ partition = \"{name}\", offset = \"{ms}ms\", duration = \"1ms\" }}")
        };
        let text = format!(
            "[module.m]\ncores = [0]\n{}{}[schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\nwindow = [{}, {}]\n",
            partition("reader"),
            partition("writer"),
            window("reader", 0),
            window("writer", 5)
        );
        let mut plan = crate::test_support::plan_of(&text);
        plan.memory_blocks.push(block);
        plan
    }

    /// As a module begins it, with a folder in which `map` has three bytes.
    fn begun(
        block: &MemoryBlock,
        kept: &BTreeMap<String, Arc<OwnedFd>>,
        warm: bool,
    ) -> Result<MemoryBlocks, MemoryBlockError> {
        let folder = tempfile::tempdir().unwrap();
        File::create(folder.path().join("map")).unwrap().write_all(b"map").unwrap();
        let plan = plan(block.clone());
        let view = plan.module(&plan[ModuleId(0)].name).unwrap();
        MemoryBlocks::begin(&view, folder.path(), kept, warm)
    }

    fn handed(
        blocks: &MemoryBlocks,
        block: &MemoryBlock,
        partition: usize,
    ) -> (Handover, MemoryBlockDescription) {
        let mut handover = Handover::from(9);
        let given = blocks.of(&plan(block.clone()), PartitionId(partition)).unwrap();
        let mut said = given.hand(&mut handover).unwrap();
        assert_eq!((said.len(), said[0].descriptor), (1, 9));
        (handover, said.remove(0))
    }

    fn first_bytes(memory: impl std::os::fd::AsFd) -> [u8; 4] {
        let mut found = [9; 4];
        pread(memory, &mut found, 0).unwrap();
        found
    }

    #[test]
    #[allow(unsafe_code)] // a mapping, to try to write to it
    fn a_partition_that_reads_gets_memory_that_it_can_not_make_writable() {
        for read_write in [&[1][..], &[]] {
            let block = block(Some("map"), read_write);
            let blocks = begun(&block, &BTreeMap::new(), false).unwrap();
            let (handover, said) = handed(&blocks, &block, 0);
            assert!(!said.writable && said.bytes == 10_000);
            let file = handover.files().next().unwrap();
            assert_eq!(first_bytes(file), *b"map\0");
            assert!(pwrite(file, b"x", 0).is_err());
            // SAFETY: fresh mappings at addresses of the kernel's choice, which nobody looks into.
            let map = |access| unsafe { mmap(std::ptr::null_mut(), 4096, access, MapFlags::SHARED, file, 0) };
            assert!(map(ProtFlags::READ | ProtFlags::WRITE).is_err());
            let mapped = map(ProtFlags::READ).unwrap();
            // SAFETY: a change of this mapping alone.
            let changed = unsafe { mprotect(mapped, 4096, MprotectFlags::READ | MprotectFlags::WRITE) };
            assert_eq!(changed, Err(Errno::ACCESS));
        }
    }

    #[test]
    fn a_block_that_nobody_writes_is_sealed_and_one_that_is_written_keeps_its_size() {
        let constant = block(Some("map"), &[]);
        let blocks = begun(&constant, &BTreeMap::new(), false).unwrap();
        assert_eq!(pwrite(&blocks.0["terrain"], b"x", 0), Err(Errno::PERM), "the executive itself");
        let shared = block(None, &[1]);
        let blocks = begun(&shared, &BTreeMap::new(), false).unwrap();
        let (handover, said) = handed(&blocks, &shared, 1);
        let file = handover.files().next().unwrap();
        assert!(said.writable && pwrite(file, b"x", 9_999).is_ok());
        assert_eq!(rustix::fs::ftruncate(file, 0), Err(Errno::PERM));
    }

    #[test]
    fn what_outlives_an_executive_is_as_it_was_and_after_a_cold_start_of_the_module_as_it_began() {
        let block = block(Some("map"), &[1]);
        let kept: BTreeMap<_, _> = [("terrain".to_owned(), Arc::new(make(&block).unwrap()))].into();
        begun(&block, &kept, false).unwrap();
        assert_eq!(first_bytes(&kept["terrain"]), *b"map\0");
        pwrite(&kept["terrain"], b"here", 0).unwrap();
        begun(&block, &kept, true).unwrap();
        assert_eq!(first_bytes(&kept["terrain"]), *b"here");
        begun(&block, &kept, false).unwrap();
        assert_eq!(first_bytes(&kept["terrain"]), *b"map\0");
    }

    #[test]
    fn content_that_is_missing_too_long_or_no_file_is_refused_with_its_path() {
        let refused = |block: &MemoryBlock| begun(block, &BTreeMap::new(), false).unwrap_err().to_string();
        assert!(refused(&block(Some("nowhere"), &[1])).contains("nowhere: No such file"));
        assert!(refused(&block(Some("."), &[1])).contains("no ordinary file"));
        let small = MemoryBlock { size_bytes: 2, ..block(Some("map"), &[1]) };
        assert!(refused(&small).contains("longer than the block, which has 2B"));
    }
}
