//! What is planned to happen to partitions at instants of module time: the same again at every run of the same plan.

use serde::{Deserialize, Serialize};

pub use crate::act::{Act, STANDBY};
use crate::inject::Aim;
use crate::monitor::Monitor;
use bateleur_plan::Plan;

/// One of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlannedAct {
    /// What is done.
    pub act: Act,
    /// The partition's name; for a fault, what it is aimed at.
    pub partition: String,
    /// Module time, ns.
    pub at_ns: u64,
}

impl PlannedAct {
    /// Whom it hits.
    ///
    /// # Errors
    /// The plan has no such target, or it can not have this fault.
    pub fn aim(&self, plan: &Plan) -> Result<Aim, String> {
        match self.act {
            Act::Inject(fault) => fault.aim(plan, &self.partition),
            _ => match plan.partition(&self.partition) {
                Some(found) if self.act == Act::KillStandby && plan[found].standby.is_none() => Err(format!(
                    "nothing stands by for partition \"{}\": it has no `standby`",
                    self.partition
                )),
                Some(found) => Ok(Aim::partition(found.index())),
                None => Err(format!("there is no partition \"{}\"", self.partition)),
            },
        }
    }
}

/// A line for each act and each change of schedule (name and module time, ns) whose time did not come before `end_ns`.
#[must_use]
pub fn not_reached(acts: &[PlannedAct], changes: &[(String, u64)], end_ns: u64) -> Vec<String> {
    let seconds = |ns: u64| ns as f64 / 1e9;
    let option = |act: &PlannedAct| {
        let at_s = seconds(act.at_ns);
        match act.act {
            Act::KillStandby => format!("--kill {}{STANDBY}@{at_s}", act.partition),
            Act::Inject(fault) => format!("--inject {}:{fault}@{at_s}", act.partition),
            other => format!("--{} {}@{at_s}", other.name(), act.partition),
        }
    };
    let acts = acts.iter().filter(|act| act.at_ns > end_ns).map(option);
    let change = |(schedule, at_ns): &(String, u64)| format!("--schedule-at {schedule}@{}", seconds(*at_ns));
    let changes = changes.iter().filter(|(_, at_ns)| *at_ns > end_ns).map(change);
    acts.chain(changes)
        .map(|option| format!("{option} was not reached: it ended at {:.2} s", seconds(end_ns)))
        .collect()
}

/// Kills of partitions chosen at random, again and again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Killings {
    /// From one to the next, module time, ns; not zero.
    pub every_ns: u64,
    /// The same seed chooses the same partitions.
    pub seed: u64,
}

/// What is still to come.
#[derive(Debug, Default)]
pub struct PlannedActs {
    /// The next one last.
    list: Vec<(u64, Aim, Act)>,
    killings: Option<Killings>,
    next_kill_ns: u64,
    /// Places in the plan of those who may be chosen.
    candidates: Vec<usize>,
}

impl PlannedActs {
    /// Names that are not in the plan were refused before.
    #[must_use]
    pub fn of(plan: &Plan, acts: &[PlannedAct], killings: Option<Killings>, candidates: Vec<usize>) -> Self {
        let aimed = |one: &PlannedAct| Some((one.at_ns, one.aim(plan).ok()?, one.act));
        let mut list: Vec<_> = acts.iter().filter_map(aimed).collect();
        list.sort_by_key(|(at_ns, ..)| *at_ns);
        list.reverse();
        let next_kill_ns = killings.map_or(u64::MAX, |killings| killings.every_ns);
        Self { list, killings, next_kill_ns, candidates }
    }

    /// Leaves out what came due until `module_ns`: an earlier executive has done it.
    pub fn skip_until(&mut self, module_ns: u64) {
        while self.list.pop_if(|(at_ns, ..)| *at_ns <= module_ns).is_some() {}
        while self.victim(module_ns).is_some() {}
    }

    /// Does what is due.
    pub fn perform(&mut self, module_ns: u64, monitor: &mut Monitor) {
        while let Some((_, aim, act)) = self.list.pop_if(|(at_ns, ..)| *at_ns <= module_ns) {
            monitor.carry_out_planned(&aim, act, module_ns);
        }
        if let Some(victim) = self.victim(module_ns) {
            monitor.kill(victim, module_ns);
        }
    }

    /// Whom chance kills now.
    fn victim(&mut self, module_ns: u64) -> Option<usize> {
        let killings = self.killings.as_mut().filter(|_| module_ns >= self.next_kill_ns)?;
        self.next_kill_ns += killings.every_ns;
        let place = random(&mut killings.seed) as usize % self.candidates.len().max(1);
        self.candidates.get(place).copied()
    }
}

/// The next number of a SplitMix64 sequence (Steele, Lea, Flood 2014): the same on every machine and in every version.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut mixed = *state;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn victims(seed: u64) -> Vec<usize> {
        let killings = Some(Killings { every_ns: 5, seed });
        let mut acts = PlannedActs { killings, next_kill_ns: 5, candidates: vec![3, 4, 8], list: Vec::new() };
        (0..500).filter_map(|now_ns| acts.victim(now_ns)).collect()
    }

    #[test]
    fn one_of_the_candidates_is_killed_in_each_period_and_all_of_them_in_time() {
        let all = victims(1);
        assert_eq!(all.len(), 99);
        assert!([3, 4, 8].iter().all(|candidate| all.contains(candidate)) && !all.contains(&0));
    }

    #[test]
    fn what_an_earlier_executive_has_done_is_not_done_again_and_the_rest_is_the_same() {
        let acts = || PlannedActs {
            killings: Some(Killings { every_ns: 5, seed: 9 }),
            next_kill_ns: 5,
            candidates: vec![3, 4, 8],
            list: Vec::new(),
        };
        let (mut whole, mut later) = (acts(), acts());
        let all: Vec<_> = (0..500).filter_map(|now_ns| whole.victim(now_ns)).collect();
        later.skip_until(247);
        let rest: Vec<_> = (248..500).filter_map(|now_ns| later.victim(now_ns)).collect();
        assert_eq!(rest, all[all.len() - rest.len()..]);
        assert_eq!(rest.len(), 50);
    }

    #[test]
    fn the_seed_decides() {
        assert_eq!(victims(7), victims(7));
        assert_ne!(victims(7), victims(8));
    }
}
