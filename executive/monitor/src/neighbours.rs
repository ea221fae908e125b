//! Other modules that use this one's processors: found, told of once each, and looked for when a partition had no processor in
//! its windows.
//!
//! It must never hold against a partition what somebody else has taken from it, nor look often.

use bateleur_host::instance;
use bateleur_host::machine::taken_by;

/// Between two looks, module time, ns.
const LOOK_NS: u64 = 5_000_000_000;
/// What the persistent log calls it; no error of a table.
pub(crate) const NO_PROCESSOR: &str = "no_processor";

/// See the module's head.
#[derive(Debug, Default)]
pub(crate) struct Neighbours {
    next_look_ns: u64,
    /// Processes of the modules that were told of.
    told: Vec<i32>,
    /// Windows in which a partition had no processor.
    starved: u64,
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

    /// Counts a window in which a partition had no processor; says whose fault it is, the first time. `cores`: the partition's.
    pub(crate) fn count_starved(&mut self, partition: &str, cores: &[u32]) -> Option<String> {
        self.starved += 1;
        if self.starved > 1 {
            return None;
        }
        let why = taken_by(cores, &instance::others())
            .unwrap_or_else(|| "something of a higher priority than its own has it".into());
        Some(format!("{partition} had no processor in its window and is not to blame for it: {why}"))
    }

    /// How often that was so, if it was more than once.
    pub(crate) fn sum(&self) -> Option<String> {
        let starved = self.starved;
        (starved > 1)
            .then(|| format!("partitions had no processor in {starved} windows that they did not close"))
    }
}
