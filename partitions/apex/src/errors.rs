//! Errors that the plan leaves to the partition itself, as its handler sees them.

use bateleur_contract::ErrorCode;

/// An error of this partition (GET_ERROR_STATUS).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HealthError {
    /// What it is.
    pub code: ErrorCode,
    /// What is known beside it, 128 bytes at most.
    pub message: String,
}

/// What an error handler decides (SET_PARTITION_MODE).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Response {
    /// The partition goes on, with the window that has begun.
    GoOn,
    /// It starts again and finds its retained memory.
    WarmRestart,
    /// It starts again from nothing.
    ColdRestart,
    /// It ends, and its windows pass.
    Idle,
}
