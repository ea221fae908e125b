//! Rules about channels: that both ends fit each other, in kind, message and time, and where they lead all together.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap};

use super::laid::Laid;
use super::{Context, links};
use crate::catalogue::{self, Rule};
use crate::closed::{Direction, Kind};
use crate::cycle::most_between;
use crate::findings::{Finding, Span};
use crate::latency::{self, Station};
use crate::raw::{RawChannel, RawPort};
use crate::reader::At;
use crate::units::ShowTime;
use bateleur_plan::timeline::gaps;

/// One end of a channel: how the channel names it, and the port.
#[derive(Clone, Copy)]
struct End<'a> {
    said: &'a At<String>,
    place: usize,
    port: &'a RawPort,
}

impl<'a> End<'a> {
    fn of(cx: &Context<'a>, said: &'a At<String>) -> Option<Self> {
        let place = cx.names.port(&said.value)?;
        Some(Self { said, place, port: &cx.file.ports[place] })
    }

    fn name(&self) -> &str {
        &self.said.value
    }
}

pub(super) fn check(cx: &Context<'_>, laid: &[Laid]) {
    for channel in &cx.file.channels {
        let source = channel.source.said().and_then(|said| End::of(cx, said));
        let destinations = destinations(cx, channel);
        direction(cx, source.as_slice(), Direction::Source, &catalogue::SOURCE_DIRECTION);
        direction(cx, &destinations, Direction::Destination, &catalogue::DESTINATION_DIRECTION);
        count(cx, channel, source.as_ref());
        for (source, destination) in
            source.iter().flat_map(|source| destinations.iter().map(move |end| (source, end)))
        {
            itself(cx, source, destination);
            kind(cx, source, destination);
            payload(cx, source, destination);
            time(cx, laid, source, destination);
        }
        if let Some(source) = &source {
            unread(cx, laid, source, &destinations);
        }
    }
    once(cx);
    loops(cx);
}

/// Notes a sampling source whose values are written more often than anybody looks.
fn unread(cx: &Context<'_>, laid: &[Laid], source: &End<'_>, destinations: &[End<'_>]) {
    if source.port.kind.get().map(|kind| kind.0) != Some(Kind::Sampling) || destinations.is_empty() {
        return;
    }
    for (schedule, laid) in cx.file.schedules.iter().zip(laid) {
        let writes = laid.windows(source.port.partition);
        if destinations.iter().any(|end| links::is_across(cx, source.port.partition, end.port.partition)) {
            return; // the relay looks in each of its windows, whoever looks then
        }
        let readers = destinations.iter().map(|end| laid.windows(end.port.partition));
        let read: BTreeSet<u64> =
            readers.flat_map(|reads| read_writes(&writes, &reads, laid.major)).collect();
        if writes.is_empty() || read.is_empty() || read.len() >= writes.len() {
            continue;
        }
        let (name, schedule) = (source.name(), &schedule.name.value);
        let message = format!(
            "{} of {} values of `{name}` in schedule `{schedule}` are read",
            read.len(),
            writes.len()
        );
        let mend = "nothing, if that is meant; else let a reader run as often as the writer";
        cx.note(&catalogue::UNREAD_WRITES, &source.said.span, message, mend);
        break;
    }
}

/// The starts of the writing windows, in the major frame, whose last value some reading window sees.
fn read_writes(writes: &[(u64, u64)], reads: &[(u64, u64)], major: u64) -> Vec<u64> {
    let station = |windows: &[(u64, u64)]| Station { windows: windows.to_vec(), hop: None };
    let ways = latency::ways(&[station(writes), station(reads)], major);
    let cycle = i64::try_from(major).unwrap_or(i64::MAX);
    let start =
        |way: &Vec<latency::Visit>| way.first().map(|visit| visit.start_ns.rem_euclid(cycle).unsigned_abs());
    ways.iter().filter_map(start).collect()
}

/// Notes the groups of partitions in which sampling channels lead around.
fn loops(cx: &Context<'_>) {
    let edges = sampling_edges(cx);
    let mut told: BTreeSet<usize> = BTreeSet::new();
    for &(from, _, _) in &edges {
        if told.contains(&from) {
            continue;
        }
        let Some(way) = way_back(&edges, from) else { continue };
        let first_step = |edge: &&(usize, usize, _)| way.starts_with(&[edge.0, edge.1]);
        let Some((_, _, said)) = edges.iter().find(first_step) else { continue };
        told.extend(reachable_both_ways(&edges, from));
        let names: Vec<&str> = way.iter().map(|&partition| cx.partition_name(partition)).collect();
        let message = format!("sampling channels lead around: {}", names.join(" → "));
        let mend = "nothing, if a feedback is meant: whoever comes first in the minor frame reads the value of the one before";
        cx.note(&catalogue::LOOP, said, message, mend);
    }
}

/// Partition to partition, with where the channel names its source.
fn sampling_edges<'a>(cx: &'a Context<'_>) -> Vec<(usize, usize, &'a Span)> {
    let mut edges = Vec::new();
    for channel in &cx.file.channels {
        let Some(source) = channel.source.said().and_then(|said| End::of(cx, said)) else { continue };
        if source.port.kind.get().map(|kind| kind.0) != Some(Kind::Sampling) {
            continue;
        }
        let others = destinations(cx, channel).into_iter().map(|end| end.port.partition);
        let others = others.filter(|&other| other != source.port.partition);
        edges.extend(others.map(|other| (source.port.partition, other, &source.said.span)));
    }
    edges
}

