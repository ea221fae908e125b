//! How well the windows kept their times.

use crate::envelope::Envelope;
use crate::flight::seconds;
use crate::run::Clock;
use crate::windows::Window;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The partitions of the flight chain: from the first of them that opens to the last one's close is the chain's
/// execution time, the seed's "about 13 ms of 20 ms".
pub const CHAIN: [&str; 5] = ["gps", "imu", "estimator", "controller", "servo"];
/// Longest time told apart, ns: beyond it stands for "a minute or more".
const LONGEST_NS: u64 = 60_000_000_000;
/// Significant decimal digits kept of each time.
const DIGITS: u8 = 3;
/// Steps of a distribution.
const SHARES: u64 = 60;

/// Percentiles of a time, µs, each to three significant digits, the greatest exactly.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p999: f64,
    /// Greatest.
    pub max: f64,
}

/// Times, ns, as they come in.
pub struct Times {
    histogram: Option<Histogram<u64>>,
    max_ns: u64,
    count: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self { histogram: Histogram::new_with_bounds(1, LONGEST_NS, DIGITS).ok(), max_ns: 0, count: 0 }
    }
}

impl Times {
    /// Counts one.
    pub fn record(&mut self, ns: u64) {
        if let Some(histogram) = &mut self.histogram {
            histogram.saturating_record(ns);
        }
        self.max_ns = self.max_ns.max(ns);
        self.count += 1;
    }

    /// The percentiles; `None` before the first time came in.
    pub fn percentiles(&self) -> Option<Percentiles> {
        let histogram = self.histogram.as_ref().filter(|_| self.count > 0)?;
        // A histogram answers with the upper end of its bucket, which may lie above the greatest value.
        let at = |quantile| histogram.value_at_quantile(quantile).min(self.max_ns) as f64 / 1000.0;
        Some(Percentiles { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: self.max_ns as f64 / 1000.0 })
    }

    /// The distribution: time, µs, and the share of all times within the step that begins there, %. Ends where 99.9 % lie
    /// below, so that one outlier does not flatten the rest.
    pub fn shares(&self) -> Vec<(f64, f64)> {
        let Some(histogram) = self.histogram.as_ref().filter(|_| self.count > 0) else { return Vec::new() };
        let last_ns = histogram.value_at_quantile(0.999);
        let step_ns = last_ns.div_ceil(SHARES).max(100);
        let share = |from_ns: u64| {
            let within = histogram.count_between(from_ns, from_ns + step_ns - 1);
            (from_ns as f64 / 1000.0, 100.0 * within as f64 / self.count as f64)
        };
        (0..=last_ns / step_ns).map(|step| share(step * step_ns)).collect()
    }
}

/// What is counted over all windows.
#[derive(Default)]
pub struct Timing {
    /// Windows granted: all but those skipped.
    pub granted: u64,
    /// Windows whose partition was not there to run.
    pub skipped: u64,
    /// Windows that the dispatcher switched to late.
    pub late: u64,
    /// Windows that their partition had not closed at their end.
    pub overruns: u64,
    /// Opened minus planned start.
    pub lateness: Times,
    /// First of the chain opened → last of the chain closed, once a minor frame.
    pub chain: Times,
    /// The same, ms, over module time, s.
    pub chain_over_time: Envelope,
    /// From one minor frame's first of the chain opened to the next one's, ms, over module time, s.
    pub interval_over_time: Envelope,
    /// Opened → closed, by partition.
    pub used: BTreeMap<String, Times>,
    /// The last major frame that began.
    pub last_frame: u64,
    running: Chain,
}

/// The chain in the minor frame at hand.
#[derive(Default)]
struct Chain {
    at: (u64, u32),
    first_opened_ns: Option<u64>,
    last_frames_ns: Option<u64>,
}

impl Timing {
    /// Counts one window; they come in the order of their planned starts.
    pub fn add(&mut self, window: &Window) {
        self.last_frame = self.last_frame.max(window.frame);
        self.late += u64::from(window.late);
        self.overruns += u64::from(window.overrun);
        if window.skipped {
            self.skipped += 1;
            return;
        }
        self.granted += 1;
        if let Some(ns) = window.lateness_ns() {
            self.lateness.record(ns);
        }
        if let Some(ns) = window.used_ns() {
            self.used_by(&window.partition).record(ns);
        }
        self.follow_chain(window);
    }

