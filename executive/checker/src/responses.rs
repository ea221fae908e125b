//! The worst responses of the processes of a plan.

use bateleur_contract::WINDOW_MARGIN_NS;
use serde::Serialize;

use super::model::{PartitionId, Plan, Schedule};
use super::response::{Response, Supply, Task, responses};
use bateleur_plan::Process;

/// When a process is done after its release in one schedule, at worst.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProcessResponse {
    /// The partition.
    pub partition: String,
    /// The process.
    pub process: String,
    /// So long after its release, ns; `None`: nothing bounds it.
    pub response_ns: Option<u64>,
    /// When it has to be, ns; `None`: whenever.
    pub deadline_ns: Option<u64>,
}

/// Those of all partitions that run in a schedule and say the times of their processes.
pub(super) fn of_schedule(plan: &Plan, schedule: &Schedule) -> Vec<ProcessResponse> {
    let of = |id: PartitionId| of_partition(plan, schedule, id).unwrap_or_default();
    plan.partition_ids().flat_map(of).collect()
}

fn of_partition(plan: &Plan, schedule: &Schedule, id: PartitionId) -> Option<Vec<ProcessResponse>> {
    let response = |(process, response): (&Process, Response)| ProcessResponse {
        partition: plan[id].name.clone(),
        process: process.name.clone(),
        response_ns: match response {
            Response::Within(response) => Some(response),
            Response::TooMuch | Response::Unlimited(_) => None,
        },
        deadline_ns: process.deadline_ns,
    };
    let responses = worst(plan, schedule, id)?;
    Some(plan[id].processes.declared.iter().zip(responses).map(response).collect())
}

/// Those of one partition; `None` where it has no processes, no windows, or periods that do not divide the major frame.
pub(super) fn worst(plan: &Plan, schedule: &Schedule, id: PartitionId) -> Option<Vec<Response>> {
    let told = &plan[id].processes;
    let (processes, windows, major_ns) = (&told.declared, schedule.occurrences(id), schedule.major_frame_ns);
    let overlap = windows.windows(2).any(|pair| pair[1].0 < pair[0].1); // which is an error of its own
    if processes.is_empty() || windows.is_empty() || overlap || !major_ns.is_multiple_of(told.period_ns) {
        return None;
    }
    let task = |process: &Process| Task {
        priority: process.priority,
        period_ns: process.period_ns,
        wcet_ns: process.wcet_ns,
    };
    let tasks: Vec<Task> = processes.iter().map(task).collect();
    Some(responses(
        &tasks,
        &Supply::new(&windows, WINDOW_MARGIN_NS, major_ns, (told.release_ns, told.period_ns)),
    ))
}
