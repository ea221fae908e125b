//! Logbooks (ARINC 653 part 2): messages that outlive the partition, its executive and the machine's power.
//!
//! The executive makes the memory and copies from there to a file; nothing here waits for that. What a partition before this one had
//! written is there, and what it had not written to its end is aborted.
#![allow(unsafe_code)] // a descriptor that the executive left open

use std::os::fd::{FromRawFd, OwnedFd};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bateleur_contract::logbook::{Busy, LogbookCounts, WriteStatus};
use bateleur_contract::{LogbookDescription, LogbookSizes, MappedWords};
use bateleur_processes::logbooks::LogbookMemory;
use bateleur_processes::standard::{self, LogbookStatus};

use crate::context::StartError;

type Memory = bateleur_contract::Logbook<MappedWords>;

/// A logbook of the plan. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Logbook {
    name: Arc<str>,
    memory: Arc<Mutex<Memory>>,
}

/// Why a message is not written, or a logbook not emptied.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LogbookError {
    /// It has no bytes, or more than the plan says.
    #[error(
        "a message of {length} bytes for a logbook of messages of 1 to {most}: mend it, or `max_size` in the plan"
    )]
    Length {
        /// Its bytes.
        length: usize,
        /// What the plan allows.
        most: u32,
    },
    /// The store has not yet taken what was written before.
    #[error(
        "messages are on their way to the store: try again in a later window, or give the logbook a higher `max_in_progress` in the plan"
    )]
    Busy,
}

impl From<Busy> for LogbookError {
    fn from(_: Busy) -> Self {
        Self::Busy
    }
}

fn mapped(described: &LogbookDescription, file: OwnedFd) -> Result<Memory, StartError> {
    let memory = MappedWords::new(file).ok().and_then(|words| Memory::over(words, described.sizes));
    memory.ok_or_else(|| {
        StartError::Other(format!("the memory of logbook \"{}\" was not handed over", described.name))
    })
}

impl Logbook {
    /// Maps what the executive left open under a number. Done once for each.
    pub(crate) fn map(described: &LogbookDescription) -> Result<Self, StartError> {
        // SAFETY: the executive left it open where it says so, and nobody else in the process knows it.
        let file = unsafe { OwnedFd::from_raw_fd(described.descriptor) };
        let memory = Arc::new(Mutex::new(mapped(described, file)?));
        Ok(Self { name: described.name.as_str().into(), memory })
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Its name in the plan.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How much it holds.
    #[must_use]
    pub fn sizes(&self) -> LogbookSizes {
        self.memory().sizes()
    }

    /// WRITE_LOGBOOK: adds a message. The oldest one makes room for it when it is stored.
    ///
    /// # Errors
    /// Its length; or as many messages are on their way to the store as may be.
    pub fn write(&self, message: &[u8]) -> Result<(), LogbookError> {
        Ok(self.memory_for(message)?.write(message)?)
    }

    /// OVERWRITE_LOGBOOK: adds a message; where [`Logbook::write`] finds no room, the newest one that is on its way is replaced.
    ///
    /// # Errors
    /// Its length; or the plan's `max_in_progress` is 1.
    pub fn overwrite(&self, message: &[u8]) -> Result<(), LogbookError> {
        Ok(self.memory_for(message)?.overwrite(message)?)
    }

    fn memory_for(&self, message: &[u8]) -> Result<MutexGuard<'_, Memory>, LogbookError> {
        let (memory, length) = (self.memory(), message.len());
        let most = memory.sizes().message;
        if (1..=most as usize).contains(&length) {
            return Ok(memory);
        }
        Err(LogbookError::Length { length, most })
    }

    /// READ_LOGBOOK: a message, 0 is the newest one, and what has become of it. `None`: there are not so many.
    #[must_use]
    pub fn read(&self, entry: u32) -> Option<(WriteStatus, Vec<u8>)> {
        let mut message = Vec::new();
        self.memory().read(entry, &mut message).map(|status| (status, message))
    }

    /// CLEAR_LOGBOOK: removes all messages.
    ///
    /// # Errors
    /// One is on its way to the store.
    pub fn clear(&self) -> Result<(), LogbookError> {
        Ok(self.memory().clear()?)
    }

    /// GET_LOGBOOK_STATUS: how many messages there are.
    #[must_use]
    pub fn counts(&self) -> LogbookCounts {
        self.memory().counts()
    }

    /// What a partition before this one had not written to its end is aborted.
    pub(crate) fn abort_unfinished(&self) {
        self.memory().abort_unfinished();
    }
}

