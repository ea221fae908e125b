//! What follows from a plan and is no fault: how full each core is, what each partition has of it, where the largest hole
//! is, and how old each chain's value becomes.

use std::collections::BTreeMap;

use serde::Serialize;

use super::latency::Visit;
use super::links::{self, LinkCost};
use super::model::{Chain, ModuleId, PartitionId, Plan, Schedule, ScheduleId};
use super::responses::{self, ProcessResponse};
use super::timeline::{CoreTimeline, Timeline, gaps};
use super::ways;

/// What follows from a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Facts {
    /// For each schedule, in the order of the file.
    pub schedules: Vec<ScheduleFacts>,
    /// What the partitions of each module may use together.
    pub memory: Vec<ModuleMemory>,
}

/// What follows from one schedule.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ScheduleFacts {
    /// Its name.
    pub schedule: String,
    /// Every partitioned core of every module.
    pub cores: Vec<CoreUse>,
    /// Every chain whose partitions, and the relays between them, all have windows in this schedule.
    pub chains: Vec<ChainAge>,
    /// What each link costs each of its ends.
    pub links: Vec<LinkCost>,
    /// When each process whose times the file says is done at worst.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub responses: Vec<ProcessResponse>,
}

/// How full a core is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CoreUse {
    /// The module.
    pub module: String,
    /// The core.
    pub core: u32,
    /// The whole cycle, ns.
    pub major_frame_ns: u64,
    /// The time of a major frame that belongs to partitions, ns.
    pub used_ns: u64,
    /// The longest stretch that belongs to nobody, ns; it may reach over the end of the major frame.
    pub largest_hole_ns: u64,
    /// Where it begins, ns from the start of the major frame.
    pub largest_hole_at_ns: u64,
    /// What each partition has, ns, in the order of the file.
    pub partitions: Vec<PartitionUse>,
}

/// What a partition has of a core.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PartitionUse {
    /// The partition.
    pub partition: String,
    /// Its time in a major frame, ns.
    pub used_ns: u64,
    /// Its windows in a major frame.
    pub windows: usize,
}

/// How old a chain's value becomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ChainAge {
    /// The chain.
    pub chain: String,
    /// From the opening of the first window to the end of the last, at worst, ns.
    pub age_ns: u64,
    /// What the file allows, ns.
    pub max_age_ns: u64,
    /// The windows on the worst way.
    pub way: Vec<Step>,
}

/// One window on the way of a chain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Step {
    /// Whose window.
    pub partition: String,
    /// When it is.
    #[serde(flatten)]
    pub visit: Visit,
}

/// What the partitions of a module may use together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ModuleMemory {
    /// The module.
    pub module: String,
    /// The sum of `memory`, in bytes; twice that of a partition with a standby.
    pub memory_bytes: u64,
}

impl Facts {
    /// What follows from a plan.
    #[must_use]
    pub fn of(plan: &Plan) -> Self {
        let memory = (0..plan.modules.len()).map(|place| memory(plan, ModuleId(place))).collect();
        let schedules = (0..plan.schedules.len()).map(|place| ScheduleFacts::of(plan, ScheduleId(place)));
        Self { schedules: schedules.collect(), memory }
    }

    /// What follows from the schedule that every module starts with.
    #[must_use]
    pub fn initial<'a>(&'a self, plan: &Plan) -> Option<&'a ScheduleFacts> {
        self.schedules.get(plan.initial_schedule().index())
    }
}

fn memory(plan: &Plan, module: ModuleId) -> ModuleMemory {
    let mine = plan.partitions.iter().filter(|partition| partition.module == module);
    let memory_bytes = mine.fold(0_u64, |sum, partition| sum.saturating_add(partition.all_memory_bytes()));
    ModuleMemory { module: plan[module].name.clone(), memory_bytes }
}

impl ScheduleFacts {
    fn of(plan: &Plan, schedule: ScheduleId) -> Self {
        let lines = (0..plan.modules.len()).map(ModuleId);
        let cores = lines.flat_map(|module| {
            let line = Timeline::of(plan, module, schedule);
            let major = line.major_frame_ns;
            let cores: Vec<CoreUse> =
                line.cores.iter().map(|core| CoreUse::of(plan, module, core, major)).collect();
            cores
        });
        let chains = plan.chains.iter().filter_map(|chain| ChainAge::of(plan, &plan[schedule], chain));
        Self {
            schedule: plan[schedule].name.clone(),
            cores: cores.collect(),
            chains: chains.collect(),
            links: links::costs(plan, &plan[schedule]),
            responses: responses::of_schedule(plan, &plan[schedule]),
        }
    }
}

impl CoreUse {
    fn of(plan: &Plan, module: ModuleId, line: &CoreTimeline, major_frame_ns: u64) -> Self {
        let (largest_hole_ns, largest_hole_at_ns) = largest_hole(line, major_frame_ns);
        let mut shares: BTreeMap<PartitionId, (u64, usize)> = BTreeMap::new();
        for window in &line.windows {
            let share = shares.entry(window.partition).or_default();
            *share = (share.0 + window.duration_ns(), share.1 + 1);
        }
        let partitions = shares.into_iter().map(|(partition, (used_ns, windows))| PartitionUse {
            partition: plan[partition].name.clone(),
            used_ns,
            windows,
        });
        Self {
            module: plan[module].name.clone(),
            core: line.core,
            major_frame_ns,
            used_ns: line.used_ns(),
            largest_hole_ns,
            largest_hole_at_ns,
            partitions: partitions.collect(),
        }
    }

    /// The share of the major frame that belongs to partitions, in hundredths of a percent.
    #[must_use]
    pub fn per_ten_thousand(&self) -> u64 {
        share(self.used_ns, self.major_frame_ns)
    }
}

/// The part of the whole in hundredths of a percent.
#[must_use]
pub fn share(part_ns: u64, whole_ns: u64) -> u64 {
    let share = u128::from(part_ns) * 10_000 / u128::from(whole_ns.max(1));
    u64::try_from(share).unwrap_or(u64::MAX)
}

fn largest_hole(line: &CoreTimeline, major_ns: u64) -> (u64, u64) {
    let starts: Vec<u64> = line.windows.iter().map(|window| window.start_ns).collect();
    let windows = line.windows.iter().zip(gaps(&starts, major_ns));
    let holes = windows.map(|(window, gap)| (gap.saturating_sub(window.duration_ns()), window.end_ns));
    let largest = holes.max_by_key(|&(hole, at)| (hole, std::cmp::Reverse(at)));
    largest.map_or((major_ns, 0), |(hole, at)| (hole, at % major_ns.max(1)))
}

impl ChainAge {
    fn of(plan: &Plan, schedule: &Schedule, chain: &Chain) -> Option<Self> {
        let way = ways::worst(plan, schedule, &chain.path)?;
        let steps = way.partitions.iter().zip(way.visits);
        Some(Self {
            chain: chain.name.clone(),
            age_ns: way.age_ns,
            max_age_ns: chain.max_age_ns,
            way: steps.map(|(&id, visit)| Step { partition: plan[id].name.clone(), visit }).collect(),
        })
    }
}
