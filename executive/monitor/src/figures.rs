//! The figures of one partition over a run: counters, spreads and a histogram of fixed size. Adding a window allocates
//! nothing.

use crate::health::log::Fault;
use bateleur_control::status::{LATENESS_BOUNDS_NS, LastFault, Lateness, PartitionStatus, Spread};
use bateleur_time::window_record::WindowRecord;

/// See the module's head.
#[derive(Debug, Clone)]
pub(crate) struct Figures {
    windows: u64,
    missed: u64,
    overruns: u64,
    window_ns: u64,
    used: Running,
    slack: Running,
    lateness: Histogram,
    pub(crate) restarts: u64,
    last_fault: Option<LastFault>,
}

impl Figures {
    pub(crate) fn new() -> Self {
        Self {
            windows: 0,
            missed: 0,
            overruns: 0,
            window_ns: 0,
            used: Running::default(),
            slack: Running::default(),
            lateness: Histogram::new(),
            restarts: 0,
            last_fault: None,
        }
    }

    /// Adds a window.
    pub(crate) fn add(&mut self, record: &WindowRecord) {
        self.window_ns = record.occurrence.window.duration_ns();
        let Some(granted_ns) = record.granted_ns else {
            self.missed += 1;
            return;
        };
        self.windows += 1;
        self.overruns += u64::from(record.is_overrun());
        self.lateness.add(granted_ns.saturating_sub(record.occurrence.start_ns));
        if let Some(closed_ns) = record.closed_ns {
            self.used.add(closed_ns.saturating_sub(granted_ns));
        }
        if let Some(slack_ns) = record.slack_ns() {
            self.slack.add(slack_ns);
        }
    }

    /// Remembers the last error.
    pub(crate) fn fault(&mut self, fault: &Fault) {
        self.last_fault = Some(LastFault {
            time_ns: fault.time_ns,
            error: fault.error.clone(),
            action: fault.action.clone(),
            detail: fault.detail.clone(),
        });
    }

    /// What stands in a status; what it is about and how it lives, the caller adds.
    pub(crate) fn status(&self) -> PartitionStatus {
        let lateness = &self.lateness;
        PartitionStatus {
            restarts: self.restarts,
            last_fault: self.last_fault.clone(),
            windows: self.windows,
            windows_missed: self.missed,
            overruns: self.overruns,
            window_ns: self.window_ns,
            use_ns: self.used.spread(),
            slack_ns: self.slack.spread(),
            lateness_ns: (lateness.count > 0).then(|| Lateness {
                p50: lateness.quantile(0.5),
                p99: lateness.quantile(0.99),
                max: lateness.most,
                within: LATENESS_BOUNDS_NS.map(|bound_ns| lateness.within(bound_ns)),
                sum: lateness.sum,
            }),
            ..PartitionStatus::default()
        }
    }
}

/// Later than that is counted as that, ns: a machine that stood still for ten seconds.
const LATEST_NS: u64 = 10_000_000_000;
/// Each doubling of a lateness is cut into so many steps, as a power of two: one part in 64 is finer than the machine repeats itself.
const STEPS_LOG2: u32 = 6;

/// How often a lateness fell into which step; some 7 KiB.
#[derive(Debug, Clone)]
struct Histogram {
    counts: Box<[u32]>,
    count: u64,
    most: u64,
    sum: u64,
}

impl Histogram {
    fn new() -> Self {
        Self { counts: vec![0; step(LATEST_NS) + 1].into(), count: 0, most: 0, sum: 0 }
    }

    fn add(&mut self, value_ns: u64) {
        let value_ns = value_ns.min(LATEST_NS);
        let count = &mut self.counts[step(value_ns)];
        *count = count.saturating_add(1);
        self.count += 1;
        self.most = self.most.max(value_ns);
        self.sum = self.sum.saturating_add(value_ns);
    }

    /// How many were at or below a value, to the end of its step.
    fn within(&self, value_ns: u64) -> u64 {
        self.counts[..=step(value_ns.min(LATEST_NS))].iter().map(|count| u64::from(*count)).sum()
    }

    /// The value at or below which that share of all lies: the end of its step. 0 of nothing.
    fn quantile(&self, share: f64) -> u64 {
        let rank = (share * self.count as f64).ceil() as u64;
        let mut seen = 0;
        let reached = self.counts.iter().position(|count| {
            seen += u64::from(*count);
            seen >= rank
        });
        reached.map_or(self.most, |step| last_of(step).min(self.most))
    }
}

