//! The simulator's time stamps in module time.
//!
//! A simulator that follows the module stamps its sensors with the time that it was asked for: such a stamp is taken as it is. One
//! with a clock of its own, whatever its zero, is tied to module time by its first stamp, and from then on by the
//! difference alone: that its stamps meet the time of a question now and then means nothing, unless three on end
//! repeat the newest question each time, as only one that follows the module now does. What lies more than a second beside
//! the module's time is not believed, unless the simulator's clock went there step by step, or nothing else has come for
//! a second.

use std::collections::VecDeque;

/// Further from module time than this, a stamp needs another reason to be believed, ns.
const NEAR_NS: i128 = 1_000_000_000;
/// The longest step between two stamps of a clock that runs, µs.
const STEP_US: u64 = 1_000_000;
/// Questions that are remembered, so that a late answer is known as such: more than a second's.
const REMEMBERED: usize = 64;
/// Stamps on end that repeat the newest question, after which a simulator with a clock of its own is taken for one that
/// follows the module.
const ECHOES: u32 = 3;
/// A stamp that repeats a question may be rounded in the last digit, µs.
const ROUNDING_US: u64 = 1;
const NS_PER_US: i128 = 1_000;

/// Why a stamp means nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Unbelievable;

/// What ties the simulator's clock to the module's.
#[derive(Debug, Clone, Default)]
pub(super) struct Clock {
    /// Module time less the simulator's time, ns.
    offset_ns: Option<i128>,
    asked_ns: VecDeque<u64>,
    /// The last stamp that was believed, µs.
    last_us: u64,
    /// Stamps on end that repeated the newest question, the last of them for module time `echoed_ns`.
    echoes: u32,
    echoed_ns: u64,
    ties: u64,
}

impl Clock {
    /// A question is sent for module time `asked_ns`.
    pub(super) fn asks(&mut self, asked_ns: u64) {
        if self.asked_ns.len() == REMEMBERED {
            self.asked_ns.pop_front();
        }
        self.asked_ns.push_back(asked_ns);
    }

    /// Times that the simulator's clock was tied to module time.
    pub(super) fn ties(&self) -> u64 {
        self.ties
    }

    /// The simulator says that it began anew: its next stamp ties its clock.
    pub(super) fn reset(&mut self) {
        self.offset_ns = None;
    }

    /// Module time, ns, of a sensor stamp, µs. `alone`: nothing new has come for a second.
    pub(super) fn sensor_ns(&mut self, stamp_us: u64, alone: bool) -> Result<u64, Unbelievable> {
        let now_ns = self.now_ns();
        let beside_ns = self.offset_ns.map(|offset_ns| in_ns(stamp_us) + offset_ns - i128::from(now_ns));
        let asked_ns = self.asked_for(stamp_us);
        self.note_echo(asked_ns == Some(now_ns), now_ns);
        // A clock of its own that is tied, and makes sense, is not untied by a number that happens to be a question's.
        let is_own = self.offset_ns.is_some_and(|offset_ns| offset_ns != 0);
        let makes_sense = beside_ns.is_some_and(|beside_ns| beside_ns.abs() <= NEAR_NS);
        if let Some(asked_ns) = asked_ns.filter(|_| !is_own || !makes_sense || self.echoes >= ECHOES) {
            self.ties += u64::from(is_own);
            (self.offset_ns, self.last_us) = (Some(0), stamp_us);
            return Ok(asked_ns);
        }
        let walked = stamp_us > self.last_us && stamp_us - self.last_us <= STEP_US;
        let tie = match beside_ns {
            None => true,
            Some(beside_ns) if beside_ns.abs() <= NEAR_NS => false,
            // A simulator that is slower than the module falls behind step by step.
            Some(beside_ns) if beside_ns < 0 && walked => true,
            Some(_) if alone => true,
            Some(_) => return Err(Unbelievable),
        };
        if tie {
            self.offset_ns = Some(i128::from(now_ns) - in_ns(stamp_us));
            self.ties += 1;
        }
        self.last_us = stamp_us;
        self.elsewhere_ns(stamp_us)
    }

    /// Module time, ns, of a stamp of something that is not measured at the sampling instant, µs.
    pub(super) fn elsewhere_ns(&self, stamp_us: u64) -> Result<u64, Unbelievable> {
        let time_ns = in_ns(stamp_us) + self.offset_ns.ok_or(Unbelievable)?;
        match (time_ns - i128::from(self.now_ns())).abs() <= 2 * NEAR_NS {
            true => Ok(u64::try_from(time_ns).unwrap_or(0)),
            false => Err(Unbelievable),
        }
    }

    /// Counts stamps on end that repeat the newest question. The answer that comes twice counts once.
    fn note_echo(&mut self, is_echo: bool, now_ns: u64) {
        if !is_echo {
            self.echoes = 0;
        } else if self.echoes == 0 || self.echoed_ns != now_ns {
            (self.echoes, self.echoed_ns) = (self.echoes.saturating_add(1), now_ns);
        }
    }

    fn now_ns(&self) -> u64 {
        self.asked_ns.back().copied().unwrap_or_default()
    }

    /// The question's time that a stamp repeats. Stamps hold microseconds, questions may not be whole ones.
    fn asked_for(&self, stamp_us: u64) -> Option<u64> {
        self.asked_ns
            .iter()
            .rev()
            .copied()
            .find(|asked_ns| (asked_ns / 1_000).abs_diff(stamp_us) <= ROUNDING_US)
    }
}

