//! The function that gives the module its beat: synchronize, execute and the telemetry time-outs.
//!
//! Responsible for: turning module time into the counters of [`Rate`]. It must never count by itself: every counter
//! is a function of module time alone, so that a restarted generator goes on where the one before was, and one that
//! missed a window misses no event.
//!
//! Where the events lie, with the usual period of 20 ms and cut-off of 3 ms:
//!
//! ```text
//! 0          3                     11.5                 20 ms
//! |synchronize                      |                    |
//! |          |execute: the chain    |time-outs           |synchronize
//! ```
//!
//! Time-outs that fell on the execute instant made the chain late every half second in an earlier system. Here they
//! lie half-way between the execute instant and the next synchronize event, and since each is a whole number of
//! cycles long, there they stay. Each of the three has another cycle besides, so that the usual 2 s, 1 s and 0.5 s
//! never ask for all telemetry at once.

use bateleur_messages::Rate;
use bateleur_messages::parameter::{Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_RATE_GENERATOR;

/// What the plan may set, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Periods {
    /// From one synchronize event to the next.
    pub sync_ns: u64,
    /// From a synchronize event to the end of taking sensors, which is the execute instant.
    pub cutoff_ns: u64,
    /// The three telemetry time-outs.
    pub timeouts_ns: [u64; 3],
}

impl Default for Periods {
    /// The seed's: 50 Hz; telemetry every 2 s, 1 s and 0.5 s.
    fn default() -> Self {
        Self {
            sync_ns: 20_000_000,
            cutoff_ns: 3_000_000,
            timeouts_ns: [2_000_000_000, 1_000_000_000, 500_000_000],
        }
    }
}

/// What the ground can read. Nothing can be set: the beat is a function of module time and the plan alone.
pub fn parameters() -> Parameters<Periods> {
    Parameters::new(FROM_RATE_GENERATOR, ROWS)
}

static ROWS: &[Row<Periods>] = &[
    Row::fixed("RAT_SYNC", Kind::Real, |p| Some(p.sync_ns as f64 * 1e-9)),
    Row::fixed("RAT_CUTOFF", Kind::Real, |p| Some(p.cutoff_ns as f64 * 1e-9)),
    Row::fixed("RAT_TIMEOUT_1", Kind::Real, |p| Some(p.timeouts_ns[0] as f64 * 1e-9)),
    Row::fixed("RAT_TIMEOUT_2", Kind::Real, |p| Some(p.timeouts_ns[1] as f64 * 1e-9)),
    Row::fixed("RAT_TIMEOUT_3", Kind::Real, |p| Some(p.timeouts_ns[2] as f64 * 1e-9)),
];

/// Why periods can not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PeriodError {
    /// No time passes in a cycle.
    #[error("sync_period is 0: give the length of a cycle, such as \"20ms\"")]
    NoCycle,
    /// Sensors would be taken until after the next synchronize event.
    #[error("sensor_cutoff_delay ({cutoff_ns} ns) must be less than sync_period ({sync_ns} ns)")]
    CutoffTooLate {
        /// The delay.
        cutoff_ns: u64,
        /// The cycle.
        sync_ns: u64,
    },
    /// A time-out would move through the cycle and meet the execute instant.
    #[error(
        "timeout_{number} ({timeout_ns} ns) must be a whole number of cycles of {sync_ns} ns, at least one"
    )]
    TimeoutNotWhole {
        /// 1, 2 or 3.
        number: usize,
        /// The time-out.
        timeout_ns: u64,
        /// The cycle.
        sync_ns: u64,
    },
}

/// The counters as a function of module time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Beat {
    periods: Periods,
}

impl Beat {
    /// A beat of the given periods.
    pub fn new(periods: Periods) -> Result<Self, PeriodError> {
        let Periods { sync_ns, cutoff_ns, timeouts_ns } = periods;
        if sync_ns == 0 {
            return Err(PeriodError::NoCycle);
        }
        if cutoff_ns >= sync_ns {
            return Err(PeriodError::CutoffTooLate { cutoff_ns, sync_ns });
        }
        for (timeout_ns, number) in timeouts_ns.into_iter().zip(1..) {
            if timeout_ns == 0 || !timeout_ns.is_multiple_of(sync_ns) {
                return Err(PeriodError::TimeoutNotWhole { number, timeout_ns, sync_ns });
            }
        }
        Ok(Self { periods })
    }

