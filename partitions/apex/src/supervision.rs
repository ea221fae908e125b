//! Whether what a function lives on outside of the module is there: a simulator, sensors on a bus. Counted in windows, not in time:
//! what was not asked in a window that was skipped did not fail to answer.

/// Windows without an answer after which it counts as gone: one second at 50 Hz, longer than a network takes
/// to find a host and shorter than a person needs to wonder.
const GONE_AFTER: u32 = 50;
/// Windows without an answer up to which the link counts as working.
const READY_WITHIN: u32 = 5;

/// What is to be reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SupervisionEvent {
    /// It does not answer.
    Gone,
    /// It answers again.
    Back,
}

/// Counts silent windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Supervision {
    silent: u32,
}

impl Default for Supervision {
    /// Nobody has answered yet, but there was no time to either.
    fn default() -> Self {
        Self { silent: READY_WITHIN }
    }
}

impl Supervision {
    /// Notes a window; gives what is to be reported, once for each change.
    pub fn note(&mut self, answered: bool) -> Option<SupervisionEvent> {
        let gone = self.silent >= GONE_AFTER;
        if answered {
            self.silent = 0;
            return gone.then_some(SupervisionEvent::Back);
        }
        self.silent = self.silent.saturating_add(1);
        (self.silent == GONE_AFTER).then_some(SupervisionEvent::Gone)
    }

    /// It answers.
    pub fn is_ready(&self) -> bool {
        self.silent < READY_WITHIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_simulator_that_goes_is_reported_once_and_once_more_when_it_is_back() {
        let mut supervision = Supervision::default();
        assert!(!supervision.is_ready());
        assert_eq!(supervision.note(true), None);
        assert!(supervision.is_ready());
        let events: Vec<_> = (0..500).filter_map(|_| supervision.note(false)).collect();
        assert_eq!(events, [SupervisionEvent::Gone]);
        assert!(!supervision.is_ready());
        assert_eq!(supervision.note(true), Some(SupervisionEvent::Back));
        assert_eq!(supervision.note(true), None);
    }

    #[test]
    fn a_few_lost_answers_are_not_worth_a_report() {
        let mut supervision = Supervision::default();
        let events = (0..1_000).filter_map(|window| supervision.note(window % 40 == 0)).count();
        assert_eq!(events, 0);
    }
}
