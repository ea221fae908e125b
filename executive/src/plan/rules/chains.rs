//! Rules about chains: every step of a path leads somewhere.

use super::Context;
use crate::plan::catalogue;
use crate::plan::closed::Direction;
use crate::plan::findings::Finding;
use crate::plan::names::{Names, port_path};
use crate::plan::raw::{RawChain, RawFile};

/// Why a path is not one.
pub(in crate::plan) enum Gap {
    /// A port is not known, which another rule reports.
    Unknown,
    /// Nothing leads from the port at this place of the written path to the one after.
    After(usize),
}

pub(super) fn check(cx: &Context<'_>) {
    for chain in &cx.file.chains {
        length(cx, chain);
        age(cx, chain);
        if let Err(Gap::After(place)) = full_path(cx.file, cx.names, chain) {
            disconnected(cx, chain, place);
        }
    }
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
    let mend = "connect them by a channel, or name the ports between them";
    let finding = Finding::new(&catalogue::CHAIN_DISCONNECTED, &to.span, message, mend);
    cx.add(finding.also(&from.span, "the path is here before"));
}

/// Every port of a chain, also those that the file leaves out.
pub(in crate::plan) fn full_path(file: &RawFile, names: &Names, chain: &RawChain) -> Result<Vec<usize>, Gap> {
    let said = chain.path.said().ok_or(Gap::Unknown)?.value.iter();
    let ports =
        said.map(|port| names.port(&port.value)).collect::<Option<Vec<usize>>>().ok_or(Gap::Unknown)?;
    let mut path: Vec<usize> = ports.first().copied().into_iter().collect();
    for (place, step) in ports.windows(2).enumerate() {
        path.extend(between(file, names, step[0], step[1]).ok_or(Gap::After(place))?);
        path.push(step[1]);
    }
    Ok(path)
}

/// The ports left out between two ports of a path; nothing if there is no way.
fn between(file: &RawFile, names: &Names, from: usize, to: usize) -> Option<Option<usize>> {
    let direction = |port: usize| file.ports[port].direction.get().map(|word| word.0);
    let owner = |port: usize| file.ports[port].partition;
    match (direction(from)?, direction(to)?) {
        (Direction::Destination, Direction::Source) => (owner(from) == owner(to)).then_some(None),
        (Direction::Source, Direction::Destination) => {
            destinations(file, names, from).contains(&to).then_some(None)
        }
        (Direction::Source, Direction::Source) => {
            destinations(file, names, from).into_iter().find(|&port| owner(port) == owner(to)).map(Some)
        }
        (Direction::Destination, Direction::Destination) => {
            let source = source(file, names, to)?;
            (owner(from) == owner(source)).then_some(Some(source))
        }
    }
}

/// The ports that a source port reaches.
fn destinations(file: &RawFile, names: &Names, source: usize) -> Vec<usize> {
    let path = port_path(file, &file.ports[source]);
    let mine = |channel: &&crate::plan::raw::RawChannel| {
        channel.source.said().is_some_and(|said| said.value == path)
    };
    let lists = file.channels.iter().filter(mine).filter_map(|channel| channel.destinations.said());
    lists.flat_map(|list| list.value.iter().filter_map(|port| names.port(&port.value))).collect()
}

/// The port that feeds a destination port.
fn source(file: &RawFile, names: &Names, destination: usize) -> Option<usize> {
    let channel = &file.channels[names.channel_of(destination)?];
    names.port(&channel.source.said()?.value).filter(|&port| port != destination)
}
