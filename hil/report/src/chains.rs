//! How old values really were at the end of each chain of the schedule file, beside what was computed and what is allowed.
//!
//! Measured on the windows as they were, not as they were planned: a window that was not granted, or whose partition never
//! closed it, carries nothing, and its reader goes on with the older value. Which value a window read follows from the times
//! alone: the latest that was closed when it opened. That never makes a chain younger than it was.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::run::Clock;
use crate::timing::{Percentiles, Times};
use crate::windows::Window;

/// Closed windows remembered of each station: beyond any overlap of two cores.
const REMEMBERED: usize = 8;

/// A chain as the schedule file has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChainBound {
    /// Its name.
    pub name: String,
    /// The partitions on its way.
    pub partitions: Vec<String>,
    /// The age that the windows allow at worst, ns.
    pub computed_ns: u64,
    /// The age that the file allows, ns.
    pub allowed_ns: u64,
}

/// The age of a chain's first value at its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChainAge {
    /// The chain.
    pub chain: String,
    /// What follows from the windows at worst, µs.
    pub computed_us: f64,
    /// First window opened → last window closed, µs; `None` where no value came through.
    pub measured_us: Option<Percentiles>,
    /// What the file allows, µs.
    pub allowed_us: f64,
    /// Values that came to the end.
    pub values: u64,
    /// Those that were older than allowed.
    pub too_old: u64,
}

/// What a window has passed on.
#[derive(Clone, Copy)]
struct Carried {
    closed_ns: u64,
    /// When the first window of the chain opened in which it began.
    origin_ns: u64,
}

/// One chain on its way through the windows.
pub struct Follower {
    bound: ChainBound,
    stations: Vec<VecDeque<Carried>>,
    ages: Times,
    values: u64,
    too_old: u64,
}

impl Follower {
    /// Nothing has come through yet.
    pub fn new(bound: &ChainBound) -> Self {
        let stations = vec![VecDeque::with_capacity(REMEMBERED); bound.partitions.len()];
        Self { bound: bound.clone(), stations, ages: Times::default(), values: 0, too_old: 0 }
    }

    /// Follows one window; they come in the order of their planned starts.
    pub fn add(&mut self, window: &Window, clock: Clock) {
        let Some((opened_ns, closed_ns)) = lasted(window, clock) else { return };
        for station in 0..self.stations.len() {
            if self.bound.partitions.get(station) != Some(&window.partition) {
                continue;
            }
            let read = station.checked_sub(1).map(|before| self.read(before, opened_ns));
            let Some(origin_ns) = read.unwrap_or(Some(opened_ns)) else { continue };
            if station + 1 == self.stations.len() {
                self.arrived(closed_ns.saturating_sub(origin_ns));
            }
            if let Some(kept) = self.stations.get_mut(station) {
                if kept.len() == REMEMBERED {
                    kept.pop_front();
                }
                kept.push_back(Carried { closed_ns, origin_ns });
            }
        }
    }

    /// The origin of the value that a window reads from the station before it.
    fn read(&self, station: usize, opened_ns: u64) -> Option<u64> {
        let there = |carried: &&Carried| carried.closed_ns <= opened_ns;
        let latest = self.stations.get(station)?.iter().filter(there).max_by_key(|carried| carried.closed_ns);
        latest.map(|carried| carried.origin_ns)
    }

    fn arrived(&mut self, age_ns: u64) {
        self.ages.record(age_ns);
        self.values += 1;
        self.too_old += u64::from(age_ns > self.bound.allowed_ns);
    }

    /// What came of it.
    pub fn age(&self) -> ChainAge {
        let us = |ns: u64| ns as f64 / 1000.0;
        ChainAge {
            chain: self.bound.name.clone(),
            computed_us: us(self.bound.computed_ns),
            measured_us: self.ages.percentiles(),
            allowed_us: us(self.bound.allowed_ns),
            values: self.values,
            too_old: self.too_old,
        }
    }
}

/// When a window was used, ns of module time; `None` if it was not, or not to its end. Under the virtual clock module
/// time stands still while a partition works, so that the planned times are the times.
fn lasted(window: &Window, clock: Clock) -> Option<(u64, u64)> {
    if window.skipped {
        return None;
    }
    let (opened_ns, closed_ns) = (window.opened_ns?, window.closed_ns?);
    match clock {
        Clock::Wall => Some((opened_ns, closed_ns)),
        Clock::Virtual => Some((window.planned_start_ns, window.planned_end_ns)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn follower(partitions: &[&str]) -> Follower {
        let partitions = partitions.iter().map(|&name| name.to_owned()).collect();
        Follower::new(&ChainBound { name: "c".into(), partitions, computed_ns: 6 * MS, allowed_ns: 7 * MS })
    }

    /// A window of 1 ms from `start_ms`, that opened `late_us` late and took half of it.
    fn window(partition: &str, start_ms: u64, late_us: u64, flags: &str) -> Window {
        let (start, opened) = (start_ms * MS, start_ms * MS + late_us * 1000);
        let closed = if flags == "O" { String::new() } else { (opened + MS / 2).to_string() };
        let end = start + MS;
        Window::parse(&format!("0,0,1,{partition},{start},{end},{start},{opened},{closed},{flags}")).unwrap()
    }

    fn max_us(follower: &Follower) -> f64 {
        follower.age().measured_us.unwrap().max
    }

    #[test]
    fn age_runs_from_the_first_opening_to_the_last_close_as_they_were() {
        let mut chain = follower(&["a", "b"]);
        chain.add(&window("a", 0, 100, ""), Clock::Wall);
        chain.add(&window("b", 5, 200, ""), Clock::Wall);
        assert_eq!(max_us(&chain), 5600.0);
        assert_eq!((chain.age().values, chain.age().too_old), (1, 0));
    }

    #[test]
    fn under_the_virtual_clock_the_planned_times_count() {
        let mut chain = follower(&["a", "b"]);
        chain.add(&window("a", 0, 100, ""), Clock::Virtual);
        chain.add(&window("b", 5, 200, ""), Clock::Virtual);
        assert_eq!(max_us(&chain), 6000.0);
    }

    #[test]
    fn window_that_was_not_granted_or_not_closed_leaves_the_reader_with_the_older_value() {
        for flags in ["S", "O"] {
            let mut chain = follower(&["a", "b"]);
            chain.add(&window("a", 0, 0, ""), Clock::Wall);
            chain.add(&window("b", 5, 0, ""), Clock::Wall);
            chain.add(&window("a", 20, 0, flags), Clock::Wall);
            chain.add(&window("b", 25, 0, ""), Clock::Wall);
            assert_eq!(max_us(&chain), 25_500.0, "{flags}");
            assert_eq!((chain.age().values, chain.age().too_old), (2, 1));
        }
    }

    #[test]
    fn writer_that_closes_after_the_reader_opened_is_read_a_period_later() {
        let mut chain = follower(&["a", "b"]);
        chain.add(&window("a", 0, 0, ""), Clock::Wall);
        chain.add(&window("a", 20, 900, ""), Clock::Wall);
        chain.add(&window("b", 21, 0, ""), Clock::Wall);
        assert_eq!(max_us(&chain), 21_500.0);
    }

    #[test]
    fn reader_without_any_value_has_no_age() {
        let mut chain = follower(&["a", "b"]);
        chain.add(&window("b", 5, 0, ""), Clock::Wall);
        assert_eq!((chain.age().measured_us, chain.age().values), (None, 0));
    }
}
