//! What ARINC 653 knows of a partition beside its windows: its number, its period with the release points, its duration, and its
//! processes. Who wants to know how windows lie in periods asks here.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A partition as its processes see it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Processes {
    /// Its number; no other partition of its module has it.
    pub identifier: u32,
    /// From one release point to the next, ns; not zero. The major frame is a multiple.
    pub period_ns: u64,
    /// The first release point, from the start of a major frame, ns; less than the period.
    pub release_ns: u64,
    /// The least time that it has in a period, ns.
    pub duration_ns: u64,
    /// Its times in schedules in which they are others, by their places in the plan. Not written down where there are none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub in_schedules: BTreeMap<usize, Times>,
    /// The most processes that it may create.
    pub most: u32,
    /// The most that their stacks may have together, bytes.
    pub stacks_bytes: u64,
    /// Those whose times the file says, in its order.
    pub declared: Vec<Process>,
}

/// When a partition's periods begin, and what it has in each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Times {
    /// From one release point to the next, ns; not zero. The major frame is a multiple.
    pub period_ns: u64,
    /// The first release point, from the start of a major frame, ns; less than the period.
    pub release_ns: u64,
    /// The least time that it has in a period, ns.
    pub duration_ns: u64,
}

impl Processes {
    /// Its times in the schedule at this place.
    #[must_use]
    pub fn times_in(&self, schedule: usize) -> Times {
        let &Self { period_ns, release_ns, duration_ns, .. } = self;
        self.in_schedules.get(&schedule).copied().unwrap_or(Times { period_ns, release_ns, duration_ns })
    }
}

/// A process whose times are known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Process {
    /// Its name, unique in its partition.
    pub name: String,
    /// 1 to 239, the highest is the most urgent.
    pub priority: u8,
    /// From one release to the next, ns, a multiple of the partition's; `None`: it is not periodic.
    pub period_ns: Option<u64>,
    /// From a release to the end of its work at the latest, ns; `None`: whenever.
    pub deadline_ns: Option<u64>,
    /// The longest time that it computes after a release, ns.
    pub wcet_ns: u64,
}

/// A partition's windows in a major frame: start and end, ns, by rising start, none overlapping another.
pub type Windows = [(u64, u64)];

/// The shortest time after which all windows recur; `None` where there are none.
#[must_use]
pub fn recurrence(windows: &Windows, major_ns: u64) -> Option<u64> {
    let (first, count) = (windows.first()?.0, windows.len());
    let start = |place: usize| windows[place % count].0 + (place / count) as u64 * major_ns;
    let length = |place: usize| windows[place % count].1 - windows[place % count].0;
    let recurs = |step: usize, period: u64| {
        (0..count).all(|at| start(at + step) - start(at) == period && length(at + step) == length(at))
    };
    let steps = (1..=count).filter(|step| count.is_multiple_of(*step));
    steps
        .map(|step| (step, start(step) - first))
        .find(|&(step, period)| recurs(step, period))
        .map(|found| found.1)
}

/// A stretch of time from one release point to the next, and what a partition has of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// The release point, from the start of the major frame, ns.
    pub release_ns: u64,
    /// The time of windows in it, ns.
    pub time_ns: u64,
    /// From the release point to the first window, ns; the whole period where there is none.
    pub waits_ns: u64,
    /// A window goes on beyond its end.
    pub crossed: bool,
}

/// What a partition has of each of its periods in a major frame. Empty where the periods do not divide it.
#[must_use]
pub fn shares(windows: &Windows, major_ns: u64, (release_ns, period_ns): (u64, u64)) -> Vec<Share> {
    if period_ns == 0 || !major_ns.is_multiple_of(period_ns) {
        return Vec::new();
    }
    let count = major_ns / period_ns;
    let release = |place: u64| release_ns % period_ns + place * period_ns;
    let nothing =
        |place| Share { release_ns: release(place), time_ns: 0, waits_ns: period_ns, crossed: false };
    let mut shares: Vec<Share> = (0..count).map(nothing).collect();
    for &(start, end) in windows {
        let (mut from, until) = (start + major_ns - release(0), end + major_ns - release(0));
        while from < until {
            let (place, within) = (from / period_ns, from % period_ns);
            let to = until.min((place + 1) * period_ns);
            let share = &mut shares[(place % count) as usize];
            share.time_ns += to - from;
            share.waits_ns = share.waits_ns.min(within);
            share.crossed |= to < until;
            from = to;
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_recur_after_the_shortest_time_that_moves_them_onto_each_other() {
        for (windows, major, period) in [
            (&[][..], 100, None),
            (&[(3, 5)], 100, Some(100)),
            (&[(3, 5), (23, 25), (43, 45), (63, 65), (83, 85)], 100, Some(20)),
            (&[(3, 5), (23, 24), (43, 45), (63, 64)], 80, Some(40)),
            (&[(3, 5), (12, 14), (23, 25), (32, 34)], 40, Some(20)),
            (&[(0, 5), (30, 35)], 100, Some(100)),
        ] {
            assert_eq!(recurrence(windows, major), period, "{windows:?}");
        }
    }

    #[test]
    fn every_period_has_the_time_of_the_windows_in_it() {
        let share = |release_ns, time_ns, waits_ns, crossed| Share { release_ns, time_ns, waits_ns, crossed };
        let windows = [(3, 5), (12, 14), (38, 40)];
        assert_eq!(
            shares(&windows, 40, (3, 20)),
            [share(3, 4, 0, false), share(23, 2, 15, false)],
            "the second period reaches over the end of the major frame"
        );
        assert_eq!(shares(&windows, 40, (13, 20)), [share(13, 1, 0, false), share(33, 5, 5, true)]);
        assert_eq!(shares(&[], 40, (0, 20)), [share(0, 0, 20, false), share(20, 0, 20, false)]);
        assert_eq!(shares(&windows, 40, (0, 30)), [], "no whole number of periods");
        assert_eq!(shares(&[(10, 70)], 80, (0, 40)), [share(0, 30, 10, true), share(40, 30, 0, false)]);
    }
}
