//! Processes that serve the executive and are not the executive, because they touch what a partition may have
//! damaged, or because they must outlive it. Each is a hidden verb of the command line.
//!
//! - the [`custodian`] creates the module's channels before frame 0 and holds them;
//! - a [`janitor`] removes what a dead partition left in shared memory, and ends;
//! - the [`guard`] waits for the executive's death and removes everything that it made.

pub mod custodian;
pub mod examiner;
pub mod guard;
pub mod janitor;
