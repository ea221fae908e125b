//! The memories of a module's logbooks: made before frame 0, and handed to the partition that the plan gives each.
//!
//! A partition can spoil the memory of its own logbooks only, whose content reaches the file through bounds (`bateleur_contract::logbook`).

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use bateleur_contract::{LogbookDescription, LogbookSizes};
use bateleur_plan::{Logbook, ModuleView, Partition, PartitionId};
use rustix::fs::SealFlags;

use crate::sealed::{Handover, seal, unsealed};

/// What the names of their memories begin with, as a map of the process shows them.
const MEMORY_NAME: &str = "logbook";

/// How much a logbook holds.
#[must_use]
pub fn sizes(logbook: &Logbook) -> LogbookSizes {
    LogbookSizes {
        message: logbook.max_size_bytes,
        logged: logbook.max_logged,
        in_progress: logbook.max_in_progress,
    }
}

/// What a logbook is called among all of the module. No other thing that outlives an executive has a point in its name.
#[must_use]
pub fn path(partition: &Partition, logbook: &Logbook) -> String {
    format!("{}.{}", partition.name, logbook.name)
}

/// All logbooks of a module, each with its path.
pub fn of_module<'p>(view: &ModuleView<'p>) -> impl Iterator<Item = (String, &'p Logbook)> + use<'p> {
    let plan = view.plan();
    let partitions: Vec<PartitionId> = view.partitions().collect();
    partitions.into_iter().flat_map(|id| {
        let partition = &plan[id];
        partition.logbooks.iter().map(|logbook| (path(partition, logbook), logbook))
    })
}

/// Memory for a logbook, without a message.
///
/// # Errors
/// The machine has no memory or no descriptor left.
pub fn make(path: &str, logbook: &Logbook) -> io::Result<OwnedFd> {
    let memory = unsealed(&format!("{MEMORY_NAME} {path}"), sizes(logbook).bytes())?;
    seal(&memory, SealFlags::empty())?;
    Ok(memory)
}

/// The memories of a module's logbooks, by path.
#[derive(Debug, Default)]
pub struct LogbookMemories(BTreeMap<String, Arc<OwnedFd>>);

impl LogbookMemories {
    /// Of all logbooks: those that outlive the executive as they are, and new ones.
    ///
    /// # Errors
    /// As [`make`], with which one it is.
    pub fn begin(view: &ModuleView<'_>, kept: &BTreeMap<String, Arc<OwnedFd>>) -> io::Result<Self> {
        let begun = of_module(view).map(|(path, logbook)| {
            let memory = match kept.get(&path) {
                Some(memory) => memory.clone(),
                None => Arc::new(
                    make(&path, logbook)
                        .map_err(|error| io::Error::new(error.kind(), format!("logbook {path}: {error}")))?,
                ),
            };
            Ok((path, memory))
        });
        begun.collect::<io::Result<_>>().map(Self)
    }

    /// The memory of a logbook.
    #[must_use]
    pub fn get(&self, path: &str) -> Option<&OwnedFd> {
        self.0.get(path).map(Arc::as_ref)
    }

    /// Those of a partition.
    pub(crate) fn of(&self, partition: &Partition) -> GivenLogbooks {
        let given = partition.logbooks.iter().filter_map(|logbook| {
            let memory = self.0.get(&path(partition, logbook))?.clone();
            let (name, descriptor) = (logbook.name.clone(), -1); // as it is handed over
            Some((LogbookDescription { name, sizes: sizes(logbook), descriptor }, memory))
        });
        GivenLogbooks(given.collect())
    }
}

/// The logbooks of one partition.
#[derive(Debug)]
pub(crate) struct GivenLogbooks(Vec<(LogbookDescription, Arc<OwnedFd>)>);

impl GivenLogbooks {
    /// Adds their memories to `handover`; says which they are, and where.
    ///
    /// # Errors
    /// The executive has no descriptor left.
    pub(crate) fn hand(&self, handover: &mut Handover) -> io::Result<Vec<LogbookDescription>> {
        let hand = |(described, file): &(LogbookDescription, Arc<OwnedFd>)| {
            Ok(LogbookDescription { descriptor: handover.add(file.try_clone()?), ..described.clone() })
        };
        self.0.iter().map(hand).collect()
    }
}
