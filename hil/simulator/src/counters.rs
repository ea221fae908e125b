//! What happened on the link, counted.

use serde::Serialize;
use std::fmt;

/// Counters of one session. None of them ever stops the flight; they are for the report at its end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Sensor sets computed (repeats not counted).
    pub answers: u64,
    /// Answers sent again because the same time was asked for again.
    pub repeated: u64,
    /// Actuator packets older than the newest answer, ignored.
    pub older: u64,
    /// Gaps too long to catch up with, skipped.
    pub pauses: u64,
    /// Module time skipped with them, ns.
    pub skipped_ns: u64,
    /// Questions that were not answered because of a planned pause.
    pub withheld: u64,
    /// Times that the module's clock began anew.
    pub clock_restarts: u64,
    /// Orders to the safety pilot.
    pub pilot_orders: u64,
    /// Datagrams that held something else than actuators or pilot orders, in whole or in part.
    pub garbage: u64,
    /// Datagrams that could not be sent.
    pub unsent: u64,
    /// Truth records that could not be written.
    pub unlogged: u64,
}

impl fmt::Display for Counters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} answers, {} repeated, {} older packets", self.answers, self.repeated, self.older)?;
        write!(f, ", {} pauses ({:.1} s skipped)", self.pauses, self.skipped_ns as f64 * 1e-9)?;
        write!(f, ", {} clock restarts, {} datagrams of garbage", self.clock_restarts, self.garbage)?;
        if self.withheld > 0 {
            write!(f, ", {} not answered in planned pauses", self.withheld)?;
        }
        write!(f, ", {} unsent, {} truth records lost", self.unsent, self.unlogged)
    }
}
