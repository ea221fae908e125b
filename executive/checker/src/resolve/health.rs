//! What is done about errors: as the file says, else as the executive does by itself.

use crate::closed::{ErrorLevel, PartitionAction, PartitionError, PartitionState, StartMode};
use crate::defaults;
use crate::model::{
    Health, HealthLog, Levels, ModuleHealth, Reset, default_level, default_module_action,
    default_partition_action,
};
use crate::raw::{Answer, RawPartition};
use crate::reader::{At, Nanoseconds};

use super::Resolver;

impl Resolver<'_> {
    pub(super) fn health(&self) -> Health {
        let raw = &self.file.health;
        Health {
            levels: Levels::fill(|error, state| self.level(error, state)),
            module: ModuleHealth::fill(|error| {
                answer(&raw.module, error).unwrap_or_else(|| default_module_action(error))
            }),
            silence_windows: raw.silence_windows.as_ref().map_or(defaults::SILENCE_WINDOWS, |at| at.value),
            late_after_ns: nanoseconds(&raw.late_after, defaults::LATE_AFTER_NS),
            reset: Reset {
                budget: raw.reset_budget.as_ref().map_or(defaults::RESET_BUDGET, |at| at.value),
                within_ns: nanoseconds(&raw.reset_within, defaults::RESET_WITHIN_NS),
                startup_ns: nanoseconds(&raw.reset_startup, defaults::RESET_STARTUP_NS),
            },
            log: HealthLog {
                bytes: raw.log_size.as_ref().map_or(defaults::HEALTH_LOG_BYTES, |at| at.value.0),
                policy: raw.log_policy.as_ref().map_or(defaults::HEALTH_LOG_POLICY, |at| at.value.0),
            },
        }
    }

    /// At which level an error is dealt with: as the file says for the state, else for the error.
    fn level(&self, error: PartitionError, state: PartitionState) -> ErrorLevel {
        let of_error = || self.file.health.levels.iter().filter(move |said| said.error == error);
        let said = of_error()
            .find(|said| said.state == Some(state))
            .or_else(|| of_error().find(|said| said.state.is_none()));
        match said.map(|said| said.level.value) {
            // A level for the error as a whole is meant for where it can be.
            Some(ErrorLevel::Process) if state != PartitionState::Normal => ErrorLevel::Partition,
            Some(level) => level,
            None => default_level(error, state),
        }
    }

    /// What is done about an error of a partition: its own answer, else the file's.
    pub(super) fn action(&self, raw: &RawPartition, error: PartitionError) -> PartitionAction {
        if let Some(own) = answer(&raw.health, error) {
            return own;
        }
        match answer(&self.file.health.partition, error).unwrap_or_else(|| default_partition_action(error)) {
            // A default is as warm as the partition can be.
            PartitionAction::WarmRestart if starts_cold(raw) => PartitionAction::ColdRestart,
            action => action,
        }
    }
}

fn nanoseconds(said: &Option<At<Nanoseconds>>, otherwise: u64) -> u64 {
    said.as_ref().map_or(otherwise, |at| at.value.0)
}

fn answer<E: Copy + PartialEq, A: Copy>(table: &[Answer<E, A>], error: E) -> Option<A> {
    table.iter().find(|answer| answer.error == error).map(|answer| answer.action.value)
}

/// Whether a partition can not use what an incarnation before it left.
pub(super) fn starts_cold(raw: &RawPartition) -> bool {
    raw.restart.start.word().unwrap_or(defaults::START) == StartMode::Cold
}
