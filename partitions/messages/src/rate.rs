//! The module's beat.

use crate::field::message;

message! {
    /// RateGenerator's events as counters: a receiver acts when a counter differs from the one it last saw, so
    /// that an event is neither lost by a late reader nor acted on twice.
    pub struct Rate {
        /// Synchronize events so far: sensors sample, the last cycle's actuators go out.
        pub synchronize: u64,
        /// Execute events so far: the sensor cut-off has passed, the chain runs.
        pub execute: u64,
        /// First telemetry time-out (Controller's navigation, GPS, OnBoardComputer's primary).
        pub timeout_1: u64,
        /// Second telemetry time-out (Servo).
        pub timeout_2: u64,
        /// Third telemetry time-out (Estimator, IMU, Controller, OnBoardComputer's secondary).
        pub timeout_3: u64,
        /// Module time of the last synchronize event, ns.
        pub synchronize_ns: u64,
        /// The instant after which this cycle's sensors are no longer taken, module time, ns.
        pub sensor_cutoff_ns: u64,
    }
}

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
