//! Other modules that use this one's processors, and whoever else takes them: found, and told of once each.
//!
//! It must never hold against a partition what somebody else has taken from it, nor look often.

use std::collections::HashMap;

use bateleur_host::instance;
use bateleur_host::machine::taken_by;

/// Between two looks, module time, ns.
const LOOK_NS: u64 = 5_000_000_000;
/// Between two entries about one who takes a processor, module time, ns.
const SAME_NS: u64 = 60_000_000_000;
/// Between two entries about anybody who does.
const ANY_NS: u64 = 1_000_000_000;
/// Of whom it is remembered, most.
const MOST: usize = 256;

/// See the module's head.
#[derive(Debug, Default)]
pub(crate) struct Neighbours {
    next_look_ns: u64,
    /// Processes of the modules that were told of.
    told: Vec<i32>,
    /// Windows in which a partition had no processor.
    starved: u64,
    /// Who had it, and when that was last told.
    takers: HashMap<String, u64>,
    next_taker_ns: u64,
}

impl Neighbours {
    /// What has begun since to use `cores`, where it is time to look. Those before were found when the machine was examined.
    pub(crate) fn look(&mut self, cores: &[u32], module_ns: u64) -> Option<String> {
        if module_ns < self.next_look_ns {
            return None;
        }
        self.next_look_ns = module_ns + LOOK_NS;
        let mut others = instance::later_ones();
        self.told.retain(|pid| others.iter().any(|other| other.pid == *pid));
        others.retain(|other| !self.told.contains(&other.pid));
        let text = taken_by(cores, &others)?;
        let theirs = others.iter().filter(|other| other.cores.iter().any(|core| cores.contains(core)));
        self.told.extend(theirs.map(|other| other.pid));
        Some(text)
    }

    /// Counts a window in which a partition had no processor.
    pub(crate) fn count_starved(&mut self) {
        self.starved += 1;
    }

    /// `taker` has kept `partition` from its processor, one of `cores`: an error in words, where it is time for one.
    pub(crate) fn judge_taker(
        &mut self,
        partition: &str,
        cores: &[u32],
        taker: &str,
        module_ns: u64,
    ) -> Option<String> {
        let is_told = self.takers.get(taker).is_some_and(|told| module_ns < told + SAME_NS);
        if is_told || module_ns < self.next_taker_ns {
            return None;
        }
        if self.takers.len() >= MOST {
            self.takers.clear();
        }
        self.takers.insert(taker.to_owned(), module_ns);
        self.next_taker_ns = module_ns + ANY_NS;
        let module = taken_by(cores, &instance::others()).map_or_else(String::new, |why| format!(" ({why})"));
        let count = self.starved;
        Some(format!(
            "{partition} had no processor in its window and is not to blame for it: {taker} had it{module}, number {count} of such \
             windows"
        ))
    }

    /// How often that was so, if it was more than once.
    pub(crate) fn sum(&self) -> Option<String> {
        let starved = self.starved;
        (starved > 1)
            .then(|| format!("partitions had no processor in {starved} windows that they did not close"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_takes_a_processor_is_told_of_once_a_minute_and_nobody_more_than_once_a_second() {
        const SECOND: u64 = 1_000_000_000;
        let mut neighbours = Neighbours::default();
        neighbours.count_starved();
        let mut judge = |taker, at| neighbours.judge_taker("imu", &[], taker, at);
        let told = judge("thread hog", 0).unwrap();
        assert!(
            told.starts_with(
                "imu had no processor in its window and is not to blame for it: thread hog had it"
            )
        );
        assert_eq!(judge("thread hog", 2 * SECOND), None, "told");
        assert!(judge("interrupt 7", 2 * SECOND).is_some());
        assert_eq!(judge("thread pig", 2 * SECOND + 1), None, "too soon");
        assert!(judge("thread hog", 60 * SECOND).is_some());
    }
}
