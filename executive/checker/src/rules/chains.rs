//! Rules about chains: every step of a path leads somewhere, and what arrives at its end is not too old.

use super::Context;
use crate::catalogue;
use crate::findings::Finding;
use crate::model::{ModuleId, PortId};
use crate::raw::RawChain;
use crate::units::ShowTime;
use crate::ways::{self, Way};

pub(super) fn check(cx: &Context<'_>) {
    for (raw, chain) in cx.file.chains.iter().zip(&cx.plan.chains) {
        length(cx, raw);
        age(cx, raw);
        if !port_twice(cx, raw, &chain.path) {
            out_of_phase(cx, raw, &chain.path);
            too_old(cx, raw, &chain.path);
        }
    }
}

/// Notes a path that comes back to a port, and says whether it does.
fn port_twice(cx: &Context<'_>, chain: &RawChain, path: &[PortId]) -> bool {
    let (Some(said), mut seen) = (chain.path.said(), std::collections::BTreeSet::new()) else { return false };
    let Some(&port) = path.iter().find(|&&port| !seen.insert(port)) else { return false };
    let message = format!("the path comes to `{}` twice", cx.plan.port_path(port));
    let mend = "end it before it comes back, or make a chain of its own of the rest";
    cx.note(&catalogue::CHAIN_PORT_TWICE, &said.span, message, mend);
    true
}

/// Notes a path between computers whose frames have no common phase.
fn out_of_phase(cx: &Context<'_>, chain: &RawChain, path: &[PortId]) {
    let Some(said) = chain.path.said() else { return };
    let modules = path.iter().filter_map(|port| cx.module_of(cx.plan[*port].partition));
    let modules: Vec<ModuleId> = modules.collect();
    let apart = |pair: &&[ModuleId]| cx.plan.aligned_within_ns(pair[0], pair[1]).is_none();
    let Some(pair) = modules.windows(2).find(apart) else { return };
    let (one, other) = (cx.module_name(pair[0]), cx.module_name(pair[1]));
    let message = format!(
        "the path leads from module `{one}` to `{other}`, whose frames have no common phase: its age has a whole pause of \
         the relay in it"
    );
    let mend = format!("let one follow the other: `follows = \"{one}\"` in `[module.{other}]`");
    cx.note(&catalogue::CHAIN_CROSSES_MODULES, &said.span, message, mend);
}

fn too_old(cx: &Context<'_>, chain: &RawChain, path: &[PortId]) {
    let Some(allowed) = chain.max_age.said().filter(|age| age.value.0 > 0) else { return };
    for schedule in &cx.plan.schedules {
        // Without a relay or a link there is no way, which another rule reports.
        let way = ways::worst(cx.plan, schedule, path).filter(|way| way.age_ns > allowed.value.0);
        let Some(way) = way else { continue };
        let name = chain.name.get().unwrap_or_default();
        let (schedule, allowed_time) = (&schedule.name, ShowTime(allowed.value.0));
        let message = format!(
            "`{name}` is up to {} old at its end in schedule `{schedule}`, and {allowed_time} is allowed",
            ShowTime(way.age_ns)
        );
        let finding = Finding::new(&catalogue::CHAIN_TOO_OLD, &allowed.span, message, longest_wait(cx, &way));
        cx.add(match chain.path.said() {
            Some(said) => finding.also(&said.span, "the path"),
            None => finding,
        });
    }
}

/// How to mend an age: where on the way most of it comes about.
fn longest_wait(cx: &Context<'_>, way: &Way) -> String {
    let steps = way.visits.windows(2).enumerate();
    let waits = steps.map(|(place, pair)| (pair[1].start_ns.abs_diff(pair[0].end_ns), place));
    let Some((wait, place)) = waits.max_by_key(|&(wait, place)| (wait, std::cmp::Reverse(place))) else {
        return "shorten the window, or allow more".to_owned();
    };
    let (from, to) = (cx.partition_name(way.partitions[place]), cx.partition_name(way.partitions[place + 1]));
    format!(
        "it waits longest, {}, from the end of a window of `{from}` to the next one of `{to}` that opens after: move them \
         closer, let them recur more often, or allow more",
        ShowTime(wait)
    )
}

fn length(cx: &Context<'_>, chain: &RawChain) {
    let Some(path) = chain.path.said() else { return };
    if path.value.len() < 2 {
        let message = format!("the path has {} of at least two ports", path.value.len());
        let mend = "name the port where the path begins and the port where it ends";
        cx.add(Finding::new(&catalogue::CHAIN_TOO_SHORT, &path.span, message, mend));
    }
}

fn age(cx: &Context<'_>, chain: &RawChain) {
    if let Some(age) = chain.max_age.said().filter(|age| age.value.0 == 0) {
        let mend = "write the age that the end of the path still tolerates";
        cx.add(Finding::new(&catalogue::CHAIN_ZERO_AGE, &age.span, "the largest age is zero", mend));
    }
}
