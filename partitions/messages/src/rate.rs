//! The module's beat.

/// Notices that a counter has changed since it was last looked at.
///
/// The first look only remembers, so that a function that was restarted does not act at once; several events
/// that were missed count as one.
#[derive(Debug, Clone, Copy, Default)]
pub struct Watch {
    last: Option<u64>,
}

impl Watch {
    /// Whether `counter` differs from the one before.
    pub fn changed(&mut self, counter: u64) -> bool {
        self.last.replace(counter).is_some_and(|last| last != counter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_counts_once_and_the_first_look_only_remembers() {
        let mut watch = Watch::default();
        let seen = [7, 7, 8, 8, 11, 11].map(|counter| watch.changed(counter));
        assert_eq!(seen, [false, false, true, false, true, false]);
    }

    #[test]
    fn a_generator_that_began_anew_counts_as_one_event() {
        let mut watch = Watch::default();
        let seen = [90, 0, 0].map(|counter| watch.changed(counter));
        assert_eq!(seen, [false, true, false]);
    }
}
