//! The way of a value from partition to partition, with the relays between modules, and how old it becomes.

use super::closed::Direction;
use super::latency::{self, Hop, Station, Visit};
use super::model::{PartitionId, Plan, PortId, Schedule};

/// The partitions of a path with the relays between them, and how the value comes to each; nothing where modules are not
/// joined.
pub(super) fn legs(plan: &Plan, stations: &[PartitionId]) -> Option<Vec<(PartitionId, Option<Hop>)>> {
    let mut legs: Vec<(PartitionId, Option<Hop>)> = Vec::new();
    for &partition in stations {
        let module = plan[partition].module;
        if let Some(from) = legs.last().map(|before| plan[before.0].module).filter(|&from| from != module) {
            let link = plan.link_between(from, module)?;
            let aligned_within_ns = plan.aligned_within_ns(from, module);
            let beside_first_ns = match plan[stations.first().copied()?].module {
                first if first == module => 0,
                first => plan.aligned_within_ns(first, module).or(aligned_within_ns).unwrap_or(0),
            };
            let hop = Hop { latency_ns: plan.latency_ns(link), aligned_within_ns, beside_first_ns };
            legs.push((plan.relay_of(from)?, None));
            legs.push((plan.relay_of(module)?, Some(hop)));
        }
        legs.push((partition, None));
    }
    Some(legs)
}

/// The windows of the partitions of a path in one schedule.
pub(super) fn stations(schedule: &Schedule, legs: &[(PartitionId, Option<Hop>)]) -> Vec<Station> {
    let station =
        |&(partition, hop): &(_, Option<Hop>)| Station { windows: schedule.occurrences(partition), hop };
    legs.iter().map(station).collect()
}

/// The windows on the way of the oldest value.
pub(super) struct Way {
    /// Whose they are.
    pub(super) partitions: Vec<PartitionId>,
    /// When.
    pub(super) visits: Vec<Visit>,
    /// From the opening of the first to the end of the last, ns.
    pub(super) age_ns: u64,
}

/// How the oldest value comes to the end of a path; nothing where it never does.
pub(super) fn worst(plan: &Plan, schedule: &Schedule, path: &[PortId]) -> Option<Way> {
    let ports = path.iter().map(|&port| &plan[port]);
    let owners = ports.map(|port| (port.partition, port.direction() == Direction::Source));
    let legs = legs(plan, &latency::stations(owners))?;
    let stations = stations(schedule, &legs);
    let visits = latency::worst(&stations, schedule.major_frame_ns)?;
    let age_ns = latency::age_ns(&stations, &visits);
    Some(Way { partitions: legs.into_iter().map(|(partition, _)| partition).collect(), visits, age_ns })
}
