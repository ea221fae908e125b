//! Partition management.

use crate::partition::{End, Partition, Runner};
use crate::return_code::ReturnCode;
use crate::standard::{OperatingMode, PartitionStatus, StartCondition};

impl Partition {
    /// GET_PARTITION_STATUS.
    #[must_use]
    pub fn get_partition_status(&self) -> PartitionStatus {
        PartitionStatus {
            period: self.settings.grid.period,
            duration: self.settings.duration,
            identifier: self.settings.identifier,
            lock_level: self.lock.level,
            operating_mode: self.mode,
            start_condition: self.settings.condition,
            num_assigned_cores: self.settings.cores,
        }
    }

    /// SET_PARTITION_MODE. Into NORMAL: the main process ends, and those that were started begin. Into any other mode: nobody of
    /// this partition runs again.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such mode. NO_ACTION: NORMAL in NORMAL. INVALID_MODE: WARM_START in COLD_START, or NORMAL by the error
    /// handler, which can not end the main process.
    pub fn set_partition_mode(&mut self, mode: impl Into<u32>) -> Result<(), ReturnCode> {
        let mode = OperatingMode::try_from(mode.into())?;
        match (self.mode, mode) {
            (OperatingMode::Normal, OperatingMode::Normal) => return Err(ReturnCode::NoAction),
            (OperatingMode::ColdStart, OperatingMode::WarmStart) => return Err(ReturnCode::InvalidMode),
            (_, OperatingMode::Normal) if self.running() == Some(Runner::Handler) => {
                return Err(ReturnCode::InvalidMode);
            }
            (_, OperatingMode::Normal) => self.enter_normal(),
            (_, OperatingMode::Idle) => self.become_idle(),
            (_, OperatingMode::ColdStart | OperatingMode::WarmStart) => {
                self.end = Some(End::Restart { mode, condition: StartCondition::PartitionRestart });
            }
        }
        Ok(())
    }
}
