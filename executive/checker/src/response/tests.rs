//! The analysis against a partition that is run unit by unit.

use super::*;

/// Numbers that look like chance and are the same for a seed (SplitMix64).
struct Chance(u64);

impl Chance {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % end
    }

    fn from(&mut self, low: u64, high: u64) -> u64 {
        low + self.below(high - low + 1)
    }
}

/// A partition: its windows without margin, its processes.
#[derive(Debug)]
struct Case {
    windows: Vec<(u64, u64)>,
    major: u64,
    grid: (u64, u64),
    tasks: Vec<Task>,
}

impl Case {
    fn random(chance: &mut Chance) -> Self {
        let period = chance.from(4, 12);
        let major = period * chance.from(1, 4);
        let mut windows: Vec<(u64, u64)> = Vec::new();
        let mut at = chance.below(period);
        while at < major {
            let end = (at + chance.from(1, 5)).min(major);
            windows.push((at, end));
            at = end + chance.from(0, 6);
        }
        let task = |chance: &mut Chance| Task {
            priority: chance.from(1, 3) as u8,
            period_ns: (chance.below(5) > 0).then(|| period * chance.from(1, 6)),
            wcet_ns: chance.from(1, 5),
        };
        let tasks = (0..chance.from(1, 5)).map(|_| task(chance)).collect();
        let release = windows[0].0 % period;
        Self { windows, major, grid: (release, period), tasks }
    }

    fn responses(&self) -> Vec<Response> {
        responses(&self.tasks, &Supply::new(&self.windows, 0, self.major, self.grid))
    }

    /// The longest response of each process that one run of the partition has shown. `first`: from the first release point on, and
    /// always as long as they may; else by chance.
    fn seen(&self, chance: &mut Chance, first: bool) -> Vec<u64> {
        let (release, period) = self.grid;
        let mut runs: Vec<Run> = self.tasks.iter().map(|task| Run::new(task, chance, first)).collect();
        let begin = release + if first { 0 } else { chance.below(self.major / period) * period };
        runs.iter_mut().for_each(|run| run.next += begin);
        for now in begin..begin + 60 * self.major {
            for run in &mut runs {
                run.arrive(now, chance, first);
            }
            let within = now % self.major;
            if !self.windows.iter().any(|&(start, end)| (start..end).contains(&within)) {
                continue;
            }
            let ready = runs.iter_mut().filter(|run| run.left > 0);
            let urgent = ready.max_by_key(|run| (run.task.priority, std::cmp::Reverse((run.since, run.lot))));
            if let Some(run) = urgent {
                run.compute(now + 1, chance, first);
            }
        }
        runs.iter().map(|run| run.worst).collect()
    }
}

/// A process while its partition runs.
struct Run {
    task: Task,
    /// The next release of a periodic one, or the next instant at which another may begin.
    next: u64,
    /// Of the job that it is at.
    released: u64,
    since: u64,
    lot: u64,
    left: u64,
    worst: u64,
}

impl Run {
    fn new(task: &Task, chance: &mut Chance, first: bool) -> Self {
        let next = match task.period_ns {
            Some(_) if first => 0,
            // Started in any period of the partition.
            Some(period) => chance.below(3) * period,
            None => chance.below(10),
        };
        Self { task: *task, next, released: 0, since: 0, lot: 0, left: 0, worst: 0 }
    }

    /// The release has come, and the job before it is done.
    fn arrive(&mut self, now: u64, chance: &mut Chance, first: bool) {
        if self.left > 0 || self.next > now {
            return;
        }
        (self.released, self.since, self.lot) = (self.next, now, chance.below(100));
        self.left = if first { self.task.wcet_ns } else { chance.from(1, self.task.wcet_ns) };
        if self.task.period_ns.is_none() {
            self.released = now;
        }
        self.next = self.task.period_ns.map_or(u64::MAX, |period| self.released + period);
    }

    fn compute(&mut self, done: u64, chance: &mut Chance, first: bool) {
        self.left -= 1;
        if self.left == 0 {
            self.worst = self.worst.max(done - self.released);
            if self.task.period_ns.is_none() {
                self.next = done + if first { 0 } else { chance.below(20) };
            }
        }
    }
}

