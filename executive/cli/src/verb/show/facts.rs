//! What follows from a plan, as text: how full each core is, how late processes are done, how old each chain becomes, and what each
//! link costs.

use std::fmt::Write;

use bateleur_checker::ProcessResponse;
use bateleur_checker::facts::{ChainAge, CoreUse, Facts, share};
use bateleur_checker::links::LinkCost;
use bateleur_plan::Plan;
use bateleur_plan::units::{ShowRate, ShowTime};

/// Every schedule's cores and chains.
pub(crate) fn text(plan: &Plan, facts: &Facts) -> String {
    let mut out = String::new();
    for schedule in &facts.schedules {
        let _ = writeln!(out, "\nschedule `{}`", schedule.schedule);
        for core in &schedule.cores {
            core_use(&mut out, core);
        }
        for response in &schedule.responses {
            process_response(&mut out, response);
        }
        for chain in &schedule.chains {
            chain_age(&mut out, chain);
        }
        for chain in
            plan.chains.iter().filter(|chain| !schedule.chains.iter().any(|age| age.chain == chain.name))
        {
            let _ =
                writeln!(out, "  chain `{}`: not computed, a partition of it has no window here", chain.name);
        }
    }
    out
}

fn process_response(out: &mut String, response: &ProcessResponse) {
    let done = match response.response_ns {
        Some(response) => format!("done {} after its release at worst", ShowTime(response)),
        None => "nothing bounds when it is done".to_owned(),
    };
    let deadline = response.deadline_ns.map_or_else(String::new, |ns| format!(", deadline {}", ShowTime(ns)));
    let _ = writeln!(out, "  process `{}.{}`: {done}{deadline}", response.partition, response.process);
}

/// What each link costs each of its ends, in the schedule that every module starts with.
pub(crate) fn links(plan: &Plan, facts: &Facts) -> String {
    let mut out = String::new();
    for cost in facts.initial(plan).into_iter().flat_map(|schedule| &schedule.links) {
        link_cost(&mut out, cost);
    }
    out
}

fn link_cost(out: &mut String, cost: &LinkCost) {
    let _ = writeln!(
        out,
        "link `{}`, `{}` to `{}`: {} channel(s); relay {} in {} windows of {} ({})",
        cost.link,
        cost.module,
        cost.peer,
        cost.channels,
        ShowTime(cost.relay_ns),
        cost.relay_windows,
        ShowTime(cost.major_frame_ns),
        percent(share(cost.relay_ns, cost.major_frame_ns)),
    );
    let phase = match cost.aligned_within_ns {
        Some(within) => format!("frames within {}", ShowTime(within)),
        None => "frames in any phase".to_owned(),
    };
    let _ = writeln!(
        out,
        "    up to {} bytes in a window, in {} of {} datagrams with room for {}; at most {} on the way, {phase}",
        cost.window_bytes,
        cost.window_datagrams,
        cost.window_datagrams_most,
        cost.datagram_room_bytes,
        ShowTime(cost.latency_ns),
    );
    for network in &cost.networks {
        let _ = writeln!(
            out,
            "    network `{}`: {} of {} set aside ({})",
            network.network,
            ShowRate(network.reserved_bits_per_s),
            ShowRate(network.rate_bits_per_s),
            percent(share(network.reserved_bits_per_s, network.rate_bits_per_s)),
        );
    }
}

/// Hundredths of a percent as a percentage.
pub(crate) fn percent(per_ten_thousand: u64) -> String {
    format!("{}.{:02} %", per_ten_thousand / 100, per_ten_thousand % 100)
}

pub(crate) fn core_use(out: &mut String, core: &CoreUse) {
    let _ = writeln!(
        out,
        "  core {} of `{}`: {} used, largest hole {} at {}",
        core.core,
        core.module,
        percent(core.per_ten_thousand()),
        ShowTime(core.largest_hole_ns),
        ShowTime(core.largest_hole_at_ns)
    );
    let width = core.partitions.iter().map(|one| one.partition.len()).max().unwrap_or(0);
    for one in &core.partitions {
        let windows = if one.windows == 1 { "window" } else { "windows" };
        let _ = writeln!(
            out,
            "    {:<width$}  {:>8}  {} in {} {windows}",
            one.partition,
            percent(share(one.used_ns, core.major_frame_ns)),
            ShowTime(one.used_ns),
            one.windows
        );
    }
}

fn chain_age(out: &mut String, chain: &ChainAge) {
    let _ = writeln!(
        out,
        "  chain `{}`: at most {} old at its end, {} allowed",
        chain.chain,
        ShowTime(chain.age_ns),
        ShowTime(chain.max_age_ns)
    );
    let width = chain.way.iter().map(|step| step.partition.len()).max().unwrap_or(0);
    for step in &chain.way {
        let (start, end) = (signed(step.visit.start_ns), signed(step.visit.end_ns));
        let _ = writeln!(out, "    {:<width$}  {start} to {end}", step.partition);
    }
}

/// A time before or after the start of the major frame.
fn signed(ns: i64) -> String {
    let sign = if ns < 0 { "-" } else { "" };
    format!("{sign}{}", ShowTime(ns.unsigned_abs()))
}
