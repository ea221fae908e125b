//! Rules about chains: every step of a path leads somewhere, and what arrives at its end is not too old.

use super::laid::Laid;
use super::{Context, links};
use crate::catalogue;
use crate::closed::Direction;
use crate::findings::Finding;
use crate::latency::{self, Station, Visit};
use crate::names::{Gap, destinations, full_path};
use crate::raw::RawChain;
use crate::units::ShowTime;
use bateleur_plan::words::listed;

pub(super) fn check(cx: &Context<'_>, laid: &[Laid]) {
    for chain in &cx.file.chains {
        length(cx, chain);
        age(cx, chain);
        match full_path(cx.file, cx.names, chain) {
            Err(Gap::After(place)) => disconnected(cx, chain, place),
            Err(Gap::Unknown) => {}
            Ok(path) => {
                if !port_twice(cx, chain, &path) {
                    out_of_phase(cx, chain, &path);
                    too_old(cx, laid, chain, &path);
                }
            }
        }
    }
}

/// Notes a path that comes back to a port, and says whether it does.
fn port_twice(cx: &Context<'_>, chain: &RawChain, path: &[usize]) -> bool {
    let (Some(said), mut seen) = (chain.path.said(), std::collections::BTreeSet::new()) else { return false };
    let Some(&port) = path.iter().find(|&&port| !seen.insert(port)) else { return false };
    let message = format!("the path comes to `{}` twice", cx.port_path(port));
    let mend = "end it before it comes back, or make a chain of its own of the rest";
    cx.note(&catalogue::CHAIN_PORT_TWICE, &said.span, message, mend);
    true
}

/// Notes a path between computers whose frames have no common phase.
fn out_of_phase(cx: &Context<'_>, chain: &RawChain, path: &[usize]) {
    let Some(said) = chain.path.said() else { return };
    let module = |port: &usize| cx.names.module_of(cx.file, cx.file.ports[*port].partition);
    let modules: Vec<usize> = path.iter().filter_map(module).collect();
    let apart = |pair: &&[usize]| links::aligned_within_ns(cx, pair[0], pair[1]).is_none();
    let Some(pair) = modules.windows(2).find(apart) else { return };
    let (one, other) = (&cx.file.modules[pair[0]].name.value, &cx.file.modules[pair[1]].name.value);
    let message = format!(
        "the path leads from module `{one}` to `{other}`, whose frames have no common phase: its age has a whole pause of \
         the relay in it"
    );
    let mend = format!("let one follow the other: `follows = \"{one}\"` in `[module.{other}]`");
    cx.note(&catalogue::CHAIN_CROSSES_MODULES, &said.span, message, mend);
}

fn too_old(cx: &Context<'_>, laid: &[Laid], chain: &RawChain, path: &[usize]) {
    let Some(allowed) = chain.max_age.said().filter(|age| age.value.0 > 0) else { return };
    let is_source =
        |port: usize| cx.file.ports[port].direction.get().map(|word| word.0) == Some(Direction::Source);
    let stations =
        latency::stations(path.iter().map(|&port| (cx.file.ports[port].partition, is_source(port))));
    // Without a relay or a link there is no way, which another rule reports.
    let Some(legs) = links::legs(cx, &stations) else { return };
    let stations: Vec<usize> = legs.iter().map(|leg| leg.partition).collect();
    for (schedule, laid) in cx.file.schedules.iter().zip(laid) {
        let on_the_way: Vec<Station> =
            legs.iter().map(|leg| Station { windows: laid.windows(leg.partition), hop: leg.hop }).collect();
        let Some(way) = latency::worst(&on_the_way, laid.major) else { continue };
        let age = latency::age_ns(&on_the_way, &way);
        if age <= allowed.value.0 {
            continue;
        }
        let name = chain.name.get().unwrap_or_default();
        let (schedule, allowed_time) = (&schedule.name.value, ShowTime(allowed.value.0));
        let message = format!(
            "`{name}` is up to {} old at its end in schedule `{schedule}`, and {allowed_time} is allowed",
            ShowTime(age)
        );
        let mend = longest_wait(cx, &stations, &way);
        let finding = Finding::new(&catalogue::CHAIN_TOO_OLD, &allowed.span, message, mend);
        cx.add(match chain.path.said() {
            Some(said) => finding.also(&said.span, "the path"),
            None => finding,
        });
    }
}

/// How to mend an age: where on the way most of it comes about.
fn longest_wait(cx: &Context<'_>, stations: &[usize], way: &[Visit]) -> String {
    let steps = way.windows(2).enumerate();
    let waits = steps.map(|(place, pair)| (pair[1].start_ns.abs_diff(pair[0].end_ns), place));
    let Some((wait, place)) = waits.max_by_key(|&(wait, place)| (wait, std::cmp::Reverse(place))) else {
        return "shorten the window, or allow more".to_owned();
    };
    let (from, to) = (cx.partition_name(stations[place]), cx.partition_name(stations[place + 1]));
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

fn disconnected(cx: &Context<'_>, chain: &RawChain, place: usize) {
    let Some([from, to]) = chain.path.said().and_then(|path| path.value.get(place..place + 2)) else {
        return;
    };
    let message = format!("nothing leads from `{}` to `{}`", from.value, to.value);
    let onward = cx.names.port(&from.value).map(|port| onward(cx, port)).unwrap_or_default();
    let mut mend = "connect them by a channel, or name the ports between them".to_owned();
    if !onward.is_empty() {
        let ports = listed(onward.iter().map(String::as_str));
        mend = format!("{mend}; `{}` leads to {ports}", from.value);
    }
    let finding = Finding::new(&catalogue::CHAIN_DISCONNECTED, &to.span, message, mend);
    cx.add(finding.also(&from.span, "the path is here before"));
}

/// Where a path may go from a port: through its channel, or through its partition.
fn onward(cx: &Context<'_>, port: usize) -> Vec<String> {
    let is_source =
        |port: usize| cx.file.ports[port].direction.get().map(|word| word.0) == Some(Direction::Source);
    let owner = cx.file.ports[port].partition;
    let ports: Vec<usize> = match is_source(port) {
        true => destinations(cx.file, cx.names, port),
        false => (0..cx.file.ports.len())
            .filter(|&other| cx.file.ports[other].partition == owner && is_source(other))
            .collect(),
    };
    ports.into_iter().map(|port| cx.port_path(port)).collect()
}