/// The shortest way from a partition back to itself, both ends included.
fn way_back(edges: &[(usize, usize, &Span)], from: usize) -> Option<Vec<usize>> {
    let mut before: HashMap<usize, usize> = HashMap::new();
    let mut queue = std::collections::VecDeque::from([from]);
    while let Some(at) = queue.pop_front() {
        for &(_, next, _) in edges.iter().filter(|edge| edge.0 == at) {
            if next == from {
                let mut way = vec![from, at];
                while let Some(&earlier) =
                    way.last().filter(|&&last| last != from).and_then(|last| before.get(last))
                {
                    way.push(earlier);
                }
                way.reverse();
                return Some(way);
            }
            if let Entry::Vacant(place) = before.entry(next) {
                place.insert(at);
                queue.push_back(next);
            }
        }
    }
    None
}

/// The partitions that `from` reaches and that reach it.
fn reachable_both_ways(edges: &[(usize, usize, &Span)], from: usize) -> BTreeSet<usize> {
    let reach = |forward: bool| {
        let mut seen = BTreeSet::from([from]);
        let mut stack = vec![from];
        while let Some(at) = stack.pop() {
            for edge in edges {
                let (here, there) = if forward { (edge.0, edge.1) } else { (edge.1, edge.0) };
                if here == at && seen.insert(there) {
                    stack.push(there);
                }
            }
        }
        seen
    };
    reach(true).intersection(&reach(false)).copied().collect()
}

fn destinations<'a>(cx: &Context<'a>, channel: &'a RawChannel) -> Vec<End<'a>> {
    let list = channel.destinations.said().into_iter().flat_map(|list| &list.value);
    list.filter_map(|said| End::of(cx, said)).collect()
}

fn direction(cx: &Context<'_>, ends: &[End<'_>], wanted: Direction, rule: &'static Rule) {
    for end in ends {
        let Some(said) = end.port.direction.said().filter(|said| said.value.0 != wanted) else { continue };
        let message = format!("`{}` is a {}, and a {wanted} belongs here", end.name(), said.value.0);
        let mend = format!("swap the ends of the channel, or make the port a {wanted}");
        cx.add(Finding::new(rule, &end.said.span, message, mend).also(&said.span, "the port says so here"));
    }
}

fn count(cx: &Context<'_>, channel: &RawChannel, source: Option<&End<'_>>) {
    let Some(list) = channel.destinations.said() else { return };
    if list.value.is_empty() {
        let mend = "name at least one port, or remove the channel";
        let finding = Finding::new(&catalogue::NO_DESTINATION, &list.span, "the channel leads nowhere", mend);
        cx.add(finding.also(&channel.span, "the channel"));
    }
    let Some(kind) = source.and_then(|source| source.port.kind.said()) else { return };
    if kind.value.0 == Kind::Queuing && list.value.len() > 1 {
        let message = format!("a queuing channel has {} destinations", list.value.len());
        let mend = "keep one, and add a source port and a channel for each of the others";
        let finding = Finding::new(&catalogue::QUEUING_SEVERAL_DESTINATIONS, &list.span, message, mend);
        cx.add(finding.also(&kind.span, "its source is queuing"));
    }
}

