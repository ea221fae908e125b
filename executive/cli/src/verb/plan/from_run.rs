//! Needs out of a run: how long each partition worked in each of its periods.
//!
//! The stamps are those of `windows.csv`: from the opening of a window to its closing, with whatever the machine took meanwhile. A partition of
//! several processes closes its windows when they end, so its time is not measured: its need is its duration in the plan.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_plan::units::ShowTime;
use bateleur_plan::{Partition, Plan};
use bateleur_recording::windows::{self, Window};

/// Shorter windows are mostly switch: see the rule T11.
const SHORTEST_NS: u64 = 100_000;
/// Durations are made in these steps.
const STEP_NS: u64 = 10_000;
/// Times are counted in these.
const COUNTED_NS: u64 = 1_000;

/// What a run says of the partitions of its plan.
pub(super) struct Run {
    measured: BTreeMap<String, Measured>,
    schedule: String,
    folder: String,
    margin_percent: u32,
}

/// One partition.
struct Measured {
    period_ns: u64,
    /// What it is given, whatever was measured; `None`: what follows from the times.
    planned_ns: Option<u64>,
    release_ns: u64,
    /// The period that is being added up, and the time so far; no time: a window of it was left open or not granted.
    current: Option<(u64, Option<u64>)>,
    /// How many periods took so many us.
    times: BTreeMap<u64, u64>,
    /// Windows that were left open.
    open: u64,
}

impl Run {
    /// Reads the windows of a run of `plan` in its initial schedule.
    pub(super) fn read(folder: &Path, plan: &Plan, margin_percent: u32) -> Result<Self> {
        let schedule = plan[plan.initial_schedule()].name.clone();
        let own = plan.partitions.iter().filter(|partition| !partition.relay);
        let mut measured: BTreeMap<String, Measured> =
            own.map(|partition| (partition.name.clone(), Measured::of(partition))).collect();
        let file = folder.join(windows::FILE);
        let add = |window: Window| {
            let of_schedule = window.schedule.is_empty() || window.schedule == schedule;
            if let Some(partition) = measured.get_mut(&window.partition).filter(|_| of_schedule) {
                partition.add(&window);
            }
        };
        windows::for_each(&file, add).with_context(|| format!("cannot read {}", file.display()))?;
        measured.values_mut().for_each(Measured::finish_period);
        Ok(Self { measured, schedule, folder: folder.display().to_string(), margin_percent })
    }

    /// The period of a partition and the window that it needs in it, ns; `None`: the plan of the run has no such partition.
    pub(super) fn need(&self, name: &str) -> Result<Option<(u64, u64)>> {
        let Some(measured) = self.measured.get(name) else { return Ok(None) };
        let duration_ns = measured.duration_ns(self.margin_percent);
        let mend = format!("add a need of `{name}` to a file of needs");
        if measured.open > 0 && measured.planned_ns.is_none() {
            bail!(
                "`{name}` left windows open in {} ({} of them), so nobody knows what it needs: {mend}",
                self.folder,
                measured.open
            );
        }
        let Some(duration_ns) = duration_ns else {
            bail!("`{name}` has no whole period of schedule `{}` in {}: {mend}", self.schedule, self.folder)
        };
        Ok(Some((measured.period_ns, duration_ns)))
    }

    /// What was measured, as comments of a schedule file.
    pub(super) fn comments(&self) -> String {
        let width = self.measured.keys().map(String::len).max().unwrap_or(0);
        let mut out = format!(
            "# From {}: windows are p99.9 of the time in a period and {} % more, and no shorter than the greatest.\n",
            self.folder, self.margin_percent
        );
        for (name, measured) in &self.measured {
            let said = match (measured.planned_ns, measured.quantile(999, 1000), measured.quantile(1, 1)) {
                (Some(planned), ..) => format!("its processes have a duration of {}", ShowTime(planned)),
                (None, Some(most), Some(greatest)) => {
                    let (count, most, greatest) = (measured.count(), ShowTime(most), ShowTime(greatest));
                    format!("{count} periods, p99.9 {most}, greatest {greatest}")
                }
                _ => "no whole period".to_owned(),
            };
            out.push_str(&format!("# {name:<width$}  {said}\n"));
        }
        out
    }
}

