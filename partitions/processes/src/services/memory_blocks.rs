//! Memory blocks (Part 2): which there are is the plan's, where they lie the driver's.

use crate::partition::Partition;
use crate::return_code::ReturnCode;
use crate::standard::{MemoryBlockStatus, Name};

impl Partition {
    /// GET_MEMORY_BLOCK_STATUS. In every mode, and the same after a restart.
    ///
    /// # Errors
    /// INVALID_CONFIG: the plan gives this partition no such block.
    pub fn get_memory_block_status(&self, name: &str) -> Result<MemoryBlockStatus, ReturnCode> {
        let name = Name::new(name);
        let block = self.settings.memory_blocks.iter().find(|(known, _)| Some(*known) == name);
        block.map(|(_, status)| *status).ok_or(ReturnCode::InvalidConfig)
    }
}