    /// The counters at module time `now_ns`.
    pub fn at(&self, now_ns: u64) -> Rate {
        let Periods { sync_ns, cutoff_ns, .. } = self.periods;
        let cycle = now_ns / sync_ns;
        let synchronize_ns = cycle * sync_ns;
        let executed = now_ns - synchronize_ns >= cutoff_ns;
        Rate {
            synchronize: cycle + 1, // the first is at module time 0
            execute: cycle + u64::from(executed),
            timeout_1: self.timeout(0, now_ns),
            timeout_2: self.timeout(1, now_ns),
            timeout_3: self.timeout(2, now_ns),
            synchronize_ns,
            sensor_cutoff_ns: synchronize_ns + cutoff_ns,
        }
    }

    /// How often a time-out has passed; the first time one whole time-out after its offset.
    fn timeout(&self, index: usize, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.offset_ns(index)) / self.periods.timeouts_ns[index]
    }

    /// Half-way between the execute instant and the next synchronize event, each time-out in another cycle.
    fn offset_ns(&self, index: usize) -> u64 {
        let Periods { sync_ns, cutoff_ns, .. } = self.periods;
        index as u64 * sync_ns + (cutoff_ns + sync_ns).div_ceil(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn beat() -> Beat {
        Beat::new(Periods::default()).unwrap()
    }

    #[test]
    fn each_cycle_has_one_synchronize_and_one_execute_event() {
        let start = beat().at(0);
        assert_eq!((start.synchronize, start.execute), (1, 0));
        let cutoff = beat().at(3 * MS);
        assert_eq!((cutoff.synchronize, cutoff.execute), (1, 1));
        let later = beat().at(60 * MS);
        assert_eq!((later.synchronize, later.execute), (4, 3));
        assert_eq!((later.synchronize_ns, later.sensor_cutoff_ns), (60 * MS, 63 * MS));
    }

    #[test]
    fn a_restarted_generator_says_the_same_as_one_that_never_stopped() {
        let now_ns = 7_213 * 20 * MS + 300;
        assert_eq!(beat().at(now_ns), Beat::new(Periods::default()).unwrap().at(now_ns));
    }

    #[test]
    fn time_outs_are_as_far_apart_as_the_plan_says() {
        let (start, end) = (beat().at(10_000 * MS), beat().at(30_000 * MS));
        assert_eq!(end.timeout_1 - start.timeout_1, 10);
        assert_eq!(end.timeout_2 - start.timeout_2, 20);
        assert_eq!(end.timeout_3 - start.timeout_3, 40);
        assert_eq!(beat().at(400 * MS).timeout_3, 0);
    }

    #[test]
    fn no_time_out_falls_near_an_execute_instant() {
        for step in 1..40_000 {
            let now_ns = step * MS / 2;
            let (before, after) = (beat().at(now_ns - MS / 2), beat().at(now_ns));
            let timed_out = before.timeout_1 != after.timeout_1
                || before.timeout_2 != after.timeout_2
                || before.timeout_3 != after.timeout_3;
            if timed_out {
                let into_cycle = now_ns % (20 * MS);
                assert!((11 * MS..=13 * MS).contains(&into_cycle), "{into_cycle}");
            }
        }
    }

    #[test]
    fn no_two_time_outs_fall_into_the_same_cycle() {
        let mut before = beat().at(0);
        for cycle in 1..2_000 {
            let now = beat().at(cycle * 20 * MS);
            let due = [
                now.timeout_1 - before.timeout_1,
                now.timeout_2 - before.timeout_2,
                now.timeout_3 - before.timeout_3,
            ];
            assert!(due.iter().sum::<u64>() <= 1, "cycle {cycle}: {due:?}");
            before = now;
        }
    }

    #[test]
    fn periods_that_would_let_events_meet_are_refused() {
        let usual = Periods::default();
        let refused = |periods| Beat::new(periods).unwrap_err().to_string();
        assert!(refused(Periods { sync_ns: 0, ..usual }).contains("sync_period is 0"));
        assert!(refused(Periods { cutoff_ns: 20 * MS, ..usual }).contains("sensor_cutoff_delay"));
        let drifting = Periods { timeouts_ns: [2_000 * MS, 1_010 * MS, 500 * MS], ..usual };
        assert!(refused(drifting).starts_with("timeout_2"));
    }
}