fn itself(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    if source.port.partition == destination.port.partition {
        let name = cx.partition_name(source.port.partition);
        let message = format!("partition `{name}` sends to itself");
        let mend = "keep the value inside the partition, or name another destination";
        let finding = Finding::new(&catalogue::SELF_CHANNEL, &destination.said.span, message, mend);
        cx.add(finding.also(&source.said.span, "the source"));
    }
}

fn kind(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    let (Some(from), Some(to)) = (source.port.kind.said(), destination.port.kind.said()) else { return };
    if from.value.0 != to.value.0 {
        let (name, one, other) = (destination.name(), to.value.0, from.value.0);
        let message = format!("`{name}` is {one}, but its source `{}` is {other}", source.name());
        let mend = "give both ports the same kind";
        let finding = Finding::new(&catalogue::KIND_MIXED, &destination.said.span, message, mend);
        cx.add(finding.also(&from.span, format!("{other} here")).also(&to.span, format!("{one} here")));
    }
}

/// What a port carries, and where it says so.
#[derive(PartialEq)]
enum Carried<'a> {
    Message(&'a str),
    Bytes(u32),
}

fn carried(port: &RawPort) -> Option<(Carried<'_>, &Span)> {
    match (port.message.said(), port.max_size.said()) {
        (Some(message), None) => Some((Carried::Message(&message.value), &message.span)),
        (None, Some(size)) => Some((Carried::Bytes(size.value), &size.span)),
        _ => None,
    }
}

impl std::fmt::Display for Carried<'_> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Message(name) => write!(formatter, "`{name}`"),
            Self::Bytes(size) => write!(formatter, "up to {size} bytes"),
        }
    }
}

fn payload(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    let (Some((from, here)), Some((to, there))) = (carried(source.port), carried(destination.port)) else {
        return;
    };
    let is_unknown = |carried: &Carried<'_>| match carried {
        Carried::Message(name) => cx.catalogue.size_of(name).is_none(),
        Carried::Bytes(_) => false,
    };
    if is_unknown(&from) || is_unknown(&to) {
        // Another rule reports it; what was meant may well be the same.
        return;
    }
    let rule = match (&from, &to) {
        (Carried::Bytes(from), Carried::Bytes(to)) if from > to => &catalogue::DESTINATION_TOO_SMALL,
        (Carried::Bytes(_), Carried::Bytes(_)) => return,
        _ if from == to => return,
        _ => &catalogue::MESSAGE_MISMATCH,
    };
    let message = format!("`{}` sends {from}, but `{}` takes {to}", source.name(), destination.name());
    let mend = match from {
        Carried::Message(name) => format!("let both say `message = \"{name}\"`"),
        Carried::Bytes(size) => format!("let both say `max_size = {size}`"),
    };
    let finding = Finding::new(rule, &destination.said.span, message, mend);
    cx.add(finding.also(here, "what is sent").also(there, "what is taken"));
}

fn time(cx: &Context<'_>, laid: &[Laid], source: &End<'_>, destination: &End<'_>) {
    for laid in laid {
        let writes = laid.starts(source.port.partition);
        let reads = laid.starts(destination.port.partition);
        if writes.is_empty() || reads.is_empty() {
            continue;
        }
        let found = stale(cx, laid, &writes, source, destination)
            || overflowing(cx, laid, (&writes, &reads), source, destination);
        if found {
            // The next schedule would say the same.
            break;
        }
    }
}