fn in_ns(stamp_us: u64) -> i128 {
    i128::from(stamp_us) * NS_PER_US
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: u64 = 20_000_000;

    #[test]
    fn stamp_of_the_question_is_its_time_to_the_nanosecond() {
        let mut clock = Clock::default();
        clock.asks(CYCLE + 7);
        assert_eq!(clock.sensor_ns(20_000, false), Ok(CYCLE + 7));
        clock.asks(2 * CYCLE);
        assert_eq!(clock.sensor_ns(20_000, false), Ok(CYCLE + 7), "a late answer keeps its time");
        assert_eq!(clock.ties(), 0);
    }

    #[test]
    fn clock_of_the_simulators_own_is_tied_once_and_then_runs_by_itself() {
        let mut clock = Clock::default();
        let epoch_us = 1_700_000_000_000_000;
        for cycle in 1..200 {
            clock.asks(cycle * CYCLE);
            let stamped = clock.sensor_ns(epoch_us + (cycle - 1) * 20_100, false).unwrap();
            assert_eq!(stamped, CYCLE + (cycle - 1) * 20_100_000);
        }
        assert_eq!(clock.ties(), 1);
    }

    #[test]
    fn own_clock_in_lockstep_whose_stamps_are_the_last_questions_stays_tied_to_the_newest() {
        let mut clock = Clock::default();
        for cycle in 1..200 {
            clock.asks(cycle * CYCLE + 500_000);
            let stamp_us = (cycle - 1) * 20_000 + 500;
            assert_eq!(clock.sensor_ns(stamp_us, false), Ok(cycle * CYCLE + 500_000));
        }
        assert_eq!(clock.ties(), 1);
    }

    #[test]
    fn own_clock_that_meets_a_question_is_not_shifted_by_it() {
        let mut clock = Clock::default();
        clock.asks(CYCLE);
        clock.sensor_ns(7, false).unwrap();
        for cycle in 2..200 {
            clock.asks(cycle * CYCLE);
            // An old question's time, and once in three cycles the newest one's.
            for stamp_us in [(cycle - 1) * 20_000, cycle * 20_000 - 4_000 + u64::from(cycle % 3 == 0) * 4_000]
            {
                let time_ns = clock.sensor_ns(stamp_us, false).unwrap();
                assert_eq!(time_ns, CYCLE + (stamp_us - 7) * 1_000, "cycle {cycle}");
            }
        }
        assert_eq!(clock.ties(), 1);
    }

    #[test]
    fn simulator_that_comes_to_repeat_the_questions_is_believed_after_three_of_them_or_at_once_if_far_away() {
        for (own_us, believed_at) in [(300_000, 13), (1_700_000_000_000_000, 11)] {
            let mut clock = Clock::default();
            for cycle in 1..=10 {
                clock.asks(cycle * CYCLE);
                clock.sensor_ns(own_us + cycle * 20_000, false).unwrap();
            }
            for cycle in 11..20 {
                clock.asks(cycle * CYCLE);
                for _ in 0..2 {
                    let is_echo = clock.sensor_ns(cycle * 20_000, false) == Ok(cycle * CYCLE);
                    assert_eq!(is_echo, cycle >= believed_at, "cycle {cycle} of {own_us}");
                }
            }
            assert_eq!(clock.ties(), 2);
        }
    }

    #[test]
    fn stamp_of_the_question_that_was_rounded_is_its_time_all_the_same() {
        let mut clock = Clock::default();
        for cycle in 1..100 {
            clock.asks(cycle * CYCLE);
            assert_eq!(clock.sensor_ns(cycle * 20_000 + cycle % 3 - 1, false), Ok(cycle * CYCLE));
        }
        assert_eq!(clock.ties(), 0);
    }

    #[test]
    fn one_stamp_from_the_future_is_not_believed_and_does_no_harm() {
        let mut clock = Clock::default();
        clock.asks(CYCLE);
        clock.sensor_ns(20_000, false).unwrap();
        clock.asks(2 * CYCLE);
        for stamp_us in [u64::MAX, 5_000_000] {
            assert_eq!(clock.sensor_ns(stamp_us, false), Err(Unbelievable));
            assert_eq!(clock.elsewhere_ns(stamp_us), Err(Unbelievable));
        }
        assert_eq!(clock.sensor_ns(40_000, false), Ok(2 * CYCLE));
    }

    #[test]
    fn simulator_that_is_slower_than_the_module_stays_within_a_second_of_it() {
        let mut clock = Clock::default();
        for cycle in 1..1_000 {
            clock.asks(cycle * CYCLE);
            let time_ns = clock.sensor_ns(77 + cycle * 4_000, false).unwrap();
            assert!((cycle * CYCLE).abs_diff(time_ns) <= 1_000_000_000);
        }
        assert!((10..30).contains(&clock.ties()), "{}", clock.ties());
    }

    #[test]
    fn simulator_started_anew_is_believed_after_a_second_alone_or_when_it_says_so() {
        let mut clock = Clock::default();
        for cycle in 1..500 {
            clock.asks(cycle * CYCLE);
            clock.sensor_ns(9_000_000_000 + cycle * 20_000, false).unwrap();
        }
        clock.asks(500 * CYCLE);
        assert_eq!(clock.sensor_ns(33, false), Err(Unbelievable));
        assert_eq!(clock.sensor_ns(34, true), Ok(500 * CYCLE));
        clock.reset();
        assert_eq!(clock.sensor_ns(700, false), Ok(500 * CYCLE));
        assert_eq!(clock.ties(), 3);
    }

    #[test]
    fn a_fix_before_the_first_sensors_has_no_time() {
        let mut clock = Clock::default();
        clock.asks(CYCLE);
        assert_eq!(clock.elsewhere_ns(10_000), Err(Unbelievable));
        clock.sensor_ns(20_000, false).unwrap();
        assert_eq!(clock.elsewhere_ns(10_000), Ok(10_000_000));
    }
}
