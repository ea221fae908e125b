//! Memory blocks (ARINC 653 part 2): memory that partitions of a module share, each for reading or for reading and writing.

use crate::model::{MemoryBlock, PartitionId, Plan};

/// What a partition may do with a memory block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryAccess {
    /// READ.
    Read,
    /// READ_WRITE.
    ReadWrite,
}

impl MemoryBlock {
    /// What a partition may do with it; `None`: it is not given to that one.
    #[must_use]
    pub fn access(&self, partition: PartitionId) -> Option<MemoryAccess> {
        if self.read_write.contains(&partition) {
            return Some(MemoryAccess::ReadWrite);
        }
        self.read.contains(&partition).then_some(MemoryAccess::Read)
    }

    /// The partitions that it is given to.
    pub fn partitions(&self) -> impl Iterator<Item = PartitionId> + '_ {
        self.read.iter().chain(&self.read_write).copied()
    }
}

impl Plan {
    /// The memory blocks that are given to a partition, in the order of the file.
    pub fn memory_blocks_of(
        &self,
        partition: PartitionId,
    ) -> impl Iterator<Item = (&MemoryBlock, MemoryAccess)> + '_ {
        self.memory_blocks.iter().filter_map(move |block| Some((block, block.access(partition)?)))
    }
}
