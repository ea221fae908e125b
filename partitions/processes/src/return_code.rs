//! The return codes of ARINC 653 services.

/// Why a service did not do what it was asked to; the numbers are those of the standard, whose NO_ERROR (0) is `Ok` here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[repr(u32)]
pub enum ReturnCode {
    /// It is so already.
    #[error("NO_ACTION: it is so already")]
    NoAction = 1,
    /// Not now.
    #[error("NOT_AVAILABLE: not now")]
    NotAvailable = 2,
    /// A parameter means nothing.
    #[error("INVALID_PARAM: a parameter means nothing")]
    InvalidParam = 3,
    /// The plan does not provide it.
    #[error("INVALID_CONFIG: the plan does not provide it")]
    InvalidConfig = 4,
    /// Not in this mode.
    #[error("INVALID_MODE: not in this mode")]
    InvalidMode = 5,
    /// It took too long.
    #[error("TIMED_OUT: it took too long")]
    TimedOut = 6,
}
