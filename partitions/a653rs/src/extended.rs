//! The services of Part 2 that `a653rs` knows: memory blocks and module schedules.

use a653rs::bindings::{
    ApexMemoryBlockP2, ApexMemoryBlockStatus, ApexScheduleP2, ApexScheduleStatus, MemoryBlockMode,
    MemoryBlockName, ScheduleId, ScheduleName,
};
use bateleur_apex::processes::current;
use bateleur_apex::processes::standard;

use crate::convert::{Answer, call, code, id, text};
use crate::partition::ApexLinuxPartition;

impl ApexMemoryBlockP2 for ApexLinuxPartition {
    fn get_memory_block_status(memory_block_name: MemoryBlockName) -> Answer<ApexMemoryBlockStatus> {
        let name = text(&memory_block_name)?;
        let status = call(|services| services.get_memory_block_status(name))?;
        Ok(ApexMemoryBlockStatus {
            address: status.address as *mut u8,
            size: status.size,
            mode: match status.mode {
                standard::MemoryBlockMode::Read => MemoryBlockMode::Read,
                standard::MemoryBlockMode::ReadWrite => MemoryBlockMode::ReadWrite,
            },
        })
    }
}

impl ApexScheduleP2 for ApexLinuxPartition {
    fn set_module_schedule(schedule_id: ScheduleId) -> Answer<()> {
        current::set_module_schedule(id(schedule_id)).map_err(code)
    }

    fn get_module_schedule_status() -> Answer<ApexScheduleStatus> {
        let status = current::get_module_schedule_status().map_err(code)?;
        Ok(ApexScheduleStatus {
            time_of_last_schedule_switch: status.time_of_last_switch,
            current_schedule: status.current.into(),
            next_schedule: status.next.into(),
        })
    }

    fn get_module_schedule_id(schedule_name: ScheduleName) -> Answer<ScheduleId> {
        let name = text(&schedule_name)?;
        current::get_module_schedule_id(name).map(Into::into).map_err(code)
    }
}
