//! Memory blocks, and the partitions that they are given to.

use super::Resolver;
use crate::raw::{Names, RawMemoryBlock};
use bateleur_plan::{MemoryBlock, PartitionId};

impl Resolver<'_> {
    pub(super) fn memory_block(&self, raw: &RawMemoryBlock) -> MemoryBlock {
        let partitions = |names: &Names| {
            names.items().iter().map(|name| self.names.partition(name)).collect::<Vec<PartitionId>>()
        };
        MemoryBlock {
            name: raw.name.value.clone(),
            size_bytes: raw.size.get().map_or(0, |bytes| bytes.0),
            content: raw.content.get(),
            read: partitions(&raw.read),
            read_write: partitions(&raw.read_write),
        }
    }
}
