//! Whether sensors come.

/// Windows without a set of sensors after which they count as gone: one second at 50 Hz.
const GONE_AFTER: u32 = 50;
/// Windows without one up to which the bus counts as working.
const READY_WITHIN: u32 = 5;

/// What is to be reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// No sensors come.
    Gone,
    /// They come again.
    Back,
}

/// Counts windows without sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Supervision {
    silent: u32,
}

impl Default for Supervision {
    /// Nothing has come yet, but there was no time to either.
    fn default() -> Self {
        Self { silent: READY_WITHIN }
    }
}

impl Supervision {
    /// Notes a window; gives what is to be reported, once for each change.
    pub fn note(&mut self, came: bool) -> Option<Event> {
        let gone = self.silent >= GONE_AFTER;
        if came {
            self.silent = 0;
            return gone.then_some(Event::Back);
        }
        self.silent = self.silent.saturating_add(1);
        (self.silent == GONE_AFTER).then_some(Event::Gone)
    }

    /// Sensors come.
    pub fn is_ready(&self) -> bool {
        self.silent < READY_WITHIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_that_fail_to_come_are_reported_once_and_once_more_when_they_are_back() {
        let mut supervision = Supervision::default();
        assert!(!supervision.is_ready());
        let events: Vec<_> = [true]
            .into_iter()
            .chain([false; 99])
            .chain([true; 2])
            .filter_map(|came| supervision.note(came))
            .collect();
        assert_eq!(events, [Event::Gone, Event::Back]);
        assert!(supervision.is_ready());
    }
}
