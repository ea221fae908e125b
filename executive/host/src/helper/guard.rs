//! Waits for the executive's end, then ends its partitions and helpers and removes its control group and shared memory: also after
//! `kill -9`, nothing is left. An executive that has cleaned up itself ends its guard before.

use std::io::{self, Read};

use crate::instance::{Instance, sweep_traces};
use bateleur_system::tree::NotRemoved;

/// Why the guard could not do its work.
#[derive(Debug, thiserror::Error)]
pub enum GuardError {
    /// What it was told is damaged.
    #[error("the guard's order is damaged: {0}")]
    Order(#[from] serde_json::Error),
    /// Its line to the executive.
    #[error("the guard can not listen: {0}")]
    Line(#[from] io::Error),
    /// Something stays: the next start tries again.
    #[error(transparent)]
    NotRemoved(#[from] NotRemoved),
}

/// The guard's life. Its standard input is a pipe whose other end only the executive holds.
///
/// # Errors
/// See [`GuardError`].
pub fn run(instance: &str) -> Result<(), GuardError> {
    let _ = rustix::thread::set_name(c"guard"); // a name is a comfort
    let instance: Instance = serde_json::from_str(instance)?;
    io::stdin().read_to_end(&mut Vec::new())?;
    instance.clean_up()?;
    // Another executive, which does so itself, must not wait for it.
    if !instance.supervised {
        sweep_traces();
    }
    Ok(())
}