/// The step that a value falls into.
fn step(value: u64) -> usize {
    let shift = value.max(1).ilog2().saturating_sub(STEPS_LOG2);
    ((u64::from(shift) << STEPS_LOG2) + (value >> shift)) as usize
}

/// The largest value of a step.
fn last_of(step: usize) -> u64 {
    let shift = (step >> STEPS_LOG2).saturating_sub(1);
    (((step - (shift << STEPS_LOG2)) as u64 + 1) << shift) - 1
}

#[derive(Debug, Clone, Copy, Default)]
struct Running {
    count: u64,
    sum: u64,
    min: u64,
    max: u64,
}

impl Running {
    fn add(&mut self, value: u64) {
        self.min = if self.count == 0 { value } else { self.min.min(value) };
        self.max = self.max.max(value);
        self.count += 1;
        self.sum = self.sum.saturating_add(value);
    }

    fn spread(self) -> Option<Spread> {
        let mean = self.sum.checked_div(self.count)?;
        Some(Spread { min: self.min, mean, max: self.max })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use bateleur_plan::{PartitionId, TimelineWindow};
    use bateleur_time::dispatcher::{Ending, Occurrence, ScheduleEpoch};

    pub(crate) fn record(granted_ns: Option<u64>, closed_ns: Option<u64>) -> WindowRecord {
        let window = TimelineWindow { start_ns: 100, end_ns: 1_100, ..some_window() };
        let occurrence = Occurrence {
            window,
            core: 0,
            epoch: ScheduleEpoch { number: 0, schedule: 0, after: None, since_ns: 0 },
            major_frame: 0,
            minor_frames: 0,
            minor_frame_ns: 2_000,
            start_ns: 100,
            end_ns: 1_100,
            late_ns: 0,
        };
        let ending = Ending { late_ns: 0, shared: false };
        WindowRecord {
            member: 0,
            occurrence,
            ending,
            missed: None,
            granted_ns,
            opened_ns: granted_ns,
            closed_ns,
            requested: None,
        }
    }

    fn some_window() -> TimelineWindow {
        use bateleur_plan::Timeline;
        let text = "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";
        let plan = crate::test_support::plan_of(text);
        let view = plan.module("m").unwrap();
        let _: PartitionId = view.partitions().next().unwrap();
        Timeline::of(&plan, view.id(), plan.initial_schedule()).cores[0].windows[0]
    }

    #[test]
    fn windows_are_counted_and_spread() {
        let mut figures = Figures::new();
        figures.add(&record(Some(110), Some(310)));
        figures.add(&record(Some(130), Some(730)));
        figures.add(&record(Some(100), None));
        figures.add(&record(None, None));
        let status = figures.status();
        assert_eq!(
            (status.windows, status.windows_missed, status.overruns, status.window_ns),
            (3, 1, 1, 1000)
        );
        assert_eq!(status.use_ns, Some(Spread { min: 200, mean: 400, max: 600 }));
        assert_eq!(status.slack_ns, Some(Spread { min: 370, mean: 580, max: 790 }));
        let lateness = status.lateness_ns.unwrap();
        assert_eq!((lateness.p50, lateness.max), (10, 30));
    }

    #[test]
    fn lateness_beyond_all_bounds_is_counted_at_the_bound() {
        let mut figures = Figures::new();
        figures.add(&record(Some(u64::MAX), None));
        assert_eq!(figures.status().lateness_ns.unwrap().max, LATEST_NS);
    }

    proptest::proptest! {
        #[test]
        fn quantiles_are_those_of_the_sorted_values_to_one_part_in_64(
            values in proptest::collection::vec((0..35_u32, proptest::num::u64::ANY), 1..300),
        ) {
            let mut histogram = Histogram::new();
            let mut sorted: Vec<u64> =
                values.iter().map(|(bits, any)| (any & ((1 << bits) - 1)).min(LATEST_NS)).collect();
            sorted.iter().for_each(|value| histogram.add(*value));
            sorted.sort_unstable();
            for share in [0.01, 0.5, 0.99, 1.0] {
                let exact = sorted[(share * sorted.len() as f64).ceil() as usize - 1];
                let told = histogram.quantile(share);
                let within = sorted.partition_point(|value| *value <= told) as u64;
                proptest::prop_assert_eq!(histogram.within(told), within, "not later than {}", told);
                proptest::prop_assert!((exact..=exact + exact / 64).contains(&told), "{told} for {exact}");
            }
        }
    }

    #[test]
    fn a_partition_without_windows_has_no_spreads() {
        let status = Figures::new().status();
        assert_eq!((status.use_ns, status.slack_ns, status.lateness_ns), (None, None, None));
    }
}