impl LogbookMemory for Logbook {
    fn status(&self) -> LogbookStatus {
        let (sizes, counts) = (self.sizes(), self.counts());
        let number = |number: u32| i32::try_from(number).unwrap_or(i32::MAX);
        LogbookStatus {
            max_message_size: number(sizes.message),
            max_logged: number(sizes.logged),
            max_in_progress: number(sizes.in_progress),
            logged: number(counts.logged),
            in_progress: number(counts.in_progress),
            aborted: number(counts.aborted),
        }
    }

    fn abort_unfinished(&self) {
        self.abort_unfinished();
    }

    fn write(&self, message: &[u8]) -> bool {
        self.memory().write(message).is_ok()
    }

    fn overwrite(&self, message: &[u8]) -> bool {
        self.memory().overwrite(message).is_ok()
    }

    fn read(&self, entry: u32, into: &mut Vec<u8>) -> Option<standard::WriteStatus> {
        Some(match self.memory().read(entry, into)? {
            WriteStatus::Aborted => standard::WriteStatus::Aborted,
            WriteStatus::InProgress => standard::WriteStatus::InProgress,
            WriteStatus::Complete => standard::WriteStatus::Complete,
        })
    }

    fn clear(&self) -> bool {
        self.memory().clear().is_ok()
    }
}

/// The executive's side of a logbook in a test.
#[derive(Debug)]
pub struct LogbookStore {
    memory: Memory,
    stored: u64,
}

impl LogbookStore {
    pub(crate) fn new(described: &LogbookDescription, file: OwnedFd) -> Result<Self, StartError> {
        Ok(Self { memory: mapped(described, file)?, stored: 0 })
    }

    /// Stores what was written since the last call, as the executive does between windows; the messages, `None` for one that was aborted.
    pub fn store(&mut self) -> Vec<Option<Vec<u8>>> {
        let (mut found, mut message) = (Vec::new(), Vec::new());
        while let Some(whole) = self.memory.claim(self.stored, &mut message) {
            self.stored += 1;
            self.memory.set_stored(self.stored);
            found.push(whole.then(|| message.clone()));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Context, Harness, Partition, Window};

    struct Pilot {
        events: Logbook,
        number: u8,
    }

    impl Partition for Pilot {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            Ok(Self { events: context.logbook("events")?, number: 0 })
        }

        fn window(&mut self, _: &Window) {
            self.number += 1;
            let _ = self.events.write(&[self.number; 3]);
        }
    }

    const SIZES: LogbookSizes = LogbookSizes { message: 4, logged: 3, in_progress: 2 };

    #[test]
    fn a_partition_and_its_successor_write_into_one_logbook() {
        let mut harness = Harness::new("pilot").unwrap();
        let mut store = harness.logbook("events", SIZES).unwrap();
        let mut pilot = harness.start::<Pilot>().unwrap();
        (0..3).for_each(|_| pilot.window());
        assert_eq!(pilot.partition.events.counts().in_progress, 2, "the third finds no room");
        assert_eq!(store.store(), [Some(vec![1; 3]), Some(vec![2; 3])]);
        pilot.window();
        drop(pilot);
        let mut pilot = harness.start::<Pilot>().unwrap();
        assert_eq!(store.store(), [Some(vec![4; 3])]);
        pilot.window();
        let events = &pilot.partition.events;
        assert_eq!(events.read(0), Some((WriteStatus::InProgress, vec![1; 3])));
        assert_eq!(events.read(1), Some((WriteStatus::Complete, vec![4; 3])));
        assert_eq!((events.read(2).is_some(), events.read(3)), (true, None));
        assert_eq!(events.clear(), Err(LogbookError::Busy));
        store.store();
        assert_eq!((events.clear(), events.read(0)), (Ok(()), None));
    }

    #[test]
    fn message_of_another_length_and_a_logbook_that_the_plan_does_not_have_are_refused_in_words() {
        let mut harness = Harness::new("pilot").unwrap();
        assert!(
            harness
                .start::<Pilot>()
                .err()
                .unwrap()
                .to_string()
                .contains("no logbook \"events\"; it has none")
        );
        harness.logbook("events", SIZES).unwrap();
        let pilot = harness.start::<Pilot>().unwrap();
        let events = &pilot.partition.events;
        for length in [0, 5] {
            assert_eq!(events.write(&vec![1; length]), Err(LogbookError::Length { length, most: 4 }));
        }
        assert_eq!((events.name(), events.sizes()), ("events", SIZES));
    }
}