fn stale(cx: &Context<'_>, laid: &Laid, writes: &[u64], source: &End<'_>, destination: &End<'_>) -> bool {
    let Some(refresh) = destination.port.refresh.said().filter(|refresh| refresh.value.0 > 0) else {
        return false;
    };
    if destination.port.kind.get().map(|kind| kind.0) != Some(Kind::Sampling) {
        return false;
    }
    let (name, limit) = (destination.name(), ShowTime(refresh.value.0));
    let period = gaps(writes, laid.major).max().unwrap_or_default();
    let age = age_when_read(cx, laid, source, destination);
    let (message, needed) = if refresh.value.0 < period {
        let period = ShowTime(period);
        (format!("`{name}` is valid for {limit}, but its source is written every {period} at best"), period)
    } else if refresh.value.0 < age {
        let age = ShowTime(age);
        (format!("`{name}` is valid for {limit}, but is up to {age} old when its window opens"), age)
    } else {
        return false;
    };
    let mend = format!("make the refresh period longer than {needed}");
    let finding = Finding::new(&catalogue::REFRESH_TOO_SHORT, &refresh.span, message, mend);
    cx.add(finding.also(&source.said.span, "the source"));
    true
}

/// The greatest age of a value as a reading window opens, counted from the opening of the window that wrote it.
fn age_when_read(cx: &Context<'_>, laid: &Laid, source: &End<'_>, destination: &End<'_>) -> u64 {
    let ends = [source.port.partition, destination.port.partition];
    let Some(legs) = links::legs(cx, &ends) else { return 0 };
    let stations: Vec<Station> =
        legs.iter().map(|leg| Station { windows: laid.windows(leg.partition), hop: leg.hop }).collect();
    let ways = latency::ways(&stations, laid.major);
    let age = |way: &Vec<latency::Visit>| match way.as_slice() {
        [write, .., read] => read.start_ns.abs_diff(write.start_ns),
        _ => 0,
    };
    ways.iter().map(age).max().unwrap_or_default().saturating_add(latency::phase_error_ns(&stations))
}

fn overflowing(
    cx: &Context<'_>,
    laid: &Laid,
    (writes, reads): (&[u64], &[u64]),
    source: &End<'_>,
    destination: &End<'_>,
) -> bool {
    let Some(depth) = destination.port.depth.said().filter(|depth| depth.value > 0) else { return false };
    // Over a link they come in the bursts of the relay: all that were written since its last window.
    let burst = links::legs(cx, &[source.port.partition, destination.port.partition])
        .filter(|legs| legs.len() > 2)
        .map_or(0, |legs| most_between(writes, &laid.starts(legs[1].partition), laid.major));
    let most = most_between(writes, reads, laid.major) + burst;
    if destination.port.kind.get().map(|kind| kind.0) != Some(Kind::Queuing) || most <= u64::from(depth.value)
    {
        return false;
    }
    let name = destination.name();
    let message =
        format!("`{name}` holds {} of up to {most} messages that come between two reads", depth.value);
    let mend = format!("make it {most} deep, or let its partition run more often");
    let finding = Finding::new(&catalogue::QUEUE_TOO_SHALLOW, &depth.span, message, mend);
    cx.add(finding.also(&source.said.span, "one message in each window of the source"));
    true
}

/// Every port is in one channel.
fn once(cx: &Context<'_>) {
    let mut sources = HashMap::new();
    let mut sinks = HashMap::new();
    for channel in &cx.file.channels {
        if let Some(end) = channel.source.said().and_then(|said| End::of(cx, said)) {
            claim(cx, &mut sources, &end, (&catalogue::SOURCE_TWICE, "is the source of two channels"));
        }
        for end in destinations(cx, channel) {
            claim(cx, &mut sinks, &end, (&catalogue::DESTINATION_TWICE, "is fed twice"));
        }
    }
}

fn claim<'a>(
    cx: &Context<'_>,
    claimed: &mut HashMap<usize, &'a Span>,
    end: &End<'a>,
    (rule, what): (&'static Rule, &str),
) {
    let Some(first) = claimed.get(&end.place) else {
        claimed.insert(end.place, &end.said.span);
        return;
    };
    let mend = match end.port.direction.get().map(|word| word.0) {
        Some(Direction::Source) => "list all its destinations in one channel",
        _ => "keep one of the two, or add a port for the other",
    };
    let finding = Finding::new(rule, &end.said.span, format!("`{}` {what}", end.name()), mend);
    cx.add(finding.also(first, "it is here before"));
}
