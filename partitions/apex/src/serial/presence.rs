//! Whether the device is there, when to try again, and what to say about it.

/// Between two attempts to open the device, module time, ns: an adapter that is plugged in again takes about as long.
const RETRY_NS: u64 = 1_000_000_000;

/// What is worth a line in the health log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// The device was there and is gone, or was missing from the start.
    Lost,
    /// The device is there after it was missing.
    Found,
}

/// The state of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Presence {
    open: bool,
    reported: bool,
    next_ns: u64,
}

impl Presence {
    /// Goes on after an incarnation that had reported the device missing, or had not.
    #[must_use]
    pub fn after(reported: bool) -> Self {
        Self { reported, ..Self::default() }
    }

    /// It was reported missing.
    pub fn is_reported(&self) -> bool {
        self.reported
    }

    /// The device is open.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// It is time to try to open it.
    pub fn is_due(&self, now_ns: u64) -> bool {
        !self.open && now_ns >= self.next_ns
    }

    /// It was opened.
    pub fn opened(&mut self) -> Option<Change> {
        self.open = true;
        std::mem::take(&mut self.reported).then_some(Change::Found)
    }

    /// It could not be opened, or it failed. Reported once until it is back.
    pub fn failed(&mut self, now_ns: u64) -> Option<Change> {
        self.open = false;
        self.next_ns = now_ns.saturating_add(RETRY_NS);
        (!std::mem::replace(&mut self.reported, true)).then_some(Change::Lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: u64 = 20_000_000;

    #[test]
    fn a_missing_device_is_reported_once_and_tried_once_a_second() {
        let mut presence = Presence::default();
        let mut reports = 0;
        let mut attempts = 0;
        for window in 0..500 {
            if presence.is_due(window * CYCLE) {
                attempts += 1;
                reports += usize::from(presence.failed(window * CYCLE).is_some());
            }
        }
        assert_eq!((attempts, reports), (10, 1));
    }

    #[test]
    fn a_device_that_comes_back_and_goes_again_is_reported_each_time() {
        let mut presence = Presence::default();
        assert_eq!(presence.opened(), None); // there from the start: nothing to say
        assert_eq!(presence.failed(CYCLE), Some(Change::Lost));
        assert!(!presence.is_due(2 * CYCLE));
        assert!(presence.is_due(60 * CYCLE));
        assert_eq!(presence.opened(), Some(Change::Found));
        assert!(presence.is_open());
        assert_eq!(presence.failed(61 * CYCLE), Some(Change::Lost));
    }
}
