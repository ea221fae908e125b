//! What a driver provides for logbooks (Part 2): memory that is copied to a store. Here only the services' checks are.

use std::fmt::Debug;
use std::sync::Arc;

use crate::standard::{LogbookStatus, Name, WriteStatus};

/// The memory of one logbook. Nothing in here waits.
pub trait LogbookMemory: Debug + Send + Sync {
    /// Its sizes in the plan, and how many messages there are.
    fn status(&self) -> LogbookStatus;
    /// Whoever wrote before has died: what he had not written to its end is aborted.
    fn abort_unfinished(&self);
    /// Adds a message. False: as many are on their way to the store as may be.
    fn write(&self, message: &[u8]) -> bool;
    /// Adds a message, or replaces the newest one that is on its way.
    fn overwrite(&self, message: &[u8]) -> bool;
    /// Copies a message, 0 the newest. `None`: there are not so many.
    fn read(&self, entry: u32, into: &mut Vec<u8>) -> Option<WriteStatus>;
    /// Removes all messages. False: one is on its way to the store.
    fn clear(&self) -> bool;
}

/// A logbook of the plan.
#[derive(Debug, Clone)]
pub struct PlannedLogbook {
    /// Its name.
    pub name: Name,
    /// Its memory.
    pub memory: Arc<dyn LogbookMemory>,
}

impl PartialEq for PlannedLogbook {
    /// The same memory.
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && Arc::ptr_eq(&self.memory, &other.memory)
    }
}

impl Eq for PlannedLogbook {}