#[test]
fn no_run_of_a_random_partition_shows_a_response_beyond_the_bound() {
    let (mut bounds, mut reached) = (0, 0);
    for seed in 0..6_000 {
        let mut chance = Chance(seed);
        let case = Case::random(&mut chance);
        let bound = case.responses();
        for run in 0..4 {
            let seen = case.seen(&mut chance, run == 0);
            for (place, (bound, seen)) in bound.iter().zip(seen).enumerate() {
                let Response::Within(bound) = *bound else { continue };
                assert!(seen <= bound, "seed {seed}, process {place}: {seen} beyond {bound}\n{case:?}");
                bounds += 1;
                reached += usize::from(seen == bound);
            }
        }
    }
    assert!(bounds > 10_000 && reached * 3 > bounds, "{reached} of {bounds} bounds were reached");
}

#[test]
fn bound_is_reached_where_all_begin_at_once_and_the_windows_are_alike() {
    for seed in 0..2_000 {
        let mut chance = Chance(seed);
        let mut case = Case::random(&mut chance);
        let length = chance.from(1, case.grid.1);
        (case.windows, case.major, case.grid.0) = (vec![(0, length)], case.grid.1, 0);
        for (place, task) in case.tasks.iter_mut().enumerate() {
            task.priority = 10 + place as u8;
            task.period_ns = task.period_ns.or(Some(5 * case.major));
        }
        let seen = case.seen(&mut chance, true);
        for (bound, seen) in case.responses().iter().zip(seen) {
            if let Response::Within(bound) = *bound {
                assert_eq!(seen, bound, "seed {seed}\n{case:?}");
            }
        }
    }
}

fn of(windows: &[(u64, u64)], major: u64, period: u64, tasks: &[(u8, Option<u64>, u64)]) -> Vec<Response> {
    let task =
        |&(priority, period_ns, wcet_ns): &(u8, Option<u64>, u64)| Task { priority, period_ns, wcet_ns };
    let tasks: Vec<Task> = tasks.iter().map(task).collect();
    responses(&tasks, &Supply::new(windows, 0, major, (windows[0].0 % period, period)))
}

#[test]
fn process_waits_for_windows_and_for_who_is_more_urgent() {
    use Response::{TooMuch, Unlimited, Within};
    let alone = |wcet| of(&[(3, 5)], 20, 20, &[(1, Some(20), wcet)]);
    assert_eq!((alone(2), alone(3)), (vec![Within(2)], vec![TooMuch]));
    assert_eq!(of(&[(3, 5)], 20, 20, &[(1, Some(40), 3)]), [Within(21)]);
    let two = [(9, Some(20), 1), (1, Some(60), 2)];
    assert_eq!(of(&[(3, 5)], 20, 20, &two), [Within(1), Within(22)]);
    assert_eq!(of(&[(3, 5)], 20, 20, &[(5, Some(40), 1), (5, Some(40), 2)]), [Within(21), Within(21)]);
    assert_eq!(of(&[(3, 5)], 20, 20, &[(1, None, 1)]), [Within(19)], "it begins as the window ends");
    assert_eq!(of(&[(3, 5)], 20, 20, &[(9, None, 1), (1, Some(20), 1)]), [Within(19), Unlimited(0)]);
    let uneven = of(&[(0, 4), (20, 22)], 40, 20, &[(1, Some(20), 2)]);
    assert_eq!(uneven, [Within(2)]);
    let uneven = of(&[(0, 4), (25, 27)], 40, 20, &[(1, Some(20), 2)]);
    assert_eq!(uneven, [Within(7)], "the second window comes 5 after its release point");
}

#[test]
fn margin_at_the_end_of_a_window_gives_nothing() {
    let supply = Supply::new(&[(0, 10), (20, 23)], 4, 40, (0, 20));
    assert_eq!((supply.takes(0, 6), supply.takes(0, 7), supply.takes(39, 1)), (Some(6), Some(41), Some(2)));
    assert_eq!(Supply::new(&[(0, 4)], 4, 40, (0, 20)).takes(0, 1), None);
}