impl Measured {
    fn of(partition: &Partition) -> Self {
        let processes = &partition.processes;
        Self {
            period_ns: processes.period_ns,
            planned_ns: (processes.most > 0).then_some(processes.duration_ns),
            release_ns: processes.release_ns,
            current: None,
            times: BTreeMap::new(),
            open: 0,
        }
    }

    fn add(&mut self, window: &Window) {
        let place = window.planned_start_ns.saturating_sub(self.release_ns) / self.period_ns.max(1);
        if self.current.is_none_or(|(current, _)| current != place) {
            self.finish_period();
            self.current = Some((place, Some(0)));
        }
        let used = window.used_ns().filter(|_| !window.overrun && !window.skipped);
        self.open += u64::from(used.is_none() && !window.skipped);
        if let Some((_, time)) = &mut self.current {
            *time = time.zip(used).map(|(time, used)| time + used);
        }
    }

    fn finish_period(&mut self) {
        if let Some((_, Some(time_ns))) = self.current.take() {
            *self.times.entry(time_ns.div_ceil(COUNTED_NS)).or_default() += 1;
        }
    }

    fn count(&self) -> u64 {
        self.times.values().sum()
    }

    /// The time, ns, that this share of the periods did not exceed.
    fn quantile(&self, part: u64, of: u64) -> Option<u64> {
        let rank = (self.count() * part).div_ceil(of);
        let mut below = 0;
        let mut reached = self.times.iter().filter(|(_, count)| {
            below += **count;
            below >= rank
        });
        reached.next().map(|(time, _)| time * COUNTED_NS)
    }

    fn duration_ns(&self, margin_percent: u32) -> Option<u64> {
        let Some(planned_ns) = self.planned_ns else {
            let most = self.quantile(999, 1000)? * (100 + u64::from(margin_percent)) / 100;
            return Some(most.max(self.quantile(1, 1)?).max(SHORTEST_NS).next_multiple_of(STEP_NS));
        };
        Some(planned_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(planned_ns: Option<u64>, lines: &[&str]) -> Measured {
        let mut measured = Measured {
            period_ns: 20_000_000,
            planned_ns,
            release_ns: 3_000_000,
            current: None,
            times: BTreeMap::new(),
            open: 0,
        };
        lines.iter().for_each(|line| measured.add(&Window::parse(line).unwrap()));
        measured.finish_period();
        measured
    }

    /// A window of the second period or later, with the time that it was used.
    fn window(period: u64, at_us: u64, used_us: u64) -> String {
        let start = 3_000_000 + period * 20_000_000 + at_us * 1000;
        format!(
            "0,0,1,imu,{start},{},{start},{start},{},,0,flight",
            start + 1_000_000,
            start + used_us * 1000
        )
    }

    #[test]
    fn times_of_the_windows_of_a_period_are_added_and_one_in_a_thousand_may_be_longer() {
        let mut lines: Vec<String> = (0..2000).map(|period| window(period, 0, 100)).collect();
        lines.push(window(2000, 0, 150));
        lines.push(window(2000, 9_000, 150));
        let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
        let measured = measured(None, &lines);
        assert_eq!((measured.count(), measured.open), (2001, 0));
        assert_eq!((measured.quantile(999, 1000), measured.quantile(1, 1)), (Some(100_000), Some(300_000)));
        assert_eq!(measured.duration_ns(50), Some(300_000), "no shorter than the greatest");
        assert_eq!(measured.duration_ns(250), Some(350_000));
    }

    #[test]
    fn windows_are_no_shorter_than_a_switch_is_worth_and_come_in_whole_steps() {
        assert_eq!(measured(None, &[&window(0, 0, 3)]).duration_ns(50), Some(100_000));
        assert_eq!(measured(None, &[&window(0, 0, 333)]).duration_ns(10), Some(370_000));
        assert_eq!(measured(None, &[]).duration_ns(50), None);
        assert_eq!(measured(Some(2_000_000), &[&window(0, 0, 3)]).duration_ns(50), Some(2_000_000));
    }

    #[test]
    fn period_with_a_window_that_was_not_closed_has_no_time() {
        let lost = "0,0,1,imu,23000000,24000000,,,,S,,flight";
        let open = "0,0,1,imu,43000000,44000000,43000000,43000000,,O,,flight";
        let measured = measured(None, &[&window(0, 0, 100), lost, open, &window(2, 9_000, 100)]);
        assert_eq!((measured.count(), measured.open), (1, 1));
    }
}
