//! What the module's health log says, for a partition that the plan lets know (`health_texts`): no service of ARINC 653.

use crate::time::Time;

/// An entry of the health log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HealthNotice {
    /// As in syslog: 1 alert, 2 critical, 3 error, 4 warning, 5 notice.
    pub severity: u8,
    /// Who, what, and what was done about it; 128 bytes at most.
    pub text: String,
}

/// The entries, in their order. Where the plan does not let this partition know, there are none.
#[derive(Debug)]
pub struct HealthNotices {
    time: Time,
    seen: u32,
    lost: u64,
}

impl HealthNotices {
    pub(crate) fn new(time: Time) -> Self {
        Self { time, seen: 0, lost: 0 }
    }

    /// Entries that were read or passed over so far, for retained memory.
    pub fn position(&self) -> u32 {
        self.seen
    }

    /// Goes on behind the entry at which the incarnation before stood.
    pub fn resume(&mut self, position: u32) {
        self.seen = position;
    }

    /// Entries that were overwritten before they were read, since it was last asked.
    pub fn take_lost(&mut self) -> u64 {
        std::mem::take(&mut self.lost)
    }
}

impl Iterator for HealthNotices {
    type Item = HealthNotice;

    fn next(&mut self) -> Option<HealthNotice> {
        let time = self.time.clone();
        let (severity, text) = time.page().next_notice(&mut self.seen, &mut self.lost)?;
        Some(HealthNotice { severity: severity.min(7) as u8, text })
    }
}