    fn used_by(&mut self, partition: &str) -> &mut Times {
        if !self.used.contains_key(partition) {
            self.used.insert(partition.to_owned(), Times::default());
        }
        self.used.entry(partition.to_owned()).or_default()
    }

    fn follow_chain(&mut self, window: &Window) {
        let Some(place) = CHAIN.iter().position(|name| *name == window.partition) else { return };
        let at = (window.frame, window.minor);
        if self.running.at != at {
            let last_frames_ns = self.running.first_opened_ns;
            self.running = Chain { at, first_opened_ns: None, last_frames_ns };
        }
        let at_s = seconds(window.planned_start_ns);
        if let (None, Some(opened)) = (self.running.first_opened_ns, window.opened_ns) {
            self.running.first_opened_ns = Some(opened);
            if let Some(apart_ns) = self.running.last_frames_ns.and_then(|last| opened.checked_sub(last)) {
                self.interval_over_time.push(at_s, apart_ns as f64 / 1e6);
            }
        }
        if place + 1 == CHAIN.len()
            && let (Some(first), Some(closed)) = (self.running.first_opened_ns, window.closed_ns)
        {
            let took_ns = closed.saturating_sub(first);
            self.chain.record(took_ns);
            self.chain_over_time.push(at_s, took_ns as f64 / 1e6);
        }
    }

    /// How late windows opened; `None` under the virtual clock, where it means nothing.
    pub fn lateness_us(&self, clock: Clock) -> Option<Percentiles> {
        if clock == Clock::Virtual { None } else { self.lateness.percentiles() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_a_thousand_even_times() {
        let mut times = Times::default();
        assert_eq!(times.percentiles(), None);
        (1..=1000).for_each(|us| times.record(us * 1000));
        let found = times.percentiles().unwrap();
        assert!((found.p50 - 500.0).abs() < 1.0 && (found.p99 - 990.0).abs() < 1.0);
        assert!((found.p999 - 999.0).abs() < 1.0 && found.max == 1000.0);
    }

    #[test]
    fn shares_of_a_distribution_sum_up_to_all_but_the_outliers() {
        let mut times = Times::default();
        assert!(times.shares().is_empty());
        (0..999).for_each(|i| times.record(10_000 + i));
        times.record(50_000_000);
        let shares = times.shares();
        let sum: f64 = shares.iter().map(|(_, share)| share).sum();
        assert!((99.5..=100.0).contains(&sum) && shares.len() < 200, "{sum} in {}", shares.len());
        assert!(shares.iter().all(|(us, _)| *us < 12.0));
    }

    fn window(minor: u32, partition: &str, opened: u64, closed: &str, flags: &str) -> Window {
        let line = format!("3,{minor},1,{partition},1000,900000,1000,{opened},{closed},{flags}");
        Window::parse(&line).unwrap()
    }

    #[test]
    fn chain_runs_from_first_open_to_servo_close_within_a_minor_frame() {
        let mut timing = Timing::default();
        timing.add(&window(0, "command", 1000, "1500", ""));
        timing.add(&window(0, "gps", 2000, "2500", ""));
        timing.add(&window(0, "servo", 9000, "12000", "L"));
        // The servo alone is a chain too; one that never closes is none.
        timing.add(&window(1, "servo", 50_000, "53000", ""));
        timing.add(&window(2, "gps", 60_000, "61000", ""));
        timing.add(&window(2, "servo", 63_000, "", "O"));
        timing.add(&window(3, "servo", 0, "", "S"));
        assert_eq!((timing.granted, timing.skipped, timing.late, timing.overruns), (6, 1, 1, 1));
        let chain = timing.chain.percentiles().unwrap();
        assert_eq!((timing.chain.count, chain.max), (2, 10.0));
        let values = |envelope: &Envelope| envelope.points().iter().map(|(_, ms)| *ms).collect::<Vec<_>>();
        assert_eq!(values(&timing.chain_over_time), [0.01, 0.003]);
        assert_eq!(values(&timing.interval_over_time), [0.048, 0.01]);
        assert_eq!(timing.lateness_us(Clock::Virtual), None);
        assert_eq!(timing.lateness_us(Clock::Wall).unwrap().max, 62.0);
    }
}
